"""Pairs of triangles of one surface that cut through each other.

Broad phase: the triangles in Morton order form an implicit binary tree of boxes, and pairs of overlapping boxes are
refined from the root down, many pairs at once, so that strongly graded meshes cost no more than uniform ones. Narrow
phase: two triangles cross when an edge of one passes through the other. A vertex that only touches does not count.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tetmesh_check.quality import Cells, Points, Values

_CHUNK_PAIRS = 1 << 19
_RELATIVE_TOLERANCE = 1e-13
"""A tetrahedron this flat, relative to the product of its edge vectors, counts as degenerate (touching)."""


def morton_order(centres: Points) -> NDArray[np.int64]:
    """Order in which points that are near each other in space lie near each other in the list.

    Parameters
    ----------
    centres
        Positions, shape ``(n, 3)``.
    """
    low = centres.min(axis=0)
    extent = max(float((centres.max(axis=0) - low).max()), 1e-300)
    cells = ((centres - low) / extent * 0xFFFFF).astype(np.uint64)
    code = np.zeros(len(centres), dtype=np.uint64)
    for bit in range(20):
        for axis in range(3):
            code |= ((cells[:, axis] >> np.uint64(bit)) & np.uint64(1)) << np.uint64(3 * bit + axis)
    return np.argsort(code, kind="stable")


def _candidate_pairs(low: Points, high: Points) -> list[Cells]:
    """Pairs of boxes that overlap, each pair once, as chunks of shape ``(k, 2)``."""
    count = len(low)
    order = morton_order(0.5 * (low + high))
    depth = max(int(np.ceil(np.log2(max(count, 1)))), 0)
    padded = 1 << depth
    # Level d holds 2^d boxes; the missing leaves are empty boxes that overlap nothing.
    lows = [np.full((padded, 3), np.inf)]
    highs = [np.full((padded, 3), -np.inf)]
    lows[0][:count], highs[0][:count] = low[order], high[order]
    for _ in range(depth):
        lows.insert(0, np.minimum(lows[0][0::2], lows[0][1::2]))
        highs.insert(0, np.maximum(highs[0][0::2], highs[0][1::2]))

    done: list[Cells] = []
    stack: list[tuple[int, Cells]] = [(0, np.zeros((1, 2), dtype=np.int64))]
    while stack:
        level, pairs = stack.pop()
        if level == depth:
            pairs = pairs[pairs[:, 0] != pairs[:, 1]]
            if len(pairs):
                done.append(order[pairs])
            continue
        children = np.concatenate([2 * pairs + shift for shift in ([0, 0], [0, 1], [1, 0], [1, 1])])
        # of a box with itself keep (left, left), (left, right), (right, right)
        children = children[children[:, 0] <= children[:, 1]]
        a, b = children[:, 0], children[:, 1]
        overlap = (lows[level + 1][a] <= highs[level + 1][b]).all(axis=1)
        overlap &= (lows[level + 1][b] <= highs[level + 1][a]).all(axis=1)
        children = children[overlap]
        stack.extend(
            (level + 1, children[start : start + _CHUNK_PAIRS]) for start in range(0, len(children), _CHUNK_PAIRS)
        )
    return done


def _orientation(a: Points, b: Points, c: Points, d: Points) -> Values:
    """Sign of the volume of the tetrahedron ``abcd``; 0 when it is flat to rounding."""
    u, v, w = b - a, c - a, d - a
    volume = np.einsum("ij,ij->i", np.cross(u, v), w)
    scale = np.abs(u).max(axis=1) * np.abs(v).max(axis=1) * np.abs(w).max(axis=1)
    return np.where(np.abs(volume) <= _RELATIVE_TOLERANCE * scale, 0.0, np.sign(volume))


def _segment_through_triangle(p: Points, q: Points, a: Points, b: Points, c: Points) -> NDArray[np.bool_]:
    """Whether each segment ``pq`` passes through the triangle ``abc``, its border included."""
    hit = _orientation(a, b, c, p) * _orientation(a, b, c, q) < 0
    index = np.flatnonzero(hit)
    p, q, a, b, c = p[index], q[index], a[index], b[index], c[index]
    sides = np.stack([_orientation(p, q, a, b), _orientation(p, q, b, c), _orientation(p, q, c, a)])
    hit[index] = (sides >= 0).all(axis=0) ^ (sides <= 0).all(axis=0)
    return hit


def _pairs_cross(points: Points, first: Cells, second: Cells) -> NDArray[np.bool_]:
    """Whether the two triangles of each pair cross; shape ``(k, 3)`` each."""
    crossing = np.zeros(len(first), dtype=bool)
    shared = (first[:, :, None] == second[:, None, :]).any(axis=2).sum(axis=1)
    for edges_of, other in ((first, second), (second, first)):
        a, b, c = (points[other[:, k]] for k in range(3))
        for k in range(3):
            tail, head = edges_of[:, k], edges_of[:, (k + 1) % 3]
            # an edge that ends in a common vertex touches there and can not pass through
            free = ~((tail[:, None] == other).any(axis=1) | (head[:, None] == other).any(axis=1))
            index = np.flatnonzero(free & (shared < 2) & ~crossing)
            if len(index):
                crossing[index] = _segment_through_triangle(
                    points[tail[index]], points[head[index]], a[index], b[index], c[index]
                )
    return crossing


def self_intersections(points: Points, triangles: Cells) -> Cells:
    """Find the pairs of triangles that cut through each other.

    Parameters
    ----------
    points
        Positions, mm, shape ``(n, 3)``; finite.
    triangles
        Vertex indices, shape ``(m, 3)``.

    Returns
    -------
    ndarray
        Indices of the two triangles of each crossing pair, shape ``(k, 2)``.
    """
    if len(triangles) == 0:
        return np.empty((0, 2), dtype=np.int64)
    corners = points[triangles]
    found = [np.empty((0, 2), dtype=np.int64)]
    for pairs in _candidate_pairs(corners.min(axis=1), corners.max(axis=1)):
        crossing = _pairs_cross(points, triangles[pairs[:, 0]], triangles[pairs[:, 1]])
        found.append(pairs[crossing])
    return np.concatenate(found)
