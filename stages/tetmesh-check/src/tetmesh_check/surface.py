"""The input surface: read, and refused unless it is a closed, outward, non-crossing triangle mesh."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyvista as pv
from vtkmodules.vtkCommonCore import vtkObject

from tetmesh_check.errors import StageError
from tetmesh_check.intersections import self_intersections
from tetmesh_check.quality import Cells, Labels, Points, Values
from tetmesh_check.topology import Topology, measure_topology, triangle_components

_TOOLS = "reconstruct writes surfaces that pass; another program's needs repairing first"


@dataclass(frozen=True)
class Surface:
    """A triangle surface in world coordinates."""

    points: Points
    """Positions, mm, shape ``(n, 3)``."""
    triangles: Cells
    """Vertex indices, counter-clockwise seen from outside, shape ``(m, 3)``."""
    history: Any
    """The history that the file carries, or ``None``."""
    merged_points: int
    """Vertices that lay exactly on another one and were joined to it."""

    @property
    def bounding_box_diagonal(self) -> float:
        """Length of the diagonal of the bounding box, mm."""
        return float(np.linalg.norm(self.points.max(axis=0) - self.points.min(axis=0)))

    def volume(self) -> float:
        """Signed volume, mm^3; positive for an outward surface."""
        return float(component_volumes(self.points, self.triangles, np.zeros(len(self.triangles), np.int64))[0])


def read_dataset(path: Path) -> pv.DataSet:
    """Read a file by pyvista, with its complaints as one of our errors.

    Parameters
    ----------
    path
        The file.
    """
    if not path.is_file():
        raise StageError(
            f"{path}: no such file", "the stage needs this file", "check the name, or run the stage before"
        )
    shown = vtkObject.GetGlobalWarningDisplay()
    vtkObject.SetGlobalWarningDisplay(0)
    try:
        return pv.read(path)
    except StageError:
        raise
    except Exception as error:
        raise StageError.file(path, "read", error, "check that it is complete and of the kind its name says") from error
    finally:
        vtkObject.SetGlobalWarningDisplay(shown)


def history_of(dataset: pv.DataSet) -> Any:
    """Return the history that a file of this pipeline carries in its field data, or ``None``.

    Parameters
    ----------
    dataset
        The file as read.
    """
    if "history" not in dataset.field_data:
        return None
    try:
        return json.loads(str(np.asarray(dataset.field_data["history"]).ravel()[0]))
    except (ValueError, IndexError):
        return None


def read_surface(path: Path) -> Surface:
    """Read a triangle surface.

    Parameters
    ----------
    path
        Anything that pyvista reads as polygons: ``.vtp``, ``.ply``, ``.stl``, ``.obj``, ``.vtk``.

    Raises
    ------
    StageError
        If it is no surface, empty, has other polygons than triangles, or coordinates that are not finite.
    """
    dataset = read_dataset(path)
    if not isinstance(dataset, pv.PolyData):
        raise StageError(
            f"{path}: holds a {type(dataset).__name__}, not a surface",
            "tetrahedra are made inside a triangle surface",
            "give the surface that reconstruct wrote",
        )
    if dataset.n_faces == 0:
        raise StageError(
            f"{path}: is empty ({dataset.n_points} points, no triangles)",
            "there is nothing to fill",
            "check the file; if it was damaged or cut short, run the stage before again",
        )
    if not dataset.is_all_triangles:
        raise StageError(
            f"{path}: has faces that are not triangles",
            "only triangle surfaces are checked and filled",
            "triangulate it first",
        )
    points = np.asarray(dataset.points, dtype=np.float64)
    triangles = np.asarray(dataset.faces, dtype=np.int64).reshape(-1, 4)[:, 1:]
    bad = ~np.isfinite(points).all(axis=1)
    if bad.any():
        raise StageError(
            f"{path}: {int(bad.sum())} of {len(points)} vertices have coordinates that are not finite, "
            f"the first is number {int(np.flatnonzero(bad)[0])}",
            "such a vertex lies nowhere",
            "find out which stage wrote it; the volume may hold NaN voxels",
        )
    # some formats (STL) and programs write a vertex once a triangle
    unique, inverse = np.unique(points, axis=0, return_inverse=True)
    merged = len(points) - len(unique)
    if merged:
        points, triangles = unique, inverse.ravel()[triangles].astype(np.int64)
        distinct = (triangles != np.roll(triangles, 1, axis=1)).all(axis=1)
        triangles = triangles[distinct]
    return Surface(points, triangles, history_of(dataset), merged)


def component_volumes(points: Points, triangles: Cells, labels: Labels) -> Values:
    """Signed volume of each component, mm^3.

    Parameters
    ----------
    points
        Positions, mm, shape ``(n, 3)``.
    triangles
        Vertex indices, shape ``(m, 3)``.
    labels
        Component of each triangle, shape ``(m,)``.
    """
    centred = points - points.mean(axis=0)
    a, b, c = (centred[triangles[:, k]] for k in range(3))
    volumes: Values = np.bincount(labels, weights=np.einsum("ij,ij->i", a, np.cross(b, c)) / 6.0).astype(np.float64)
    return volumes


def _generic_rotation() -> Points:
    """Build a rotation without any relation to the axes, so that rays do not run along rows of vertices."""
    rotation, _ = np.linalg.qr(np.array([[0.36, 0.48, -0.8], [-0.81, 0.57, 0.13], [0.52, 0.64, 0.57]]))
    return np.asarray(rotation)


def inside_out_components(points: Points, triangles: Cells) -> list[int]:
    """Find the components that are turned the wrong way round.

    A component that lies in the open must have a positive volume, one that bounds a cavity (it lies inside one other
    body) a negative one.

    Parameters
    ----------
    points
        Positions, mm, shape ``(n, 3)``.
    triangles
        Vertex indices of a closed surface, shape ``(m, 3)``.

    Returns
    -------
    list of int
        Numbers of the components.
    """
    labels = triangle_components(len(points), triangles)
    volumes = component_volumes(points, triangles, labels)
    if len(volumes) == 1:
        return [] if volumes[0] > 0 else [0]
    turned = points @ _generic_rotation().T
    corner = turned[triangles]
    low, high = corner.min(axis=1), corner.max(axis=1)
    first_triangle = np.unique(labels, return_index=True)[1]
    wrong = []
    for label, volume in enumerate(volumes):
        x, y, z = turned[triangles[first_triangle[label], 0]]
        near = (low[:, 1] <= y) & (high[:, 1] >= y) & (low[:, 2] <= z) & (high[:, 2] >= z) & (high[:, 0] >= x)
        index = np.flatnonzero(near & (labels != label))
        # Signed crossings of the ray from this vertex along +x with all other components: how many enclose it.
        a, b, c = (corner[index, k] for k in range(3))
        s = [(q[:, 1] - y) * (r[:, 2] - z) - (q[:, 2] - z) * (r[:, 1] - y) for q, r in ((b, c), (c, a), (a, b))]
        area = s[0] + s[1] + s[2]
        through = ((s[0] > 0) & (s[1] > 0) & (s[2] > 0)) | ((s[0] < 0) & (s[1] < 0) & (s[2] < 0))
        weight = np.where(through, area, 1.0)
        at = (s[0] * a[:, 0] + s[1] * b[:, 0] + s[2] * c[:, 0]) / weight
        enclosing = int(np.sign(area[through & (at > x)]).sum())
        if volume <= 0 if enclosing == 0 else volume >= 0:
            wrong.append(label)
    return wrong


def check_surface(path: Path, surface: Surface) -> Topology:
    """Refuse a surface that bounds no volume.

    Parameters
    ----------
    path
        Its file, for the messages.
    surface
        The surface as read.

    Returns
    -------
    Topology
        Its counts.

    Raises
    ------
    StageError
        If it is open, not manifold, inconsistently wound, inside out, or cuts through itself.
    """
    topology = measure_topology(surface.points, surface.triangles)
    if not topology.is_closed_manifold:
        raise StageError(
            f"{path}: is no closed manifold: {topology.open_edges} open edges, {topology.nonmanifold_edges} edges with "
            f"more than two triangles, {topology.badly_oriented_edges} edges whose triangles disagree on the outside, "
            f"{topology.nonmanifold_vertices} vertices where sheets only touch",
            "inside and outside are not defined, so there is no volume to fill",
            _TOOLS,
        )
    wrong = inside_out_components(surface.points, surface.triangles)
    if wrong:
        raise StageError(
            f"{path}: {len(wrong)} of {topology.components} components are inside out "
            f"(signed volume of the whole: {surface.volume():.6g} mm^3)",
            "the triangles must be counter-clockwise seen from outside, and a cavity's from within it",
            "turn the winding of these components round; " + _TOOLS,
        )
    crossing = self_intersections(surface.points, surface.triangles)
    if len(crossing):
        where = surface.points[surface.triangles[crossing[0, 0]]].mean(axis=0)
        raise StageError(
            f"{path}: cuts through itself: {len(np.unique(crossing))} triangles in {len(crossing)} pairs, the first "
            f"near ({where[0]:.6g}, {where[1]:.6g}, {where[2]:.6g}) mm",
            "the volume inside such a surface is ambiguous, and tetrahedra would hide the fault",
            _TOOLS,
        )
    return topology
