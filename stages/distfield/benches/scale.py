"""Meshes of a few sizes from one volume: what `--scale-for-vertices` and `--vertices` make of it.

    scale.py @solid.txt @thin.txt [--vertices 1000 5000 20000 75000] [--backend gpu] [--no-distances]

CASE is NAME=VOLUME;DISTFIELD OPTIONS[;SIZEFIELD OPTIONS]; @FILE stands for the lines of a file but for those that start with #
(solid.txt and thin.txt beside this program); $NAME for a variable of the environment (DATA: the folder of the real volumes). Run
it with the Python of `make env`; without distances any Python 3.11 does.

Each row is one run from the volume to the checked surface. The distance is that of the vertices and centroids of the mesh from
the surface at scale 0, which keeps every voxel centre on its side: mean, 99th percentile and largest, in mm. "Lost" is how far
that surface lies from the smoothed one, the 99th percentile and largest: what is gone is far from what is left. Volume is that of
the mesh against that of the voxels.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import numpy as np
    import pyvista as pv


class RefusedError(Exception):
    """A stage made nothing, and said why."""


@dataclass
class Case:
    """A surface in a volume, and the folder and programs to work with."""

    name: str
    volume: str
    distfield: list[str]
    sizefield: list[str]
    programs: Path
    work: Path
    backend: str
    distances: bool

    def run(self, key: str, program: str, *arguments: str) -> tuple[int, dict[str, Any]]:
        """Runs a stage; returns its exit code and report."""
        report = self.work / f"{self.name}.{key}.{program}.json"
        command = [str(self.programs / program), *arguments, "--force", "-q", "--report", str(report)]
        done = subprocess.run(command, check=False, stderr=subprocess.PIPE, text=True)
        if done.returncode not in (0, 1):
            raise RefusedError(f"{program}: {done.stderr.strip().splitlines()[0]}")
        return done.returncode, json.loads(report.read_text(encoding="utf-8"))

    def file(self, key: str, ending: str) -> str:
        """Path of a file of a run."""
        return str(self.work / f"{self.name}.{key}.{ending}")

    def exact(self) -> pv.ImageData:
        """Distance field at scale 0."""
        path = self.file("exact", "distfield.vti")
        if not Path(path).exists():
            self.run("exact", "distfield", self.volume, *self.distfield, "-o", path)
        import pyvista as pv

        return pv.read(path)


def sample(field: pv.ImageData, points: np.ndarray) -> np.ndarray:
    """Trilinear values of a distance field at points in the world."""
    import numpy as np
    from scipy.ndimage import map_coordinates

    directions = np.array(field.direction_matrix)
    index = (points - np.array(field.origin)) @ np.linalg.inv(directions).T / np.array(field.spacing)
    values = np.asarray(field["signed_distance"]).reshape(field.dimensions[::-1])
    return map_coordinates(values, index[:, ::-1].T, order=1, mode="nearest")


def exact_surface(field: pv.ImageData) -> np.ndarray:
    """Vertices of the zero set of a distance field, in the world."""
    import numpy as np

    contour = field.contour([0.0], scalars="signed_distance")
    return np.asarray(contour.points)


def distances(case: Case, surface: str, distfield: str) -> tuple[str, str]:
    """How far a mesh lies from the surface at scale 0, and that from the smoothed one, mm."""
    import numpy as np
    import pyvista as pv

    exact, mesh = case.exact(), pv.read(surface)
    points = np.concatenate([np.asarray(mesh.points), np.asarray(mesh.cell_centers().points)])
    away = np.abs(sample(exact, points))
    lost = np.abs(sample(pv.read(distfield), exact_surface(exact)))
    told = f"{np.mean(away):.2f}, {np.quantile(away, 0.99):.2f}, {np.max(away):.2f}"
    return told, f"{np.quantile(lost, 0.99):.2f}, {np.max(lost):.2f}"


def row(case: Case, vertices: int) -> str:
    """One row of the table."""
    key = str(vertices)
    distfield, sizefield, seeds = (case.file(key, f"{e}") for e in ("distfield.vti", "sizefield.vti", "seeds.bin"))
    particles, surface = case.file(key, "particles.bin"), case.file(key, "surface.vtp")
    start = time.monotonic()
    reports = [
        case.run(key, "distfield", case.volume, *case.distfield, "--scale-for-vertices", key, "-o", distfield),
        case.run(key, "sizefield", distfield, "--vertices", key, *case.sizefield, "-o", sizefield),
        case.run(key, "seed", distfield, sizefield, "-o", seeds),
        case.run(
            key,
            "particles",
            seeds,
            "--distfield",
            distfield,
            "--sizefield",
            sizefield,
            "-o",
            particles,
            "--backend",
            case.backend,
        ),
        case.run(key, "reconstruct", particles, "--distfield", distfield, "--sizefield", sizefield, "-o", surface),
    ]
    seconds = time.monotonic() - start
    code = max(code for code, _ in reports)
    meta = reports[0][1]["results"]["meta"]
    results = reports[4][1]["results"]
    checked, quality = results["check"], results["check"]["quality"]
    away, lost = distances(case, surface, distfield) if case.distances else ("-", "-")
    changes = meta.get("scale_changes", {})
    told = ", ".join(f"{count} {kind}" for kind, count in changes.get("counts", {}).items()) or "-"
    before = meta.get("volume_before", meta["volume"])
    columns = [
        case.name,
        f"{vertices:,}",
        f"{meta.get('scale', 0.0):.2f}",
        f"{checked['vertices']:,} ({100 * (checked['vertices'] / vertices - 1):+.1f} %)",
        str(code),
        f"{quality['radius_ratio_mean']:.3f} / {quality['radius_ratio_min']:.2f}",
        f"{quality['angle_min']:.0f} to {quality['angle_max']:.0f}",
        away,
        lost,
        f"{100 * (checked['volume'] / before - 1):+.2f}",
        " -> ".join(str(n) for n in changes.get("components", ["-"])) + f"; {told}",
        f"{seconds:.0f}",
    ]
    return "| " + " | ".join(columns) + " |"


class Parser(argparse.ArgumentParser):
    """A parser whose files of arguments may have comments."""

    def convert_arg_line_to_args(self, arg_line: str) -> list[str]:
        """Takes a line of a file for an argument, unless it starts with #."""
        return [] if arg_line.startswith("#") else [arg_line]


