"""Algebraic multigrid by smoothed aggregation (PyAMG): the preconditioner with which large meshes are solved.

Vanek, Mandel and Brezina, "Algebraic multigrid by smoothed aggregation for second and fourth order elliptic problems"
(1996). What costs a matrix little energy must survive on the coarse levels: constants for a potential, the six motions
of a rigid body for displacements.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pyamg

from tetmesh_check.quality import Points, Values

STRENGTH = 0.03
"""Entries weaker than this, over the root of the product of both diagonal entries, do not join unknowns to an aggregate. On the
elasticity of a heart (568,806 unknowns): 37 iterations with 0, 24 with 0.03, 26 with 0.05."""
COARSEST = 300
"""Unknowns below which a level is solved directly."""
_SEED = 1
"""PyAMG estimates spectral radii from random vectors."""


def rigid_motions(points: Points) -> Values:
    """Displacements of the six motions of a rigid body.

    Parameters
    ----------
    points
        Positions, mm, shape ``(n, 3)``.

    Returns
    -------
    ndarray
        Shape ``(3 n, 6)``: three translations, then three rotations about the middle, scaled to the size of the body;
        row ``3 i + k`` is component k at point i.
    """
    out = points - points.mean(axis=0)
    out /= max(float(np.abs(out).max()), 1e-300)
    motions = np.zeros((len(points), 3, 6))
    for axis in range(3):
        motions[:, axis, axis] = 1.0
        motions[:, :, 3 + axis] = np.cross(np.eye(3)[axis], out)
    return motions.reshape(-1, 6)


def multigrid(matrix: Any, near_null: Values | None = None) -> Callable[[Values], Values]:
    """Set up one V-cycle with a symmetric Gauss-Seidel sweep before and after, as a function of the residual.

    Parameters
    ----------
    matrix
        Sparse, symmetric, positive definite, shape ``(n, n)``; with blocks of three
        unknowns where ``near_null`` is given.
    near_null
        See :func:`rigid_motions`; the constant by default.
    """
    smoother: Any = ("gauss_seidel", {"sweep": "symmetric"})
    level = matrix
    if near_null is not None:
        smoother = ("block_gauss_seidel", {"sweep": "symmetric"})
        level = matrix.tobsr((3, 3))
    before = np.random.get_state()  # noqa: NPY002 - PyAMG draws from the global generator
    try:
        np.random.seed(_SEED)  # noqa: NPY002
        hierarchy = pyamg.smoothed_aggregation_solver(
            level,
            B=near_null,
            strength=("symmetric", {"theta": STRENGTH}),
            smooth=("jacobi", {"omega": 4.0 / 3.0, "weighting": "block"}),
            presmoother=smoother,
            postsmoother=smoother,
            improve_candidates=None,
            max_coarse=COARSEST,
        )
    finally:
        np.random.set_state(before)  # noqa: NPY002
    cycle = hierarchy.aspreconditioner(cycle="V")

    def precondition(residual: Values) -> Values:
        improved: Values = cycle.matvec(residual)
        return improved

    return precondition
