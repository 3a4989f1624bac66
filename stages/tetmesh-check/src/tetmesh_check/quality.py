"""Quality of triangles and tetrahedra, computed by the Rust code.

All measures are 1 for the equilateral triangle or the regular tetrahedron and 0 for a degenerate
one, except the aspect ratio and the edge ratio (1 is best, larger is worse) and the angles.
Definitions follow the Verdict library (Stimpson et al., SAND2007-1751), with the radius ratio
inverted, so that it lies in [0, 1] as in Table 1 of Kim, Chen and Hansen 2012.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from isoparticles import _native
from numpy.typing import NDArray

Points = NDArray[np.float64]
"""Positions in mm, shape ``(n, 3)``."""
Cells = NDArray[np.int64]
"""Vertex indices, shape ``(m, 3)`` for triangles and ``(m, 4)`` for tetrahedra."""
Labels = NDArray[np.int64]
"""One component number per cell, shape ``(m,)``."""
Values = NDArray[np.float64]
"""One number per cell, shape ``(m,)``."""

PERCENTILES = (1, 5, 10, 25, 50, 75, 90, 95, 99)
"""The percentiles that a summary lists."""

OUTWARD_FACES = ((0, 2, 1), (0, 1, 3), (1, 2, 3), (0, 3, 2))
"""Faces of a positive tetrahedron in VTK order, counter-clockwise as seen from outside."""
_BLOCK = 1 << 22
"""Tetrahedra to measure together if only the volume is kept. All measures of a block take 64 bytes
per tetrahedron, and their copies as much again: 0.5 GiB."""


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
    """sqrt(2) times the Jacobian over the largest product of the three edges at a vertex, [-1, 1];
    1 is regular."""
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
    return TriangleQuality(*_native.triangle_quality(points, triangles))


def tetrahedron_quality(points: Points, tetrahedra: Cells) -> TetrahedronQuality:
    """Measure every tetrahedron.

    Parameters
    ----------
    points
        Positions, mm, shape ``(n, 3)``.
    tetrahedra
        Vertex indices in VTK order, shape ``(m, 4)``.

    Returns
    -------
    TetrahedronQuality
        Arrays of shape ``(m,)``. Flat tetrahedra have radius ratio and scaled Jacobian 0, inverted
        ones a negative volume and a negative scaled Jacobian.
    """
    return TetrahedronQuality(*_native.tetrahedron_quality(points, tetrahedra))


def signed_tetrahedron_volumes(points: Points, tetrahedra: Cells) -> Values:
    """Signed volume of every tetrahedron, mm^3, positive in VTK's vertex order.

    Parameters
    ----------
    points
        Positions, mm, shape ``(n, 3)``.
    tetrahedra
        Vertex indices, shape ``(m, 4)``.
    """
    volumes = np.empty(len(tetrahedra))
    for start in range(0, len(tetrahedra), _BLOCK):
        block = slice(start, start + _BLOCK)
        volumes[block] = tetrahedron_quality(points, tetrahedra[block]).volume
    return volumes


def orient_positive(points: Points, tetrahedra: Cells) -> tuple[Cells, bool]:
    """Bring tetrahedra that are all wound the other way into VTK's order.

    Single inverted tetrahedra among positive ones are a fault of the mesh and stay as they are.

    Parameters
    ----------
    points
        Positions, mm, shape ``(n, 3)``.
    tetrahedra
        Vertex indices, shape ``(m, 4)``.

    Returns
    -------
    tuple
        The tetrahedra, and whether they were turned.
    """
    volumes = signed_tetrahedron_volumes(points, tetrahedra)
    if (volumes < 0).sum() <= (volumes > 0).sum():
        return tetrahedra, False
    return tetrahedra[:, [0, 2, 1, 3]], True


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


def summarize(values: Values, bins: NDArray[np.float64] | None = None) -> dict[str, Any]:
    """Condense one measure into the numbers of the report.

    Parameters
    ----------
    values
        One number per cell.
    bins
        Edges of the histogram; without them there is none.

    Returns
    -------
    dict
        ``count, min, max, mean, median``, ``percentiles`` by name, and ``histogram`` with ``edges``
        and ``counts``. Infinite values (degenerate cells) are left out of the mean and counted in
        ``infinite``.
    """
    found = _native.statistics(values, PERCENTILES, [] if bins is None else bins)
    summary: dict[str, Any] = {"count": int(values.size), "infinite": found["infinite"]}
    if found["infinite"] == values.size:
        return summary
    summary |= {name: found[name] for name in ("min", "max", "mean", "median")}
    summary["percentiles"] = {f"p{p}": value for p, value in zip(PERCENTILES, found["percentiles"], strict=True)}
    if bins is not None:
        summary["histogram"] = {"edges": [float(x) for x in bins], "counts": found["histogram"]}
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


def summarize_all(quality: TriangleQuality | TetrahedronQuality, own: Any = slice(None)) -> dict[str, dict[str, Any]]:
    """Condense every measure of a mesh (see :func:`summarize`).

    Parameters
    ----------
    quality
        The measures of the triangles or of the tetrahedra.
    own
        Indices of those to condense; all by default.
    """
    return {
        field.name: summarize(getattr(quality, field.name)[own], _BINS.get(field.name)) for field in fields(quality)
    }
