#!/usr/bin/env python3
"""Reproduce Tables 1 to 4 of the paper (section 6) with one CPU thread, all cores and the GPU.

    tests/results/paper.py --data ../shared/data [--bin target/release]    # or: make bench-paper
    tests/results/paper.py --tables 2 1 --time-limit 540    # a part of it; call again for the rest
    tests/results/paper.py --quick --no-gpu --json FILE     # fewer particles, only to try it out

All tables run with the printed parameters; Tables 1 and 2 also run with the defaults. Needs only
the stage programs and Python. Each run is a row of the JSON file, which is written immediately;
existing rows are not made again. `page.py` and `plots.py` make the page and its pictures. The
constants at the top of this file define the runs.
"""

from __future__ import annotations

import math
import os
import shutil
import sys
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from measured import SHRINK, Bench, Row, Rows, begin, end, options, ratios, settled

PACKING = 2.1
"""Ratio of the particles at the printed stop test to the vertices requested from sizefield.

Measured on the torso phantom's heart: 84,716 over 40,000. The lattice with the printed energy 3.462
has 2.3 times the particles of a lattice with edge h, but the run stops before it reaches this.
"""

TORSO = "torso --part"
OBJECTS = {
    "torso heart": (f"{TORSO} heart", "--iso 170", 80_000),
    "torso lungs": (f"{TORSO} lungs", "--iso -380 --inside below", 74_000),
    "torso ribcage": (f"{TORSO} ribs", "--iso 370", 469_000),
    "heart_label 1": ("heart_label.nrrd", "--labels 1", 80_000),
    "thorax_labels 2": ("thorax_labels.nrrd", "--labels 2", 74_000),
    "thorax_labels 1": ("thorax_labels.nrrd", "--labels 1", 469_000),
}
"""Organs of Table 2: volume, options of distfield, and approximate printed number of particles.

In `thorax_labels`, label 2 is the lungs and label 1 is bone.
"""

QUICK_OBJECTS = ["torso heart"]
QUICK_GRID = "--size 134,65,89 --spacing 2.6"
"""Grid for `--quick`, which runs only phantoms."""

RIBCAGE = "torso ribcage"
FINE = f"{TORSO} ribs --size 402,194,266 --spacing 0.8667"
"""The ribcage at 1.5 times the resolution of the paper's volume.

Marching cubes has fewer than 300,000 vertices on the volume of 268 x 129 x 177 voxels.
"""

SEEDS = range(60_000, 300_001, 30_000)
"""Numbers of seeds in Table 3."""
H_OF_TABLE_3 = 1.55
"""Edge length of Table 3, mm.

It deletes 24.2 % of 300,000 seeds; the paper has 25.0 %. At 1.4 mm it is 14 %, at 1.7 mm 37 %.
"""

SWEEP = [(8, 2, 4), (2, 1, 4), (0.5, 0.5, 4), (0.25, 0.25, 4), (0.125, 0.125, 4), (0.01, 0.01, 4), (0.01, 0.01, 7)]
"""Table 4: epsilon, delta, refinement level."""
LARGEST_H = 1.2
"""Maximum of h in Table 4, mm: fitted to the printed count of its first row."""
SMALLEST_H = {4: 0.965, 7: 0.93}
"""Minimum of h by refinement level, mm: fitted to the printed counts of the last two rows."""

MODES = {
    "as printed": ("--from marching-cubes", "--as-printed", "--method tight-cocone"),
    "defaults": ("", "", ""),
}
"""Options of seed, particles and reconstruct in each mode."""


@dataclass(frozen=True)
class Case:
    """A case whose particles are settled; each engine gives a row."""

    table: str
    name: str
    volume: str
    distfield: str
    sizefield: str
    mode: str
    seed: str = ""
    particles: str = ""

    @property
    def stem(self) -> str:
        """Return the stem of the case's file names."""
        return f"{self.table} {self.name} {self.mode}".replace(" ", "-").replace("/", "-")

    @property
    def field(self) -> str:
        """Return the stem of the distance field's files, which several cases share."""
        return f"{self.volume} {self.distfield}".replace(" ", "-").replace("/", "-").replace(",", "-")

    @property
    def options(self) -> Row:
        """Return the options of each stage for the row."""
        seed, particles, _ = MODES[self.mode]
        return {
            "volume": self.volume,
            "distfield": self.distfield,
            "sizefield": self.sizefield,
            "seed": f"{seed} {self.seed}".strip(),
            "particles": f"{particles} {self.particles}".strip(),
        }


