"""The size field h as the background sizing of the tetrahedra.

``sizefield`` writes h on the grid of the distance field. fTetWild wants it on a tetrahedral background mesh, which it
searches for every vertex. Only the grid cells in and near the object matter, and h varies slowly (its gradient is at
most the delta of ``sizefield``), so the grid is thinned until the background mesh is small beside the result. Gmsh wants
it on a grid along the world's axes, which is cheap to search and may have more nodes.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyvista as pv
from numpy.typing import NDArray
from vtkmodules.vtkImagingStencil import vtkImageStencilToImage, vtkPolyDataToImageStencil

from tetmesh_check.errors import StageError
from tetmesh_check.polydata import to_polydata
from tetmesh_check.quality import Cells, Points, Values
from tetmesh_check.surface import Surface, history_of, read_dataset

ARRAY_NAME = "sizing"
"""Point array of a size field: target edge length h, mm."""
MAX_BACKGROUND_NODES = 200_000
"""Nodes of the background mesh that are cheap beside the tetrahedra themselves."""
MAX_GRID_NODES = 4_000_000
"""Nodes of the grid along the world's axes: 32 MB."""
_SLAB_NODES = 1 << 18
_BLOCK_POINTS = 1 << 14
"""Positions that are looked up at once: few enough for the cache."""

_FIVE_TETRAHEDRA = (
    ((0, 1, 3, 4), (1, 2, 3, 6), (1, 3, 4, 6), (1, 4, 5, 6), (3, 4, 6, 7)),
    ((0, 1, 2, 5), (0, 2, 3, 7), (0, 2, 5, 7), (0, 4, 5, 7), (2, 5, 6, 7)),
)
"""A cube cut into five tetrahedra in the two mirrored ways; neighbouring cubes alternate, so that their faces match."""
_CUBE_CORNERS = np.array(
    [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0, 1], [1, 0, 1], [1, 1, 1], [0, 1, 1]], dtype=np.int64
)


@dataclass(frozen=True)
class SizingField:
    """Target edge length h on a regular grid placed in the world."""

    values: NDArray[np.float32]
    """Edge lengths, mm, shape ``(nx, ny, nz)``."""
    step: Points
    """World vectors from a voxel centre to the next along each grid axis, mm; one a column."""
    origin: NDArray[np.float64]
    """World position of the centre of voxel (0, 0, 0), mm."""
    history: Any
    """The history that the file carries, or ``None``."""

    @property
    def voxel(self) -> float:
        """Geometric mean spacing, mm."""
        return float(abs(np.linalg.det(self.step)) ** (1.0 / 3.0))

    def to_index(self, world: Points) -> Points:
        """Index positions (voxel centres at whole numbers) of world positions, shape ``(n, 3)``."""
        index: Points = np.linalg.solve(self.step, (world - self.origin).T).T.astype(np.float64)
        return index

    def to_world(self, index: Points) -> Points:
        """World positions, mm, of index positions, shape ``(n, 3)``."""
        return index @ self.step.T + self.origin

    def at(self, world: Points) -> Values:
        """Edge length at world positions, mm: trilinear, clamped at the border of the grid.

        Parameters
        ----------
        world
            Positions, mm, shape ``(n, 3)``.
        """
        result = np.empty(len(world))
        for start in range(0, len(world), _BLOCK_POINTS):
            result[start : start + _BLOCK_POINTS] = self._at(world[start : start + _BLOCK_POINTS])
        return result

    def _at(self, world: Points) -> Values:
        """Edge length at some positions."""
        last = np.array(self.values.shape) - 1
        index = np.clip(self.to_index(world), 0, last)
        base = np.minimum(index.astype(np.int64), np.maximum(last - 1, 0))
        fraction = index - base
        above, below = np.ascontiguousarray(fraction.T), np.ascontiguousarray((1.0 - fraction).T)
        result = np.zeros(len(world))
        for corner in _CUBE_CORNERS:
            weight = np.ones(len(world))
            for axis in range(3):
                weight *= above[axis] if corner[axis] else below[axis]
            at = np.minimum(base + corner, last)
            result += weight * self.values[at[:, 0], at[:, 1], at[:, 2]]
        return result


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
    step = np.asarray(image.direction_matrix, dtype=np.float64) * np.asarray(image.spacing)
    first = np.array(image.extent[::2], dtype=np.float64)
    return SizingField(
        values=values.reshape(dimensions, order="F"),
        step=step,
        origin=np.asarray(image.origin, dtype=np.float64) + step @ first,
        history=history_of(image),
    )


