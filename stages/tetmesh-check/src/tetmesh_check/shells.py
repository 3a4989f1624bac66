"""The volumes that a surface of many materials bounds, from its triangles alone.

Each triangle has two sides, one in each of its materials. Round an edge the triangles follow each other by their angle, and the wedge
between two of them joins a side of the one with a side of the other. Sides that hang together through wedges are a shell: a closed
oriented surface that bounds one connected part of one material from outside, or a cavity of it. Where a material touches itself along
an edge only, the wedges keep its parts asunder.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tetmesh_check.components import component_volumes, generic_rotation, ray_crossings
from tetmesh_check.materials import NOTHING, Sides
from tetmesh_check.quality import Cells, Labels, Points, Values
from tetmesh_check.topology import connected_components


@dataclass(frozen=True)
class Edges:
    """The edges of a triangle mesh, with the half-edges on each."""

    low: Labels
    """Lower vertex of each edge, shape ``(e,)``."""
    high: Labels
    """Higher vertex, shape ``(e,)``."""
    uses: Labels
    """Triangles on each edge, shape ``(e,)``."""
    of: Labels
    """Edge of each half-edge, shape ``(3 m,)``; half-edge ``3 t + k`` goes from corner k of triangle t to the next."""
    forward: NDArray[np.bool_]
    """Whether each half-edge goes from the lower to the higher vertex, shape ``(3 m,)``."""


def edges_of(count: int, triangles: Cells) -> Edges:
    """Find the edges of a triangle mesh.

    Parameters
    ----------
    count
        Number of vertices.
    triangles
        Vertex indices, shape ``(m, 3)``.
    """
    tail, head = triangles.ravel(), np.roll(triangles, -1, axis=1).ravel()
    key = np.minimum(tail, head) * count + np.maximum(tail, head)
    unique, of, uses = np.unique(key, return_inverse=True, return_counts=True)
    return Edges(unique // count, unique % count, uses, of.ravel().astype(np.int64), tail < head)


def unbalanced_edges(edges: Edges, sides: Sides) -> dict[int, int]:
    """Count for each material the edges at which its facets do not close: those that go one way are not as many as those that go the other.

    Parameters
    ----------
    edges
        Those of the surface.
    sides
        The materials of its triangles.

    Returns
    -------
    dict
        Number of the material to number of edges; only those that have any, so that it is empty for a complex that bounds volumes.
    """
    way = np.where(edges.forward, 1, -1)
    count = len(edges.uses)
    materials = np.concatenate([np.repeat(sides.inside, 3), np.repeat(sides.outside, 3)])
    keys, which = np.unique(materials * count + np.tile(edges.of, 2), return_inverse=True)
    balance = np.bincount(which.ravel(), weights=np.concatenate([way, -way]))
    wrong, number = np.unique(keys[balance != 0] // count, return_counts=True)
    return dict(zip(wrong.tolist(), number.tolist(), strict=True))


def _angles(points: Points, triangles: Cells, edges: Edges) -> Values:
    """Angle round its edge of the triangle of each half-edge, radians; by the right hand from the lower to the higher vertex."""
    start = points[edges.low]
    axis = points[edges.high] - start
    axis /= np.linalg.norm(axis, axis=1, keepdims=True)
    # any direction across the axis will do for zero, if it is the same for all triangles of an edge
    first = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis), axis=1)])
    second = np.cross(axis, first)
    out = points[np.roll(triangles, -2, axis=1).ravel()] - start[edges.of]
    angles: Values = np.arctan2(
        np.einsum("ij,ij->i", out, second[edges.of]), np.einsum("ij,ij->i", out, first[edges.of])
    )
    return angles


@dataclass(frozen=True)
class Wedges:
    """What lies between triangles that follow each other round an edge, one for each half-edge."""

    ahead: Labels
    """Side of the triangle before the wedge, shape ``(3 m,)``; side ``2 t`` of triangle t is its inside, ``2 t + 1`` its outside."""
    behind: Labels
    """Side of the triangle after it."""
    angle: Values
    """How wide it is, degrees, above 0 and up to 360."""


def wedges_of(points: Points, triangles: Cells, edges: Edges) -> Wedges:
    """Find the wedges round all edges.

    Parameters
    ----------
    points
        Positions, mm, shape ``(n, 3)``.
    triangles
        Vertex indices, shape ``(m, 3)``.
    edges
        Those of the triangles.
    """
    angle = _angles(points, triangles, edges)
    order = np.lexsort((angle, edges.of))
    # the one after each half-edge round its edge
    ends = np.cumsum(edges.uses)
    following = np.arange(1, len(order) + 1)
    following[ends - 1] = ends - edges.uses
    after = order[following]
    # a triangle that goes along the edge has its outside ahead of it, at the larger angles
    ahead = 2 * (order // 3) + edges.forward[order]
    behind = 2 * (after // 3) + ~edges.forward[after]
    width = np.degrees(angle[after] - angle[order])
    return Wedges(ahead, behind, np.where(width <= 0.0, width + 360.0, width))


@dataclass(frozen=True)
class Shells:
    """The volumes of a surface of many materials."""

    materials: Labels
    """Material of each volume, shape ``(v,)``, ascending."""
    sizes: Values
    """Size of each volume, mm^3, cavities taken off, shape ``(v,)``."""
    of_inside: Labels
    """Volume behind each triangle, shape ``(m,)``."""
    of_outside: Labels
    """Volume before it, shape ``(m,)``; where there is no material below 0, another number for each shell of the outside."""
    mixed: int
    """Wedges between sides of different materials: at such an edge the order of the triangles contradicts their materials."""
    narrowest: dict[int, float]
    """Smallest wedge of each material but the outside, degrees: no tetrahedron there has a wider smallest dihedral angle."""
    inside_out: int
    """Shells that bound a cavity which lies in no volume of its material: turned the wrong way round."""

    def sheets(self) -> tuple[Cells, Labels]:
        """Pairs of volumes that touch, shape ``(s, 2)``, and the pair of each triangle, shape ``(m,)``.

        Neither two volumes nor two hollows have the same sheets round them.
        """
        pairs, which = np.unique(np.stack([self.of_inside, self.of_outside], 1), axis=0, return_inverse=True)
        return pairs, which.ravel().astype(np.int64)


def measure_shells(points: Points, triangles: Cells, sides: Sides, edges: Edges) -> Shells:
    """Find the volumes that the triangles bound.

    Parameters
    ----------
    points
        Positions, mm, shape ``(n, 3)``.
    triangles
        Vertex indices, shape ``(m, 3)``; every material's facets close (:func:`unbalanced_edges`) and no two cross.
    sides
        The materials of the triangles.
    edges
        Those of the triangles.
    """
    material_of_side = np.stack([sides.inside, sides.outside], 1).ravel()
    wedges = wedges_of(points, triangles, edges)
    of_wedge = material_of_side[wedges.ahead]
    mixed = int((of_wedge != material_of_side[wedges.behind]).sum())
    narrowest = np.full(len(sides.table), np.inf)
    np.minimum.at(narrowest, of_wedge, wedges.angle)
    shell = connected_components(2 * len(triangles), np.stack([wedges.ahead, wedges.behind], 1))
    count = int(shell.max(initial=-1)) + 1
    material = np.zeros(count, dtype=np.int64)
    material[shell] = material_of_side
    # each side as a triangle that points out of its material
    facets = np.stack([triangles, triangles[:, [0, 2, 1]]], 1).reshape(-1, 3)
    size = component_volumes(points, facets, shell)

    outer = np.flatnonzero((size > 0) & (material != NOTHING))
    outer = outer[np.argsort(material[outer], kind="stable")]
    volume = np.full(count, -1, dtype=np.int64)
    volume[outer] = np.arange(len(outer))
    cavities = np.flatnonzero((size <= 0) & (material != NOTHING))
    if len(cavities):
        parent = _parents(points, facets, shell, material, size, cavities)
        volume[cavities] = np.where(parent >= 0, volume[parent], -1)
    # Gmsh tells hollows, too, by their sheets
    beyond = np.zeros(count, dtype=np.int64)
    beyond[material == NOTHING] = np.arange(int((material == NOTHING).sum()))
    known = volume >= 0
    total: Values = np.bincount(volume[known], weights=size[known], minlength=len(outer)).astype(np.float64)
    lost = int((volume[cavities] < 0).sum())
    return Shells(
        materials=material[outer],
        sizes=total,
        of_inside=volume[shell[0::2]],
        of_outside=np.where(sides.outside == NOTHING, -1 - beyond[shell[1::2]], volume[shell[1::2]]),
        mixed=mixed,
        narrowest={number: float(narrowest[number]) for number in sides.present},
        inside_out=lost,
    )


def _parents(points: Points, facets: Cells, shell: Labels, material: Labels, size: Values, cavities: Labels) -> Labels:
    """For each cavity the smallest shell of its material round it, -1 where there is none; shape ``(c,)``."""
    turned = points @ generic_rotation().T
    around = np.flatnonzero((size > 0)[shell] & np.isin(material[shell], material[cavities]))
    first = np.full(len(material), -1, dtype=np.int64)
    first[shell[::-1]] = np.arange(len(shell))[::-1]
    # the middle of a facet of a cavity lies on no other facet of its material
    starts = turned[facets[first[cavities]]].mean(axis=1)
    rays, hit, way = ray_crossings(starts, turned[facets[around]])
    outer = shell[around[hit]]
    same = material[outer] == material[cavities[rays]]
    pairs, which = np.unique(rays[same] * len(material) + outer[same], return_inverse=True)
    crossed = np.bincount(which.ravel(), weights=way[same], minlength=len(pairs))
    ray, outer = np.divmod(pairs[crossed != 0], len(material))
    parents = np.full(len(cavities), -1, dtype=np.int64)
    order = np.argsort(-size[outer], kind="stable")
    parents[ray[order]] = outer[order]
    return parents
