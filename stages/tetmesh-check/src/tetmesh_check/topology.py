"""Topology of triangle meshes from their connectivity alone: edges, fans, components, Euler characteristic."""

from __future__ import annotations

from dataclasses import asdict, dataclass

import numpy as np
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


def triangle_components(vertex_count: int, triangles: Cells) -> Labels:
    """Component of each triangle; triangles that share a vertex belong together.

    Parameters
    ----------
    vertex_count
        Number of vertices.
    triangles
        Vertex indices, shape ``(m, 3)``.
    """
    labels = connected_components(vertex_count, np.concatenate([triangles[:, :2], triangles[:, 1:]]))
    _, result = np.unique(labels[triangles[:, 0]], return_inverse=True)
    return result.ravel().astype(np.int64)


def measure_topology(points: Points, triangles: Cells) -> Topology:
    """Count edges, fans and components of a triangle mesh.

    Parameters
    ----------
    points
        Positions, shape ``(n, 3)``; only their number matters.
    triangles
        Vertex indices, shape ``(m, 3)``.
    """
    count = len(points)
    size = len(triangles)
    tail = triangles.ravel()
    head = np.roll(triangles, -1, axis=1).ravel()
    low, high = np.minimum(tail, head), np.maximum(tail, head)
    key = low * count + high
    order = np.argsort(key, kind="stable")
    _, start, uses = np.unique(key[order], return_index=True, return_counts=True)
    twice = start[uses == 2]
    one, other = order[twice], order[twice + 1]

    # A corner is half-edge number h = 3 * triangle + slot at its tail; its head is the next slot of the triangle.
    next_corner = np.arange(3 * size).reshape(-1, 3)[:, [1, 2, 0]].ravel()
    same_direction = tail[one] == tail[other]
    other_tail = np.where(same_direction, other, next_corner[other])
    other_head = np.where(same_direction, next_corner[other], other)
    links = np.concatenate([np.stack([one, other_tail], 1), np.stack([next_corner[one], other_head], 1)])
    fans = connected_components(3 * size, links)
    vertex_of_fan = np.zeros(int(fans.max(initial=-1)) + 1, dtype=np.int64)
    vertex_of_fan[fans] = tail
    fans_of_vertex = np.bincount(vertex_of_fan, minlength=count)
    used = int((fans_of_vertex > 0).sum())
    parts = triangle_components(count, triangles)

    return Topology(
        vertices=count,
        triangles=size,
        edges=len(uses),
        unused_vertices=count - used,
        open_edges=int((uses == 1).sum()),
        nonmanifold_edges=int((uses > 2).sum()),
        badly_oriented_edges=int(same_direction.sum()),
        nonmanifold_vertices=int((fans_of_vertex > 1).sum()),
        components=int(parts.max(initial=-1)) + 1,
        euler_characteristic=used - len(uses) + size,
    )


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
    size = len(tetrahedra)
    order, same = equal_faces(tetrahedra)
    found = _alone(order, same)
    triangles, place = outward_faces(tetrahedra, found)
    first = np.argsort(place * size + found % size)
    # face number f belongs to tetrahedron f modulo their number
    links = np.stack([order[:-1][same] % size, order[1:][same] % size], 1)
    return Boundary(triangles[:, first].T, found[first] % size, connected_components(size, links))


def outside_of_part(tetrahedra: Cells, part: Labels, on_boundary: NDArray[np.bool_]) -> tuple[Cells, Labels]:
    """Find the outside of some of the tetrahedra without looking at all their faces.

    Parameters
    ----------
    tetrahedra
        Vertex indices in VTK order, shape ``(m, 4)``.
    part
        Numbers of those that count, ascending, shape ``(p,)``.
    on_boundary
        Which vertices lie on the boundary of the whole, shape ``(n,)``.

    Returns
    -------
    tuple
        Triangles and their owners, as in :class:`Boundary`.
    """
    # a face outside the part is one of the whole's, or belongs to a tetrahedron that does not count as well
    others = np.ones(len(tetrahedra), dtype=bool)
    others[part] = False
    candidate = on_boundary.copy()
    candidate[tetrahedra[others]] = True
    faces = faces_of(tetrahedra[part])
    near = np.flatnonzero(candidate[faces[0]] & candidate[faces[1]] & candidate[faces[2]])
    order, same = _in_order([np.sort(faces[:, near], axis=0)])
    alone = near[np.sort(_alone(order, same))]
    return faces[:, alone].T, part[alone % len(part)]


def faces_of(tetrahedra: Cells) -> Cells:
    """Outward faces by rows, shape ``(3, 4 m)``: the first of every tetrahedron, then the second, and so on.

    Parameters
    ----------
    tetrahedra
        Vertex indices in VTK order, shape ``(m, 4)``.
    """
    corners = np.ascontiguousarray(tetrahedra.T)
    return np.stack([np.concatenate([corners[face[k]] for face in OUTWARD_FACES]) for k in range(3)])


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


def _alone(order: Labels, same: NDArray[np.bool_]) -> Labels:
    """Faces that are equal to no other."""
    found: Labels = order[np.concatenate([[True], ~same]) & np.concatenate([~same, [True]])]
    return found


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


def _number_rows(rows: Points | Cells) -> Labels:
    """Give equal rows of an array equal numbers, shape ``(n,)``."""
    order = np.lexsort(rows.T)
    new = (rows[order[1:]] != rows[order[:-1]]).any(axis=1)
    number = np.zeros(len(rows), dtype=np.int64)
    number[order[1:]] = np.cumsum(new)
    return number


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
    shared = len(before[0])
    if np.array_equal(after[0][:shared], before[0]):  # the same vertices first, as HXT leaves them
        triangles = np.concatenate([before[1], after[1]])
    else:
        corners = np.concatenate([mesh[0][mesh[1]].reshape(-1, 3) for mesh in (before, after)])
        triangles = _number_rows(corners).reshape(-1, 3)
    # every triangle from its smallest corner on
    turn = (np.argmin(triangles, axis=1)[:, None] + np.arange(3)) % 3
    number = _number_rows(np.take_along_axis(triangles, turn, axis=1))
    first, second = np.split(number, [len(before[1])])
    return len(np.setdiff1d(first, second)), len(np.setdiff1d(second, first))
