#!/usr/bin/env python3
"""Measure how time and memory of every stage grow with voxels, particles, cores and materials.

    tests/results/growth.py [--bin target/release]                       # or: make bench-growth
    tests/results/growth.py --series cores materials --time-limit 540    # a part of it

Needs only the stage programs and Python. A row of the JSON file contains the seconds and the peak
memory of one stage at one size of a series. The sizes of a series run in ascending order. A stage
whose extrapolated time exceeds `--longest` is omitted at this and all larger sizes, and a row
records this. Another call continues after the existing rows. `page.py` fits the exponents.
"""

from __future__ import annotations

import json
import math
import random
import sys
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

from measured import SHRINK, Bench, Row, Rows, begin, end, options, settled, stage_row

VOLUMES = [64, 96, 128, 192, 256, 384, 512]
"""Numbers of voxels along an edge; the torus is the same and has about PARTICLES particles."""
EDGE = 128.0
"""Edge length of the volumes, mm."""
PARTICLES = 50_000
COUNTS = [10_000, 30_000, 100_000, 300_000, 1_000_000, 2_000_000, 5_000_000]
"""Numbers of particles on the bumpy torus of 128 x 128 x 128 voxels."""
MATERIALS = [1, 3, 10, 30, 100]
"""Numbers of Voronoi cells in the ball."""
CELLS_EDGE = 96
"""Number of voxels of 1 mm along an edge of the volume with several materials."""
CELLS_H = 1.5
"""Edge length on the interfaces of the materials, mm."""
TORUS = "bumpy-torus"
SERIES = ("volume", "particles", "cores", "materials")
STAGES = ("distfield", "sizefield", "seed", "particles", "reconstruct")


def value(line: tuple[float, float, int], x: float) -> float:
    """Return the value of a line (slope, offset, label) at x."""
    return line[0] * x + line[1]


def cells(materials: int, edge: int) -> bytes:
    """Return an NRRD file of a ball that is divided into the Voronoi cells of random points.

    The labels are 1 to `materials`, and 0 outside. Along a row of voxels, the squared distance to a
    point is x^2 + a x + b, where a and b depend on the point. The nearest points are thus the lower
    envelope of lines.
    """
    numbers = random.Random(materials)
    centre, radius = (edge - 1) / 2, 0.42 * edge

    def inside() -> tuple[float, ...]:
        while True:
            point = tuple(numbers.uniform(-radius, radius) for _ in range(3))
            if math.hypot(*point) < 0.95 * radius:
                return tuple(c + centre for c in point)

    points: list[tuple[float, ...]] = []
    for _ in range(materials):  # the candidate farthest from the other points, of twenty
        candidates = [inside() for _ in range(20)]
        points.append(max(candidates, key=lambda c: min((math.dist(c, p) for p in points), default=0.0)))
    order = sorted(range(materials), key=lambda i: points[i][0])
    voxels = bytearray(edge**3)
    for z in range(edge):
        for y in range(edge):
            half = radius**2 - (y - centre) ** 2 - (z - centre) ** 2
            if half <= 0.0:
                continue
            envelope: list[tuple[float, float, int]] = []  # slope, offset, label; descending slopes
            for i in order:
                px, py, pz = points[i]
                slope, offset = -2.0 * px, px * px + (y - py) ** 2 + (z - pz) ** 2
                while len(envelope) > 1:
                    (s1, o1, _), (s2, o2, _) = envelope[-2:]
                    if (offset - o1) * (s1 - s2) > (o2 - o1) * (s1 - slope):
                        break
                    envelope.pop()
                envelope.append((slope, offset, i + 1))
            first, last = math.ceil(centre - math.sqrt(half)), math.floor(centre + math.sqrt(half))
            row, at = (z * edge + y) * edge, 0
            for x in range(first, last + 1):
                while at + 1 < len(envelope) and value(envelope[at + 1], x) < value(envelope[at], x):
                    at += 1
                voxels[row + x] = envelope[at][2]
    header = f"NRRD0004\ntype: uint8\ndimension: 3\nsizes: {edge} {edge} {edge}\nspacings: 1 1 1\nencoding: raw\n\n"
    return header.encode() + bytes(voxels)


