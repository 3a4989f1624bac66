"""Shared code of the benchmarks of docs/results.md: stage runs, and a JSON file with their rows.

The code uses only the standard library, so a machine needs only Python and the programs.
"""

from __future__ import annotations

import argparse
import concurrent.futures
import json
import math
import os
import platform
import shlex
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

Row = dict[str, Any]

SHRINK = 20
"""Divisor of the number of particles with `--quick`."""

BINS = 25
"""Number of bins of a stored histogram of radius ratios; the reports have 50 bins."""


class StageError(Exception):
    """A program has failed; the message contains the program and the reason."""


@dataclass
class Rows:
    """The rows of a JSON file by name; the file is rewritten after each row."""

    path: Path
    head: Row
    rows: dict[str, Row] = field(default_factory=dict)
    lock: threading.Lock = field(default_factory=threading.Lock)

    @classmethod
    def open(cls, path: Path, head: Row) -> Rows:
        """Read the rows of the file; refuse rows of another build or machine."""
        if not path.exists():
            return cls(path, head)
        told = json.loads(path.read_text(encoding="utf-8"))
        for key in ("commit", "processor", "cores", "adapter", "quick"):
            if told["head"].get(key) != head.get(key):
                sys.exit(
                    f"{path}: {key} is {told['head'].get(key)!r} there and {head.get(key)!r} here\n"
                    "  why it matters: rows of one file are compared with each other\n"
                    "  what to do: name another file by --json, or remove this one"
                )
        return cls(path, told["head"], told["rows"])

    def __contains__(self, name: str) -> bool:
        """Return whether the row exists."""
        return name in self.rows

    def add(self, name: str, row: Row) -> None:
        """Store a row, and write the file."""
        with self.lock:
            self.rows[name] = row
            lines = ",\n".join(f"{json.dumps(key)}: {json.dumps(self.rows[key])}" for key in sorted(self.rows))
            text = f'{{"head": {json.dumps(self.head, indent=1)},\n"rows": {{\n{lines}\n}}}}\n'
            new = self.path.with_suffix(".new")
            new.write_text(text, encoding="utf-8")
            new.replace(self.path)


@dataclass
class Bench:
    """Folders of programs and files, number of cores, and the time after which no run starts."""

    programs: Path
    work: Path
    cores: int
    stop_at: float
    left: int = 0

    def stage(self, program: str, options: str, report: Path, threads: int, allowed: tuple[int, ...] = (0,)) -> Row:
        """Run a stage; return its report, with the seconds of the whole process as `wall`."""
        command = [str(self.programs / program), *shlex.split(options)]
        command += ["--force", "-q", "--threads", str(threads), "--report", str(report)]
        begun = time.perf_counter()
        done = subprocess.run(command, check=False, stderr=subprocess.PIPE, text=True)
        wall = time.perf_counter() - begun
        if done.returncode not in allowed:
            raise StageError(f"{shlex.join(command)}: exit code {done.returncode}\n{done.stderr.strip()}")
        told: Row = json.loads(report.read_text(encoding="utf-8"))
        told["wall"] = wall
        return told

    @staticmethod
    def report(path: Path) -> Row:
        """Read an existing report."""
        try:
            told: Row = json.loads(path.read_text(encoding="utf-8"))
        except FileNotFoundError as why:
            raise StageError(f"{path}: not there, so a run before did not end") from why
        return told

    def phantom(self, words: str, path: Path) -> Path:
        """Make a volume with `phantom` from these words, unless it exists."""
        if not path.exists():
            command = [str(self.programs / "phantom"), *shlex.split(words), "-o", str(path), "--force"]
            done = subprocess.run(command, check=False, stderr=subprocess.PIPE, text=True)
            if done.returncode != 0:
                raise StageError(f"{shlex.join(command)}: exit code {done.returncode}\n{done.stderr.strip()}")
        return path

    def each(self, tasks: Iterable[tuple[str, Callable[[], None]]], at_once: int) -> None:
        """Run tasks, `at_once` in parallel.

        A task that fails is reported and omitted. No task starts after the time limit.
        """

        def one(name: str, task: Callable[[], None]) -> None:
            if time.monotonic() > self.stop_at:
                self.left += 1
                return
            begun = time.perf_counter()
            try:
                task()
            except StageError as why:
                self.left += 1
                print(f"{name}: left out: {why}", file=sys.stderr, flush=True)
                return
            print(f"{name}: {time.perf_counter() - begun:.1f} s", file=sys.stderr, flush=True)

        with concurrent.futures.ThreadPoolExecutor(max(at_once, 1)) as pool:
            for done in [pool.submit(one, name, task) for name, task in tasks]:
                done.result()


def histogram(quality: Row) -> list[int]:
    """Merge the report's histogram of radius ratios from 0 to 1 into BINS bins."""
    counts: list[int] = quality["radius_ratio_histogram"]
    width = len(counts) // BINS
    return [sum(counts[i * width : (i + 1) * width]) for i in range(BINS)]


