"""Fields on grids, read from files and evaluated by the Rust code."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pyvista as pv
from isoparticles._native import GridField
from numpy.typing import NDArray

from tetmesh_check.errors import StageError
from tetmesh_check.quality import Points
from tetmesh_check.surface import history_of, read_dataset

DISTANCE = "signed_distance"
"""Point array of a distance field: F at the voxel centres, mm, negative inside."""


def _placement(image: pv.ImageData) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the world vectors between voxel centres, as columns, and the first centre, mm."""
    step = np.asarray(image.direction_matrix, dtype=np.float64) * np.asarray(image.spacing)
    return step, np.asarray(image.origin, dtype=np.float64) + step @ np.array(image.extent[::2], dtype=np.float64)


def grid_field(image: pv.ImageData, values: NDArray[np.floating[Any]]) -> GridField:
    """Convert numbers at the points of an image to a field of the Rust code.

    Parameters
    ----------
    image
        The grid.
    values
        One number per point, x fastest.
    """
    _, origin = _placement(image)
    shaped = values.astype(np.float32, copy=False).reshape(image.dimensions, order="F")
    return GridField(shaped, tuple(image.spacing), tuple(origin), np.asarray(image.direction_matrix).T.tolist())


def read_distance_field(path: Path, points: Points) -> tuple[GridField, object]:
    """Read the distance field of an object.

    Parameters
    ----------
    path
        File of ``distfield``.
    points
        The object's vertices, world coordinates, mm.

    Returns
    -------
    tuple
        The field, and the history that the file carries.

    Raises
    ------
    StageError
        If it is of another kind, flat, has values that are no numbers, or does not hold the object.
    """
    advice = "give the file that distfield wrote for this surface"
    image = read_dataset(path)
    found = ", ".join(image.point_data.keys()) or "none"
    if not isinstance(image, pv.ImageData) or DISTANCE not in image.point_data:
        raise StageError(
            f"{path}: is no image with a point array named '{DISTANCE}' (those present: {found})",
            "mid-edge nodes are brought onto the surface where that distance is 0",
            advice,
        )
    values = np.asarray(image.point_data[DISTANCE])
    if min(image.dimensions) < 2 or values.ndim != 1 or not np.isfinite(values).all():
        raise StageError(
            f"{path}: is flat, many-valued or not finite {image.dimensions}", "F is one number a voxel in 3-D", advice
        )
    step, origin = _placement(image)
    index = np.linalg.solve(step, (points - origin).T).T
    low, high = index.min(axis=0), index.max(axis=0)
    # a vertex may lie half a voxel beyond the outermost centres, where the border of the volume is
    if (low < -0.5).any() or (high > np.array(image.dimensions) - 0.5).any():
        raise StageError(
            f"{path}: the surface reaches beyond this field (voxels {low.round(1).tolist()} to {high.round(1).tolist()} of "
            f"{list(image.dimensions)})",
            "F is not known there, so they do not belong together",
            advice,
        )
    return grid_field(image, values), history_of(image)