def main() -> None:
    """Reads the command line and prints the table."""
    parser = Parser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter, fromfile_prefix_chars="@"
    )
    parser.add_argument("cases", nargs="+", metavar="CASE")
    parser.add_argument("--vertices", type=int, nargs="+", default=[1000, 5000, 20_000, 75_000])
    parser.add_argument("--bin", type=Path, default=Path("target/release"), help="folder of the stage programs")
    parser.add_argument("--work", type=Path, default=Path("out/scale"), help="folder for the files")
    parser.add_argument("--backend", default="cpu", help="of particles: cpu, gpu or auto")
    parser.add_argument("--no-distances", action="store_true", help="without pyvista and the field at scale 0")
    arguments = parser.parse_intermixed_args()
    arguments.work.mkdir(parents=True, exist_ok=True)
    print(
        "| object | asked for | scale, mm | vertices | exit code | radius ratio, mean / smallest | angles, degrees | distance, mm | lost, mm"
        " | volume, % | components of the data; what happened | s |\n" + "|---" * 12 + "|"
    )
    for text in arguments.cases:
        name, _, rest = text.partition("=")
        volume, distfield, sizefield = [*os.path.expandvars(rest).split(";"), ""][:3]
        name = name.replace(" ", "-")
        case = Case(
            name,
            volume,
            distfield.split(),
            sizefield.split(),
            arguments.bin,
            arguments.work,
            arguments.backend,
            not arguments.no_distances,
        )
        for vertices in arguments.vertices:
            try:
                print(row(case, vertices), flush=True)
            except RefusedError as reason:
                print(f"| {case.name} | {vertices:,} | {reason} |" + " |" * 9, flush=True)


if __name__ == "__main__":
    main()
