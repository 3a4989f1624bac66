"""Triangle meshes as pyvista holds them, and as arrays."""

from __future__ import annotations

import numpy as np
import pyvista as pv

from tetmesh_check.quality import Cells, Points


def to_polydata(points: Points, triangles: Cells) -> pv.PolyData:
    """Build pyvista's form of a triangle mesh.

    Parameters
    ----------
    points
        Positions, mm, shape ``(n, 3)``.
    triangles
        Vertex indices, shape ``(m, 3)``.
    """
    return pv.PolyData(points, np.hstack([np.full((len(triangles), 1), 3), triangles]).ravel())


def from_polydata(surface: pv.PolyData) -> tuple[Points, Cells]:
    """Points, mm, and triangles of pyvista's form of a triangle mesh.

    Parameters
    ----------
    surface
        The mesh; all its faces are triangles.
    """
    points = np.asarray(surface.points, dtype=np.float64)
    return points, np.asarray(surface.faces, dtype=np.int64).reshape(-1, 4)[:, 1:]
