"""Reads the input surface; refuses open, inward or crossing triangles."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pyvista as pv
from isoparticles import _native
from numpy.typing import NDArray
from vtkmodules.vtkCommonCore import vtkObject

from tetmesh_check.datasets import from_polydata, text_of
from tetmesh_check.errors import file_error, refuse_file
from tetmesh_check.materials import Sides, read_sides
from tetmesh_check.quality import Cells, Points
from tetmesh_check.topology import NOT_MANIFOLD, Components, measure_components
from tetmesh_check.volume_table import told_volumes

TOOLS = "use a surface from reconstruct, or repair this surface first"
"""Remedy for a surface that bounds no volumes."""


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
    cap: NDArray[np.bool_] | None = None
    """Whether each triangle lies where the border of the volume cut the object, shape ``(m,)``;
    ``None`` if unknown."""
    sides: Sides | None = None
    """The materials on both sides of each triangle; ``None`` for the surface of one object."""
    volumes: list[dict[str, Any]] = field(default_factory=list)
    """Volumes by material in the metadata of the surface, mm^3 (:mod:`.volume_table`)."""

    @property
    def bounding_box_diagonal(self) -> float:
        """Length of the diagonal of the bounding box, mm."""
        return float(np.linalg.norm(self.points.max(axis=0) - self.points.min(axis=0)))


def read_dataset(path: Path) -> pv.DataSet:
    """Read a file by pyvista, with its complaints as one of our errors.

    Parameters
    ----------
    path
        The file.
    """
    if not path.is_file():
        refuse_file(path, "no such file", "the stage needs this file", "check the name, or run the previous stage")
    shown = vtkObject.GetGlobalWarningDisplay()
    vtkObject.SetGlobalWarningDisplay(0)
    try:
        return pv.read(path)
    except Exception as error:
        raise file_error(path, "read", error, "check that the file is complete and matches its extension") from error
    finally:
        vtkObject.SetGlobalWarningDisplay(shown)


def history_of(dataset: pv.DataSet) -> Any:
    """Return the history that a file of this pipeline carries in its field data, or ``None``.

    Parameters
    ----------
    dataset
        The file as read.
    """
    text = text_of(dataset, "history")
    try:
        return None if text is None else json.loads(text)
    except ValueError:
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
        If it is no surface, empty, has other polygons than triangles, or coordinates that are not
        finite.
    """
    dataset, refuse = read_dataset(path), partial(refuse_file, path)
    if not isinstance(dataset, pv.PolyData):
        refuse(
            f"holds a {type(dataset).__name__}, not a surface",
            "the tetrahedra fill a triangle surface",
            "use the surface that reconstruct wrote",
        )
    if dataset.n_faces == 0:
        refuse(
            f"is empty ({dataset.n_points} points, no triangles)",
            "there is nothing to fill",
            "check the file; if it is damaged or incomplete, run the previous stage again",
        )
    if not dataset.is_all_triangles:
        refuse(
            "has faces that are not triangles",
            "only triangle surfaces can be checked and filled",
            "triangulate it first",
        )
    points, triangles = from_polydata(dataset)
    bad = ~np.isfinite(points).all(axis=1)
    if bad.any():
        refuse(
            f"{int(bad.sum())} of {len(points)} vertices have coordinates that are not finite, "
            f"the first is number {int(np.flatnonzero(bad)[0])}",
            "these vertices have no position",
            "check the volume for NaN voxels, and run the previous stages again",
        )
    cap = np.asarray(dataset.cell_data["cap"]).ravel() != 0 if "cap" in dataset.cell_data else None
    sides = read_sides(path, dataset)
    # some formats (STL) and programs write a vertex once a triangle
    unique, inverse = np.unique(points, axis=0, return_inverse=True)
    merged = len(points) - len(unique)
    if merged:
        points, triangles = unique, inverse.ravel()[triangles].astype(np.int64)
        distinct = (triangles != np.roll(triangles, 1, axis=1)).all(axis=1)
        triangles = triangles[distinct]
        cap = None if cap is None else cap[distinct]
        sides = None if sides is None else sides.of(distinct)
    if sides is not None:
        # the tetrahedra keep every vertex, and those of many materials must all be in use
        used, local = np.unique(triangles, return_inverse=True)
        points, triangles = points[used], local.reshape(-1, 3).astype(np.int64)
    return Surface(points, triangles, history_of(dataset), merged, cap, sides, told_volumes(dataset))


def place_of(points: Points, corners: Cells) -> str:
    """Write the mean position of vertices.

    Parameters
    ----------
    points
        Positions, mm, shape ``(n, 3)``.
    corners
        Indices of the vertices.
    """
    x, y, z = points[corners].reshape(-1, 3).mean(axis=0)
    return f"({x:.6g}, {y:.6g}, {z:.6g}) mm"


def check_surface(path: Path, surface: Surface) -> tuple[dict[str, int], Components]:
    """Refuse a surface that bounds no volume.

    Parameters
    ----------
    path
        Its file, for the messages.
    surface
        The surface as read.

    Returns
    -------
    tuple
        Its counts, and its components.

    Raises
    ------
    StageError
        If it is open, not manifold, inconsistently wound, inside out, or cuts through itself.
    """
    refuse = partial(refuse_file, path, remedy=TOOLS)
    topology = _native.surface_topology(len(surface.points), surface.triangles)
    if any(topology[key] for key in NOT_MANIFOLD):
        refuse(
            f"is not a closed manifold: {topology['open_edges']} open edges, {topology['nonmanifold_edges']} edges "
            f"with more than two triangles, {topology['badly_oriented_edges']} edges whose triangles disagree on the "
            f"outside, {topology['nonmanifold_vertices']} vertices where parts of the surface only touch",
            "inside and outside are not defined, so there is no volume to fill",
        )
    components = measure_components(surface.points, surface.triangles)
    wrong = components.inside_out()
    if len(wrong):
        refuse(
            f"{len(wrong)} of {topology['components']} components are inside out "
            f"(signed volume of the whole: {components.volumes.sum():.6g} mm^3)",
            "the triangles must be counter-clockwise as seen from outside, and those of a cavity as seen from inside "
            "the cavity",
            remedy=f"reverse the winding of these components; {TOOLS}",
        )
    crossing = _native.self_intersections(surface.points, surface.triangles)
    if len(crossing):
        refuse(
            f"intersects itself: {len(np.unique(crossing))} triangles in {len(crossing)} pairs, the first "
            f"near {place_of(surface.points, surface.triangles[crossing[0, 0]])}",
            "the volume inside such a surface is ambiguous",
        )
    return topology, components
