#!/usr/bin/env python3
"""Compares the triangle quality of settled particles between passes, backends or methods.

    quality.py passes CASE ... [--passes 5 10 ...] [--levels 1 3]  CSV: quality by number of passes
    quality.py backends CASE ... [--jobs N]      table: CPU and GPU with default parameters
    quality.py counts CASE ... [--jobs N]        table: predicted and settled counts
    quality.py surfaces CASE ... [--jobs N]      table: surfaces of both methods of reconstruct
    quality.py plot CSV PICTURE                  plot of the CSV (needs matplotlib)

CASE is NAME=VOLUME;DISTFIELD OPTIONS[;SIZEFIELD OPTIONS]. VOLUME is a file, or the arguments of
`phantom` that make one:
    torus="torus --size 128;--iso 100;--uniform 1.2"    heart="heart.nrrd;--labels 1"
@FILE inserts the lines of a file, except those that start with # (for example phantoms.txt,
volumes.txt and volumes-large.txt in this folder). $NAME inserts an environment variable.

The number of passes is the total over all levels. Density control is off in the last ten passes at
the finest level, and in the last three at each coarser level. "raw" refers to the Delaunay
triangles of the particles before improvement, "full" to the triangles improved by reconstruct. The
time is the device time on a GPU, and otherwise the time of the settling step.
"""

from __future__ import annotations

import argparse
import concurrent.futures
import csv
import hashlib
import json
import os
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

RAW = ["--relaxation-sweeps", "0", "--improve-below", "0"]


@dataclass
class Case:
    """A surface with its size field and seeds, the stage programs and the working folder."""

    name: str
    volume: str
    distfield: list[str]
    sizefield: list[str]
    programs: Path
    work: Path

    def file(self, ending: str) -> str:
        """Returns the path of the case's file with this suffix."""
        return str(self.work / f"{self.name}.{ending}")

    def run(self, program: str, *arguments: str, allowed: tuple[int, ...] = (0,)) -> dict[str, Any]:
        """Runs a stage and returns its report. Exits if the exit code is not in `allowed`."""
        report = self.file(f"{program}.json")
        command = [str(self.programs / program), *arguments, "--force", "-q", "--report", report]
        done = subprocess.run(command, check=False, stderr=subprocess.PIPE, text=True)
        if done.returncode not in allowed:
            sys.exit(f"{' '.join(command)}: exit code {done.returncode}\n{done.stderr}")
        with open(report, encoding="utf-8") as file:
            loaded: dict[str, Any] = json.load(file)
        return loaded

    def prepare(self) -> None:
        """Makes the fields and seeds if they do not exist."""
        if Path(self.file("seeds.bin")).exists():
            return
        volume = self.volume
        if not Path(volume).exists():
            volume = self.file("nrrd")
            subprocess.run([str(self.programs / "phantom"), *self.volume.split(), "-o", volume, "--force"], check=True)
        self.run("distfield", volume, *self.distfield, "-o", self.file("distfield.vti"))
        self.run("sizefield", self.file("distfield.vti"), *self.sizefield, "-o", self.file("sizefield.vti"))
        self.run("seed", self.file("distfield.vti"), self.file("sizefield.vti"), "-o", self.file("seeds.bin"))

    def settle(self, *options: str) -> dict[str, Any]:
        """Settles the seeds and returns counts, time, fraction of defects and the file hash."""
        report = self.run(
            "particles", self.file("seeds.bin"), "--distfield", self.file("distfield.vti"), "--sizefield",
            self.file("sizefield.vti"), "-o", self.file("bin"), "--log", self.file("csv"), *options,
        )  # fmt: skip
        results = report["results"]
        settling = next(step["seconds"] for step in report["steps"] if step["name"] == "settle")
        with open(self.file("csv"), encoding="utf-8") as file:
            last = list(csv.DictReader(file))[-1]
        with open(self.file("bin"), "rb") as particles:
            digest = hashlib.file_digest(particles, "sha256").hexdigest()
        return {
            "particles": int(last["count"]),
            "passes": int(last["pass"]),
            "seconds": results.get("device", {}).get("device_seconds", settling),
            "defects": int(last["lattice_defects"]) / int(last["count"]),
            "hash": digest,
        }

    def surface(self, *options: str) -> dict[str, Any]:
        """Runs `reconstruct` on the settled particles and returns its report."""
        return self.run(
            "reconstruct", self.file("bin"), "--distfield", self.file("distfield.vti"), "--sizefield",
            self.file("sizefield.vti"), "-o", self.file("vtp"), *options, allowed=(0, 1),
        )  # fmt: skip

    def quality(self, *options: str) -> tuple[float, float]:
        """Returns the mean and minimum radius ratio of the surface of the settled particles."""
        quality = self.surface(*options)["results"]["check"]["quality"]
        return quality["radius_ratio_mean"], quality["radius_ratio_min"]


