"""Where the surface itself allows no good tetrahedron: facets that meet at a small angle, or lie close before each other.

A tetrahedron that stands on a facet with dihedral angles of at least X at the facet's three edges contains the *roof* of the facet: the
flat tetrahedron whose three other faces rise from its edges at X. Where another facet cuts into the roof, no tetrahedron on that side of the
facet has such angles, whoever makes it. The side is *forced*, and the largest X whose roof is free is what its tetrahedron can reach at most.
A facet with a small angle of its own forces both sides: no tetrahedron on it has large dihedral angles and a large scaled Jacobian at once.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tetmesh_check.intersections import candidate_pairs
from tetmesh_check.quality import Cells, Labels, Points, Values

INSIDE, OUTSIDE = 0, 1
"""Sides of a facet: behind it, and before it, where its normal points."""
_TOUCHING = 1e-9
"""Depth over the longest side of the facet up to which another facet only touches its roof."""
_HALVINGS = 20
"""Of the interval in which the largest angle of a free roof lies: to a millionth."""
_FLAT = 1e-12
"""Squared length of a vector product, over those of its factors, below which they are parallel."""


@dataclass(frozen=True)
class ForcedSides:
    """The sides of facets on which no tetrahedron reaches a smallest dihedral angle."""

    facet: Labels
    """Number of the facet of each, ascending, shape ``(k,)``."""
    side: Labels
    """:data:`INSIDE` or :data:`OUTSIDE`, shape ``(k,)``."""
    bound: Values
    """The largest smallest dihedral angle of a tetrahedron there, degrees, shape ``(k,)``."""

    def where(self, kept: NDArray[np.bool_]) -> ForcedSides:
        """Leave out the others; ``kept`` has the shape ``(k,)``."""
        return ForcedSides(self.facet[kept], self.side[kept], self.bound[kept])


@dataclass(frozen=True)
class _Frames:
    """Facets with what their roofs need; all by facet."""

    corners: NDArray[np.float64]
    """Shape ``(n, 3, 3)``: facet, corner, axis."""
    normal: Points
    inward: NDArray[np.float64]
    """Unit vectors in the plane of the facet, from the edge that begins at each corner to its inside, shape ``(n, 3, 3)``."""
    centre: Points
    """Of the inscribed circle, mm."""
    radius: Values
    """Of the inscribed circle, mm."""
    longest: Values
    """Longest side, mm."""

    def of(self, which: Labels) -> _Frames:
        return _Frames(*(getattr(self, name)[which] for name in self.__dataclass_fields__))


def _frames(points: Points, triangles: Cells) -> _Frames:
    corners = points[triangles]
    sides = np.roll(corners, -1, axis=1) - corners
    lengths = np.linalg.norm(sides, axis=2)
    doubled = np.cross(sides[:, 0], sides[:, 1])
    area = np.linalg.norm(doubled, axis=1)
    normal = doubled / area[:, None]
    inward = np.cross(normal[:, None, :], sides / lengths[:, :, None])
    perimeter = lengths.sum(axis=1)
    # the centre weighs each corner by the side opposite to it
    centre = np.einsum("nk,nki->ni", np.roll(lengths, -1, axis=1), corners) / perimeter[:, None]
    return _Frames(corners, normal, inward, centre, area / perimeter, lengths.max(axis=1))


def _dot(u: NDArray[np.float64], v: NDArray[np.float64]) -> NDArray[np.float64]:
    products: NDArray[np.float64] = np.einsum("...i,...i->...", u, v)
    return products


def _apart_by_faces(frames: _Frames, other: NDArray[np.float64], way: Values, slope: Values) -> NDArray[np.bool_]:
    """Whether a face of the roof has the other triangle wholly beyond it.

    ``way`` is 1 before the facet and -1 behind it, ``slope`` the tangent of the angle.
    """
    touching = (_TOUCHING * frames.longest)[:, None]
    height = way[:, None] * _dot(other - frames.corners[:, :1], frames.normal[:, None, :])
    apart = np.all(height <= touching, axis=1)
    for k in range(3):
        within = _dot(other - frames.corners[:, k : k + 1], frames.inward[:, k : k + 1])
        apart = apart | np.all(height >= slope[:, None] * within - touching, axis=1)
    return np.asarray(apart)


def _apart_by_edges(frames: _Frames, other: NDArray[np.float64], way: Values, slope: Values) -> NDArray[np.bool_]:
    """Whether the other triangle's plane, or one on an edge of each, has the two on its two sides."""
    apex = frames.centre + (way * slope * frames.radius)[:, None] * frames.normal
    roof = np.concatenate([frames.corners, apex[:, None, :]], axis=1)
    edges = np.stack([roof[:, j] - roof[:, i] for i, j in ((0, 1), (1, 2), (2, 0), (0, 3), (1, 3), (2, 3))], axis=1)
    sides = np.roll(other, -1, axis=1) - other
    axes = np.concatenate(
        [
            np.cross(sides[:, :1], sides[:, 1:2]),
            np.cross(edges[:, :, None, :], sides[:, None, :, :]).reshape(-1, 18, 3),
        ],
        axis=1,
    )
    length = np.linalg.norm(axes, axis=2)
    scale = np.square(np.linalg.norm(sides, axis=2).max(axis=1) + frames.longest)
    usable = length > np.sqrt(_FLAT) * scale[:, None]
    axes = axes / np.where(usable, length, 1.0)[:, :, None]
    own, others = np.einsum("nak,nvk->nav", axes, roof), np.einsum("nak,nvk->nav", axes, other)
    touching = (_TOUCHING * frames.longest)[:, None]
    beyond = others.min(axis=2) >= own.max(axis=2) - touching
    beyond |= others.max(axis=2) <= own.min(axis=2) + touching
    apart: NDArray[np.bool_] = (beyond & usable).any(axis=1)
    return apart


