"""Topology of triangle meshes and of tetrahedra, from their connectivity alone. The Rust code computes it."""

from __future__ import annotations

from dataclasses import asdict, dataclass

import numpy as np
from isoparticles import _native
from numpy.typing import NDArray
from scipy.sparse import coo_matrix, csgraph

from tetmesh_check.quality import OUTWARD_FACES, Cells, Labels, Points


def connected_components(count: int, links: Cells) -> Labels:
    """Number the connected components of a graph.

    Parameters
    ----------
    count
        Number of nodes.
    links
        Pairs of nodes, shape ``(m, 2)``.

    Returns
    -------
    ndarray
        Component of each node, shape ``(count,)``, numbered from 0 by first appearance.
    """
    graph = coo_matrix((np.ones(len(links), dtype=np.int32), (links[:, 0], links[:, 1])), shape=(count, count))
    labels: Labels = csgraph.connected_components(graph, directed=False)[1].astype(np.int64)
    return labels


def members_of(labels: Labels, count: int) -> list[Labels]:
    """Indices of the members of each group, ascending; one array a group.

    Parameters
    ----------
    labels
        Group of each, from 0 on.
    count
        Number of groups.
    """
    order = np.argsort(labels, kind="stable")
    return np.split(order, np.searchsorted(labels[order], np.arange(1, count)))


_KEY_BITS = 63
"""Of a number that a face is sorted by. Two of its vertices (up to 2^31) are in it whole, and of the third as much as there is room for."""
_WITHOUT = ((1, 2, 3), (0, 2, 3), (0, 1, 3), (0, 1, 2))
"""The corners of a tetrahedron without one of them."""
_FACE_WITHOUT = np.array([2, 3, 1, 0])
"""Which of :data:`.OUTWARD_FACES` each corner is not on."""


@dataclass(frozen=True)
class Topology:
    """Counts that say whether a triangle mesh is a closed oriented surface."""

    vertices: int
    triangles: int
    edges: int
    unused_vertices: int
    open_edges: int
    """Edges with one triangle."""
    nonmanifold_edges: int
    """Edges with three or more triangles."""
    badly_oriented_edges: int
    """Edges whose two triangles disagree on which side is out."""
    nonmanifold_vertices: int
    """Vertices round which the triangles form more than one fan."""
    components: int
    euler_characteristic: int
    """Vertices in use minus edges plus triangles: 2 for each sphere, 0 for a torus."""

    @property
    def is_closed_manifold(self) -> bool:
        """Whether the mesh is a closed, oriented 2-manifold."""
        return not (self.open_edges or self.nonmanifold_edges or self.badly_oriented_edges or self.nonmanifold_vertices)

    def as_dict(self) -> dict[str, int]:
        """Write the counts for the report."""
        return asdict(self)


def measure_topology(points: Points, triangles: Cells) -> Topology:
    """Count edges, fans and components of a triangle mesh.

    Parameters
    ----------
    points
        Positions, shape ``(n, 3)``; only their number matters.
    triangles
        Vertex indices, shape ``(m, 3)``.
    """
    return Topology(**_native.surface_topology(len(points), triangles))


@dataclass(frozen=True)
class Boundary:
    """The outside of a volume mesh."""

    triangles: Cells
    """Those that belong to one tetrahedron only, wound to point out of positive ones, shape ``(k, 3)``."""
    owners: Labels
    """The tetrahedron of each, shape ``(k,)``."""
    bodies: Labels
    """Body of each tetrahedron, shape ``(m,)``, numbered from 0; bodies hang together through faces."""


def tetrahedron_boundary(tetrahedra: Cells) -> Boundary:
    """Find the boundary of a volume mesh, and its bodies.

    Parameters
    ----------
    tetrahedra
        Vertex indices in VTK order, shape ``(m, 4)``.
    """
    return Boundary(*_native.tetrahedron_boundary(int(tetrahedra.max(initial=-1)) + 1, tetrahedra))


def outward_faces(tetrahedra: Cells, numbers: Labels) -> tuple[Cells, Labels]:
    """Give faces by the numbers that :func:`equal_faces` gives them.

    Parameters
    ----------
    tetrahedra
        Vertex indices in VTK order, shape ``(m, 4)``.
    numbers
        Those of the faces, shape ``(k,)``.

    Returns
    -------
    tuple
        Their vertices by rows, wound to point out of positive tetrahedra, shape ``(3, k)``, and which of :data:`.OUTWARD_FACES` each is.
    """
    own = tetrahedra[numbers % len(tetrahedra)]
    left_out = np.take_along_axis(np.argsort(own, axis=1), (numbers // len(tetrahedra))[:, None], axis=1)
    place = _FACE_WITHOUT[left_out[:, 0]]
    return np.take_along_axis(own, np.array(OUTWARD_FACES)[place], axis=1).T, place


def equal_faces(tetrahedra: Cells, triangles: Cells | None = None) -> tuple[Labels, NDArray[np.bool_]]:
    """Find an order of faces in which equal ones follow each other.

    Face ``k m + t`` is that of tetrahedron ``t`` without its vertex that is the ``k``-th by number, and face ``4 m + i`` is triangle ``i``.

    Parameters
    ----------
    tetrahedra
        Vertex indices, shape ``(m, 4)``.
    triangles
        Others beside their faces, shape ``(n, 3)``.

    Returns
    -------
    tuple
        The order, shape ``(4 m + n,)``, and whether each but the last is equal to the one after it.
    """
    corners = np.sort(tetrahedra.astype(np.int32 if tetrahedra.max(initial=0) < 1 << 31 else np.int64), axis=1).T
    faces = [corners[list(kept)] for kept in _WITHOUT]
    return _in_order(faces if triangles is None else [*faces, np.sort(triangles, axis=1).T])


def _in_order(faces: list[Cells]) -> tuple[Labels, NDArray[np.bool_]]:
    """As :func:`equal_faces`, of several arrays ``(3, n)`` of ascending columns."""
    width = max(int(part.max(initial=0)).bit_length() for part in faces)
    rest = min(width, max(0, _KEY_BITS - 2 * width))
    key = np.empty(sum(part.shape[1] for part in faces), dtype=np.int64)
    start = 0
    for low, middle, high in faces:
        own = key[start : start + len(low)]
        own[:] = low
        for more, bits in ((middle, width), (high & ((1 << rest) - 1), rest)):
            own <<= bits
            own |= more
        start += len(low)
    order = np.argsort(key)
    key = key[order]
    same = key[1:] == key[:-1]
    if rest < width:
        last = np.concatenate([part[2] for part in faces])[order]
        differ = last[1:] != last[:-1]
        mixed = np.flatnonzero(same & differ)
        if len(mixed):
            # those whose keys are equal by chance, in order among themselves
            run = np.concatenate([[0], np.cumsum(~same)])
            at = np.flatnonzero(np.isin(run, run[mixed]))
            inner = at[np.lexsort((last[at], run[at]))]
            order[at], last[at] = order[inner], last[inner]
            differ = last[1:] != last[:-1]
        same &= ~differ
    return order, same


def changed_triangles(before: tuple[Points, Cells], after: tuple[Points, Cells]) -> tuple[int, int]:
    """Compare two triangle meshes by the coordinates of their corners, bit for bit, and by their winding.

    Parameters
    ----------
    before, after
        Points and triangles of the two meshes; no two vertices of one lie on each other.

    Returns
    -------
    tuple
        How many triangles of the first are not in the second, and the other way round.
    """
    missing, added = _native.changed_triangles(*before, *after)
    return missing, added
