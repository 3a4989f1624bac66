"""The 3-D view: which meshes it shows, coloured by what, and the controls around it."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pyvista as pv
from markupsafe import Markup

from tetmesh_check.datasets import from_polydata, text_of, to_polydata
from tetmesh_check.quality import OUTWARD_FACES, triangle_quality
from tetmesh_check.report.page.key import Entry
from tetmesh_check.report.page.payload import MAX_TRIANGLES, WORST, ViewMesh, pack
from tetmesh_check.report.page.templates import render
from tetmesh_check.report.pictures import boundary_of, cut_of
from tetmesh_check.surface import read_dataset

_YAW, _PITCH = 0.63, 0.38
"""Initial direction of view, radians; the same as in the pictures."""
_MAX_WORST = 5000
"""Largest number of tetrahedra among the worst: more only hide each other."""
_MAX_REGIONS = 12
"""Materials that can be looked at one by one, the largest first: the page grows with each."""


def is_anatomical(dataset: pv.DataSet) -> bool:
    """Whether a file of the pipeline says that its world is that of the body.

    Parameters
    ----------
    dataset
        The file as read.
    """
    return (text_of(dataset, "space") or "").strip('"').lower() == "lps"


def _add_edge_lengths(mesh: pv.PolyData) -> pv.PolyData:
    """Add the mean length of the edges at each vertex, mm."""
    points, triangles = from_polydata(mesh)
    edges = triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    lengths = np.linalg.norm(points[edges[:, 0]] - points[edges[:, 1]], axis=1)
    total = np.bincount(edges.ravel(), np.repeat(lengths, 2), len(points))
    mesh.point_data["edge_length"] = total / np.maximum(np.bincount(edges.ravel(), minlength=len(points)), 1)
    return mesh


def _with_quality(mesh: pv.PolyData) -> pv.PolyData:
    """Return the mesh with the radius ratios of its triangles."""
    made = mesh.copy(deep=False)
    made.cell_data["radius_ratio"] = triangle_quality(*from_polydata(mesh)).radius_ratio
    return made


def _views_of_volume(grid: pv.UnstructuredGrid, key: list[Entry]) -> list[ViewMesh]:
    """Return the half of the tetrahedra behind a cut, the worst ones, and each material."""
    cut = _add_edge_lengths(cut_of(grid)[0])
    ratio = grid.cell_data["radius_ratio"]
    count = min(max(1, round(grid.n_cells * WORST / 100.0)), _MAX_WORST)
    lowest = np.sort(np.argpartition(ratio, count - 1)[:count])
    faces = grid.cells_dict[pv.CellType.TETRA][lowest][:, OUTWARD_FACES].reshape(-1, 3)
    worst = to_polydata(grid.points, faces)
    for data in ("radius_ratio", "min_dihedral"):
        worst.cell_data[data] = np.repeat(grid.cell_data[data][lowest], len(OUTWARD_FACES))
    names = [str(entry["name"]) for entry in json.loads(text_of(grid, "materials") or "[]")]
    if names:
        cut.cell_data["material"] = cut.cell_data["region"]
    shades = {entry.name: entry.colour for entry in key}
    named = tuple((name, shades.get(name, (0, 0, 0))) for name in names)
    views = [ViewMesh("cut", cut, names=named), ViewMesh("worst tetrahedra", worst, within=True)]
    return [*views, *(_views_of_regions(grid, names) if names else [])]


def _views_of_regions(grid: pv.UnstructuredGrid, names: list[str]) -> list[ViewMesh]:
    """Each material inside a ghost of the whole, the largest first."""
    region = grid.cell_data["region"]
    numbers, counts = np.unique(region, return_counts=True)
    views: list[ViewMesh] = []
    left = MAX_TRIANGLES
    for material in numbers[np.argsort(-counts, kind="stable")][:_MAX_REGIONS].tolist():
        boundary = boundary_of(grid, region == material)
        left -= boundary.n_cells
        if left < 0:
            break
        boundary.clear_cell_data()
        views.append(ViewMesh(f"only {names[material]}", _with_quality(boundary), within=True))
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
    meshes = [] if surface is None else [ViewMesh("surface", _add_edge_lengths(_with_quality(surface)))]
    if volume is not None:
        grid = read_dataset(volume)
        if isinstance(grid, pv.UnstructuredGrid) and pv.CellType.TETRA in grid.cells_dict:
            meshes += _views_of_volume(grid, key)
    return [mesh for mesh in meshes if 0 < mesh.mesh.n_cells <= MAX_TRIANGLES]


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