def over_passes(cases: list[Case], arguments: argparse.Namespace) -> None:
    """Prints a CSV line for each combination of case, number of levels and number of passes."""
    writer = csv.writer(sys.stdout, lineterminator="\n")
    writer.writerow(["case", "levels", "passes", "particles", "seconds", "lattice defects", "mean", "smallest"])
    for case in cases:
        case.prepare()
        for levels in arguments.levels:
            runs = [["--max-passes", str(n), "--coarse-passes", str(n), "--energy-tolerance", "0"] for n in arguments.passes]
            for options in [*runs, []]:
                settled = case.settle("--backend", arguments.backend, "--levels", str(levels), *options)
                mean, smallest = case.quality(*RAW)
                passes = f"{settled['passes']}{'' if options else ' (stop test)'}"
                numbers = [f"{x:.4f}" for x in (settled["seconds"], settled["defects"], mean, smallest)]
                writer.writerow([case.name, levels, passes, settled["particles"], *numbers])
                sys.stdout.flush()


def compare(case: Case, backends: list[str], adapter: str | None, raw_only: bool) -> str:
    """Returns the table row of a case for `over_backends`."""
    case.prepare()
    counts, passes, defects, raw, full, notes = [], [], [], [], [], []
    for backend in backends:
        device = ["--adapter", adapter] if adapter and backend == "gpu" else []
        settled = case.settle("--backend", backend, *device)
        counts.append(f"{settled['particles']:,}")
        passes.append(str(settled["passes"]))
        defects.append(f"{100 * settled['defects']:.1f}")
        raw.append("{:.3f} / {:.2f}".format(*case.quality(*RAW)))
        full.append("-" if raw_only else "{:.3f} / {:.2f}".format(*case.quality()))
        if backend == "gpu":
            again = case.settle("--backend", backend, *device)
            notes.append("same bytes" if again["hash"] == settled["hash"] else "DIFFERENT BYTES")
    columns = [", ".join(column) for column in (counts, passes, defects, raw, full)]
    return f"| {case.name} | " + " | ".join([*columns, *notes]) + " |"


def over_backends(cases: list[Case], arguments: argparse.Namespace) -> None:
    """Prints a table that compares CPU and GPU, with one row per case."""
    backends = ["cpu"] if arguments.backend == "cpu" else ["cpu", "gpu"]
    again = " two GPU runs |" if "gpu" in backends else ""
    print(f"| surface | particles, {', '.join(backends)} | passes | lattice defects, % | raw, mean / smallest | full |{again}")
    print("|---" * (7 if again else 6) + "|")
    with concurrent.futures.ThreadPoolExecutor(arguments.jobs) as pool:
        rows = [pool.submit(compare, case, backends, arguments.adapter, arguments.raw_only) for case in cases]
        for row in concurrent.futures.as_completed(rows):
            print(row.result(), flush=True)


def counted(case: Case, backend: str) -> str:
    """Returns the table row of a case for `over_counts`."""
    case.prepare()
    with open(case.file("sizefield.json"), encoding="utf-8") as file:
        predicted = float(json.load(file)["results"]["fields"]["predicted_count"])
    settled = case.settle("--backend", backend)
    off = 100 * (predicted / settled["particles"] - 1)
    numbers = f"{predicted:,.0f} | {settled['particles']:,} | {off:+.1f}"
    return f"| {case.name} | {numbers} | {settled['passes']} | {100 * settled['defects']:.1f} |"


def over_counts(cases: list[Case], arguments: argparse.Namespace) -> None:
    """Prints a table of predicted and settled counts, with one row per case."""
    print("| surface | predicted | settled | off by, % | passes | lattice defects, % |\n" + "|---" * 6 + "|")
    with concurrent.futures.ThreadPoolExecutor(arguments.jobs) as pool:
        rows = [pool.submit(counted, case, arguments.backend) for case in cases]
        for row in concurrent.futures.as_completed(rows):
            print(row.result(), flush=True)


def surfaces(case: Case, backend: str) -> str:
    """Returns the two table rows of a case for `over_surfaces`."""
    case.prepare()
    case.settle("--backend", backend)
    rows = []
    for method in ("restricted", "tight-cocone"):
        report = case.surface("--method", method)
        results, refined = report["results"], report["results"]["refine"]
        checked, quality = results["check"], results["check"]["quality"]
        columns = [
            case.name,
            method,
            str(report["exit_code"]),
            f"{checked['vertices']:,}",
            results["components"],
            str(checked["regions"][0]["euler"]),
            f"{quality['radius_ratio_mean']:.3f} / {quality['radius_ratio_min']:.3f}",
            f"{quality['angle_min']:.1f} to {quality['angle_max']:.1f}",
            f"{sum(refined['inserted'].values()):,}, {refined['rounds']}",
            str(checked["nodes_on_wrong_side"]) if "--labels" in case.distfield else "scalar",
            f"{report['seconds']:.1f}",
        ]
        rows.append("| " + " | ".join(columns) + " |")
    return "\n".join(rows)


