"""Kills the chain at random moments, runs it again, and compares what comes of it with an undisturbed run, byte by byte.

    tests/kills.py --count 100 --seed 1        # or: make bench-kills N=100

Each of the kills starts from nothing: a tiny phantom is meshed by `isoparticles-case`, as make does it. At a random moment of a random stage
(by the time that it took undisturbed) SIGKILL, SIGTERM or SIGINT goes to the program, to the stage that it runs, or to all of its processes
(as Ctrl-C and the end of a batch job do). Then the same command is called again, and has to end with 0. Every file is compared byte by byte,
but for those that tell of times: reports, status, page, the list of passes and the tetrahedralizer's log, which are compared without these.
No file may be left over. HXT makes the tetrahedra, because fTetWild's are not the same from run to run.
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
"""Endings of files that tell of times."""
PATIENCE = 120.0
"""How long processes may take to end after a signal, s: a stage has a minute for its last checkpoint, and is asked twice."""


def children_of(parent: int) -> list[int]:
    """Processes that this one has started."""
    try:
        return [int(word) for word in Path(f"/proc/{parent}/task/{parent}/children").read_text().split()]
    except (FileNotFoundError, ProcessLookupError):
        return []


def group_lives(group: int) -> bool:
    """Whether any process of a group runs still."""
    for path in Path("/proc").glob("[0-9]*/stat"):
        try:
            fields = path.read_text().rpartition(")")[2].split()
        except (FileNotFoundError, ProcessLookupError):
            continue
        if int(fields[2]) == group and fields[0] != "Z":
            return True
    return False


def send(process: subprocess.Popen[bytes], target: str, which: signal.Signals) -> None:
    """Give the signal to the program, to what it runs (to itself where it runs nothing), or to all."""
    try:
        if target == "all":
            os.killpg(process.pid, which)
        else:
            running = children_of(process.pid) if target == "stage" else []
            os.kill(running[0] if running else process.pid, which)
    except ProcessLookupError:
        pass


def stages_in(folder: Path) -> list[dict[str, object]]:
    """What the status says of the stages; none before there is one."""
    try:
        stages: list[dict[str, object]] = json.loads((folder / f"{NAME}.status.json").read_text())["stages"]
    except FileNotFoundError:
        return []
    return stages


def stage_now(folder: Path) -> str:
    """The stage that runs, by the status."""
    stages = stages_in(folder)
    running = [str(entry["stage"]) for entry in stages if entry["state"] == "running"]
    return running[0] if running else "between two" if stages else "before the first"


def wait_for_stage(process: subprocess.Popen[bytes], folder: Path, stage: str) -> None:
    """Wait until a stage runs, or is behind; the start is no stage, and not waited for."""
    while stage != "start" and process.poll() is None:
        if any(entry["stage"] == stage and entry["state"] in ("running", "done") for entry in stages_in(folder)):
            return
        time.sleep(0.002)


def contents(folder: Path) -> dict[str, object]:
    """What is in a folder: bytes, or, of files that tell of times, what does not change with them."""
    found: dict[str, object] = {}
    for path in sorted(folder.rglob("*")):
        if path.is_file():
            name = str(path.relative_to(folder))
            found[name] = told_by(path) if path.suffix in WITH_TIMES and "truth" not in name else path.read_bytes()
    return found


def told_by(path: Path) -> object:
    if path.suffix == ".csv":
        # a pass a line; the time of each stands in the column `seconds`
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
    """The command under test."""

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
    """Wait for a program and all that it started."""
    process.wait(PATIENCE)
    end = time.monotonic() + PATIENCE
    while group_lives(process.pid):
        if time.monotonic() > end:
            raise TimeoutError(f"processes of group {process.pid} run still after {PATIENCE:g} s")
        time.sleep(0.02)


def differences(one: dict[str, object], other: dict[str, object]) -> list[str]:
    """Names of files that are not in both, or not the same."""
    missing = [f"{name} is missing" for name in one if name not in other]
    added = [f"{name} is left over" for name in other if name not in one]
    return missing + added + [f"{name} differs" for name in one if name in other and one[name] != other[name]]


def undisturbed(chain: Chain) -> tuple[dict[str, object], dict[str, float]]:
    """What comes of it, and the time that each stage takes, s."""
    process = chain.start()
    wait_for(process)
    if process.returncode != 0:
        sys.exit(f"error: the undisturbed run ended with {process.returncode}\n{chain.log()}")
    seconds = {str(entry["stage"]): float(str(entry["seconds"])) for entry in stages_in(chain.folder)}
    return contents(chain.folder), {"start": 0.1, **seconds}


def kill_once(
    chain: Chain, moment: tuple[str, float], target: str, which: signal.Signals, wanted: dict[str, object]
) -> tuple[str, list[str]]:
    """One kill, so long after the start of a stage, and the run after it; the stage that it met, and what was wrong."""
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
    # what a killed program leaves running may still be there when the command is called again, as in life
    again = chain.start()
    wait_for(again)
    wrong = [] if again.returncode == 0 else [f"the run after it ended with {again.returncode}: {chain.log()[-2000:]}"]
    wait_for(process)
    return met, wrong + differences(wanted, contents(chain.folder))


def main() -> int:
    """Run the kills; 0 when every result was the same."""
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
