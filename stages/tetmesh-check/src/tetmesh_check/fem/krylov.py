"""Conjugate gradients, and what they tell about the matrix.

The coefficients of the iteration are those of the Lanczos process (Saad, "Iterative Methods for Sparse Linear Systems",
2003, section 6.7.3), whose tridiagonal matrix has eigenvalues between those of the preconditioned matrix: their ratio
bounds its condition number from below, and closely so once the iteration has converged.

Step k lowers the squared error in the energy norm by alpha_k r_k.z_k (Hestenes and Stiefel 1952), so that the steps of a while tell
the error before it (Strakos and Tichy, "On error estimation in the conjugate gradient method and why it works in finite
precision computations", 2002). The iteration ends by that and not by the residual, whose norm says little where a few flat
tetrahedra with huge entries make up most of the right-hand side.
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
"""Error of the iteration over the solution, both in the energy norm, that is asked for."""
DELAY = 0.1
"""Share of the steps by which an error is told."""


class OutOfTimeError(Exception):
    """The time for the solves is over."""


@dataclass(frozen=True)
class CgResult:
    """How an iteration ended."""

    solution: Values
    """Shape ``(n,)``."""
    iterations: int
    """Steps until the error in the energy norm was below the tolerance; the estimate of that error took some more."""
    converged: bool
    """Whether it came to that."""
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


def _told(falls: list[float], goal: float) -> bool:
    """Whether the last steps say that the error was below the goal before them.

    Parameters
    ----------
    falls
        By how much each step lowered the squared error in the energy norm.
    goal
        Squared error in the energy norm.
    """
    # the last alone first, because a window of many steps takes its time
    return falls[-1] <= goal and sum(falls[-max(1, int(DELAY * len(falls))) :]) <= goal


def _steps_needed(falls: list[float], goal: float) -> int:
    """Number of steps after which the squared error, told by all that came later, is at most the goal."""
    return int(np.count_nonzero(np.cumsum(falls[::-1]) > goal))


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
    energy: float | None = None,
) -> CgResult:
    """Solve a symmetric positive system, from zero on.

    It ends when the last tenth of the steps (:data:`DELAY`) tells that the error before them was below the tolerance.

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
    energy
        Squared energy norm that the error is measured by, by default that of the solution. To be given where the unknowns are
        only a part of a field: without the values on the boundary they have the energy of a jump there, which grows with the flatness
        of the tetrahedra.

    Raises
    ------
    OutOfTimeError
        When time is over.
    """
    norm = _dot(right_side, right_side) ** 0.5
    x = np.zeros(len(right_side))
    r = right_side.copy()
    z = precondition(r)
    p = z.copy()
    rz = _dot(r, z)
    steps: list[float] = []
    turns: list[float] = []
    falls: list[float] = []
    total, goal = 0.0, 0.0
    converged = norm == 0.0
    positive = converged or _positive(rz)
    while positive and not converged and len(steps) < max_iterations:
        if time.monotonic() > deadline:
            raise OutOfTimeError
        q = matrix @ p
        pq = _dot(p, q)
        if not pq > 0.0:
            converged = positive = _dot(r, r) <= (tolerance * norm) ** 2
            break
        alpha = rz / pq
        x += alpha * p
        r -= alpha * q
        steps.append(alpha)
        falls.append(alpha * rz)
        total += falls[-1]
        z = precondition(r)
        before, rz = rz, _dot(r, z)
        goal = tolerance * tolerance * (total if energy is None else energy)
        converged = _told(falls, goal)
        if not converged and not _positive(rz):
            # nothing is left to tell the error by, or the preconditioner is not positive
            converged = positive = _dot(r, r) <= (tolerance * norm) ** 2
            break
        turns.append(rz / before)
        p = z + turns[-1] * p
    low, high = _extreme_eigenvalues(steps, turns) if steps else (1.0, 1.0)
    if not positive:
        low = 0.0
    left = right_side - matrix @ x
    residual = _dot(left, left) ** 0.5 / norm if norm else 0.0
    needed = _steps_needed(falls, goal) if converged else len(steps)
    return CgResult(x, needed, converged, residual, low, high)
