#!/usr/bin/env python3
"""Measure how every stage scales with threads: one volume through all stages, as one table.

    scaling.py @stages/distfield/benches/peers.txt [--threads 1 2 4 8 16] [--rounds 1]

CASE is NAME=VOLUME;DISTFIELD OPTIONS[;SIZEFIELD OPTIONS]. @FILE stands for the lines of a file
that do not start with #. $NAME stands for an environment variable. Seconds are those of the
stages' reports, the minimum over all rounds. A step has a row if it takes at least a fiftieth of
the whole chain on the fewest threads. "Serial" is the share of the work that does not scale, by
Amdahl's law from the fewest and the most threads: t(n) = t(1) (s + (1 - s) / n). Files made with
different numbers of threads are compared; if they differ, the exit code is 1. `particles` runs on
the CPU.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import platform
import subprocess
import sys
from pathlib import Path

STAGES = ("distfield", "sizefield", "seed", "particles", "reconstruct")
LEAST_SHARE = 0.02  # minimum share of the total time for a step to have a row


def commands(volume: str, distfield: list[str], sizefield: list[str], folder: Path) -> list[tuple[list[str], Path]]:
    """Return the arguments of each stage and the file that the stage writes."""
    names = ("distfield.vti", "sizefield.vti", "seeds.bin", "particles.bin", "surface.vtp")
    f, s, seeds, particles, surface = (folder / name for name in names)
    fields = ["--distfield", str(f), "--sizefield", str(s)]
    return [
        ([volume, *distfield], f),
        ([str(f), *sizefield], s),
        ([str(f), str(s)], seeds),
        ([str(seeds), *fields, "--backend", "cpu"], particles),
        ([str(particles), *fields], surface),
    ]


def run(
    arguments: argparse.Namespace, text: str, threads: int, folder: Path
) -> tuple[dict[tuple[str, str], float], str]:
    """Return the seconds of every step ("" for the whole stage) and a digest of all outputs."""
    _, _, rest = text.partition("=")
    volume, distfield, sizefield = [*os.path.expandvars(rest).split(";"), ""][:3]
    seconds: dict[tuple[str, str], float] = {}
    digest = hashlib.sha256()
    steps = commands(volume, distfield.split(), sizefield.split(), folder)
    for stage, (options, output) in zip(STAGES, steps, strict=True):
        report = folder / f"{stage}.json"
        shared = ["--force", "-q", "--threads", str(threads), "--report", str(report)]
        command = [str(arguments.bin / stage), *options, "-o", str(output), *shared]
        done = subprocess.run(command, check=False, stderr=subprocess.PIPE, text=True)
        if done.returncode not in (0, 1):
            raise SystemExit(f"{stage}: {done.stderr.strip()}")
        told = json.loads(report.read_text(encoding="utf-8"))
        seconds[stage, ""] = told["seconds"]
        for step in told["steps"]:
            seconds[stage, step["name"]] = seconds.get((stage, step["name"]), 0.0) + step["seconds"]
        digest.update(output.read_bytes())
    seconds["all", ""] = sum(seconds[stage, ""] for stage in STAGES)
    return seconds, digest.hexdigest()


def serial(first: float, last: float, few: int, many: int) -> str:
    """Return the serial percentage of the work on one thread, from Amdahl's law."""
    # Amdahl's law for the serial fraction s is t(n) = t(1) (s + (1 - s) / n). The ratio of t(many)
    # to t(few) eliminates t(1) and determines s.
    ratio = last / first if first > 0.0 else 1.0
    share = (ratio / few - 1.0 / many) / ((1.0 - 1.0 / many) - ratio * (1.0 - 1.0 / few))
    return f"{100.0 * min(max(share, 0.0), 1.0):.0f}"


def main() -> None:
    """Run the program and print the tables."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter, fromfile_prefix_chars="@"
    )
    parser.add_argument("cases", nargs="+", metavar="CASE")
    parser.add_argument("--threads", type=int, nargs="+", default=[1, 2, 4, 8, 16])
    parser.add_argument("--rounds", type=int, default=1)
    parser.add_argument("--bin", type=Path, default=Path("target/release"), help="folder of the stage programs")
    parser.add_argument("--work", type=Path, default=Path("out/scaling"), help="folder for the files")
    arguments = parser.parse_intermixed_args()
    threads = sorted(set(arguments.threads))
    differ = False
    print(f"{platform.machine()}, {os.cpu_count()} cores, load {os.getloadavg()[0]:.1f} at the start")
    # Case files may contain comments.
    for text in (text for text in arguments.cases if not text.startswith("#")):
        name = text.partition("=")[0]
        folder = arguments.work / name
        folder.mkdir(parents=True, exist_ok=True)
        best: dict[int, dict[tuple[str, str], float]] = {}
        digests = set()
        for _ in range(arguments.rounds):
            for count in threads:
                seconds, digest = run(arguments, text, count, folder)
                digests.add(digest)
                before = best.setdefault(count, seconds)
                best[count] = {key: min(before.get(key, value), value) for key, value in seconds.items()}
        few, many = threads[0], threads[-1]
        differ |= len(digests) > 1
        print(f"\n{name}: files {'the same' if len(digests) == 1 else 'NOT the same'} on any number of threads\n")
        print(
            "| stage | step | " + " | ".join(f"{count} threads, s" for count in threads) + " | speed-up | serial, % |"
        )
        print("|" + "---|" * (len(threads) + 4))
        for (stage, step), first in best[few].items():
            if step and first < LEAST_SHARE * best[few]["all", ""]:
                continue
            last = best[many][stage, step]
            row = [stage, step or "**all**", *(f"{best[count][stage, step]:.2f}" for count in threads)]
            row += [f"{first / last:.1f}" if last > 0.0 else "-", serial(first, last, few, many) if many > few else "-"]
            print("| " + " | ".join(row) + " |", flush=True)
    sys.exit(int(differ))


if __name__ == "__main__":
    main()
