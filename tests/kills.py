"""Kill the chain at random moments, run it again, and compare with an undisturbed run.

    tests/kills.py --count 100 --seed 1        # or: make bench-kills N=100

Each kill starts from an empty folder: `isoparticles-case` meshes a tiny phantom, as make does.
SIGKILL, SIGTERM or SIGINT is sent at a random moment of a random stage, within the time that the
stage takes undisturbed. The signal goes to the program, to the stage that it runs, or to all of its
processes (like Ctrl-C or the end of a batch job). Then the same command runs again and must end
with 0.

All files are compared byte by byte. Files that contain times (reports, status, page, list of
passes, the tetrahedralizer's log) are compared without them. No file may be left over. HXT makes
the tetrahedra, because fTetWild's differ from run to run.
"""

from __future__ import annotations

import argparse
import collections
import json
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

NAME = "tiny"
CASE = [
    f"NAME={NAME}",
    "PHANTOM=ball --size 20",
    "ISO=0",
    "SIZE=2.5",
    "BACKEND=cpu",
    "TETMESH_OPTIONS=--method hxt --solve no",
    "VERBOSITY=-q",
]
SIGNALS = (signal.SIGKILL, signal.SIGTERM, signal.SIGINT)
TARGETS = ("program", "stage", "all")
WITH_TIMES = (".json", ".html", ".log", ".csv")
"""Endings of files that contain times."""
PATIENCE = 120.0
"""Maximum time in seconds for processes to end after a signal.

A stage is interrupted twice, and gets a minute each time for its last checkpoint.
"""


def children_of(parent: int) -> list[int]:
    """Return the child processes of a process."""
    try:
        return [int(word) for word in Path(f"/proc/{parent}/task/{parent}/children").read_text().split()]
    except (FileNotFoundError, ProcessLookupError):
        return []


def group_lives(group: int) -> bool:
    """Return whether any process of a group is still running."""
    for path in Path("/proc").glob("[0-9]*/stat"):
        try:
            fields = path.read_text().rpartition(")")[2].split()
        except (FileNotFoundError, ProcessLookupError):
            continue
        if int(fields[2]) == group and fields[0] != "Z":
            return True
    return False


def send(process: subprocess.Popen[bytes], target: str, which: signal.Signals) -> None:
    """Send the signal to the program, to the stage that it runs (if any), or to all processes."""
    try:
        if target == "all":
            os.killpg(process.pid, which)
        else:
            running = children_of(process.pid) if target == "stage" else []
            os.kill(running[0] if running else process.pid, which)
    except ProcessLookupError:
        pass


def stages_in(folder: Path) -> list[dict[str, object]]:
    """Return the stages in the status file; empty if the file does not exist yet."""
    try:
        stages: list[dict[str, object]] = json.loads((folder / f"{NAME}.status.json").read_text())["stages"]
    except FileNotFoundError:
        return []
    return stages


def stage_now(folder: Path) -> str:
    """Return the running stage according to the status file."""
    stages = stages_in(folder)
    running = [str(entry["stage"]) for entry in stages if entry["state"] == "running"]
    return running[0] if running else "between two" if stages else "before the first"


def wait_for_stage(process: subprocess.Popen[bytes], folder: Path, stage: str) -> None:
    """Wait until a stage is running or done; return at once for `start`, which is not a stage."""
    while stage != "start" and process.poll() is None:
        if any(entry["stage"] == stage and entry["state"] in ("running", "done") for entry in stages_in(folder)):
            return
        time.sleep(0.002)


def contents(folder: Path) -> dict[str, object]:
    """Return the content of each file of a folder, without the parts that depend on time."""
    found: dict[str, object] = {}
    for path in sorted(folder.rglob("*")):
        if path.is_file():
            name = str(path.relative_to(folder))
            found[name] = told_by(path) if path.suffix in WITH_TIMES and "truth" not in name else path.read_bytes()
    return found


def told_by(path: Path) -> object:
    if path.suffix == ".csv":
        # One line per pass, without the column `seconds`.
        head, *rows = (line.split(",") for line in path.read_text().splitlines())
        return [[word for name, word in zip(head, row, strict=True) if name != "seconds"] for row in rows]
    if path.suffix != ".json":
        return path.stat().st_size > 0
    document = json.loads(path.read_text())
    if "stages" in document:
        stages = [(entry["stage"], entry["state"], entry["outputs"], entry["key"]) for entry in document["stages"]]
        return document["verdict"], document["parameters"], stages
    return document["outcome"], document["failed_checks"], document["warnings"], document["parameters"]


