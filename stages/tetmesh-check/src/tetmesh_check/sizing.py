"""The size field h: the target edge lengths of the tetrahedra.

``sizefield`` writes h on the grid of the distance field. fTetWild reads it from a tetrahedral
background mesh, which it searches for every vertex. Only the grid cells in and near the object
matter, and h varies slowly (its gradient is at most the delta of ``sizefield``). So the grid is
coarsened until the background mesh is much smaller than the result. Gmsh reads h from a grid along
the world axes, which is cheap to search and may have more nodes.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyvista as pv
from isoparticles._native import GridField

from tetmesh_check.errors import StageError
from tetmesh_check.fields import grid_field
from tetmesh_check.surface import Surface, history_of, read_dataset

ARRAY_NAME = "sizing"
"""Point array of a size field: target edge length h, mm."""


def read_sizing_field(path: Path) -> tuple[GridField, object]:
    """Read a size field.

    Parameters
    ----------
    path
        A VTK image (``.vti``) with the point array ``sizing``.

    Returns
    -------
    tuple
        The edge lengths, mm, and the history that the file carries.

    Raises
    ------
    StageError
        If it is of another kind, flat, or has values that are no edge lengths.
    """
    image = read_dataset(path)
    advice = "give the file that sizefield wrote"
    if not isinstance(image, pv.ImageData):
        raise StageError(
            f"{path}: holds a {type(image).__name__}, not an image", "the size field is a regular grid", advice
        )
    if ARRAY_NAME not in image.point_data:
        found = ", ".join(image.point_data.keys()) or "none"
        raise StageError(
            f"{path}: has no point array named '{ARRAY_NAME}' (those present: {found})",
            "it holds the target edge lengths of the tetrahedra",
            advice,
        )
    dimensions = image.dimensions
    values = np.asarray(image.point_data[ARRAY_NAME])
    if min(dimensions) < 2 or values.ndim != 1:
        raise StageError(
            f"{path}: is a two-dimensional image or has several values per voxel {dimensions}",
            "the size field has one number per voxel of a 3-D grid",
            advice,
        )
    bad = ~(np.isfinite(values) & (values > 0))
    if bad.any():
        raise StageError(
            f"{path}: {int(bad.sum())} of {values.size} values are not positive and finite",
            "the values are edge lengths in mm",
            "run sizefield again",
        )
    return grid_field(image, values), history_of(image)


def uniform_sizing_field(surface: Surface, edge_length: float) -> GridField:
    """Build a constant size field on a coarse grid around the object.

    Parameters
    ----------
    surface
        The object.
    edge_length
        The length, mm.
    """
    low, high = surface.points.min(axis=0), surface.points.max(axis=0)
    spacing = max(float((high - low).max()) / 48.0, edge_length)
    count = np.ceil((high - low) / spacing).astype(np.int64) + 3
    values = np.full(tuple(int(n) for n in count), edge_length, dtype=np.float32)
    return GridField(values, (spacing,) * 3, tuple(low - spacing), np.eye(3).tolist())
