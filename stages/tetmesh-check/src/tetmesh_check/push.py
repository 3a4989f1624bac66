"""Moves nodes along the normals of their triangles, and the nodes nearby with them.

A node moves by the vector d whose component along the normal of each adjacent triangle is a given
height (least squares). Two systems of such equations are solved in turn: the second determines d
only in the directions that the first leaves free. Gaps (:mod:`.gap`) and prism layers
(:mod:`.layers`) use this module.
"""

from __future__ import annotations

import numpy as np

from tetmesh_check.quality import Cells, Labels, Points, Values

SHARP = np.cos(np.radians(8.0))
"""Cosine of the maximum angle between the normals of a node and of its triangles, where distances
are checked. At such an edge, two sides are 1 / cos(8 degrees) = 1.01 times as far apart as beside
it. If the mean of both distances is right, each is within 0.5 %."""
NOISE = 1.0 - SHARP**2
"""Minimum mean square of the normals' components along a direction in which they determine the
movement of a node: sin^2 of the angle of :data:`SHARP`."""
FOLLOWER_RINGS = 4
"""Rings of elements around moved nodes that follow. In the ball of ``test_gap.py`` with a gap of
0.8 mm, the minimum dihedral angle is 13.4 degrees with 0 rings, 17.9 with 2, and 19.3 with 4 and
8."""
_SWEEPS = 60
"""Sweeps of Jacobi's method for these nodes. Each multiplies the error in :data:`FOLLOWER_RINGS`
rings by at most cos(pi / 5) = 0.81, so all of them by less than 1e-5."""

System = tuple[Points, Points]
"""The normal equations of each node: matrices, shape ``(n, 3, 3)`` and trace 1, and right sides."""


def normals_of(points: Points, triangles: Cells) -> tuple[Points, Points]:
    """Return the unit normals of triangles, and their angles, shape ``(m, 3)``."""
    corners = points[triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    edges = np.roll(corners, -1, axis=1) - corners
    edges /= np.linalg.norm(edges, axis=2, keepdims=True)
    angles = np.arccos(np.clip(-np.einsum("mij,mij->mi", edges, np.roll(edges, 1, axis=1)), -1.0, 1.0))
    return normals / np.linalg.norm(normals, axis=1, keepdims=True), angles


def normal_system(
    points: Points, triangles: Cells, nodes: Labels, heights: Values, planes: Points | None = None
) -> System:
    """Return the equations d . normal = height of the triangles at each node, weighted by angle.

    Parameters
    ----------
    points, triangles
        The triangles.
    nodes
        The nodes, ascending.
    heights
        Height of each triangle, mm.
    planes
        Normals to use instead of those of the triangles.
    """
    touching = np.flatnonzero(np.isin(triangles, nodes).any(axis=1))
    corners = triangles[touching]
    normals, angles = normals_of(points, corners)
    if planes is not None:
        normals = planes[touching]
    triangle, corner = np.nonzero(np.isin(corners, nodes))
    at, normal = np.searchsorted(nodes, corners[triangle, corner]), normals[triangle]
    weighted = angles[triangle, corner][:, None] * normal
    matrices, right = np.zeros((len(nodes), 3, 3)), np.zeros((len(nodes), 3))
    np.add.at(matrices, at, weighted[:, :, None] * normal[:, None, :])
    np.add.at(right, at, heights[touching][triangle][:, None] * weighted)
    weights = np.maximum(np.trace(matrices, axis1=1, axis2=2), 1e-300)[:, None]
    return matrices / weights[:, :, None], right / weights


def _solve_known(matrices: Points, right: Points, least: float) -> tuple[Points, Points]:
    """Solve symmetric 3x3 systems in the directions whose eigenvalue is above ``least``.

    Returns the solutions, and the projections on the other directions, shape ``(n, 3, 3)``.
    """
    values, vectors = np.linalg.eigh(matrices)
    is_known = values > least
    inverse = np.divide(1.0, values, out=np.zeros_like(values), where=is_known)
    solution = np.einsum("nij,nj,nkj,nk->ni", vectors, inverse, vectors, right)
    return solution, np.einsum("nij,nj,nkj->nik", vectors, (~is_known).astype(float), vectors)


def solve_in_turn(first: System, second: System, leasts: tuple[float, float]) -> Points:
    """Return the vectors that satisfy the first system, and the second one as far as it allows.

    ``leasts`` are the minimum eigenvalues of the directions that each system determines.
    """
    vectors, free = _solve_known(*first, leasts[0])
    matrices, right = second
    pull = np.einsum("nij,nj->ni", free, right - np.einsum("njk,nk->nj", matrices, vectors))
    return vectors + _solve_known(free @ matrices @ free, pull, leasts[1])[0]


class Followers:
    """The nodes near moved nodes. Each moves by the weighted mean movement of its neighbours.

    Parameters
    ----------
    points, tetrahedra
        The mesh before the movement.
    moved, fixed
        Nodes whose movement is given, and nodes that stay.
    planes
        Unit normal of the plane in which each node stays, shape ``(n, 3)``; 0 for a free node.
    """

    def __init__(
        self, points: Points, tetrahedra: Cells, moved: Labels, fixed: Labels, planes: Points | None = None
    ) -> None:
        is_near = np.zeros(len(points), dtype=bool)
        is_near[moved] = True
        for _ in range(FOLLOWER_RINGS):
            is_near[tetrahedra[is_near[tetrahedra].any(axis=1)]] = True
        cells = tetrahedra[is_near[tetrahedra].any(axis=1)]
        pairs = cells[:, [[0, 1], [0, 2], [0, 3], [1, 2], [1, 3], [2, 3]]].reshape(-1, 2)
        edges = np.unique(np.sort(pairs, axis=1), axis=0)
        is_near[fixed] = is_near[moved] = False
        both = np.concatenate([edges, edges[:, ::-1]])
        self.points, self.is_near, self.planes = points, is_near, planes
        self.start, self.end = both[is_near[both[:, 0]]].T
        self.weights = 1.0 / np.linalg.norm(points[self.start] - points[self.end], axis=1)

    def follow(self, points: Points) -> Points:
        """Return the positions of all nodes, given those of the moved ones."""
        count = len(points)
        total = np.maximum(np.bincount(self.start, self.weights, count), 1e-300)
        shift = points - self.points
        for _ in range(_SWEEPS):
            sums = [np.bincount(self.start, self.weights * shift[self.end, axis], count) / total for axis in range(3)]
            mean = np.stack(sums, axis=1)
            if self.planes is not None:
                mean -= np.einsum("ij,ij->i", mean, self.planes)[:, None] * self.planes
            shift = np.where(self.is_near[:, None], mean, shift)
        result: Points = self.points + shift
        return result
