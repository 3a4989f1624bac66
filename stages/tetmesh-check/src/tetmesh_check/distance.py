"""Distance between the boundary of the tetrahedra and the input surface, both ways."""

from __future__ import annotations

from typing import Any

import numpy as np
import pyvista as pv
from vtkmodules.util.numpy_support import numpy_to_vtk, vtk_to_numpy
from vtkmodules.vtkCommonCore import vtkDoubleArray
from vtkmodules.vtkFiltersCore import vtkImplicitPolyDataDistance

from tetmesh_check.polydata import to_polydata
from tetmesh_check.quality import Cells, Points, Values

MAX_SAMPLES = 200_000
"""Sample points a surface; more than this are thinned evenly."""


def distances_to(target: pv.PolyData, samples: Points) -> Values:
    """Distance of each sample point from the nearest point of a triangle mesh, mm.

    Parameters
    ----------
    target
        The mesh.
    samples
        Positions, mm, shape ``(n, 3)``.
    """
    function = vtkImplicitPolyDataDistance()
    function.SetInput(target)
    result = vtkDoubleArray()
    function.FunctionValue(numpy_to_vtk(np.ascontiguousarray(samples)), result)
    distances: Values = np.abs(vtk_to_numpy(result)).astype(np.float64)
    return distances


def sample_points(points: Points, triangles: Cells) -> Points:
    """Vertices in use and triangle centres, thinned evenly to :data:`MAX_SAMPLES`.

    Parameters
    ----------
    points
        Positions, mm, shape ``(n, 3)``.
    triangles
        Vertex indices, shape ``(m, 3)``.
    """
    samples = np.concatenate([points[np.unique(triangles)], points[triangles].mean(axis=1)])
    step = -(-len(samples) // MAX_SAMPLES)
    return samples[::step]


def summarize_distances(distances: Values) -> dict[str, Any]:
    """Condense distances into mean, 99th percentile, largest and number of samples; mm.

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
    """Distances of samples on the first mesh from the second, and the other way round, mm.

    Parameters
    ----------
    first, second
        Points and triangles of the two meshes.
    """
    return (
        distances_to(to_polydata(*second), sample_points(*first)),
        distances_to(to_polydata(*first), sample_points(*second)),
    )
