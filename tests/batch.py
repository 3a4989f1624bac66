"""Run a batch of phantoms, real volumes and broken rows, interrupt it, and run it again.

    tests/batch.py --data ../shared/data        # or: make bench-batch
    tests/batch.py --slurm                      # with `make cluster PROFILE=slurm` (tests/slurm.sh)

Writes the volumes and the list, and runs `isoparticles-case batch` as `make batch` does. Sends
SIGINT when a third of the rows is done, and runs the batch again. Checks the exit codes and the
summary: only the broken rows may fail, and each must report the error and what to do. Rows that
were done before the interrupt must not run again. On Slurm, `scancel` for all jobs replaces
SIGINT, and the same call continues with the other rows.
"""

from __future__ import annotations

import argparse
import csv
import getpass
import itertools
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

SHAPES = ("ball", "ellipsoid", "torus", "bumpy-torus", "thin-shell", "two-balls", "cylinder")
VARIANTS = (
    ["--size", "28"],
    ["--size", "28", "--kind", "label"],
    ["--size", "24,28,32"],
    ["--size", "28", "--rotate", "20,30,40"],
    ["--size", "28", "--left-handed"],
    ["--size", "28", "--spacing", "1,1,1.5"],
    ["--size", "28", "--noise", "10"],
    ["--size", "36", "--kind", "label", "--rotate", "10,0,60"],
)
REAL = (
    {"NAME": "mickey", "INPUT": "mickey_labels.nrrd", "LABELS": "2"},
    {"NAME": "mickey-coarse", "INPUT": "mickey_labels.nrrd", "LABELS": "2", "SIZE": "4"},
    {"NAME": "heart", "INPUT": "heart_label.nrrd", "LABELS": "1", "VERTICES": "2000"},
    {"NAME": "tooth", "INPUT": "tooth_ct.nrrd", "ISO": "600", "VERTICES": "2000"},
)
BROKEN = {
    "truncated": "the data is truncated",
    "absent": "not found",
    "empty": "no voxel crosses iso value",
    "no-such-label": "no voxel has the label 9",
    "no-volume": "does not start like a file with this ending",
}
"""Names of the broken rows, with words that the headline of each must contain."""
SLURM_OPTIONS = (
    "--slurm-status-command squeue --slurm-no-account --max-threads 1 --retries 0 "
    "--slurm-init-seconds-before-status-checks 3 --seconds-between-status-checks 3 "
    "--groups distfield=row sizefield=row seed=row particles=row reconstruct=row tetmesh_check=row"
)
"""Snakemake options for Slurm without accounting; one job per row (docs/user/batch.md)."""
COLUMNS = ("NAME", "INPUT", "ISO", "LABELS", "SIZE", "VERTICES")
SHARE_BEFORE = 1.0 / 3.0
"""Fraction of the rows that are done when the interrupt is sent."""


def phantoms(folder: Path, program: Path, count: int) -> list[dict[str, str]]:
    """Make the volumes, and return a row for each volume."""
    rows = []
    for number, (variant, shape) in enumerate(itertools.islice(itertools.product(VARIANTS, SHAPES), count)):
        path = folder / f"{shape}-{number:02}.nrrd"
        subprocess.run([program, shape, "-o", path, *variant, "--seed", str(number)], check=True)
        labels = "label" in variant
        # Two out of three rows have a constant edge length. In the others, h follows the local
        # feature size.
        row = {"NAME": path.stem, "INPUT": path.name, "LABELS" if labels else "ISO": "1" if labels else "100"}
        rows.append({**row, "SIZE": "2"} if number % 3 else row)
    return rows


