"""Quality of triangles and tetrahedra, as the mesh-generation field measures it.

All measures are 1 for the equilateral triangle or the regular tetrahedron and 0 for a degenerate one, except the
aspect ratio and the edge ratio (1 is best, larger is worse) and the angles. Definitions follow the Verdict library
(Stimpson et al., SAND2007-1751), with the radius ratio turned over so that it lies in [0, 1] like the figure in
Table 1 of Kim, Chen and Hansen 2012.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from functools import reduce
from typing import Any

import numpy as np
from numpy.typing import NDArray

Points = NDArray[np.float64]
"""Positions in mm, shape ``(n, 3)``."""
Cells = NDArray[np.int64]
"""Vertex indices, shape ``(m, 3)`` for triangles and ``(m, 4)`` for tetrahedra."""
Labels = NDArray[np.int64]
"""One component number a cell, shape ``(m,)``."""
Values = NDArray[np.float64]
"""One number a cell, shape ``(m,)``."""

PERCENTILES = (1, 5, 10, 25, 50, 75, 90, 95, 99)
"""The percentiles that a summary lists."""

_BLOCK = 1 << 14
"""Tetrahedra that are measured at once: few enough for the cache."""
_TETRAHEDRON_EDGES = ((0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3))
_TETRAHEDRON_CORNERS = ((0, 1, 2), (0, 3, 4), (1, 3, 5), (2, 4, 5))
"""For each vertex, the three of the edges above that meet in it."""
OUTWARD_FACES = ((0, 2, 1), (0, 1, 3), (1, 2, 3), (0, 3, 2))
"""Faces of a positive tetrahedron in VTK order, each wound so that its normal points out."""


@dataclass(frozen=True)
class TriangleQuality:
    """Shape of each triangle of a surface."""

    area: Values
    """Area, mm^2."""
    radius_ratio: Values
    """Twice the inradius over the circumradius, [0, 1]."""
    min_angle: Values
    """Smallest angle, degrees."""
    max_angle: Values
    """Largest angle, degrees."""
    edge_length: Values
    """Mean edge length, mm."""


@dataclass(frozen=True)
class TetrahedronQuality:
    """Shape of each tetrahedron of a volume mesh."""

    volume: Values
    """Signed volume, mm^3; positive in VTK's vertex order."""
    radius_ratio: Values
    """Three times the inradius over the circumradius, [0, 1]; the reciprocal of Verdict's."""
    scaled_jacobian: Values
    """sqrt(2) times the Jacobian over the largest product of the three edges at a vertex, [-1, 1]; 1 is regular."""
    min_dihedral: Values
    """Smallest dihedral angle, degrees."""
    max_dihedral: Values
    """Largest dihedral angle, degrees."""
    aspect_ratio: Values
    """Longest edge over 2 sqrt(6) inradii, at least 1."""
    edge_ratio: Values
    """Longest over shortest edge, at least 1."""
    edge_length: Values
    """Mean edge length, mm."""


def _lengths(vectors: NDArray[np.float64]) -> Values:
    lengths: Values = np.sqrt(np.einsum("ij,ij->i", vectors, vectors))
    return lengths


def _ratio(numerator: Values, denominator: Values, degenerate: float) -> Values:
    """Divide, with a stated value where the denominator is zero."""
    result = np.full(numerator.shape, degenerate)
    np.divide(numerator, denominator, out=result, where=denominator > 0.0)
    return result