def _cut(frames: _Frames, other: NDArray[np.float64], way: Values, slope: Values) -> NDArray[np.bool_]:
    """Whether the other triangle of each pair enters the roof of the first, by the theorem of the separating axis; shape ``(k,)``."""
    hit = ~_apart_by_faces(frames, other, way, slope)
    index = np.flatnonzero(hit)
    hit[index] = ~_apart_by_edges(frames.of(index), other[index], way[index], slope[index])
    return hit


def forced_sides(points: Points, triangles: Cells, angle: float) -> ForcedSides:
    """Find the sides of facets on which every tetrahedron has a dihedral angle below a given one.

    Parameters
    ----------
    points
        Positions, mm, shape ``(n, 3)``.
    triangles
        Vertex indices, shape ``(m, 3)``; each has an area, and no two cross. The normal points to the outside of each.
    angle
        Dihedral angle, degrees, above 0 and below 60.
    """
    frames = _frames(points, triangles)
    slope = float(np.tan(np.radians(angle)))
    rise = (slope * frames.radius)[:, None] * frames.normal
    tips = np.stack([frames.centre + rise, frames.centre - rise], axis=1)
    extent = np.concatenate([frames.corners, tips], axis=1)
    found: list[NDArray[np.int64]] = []
    for pairs in candidate_pairs(extent.min(axis=1), extent.max(axis=1)):
        for first, second in ((pairs[:, 0], pairs[:, 1]), (pairs[:, 1], pairs[:, 0])):
            own, other = frames.of(first), frames.corners[second]
            for side, way in ((INSIDE, -1.0), (OUTSIDE, 1.0)):
                hit = np.flatnonzero(_cut(own, other, np.full(len(first), way), np.full(len(first), slope)))
                found.append(np.stack([2 * first[hit] + side, second[hit]], 1))
    cuts = np.concatenate([np.empty((0, 2), dtype=np.int64), *found])
    bound = _free_angles(frames, cuts, angle)
    sides, which = np.unique(cuts[:, 0], return_inverse=True)
    least = np.full(len(sides), angle)
    np.minimum.at(least, which.ravel(), bound)
    return ForcedSides(sides // 2, sides % 2, least)


def largest_jacobians(points: Points, triangles: Cells, angle: float) -> Values:
    """Give the largest scaled Jacobian of a tetrahedron on each triangle with no dihedral angle below a given one, shape ``(m,)``.

    At a corner with the angle a the third edge rises at some angle e over the triangle, and the scaled Jacobian is at most sqrt(2) sin a sin e.
    The dihedral angle d at that edge is largest where it rises over the bisector: tan(a/2) = sin e tan(d/2) in the right spherical triangle.
    So an edge that rises steeply makes the one small, and one that does not the other.

    Parameters
    ----------
    points
        Positions, mm, shape ``(n, 3)``.
    triangles
        Vertex indices, shape ``(m, 3)``; each has an area.
    angle
        Dihedral angle, degrees, below 180; with 0 all are allowed.
    """
    corners = points[triangles]
    ahead, back = np.roll(corners, -1, axis=1) - corners, np.roll(corners, 1, axis=1) - corners
    doubled = np.linalg.norm(np.cross(ahead, back), axis=2)
    product = np.linalg.norm(ahead, axis=2) * np.linalg.norm(back, axis=2)
    sine, cosine = doubled / product, _dot(ahead, back) / product
    # tan(a/2) = sin a / (1 + cos a)
    with np.errstate(divide="ignore"):
        rise = np.minimum(1.0, sine / (1.0 + cosine) / np.tan(np.radians(angle / 2.0)))
    largest: Values = (np.sqrt(2.0) * sine * rise).min(axis=1)
    return largest


def _free_angles(frames: _Frames, cuts: NDArray[np.int64], angle: float) -> Values:
    """The largest angle, degrees, whose roof each cut leaves free.

    ``cuts`` are twice the facet plus the side, and the facet that enters, shape ``(k, 2)``.
    """
    own, other = frames.of(cuts[:, 0] // 2), frames.corners[cuts[:, 1]]
    way = np.where(cuts[:, 0] % 2 == OUTSIDE, 1.0, -1.0)
    low, high = np.zeros(len(cuts)), np.full(len(cuts), angle)
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        hit = _cut(own, other, way, np.tan(np.radians(middle)))
        low, high = np.where(hit, low, middle), np.where(hit, middle, high)
    return high