def cases(tables: list[str], quick: bool) -> list[Case]:
    """Return all cases of these tables; a quick run has fewer and smaller cases."""
    shrink = SHRINK if quick else 1
    coarser = math.sqrt(shrink)
    found = []
    if "1" in tables or "2" in tables:
        for name, (volume, distfield, count) in OBJECTS.items():
            if quick and name not in QUICK_OBJECTS:
                continue
            for mode in MODES:
                vertices = count / shrink / (PACKING if mode == "as printed" else 1.0)
                sizes = f"--epsilon 0.5 --delta 0.4 --vertices {vertices:.0f}"
                found.append(Case("2", name, small(volume) if quick else volume, distfield, sizes, mode))
    if "3" in tables:
        for asked in SEEDS[::4] if quick else SEEDS:
            sizes = f"--uniform {H_OF_TABLE_3 * coarser:.4g}"
            seeds = f"--count {asked // shrink}"
            volume = small(f"{TORSO} ribs") if quick else FINE
            found.append(Case("3", f"{asked}", volume, "--iso 370", sizes, "as printed", seeds, "--no-insert"))
    if "4" in tables:
        volume, distfield, _ = OBJECTS[RIBCAGE]
        for epsilon, delta, level in SWEEP[::3] if quick else SWEEP:
            least, most = SMALLEST_H[level] * coarser, LARGEST_H * coarser
            sizes = (
                f"--epsilon {epsilon} --delta {delta} --min-size {least:.4g} --max-size {most:.4g} --max-deviation 0"
            )
            name = f"{epsilon}/{delta} level {level}"
            found.append(Case("4", name, small(volume) if quick else volume, distfield, sizes, "as printed"))
    return found


def small(volume: str) -> str:
    """Return a phantom on the coarse grid; return a file unchanged."""
    return f"{volume} {QUICK_GRID}" if volume.startswith(TORSO) else volume


