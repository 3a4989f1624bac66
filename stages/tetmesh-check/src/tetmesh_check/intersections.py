"""Pairs of boxes that overlap, for forced.py."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tetmesh_check.quality import Cells, Labels, Points

_CHUNK_PAIRS = 1 << 19


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
