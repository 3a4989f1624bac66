"""The size field h as the background sizing of the tetrahedra.

``sizefield`` writes h on the grid of the distance field. fTetWild reads it from a tetrahedral
background mesh, which it searches for every vertex. Only the grid cells in and near the object
matter, and h varies slowly (its gradient is at most the delta of ``sizefield``). So the grid is
coarsened until the background mesh is much smaller than the result. Gmsh reads h from a grid along
the world axes, which is cheap to search and may have more nodes.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyvista as pv
from isoparticles._native import GridField
from numpy.typing import NDArray

from tetmesh_check.errors import StageError
from tetmesh_check.fields import grid_field
from tetmesh_check.quality import Cells, Points, Values
from tetmesh_check.surface import Surface, history_of, read_dataset

ARRAY_NAME = "sizing"
"""Point array of a size field: target edge length h, mm."""
MAX_BACKGROUND_NODES = 200_000
"""Maximum number of nodes of the background mesh. They cost little compared with the tetrahedra."""
MAX_GRID_NODES = 4_000_000
"""Maximum number of nodes of the grid along the world axes: 32 MB."""


@dataclass(frozen=True)
class SizingField:
    """Target edge length h on a regular grid placed in the world."""

    grid: GridField
    """Edge lengths, mm."""
    history: Any
    """The history that the file carries, or ``None``."""

    def at(self, world: Points) -> Values:
        """Edge length at world positions, mm: trilinear, clamped at the border of the grid.

        Parameters
        ----------
        world
            Positions, mm, shape ``(n, 3)``.
        """
        return self.grid.trilinear(world)


@dataclass(frozen=True)
class Background:
    """The size field on a tetrahedral mesh that covers the object."""

    points: Points
    """World positions, mm, shape ``(n, 3)``."""
    tetrahedra: Cells
    """Vertex indices, shape ``(m, 4)``."""
    values: Values
    """Edge length at each point, mm, shape ``(n,)``."""
    stride: int
    """Voxels from one node to the next."""


@dataclass(frozen=True)
class WorldGrid:
    """The size field on a regular grid along the world's axes that covers the object."""

    values: NDArray[np.float64]
    """Edge lengths, mm, shape ``(nx, ny, nz)``."""
    origin: NDArray[np.float64]
    """World position of node (0, 0, 0), mm."""
    spacing: float
    """From a node to the next along each axis, mm."""


def read_sizing_field(path: Path) -> SizingField:
    """Read a size field.

    Parameters
    ----------
    path
        A VTK image (``.vti``) with the point array ``sizing``.

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
    return SizingField(grid_field(image, values), history_of(image))


def uniform_sizing_field(surface: Surface, edge_length: float) -> SizingField:
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
    return SizingField(GridField(values, (spacing,) * 3, tuple(low - spacing), np.eye(3).tolist()), None)


def background_mesh(field: SizingField, surface: Surface, max_nodes: int = MAX_BACKGROUND_NODES) -> Background:
    """Put the size field on tetrahedra that cover the object.

    Parameters
    ----------
    field
        The size field.
    surface
        The surface of the object, world coordinates.
    max_nodes
        Maximum number of nodes. The grid takes every second, third, ... voxel until they suffice.

    Returns
    -------
    Background
        It reaches at least one cell beyond the surface wherever the grid does.
    """
    return Background(*field.grid.background(surface.points, surface.triangles, max_nodes))


def world_grid(field: SizingField, surface: Surface, factor: float, max_nodes: int = MAX_GRID_NODES) -> WorldGrid:
    """Put the size field on a grid along the world's axes, over the bounding box of the object.

    Parameters
    ----------
    field
        The size field.
    surface
        The surface of the object, world coordinates.
    factor
        Factor of the edge lengths.
    max_nodes
        The spacing is the smallest of the field, or larger where that would take more nodes than
        this.
    """
    values, origin, spacing = field.grid.world_grid(surface.points, max_nodes)
    return WorldGrid(factor * values, np.array(origin), spacing)
