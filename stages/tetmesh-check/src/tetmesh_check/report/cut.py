"""A cut through the middle of a volume mesh, along faces of tetrahedra."""

from __future__ import annotations

from typing import Any

import numpy as np
import pyvista as pv
from numpy.typing import NDArray

from tetmesh_check.quality import Points


def cut_of(volume: pv.UnstructuredGrid) -> tuple[pv.PolyData, Points, Points]:
    """Cut across the shortest side of the object, at the median of the tetrahedra.

    Parameters
    ----------
    volume
        A mesh as ``tetmesh-check`` writes it.

    Returns
    -------
    tuple
        The boundary of the farther half; the direction from it towards the eye, along an axis of
        the world; and the upward direction of a picture.
    """
    axis = int(np.argmin(np.ptp(volume.points, axis=0)))
    normal = np.zeros(3)
    normal[axis] = -1.0 if axis == 1 else 1.0
    up = np.array([0.0, 1.0, 0.0]) if axis == 2 else np.array([0.0, 0.0, 1.0])
    depth = volume.cell_centers().points @ normal
    kept = depth < np.median(depth)
    # none lie before the median if all lie in one plane
    return boundary_of(volume, kept if kept.any() else ~kept), normal, up


def boundary_of(volume: pv.UnstructuredGrid, kept: NDArray[Any]) -> pv.PolyData:
    """Return the boundary of some tetrahedra, outward, with their cell data.

    Parameters
    ----------
    volume
        A mesh of tetrahedra.
    kept
        Whether each tetrahedron is one of them, shape ``(m,)``.
    """
    return volume.extract_cells(kept).extract_surface(algorithm="dataset_surface")
