"""``tetmesh-check-convergence``: how the error of Poisson's equation falls from a coarse mesh of an object to finer ones."""

from __future__ import annotations

import math
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pyvista as pv

from tetmesh_check.context import guarded
from tetmesh_check.errors import ExitCode, StageError
from tetmesh_check.fem.assembly import Assembler
from tetmesh_check.fem.problems import Solver, poisson
from tetmesh_check.fem.solve import MAX_ITERATIONS
from tetmesh_check.parsing import program_parser
from tetmesh_check.quality import Cells, Points, signed_tetrahedron_volumes
from tetmesh_check.surface import read_dataset
from tetmesh_check.topology import tetrahedron_boundary

TOOL = "tetmesh-check-convergence"
ORDER = 2.0
"""Order of the error of linear elements in the mean square."""
TOLERANCE = 0.1
"""How far the last order may be from that, relative."""


@dataclass(frozen=True)
class Row:
    """One mesh."""

    name: str
    tetrahedra: int
    size: float
    """Edge length of the regular tetrahedron of mean volume, mm."""
    figures: dict[str, Any]
    """Those of :func:`.poisson`."""


def read_volume(path: Path) -> tuple[Points, Cells]:
    """Points, mm, and tetrahedra of a volume mesh.

    Parameters
    ----------
    path
        What ``tetmesh-check`` wrote.
    """
    grid = read_dataset(path)
    if not isinstance(grid, pv.UnstructuredGrid) or pv.CellType.TETRA not in grid.cells_dict:
        raise StageError(f"{path}: holds no tetrahedra", "they are what is solved on", "give what tetmesh-check wrote")
    cells = np.asarray(grid.cells_dict[pv.CellType.TETRA], dtype=np.int64)
    used, local = np.unique(cells, return_inverse=True)
    return np.asarray(grid.points, dtype=np.float64)[used], local.reshape(-1, 4).astype(np.int64)


def measure(name: str, points: Points, tetrahedra: Cells) -> Row:
    """Solve on one mesh.

    Parameters
    ----------
    name
        For the table.
    points
        Positions, mm, shape ``(n, 3)``.
    tetrahedra
        Vertex indices, shape ``(m, 4)``.

    Raises
    ------
    StageError
        If a tetrahedron is not positive, or if there is no solution.
    """
    volumes = signed_tetrahedron_volumes(points, tetrahedra)
    if not (volumes > 0).all():
        raise StageError(f"{name}: has inverted or flat tetrahedra", "there is no solution on it", "mesh it again")
    boundary = np.zeros(len(points), dtype=bool)
    boundary[tetrahedron_boundary(tetrahedra).triangles] = True
    figures, converged = poisson(Assembler(points, tetrahedra), boundary, Solver(MAX_ITERATIONS, math.inf))
    if not converged:
        raise StageError(f"{name}: conjugate gradients did not converge", "there is no solution", "look at its quality")
    size = float((6.0 * math.sqrt(2.0) * volumes.mean()) ** (1.0 / 3.0))
    return Row(name, len(tetrahedra), size, figures)


def orders(rows: Sequence[Row], measure_name: str) -> list[float]:
    """Order of convergence from each mesh to the next.

    Parameters
    ----------
    rows
        From coarse to fine.
    measure_name
        ``relative_l2_error`` or ``relative_h1_error``.
    """
    return [
        math.log(before.figures[measure_name] / after.figures[measure_name]) / math.log(before.size / after.size)
        for before, after in pairwise(rows)
    ]


def table(rows: Sequence[Row]) -> str:
    """Write the table, in Markdown.

    Parameters
    ----------
    rows
        From coarse to fine.
    """
    lines = [
        "| mesh | tetrahedra | size, mm | L2 error, % | order | H1 error, % | order | CG, Jacobi | CG, plain | condition |",
        "|---|---|---|---|---|---|---|---|---|---|",
    ]
    steps = [[math.nan, *orders(rows, name)] for name in ("relative_l2_error", "relative_h1_error")]
    for row, value, gradient in zip(rows, *steps, strict=True):
        figures = row.figures
        words = ["" if math.isnan(order) else f"{order:.2f}" for order in (value, gradient)]
        lines.append(
            f"| {row.name} | {row.tetrahedra:,} | {row.size:.3g} | {100 * figures['relative_l2_error']:.3g} | {words[0]} | "
            f"{100 * figures['relative_h1_error']:.3g} | {words[1]} | {figures['jacobi']['iterations']} | "
            f"{figures['plain']['iterations']} | {figures['plain']['condition']:.3g} |"
        )
    return "\n".join(lines)


def _run(paths: Sequence[Path]) -> ExitCode:
    if len(paths) < 2:
        raise StageError("one mesh is given", "an order of convergence needs two", "give coarser or finer ones, too")
    rows = [measure(path.name, *read_volume(path)) for path in paths]
    rows.sort(key=lambda row: -row.size)
    if not all(after.size < 0.9 * before.size for before, after in pairwise(rows)):
        raise StageError(
            "the meshes are too much alike in size: " + ", ".join(f"{row.name} {row.size:.3g} mm" for row in rows),
            "an order of convergence needs errors that differ",
            "mesh the object again with half the edge length (SIZE=... of make)",
        )
    print(table(rows))
    last = orders(rows, "relative_l2_error")[-1]
    if abs(last / ORDER - 1.0) <= TOLERANCE:
        return ExitCode.OK
    print(
        f"check failed: the order of the error is {last:.2f}, not {ORDER:g} within {100 * TOLERANCE:g} %",
        file=sys.stderr,
    )
    return ExitCode.CHECK_FAILED


def main(argv: Sequence[str] | None = None) -> int:
    """Run the program.

    Parameters
    ----------
    argv
        The command line without the program's name; that of the process by default.
    """
    parser = program_parser(
        TOOL,
        description="Solves Poisson's equation with a known solution on two or more volume meshes of one object, with linear elements, and "
        "prints a table of the errors, their order of convergence and the iterations of conjugate gradients.",
        epilog="exit codes: 0 the last order in the mean square is 2 within 10 %; 1 it is not; 2 bad usage or input\n\nexample:\n"
        f"  {TOOL} coarse.volume.vtu middle.volume.vtu fine.volume.vtu",
    )
    parser.add_argument(
        "volumes", metavar="VOLUME.vtu", type=Path, nargs="+", help="the meshes, two or more, in any order"
    )
    parsed = parser.parse_args(argv)
    return guarded(TOOL, lambda: _run(parsed.volumes))
