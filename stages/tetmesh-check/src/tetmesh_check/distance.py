"""Distance between the boundary of the tetrahedra and the input surface, in both directions."""

from __future__ import annotations

from typing import Any

import numpy as np
from isoparticles import _native

from tetmesh_check.quality import Cells, Points, Values


def summarize_distances(distances: Values) -> dict[str, Any]:
    """Return mean, 99th percentile, maximum (mm) and number of distances.

    Parameters
    ----------
    distances
        Distances, mm.
    """
    return {
        "mean": float(distances.mean()),
        "p99": float(np.percentile(distances, 99)),
        "max": float(distances.max()),
        "samples": int(distances.size),
    }


def distances_both_ways(first: tuple[Points, Cells], second: tuple[Points, Cells]) -> tuple[Values, Values]:
    """Distances of vertices and centroids of each mesh from the other, mm.

    If a mesh has more than 200,000 of them, only every n-th is used.

    Parameters
    ----------
    first, second
        Points and triangles of the two meshes.
    """
    return _native.distances_between(*first, *second), _native.distances_between(*second, *first)
