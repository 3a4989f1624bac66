"""Fields on grids, read from files and evaluated by the Rust code.

``sizefield`` writes the size field h, the target edge lengths of the tetrahedra, on the grid of the
distance field F. fTetWild reads h from a tetrahedral background mesh, which it searches for every
vertex. Only the grid cells in and near the object matter, and h varies slowly (its gradient is at
most the delta of ``sizefield``). So the grid is coarsened until the background mesh is much smaller
than the result. Gmsh reads h from a grid along the world axes, which is cheap to search and may
have more nodes.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, NoReturn

import numpy as np
import pyvista as pv
from isoparticles._native import GridField

from tetmesh_check.errors import StageError
from tetmesh_check.parts.caps import Border, border_of
from tetmesh_check.quality import Points
from tetmesh_check.surface import Surface, history_of, read_dataset

DISTANCE = "signed_distance"
"""Point array of a distance field: F at the voxel centres, mm, negative inside."""
SIZING = "sizing"
"""Point array of a size field: target edge length h, mm."""


def _read_field(path: Path, name: str, why: str, advice: str, above: float) -> tuple[pv.ImageData, GridField]:
    """Read an image whose point array ``name`` has finite values above a number."""

    def refuse(what: str) -> NoReturn:
        raise StageError(f"{path}: {what}", why, advice)

    image = read_dataset(path)
    if not isinstance(image, pv.ImageData):
        refuse(f"holds a {type(image).__name__}, not an image")
    if name not in image.point_data:
        refuse(f"has no point array named '{name}' (those present: {', '.join(image.point_data.keys()) or 'none'})")
    values = np.asarray(image.point_data[name])
    if min(image.dimensions) < 2 or values.ndim != 1:
        refuse(f"is a two-dimensional image or has several values per voxel {image.dimensions}")
    bad = int((~np.isfinite(values) | (values <= above)).sum())
    if bad:
        refuse(f"{bad} of {values.size} values are not {'positive and ' if above == 0 else ''}finite")
    shaped = values.astype(np.float32, copy=False).reshape(image.dimensions, order="F")
    axes = np.asarray(image.direction_matrix).T.tolist()
    return image, GridField(shaped, tuple(image.spacing), image.GetPoint(0), axes)


def read_distance_field(path: Path, points: Points) -> tuple[GridField, Any]:
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
        The field, and the history in the file.

    Raises
    ------
    StageError
        If the file has no such field, is two-dimensional, has values that are not finite, or does
        not contain the object.
    """
    why = "mid-edge nodes are moved to the zero set of F"
    advice = "give the file that distfield wrote for this surface"
    image, field = _read_field(path, DISTANCE, why, advice, -np.inf)
    step = np.asarray(image.direction_matrix) * image.spacing
    index = np.linalg.solve(step, (points - image.GetPoint(0)).T).T
    low, high = index.min(axis=0), index.max(axis=0)
    # the border of the volume is half a voxel beyond the outermost voxel centres
    if (low < -0.5).any() or (high > np.array(image.dimensions) - 0.5).any():
        raise StageError(
            f"{path}: the surface reaches beyond this field (voxels {low.round(1).tolist()} to {high.round(1).tolist()} of "
            f"{list(image.dimensions)})",
            "F is not known there, so they do not belong together",
            advice,
        )
    return field, history_of(image)


def read_sizing_field(path: Path) -> tuple[GridField, Any, Border | None]:
    """Read a size field.

    Parameters
    ----------
    path
        A VTK image (``.vti``) with the point array ``sizing``.

    Returns
    -------
    tuple
        The edge lengths, mm, the history in the file, and the faces of the volume, if known.

    Raises
    ------
    StageError
        If the file has no such field, is two-dimensional, or has values that are not positive and
        finite.
    """
    why = "it holds the target edge lengths of the tetrahedra, mm"
    image, field = _read_field(path, SIZING, why, "give the file that sizefield wrote", 0.0)
    history = history_of(image)
    return field, history, border_of(image, history)


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
