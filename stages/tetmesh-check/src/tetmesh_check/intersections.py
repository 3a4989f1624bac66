"""Pairs of triangles of one surface that cut through each other.

Broad phase: the triangles in Morton order form an implicit binary tree of boxes, and pairs of overlapping boxes are
refined from the root down, many pairs at once, so that strongly graded meshes cost no more than uniform ones. Narrow
phase: two triangles cross when an edge of one passes through the other. A vertex that only touches does not count.
"""

from __future__ import annotations

from functools import reduce

import numpy as np
from numpy.typing import NDArray

from tetmesh_check.quality import Cells, Labels, Points, Values

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


def candidate_pairs(low: Points, high: Points) -> list[Cells]:
    """Pairs of boxes that overlap, each pair once, as chunks of shape ``(k, 2)``."""
    count = len(low)
    order = morton_order(0.5 * (low + high))
    depth = max(int(np.ceil(np.log2(max(count, 1)))), 0)
    padded = 1 << depth
    # Level d holds 2^d boxes, one array an axis; the missing leaves are empty boxes that overlap nothing.
    lows = [np.full((3, padded), np.inf)]
    highs = [np.full((3, padded), -np.inf)]
    lows[0][:, :count], highs[0][:, :count] = low[order].T, high[order].T
    for _ in range(depth):
        lows.insert(0, np.minimum(lows[0][:, 0::2], lows[0][:, 1::2]))
        highs.insert(0, np.maximum(highs[0][:, 0::2], highs[0][:, 1::2]))

    done: list[Cells] = []
    root = np.zeros(1, dtype=np.int64)
    stack: list[tuple[int, Labels, Labels]] = [(0, root, root)]
    while stack:
        level, first, second = stack.pop()
        if level == depth:
            apart = first != second
            if apart.any():
                done.append(np.stack([order[first[apart]], order[second[apart]]], 1))
            continue
        a = np.concatenate([2 * first, 2 * first, 2 * first + 1, 2 * first + 1])
        b = np.concatenate([2 * second, 2 * second + 1, 2 * second, 2 * second + 1])
        # of a box with itself keep (left, left), (left, right), (right, right)
        kept = np.flatnonzero(a <= b)
        for axis in range(3):
            low_of, high_of = lows[level + 1][axis], highs[level + 1][axis]
            for one, other in ((a, b), (b, a)):
                kept = kept[low_of[one[kept]] <= high_of[other[kept]]]
        stack.extend(
            (level + 1, a[chunk], b[chunk])
            for chunk in (kept[start : start + _CHUNK_PAIRS] for start in range(0, len(kept), _CHUNK_PAIRS))
        )
    return done


def _orientation(a: Points, b: Points, c: Points, d: Points) -> Values:
    """Sign of the volume of the tetrahedron ``abcd``; 0 when it is flat to rounding. Coordinates by rows, ``(3, n)``."""
    u, v, w = b - a, c - a, d - a
    volume = (
        (u[1] * v[2] - u[2] * v[1]) * w[0] + (u[2] * v[0] - u[0] * v[2]) * w[1] + (u[0] * v[1] - u[1] * v[0]) * w[2]
    )
    scale = _largest(u) * _largest(v) * _largest(w)
    return np.where(np.abs(volume) <= _RELATIVE_TOLERANCE * scale, 0.0, np.sign(volume))


def _largest(vectors: Points) -> Values:
    """Largest coordinate of each vector, without its sign; shape ``(n,)``."""
    largest: Values = np.maximum(np.maximum(np.abs(vectors[0]), np.abs(vectors[1])), np.abs(vectors[2]))
    return largest


def _segment_through_triangle(p: Points, q: Points, a: Points, b: Points, c: Points) -> NDArray[np.bool_]:
    """Whether each segment ``pq`` passes through the triangle ``abc``, its border included; coordinates by rows."""
    hit = _orientation(a, b, c, p) * _orientation(a, b, c, q) < 0
    index = np.flatnonzero(hit)
    p, q, a, b, c = p[:, index], q[:, index], a[:, index], b[:, index], c[:, index]
    sides = np.stack([_orientation(p, q, a, b), _orientation(p, q, b, c), _orientation(p, q, c, a)])
    hit[index] = (sides >= 0).all(axis=0) ^ (sides <= 0).all(axis=0)
    return hit


def _pairs_cross(points: Points, first: Cells, second: Cells) -> NDArray[np.bool_]:
    """Whether the two triangles of each pair cross; shape ``(k, 3)`` each, the points by rows ``(3, n)``."""
    crossing = np.zeros(len(first), dtype=bool)
    same = [[first[:, i] == second[:, j] for j in range(3)] for i in range(3)]
    in_second = [same[i][0] | same[i][1] | same[i][2] for i in range(3)]
    in_first = [same[0][j] | same[1][j] | same[2][j] for j in range(3)]
    # triangles with a common edge cannot cross
    shared = in_second[0].astype(np.int8) + in_second[1] + in_second[2]
    for edges_of, other, common in ((first, second, in_second), (second, first, in_first)):
        for k in range(3):
            tail, head = edges_of[:, k], edges_of[:, (k + 1) % 3]
            # an edge that ends in a common vertex touches there and can not pass through
            index = np.flatnonzero((shared < 2) & ~(common[k] | common[(k + 1) % 3]) & ~crossing)
            if len(index):
                corners = (points[:, other[index, m]] for m in range(3))
                crossing[index] = _segment_through_triangle(points[:, tail[index]], points[:, head[index]], *corners)
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
    by_rows = np.ascontiguousarray(points.T)
    low, high = (reduce(how, (corners[:, k] for k in range(3))) for how in (np.minimum, np.maximum))
    for pairs in candidate_pairs(low, high):
        crossing = _pairs_cross(by_rows, triangles[pairs[:, 0]], triangles[pairs[:, 1]])
        found.append(pairs[crossing])
    return np.concatenate(found)