def uniform_sizing_field(surface: Surface, edge_length: float) -> SizingField:
    """Build a size field of one length, on a coarse grid round the object.

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
    return SizingField(values, np.eye(3) * spacing, low - spacing, None)


def _inside_nodes(surface_index: Points, triangles: Cells, shape: tuple[int, int, int]) -> NDArray[np.bool_]:
    """Which nodes of a grid lie inside a surface given in the index positions of that grid; shape ``shape``."""
    stencil = vtkPolyDataToImageStencil()
    stencil.SetInputData(to_polydata(np.ascontiguousarray(surface_index), triangles))
    stencil.SetOutputOrigin(0.0, 0.0, 0.0)
    stencil.SetOutputSpacing(1.0, 1.0, 1.0)
    stencil.SetOutputWholeExtent(0, shape[0] - 1, 0, shape[1] - 1, 0, shape[2] - 1)
    to_image = vtkImageStencilToImage()
    to_image.SetInputConnection(stencil.GetOutputPort())
    to_image.SetInsideValue(1)
    to_image.SetOutsideValue(0)
    to_image.SetOutputScalarTypeToUnsignedChar()
    to_image.Update()
    image = pv.wrap(to_image.GetOutput())
    inside: NDArray[np.bool_] = np.asarray(image.point_data.active_scalars).reshape(shape, order="F") > 0
    return inside


def _dilate(cells: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Add the 26 neighbours of every marked cell."""
    for axis in range(3):
        padded = np.pad(cells, [(1, 1) if k == axis else (0, 0) for k in range(3)])
        low, mid, high = (np.take(padded, range(s, s + cells.shape[axis]), axis=axis) for s in range(3))
        cells = low | mid | high
    return cells


def background_mesh(field: SizingField, surface: Surface, max_nodes: int = MAX_BACKGROUND_NODES) -> Background:
    """Put the size field on tetrahedra that cover the object.

    Parameters
    ----------
    field
        The size field.
    surface
        The surface of the object, world coordinates.
    max_nodes
        The grid is thinned to every second, third, ... voxel until no more nodes than this are needed.

    Returns
    -------
    Background
        It reaches at least one cell beyond the surface wherever the grid does.
    """
    surface_index = field.to_index(surface.points)
    last = np.array(field.values.shape) - 1
    stride = 1
    while True:
        # Nodes every `stride` voxels; the last one may lie beyond the grid, where h is clamped to its border.
        low = np.maximum(np.floor(surface_index.min(axis=0)) - 2 * stride, 0)
        high = np.minimum(np.ceil(surface_index.max(axis=0)) + 2 * stride, last)
        cells_along = np.maximum(np.ceil((high - low) / stride).astype(np.int64), 1)
        local = (surface_index - low) / stride
        nx, ny, nz = (int(n) for n in cells_along)
        inside = _inside_nodes(local, surface.triangles, (nx + 1, ny + 1, nz + 1))
        wanted = np.zeros((nx, ny, nz), dtype=bool)
        for i, j, k in _CUBE_CORNERS:
            wanted |= inside[i : i + nx, j : j + ny, k : k + nz]
        touched = np.clip(np.floor(local).astype(np.int64), 0, cells_along - 1)
        wanted[touched[:, 0], touched[:, 1], touched[:, 2]] = True
        wanted = _dilate(wanted)
        cells = np.argwhere(wanted)
        corners = cells[:, None, :] + _CUBE_CORNERS
        flat = (corners[..., 0] * (ny + 1) + corners[..., 1]) * (nz + 1) + corners[..., 2]
        used, renumbered = np.unique(flat, return_inverse=True)
        if len(used) <= max_nodes:
            break
        stride += 1

    renumbered = renumbered.reshape(flat.shape)
    odd = cells.sum(axis=1) % 2
    tetrahedra = np.concatenate([renumbered[odd == way][:, cut] for way in (0, 1) for cut in _FIVE_TETRAHEDRA[way]])
    nodes = np.stack([used // ((ny + 1) * (nz + 1)), used // (nz + 1) % (ny + 1), used % (nz + 1)], 1)
    points = field.to_world(nodes * float(stride) + low)
    return Background(points, tetrahedra, field.at(points), stride)


def world_grid(field: SizingField, surface: Surface, factor: float, max_nodes: int = MAX_GRID_NODES) -> WorldGrid:
    """Put the size field on a grid along the world's axes, over the bounding box of the object.

    Parameters
    ----------
    field
        The size field.
    surface
        The surface of the object, world coordinates.
    factor
        What the edge lengths are multiplied by.
    max_nodes
        The spacing is the smallest of the field, or larger where that would take more nodes than this.
    """
    low, high = surface.points.min(axis=0), surface.points.max(axis=0)
    spacing = float(np.linalg.norm(field.step, axis=0).min())
    while True:
        count = np.ceil((high - low) / spacing).astype(np.int64) + 1
        nodes = float(np.prod(count.astype(np.float64)))
        if nodes <= max_nodes:
            break
        spacing *= max(1.01, float(np.cbrt(nodes / max_nodes)))
    axes = [low[k] + spacing * np.arange(count[k]) for k in range(3)]
    values = np.empty(tuple(int(n) for n in count))
    thickness = max(1, _SLAB_NODES // int(count[1] * count[2]))
    for start in range(0, len(axes[0]), thickness):  # in slabs, so that memory stays bounded
        slab = axes[0][start : start + thickness]
        nodes_of_slab = np.stack(np.meshgrid(slab, axes[1], axes[2], indexing="ij"), axis=-1).reshape(-1, 3)
        values[start : start + thickness] = factor * field.at(nodes_of_slab).reshape(len(slab), *values.shape[1:])
    return WorldGrid(values, low, spacing)
