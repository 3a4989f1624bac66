"""The 3-D view: which meshes it shows, coloured by what, and the controls around it."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pyvista as pv
from markupsafe import Markup

from tetmesh_check.field_data import text_of
from tetmesh_check.polydata import from_polydata
from tetmesh_check.quality import Cells, Labels, Points, Values, triangle_quality
from tetmesh_check.report.cut import cut_of
from tetmesh_check.report.page.key import Entry
from tetmesh_check.report.page.payload import MAX_TRIANGLES, WORST, Colour, ViewMesh, pack
from tetmesh_check.report.page.templates import render
from tetmesh_check.surface import read_dataset
from tetmesh_check.topology import tetrahedron_boundary

_YAW, _PITCH = 0.63, 0.38
"""Initial direction of view, radians; the same as in the pictures."""
_MAX_WORST = 5000
"""Largest number of tetrahedra among the worst: more only hide each other."""
_MAX_REGIONS = 12
"""Materials that can be looked at one by one, the largest first: the page grows with each."""


def _edge_lengths(points: Points, triangles: Cells) -> Values:
    """Mean length of the edges at each vertex, mm, shape ``(n,)``; 0 if unused."""
    total, uses = np.zeros(len(points)), np.zeros(len(points))
    for k in range(3):
        a, b = triangles[:, k], triangles[:, (k + 1) % 3]
        length = np.linalg.norm(points[a] - points[b], axis=1)
        for end in (a, b):
            total += np.bincount(end, length, len(points))
            uses += np.bincount(end, minlength=len(points))
    return np.divide(total, uses, out=np.zeros(len(points)), where=uses > 0)


def _edge_length(points: Points, triangles: Cells) -> Colour:
    return Colour("edge length", " mm", _edge_lengths(points, triangles), False)


def is_anatomical(dataset: pv.DataSet) -> bool:
    """Whether a file of the pipeline says that its world is that of the body.

    Parameters
    ----------
    dataset
        The file as read.
    """
    return (text_of(dataset, "space") or "").strip('"').lower() == "lps"


def view_of_surface(surface: pv.PolyData) -> ViewMesh:
    """Take a surface, its quality, edge lengths and deviation from F = 0.

    Parameters
    ----------
    surface
        The surface as read.
    """
    points, triangles = from_polydata(surface)
    colours = [
        Colour("radius ratio", "", triangle_quality(points, triangles).radius_ratio, True, "low"),
        _edge_length(points, triangles),
    ]
    if "deviation" in surface.cell_data:
        deviation = np.abs(np.asarray(surface.cell_data["deviation"], dtype=np.float64))
        if np.isfinite(deviation).all():
            colours.append(Colour("deviation from F = 0", " mm", deviation, True, "high"))
    return ViewMesh("surface", points, triangles, colours)


def views_of_volume(grid: pv.UnstructuredGrid, key: list[Entry]) -> list[ViewMesh]:
    """Take the half of the tetrahedra behind a cut, and the worst of all tetrahedra.

    Parameters
    ----------
    grid
        The volume mesh as read.
    key
        Names and colours of the materials.
    """
    points = np.asarray(grid.points, dtype=np.float64)
    cells = np.asarray(grid.cells_dict[pv.CellType.TETRA], dtype=np.int64)
    ratio = np.asarray(grid.cell_data["radius_ratio"], dtype=np.float64)
    dihedral = np.asarray(grid.cell_data["min_dihedral"], dtype=np.float64)

    def colours(owners: Cells) -> list[Colour]:
        return [
            Colour("radius ratio", "", ratio[owners], True, "low"),
            Colour("minimum dihedral angle", "\u00b0", dihedral[owners], True, "low"),
        ]

    cut = cut_of(grid)
    on_cut = [*colours(cut.owners), _edge_length(points, cut.triangles)]
    if (text := text_of(grid, "materials")) is not None:
        region = np.asarray(grid.cell_data["region"], dtype=np.int64)
        names = [str(entry["name"]) for entry in json.loads(text)]
        shades = {entry.name: entry.colour for entry in key}
        shown = tuple((name, shades.get(name, (0, 0, 0))) for name in names)
        on_cut.append(Colour("material", "", region[cut.owners].astype(np.float64), True, names=shown))
        singly = _views_of_regions(points, cells, region, names)
    else:
        singly = []
    count = min(max(1, round(len(cells) * WORST / 100.0)), _MAX_WORST)
    worst = np.sort(np.argpartition(ratio, count - 1)[:count])
    # the faces of a tetrahedron, outward
    faces = cells[worst][:, [[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]]].reshape(-1, 3)
    return [
        ViewMesh("cut", points, cut.triangles, on_cut),
        ViewMesh("worst tetrahedra", points, faces, colours(np.repeat(worst, 4)), within=True),
        *singly,
    ]


def _views_of_regions(points: Points, cells: Cells, region: Labels, names: list[str]) -> list[ViewMesh]:
    """Each material inside a ghost of the whole, the largest first."""
    numbers, counts = np.unique(region, return_counts=True)
    views: list[ViewMesh] = []
    left = MAX_TRIANGLES
    for material in numbers[np.argsort(-counts, kind="stable")][:_MAX_REGIONS].tolist():
        triangles = tetrahedron_boundary(cells[region == material]).triangles
        left -= len(triangles)
        if left < 0:
            break
        shape = Colour("radius ratio", "", triangle_quality(points, triangles).radius_ratio, True, "low")
        views.append(ViewMesh(f"only {names[material]}", points, triangles, [shape], within=True))
    return views


def view_meshes(surface: pv.PolyData | None, volume: Path | None, key: list[Entry]) -> list[ViewMesh]:
    """Gather what the 3-D view shows.

    Parameters
    ----------
    surface
        The surface as read.
    volume
        The file of the tetrahedra. Meshes of more than :data:`.MAX_TRIANGLES` triangles are left
        out.
    key
        Names and colours of the materials.
    """
    meshes = [] if surface is None else [view_of_surface(surface)]
    if volume is not None:
        grid = read_dataset(volume)
        if isinstance(grid, pv.UnstructuredGrid) and pv.CellType.TETRA in grid.cells_dict:
            meshes += views_of_volume(grid, key)
    return [mesh for mesh in meshes if 0 < len(mesh.triangles) <= MAX_TRIANGLES]


def view(meshes: list[ViewMesh], anatomical: bool, key: list[Entry]) -> str:
    """Write the 3-D view.

    Parameters
    ----------
    meshes
        The content; empty if there is none.
    anatomical
        Whether the world is that of the body.
    key
        Names and colours of the materials.
    """
    if not meshes:
        return ""
    about, data = pack(meshes, _YAW, _PITCH, anatomical)
    text = Markup(json.dumps(about).replace("<", "\\u003c"))
    return render("view", meshes=meshes, about=about, text=text, data=data, key=key, worst=WORST)
