"""Reads the input surface, of one object or of many materials; checks and measures it."""

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
from tetmesh_check.materials import CAP, NOTHING, Planes, Sides, read_planes, read_sides
from tetmesh_check.quality import Cells, Points, TriangleQuality, summarize_all, triangle_quality
from tetmesh_check.space import in_lps, space_of, turned
from tetmesh_check.topology import NOT_MANIFOLD, Components, Shells, members_of

_TOOLS = "use a surface from reconstruct, or repair this surface first"
"""Remedy for a surface that bounds no volumes."""

COLUMNS = ("voxels_mm3", "field_mm3", "mesh_mm3", "tetrahedra_mm3")
"""Keys of the volumes of an object or a material, in the order of the stages that compute them."""


@dataclass(frozen=True)
class Surface:
    """A triangle surface in world coordinates."""

    points: Points
    """Positions, mm, shape ``(n, 3)``."""
    triangles: Cells
    """Vertex indices, counter-clockwise seen from outside, shape ``(m, 3)``."""
    history: Any
    """The history in the file, or ``None``."""
    merged_points: int
    """Number of vertices with the same position as another one, which were merged."""
    cap: NDArray[np.bool_] | None = None
    """Whether each triangle lies where the border of the volume cuts the object, shape ``(m,)``;
    ``None`` if unknown."""
    sides: Sides | None = None
    """The materials on both sides of each triangle; ``None`` for the surface of one object."""
    planes: Planes | None = None
    """The planes at which the materials end, if there are any."""
    volumes: list[dict[str, Any]] = field(default_factory=list)
    """Volumes by material in the metadata of the surface, mm^3 (:func:`told_volumes`)."""
    space: str | None = None
    """World frame of the output: lps, ras, or ``None`` if unknown. ``points`` are in LPS if it is
    known."""

    def shown(self, points: Points) -> Points:
        """Convert positions to the world frame of the output.

        Parameters
        ----------
        points
            Positions in the frame of the surface, shape ``(n, 3)``.
        """
        return turned(points) if self.space == "ras" else points

    @property
    def bounding_box_diagonal(self) -> float:
        """Length of the diagonal of the bounding box, mm."""
        return float(np.linalg.norm(self.points.max(axis=0) - self.points.min(axis=0)))


def read_dataset(path: Path) -> pv.DataSet:
    """Read a file with PyVista, and convert it to LPS if it has an anatomical frame.

    Exceptions are converted to errors in three parts.

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
        return in_lps(pv.read(path), path)
    except Exception as error:
        raise file_error(path, "read", error, "check that the file is complete and matches its extension") from error
    finally:
        vtkObject.SetGlobalWarningDisplay(shown)


def history_of(dataset: pv.DataSet) -> Any:
    """Return the history in the field data of a file, or ``None``.

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


def told_volumes(surface: pv.PolyData) -> list[dict[str, Any]]:
    """Read the volumes that ``reconstruct`` writes into the metadata of a surface, if any.

    Parameters
    ----------
    surface
        The file as read.
    """
    try:
        rows = json.loads(text_of(surface, "meta") or "{}")["volumes"]
        return [{"name": str(row["name"]), **{key: row.get(key) for key in COLUMNS}} for row in rows]
    except (ValueError, KeyError, TypeError, AttributeError):
        return []


def with_changes(row: dict[str, Any]) -> dict[str, Any]:
    """Add ``change_percent``: the change of each volume from the first known one, percent.

    Parameters
    ----------
    row
        The volumes of an object or a material, mm^3; ``None`` if unknown.
    """
    known = {key: float(row[key]) for key in COLUMNS if row.get(key) is not None}
    first, *others = known
    changes = {key: 100.0 * (known[key] / known[first] - 1.0) for key in others} if known[first] > 0.0 else {}
    return {**row, "change_percent": changes}


def volume_table(told: list[dict[str, Any]], tetrahedra: dict[str, float]) -> list[dict[str, Any]]:
    """Complete the rows of a surface with the volumes of its tetrahedra.

    Parameters
    ----------
    told
        The rows of :func:`told_volumes`.
    tetrahedra
        Volume of the tetrahedra by material, mm^3. For one object, the name is ignored.
    """
    alone = next(iter(tetrahedra.values())) if len(told) == len(tetrahedra) == 1 else None
    return [with_changes({**row, "tetrahedra_mm3": tetrahedra.get(row["name"], alone)}) for row in told]