class Chain:
    """Command under test."""

    def __init__(self, arguments: argparse.Namespace, work: Path) -> None:
        self.work = work
        self.folder = work / NAME
        self.command = [
            arguments.bin / "isoparticles-case",
            "mesh",
            *CASE,
            f"OUT={work}",
            f"THREADS={arguments.threads}",
        ]
        self.command += ["--bin", arguments.bin, "--tetmesh-check", arguments.tetmesh_check]

    def start(self) -> subprocess.Popen[bytes]:
        with (self.work / "log").open("wb") as log:
            return subprocess.Popen(self.command, stdout=log, stderr=log, start_new_session=True)

    def log(self) -> str:
        return (self.work / "log").read_text(errors="replace")


def wait_for(process: subprocess.Popen[bytes]) -> None:
    """Wait for a program and all processes that it started."""
    process.wait(PATIENCE)
    end = time.monotonic() + PATIENCE
    while group_lives(process.pid):
        if time.monotonic() > end:
            raise TimeoutError(f"processes of group {process.pid} run still after {PATIENCE:g} s")
        time.sleep(0.02)


def differences(one: dict[str, object], other: dict[str, object]) -> list[str]:
    """Return messages about files that are missing, left over or different."""
    missing = [f"{name} is missing" for name in one if name not in other]
    added = [f"{name} is left over" for name in other if name not in one]
    return missing + added + [f"{name} differs" for name in one if name in other and one[name] != other[name]]


def undisturbed(chain: Chain) -> tuple[dict[str, object], dict[str, float]]:
    """Return the files of an undisturbed run, and the seconds of each stage."""
    process = chain.start()
    wait_for(process)
    if process.returncode != 0:
        sys.exit(f"error: the undisturbed run ended with {process.returncode}\n{chain.log()}")
    seconds = {str(entry["stage"]): float(str(entry["seconds"])) for entry in stages_in(chain.folder)}
    return contents(chain.folder), {"start": 0.1, **seconds}


def kill_once(
    chain: Chain, moment: tuple[str, float], target: str, which: signal.Signals, wanted: dict[str, object]
) -> tuple[str, list[str]]:
    """Kill a run at a delay after the start of a stage, and run it again.

    Returns the stage that received the signal, and a list of problems.
    """
    shutil.rmtree(chain.folder, ignore_errors=True)
    process = chain.start()
    stage, delay = moment
    wait_for_stage(process, chain.folder, stage)
    try:
        process.wait(delay)
        met = "after the last"
    except subprocess.TimeoutExpired:
        met = stage_now(chain.folder)
        send(process, target, which)
    process.wait(PATIENCE)
    # The next run starts at once, even if child processes of the killed program are still running.
    again = chain.start()
    wait_for(again)
    wrong = [] if again.returncode == 0 else [f"the run after it ended with {again.returncode}: {chain.log()[-2000:]}"]
    wait_for(process)
    return met, wrong + differences(wanted, contents(chain.folder))


def main() -> int:
    """Run the kills; return 0 if every result is the same."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", metavar="N", type=int, default=100, help="kills (default 100)")
    parser.add_argument("--seed", metavar="N", type=int, default=1, help="of moments, signals and targets (default 1)")
    parser.add_argument(
        "--bin", metavar="DIR", type=Path, default=Path("target/release"), help="folder of the programs"
    )
    parser.add_argument("--tetmesh-check", metavar="PROGRAM", type=Path, default=Path(".venv/bin/tetmesh-check"))
    parser.add_argument("--threads", metavar="N", type=int, default=2, help="CPU threads of each stage (default 2)")
    arguments = parser.parse_args()
    chance = random.Random(arguments.seed)
    met: collections.Counter[str] = collections.Counter()
    failures = 0
    with tempfile.TemporaryDirectory(prefix="kills-") as folder:
        chain = Chain(arguments, Path(folder))
        wanted, seconds = undisturbed(chain)
        print(f"undisturbed: {sum(seconds.values()):.1f} s, {len(wanted)} files", flush=True)
        for number in range(1, arguments.count + 1):
            stage = chance.choice(list(seconds))
            delay, target, which = chance.uniform(0.0, seconds[stage]), chance.choice(TARGETS), chance.choice(SIGNALS)
            stage, wrong = kill_once(chain, (stage, delay), target, which, wanted)
            met[stage] += 1
            failures += bool(wrong)
            words = f"{number}: {which.name} to {target} in {stage}, {delay:.2f} s on"
            print(f"{words}: {'; '.join(wrong) if wrong else 'the same'}", flush=True)
    print(
        f"{arguments.count} kills, {arguments.count - failures} results the same; "
        + ", ".join(f"{k}: {n}" for k, n in met.most_common())
    )
    return 1 if failures else 0


if __name__ == "__main__":
    sys.exit(main())
