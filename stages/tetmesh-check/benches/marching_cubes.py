"""Our surface against marching cubes on the same distance field: the same size field, tetrahedralizer and problems.

    .venv/bin/python stages/tetmesh-check/benches/marching_cubes.py out/ball out/mickey --work out/bench-marching-cubes

For each folder with the results of a case (NAME.distfield.vti, NAME.sizefield.vti, NAME.surface.vtp) it fills both
surfaces with HXT, which leaves their triangles as they are, solves on both, and prints a table in Markdown.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyvista as pv

from tetmesh_check.components import component_volumes
from tetmesh_check.polydata import from_polydata, to_polydata
from tetmesh_check.surface import read_dataset

_DISTANCE = "signed_distance"
_PROBLEMS = ("poisson", "conduction", "elasticity")


def marching_cubes(distfield: Path, target: Path) -> None:
    """Write the zero set of a distance field as marching cubes sees it (VTK's flying edges), in world coordinates.

    Parameters
    ----------
    distfield
        Negative inside.
    target
        A ``.vtp`` file.
    """
    image = read_dataset(distfield)
    plain = pv.ImageData(dimensions=image.dimensions)
    plain[_DISTANCE] = np.asarray(image.point_data[_DISTANCE])
    points, triangles = from_polydata(plain.contour([0.0], scalars=_DISTANCE, method="flying_edges"))
    step = np.asarray(image.direction_matrix, dtype=np.float64) * np.asarray(image.spacing)
    points = (points + np.array(image.extent[::2])) @ step.T + np.asarray(image.origin)
    if component_volumes(points, triangles, np.zeros(len(triangles), dtype=np.int64))[0] < 0:
        triangles = triangles[:, ::-1]
    to_polydata(points, triangles).save(target)


def fill_and_solve(surface: Path, sizefield: Path, work: Path, name: str, seconds: float) -> dict[str, Any] | None:
    """Fill one surface and solve on it; returns the report, or nothing where the run left none.

    Parameters
    ----------
    surface, sizefield
        What is filled, and how long the edges are to be.
    work
        Where the results go.
    name
        What they are called.
    seconds
        Time limit of the problems, s.
    """
    report = work / f"{name}.report.json"
    report.unlink(missing_ok=True)
    subprocess.run(
        [
            *(sys.executable, "-m", "tetmesh_check", str(surface), "--sizefield", str(sizefield)),
            *(
                "-o",
                str(work / f"{name}.volume.vtu"),
                "--method",
                "hxt",
                "--solve",
                "yes",
                "--solve-seconds",
                str(seconds),
            ),
            *("--force", "--report", str(report), "-q"),
        ],
        check=False,
    )
    if not report.is_file():
        return None
    loaded: dict[str, Any] = json.loads(report.read_text(encoding="utf-8"))
    return loaded


def row(case: str, kind: str, report: dict[str, Any] | None) -> str:
    """Write one line of the table.

    Parameters
    ----------
    case, kind
        Its first two cells.
    report
        What ``tetmesh-check`` wrote, if anything.
    """
    if report is None:
        return f"| {case} | {kind} | ended without a report |"
    if report["error"] is not None:
        return f"| {case} | {kind} | {report['error']['what'].split(': ', 1)[-1]} |"
    results = report["results"]
    quality = results["volume"]["quality"]
    cells = [
        f"{results['surface']['topology']['vertices']:,}",
        f"{results['surface']['quality']['radius_ratio']['min']:.3f}",
        f"{results['volume']['tetrahedra']:,}",
        f"{quality['min_dihedral']['min']:.1f}",
        f"{quality['radius_ratio']['min']:.3f} / {quality['radius_ratio']['mean']:.3f}",
    ]
    for problem in _PROBLEMS:
        figures = results["solve"].get(problem)
        if figures is None or "jacobi" not in figures:
            cells.append("not solved")
            continue
        plain = figures["plain"] or {}
        iterations, condition = plain.get("iterations"), plain.get("condition")
        cells.append(
            f"{'out of time' if iterations is None else f'{iterations:,}'} / {figures['jacobi']['iterations']:,} "
            f"({'-' if condition is None else f'{condition:.2g}'})"
        )
    return f"| {case} | {kind} | {' | '.join(cells)} |"


def main(argv: Sequence[str] | None = None) -> int:
    """Fill, solve, print; 2 where a run ended in an error, 0 else (a mesh that fails a check is a row of the table).

    Parameters
    ----------
    argv
        The command line without the program's name; that of the process by default.
    """
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("cases", metavar="CASE_DIR", type=Path, nargs="+", help="folders with the results of a case")
    parser.add_argument("--work", type=Path, required=True, help="where to write the meshes")
    parser.add_argument("--solve-seconds", type=float, default=600.0, help="time limit of the problems of one mesh, s")
    parsed = parser.parse_args(argv)
    failed = False
    parsed.work.mkdir(parents=True, exist_ok=True)
    print(
        "| case | surface | vertices | smallest radius ratio, triangles | tetrahedra | smallest dihedral | radius ratio, "
        "smallest / mean | Poisson: CG plain / Jacobi (condition) | conduction | elasticity |\n" + "|---" * 10 + "|"
    )
    for folder in parsed.cases:
        name = folder.name
        other = parsed.work / f"{name}.marching-cubes.vtp"
        marching_cubes(folder / f"{name}.distfield.vti", other)
        sizefield = folder / f"{name}.sizefield.vti"
        for kind, surface in (("particles", folder / f"{name}.surface.vtp"), ("marching cubes", other)):
            label = f"{name}.{kind.replace(' ', '-')}"
            report = fill_and_solve(surface, sizefield, parsed.work, label, parsed.solve_seconds)
            print(row(name, kind, report), flush=True)
            failed = failed or report is None or report["error"] is not None
    return 2 if failed else 0


if __name__ == "__main__":
    raise SystemExit(main())