def settled(report: Row) -> Row:
    """Return the figures of a `particles` report that a row stores."""
    results = report["results"]
    passes = results["passes"]
    device = results.get("device") or {}
    return {
        "particles": int(results["particles"]),
        "passes": len(passes),
        "inserted": sum(one["inserted"] for one in passes),
        "deleted": sum(one["deleted"] for one in passes),
        "escaped": results["settling"]["escaped"],
        "energy_ratio": round(results["settling"]["energy_ratio"], 4),
        "stopped_by": results["stopped by"],
        "settle": round(next(step["seconds"] for step in report["steps"] if step["name"] == "settle"), 4),
        "device": round(device["device_seconds"], 4) if "device_seconds" in device else None,
        "device_bytes": device.get("peak_device_bytes"),
        "wall": round(report["wall"], 3),
        "bytes": report.get("peak_memory_bytes"),
    }


def ratios(quality: Row) -> Row:
    """Return the figures of triangle quality that a row stores."""
    return {
        "mean": round(quality["radius_ratio_mean"], 5),
        "smallest": round(quality["radius_ratio_min"], 5),
        "angles": [round(quality["angle_min"], 1), round(quality["angle_max"], 1)],
        "histogram": histogram(quality),
    }


def stage_row(report: Row) -> Row:
    """Return the time and memory of a stage."""
    return {
        "seconds": round(report["seconds"], 4),
        "wall": round(report["wall"], 3),
        "bytes": report["peak_memory_bytes"],
    }


def options(description: str | None, json_name: str) -> argparse.ArgumentParser:
    """Return a parser with the options that both benchmarks share."""
    parser = argparse.ArgumentParser(description=description, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--bin", type=Path, default=Path("target/release"), help="folder of the stage programs")
    parser.add_argument("--work", type=Path, default=Path("out") / json_name, help="folder for the files")
    parser.add_argument(
        "--json",
        type=Path,
        default=Path(f"docs/results/{json_name}.json"),
        help="the rows; those in it are not run again",
    )
    parser.add_argument("--jobs", type=int, default=0, help="cores to use (default: all)")
    parser.add_argument("--adapter", help="part of the GPU's name; a software renderer must be named")
    parser.add_argument("--no-gpu", action="store_true", help="leave out the runs on a GPU")
    parser.add_argument(
        "--quick", action="store_true", help="a twentieth of everything: to see that it runs, not to measure"
    )
    parser.add_argument(
        "--time-limit",
        type=float,
        default=math.inf,
        metavar="SECONDS",
        help="then begin no run; call again for the rest",
    )
    parser.add_argument("--commit", help="of the programs (default: what git says of this folder)")
    return parser


def processor() -> str:
    """Return the name of the processor."""
    cpuinfo = Path("/proc/cpuinfo")
    if cpuinfo.exists():
        for line in cpuinfo.read_text(encoding="utf-8").splitlines():
            if line.startswith("model name"):
                return line.split(":", 1)[1].strip()
    return platform.processor() or platform.machine()


def adapter(arguments: argparse.Namespace) -> str | None:
    """Return the GPU for the runs; None without a GPU."""
    if arguments.no_gpu:
        return None
    done = subprocess.run(
        [str(arguments.bin / "particles"), "--list-adapters", "-q"], check=False, capture_output=True, text=True
    )
    found = [line for line in done.stdout.splitlines() if line]
    if arguments.adapter:
        found = [line for line in found if arguments.adapter.lower() in line.lower()]
    else:
        found = [line for line in found if "(software" not in line]
    return found[0] if found else None


def commit() -> str:
    """Return the current commit according to git."""
    done = subprocess.run(["git", "rev-parse", "--short=10", "HEAD"], check=False, capture_output=True, text=True)
    return done.stdout.strip() if done.returncode == 0 else "unknown"


def begin(arguments: argparse.Namespace, further: Row) -> tuple[Bench, Rows]:
    """Make the bench, and open the file of rows with a description of the machine."""
    arguments.json.parent.mkdir(parents=True, exist_ok=True)
    cores = arguments.jobs or os.cpu_count() or 1
    gpu = adapter(arguments)
    head = {
        "date": time.strftime("%Y-%m-%d", time.gmtime()),
        "commit": arguments.commit or commit(),
        "processor": processor(),
        "cores": cores,
        "adapter": gpu,
        "quick": arguments.quick,
        **further,
    }
    if gpu is None:
        print("no GPU: its rows are left out", file=sys.stderr)
    # Files in the work folder are reused. Each build, and each quick run of a build, therefore has
    # a folder of its own.
    work = arguments.work / (f"{head['commit']}-quick" if arguments.quick else str(head["commit"]))
    work.mkdir(parents=True, exist_ok=True)
    bench = Bench(arguments.bin, work, cores, time.monotonic() + arguments.time_limit)
    return bench, Rows.open(arguments.json, head)


def end(bench: Bench, rows: Rows) -> int:
    """Report the numbers of rows and of omitted tasks; return 1 if something was omitted."""
    print(f"{rows.path}: {len(rows.rows)} rows, {bench.left} left out", file=sys.stderr)
    return int(bench.left > 0)