def over_surfaces(cases: list[Case], arguments: argparse.Namespace) -> None:
    """Prints a table with two rows per case, one for each method of `reconstruct`."""
    print(
        "| surface | method | exit code | vertices | components | Euler characteristic | radius ratio, mean / smallest | angles, degrees"
        " | points added, rounds | grid nodes on the wrong side | s |\n" + "|---" * 11 + "|"
    )
    with concurrent.futures.ThreadPoolExecutor(arguments.jobs) as pool:
        rows = [pool.submit(surfaces, case, arguments.backend) for case in cases]
        for row in concurrent.futures.as_completed(rows):
            print(row.result(), flush=True)


def plot(table: Path, picture: Path) -> None:
    """Plots mean and minimum radius ratio against time, with one column of plots per case."""
    import matplotlib.pyplot as plt
    from matplotlib import ticker

    with open(table, encoding="utf-8") as file:
        rows = [row for row in csv.DictReader(file) if "stop" not in row["passes"]]
    names = list(dict.fromkeys(row["case"] for row in rows))
    figure, axes = plt.subplots(2, len(names), figsize=(3.6 * len(names), 6), squeeze=False, sharey="row", layout="constrained")
    for column, name in enumerate(names):
        for levels, marker in zip(dict.fromkeys(row["levels"] for row in rows), "os^v", strict=False):
            own = [row for row in rows if row["case"] == name and row["levels"] == levels]
            seconds = [1e3 * float(row["seconds"]) for row in own]
            label = "at h at once" if levels == "1" else f"coarse to fine, {levels} levels"
            for line, key in enumerate(("mean", "smallest")):
                axes[line][column].plot(seconds, [float(row[key]) for row in own], marker=marker, label=label)
            for x, row in zip(seconds, own, strict=True):
                axes[0][column].annotate(
                    row["passes"], (x, float(row["mean"])), fontsize=6, xytext=(2, -8), textcoords="offset points"
                )
        axes[0][column].set_title(f"{name}, {int(own[-1]['particles']):,} particles", fontsize=10)
        axes[1][column].set_xlabel("time, ms")
        for line in range(2):
            axes[line][column].set_xscale("log")
            axes[line][column].xaxis.set_major_locator(ticker.LogLocator(subs=[1, 2, 5]))
            axes[line][column].xaxis.set_major_formatter(ticker.ScalarFormatter())
            axes[line][column].xaxis.set_minor_formatter(ticker.NullFormatter())
            axes[line][column].grid(alpha=0.3, which="both")
    axes[0][0].set_ylabel("radius ratio, mean (passes in small)")
    axes[1][0].set_ylabel("radius ratio, smallest")
    axes[0][0].legend(fontsize=8, loc="lower right")
    figure.savefig(picture, dpi=130)


def main() -> None:
    """Parses the command line and runs the task."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter, fromfile_prefix_chars="@"
    )
    parser.add_argument("task", choices=["passes", "backends", "counts", "surfaces", "plot"])
    parser.add_argument("cases", nargs="+", metavar="CASE")
    parser.add_argument("--bin", type=Path, default=Path("target/release"), help="folder of the stage programs")
    parser.add_argument("--work", type=Path, default=Path("out/quality"), help="folder for the files")
    parser.add_argument("--backend", choices=["auto", "gpu", "cpu"], default="auto")
    parser.add_argument("--passes", type=int, nargs="+", default=[5, 10, 20, 40, 80, 160])
    parser.add_argument("--levels", type=int, nargs="+", default=[1, 3])
    parser.add_argument("--adapter", help="part of the GPU's name; a software renderer must be named")
    parser.add_argument("--raw-only", action="store_true", help="leave out the improved triangles")
    parser.add_argument("--default-sizes", action="store_true", help="leave out the size field options of the cases")
    parser.add_argument("--jobs", type=int, default=1, help="cases at once")
    arguments = parser.parse_intermixed_args()
    if arguments.task == "plot":
        plot(Path(arguments.cases[0]), Path(arguments.cases[1]))
        return
    arguments.work.mkdir(parents=True, exist_ok=True)
    cases = []
    # skip the comment lines of case files
    for text in (text for text in arguments.cases if not text.startswith("#")):
        name, _, rest = text.partition("=")
        volume, distfield, sizefield = [*os.path.expandvars(rest).split(";"), ""][:3]
        sizefield = "" if arguments.default_sizes else sizefield
        cases.append(Case(name, volume, distfield.split(), sizefield.split(), arguments.bin, arguments.work))
    tasks = {"passes": over_passes, "backends": over_backends, "counts": over_counts, "surfaces": over_surfaces}
    tasks[arguments.task](cases, arguments)


if __name__ == "__main__":
    main()
