"""A cut through the middle of a volume mesh, along faces of tetrahedra."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pyvista as pv

from tetmesh_check.quality import Cells, Labels, Points, centres_of
from tetmesh_check.topology import tetrahedron_boundary


@dataclass(frozen=True)
class Cut:
    """The outside of the farther half."""

    triangles: Cells
    """Vertex indices, outward, shape ``(k, 3)``."""
    owners: Labels
    """Tetrahedron of each triangle, shape ``(k,)``."""
    normal: Points
    """From the half that is kept towards the eye, along an axis of the world; shape ``(3,)``."""
    up: Points
    """Upward direction of the picture, shape ``(3,)``."""


def cut_through_the_middle(points: Points, tetrahedra: Cells) -> Cut:
    """Cut across the shortest side of the object, at the median of the tetrahedra.

    Parameters
    ----------
    points
        Positions, mm, shape ``(n, 3)``.
    tetrahedra
        Vertex indices, shape ``(m, 4)``.
    """
    axis = int(np.argmin(np.ptp(points, axis=0)))
    normal = np.zeros(3)
    normal[axis] = -1.0 if axis == 1 else 1.0
    up = np.array([0.0, 1.0, 0.0]) if axis == 2 else np.array([0.0, 0.0, 1.0])
    depth = centres_of(points @ normal, tetrahedra)
    kept = np.flatnonzero(depth < np.median(depth))
    if len(kept) == 0:  # all in one plane
        kept = np.arange(len(tetrahedra))
    outside = tetrahedron_boundary(tetrahedra[kept])
    return Cut(outside.triangles, kept[outside.owners], normal, up)


def cut_of(volume: pv.UnstructuredGrid) -> Cut:
    """Cut a volume mesh as ``tetmesh-check`` writes it.

    Parameters
    ----------
    volume
        The mesh.
    """
    points = np.asarray(volume.points, dtype=np.float64)
    tetrahedra = np.asarray(volume.cells_dict[pv.CellType.TETRA], dtype=np.int64)
    return cut_through_the_middle(points, tetrahedra)
