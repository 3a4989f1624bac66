#!/usr/bin/env python3
"""Compares meshes of one object by the error of a known solution, and preconditioners on them.

Solves Poisson's equation with linear elements on two or more volume meshes. The table gives the
errors, their orders of convergence, the iterations of conjugate gradients with multigrid, with
Jacobi's preconditioner and without one, and the condition number of the matrix.

Exit codes: 0: the last order of the L2 error is 2 within 10 %; 1: it is not; 2: bad usage or input.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pyvista as pv
from scipy.sparse import diags
from scipy.sparse.linalg import cg, eigsh
from skfem import MeshTet, condense
from skfem.models.poisson import laplace

from tetmesh_check.errors import StageError, guarded
from tetmesh_check.fem.assembly import linear_elements
from tetmesh_check.fem.problems import poisson
from tetmesh_check.fem.solver import TOLERANCE as RESIDUAL
from tetmesh_check.quality import Cells, Points, signed_tetrahedron_volumes
from tetmesh_check.surface import read_dataset
from tetmesh_check.topology import tetrahedron_boundary

TOOL = "convergence.py"
ORDER = 2.0
"""Order of the L2 error of linear elements."""
TOLERANCE = 0.1
"""Accepted relative deviation of the last order."""
MAX_ITERATIONS = 50_000
"""Maximum iterations of conjugate gradients without multigrid."""
_COLUMNS = (
    "mesh", "tetrahedra", "size, mm", "L2 error, %", "order", "H1 error, %", "order", "CG steps, multigrid", "Jacobi", "plain", "condition",
)  # fmt: skip


@dataclass(frozen=True)
class Row:
    """One mesh."""

    name: str
    tetrahedra: int
    size: float
    """Edge length of the regular tetrahedron of mean volume, mm."""
    figures: dict[str, Any]
    """Those of :func:`.poisson`, with ``steps`` and ``condition``."""


def read_volume(path: Path) -> tuple[Points, Cells]:
    """Read points (mm) and tetrahedra of a file that ``tetmesh-check`` wrote."""
    grid = read_dataset(path)
    if not isinstance(grid, pv.UnstructuredGrid) or pv.CellType.TETRA not in grid.cells_dict:
        raise StageError(f"{path}: has no tetrahedra", "the problem is solved on them", "give NAME.volume.vtu")
    cells = np.asarray(grid.cells_dict[pv.CellType.TETRA], dtype=np.int64)
    used, local = np.unique(cells, return_inverse=True)
    return np.asarray(grid.points, dtype=np.float64)[used], local.reshape(-1, 4).astype(np.int64)


def iterations(matrix: Any, preconditioner: Any) -> int:
    """Return the iterations of conjugate gradients for a right-hand side of ones."""
    steps: list[None] = []
    ones = np.ones(matrix.shape[0])
    cg(matrix, ones, rtol=RESIDUAL, maxiter=MAX_ITERATIONS, M=preconditioner, callback=lambda _: steps.append(None))
    return len(steps)


def compared(matrix: Any, figures: dict[str, Any]) -> dict[str, Any]:
    """Return the iterations by preconditioner, and the condition number of the matrix."""
    smallest, largest = (eigsh(matrix, 1, return_eigenvectors=False, **at)[0] for at in ({"sigma": 0.0}, {}))
    jacobi = diags(1.0 / matrix.diagonal())
    steps = [figures["multigrid"]["iterations"], iterations(matrix, jacobi), iterations(matrix, None)]
    return {"steps": steps, "condition": float(largest / smallest)}


def measure(name: str, points: Points, tetrahedra: Cells) -> Row:
    """Solve on one mesh.

    Raises
    ------
    StageError
        If a tetrahedron is not positive or the solver does not converge.
    """
    volumes = signed_tetrahedron_volumes(points, tetrahedra)
    if not (volumes > 0).all():
        raise StageError(f"{name}: has inverted or flat tetrahedra", "there is no solution on it", "mesh it again")
    mesh = MeshTet(np.ascontiguousarray(points.T), np.ascontiguousarray(tetrahedra.T))
    outside = tetrahedron_boundary(tetrahedra).triangles
    figures = poisson(mesh, outside, math.inf)
    if not figures["multigrid"]["converged"]:
        raise StageError(f"{name}: conjugate gradients did not converge", "there is no solution", "check its quality")
    matrix = condense(laplace.assemble(linear_elements(mesh)), D=np.unique(outside), expand=False)
    size = float((6.0 * math.sqrt(2.0) * volumes.mean()) ** (1.0 / 3.0))
    return Row(name, len(tetrahedra), size, {**figures, **compared(matrix, figures)})


def orders(rows: Sequence[Row], error: str) -> list[float]:
    """Return the order of convergence of ``relative_l2_error`` from each mesh to the next."""
    return [
        math.log(before.figures[error] / after.figures[error]) / math.log(before.size / after.size)
        for before, after in pairwise(rows)
    ]


def table(rows: Sequence[Row]) -> str:
    """Write the table in Markdown, from coarse to fine."""
    lines = [f"| {' | '.join(_COLUMNS)} |", "|---" * len(_COLUMNS) + "|"]
    steps = [[math.nan, *orders(rows, error)] for error in ("relative_l2_error", "relative_h1_error")]
    for row, *found in zip(rows, *steps, strict=True):
        known = row.figures
        value, gradient = ("" if math.isnan(order) else f"{order:.2f}" for order in found)
        l2, h1 = (100 * known[f"relative_{kind}_error"] for kind in ("l2", "h1"))
        cells = [row.name, f"{row.tetrahedra:,}", f"{row.size:.3g}", f"{l2:.3g}", value, f"{h1:.3g}", gradient]
        cells += [*map(str, known["steps"]), f"{known['condition']:.3g}"]
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines)


def _run(paths: Sequence[Path]) -> list[str]:
    if len(paths) < 2:
        raise StageError("one mesh is given", "an order of convergence needs two", "give coarser or finer ones as well")
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
        return []
    limit = f"{ORDER:g} within {100 * TOLERANCE:g} %"
    return [f"the order of the error is {last:.2f}, not {limit}"]


def main(argv: Sequence[str] | None = None) -> int:
    """Run the program with the words after its name (default: those of the process)."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("volumes", metavar="VOLUME.vtu", type=Path, nargs="+", help="the meshes, two or more")
    parsed = parser.parse_args(argv)
    return guarded(TOOL, lambda: _run(parsed.volumes))


if __name__ == "__main__":
    raise SystemExit(main())
