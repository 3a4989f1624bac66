"""Stiffness matrices and load vectors on tetrahedra with linear elements, by scikit-fem, in blocks of bounded memory."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_matrix
from skfem import Basis, BilinearForm, ElementTetP1, ElementVector, Functional, LinearForm, MeshTet

from tetmesh_check.krylov import OutOfTimeError
from tetmesh_check.quality import Cells, Labels, Points, Values

BLOCK = 50_000
"""Tetrahedra that are assembled at once: about 200 MB for elasticity."""
_STIFFNESS_ORDER = 1
"""Order of quadrature of the stiffness matrices: the gradients of linear elements are constant."""
DATA_ORDER = 3
"""Order of quadrature of loads and errors."""


def _unknowns(points: Labels) -> Labels:
    """Numbers of the three unknowns at each of some points."""
    numbers: Labels = (3 * points[:, None] + np.arange(3)).ravel()
    return numbers


class Assembler:
    """The tetrahedra as scikit-fem sees them.

    Parameters
    ----------
    points
        Positions, mm, shape ``(n, 3)``.
    tetrahedra
        Vertex indices, shape ``(m, 4)``; every point is in use.
    deadline
        When time is over, by the monotonic clock, s.
    """

    def __init__(self, points: Points, tetrahedra: Cells, deadline: float = float("inf")) -> None:
        self.points = points
        self.tetrahedra = tetrahedra
        self.deadline = deadline

    def _blocks(self, vector: bool, order: int) -> Iterator[tuple[Labels, Any]]:
        """Points in use and basis of one block after the other; to scikit-fem each is a mesh of its own."""
        element = ElementVector(ElementTetP1()) if vector else ElementTetP1()
        for start in range(0, len(self.tetrahedra), BLOCK):
            if time.monotonic() > self.deadline:
                raise OutOfTimeError
            used, local = np.unique(self.tetrahedra[start : start + BLOCK], return_inverse=True)
            mesh = MeshTet(np.ascontiguousarray(self.points[used].T), np.ascontiguousarray(local.reshape(-1, 4).T))
            yield used, Basis(mesh, element, intorder=order)

    def matrix(self, form: Callable[..., Any], vector: bool = False) -> Any:
        """Assemble a bilinear form ``form(u, v, w)`` to a sparse matrix.

        Parameters
        ----------
        form
            In terms of gradients only.
        vector
            Whether it is one of vector fields: unknown ``3 i + k`` is then component k at point i.
        """
        size = (3 if vector else 1) * len(self.points)
        parts = []
        for used, basis in self._blocks(vector, _STIFFNESS_ORDER):
            local = BilinearForm(form).assemble(basis).tocoo()
            place = _unknowns(used) if vector else used
            parts.append(csr_matrix((local.data, (place[local.row], place[local.col])), shape=(size, size)))
        while len(parts) > 1:  # in pairs, so that every entry is added a few times only
            parts = [sum(parts[k + 1 : k + 2], parts[k]) for k in range(0, len(parts), 2)]
        return parts[0]

    def load(self, form: Callable[..., Any], vector: bool = False, order: int = DATA_ORDER) -> Values:
        """Assemble a linear form ``form(v, w)`` to a vector.

        Parameters
        ----------
        form
            The form.
        vector
            See :meth:`matrix`.
        order
            Order of quadrature.
        """
        total = np.zeros((3 if vector else 1) * len(self.points))
        for used, basis in self._blocks(vector, order):
            total[_unknowns(used) if vector else used] += LinearForm(form).assemble(basis)
        return total

    def integrals(self, forms: Sequence[Callable[..., Any]], **fields: Values) -> Values:
        """Integrate each ``form(w)`` in one pass; one number a form.

        Parameters
        ----------
        forms
            The forms; ``w.NAME`` and its gradient belong to the field of that name.
        fields
            Values at the points, shape ``(n,)`` each.
        """
        totals = np.zeros(len(forms))
        for used, basis in self._blocks(False, DATA_ORDER):
            known = {name: basis.interpolate(values[used]) for name, values in fields.items()}
            totals += [Functional(form).assemble(basis, **known) for form in forms]
        return totals


def held_at_one_side(tetrahedra: Cells, heights: Values, bodies: Labels, share: float) -> NDArray[np.bool_]:
    """Mark the tetrahedra at the lower end of every body, so that none can move or turn; shape ``(m,)``.

    Parameters
    ----------
    tetrahedra
        Vertex indices, shape ``(m, 4)``.
    heights
        Of every point, mm, shape ``(n,)``.
    bodies
        Body of each tetrahedron, shape ``(m,)``, numbered from 0.
    share
        Tetrahedra with a vertex in this share of the height of their body are held.
    """
    lowest = heights[tetrahedra].min(axis=1)
    low = np.full(int(bodies.max()) + 1, np.inf)
    high = np.full(len(low), -np.inf)
    np.minimum.at(low, bodies, lowest)
    np.maximum.at(high, bodies, heights[tetrahedra].max(axis=1))
    held: NDArray[np.bool_] = lowest <= (low + share * (high - low))[bodies]
    return held
