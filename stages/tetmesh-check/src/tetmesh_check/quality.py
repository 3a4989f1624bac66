"""Quality of triangles and tetrahedra, computed by the Rust code.

All measures are 1 for the equilateral triangle or the regular tetrahedron and 0 for a degenerate
one, except the aspect ratio and the edge ratio (1 is best, larger is worse) and the angles.
Definitions follow the Verdict library (Stimpson et al., SAND2007-1751), with the radius ratio
inverted, so that it lies in [0, 1] as in Table 1 of Kim, Chen and Hansen 2012.
"""

from __future__ import annotations

from typing import Any, NamedTuple

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

OUTWARD_FACES = ((0, 2, 1), (0, 1, 3), (1, 2, 3), (0, 3, 2))
"""Faces of a positive tetrahedron in VTK order, counter-clockwise as seen from outside."""


class TriangleQuality(NamedTuple):
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


class TetrahedronQuality(NamedTuple):
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


signed_tetrahedron_volumes = _native.tetrahedron_volumes
"""Signed volume of every tetrahedron, mm^3, positive in VTK's vertex order."""


def orient_positive(points: Points, tetrahedra: Cells) -> tuple[Cells, bool]:
    """Reverse the vertex order of all tetrahedra if most of them are inverted.

    The result is in VTK's order. Single inverted tetrahedra are a fault of the mesh, and are not
    changed.

    Parameters
    ----------
    points
        Positions, mm, shape ``(n, 3)``.
    tetrahedra
        Vertex indices, shape ``(m, 4)``.

    Returns
    -------
    tuple
        The tetrahedra, and whether they were reversed.
    """
    volumes = signed_tetrahedron_volumes(points, tetrahedra)
    if (volumes < 0).sum() <= (volumes > 0).sum():
        return tetrahedra, False
    return tetrahedra[:, [0, 2, 1, 3]], True


def centres_of(points: Points, cells: Cells) -> Points:
    """Return the mean position of the vertices of each cell, mm, shape ``(m, 3)``.

    Parameters
    ----------
    points
        Positions, mm, shape ``(n, 3)``, or one coordinate, shape ``(n,)``.
    cells
        Vertex indices, shape ``(m, k)``.
    """
    # corner by corner, because the corners of all cells together need several times the memory
    centres: Points = sum(points[corners] for corners in cells.T) / cells.shape[1]
    return centres


summarize = _native.summarize
"""Return the statistics of a measure for the report: ``count``, ``min``, ``max``, ``mean``,
``median``, ``percentiles`` by name and, if the edges of bins are given, ``histogram`` with
``edges`` and ``counts``. Values that are not finite (degenerate cells) are only counted, in
``infinite``."""


def summarize_distances(distances: Values) -> dict[str, Any]:
    """Return mean, 99th percentile, maximum (mm) and number of distances.

    Parameters
    ----------
    distances
        Distances, mm.
    """
    found = summarize(distances)
    p99 = found["percentiles"]["p99"]
    return {"mean": found["mean"], "p99": p99, "max": found["max"], "samples": found["count"]}


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
    """Return the statistics of every measure of a mesh (:data:`summarize`).

    Parameters
    ----------
    quality
        The measures of the triangles or of the tetrahedra.
    own
        Indices of the cells to use; all by default.
    """
    return {name: summarize(values[own], _BINS.get(name)) for name, values in quality._asdict().items()}