def triangle_quality(points: Points, triangles: Cells) -> TriangleQuality:
    """Measure every triangle.

    Parameters
    ----------
    points
        Positions, mm, shape ``(n, 3)``.
    triangles
        Vertex indices, shape ``(m, 3)``.

    Returns
    -------
    TriangleQuality
        Arrays of shape ``(m,)``. A triangle without area has radius ratio 0.
    """
    a, b, c = (points[triangles[:, k]] for k in range(3))
    edges = [_lengths(b - c), _lengths(c - a), _lengths(a - b)]
    area = 0.5 * _lengths(np.cross(b - a, c - a))
    perimeter = edges[0] + edges[1] + edges[2]
    # 2 r / R with r = 2 A / perimeter and R = abc / (4 A)
    radius_ratio = _ratio(16.0 * area**2, perimeter * edges[0] * edges[1] * edges[2], 0.0)
    angles = []
    for k in range(3):
        opposite, left, right = edges[k], edges[(k + 1) % 3], edges[(k + 2) % 3]
        cosine = _ratio(left**2 + right**2 - opposite**2, 2.0 * left * right, 1.0)
        angles.append(np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))))
    return TriangleQuality(
        area=area,
        radius_ratio=radius_ratio,
        min_angle=np.minimum.reduce(angles),
        max_angle=np.maximum.reduce(angles),
        edge_length=perimeter / 3.0,
    )


def centres_of(points: Points, cells: Cells) -> Points:
    """Mean position of the vertices of each cell, mm, shape ``(m, 3)``.

    Parameters
    ----------
    points
        Positions, mm, shape ``(n, 3)``, or one coordinate, shape ``(n,)``.
    cells
        Vertex indices, shape ``(m, k)``.
    """
    total = points[cells[:, 0]]
    for k in range(1, cells.shape[1]):
        total += points[cells[:, k]]
    total /= cells.shape[1]
    return total


def signed_tetrahedron_volumes(points: Points, tetrahedra: Cells) -> Values:
    """Signed volume of every tetrahedron, mm^3, positive in VTK's vertex order.

    Parameters
    ----------
    points
        Positions, mm, shape ``(n, 3)``.
    tetrahedra
        Vertex indices, shape ``(m, 4)``.
    """
    a = points[tetrahedra[:, 0]]
    ab, ac, ad = (points[tetrahedra[:, k]] - a for k in (1, 2, 3))
    volumes: Values = np.einsum("ij,ij->i", np.cross(ab, ac), ad) / 6.0
    return volumes


def tetrahedron_quality(points: Points, tetrahedra: Cells) -> TetrahedronQuality:
    """Measure every tetrahedron.

    Parameters
    ----------
    points
        Positions, mm, shape ``(n, 3)``.
    tetrahedra
        Vertex indices, shape ``(m, 4)``.

    Returns
    -------
    TetrahedronQuality
        Arrays of shape ``(m,)``. A flat tetrahedron has radius ratio and scaled Jacobian 0 and an infinite aspect
        ratio; an inverted one has negative volume and scaled Jacobian.
    """
    by_rows = np.ascontiguousarray(points.T)
    measures = {field.name: np.empty(len(tetrahedra)) for field in fields(TetrahedronQuality)}
    for start in range(0, len(tetrahedra), _BLOCK):
        block = slice(start, start + _BLOCK)
        part = _measure_block([by_rows[:, tetrahedra[block, k]] for k in range(4)])
        for name, values in part.items():
            measures[name][block] = values
    return TetrahedronQuality(**measures)


def _cross(u: Points, v: Points) -> Points:
    """Vector products by rows, shape ``(3, n)``."""
    return np.stack([u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]])


def _dot(u: Points, v: Points) -> Values:
    """Scalar products by rows, shape ``(n,)``."""
    products: Values = u[0] * v[0] + u[1] * v[1] + u[2] * v[2]
    return products


def _degrees(cosine: Values) -> Values:
    angles: Values = np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0)))
    return angles


