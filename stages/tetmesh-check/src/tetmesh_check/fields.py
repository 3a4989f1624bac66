"""Fields on grids, read from files and evaluated by the Rust code.

``sizefield`` writes the size field h, the target edge lengths of the tetrahedra, on the grid of the
distance field F. fTetWild reads h from a tetrahedral background mesh, which it searches for every
vertex. Only the grid cells in and near the object matter, and h varies slowly (its gradient is at
most the delta of ``sizefield``). So the grid is coarsened until the background mesh is much smaller
than the result. Gmsh reads h from a grid along the world axes, which is cheap to search and may
have more nodes.
"""

from __future__ import annotations

import json
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pyvista as pv
from isoparticles._native import DistanceField, GridField

from tetmesh_check.errors import refuse_file
from tetmesh_check.parts.caps import Border, border_of
from tetmesh_check.quality import Points
from tetmesh_check.surface import Surface, history_of, read_dataset

SIZING = "sizing"
"""Point array of a size field: target edge length h, mm."""


def read_distance_field(path: Path, points: Points, names: list[str]) -> tuple[DistanceField, Any]:
    """Read the distance field of an object, or of many materials.

    Parameters
    ----------
    path
        File of ``distfield``.
    points
        The vertices of the surface, world coordinates, mm.
    names
        The names of its materials by number, then those of the planes at which they end; empty for
        one object.

    Returns
    -------
    tuple
        The field, and the history in the file.

    Raises
    ------
    StageError
        If the file has no such field, has other materials, is two-dimensional, has values that are
        not finite, or does not contain the surface.
    """
    field = DistanceField(path, points)
    if field.materials != names:
        own, others = (", ".join(known[1:]) or "one object" for known in (names, field.materials))
        refuse_file(
            path,
            f"is the field of {others}; the surface is that of {own}",
            "mid-edge nodes are moved onto the interfaces between the materials of the surface",
            "give the file that distfield wrote for this surface",
        )
    return field, json.loads(field.history)


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
    refuse = partial(
        refuse_file,
        path,
        why="it holds the target edge lengths of the tetrahedra, mm",
        remedy="give the file that sizefield wrote",
    )
    image = read_dataset(path)
    if not isinstance(image, pv.ImageData):
        refuse(f"holds a {type(image).__name__}, not an image")
    if SIZING not in image.point_data:
        refuse(f"has no point array named '{SIZING}' (those present: {', '.join(image.point_data.keys()) or 'none'})")
    values = np.asarray(image.point_data[SIZING])
    if min(image.dimensions) < 2 or values.ndim != 1:
        refuse(f"is a two-dimensional image or has several values per voxel {image.dimensions}")
    bad = int((~np.isfinite(values) | (values <= 0.0)).sum())
    if bad:
        refuse(f"{bad} of {values.size} values are not positive and finite")
    shaped = values.astype(np.float32, copy=False).reshape(image.dimensions, order="F")
    axes = np.asarray(image.direction_matrix).T.tolist()
    history = history_of(image)
    return GridField(shaped, tuple(image.spacing), image.GetPoint(0), axes), history, border_of(image, history)


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
