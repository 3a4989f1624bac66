"""Connected components of a closed surface: their volumes, and which lies in which."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tetmesh_check.quality import Cells, Labels, Points, Values
from tetmesh_check.topology import triangle_components

_CHUNK_PAIRS = 1 << 22


@dataclass(frozen=True)
class Components:
    """The components of a closed surface.

    A component that lies in the open, or in a cavity, bounds a body from outside and must have a positive volume; one
    that lies in a body bounds a cavity and must have a negative one.
    """

    labels: Labels
    """Component of each triangle, numbered from 0."""
    volumes: Values
    """Signed volume of each component, mm^3."""
    depths: Labels
    """How many others enclose each component."""
    parents: Labels
    """The innermost of them, -1 where there is none."""

    def inside_out(self) -> Labels:
        """Numbers of the components that are turned the wrong way round."""
        outer = self.depths % 2 == 0
        wrong: Labels = np.flatnonzero(np.where(outer, self.volumes <= 0, self.volumes >= 0))
        return wrong

    def bodies(self) -> Labels:
        """For each component the number of the one that bounds its body from outside: itself, or a cavity's parent."""
        bodies: Labels = np.where(self.depths % 2 == 0, np.arange(len(self.depths)), self.parents)
        return bodies


def component_volumes(points: Points, triangles: Cells, labels: Labels) -> Values:
    """Signed volume of each component, mm^3.

    Parameters
    ----------
    points
        Positions, mm, shape ``(n, 3)``.
    triangles
        Vertex indices, shape ``(m, 3)``.
    labels
        Component of each triangle, shape ``(m,)``.
    """
    centred = points - points.mean(axis=0)
    a, b, c = (centred[triangles[:, k]] for k in range(3))
    volumes: Values = np.bincount(labels, weights=np.einsum("ij,ij->i", a, np.cross(b, c)) / 6.0).astype(np.float64)
    return volumes


def generic_rotation() -> Points:
    """Build a rotation without any relation to the axes, so that rays do not run along rows of vertices."""
    rotation, _ = np.linalg.qr(np.array([[0.36, 0.48, -0.8], [-0.81, 0.57, 0.13], [0.52, 0.64, 0.57]]))
    return np.asarray(rotation)


def ray_crossings(starts: Points, corners: Points) -> tuple[Labels, Labels, Labels]:
    """Crossings of the rays from some points along +x with triangles, shape ``(m, 3, 3)``.

    Returns
    -------
    tuple
        Number of the ray, number of the triangle, and on which side it is hit: 1 where the ray leaves, -1 where it enters.
    """
    by_y = np.argsort(starts[:, 1], kind="stable")
    low, high = corners.min(axis=1), corners.max(axis=1)
    # rays whose y lies within a triangle's follow each other in that order
    first = np.searchsorted(starts[by_y, 1], low[:, 1], side="left")
    count = np.searchsorted(starts[by_y, 1], high[:, 1], side="right") - first
    ends = np.cumsum(count)
    found: list[tuple[Labels, Labels, Labels]] = []
    begin = 0
    while begin < len(corners):
        done = ends[begin - 1] if begin else 0
        end = max(begin + 1, int(np.searchsorted(ends, done + _CHUNK_PAIRS, side="right")))
        size = count[begin:end]
        triangle = np.repeat(np.arange(begin, end), size)
        offset = np.arange(len(triangle)) - np.repeat(np.cumsum(size) - size, size)
        ray = by_y[first[triangle] + offset]
        begin = end

        z = starts[ray, 2]
        near = (low[triangle, 2] <= z) & (high[triangle, 2] >= z) & (high[triangle, 0] >= starts[ray, 0])
        triangle, ray = triangle[near], ray[near]
        x, y, z = starts[ray].T
        a, b, c = (corners[triangle, k] for k in range(3))
        s = [(q[:, 1] - y) * (r[:, 2] - z) - (q[:, 2] - z) * (r[:, 1] - y) for q, r in ((b, c), (c, a), (a, b))]
        area = s[0] + s[1] + s[2]
        through = ((s[0] > 0) & (s[1] > 0) & (s[2] > 0)) | ((s[0] < 0) & (s[1] < 0) & (s[2] < 0))
        weight = np.where(through, area, 1.0)
        at = (s[0] * a[:, 0] + s[1] * b[:, 0] + s[2] * c[:, 0]) / weight
        hit = through & (at > x)
        found.append((ray[hit], triangle[hit], np.sign(area[hit]).astype(np.int64)))
    rays, triangles, sides = (np.concatenate(parts) for parts in zip(*found, strict=True))
    return rays, triangles, sides


def measure_components(points: Points, triangles: Cells) -> Components:
    """Find the components of a closed surface, and which lies in which.

    Parameters
    ----------
    points
        Positions, mm, shape ``(n, 3)``.
    triangles
        Vertex indices of a closed surface, shape ``(m, 3)``; components do not cut through each other.
    """
    labels = triangle_components(len(points), triangles)
    volumes = component_volumes(points, triangles, labels)
    count = len(volumes)
    depths = np.zeros(count, dtype=np.int64)
    parents = np.full(count, -1, dtype=np.int64)
    if count > 1:
        turned = points @ generic_rotation().T
        first_triangle = np.unique(labels, return_index=True)[1]
        rays, hit, sides = ray_crossings(turned[triangles[first_triangle, 0]], turned[triangles])
        # a ray that starts outside a component leaves it as often as it enters
        pairs, which = np.unique(rays * count + labels[hit], return_inverse=True)
        inner, outer = np.divmod(pairs[np.bincount(which.ravel(), weights=sides) != 0], count)
        inner, outer = inner[inner != outer], outer[inner != outer]
        depths += np.bincount(inner, minlength=count)
        # enclosing components lie in each other: the largest first, so that the smallest is what stays
        order = np.argsort(-np.abs(volumes[outer]), kind="stable")
        parents[inner[order]] = outer[order]
    return Components(labels, volumes, depths, parents)
