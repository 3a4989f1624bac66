"""Stiffness matrices and load vectors by scikit-fem, in blocks."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_matrix
from skfem import Basis, BilinearForm, ElementTetP1, ElementVector, Functional, LinearForm, MeshTet

from tetmesh_check.fem.solver import OutOfTimeError
from tetmesh_check.quality import Cells, Labels, Points, Values

BLOCK = 50_000
"""Tetrahedra that are assembled at once: about 200 MB for elasticity."""
_STIFFNESS_ORDER = 1
"""Order of quadrature of the stiffness matrices: the gradients of linear elements are constant."""
DATA_ORDER = 3
"""Order of quadrature of loads."""
ERROR_ORDER = 4
"""Order of quadrature of squared errors: that of linear elements is a square of quadratic
polynomials, to first order."""


def _unknowns(points: NDArray[np.int64]) -> NDArray[np.int64]:
    """Numbers of the unknowns at points, three for each along the last axis."""
    numbers: NDArray[np.int64] = 3 * np.repeat(points, 3, axis=-1) + np.resize(np.arange(3), 3 * points.shape[-1])
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

    def _blocks(self, vector: bool, order: int, timed: bool = True) -> Iterator[tuple[Labels, Any]]:
        """Used points and basis of each block; each block is a mesh of its own."""
        element = ElementVector(ElementTetP1()) if vector else ElementTetP1()
        for start in range(0, len(self.tetrahedra), BLOCK):
            if timed and time.monotonic() > self.deadline:
                raise OutOfTimeError
            used, local = np.unique(self.tetrahedra[start : start + BLOCK], return_inverse=True)
            mesh = MeshTet(np.ascontiguousarray(self.points[used].T), np.ascontiguousarray(local.reshape(-1, 4).T))
            yield used, Basis(mesh, element, intorder=order)

    def matrix(
        self,
        form: Callable[..., Any],
        coefficient: Callable[[Any], Any] | None = None,
        weights: Values | None = None,
    ) -> Any:
        """Assemble a bilinear form ``form(u, v, w)`` to a sparse matrix.

        Parameters
        ----------
        form
            In terms of gradients only.
        coefficient
            Of positions; the form finds its values, computed once, as ``w.coefficient``.
        weights
            One number a tetrahedron, shape ``(m,)``; the form finds them as ``w.weight``.
        """
        size = len(self.points)
        total = csr_matrix((size, size))
        for number, (used, basis) in enumerate(self._blocks(False, _STIFFNESS_ORDER)):
            known = {}
            if weights is not None:
                own = weights[number * BLOCK : (number + 1) * BLOCK, None]
                known["weight"] = np.broadcast_to(own, np.asarray(basis.dx).shape)
            if coefficient is not None:
                known["coefficient"] = coefficient(np.asarray(basis.global_coordinates()))
            local = BilinearForm(form).assemble(basis, **known).tocoo()
            total += csr_matrix((local.data, (used[local.row], used[local.col])), shape=(size, size))
        return total

    def elastic_stiffness(self, shear: float, lame: float) -> Any:
        """Assemble the stiffness matrix of isotropic linear elasticity.

        Its blocks of 3 x 3 are made of the products of the gradients of two hat functions, which
        takes a tenth of the time of a form of vector fields.

        Parameters
        ----------
        shear, lame
            Lame's parameters (mu and lambda), N/mm^2.

        Returns
        -------
        sparse matrix
            Shape ``(3 n, 3 n)``, in rows; unknown ``3 i + k`` is component k at point i.
        """
        size = 3 * len(self.points)
        total = csr_matrix((size, size))
        for used, basis in self._blocks(False, _STIFFNESS_ORDER):
            gradients = np.stack([np.asarray(function[0].grad)[:, :, 0] for function in basis.basis])
            # d/dx_k of the j-th function times d/dx_l of the i-th, over the tetrahedron
            products = np.einsum(
                "jkm,ilm,m->mijkl", gradients, gradients, np.asarray(basis.dx).sum(axis=1), optimize=True
            )
            blocks = shear * products + lame * products.swapaxes(3, 4)
            blocks += shear * np.trace(products, axis1=3, axis2=4)[..., None, None] * np.eye(3)
            corners = used[np.asarray(basis.mesh.t).T]
            rows = np.repeat(_unknowns(corners), 12, axis=1).ravel()
            columns = np.tile(_unknowns(corners), 12).ravel()
            entries = blocks.transpose(0, 1, 3, 2, 4).ravel()
            total += csr_matrix((entries, (rows, columns)), shape=(size, size))
        return total

    def load(self, form: Callable[..., Any], vector: bool = False, order: int = DATA_ORDER) -> Values:
        """Assemble a linear form ``form(v, w)`` to a vector.

        Parameters
        ----------
        form
            The form.
        vector
            Whether it is one of vector fields: entry ``3 i + k`` is then component k at point i.
        order
            Order of quadrature.
        """
        total = np.zeros((3 if vector else 1) * len(self.points))
        for used, basis in self._blocks(vector, order):
            total[_unknowns(used) if vector else used] += LinearForm(form).assemble(basis)
        return total

    def integrals(self, forms: Sequence[Callable[..., Any]], **fields: Values) -> Values:
        """Integrate each ``form(w)`` in one pass; one number a form.

        A short pass, that goes on when time is over: what it judges was computed in time.

        Parameters
        ----------
        forms
            The forms; ``w.NAME`` and its gradient belong to the field of that name.
        fields
            Values at the points, shape ``(n,)`` each.
        """
        totals = np.zeros(len(forms))
        for used, basis in self._blocks(False, ERROR_ORDER, timed=False):
            known = {name: basis.interpolate(values[used]) for name, values in fields.items()}
            totals += [Functional(form).assemble(basis, **known) for form in forms]
        return totals


def held_at_one_side(tetrahedra: Cells, heights: Values, bodies: Labels, share: float) -> NDArray[np.bool_]:
    """Mark the tetrahedra at the lower end of each body; shape ``(m,)``.

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
