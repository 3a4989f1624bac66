"""Conjugate gradients, and what they tell about the matrix.

The coefficients of the iteration are those of the Lanczos process (Saad, "Iterative Methods for Sparse Linear Systems",
2003, section 6.7.3), whose tridiagonal matrix has eigenvalues between those of the preconditioned matrix: their ratio
bounds its condition number from below, and closely so once the iteration has converged.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.linalg import eigvalsh_tridiagonal

from tetmesh_check.quality import Values

TOLERANCE = 1e-8
"""Norm of the residual over that of the right-hand side at which the iteration ends."""


class OutOfTimeError(Exception):
    """The time for the solves is over."""


@dataclass(frozen=True)
class CgResult:
    """How an iteration ended."""

    solution: Values
    """Shape ``(n,)``."""
    iterations: int
    """Products with the matrix."""
    converged: bool
    """Whether the residual fell below the tolerance."""
    residual: float
    """Norm of the residual over that of the right-hand side, computed from the solution."""
    smallest_eigenvalue: float
    """Smallest eigenvalue found, of the preconditioned matrix."""
    largest_eigenvalue: float
    """Largest eigenvalue found."""

    @property
    def condition(self) -> float:
        """Condition number found, a lower bound; infinite where the matrix or the preconditioner is not positive."""
        if self.smallest_eigenvalue <= 0.0:
            return float("inf")
        return self.largest_eigenvalue / self.smallest_eigenvalue


def _extreme_eigenvalues(steps: list[float], turns: list[float]) -> tuple[float, float]:
    """Smallest and largest eigenvalue of the Lanczos matrix of an iteration with these alpha and beta."""
    alpha = np.array(steps)
    beta = np.array(turns[: len(steps) - 1])
    diagonal = 1.0 / alpha
    diagonal[1:] += beta / alpha[:-1]
    beside = np.sqrt(beta) / alpha[:-1]
    first, last = (
        eigvalsh_tridiagonal(diagonal, beside, select="i", select_range=(at, at)) for at in (0, len(diagonal) - 1)
    )
    return float(first[0]), float(last[0])


def _dot(a: Values, b: Values) -> float:
    """Scalar product; not by BLAS, whose threads wait for each other at length on a busy machine."""
    return float(np.einsum("i,i->", a, b))


def _positive(product: float) -> bool:
    return 0.0 < product < np.inf


def nothing(residual: Values) -> Values:
    """Leave the residual as it is: no preconditioner."""
    return residual


def jacobi(matrix: Any) -> Callable[[Values], Values]:
    """Divide the residual by the diagonal of a matrix."""
    scale: Values = 1.0 / matrix.diagonal()
    return lambda residual: scale * residual


def conjugate_gradients(
    matrix: Any,
    right_side: Values,
    precondition: Callable[[Values], Values],
    max_iterations: int,
    deadline: float,
    tolerance: float = TOLERANCE,
) -> CgResult:
    """Solve a symmetric positive system, from zero on.

    A singular matrix will do where the right-hand side lies in its range. The iteration ends unconverged, and the condition is
    infinite, where the matrix or the preconditioner turns out not to be positive.

    Parameters
    ----------
    matrix
        Sparse, shape ``(n, n)``.
    right_side
        Shape ``(n,)``.
    precondition
        From a residual to the correction that goes with it, linear, symmetric and positive: :func:`nothing`, :func:`jacobi`,
        :func:`.multigrid`.
    max_iterations
        The iteration ends then, converged or not.
    deadline
        When time is over, by the monotonic clock, s.
    tolerance
        See :data:`TOLERANCE`.

    Raises
    ------
    OutOfTimeError
        When time is over.
    """
    norm = _dot(right_side, right_side) ** 0.5
    goal = tolerance * norm
    x = np.zeros(len(right_side))
    r = right_side.copy()
    z = precondition(r)
    p = z.copy()
    rz = _dot(r, z)
    steps: list[float] = []
    turns: list[float] = []
    converged = goal == 0.0
    positive = converged or _positive(rz)
    while positive and not converged and len(steps) < max_iterations:
        if time.monotonic() > deadline:
            raise OutOfTimeError
        q = matrix @ p
        pq = _dot(p, q)
        if not pq > 0.0:
            positive = False
            break
        alpha = rz / pq
        x += alpha * p
        r -= alpha * q
        steps.append(alpha)
        converged = _dot(r, r) <= goal * goal
        z = precondition(r)
        before, rz = rz, _dot(r, z)
        if not converged and not _positive(rz):
            positive = False
            break
        turns.append(rz / before)
        p = z + turns[-1] * p
    low, high = _extreme_eigenvalues(steps, turns) if steps else (1.0, 1.0)
    if not positive:
        low = 0.0
    left = right_side - matrix @ x
    residual = _dot(left, left) ** 0.5 / norm if norm else 0.0
    return CgResult(x, len(steps), converged, residual, low, high)
