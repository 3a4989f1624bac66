"""Converts triangle meshes from and to PyVista, and stores texts in the field data of VTK files."""

from __future__ import annotations

import numpy as np
import pyvista as pv

from tetmesh_check.quality import Cells, Points


def to_polydata(points: Points, triangles: Cells) -> pv.PolyData:
    """Convert a triangle mesh to PyVista.

    Parameters
    ----------
    points
        Positions, mm, shape ``(n, 3)``.
    triangles
        Vertex indices, shape ``(m, 3)``.
    """
    return pv.PolyData(points, np.insert(triangles, 0, 3, axis=1).ravel())


def from_polydata(surface: pv.PolyData) -> tuple[Points, Cells]:
    """Return the points, mm, and the triangles of a mesh of PyVista.

    Parameters
    ----------
    surface
        The mesh; all its faces are triangles.
    """
    return np.asarray(surface.points, dtype=np.float64), np.asarray(surface.regular_faces, dtype=np.int64)


def add_text(dataset: pv.DataSet, name: str, text: str) -> None:
    """Store a text in the field data as bytes (UTF-8), because meshio cannot read VTK's strings.

    Parameters
    ----------
    dataset
        The data set.
    name
        Name of the array.
    text
        Any text without zero characters.
    """
    dataset.field_data.set_array(np.frombuffer(text.encode(), dtype=np.uint8).copy(), name)


def text_of(dataset: pv.DataSet, name: str) -> str | None:
    """Return a text of the field data, or ``None`` if there is none.

    Parameters
    ----------
    dataset
        A file as read; files written by older versions have strings.
    name
        Name of the array.
    """
    if name not in dataset.field_data:
        return None
    values = np.asarray(dataset.field_data[name]).ravel()
    if values.dtype == np.uint8:
        return values.tobytes().partition(b"\0")[0].decode(errors="replace")
    return str(values[0]) if len(values) else None