def broken(folder: Path) -> list[dict[str, str]]:
    """Write broken volumes and return rows that must fail; one row has a missing file."""
    whole = (folder / "ball-00.nrrd").read_bytes()
    (folder / "truncated.nrrd").write_bytes(whole[: len(whole) // 2])
    (folder / "no-volume.nrrd").write_bytes(b"NAME,INPUT\nthis is a list and no volume\n")
    return [
        {"NAME": "truncated", "INPUT": "truncated.nrrd", "ISO": "100"},
        {"NAME": "absent", "INPUT": "absent.nrrd", "ISO": "100"},
        {"NAME": "empty", "INPUT": "ball-00.nrrd", "ISO": "5000"},
        {"NAME": "no-such-label", "INPUT": "ball-07.nrrd", "LABELS": "9"},
        {"NAME": "no-volume", "INPUT": "no-volume.nrrd", "ISO": "100"},
    ]


def write_list(path: Path, rows: list[dict[str, str]]) -> None:
    """Write the rows as a list of cases."""
    with path.open("w", newline="") as file:
        writer = csv.DictWriter(file, COLUMNS)
        writer.writeheader()
        writer.writerows(rows)


def summary(out: Path) -> list[dict[str, str]]:
    """Return the lines of batch.csv; empty before the first row is done."""
    try:
        with (out / "batch.csv").open(newline="") as file:
            return list(csv.DictReader(file))
    except FileNotFoundError:
        return []


def times(out: Path) -> dict[str, int]:
    """Return the modification time in ns of each case's surface."""
    return {path.parent.name: path.stat().st_mtime_ns for path in out.glob("*/*.surface.vtp")}


def faults(rows: list[dict[str, str]], found: list[dict[str, str]]) -> list[str]:
    """Return the differences between the summary and the expected result."""
    wrong = []
    if sorted(row["name"] for row in found) != sorted(row["NAME"] for row in rows):
        wrong.append(f"{len(found)} rows in batch.csv for {len(rows)} of the list")
    for row in found:
        fit = row["verdict"] in ("passed", "warning")
        if row["name"] in BROKEN and (fit or BROKEN[row["name"]] not in row["headline"] or not row["next"]):
            wrong.append(f"{row['name']}: {row['verdict']}, '{row['headline']}', '{row['next']}'")
        if row["name"] not in BROKEN and not fit:
            wrong.append(f"{row['name']} is {row['verdict']}: {row['headline']}")
    return wrong


def main() -> int:
    """Run the batch; return 0 if every check passes."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "--bin", metavar="DIR", type=Path, default=Path("target/release"), help="folder of the programs"
    )
    parser.add_argument("--tetmesh-check", metavar="PROGRAM", type=Path, default=Path(".venv/bin/tetmesh-check"))
    parser.add_argument("--data", metavar="DIR", type=Path, help="folder of real volumes; without it phantoms alone")
    parser.add_argument("--goal", default="surface", help="how far each case is made (default surface)")
    parser.add_argument("--phantoms", metavar="N", type=int, default=50, help="phantoms, 8 to 56 (default 50)")
    parser.add_argument("--slurm", action="store_true", help="make the rows by the jobs of a Slurm of its own")
    parser.add_argument("settings", metavar="KEY=VALUE", nargs="*", help="parameters of all rows")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="batch-") as name:
        folder, out = Path(name), Path(name) / "out"
        rows = phantoms(folder, arguments.bin / "phantom", arguments.phantoms)
        if arguments.data is not None:
            rows += [{**row, "INPUT": str((arguments.data / row["INPUT"]).resolve())} for row in REAL]
        for number, row in enumerate(broken(folder)):
            rows.insert(3 + 11 * number, row)
        write_list(folder / "cases.csv", rows)
        settings = [f"OUT={out}", "BACKEND=cpu", *arguments.settings]
        programs = {"BIN": arguments.bin.resolve(), "TETMESH_CHECK": arguments.tetmesh_check.absolute()}
        if arguments.slurm:
            words = [f"LIST={folder / 'cases.csv'}", f"GOAL={arguments.goal}", f"CLUSTER_OPTIONS={SLURM_OPTIONS}"]
            words += [f"{key}={value}" for key, value in programs.items()]
            return judge(["make", "cluster", "NO_BUILD=1", "PROFILE=slurm", *words, *settings], rows, out, True)
        command = [arguments.bin / "isoparticles-case", "batch", *settings, "--list", folder / "cases.csv"]
        command += ["--as-far-as", arguments.goal]
        command += ["--bin", programs["BIN"], "--tetmesh-check", programs["TETMESH_CHECK"]]
        return judge(command, rows, out, False)


def interrupt(first: subprocess.Popen[bytes], on_slurm: bool) -> None:
    """Interrupt the batch; on Slurm, cancel only its jobs."""
    if on_slurm:
        subprocess.run(["scancel", "--user", getpass.getuser()], check=True)
    else:
        first.send_signal(signal.SIGINT)
    first.wait(None if on_slurm else 150)


def judge(command: list[object], rows: list[dict[str, str]], out: Path, on_slurm: bool) -> int:
    """Run the batch twice and report the outcome."""
    wrong = []
    # make exits with 2 whenever a command fails.
    stopped, not_fit = (2, 2) if on_slurm else (130, 1)
    begun = time.monotonic()
    with (out.parent / "log").open("wb") as log:
        first = subprocess.Popen(list(map(str, command)), stdout=log, stderr=log, start_new_session=True)
        while first.poll() is None and max(len(summary(out)), len(times(out))) < SHARE_BEFORE * len(rows):
            time.sleep(0.05)
        interrupt(first, on_slurm)
    if first.returncode != stopped:
        wrong.append(f"the interrupted batch ended with {first.returncode}, not {stopped}")
    before, done = times(out), {row["name"] for row in summary(out) if row["verdict"] in ("passed", "warning")}
    print(
        f"interrupted, ended after {time.monotonic() - begun:.0f} s: {len(done)} of {len(rows)} rows done", flush=True
    )
    if len(done) == len(rows) - len(BROKEN):
        wrong.append("nothing was left for the second call")
    begun = time.monotonic()
    again = subprocess.run(list(map(str, command)), capture_output=True, text=True, check=False)
    if again.returncode != not_fit:
        wrong.append(f"the batch ended with {again.returncode}, not {not_fit}\n{again.stdout}{again.stderr}")
    found, after = summary(out), times(out)
    wrong += faults(rows, found)
    wrong += [f"{name} was made again" for name in sorted(done) if before[name] != after.get(name)]
    if not (out / "index.csv").exists():
        wrong.append("there is no index.csv")
    verdicts = [row["verdict"] for row in found]
    counts = ", ".join(f"{verdicts.count(word)} {word}" for word in sorted(set(verdicts)))
    print(f"called again, {time.monotonic() - begun:.0f} s: {counts}")
    for row in found:
        if row["verdict"] not in ("passed", "warning"):
            print(f"  {row['name']}: {row['verdict']}: {row['headline']}; {row['next']}")
    for line in wrong:
        print(f"wrong: {line}")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