def _measure_block(corner: list[Points]) -> dict[str, Values]:
    """Measure some tetrahedra by the positions of their vertices, four arrays of shape ``(3, n)``."""
    side = [corner[j] - corner[i] for i, j in _TETRAHEDRON_EDGES]
    edge = [np.sqrt(_dot(vector, vector)) for vector in side]
    longest, shortest = reduce(np.maximum, edge), reduce(np.minimum, edge)

    # area vectors pointing out of a positive tetrahedron; face k lies opposite vertex (3, 2, 0, 1)[k]
    area_vectors = [_cross(corner[j] - corner[i], corner[k] - corner[i]) for i, j, k in OUTWARD_FACES]
    volume = _dot(_cross(side[0], side[1]), side[2]) / 6.0
    doubled_areas = [np.sqrt(_dot(vector, vector)) for vector in area_vectors]
    surface = 0.5 * reduce(np.add, doubled_areas)
    inradius = _ratio(3.0 * np.abs(volume), surface, 0.0)

    # circumradius: with the three products of opposite edges p, q, r, 24 V R = sqrt((p+q+r)(p+q-r)(p-q+r)(-p+q+r))
    p, q, r = edge[0] * edge[5], edge[1] * edge[4], edge[2] * edge[3]
    heron = np.maximum((p + q + r) * (p + q - r) * (p - q + r) * (q + r - p), 0.0)
    radius_ratio = _ratio(72.0 * np.abs(volume) * inradius, np.sqrt(heron), 0.0)

    largest_product = reduce(np.maximum, [edge[i] * edge[j] * edge[k] for i, j, k in _TETRAHEDRON_CORNERS])
    cosines = [
        _ratio(-_dot(area_vectors[i], area_vectors[j]), doubled_areas[i] * doubled_areas[j], 1.0)
        for i in range(4)
        for j in range(i)
    ]
    return {
        "volume": volume,
        "radius_ratio": np.clip(radius_ratio, 0.0, 1.0),
        "scaled_jacobian": _ratio(np.sqrt(2.0) * 6.0 * volume, largest_product, 0.0),
        "min_dihedral": _degrees(reduce(np.maximum, cosines)),
        "max_dihedral": _degrees(reduce(np.minimum, cosines)),
        "aspect_ratio": _ratio(longest, 2.0 * np.sqrt(6.0) * inradius, np.inf),
        "edge_ratio": _ratio(longest, shortest, np.inf),
        "edge_length": reduce(np.add, edge) / 6.0,
    }


def summarize(values: Values, bins: NDArray[np.float64] | None = None) -> dict[str, Any]:
    """Condense one measure into the numbers of the report.

    Parameters
    ----------
    values
        One number a cell.
    bins
        Edges of the histogram; without them there is none.

    Returns
    -------
    dict
        ``count, min, max, mean, median``, ``percentiles`` by name, and ``histogram`` with ``edges`` and ``counts``.
        Infinite values (degenerate cells) are left out of the mean and counted in ``infinite``.
    """
    finite = values[np.isfinite(values)]
    summary: dict[str, Any] = {"count": int(values.size), "infinite": int(values.size - finite.size)}
    if finite.size == 0:
        return summary
    percentiles = np.percentile(finite, PERCENTILES)
    summary.update(
        min=float(finite.min()),
        max=float(finite.max()),
        mean=float(finite.mean()),
        median=float(np.median(finite)),
        percentiles={f"p{p}": float(v) for p, v in zip(PERCENTILES, percentiles, strict=True)},
    )
    if bins is not None:
        counts, edges = np.histogram(finite, bins=bins)
        summary["histogram"] = {"edges": [float(x) for x in edges], "counts": [int(x) for x in counts]}
    return summary


_UNIT_BINS = np.linspace(0.0, 1.0, 51)
_HALF_TURN_BINS = np.linspace(0.0, 180.0, 61)
_RATIO_BINS = np.concatenate([np.linspace(1.0, 5.0, 41), [10.0, 100.0, 1e9]])
_BINS = {
    "radius_ratio": _UNIT_BINS,
    "scaled_jacobian": np.linspace(-1.0, 1.0, 101),
    "min_angle": np.linspace(0.0, 60.0, 61),
    "max_angle": np.linspace(60.0, 180.0, 61),
    "min_dihedral": _HALF_TURN_BINS,
    "max_dihedral": _HALF_TURN_BINS,
    "aspect_ratio": _RATIO_BINS,
    "edge_ratio": _RATIO_BINS,
}


def summarize_all(quality: TriangleQuality | TetrahedronQuality) -> dict[str, dict[str, Any]]:
    """Condense every measure of a mesh (see :func:`summarize`).

    Parameters
    ----------
    quality
        The measures of the triangles or of the tetrahedra.
    """
    return {field.name: summarize(getattr(quality, field.name), _BINS.get(field.name)) for field in fields(quality)}
