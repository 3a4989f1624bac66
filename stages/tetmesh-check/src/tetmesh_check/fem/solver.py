"""Conjugate gradients of SciPy, with the algebraic multigrid of PyAMG as their preconditioner.

The coarse levels of smoothed aggregation (Vanek, Mandel and Brezina 1996) represent the vectors of
low energy: constants for a potential, rigid motions for displacements.
"""

from __future__ import annotations

import time
from typing import Any

import numpy as np
import pyamg
from scipy.sparse import diags
from scipy.sparse.csgraph import connected_components
from scipy.sparse.linalg import cg

from tetmesh_check.quality import Labels, Points, Values

TOLERANCE = 1e-10
"""Norm of the residual over that of the right-hand side. The residual of a few flat tetrahedra can
dominate this norm, so the tolerance is smaller than the error of 1e-8 that the solution needs."""
MAX_ITERATIONS = 500
"""Maximum iterations of conjugate gradients. A good mesh takes 10 to 50."""
STRENGTH = 0.03
"""Weaker entries, relative to the root of the product of both diagonal entries, do not join
unknowns to an aggregate. Elasticity of a heart (568,806 unknowns): 37 iterations with 0, 24 with
0.03, 26 with 0.05."""
COARSEST = 300
"""Maximum number of unknowns of a level that is solved directly. PyAMG's default is 10."""
_SEED = 1
"""Seed of the random vectors from which PyAMG estimates spectral radii."""


def rigid_motions(points: Points) -> Values:
    """Return the six displacements of a rigid body, shape ``(3 n, 6)``.

    Three translations, then three rotations about the centre, scaled to the size of the body. Row
    ``3 i + k`` is component k at point i.
    """
    out = points - points.mean(axis=0)
    out /= max(float(np.abs(out).max()), 1e-300)
    rotations = np.cross(np.eye(3), out[:, None, :]).swapaxes(1, 2)
    translations = np.broadcast_to(np.eye(3), rotations.shape)
    return np.concatenate([translations, rotations], axis=2).reshape(-1, 6)


def multigrid(matrix: Any, near_null: Values | None = None) -> Any:
    """Set up a V-cycle with symmetric block Gauss-Seidel sweeps, PyAMG's default.

    Parameters
    ----------
    matrix
        Sparse, symmetric and positive definite; in blocks of three unknowns if ``near_null`` is
        given.
    near_null
        See :func:`rigid_motions`; the constant by default.
    """
    before = np.random.get_state()  # noqa: NPY002 - PyAMG draws from the global generator
    try:
        np.random.seed(_SEED)  # noqa: NPY002
        hierarchy = pyamg.smoothed_aggregation_solver(
            matrix if near_null is None else matrix.tobsr((3, 3)),
            B=near_null,
            strength=("symmetric", {"theta": STRENGTH}),
            smooth=("jacobi", {"omega": 4.0 / 3.0, "weighting": "block"}),
            improve_candidates=None,
            max_coarse=COARSEST,
        )
    finally:
        np.random.set_state(before)  # noqa: NPY002
    return hierarchy.aspreconditioner(cycle="V")


def _check_time(deadline: float) -> None:
    if time.monotonic() > deadline:
        raise TimeoutError


def solve(
    matrix: Any, right_side: Values, deadline: float, near_null: Values | None = None, grounded: Any = None
) -> tuple[Values, dict[str, Any]]:
    """Solve a linear system.

    Parameters
    ----------
    matrix, right_side
        The system.
    deadline
        Time limit by the monotonic clock, s.
    near_null
        See :func:`multigrid`.
    grounded
        Matrix for the set-up of multigrid, if that of the system is singular.

    Returns
    -------
    tuple
        The solution, and results for the report. ``multigrid`` has those of the iteration, such as
        whether it converged.

    Raises
    ------
    TimeoutError
        At the time limit; a set-up of multigrid in progress is finished first.
    """
    steps = 0

    def count(_solution: Values) -> None:
        nonlocal steps
        steps += 1
        _check_time(deadline)

    _check_time(deadline)
    started = time.monotonic()
    # a mesh with one layer of tetrahedra may have no interior points, so no unknowns
    cycle = multigrid(matrix if grounded is None else grounded, near_null) if matrix.shape[0] else None
    set_up = time.monotonic() - started
    with np.errstate(all="ignore"):
        solution, code = cg(matrix, right_side, rtol=TOLERANCE, maxiter=MAX_ITERATIONS, M=cycle, callback=count)
        residual = float(np.linalg.norm(right_side - matrix @ solution))
    norm = float(np.linalg.norm(right_side))
    residual = residual / norm if norm else 0.0
    finite = bool(np.isfinite(residual))
    run = {
        "iterations": steps,
        "converged": code == 0 and finite,
        "residual": residual if finite else None,
        "setup_seconds": set_up,
        "seconds": time.monotonic() - started,
    }
    return solution, {"unknowns": matrix.shape[0], "nonzeros": matrix.nnz, "tolerance": TOLERANCE, "multigrid": run}


def solve_floating(matrix: Any, right_side: Values, deadline: float) -> tuple[Values, Labels, dict[str, Any]]:
    """Solve a system that leaves a constant free in each connected part of the mesh.

    Returns the solution, the part of each unknown, and results as :func:`solve`.
    """
    parts, part = connected_components(matrix, directed=False)
    # On a coarse level, a small part is a single unknown with a diagonal entry of zero, or of
    # rounding errors. So the matrix for multigrid grounds one point of each part.
    first = np.unique(part, return_index=True)[1]
    leak = np.zeros(len(right_side))
    leak[first] = matrix.diagonal()[first]
    solution, figures = solve(matrix, right_side, deadline, grounded=(matrix + diags(leak)).tocsr())
    figures["parts"] = int(parts)
    return solution, part, figures
