"""Caps: where the faces of the volume cut the object."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import pyvista as pv
from numpy.typing import NDArray

from tetmesh_check.datasets import to_polydata
from tetmesh_check.quality import Cells, Labels, Points, Values
from tetmesh_check.regions import distfield_parameter

SIDES = ("x0", "x1", "y0", "y1", "z0", "z1")
"""Faces of the volume: its axes in the order of the file, at the first and at the last voxel."""
NO_SIDE = -1
MAX_ANGLE = 30.0
"""Maximum angle between a triangle of a cap and the face of the volume, degrees. Rims of caps are
rounded. With this angle and :data:`MAX_DEPTH`, the caps of a tube and of a half ball (radius 12 and
14 voxels, edges of 0.75 and 2 voxels) have 95 to 99 % of their exact area. The triangles with all
corners within 0.1 voxel of the face have 59 to 92 %. If the surface meets the face at 37 degrees,
part of its rounded rim counts, and the caps have 113 to 119 %. The volumes were meshed with
`make surface INPUT=tube.nrrd LABELS=1,2` or `MATERIALS=lumen:1,wall:2`, `SIZE=2` or `SCALE=0`."""
MAX_DEPTH = 0.25
"""Maximum distance of the centroid of a triangle of a cap from the face of the volume, voxels."""


class Border(NamedTuple):
    """The six faces of the volume, in LPS."""

    axes: Points
    """Unit vectors of the axes of the volume, as rows."""
    positions: Values
    """Position of each of :data:`SIDES` along its axis, mm, shape ``(6,)``."""
    spacing: Values
    """Size of a voxel along each axis, mm, shape ``(3,)``."""


def border_of(image: pv.ImageData, history: Any) -> Border | None:
    """Return the faces of the volume of which a file has a field; ``None`` if they are unknown.

    The grid of a field extends the volume by the margin of ``distfield``. If ``distfield`` crops
    the volume to the object, it leaves voxels of the outside at the new faces, which have no caps.

    Parameters
    ----------
    image
        A field in LPS, on the grid of ``distfield``.
    history
        The history in the file.
    """
    margin = distfield_parameter(history, "margin")
    if not isinstance(margin, int) or distfield_parameter(history, "border") != "cap":
        return None
    axes, spacing = np.asarray(image.direction_matrix).T, np.asarray(image.spacing)
    # the faces are half a voxel beyond the outermost voxel centres
    ends = np.array([[margin - 0.5, count - margin - 0.5] for count in image.dimensions])
    positions = (axes @ np.asarray(image.GetPoint(0)))[:, None] + spacing[:, None] * ends
    return Border(axes, positions.ravel(), spacing)


def cap_sides(
    points: Points, triangles: Cells, outer: NDArray[np.bool_], flags: NDArray[np.bool_] | None, border: Border | None
) -> Labels:
    """Return the face of the volume that each triangle lies on, from 0, or :data:`NO_SIDE`.

    Parameters
    ----------
    points, triangles
        The surface, in LPS.
    outer
        Whether each triangle has the outside in front.
    flags
        For one object, whether ``reconstruct`` counts each triangle as a cap; ``None`` for many
        materials. Faces of the volume without such a triangle have no cap: the object is just flat.
    border
        The faces of the volume. If they are unknown, only ``flags`` count.
    """
    corners = points[triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    along = np.divide(normals, lengths, out=np.zeros_like(normals), where=lengths > 0.0)
    along = along @ (np.eye(3) if border is None else border.axes).T
    axis = np.abs(along).argmax(axis=1)
    cosine = along[np.arange(len(along)), axis]
    side = 2 * axis + (cosine > 0.0)
    if border is None:
        is_cap = np.zeros(len(side), dtype=bool) if flags is None else flags
        return np.asarray(np.where(is_cap & outer, side, NO_SIDE))
    depth = np.einsum("ij,ij->i", corners.mean(axis=1), border.axes[axis]) - border.positions[side]
    is_cap = outer & (np.abs(cosine) > np.cos(np.radians(MAX_ANGLE)))
    is_cap &= np.abs(depth) < MAX_DEPTH * border.spacing[axis]
    if flags is not None:
        is_cap &= np.isin(side, side[flags & is_cap])
    return np.asarray(np.where(is_cap, side, NO_SIDE))


def connected(points: Points, triangles: Cells, classes: Labels) -> Labels:
    """Return the number of the connected piece of each triangle, from 0.

    Triangles of different classes are not connected.

    Parameters
    ----------
    points, triangles
        The triangles.
    classes
        Class of each triangle.
    """
    corners = np.column_stack([np.repeat(classes, 3), triangles.ravel()])
    unique, local = np.unique(corners, axis=0, return_inverse=True)
    mesh = to_polydata(points[unique[:, 1]], local.reshape(-1, 3))
    return np.asarray(mesh.connectivity(extraction_mode="all").cell_data["RegionId"]).astype(np.int64)