@dataclass
class Paper:
    """One run of this program."""

    bench: Bench
    rows: Rows
    data: Path
    adapter: str
    gpu: bool
    keep: Path | None

    def path(self, name: str, ending: str) -> Path:
        """Return the path of a file in the work folder."""
        return self.bench.work / f"{name}.{ending}"

    def field(self, case: Case, threads: int) -> None:
        """Make the distance field of a case if it does not exist."""
        output = self.path(case.field, "distfield.vti")
        if output.exists():
            return
        volume = self.data / case.volume
        if case.volume.startswith(TORSO):
            volume = self.bench.phantom(case.volume, self.path(case.field, "nrrd"))
        self.bench.stage(
            "distfield", f"'{volume}' {case.distfield} -o '{output}'", self.path(case.field, "json"), threads
        )

    def seeds(self, case: Case, threads: int) -> None:
        """Make the size field and seeds of a case if they do not exist."""
        seeds, sizes = self.path(case.stem, "seeds.bin"), self.path(case.stem, "sizefield.vti")
        if seeds.exists():
            return
        field = self.path(case.field, "distfield.vti")
        report = self.path(case.stem, "sizefield.json")
        self.bench.stage("sizefield", f"'{field}' {case.sizefield} -o '{sizes}'", report, threads)
        report = self.path(case.stem, "seed.json")
        self.bench.stage("seed", f"'{field}' '{sizes}' {case.options['seed']} -o '{seeds}'", report, threads)

    def of(self, case: Case, name: str) -> str:
        """Return arguments with the files of a case."""
        fields = f"--distfield '{self.path(case.field, 'distfield.vti')}' --sizefield '{self.path(case.stem, 'sizefield.vti')}'"
        return f"'{name}' {fields}"

    def settle(self, case: Case, engine: str) -> Row:
        """Settle the seeds; return the report of `particles`."""
        backend = "--backend cpu"
        if engine == "gpu":
            backend = "--backend gpu" + (f" --adapter '{self.adapter}'" if self.adapter else "")
        output = self.path(f"{case.stem}.{engine}", "bin")
        words = f"{self.of(case, str(self.path(case.stem, 'seeds.bin')))} {case.options['particles']} {backend} -o '{output}'"
        threads = 1 if engine == "cpu-1" else self.bench.cores
        return self.bench.stage("particles", words, self.path(f"{case.stem}.{engine}", "json"), threads)

    def particles(self, case: Case, engine: str) -> None:
        """Make the row of a case for an engine."""
        self.seeds(case, self.bench.cores)
        seeded = self.bench.report(self.path(case.stem, "seed.json"))
        predicted = self.bench.report(self.path(case.stem, "sizefield.json"))["results"]["fields"]
        row: Row = {
            "table": case.table,
            "case": case.name,
            "mode": case.mode,
            "engine": engine,
            "options": case.options,
        }
        row["seeds"] = int(seeded["results"]["particles"])
        row["predicted"] = round(predicted["predicted_count"])
        row["h"] = [round(predicted["size_at_surface"][key], 3) for key in ("min", "median", "max")]
        self.rows.add(f"{case.stem} {engine}", {**row, **settled(self.settle(case, engine))})

    def surface(self, case: Case, engine: str, threads: int) -> None:
        """Make the row of a case's triangles, before and after reconstruct improves them."""
        name = f"{case.stem}.{engine}"
        if not self.path(name, "bin").exists():
            self.settle(case, engine)
        method = MODES[case.mode][2]
        words = f"{self.of(case, str(self.path(name, 'bin')))} {method} -o '{self.path(name, 'vtp')}'"
        report = self.bench.stage("reconstruct", words, self.path(name, "surface.json"), threads, allowed=(0, 1))
        results = report["results"]
        self.rows.add(
            f"1 {name}",
            {
                "table": "1", "case": case.name, "mode": case.mode, "engine": engine,
                "options": {**case.options, "reconstruct": method},
                "exit_code": report["exit_code"], "vertices": results["check"]["vertices"], "components": results["components"],
                "euler": results["topology"]["euler"],
                "raw": ratios(results["improve"]["before"]), "finished": ratios(results["check"]["quality"]),
                "seconds": round(report["seconds"], 2), "bytes": report.get("peak_memory_bytes"),
            },
        )  # fmt: skip
        if self.keep and case.name == "torso heart":
            self.keep.mkdir(parents=True, exist_ok=True)
            shutil.copy(self.path(name, "vtp"), self.keep / f"heart-{case.mode.replace(' ', '-')}-{engine}.vtp")

    def run(self, found: list[Case], tables: list[str], beside: int) -> None:
        """Make all missing rows.

        Timed runs on all cores or on the GPU run alone; runs on one thread run in parallel.
        """
        engines = ["cpu-all", "cpu-1", *(["gpu"] if self.gpu else [])]
        missing = [(case, engine) for case in found for engine in engines if f"{case.stem} {engine}" not in self.rows]
        if "2" not in tables:
            missing = [(case, engine) for case, engine in missing if case.table != "2"]
        surfaces: list[tuple[Case, str]] = []
        if "1" in tables:
            surfaces = [
                (case, engine) for case in found if case.table == "2" for engine in engines if engine != "cpu-1"
            ]
            surfaces = [(case, engine) for case, engine in surfaces if f"1 {case.stem}.{engine}" not in self.rows]
        wanted = list(dict.fromkeys(case for case, _ in [*missing, *surfaces]))
        fields = list({case.field: case for case in wanted}.values())
        some = max(self.bench.cores // 4, 1)
        few = min(self.bench.cores, 4)
        each = self.bench.each
        each(((f"field {case.field}", partial(self.field, case, few)) for case in fields), some)
        each(((f"seeds {case.stem}", partial(self.seeds, case, few)) for case in wanted), some)
        alone = [pair for pair in missing if pair[1] != "cpu-1"]
        each(named(alone, self.particles), 1)
        each(named([pair for pair in missing if pair[1] == "cpu-1"], self.particles), beside)
        each(named(surfaces, partial(self.surface, threads=few)), some)


def named(pairs: list[tuple[Case, str]], task: Callable[[Case, str], None]) -> list[tuple[str, Callable[[], None]]]:
    """Return tasks with their names."""
    return [(f"{case.stem} {engine}", partial(task, case, engine)) for case, engine in pairs]


def main() -> int:
    """Run the program; return 1 if rows were omitted."""
    parser = options(__doc__, "paper")
    parser.add_argument("--data", type=Path, default=Path("../shared/data"), help="folder of the real volumes")
    parser.add_argument("--tables", nargs="+", choices=["1", "2", "3", "4"], default=["2", "1", "3", "4"])
    parser.add_argument(
        "--cases", nargs="+", metavar="CASE", help=f"of Tables 1 and 2 these alone: {', '.join(OBJECTS)}"
    )
    parser.add_argument(
        "--beside", type=int, default=0, help="runs of one thread side by side (default: a quarter of the cores)"
    )
    parser.add_argument(
        "--keep", type=Path, metavar="FOLDER", help="copy the surfaces of the phantom's heart there, for close-ups"
    )
    arguments = parser.parse_args()
    arguments.jobs = arguments.jobs or os.cpu_count() or 1
    beside = arguments.beside or max(arguments.jobs // 4, 1)
    bench, rows = begin(arguments, {"beside": beside})
    found = cases(arguments.tables, arguments.quick)
    found = [case for case in found if case.table != "2" or not arguments.cases or case.name in arguments.cases]
    paper = Paper(
        bench, rows, arguments.data, arguments.adapter or "", rows.head["adapter"] is not None, arguments.keep
    )
    paper.run(found, arguments.tables, beside)
    return end(bench, rows)


if __name__ == "__main__":
    sys.exit(main())