@dataclass
class Growth:
    """One run of this program."""

    bench: Bench
    rows: Rows
    gpu: str | None
    longest: float
    shrink: int = 1
    last: dict[tuple[str, str], tuple[float, float]] = field(default_factory=dict)

    def step(
        self, series: str, size: float, stage: str, words: str, output: Path, threads: int = 0, engine: str = ""
    ) -> bool:
        """Run a stage at a size of a series; return whether its output exists."""
        name = f"{series} {size:09.0f} {stage}{engine and ' ' + engine}"
        if name in self.rows and output.exists():
            self.last[series, stage + engine] = (size, self.rows.rows[name].get("seconds", 0.0))
            return True
        before, seconds = self.last.get((series, stage + engine), (size, 0.0))
        row: Row = {"series": series, "size": size, "stage": stage, "engine": engine, "options": shorten(words)}
        if series != "cores" and seconds * size / before > self.longest:
            self.rows.add(name, {**row, "left_out": f"more than {self.longest:.0f} s expected"})
            return False
        report = self.bench.stage(
            stage,
            f"{words} -o '{output}'",
            output.with_suffix(f".{stage}.json"),
            threads or self.bench.cores,
            allowed=(0, 1),
        )
        told = {**row, **stage_row(report), "exit_code": report["exit_code"]}
        if stage == "particles":
            told.update(settled(report))
        self.rows.add(name, told)
        self.last[series, stage + engine] = (size, report["seconds"])
        print(f"  {name}: {report['seconds']:.1f} s", file=sys.stderr, flush=True)
        return True

    def complete(self, series: str, size: float) -> bool:
        """Return whether all rows of a size exist, up to the last stage or an omitted stage.

        Also records the seconds of the rows for later predictions.
        """
        own = [row for row in self.rows.rows.values() if (row["series"], row["size"]) == (series, size)]
        for row in own:
            if "seconds" in row:
                self.last[series, row["stage"] + row["engine"]] = (size, row["seconds"])
        return any(row["stage"] == "reconstruct" or ("left_out" in row and row["engine"] != "gpu") for row in own)

    def after_sizes(self, series: str, size: float, stem: Path, fields: tuple[Path, Path], threads: int = 0) -> None:
        """Run seed, particles and reconstruct."""
        distance, sizes = fields
        seeds, settled_to, surface = (stem.with_suffix(f".{end}") for end in ("seeds.bin", "particles.bin", "vtp"))
        both = f"--distfield '{distance}' --sizefield '{sizes}'"
        if not self.step(series, size, "seed", f"'{distance}' '{sizes}'", seeds, threads):
            return
        found = None
        if self.gpu is not None and series != "cores":
            backend = f"--backend gpu{self.gpu and f' --adapter {self.gpu!r}'}"
            of_gpu = stem.with_suffix(".gpu.bin")
            if self.step(series, size, "particles", f"'{seeds}' {both} {backend}", of_gpu, threads, "gpu"):
                found = of_gpu
        if self.step(series, size, "particles", f"'{seeds}' {both} --backend cpu", settled_to, threads, "cpu"):
            found = settled_to
        if found is not None:
            self.step(series, size, "reconstruct", f"'{found}' {both}", surface, threads)

    def chain(self, series: str, size: float, volume: Path, words: tuple[str, str], threads: int = 0) -> None:
        """Run all stages on a volume, unless all rows exist."""
        if self.complete(series, size):
            return
        stem = self.bench.work / f"{series}-{size:.0f}"
        distance, sizes = stem.with_suffix(".distfield.vti"), stem.with_suffix(".sizefield.vti")
        if not self.step(series, size, "distfield", f"'{volume}' {words[0]}", distance, threads):
            return
        if self.step(series, size, "sizefield", f"'{distance}' {words[1]}", sizes, threads):
            self.after_sizes(series, size, stem, (distance, sizes), threads)
        for path in self.bench.work.glob(f"{stem.name}.*"):
            path.unlink()

    def torus(self, edge: int) -> tuple[Path, float]:
        """Make the volume of a bumpy torus; return its path and the area of the surface in mm^2."""
        path = self.bench.work / f"torus-{edge}.nrrd"
        truth = path.with_suffix(".json")
        self.bench.phantom(f"{TORUS} --size {edge} --spacing {EDGE / edge} --raw --truth '{truth}'", path)
        area: float = json.loads(truth.read_text(encoding="utf-8"))["area"]
        return path, area

    def volume(self, edge: int) -> None:
        """Measure the same object on a grid with this edge."""
        path, area = self.torus(edge)
        self.chain("volume", edge**3, path, ("--iso 100", f"--uniform {of_count(area, PARTICLES // self.shrink):.4g}"))
        path.unlink()

    def particles(self, count: int) -> None:
        """Measure this number of particles on the same object."""
        path, area = self.torus(64 if self.shrink > 1 else 128)
        self.chain("particles", count, path, ("--iso 100", f"--uniform {of_count(area, count // self.shrink):.4g}"))

    def cores(self, threads: int) -> None:
        """Measure the torso phantom's ribcage with this number of threads."""
        path = self.bench.phantom("torso --part ribs", self.bench.work / "ribs.nrrd")
        sizes = f"--scale {self.shrink**0.5:.4g}"
        self.chain("cores", threads, path, ("--iso 370", sizes), threads)

    def materials(self, count: int) -> None:
        """Measure this number of materials in the same ball."""
        path = self.bench.work / f"cells-{count}.nrrd"
        path.write_bytes(cells(count, CELLS_EDGE // 2 if self.shrink > 1 else CELLS_EDGE))
        self.chain("materials", count, path, ("--material all", f"--uniform {CELLS_H * self.shrink**0.25:.4g}"))


def of_count(area: float, count: int) -> float:
    """Return the spacing of a hexagonal lattice with this many particles on an area."""
    return math.sqrt(2.0 * area / (math.sqrt(3.0) * count))


def shorten(words: str) -> str:
    """Return the options with file names instead of paths."""
    return " ".join(f"'{Path(word.strip(chr(39))).name}'" if "/" in word else word for word in words.split(" "))


def main() -> int:
    """Run the program; return 1 if something was omitted."""
    parser = options(__doc__, "growth")
    parser.add_argument("--series", nargs="+", choices=SERIES, default=SERIES)
    parser.add_argument(
        "--longest", type=float, default=60.0, metavar="SECONDS", help="a stage expected to take longer is left out"
    )
    arguments = parser.parse_args()
    bench, rows = begin(arguments, {})
    gpu = None if rows.head["adapter"] is None else arguments.adapter or ""
    growth = Growth(bench, rows, gpu, arguments.longest, SHRINK if arguments.quick else 1)
    threads = sorted({*(2**i for i in range(8) if 2**i <= bench.cores), bench.cores})
    tasks = {
        "volume": [(size, partial(growth.volume, size)) for size in VOLUMES],
        "particles": [(size, partial(growth.particles, size)) for size in COUNTS],
        "cores": [(size, partial(growth.cores, size)) for size in threads],
        "materials": [(size, partial(growth.materials, size)) for size in MATERIALS],
    }
    for series in arguments.series:
        chosen = tasks[series][:3] if arguments.quick else tasks[series]
        bench.each(((f"{series} {size}", task) for size, task in chosen), 1)
    return end(bench, rows)


if __name__ == "__main__":
    sys.exit(main())