def read_surface(path: Path) -> Surface:
    """Read a triangle surface.

    Parameters
    ----------
    path
        A file that PyVista reads as polygons: ``.vtp``, ``.ply``, ``.stl``, ``.obj``, ``.vtk``.

    Raises
    ------
    StageError
        If the file is not a surface, is empty, or has polygons that are not triangles or
        coordinates that are not finite.
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
    sides = read_sides(path, dataset)
    planes = None if sides is None else read_planes(dataset)
    cap = np.asarray(dataset.cell_data[CAP]).ravel() != 0 if sides is None and CAP in dataset.cell_data else None
    # some formats (STL) and programs write a vertex once per triangle
    unique, inverse = np.unique(points, axis=0, return_inverse=True)
    merged = len(points) - len(unique)
    if merged:
        points, triangles = unique, inverse.ravel()[triangles].astype(np.int64)
        distinct = (triangles != np.roll(triangles, 1, axis=1)).all(axis=1)
        triangles = triangles[distinct]
        cap = None if cap is None else cap[distinct]
        sides = sides and Sides(sides.inside[distinct], sides.outside[distinct], sides.table)
        planes = planes and planes._replace(of_triangles=planes.of_triangles[distinct])
    if sides is not None:
        # with many materials, the vertices must all be used, because the tetrahedra keep them
        used, local = np.unique(triangles, return_inverse=True)
        points, triangles = points[used], local.reshape(-1, 3).astype(np.int64)
    volumes, space = told_volumes(dataset), space_of(dataset, path)
    return Surface(points, triangles, history_of(dataset), merged, cap, sides, planes, volumes, space)


def place_of(surface: Surface, corners: Cells) -> str:
    """Write the mean position of vertices in the world frame of the output.

    Parameters
    ----------
    surface
        The surface.
    corners
        Indices of the vertices.
    """
    x, y, z = surface.shown(surface.points[corners].reshape(-1, 3)).mean(axis=0)
    return f"({x:.6g}, {y:.6g}, {z:.6g}) mm"


def _crossing(surface: Surface, pairs: Cells) -> str:
    """Write how many triangles intersect each other, and where the first is."""
    place = place_of(surface, surface.triangles[pairs[0, 0]])
    return f"intersects itself: {len(np.unique(pairs))} triangles in {len(pairs)} pairs, the first near {place}"


def _check_object(path: Path, surface: Surface) -> tuple[dict[str, Any], Components]:
    """Refuse a surface of one object that bounds no volume; return its measures and components."""
    refuse = partial(refuse_file, path, remedy=_TOOLS)
    topology = _native.surface_topology(len(surface.points), surface.triangles)
    if any(topology[key] for key in NOT_MANIFOLD):
        refuse(
            f"is not a closed manifold: {topology['open_edges']} open edges, {topology['nonmanifold_edges']} edges "
            f"with more than two triangles, {topology['badly_oriented_edges']} edges whose triangles disagree on the "
            f"outside, {topology['nonmanifold_vertices']} vertices where parts of the surface only touch",
            "inside and outside are not defined, so there is no volume to fill",
        )
    components = Components(**_native.surface_components(surface.points, surface.triangles))
    wrong = components.inside_out()
    if len(wrong):
        refuse(
            f"{len(wrong)} of {topology['components']} components are inside out "
            f"(signed volume of the whole: {components.volumes.sum():.6g} mm^3)",
            "the triangles must be counter-clockwise as seen from outside, and those of a cavity as seen from inside "
            "the cavity",
            remedy=f"reverse the winding of these components; {_TOOLS}",
        )
    crossing = _native.self_intersections(surface.points, surface.triangles)
    if len(crossing):
        refuse(_crossing(surface, crossing), "the volume inside such a surface is ambiguous")
    return {"topology": topology, "volume_mm3": float(components.volumes.sum())}, components


def _check_materials(path: Path, surface: Surface, sides: Sides) -> Shells:
    """Refuse a surface of many materials that bounds no volumes; return the volumes."""
    refuse = partial(refuse_file, path, remedy=_TOOLS)
    points, triangles = surface.points, surface.triangles
    found = _native.check_complex(points, triangles, sides.inside, sides.outside, len(sides.table))
    flat, twice, wrong, crossing = found["flat"], found["duplicates"], found["open_edges"], found["crossing"]
    if len(flat):
        refuse(
            f"{len(flat)} triangles have no area, the first near {place_of(surface, triangles[flat[0]])}",
            "no tetrahedron with a positive volume can have such a face",
        )
    if len(twice):
        refuse(
            f"{len(twice)} triangles occur more than once, the first near {place_of(surface, triangles[twice[0]])}",
            "the space between two equal triangles is empty",
        )
    if wrong:
        words = ", ".join(f"{sides.names[number]} {count}" for number, count in wrong.items())
        refuse(
            f"the surfaces of {len(wrong)} materials are open or inconsistently oriented; number of such edges: "
            f"{words}",
            "such a material has no inside, so there is no volume to fill",
        )
    if found["shells"] is None:
        refuse(_crossing(surface, crossing), "points there would belong to two materials")
    shells = Shells(**found["shells"])
    if shells.mixed or shells.inside_out or (shells.of_inside < 0).any():
        refuse(
            f"is inside out: {shells.mixed} wedges between neighbouring triangles lie in two materials, "
            f"{shells.inside_out} closed surfaces enclose nothing",
            "each triangle must be counter-clockwise as seen from the material of the lower number",
            remedy=f"reverse the winding of these triangles; {_TOOLS}",
        )
    return shells


def _describe_materials(surface: Surface, sides: Sides, shells: Shells, quality: TriangleQuality) -> dict[str, Any]:
    """Count and measure a surface of many materials for the report."""
    count = len(sides.table)
    described = _native.describe_complex(surface.points, surface.triangles, sides.inside, sides.outside, count)
    found: dict[str, Any] = {**described}
    topologies, interfaces = found.pop("topologies"), found.pop("interfaces")
    areas = np.bincount(sides.inside, quality.area, count) + np.bincount(sides.outside, quality.area, count)
    volumes = np.bincount(shells.materials, shells.sizes, count)
    parts = np.bincount(shells.materials, minlength=count)
    pairs, which = sides.pairs()
    of_pairs = zip(pairs.tolist(), members_of(which, len(pairs)), interfaces, strict=True)
    return {
        "vertices": len(surface.points),
        "triangles": len(surface.triangles),
        **found,
        "materials": [
            {
                "number": number,
                "name": sides.names[number],
                "volume_mm3": None if number == NOTHING else float(volumes[number]),
                "components": None if number == NOTHING else int(parts[number]),
                "area_mm2": float(areas[number]),
                "smallest_wedge_degrees": None if number == NOTHING else float(shells.narrowest[number]),
                "topology": topology,
            }
            for number, topology in topologies.items()
        ],
        "interfaces": [
            {
                "inside": inside,
                "outside": outside,
                "name": sides.pair_name((inside, outside)),
                "triangles": len(own),
                "area_mm2": float(quality.area[own].sum()),
                "pieces": pieces,
                "rms_turn_degrees": turn,
                "quality": summarize_all(quality, own),
            }
            for (inside, outside), own, (pieces, turn) in of_pairs
        ],
    }


def check_surface(path: Path, surface: Surface) -> tuple[dict[str, Any], Components | Shells]:
    """Refuse a surface that bounds no volumes, and measure it for the report.

    Parameters
    ----------
    path
        Its file, for the messages.
    surface
        The surface as read.

    Returns
    -------
    tuple
        The measures, and the components of one object or the volumes of many materials. All
        surfaces have ``merged_points, area_mm2, bounding_box_diagonal_mm`` and ``quality``. One
        object has ``topology`` and ``volume_mm3``. Many materials have ``vertices``, ``triangles``,
        ``junction_edges`` (edges that do not have two triangles), ``junction_vertices`` (where one
        junction edge or more than two end), ``edges_by_triangles``, ``vertices_by_materials``,
        ``rms_turn_degrees`` (angle between the normals of neighbouring triangles of an interface),
        ``materials`` (volume, parts, smallest wedge and topology of each) and ``interfaces`` (area,
        connected pieces, quality and turn of each).

    Raises
    ------
    StageError
        If the surface of an object is open, not manifold, inconsistently wound, or inside out; if
        one of many materials has triangles without area or twice, is not closed for each material,
        or has triangles on the wrong side; if it intersects itself.
    """
    parts: Components | Shells
    quality = triangle_quality(surface.points, surface.triangles)
    if surface.sides is None:
        found, parts = _check_object(path, surface)
    else:
        parts = _check_materials(path, surface, surface.sides)
        found = _describe_materials(surface, surface.sides, parts, quality)
    shape = {
        "merged_points": surface.merged_points,
        "area_mm2": float(quality.area.sum()),
        "bounding_box_diagonal_mm": surface.bounding_box_diagonal,
        "quality": summarize_all(quality),
    }
    return shape | found, parts
