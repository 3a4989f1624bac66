"""Compare our surface with other surfaces of the same distance field.

    .venv/bin/python stages/tetmesh-check/benches/marching_cubes.py out/ball out/mickey
        --work out/bench-marching-cubes

CASE_DIR is a folder with the results of a case: NAME.distfield.vti, NAME.sizefield.vti and
NAME.surface.vtp. The surfaces of a case are:

- our surface;
- the surface of marching cubes;
- the surface of marching cubes on the field, resampled to give about as many vertices as ours;
- with ``--remesher PYTHON`` (an interpreter with the packages in benches/requirements.lock): the
  surface of marching cubes, remeshed by gpytoolbox's remesh_botsch to about as many vertices.

HXT fills each surface with tetrahedra for the same size field, without changing its triangles. The
same problems are then solved on the tetrahedra. The result is a Markdown table. If a program
exceeds its time limit, its row says so.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyvista as pv
from isoparticles._native import surface_components

from tetmesh_check.datasets import from_polydata, to_polydata
from tetmesh_check.surface import read_dataset

_DISTANCE = "signed_distance"
_PROBLEMS = ("poisson", "conduction", "elasticity")
_COLUMNS = (
    "case", "surface", "made in, s", "vertices", "smallest radius ratio, triangles", "tetrahedra", "filled in, s", "smallest dihedral",
    "radius ratio, smallest / mean", "checks", *(f"{name}: unknowns; CG steps" for name in _PROBLEMS),
    "error of the known solution, L2 / H1, %", "solved in, s",
)  # fmt: skip
KINDS = ("particles", "marching-cubes", "marching-cubes-resampled", "remesh_botsch")


def marching_cubes(distfield: Path, target: Path, step: float = 1.0) -> int:
    """Extract the zero set of a distance field by marching cubes (VTK's flying edges).

    Writes the surface in world coordinates.

    Parameters
    ----------
    distfield
        File of the distance field, negative inside.
    target
        A ``.vtp`` file.
    step
        Distance between samples, in voxels. The field is interpolated trilinearly.

    Returns
    -------
    int
        Number of vertices.
    """
    image = read_dataset(distfield)
    plain = pv.ImageData(dimensions=image.dimensions)
    plain[_DISTANCE] = np.asarray(image.point_data[_DISTANCE])
    if step != 1.0:
        counts = [max(2, round((count - 1) / step) + 1) for count in image.dimensions]
        spacing = [(count - 1) / (new - 1) for count, new in zip(image.dimensions, counts, strict=True)]
        plain = pv.ImageData(dimensions=counts, spacing=spacing).sample(plain)
    points, triangles = from_polydata(plain.contour([0.0], scalars=_DISTANCE, method="flying_edges"))
    axes = np.asarray(image.direction_matrix, dtype=np.float64) * np.asarray(image.spacing)
    points = (points + np.array(image.extent[::2])) @ axes.T + np.asarray(image.origin)
    if surface_components(points, triangles)["volumes"].sum() < 0:
        triangles = triangles[:, ::-1]
    to_polydata(points, triangles).save(target)
    return len(points)


def vertices_of(surface: Path) -> int:
    """Return the number of points of a surface."""
    return int(read_dataset(surface).n_points)


def remesh(python: Path, source: Path, vertices: int, target: Path, seconds: float) -> str | None:
    """Remesh a surface with ``remesh.py``. Returns a message if it fails, or else None.

    Parameters
    ----------
    python
        An interpreter that has gpytoolbox.
    source, target
        ``.vtp`` files.
    vertices
        Target number of vertices.
    seconds
        Time limit, s.
    """
    job, result = target.with_suffix(".job.npz"), target.with_suffix(".npz")
    result.unlink(missing_ok=True)
    points, triangles = from_polydata(read_dataset(source))
    np.savez(job, points=points, triangles=triangles, vertices=vertices)
    script = Path(__file__).with_name("remesh.py")
    try:
        code = subprocess.run(
            [str(python), str(script), str(job), str(result)], check=False, timeout=seconds
        ).returncode
    except subprocess.TimeoutExpired:
        code = 0
        if not result.is_file():
            return f"the remesher did not finish within {seconds:g} s"
    if code != 0 or not result.is_file():
        return f"the remesher failed (exit code {code})"
    with np.load(result) as made:
        to_polydata(made["points"], made["triangles"].astype(np.int64)).save(target)
    return None


def fill_and_solve(
    surface: Path, sizefield: Path, work: Path, name: str, parsed: argparse.Namespace
) -> dict[str, Any] | None:
    """Fill a surface and solve the problems. Returns the report, or None if there is none.

    Parameters
    ----------
    surface, sizefield
        Files of the surface and of the size field.
    work
        Folder for the results.
    name
        Name of the results.
    parsed
        The parsed command line of this program, which contains the time limits.
    """
    report = work / f"{name}.report.json"
    report.unlink(missing_ok=True)
    volume = work / f"{name}.volume.vtu"
    subprocess.run(
        [
            *(sys.executable, "-m", "tetmesh_check", str(surface), "--sizefield", str(sizefield), "-o", str(volume)),
            *("--method", "hxt", "--max-seconds", str(parsed.fill_seconds)),
            *("--solve", "yes", "--solve-seconds", str(parsed.solve_seconds)),
            *("--force", "--report", str(report), "-q"),
        ],
        check=False,
    )
    if not report.is_file():
        return None
    loaded: dict[str, Any] = json.loads(report.read_text(encoding="utf-8"))
    return loaded


def _solves(solve: dict[str, Any]) -> list[str]:
    cells = []
    for problem in _PROBLEMS:
        figures = solve.get(problem)
        if figures is None or "multigrid" not in figures:
            cells.append("not solved")
            continue
        run = figures["multigrid"]
        cells.append(f"{figures['unknowns']:,}; {'' if run['converged'] else 'stuck at '}{run['iterations']:,}")
    poisson = solve.get("poisson") or {}
    errors = [poisson.get(f"relative_{norm}_error") for norm in ("l2", "h1")]
    cells.append(" / ".join("-" if error is None else f"{100.0 * error:.3g}" for error in errors))
    return cells


def row(case: str, kind: str, seconds: float | None, report: dict[str, Any] | str | None) -> str:
    """Return one row of the table.

    Parameters
    ----------
    case, kind
        The first two cells.
    seconds
        Time to make the surface from the distance field, s, if known.
    report
        The report of ``tetmesh-check``, or the message of an earlier failure.
    """
    first = f"| {case} | {kind} | {'-' if seconds is None else f'{seconds:.1f}'} |"
    if report is None:
        return f"{first} ended without a report |"
    if isinstance(report, str):
        return f"{first} {report} |"
    if report["error"] is not None:
        return f"{first} {report['error']['what'].split(': ', 1)[-1]} |"
    results = report["results"]
    quality = results["volume"]["quality"]
    steps = {step["name"]: step["seconds"] for step in report["steps"]}
    cells = [
        f"{results['surface']['topology']['vertices']:,}",
        f"{results['surface']['quality']['radius_ratio']['min']:.3f}",
        f"{results['volume']['tetrahedra']:,}",
        f"{steps['tetrahedralize']:.1f}",
        f"{quality['min_dihedral']['min']:.2g}"
        if quality["min_dihedral"]["min"] < 1
        else f"{quality['min_dihedral']['min']:.1f}",
        f"{quality['radius_ratio']['min']:.3f} / {quality['radius_ratio']['mean']:.3f}",
        "passed" if report["exit_code"] == 0 else "failed",
        *_solves(results["solve"]),
        f"{steps['solve']:.0f}" if "solve" in steps else "-",
    ]
    return f"{first} {' | '.join(cells)} |"


def made_in(folder: Path) -> float | None:
    """Return the time (s) of the stages from the distance field to our surface, if reported."""
    reports = [folder / "reports" / f"{stage}.json" for stage in ("sizefield", "seed", "particles", "reconstruct")]
    if not all(report.is_file() for report in reports):
        return None
    return float(sum(json.loads(report.read_text(encoding="utf-8"))["seconds"] for report in reports))


def surfaces(folder: Path, parsed: argparse.Namespace) -> dict[str, Callable[[Path], tuple[float | None, str | None]]]:
    """Return the function that makes each surface of a case.

    Each function takes the path of the surface file. It returns the time (s), if known, and, if it
    fails, a message.

    Parameters
    ----------
    folder
        Folder with the results of the case.
    parsed
        The parsed command line of this program.
    """
    name = folder.name
    distfield, ours = folder / f"{name}.distfield.vti", folder / f"{name}.surface.vtp"
    native = parsed.work / f"{name}.marching-cubes.vtp"

    def by_particles(target: Path) -> tuple[float | None, str | None]:
        target.write_bytes(ours.read_bytes())
        return made_in(folder), None

    def by_marching_cubes(target: Path) -> tuple[float | None, str | None]:
        started = time.monotonic()
        marching_cubes(distfield, target)
        return time.monotonic() - started, None

    def as_many(target: Path) -> tuple[float | None, str | None]:
        wanted, step = vertices_of(ours), 1.0
        count = marching_cubes(distfield, target, step)
        for _ in range(3):
            step *= float(np.sqrt(count / wanted))
            started = time.monotonic()
            count = marching_cubes(distfield, target, step)
        return time.monotonic() - started, None

    def by_botsch(target: Path) -> tuple[float | None, str | None]:
        marching_cubes(distfield, native)
        problem = remesh(parsed.remesher, native, vertices_of(ours), target, parsed.fill_seconds)
        if problem is not None:
            return None, problem
        with np.load(target.with_suffix(".npz")) as made:
            return float(made["seconds"]), None

    makers = dict(zip(KINDS, (by_particles, by_marching_cubes, as_many, by_botsch), strict=True))
    return {kind: makers[kind] for kind in KINDS if kind in parsed.surfaces and (kind != KINDS[3] or parsed.remesher)}


def main(argv: Sequence[str] | None = None) -> int:
    """Fill the surfaces, solve the problems and print the table.

    Returns 2 if one of our own surfaces has no report or a report of an error, and 0 otherwise. The
    table shows the failures of the other surfaces.

    Parameters
    ----------
    argv
        The command line without the name of the program (default: that of the process).
    """
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("cases", metavar="CASE_DIR", type=Path, nargs="+", help="folders with the results of a case")
    parser.add_argument("--work", type=Path, required=True, help="where to write the meshes")
    parser.add_argument(
        "--remesher", metavar="PYTHON", type=Path, help="interpreter with gpytoolbox; without it no remesher"
    )
    parser.add_argument("--surfaces", choices=KINDS, nargs="+", default=KINDS, help="which of them (default: all)")
    parser.add_argument("--fill-seconds", type=float, default=600.0, help="time limit of remesher and of HXT, s")
    parser.add_argument("--solve-seconds", type=float, default=600.0, help="time limit of the problems of one mesh, s")
    parsed = parser.parse_args(argv)
    failed = False
    parsed.work.mkdir(parents=True, exist_ok=True)
    if parsed.remesher is None:
        print("no remesher: skipped (--remesher PYTHON)", file=sys.stderr)
    print(f"| {' | '.join(_COLUMNS)} |\n" + "|---" * len(_COLUMNS) + "|")
    for folder in parsed.cases:
        name = folder.name
        for kind, make in surfaces(folder, parsed).items():
            label = f"{name}.{kind}"
            surface = parsed.work / f"{label}.vtp"
            seconds, problem = make(surface)
            report: dict[str, Any] | str | None = problem
            if problem is None:
                report = fill_and_solve(surface, folder / f"{name}.sizefield.vti", parsed.work, label, parsed)
            print(row(name, kind.replace("-", " "), seconds, report), flush=True)
            if kind == "particles":
                failed = failed or not isinstance(report, dict) or report["error"] is not None
    return 2 if failed else 0


if __name__ == "__main__":
    raise SystemExit(main())
