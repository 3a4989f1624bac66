"""The 3-D view: which meshes it shows, and their data as text.

The text is base64 of deflated whole numbers, many of them differences.
"""

from __future__ import annotations

import base64
import json
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import pyvista as pv
from numpy.typing import NDArray

from tetmesh_check.datasets import from_polydata, text_of, to_polydata
from tetmesh_check.quality import OUTWARD_FACES, triangle_quality
from tetmesh_check.report.colours import Entry
from tetmesh_check.report.page.scan import world_letters
from tetmesh_check.report.pictures import boundary_of, cut_of

STEPS = 8191
"""Steps in half of the longest side of the object. A step is well below a pixel."""
MAX_TRIANGLES = 1_000_000
"""Larger meshes are omitted from the view. For `ribs`, 579,140 triangles and 287,010 on the cut
take 5.5 MB of the page."""
_WHOLE_VALUES = 300_000
"""Values of meshes with more triangles have 8 bits instead of 16, which halves their deflated
size."""
_RANGE = (1.0, 99.0)
"""Percentiles at the ends of the colour bar, so that a few extreme values do not set its range."""
WORST = 1.0
"""Percent of the triangles that 'worst' shows."""
_YAW, _PITCH = 0.63, 0.38
"""Initial direction of view, radians; the same as in the pictures."""
_SIDEWAYS = (np.cos(_YAW), np.sin(_YAW), 0.0)
_UPWARDS = (-np.sin(_PITCH) * np.sin(_YAW), np.sin(_PITCH) * np.cos(_YAW), np.cos(_PITCH))
"""Axes of the picture in that view."""
_MAX_WORST = 5000
"""Maximum number of worst tetrahedra. More would hide each other."""
_MAX_REGIONS = 12
"""Maximum number of materials that are also shown alone, the largest first. Each makes the page
larger."""


class Measure(NamedTuple):
    """A measure that meshes can be coloured by."""

    data: str
    """Name of the data of triangles or vertices."""
    name: str
    """As the page calls it."""
    unit: str = ""
    """With a space before it, as in ``" mm"``."""
    worst: str = ""
    """``low`` or ``high``: which end is bad; empty if none is."""


MEASURES = (
    Measure("radius_ratio", "radius ratio", worst="low"),
    Measure("min_dihedral", "minimum dihedral angle", "\u00b0", "low"),
    Measure("edge_length", "edge length", " mm"),
    Measure("deviation", "deviation from F = 0", " mm", "high"),
    Measure("material", "material"),
)
"""If the chosen measure has no bad end, the first one of the mesh defines which triangles are the
worst."""


@dataclass(frozen=True)
class ViewMesh:
    """One mesh of the view."""

    name: str
    """Name on the page."""
    mesh: pv.PolyData
    """Triangles. Their cell data and point data are the measures."""
    within: bool = False
    """Whether it lies inside the object, and is shown within a ghost of the first mesh."""
    names: tuple[tuple[str, tuple[int, int, int]], ...] = ()
    """The name and the colour of each ``material``."""


def is_anatomical(dataset: pv.DataSet) -> bool:
    """Return whether the world frame in a file of the pipeline is anatomical: LPS or RAS.

    Parameters
    ----------
    dataset
        The file as read.
    """
    return (text_of(dataset, "space") or "").strip('"').lower() in ("lps", "ras")


def _add_edge_lengths(mesh: pv.PolyData) -> pv.PolyData:
    """Add the mean length of the edges at each vertex, mm."""
    points, triangles = from_polydata(mesh)
    edges = triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    lengths = np.linalg.norm(points[edges[:, 0]] - points[edges[:, 1]], axis=1)
    total = np.bincount(edges.ravel(), np.repeat(lengths, 2), len(points))
    mesh.point_data["edge_length"] = total / np.maximum(np.bincount(edges.ravel(), minlength=len(points)), 1)
    return mesh


def _add_quality(mesh: pv.PolyData) -> pv.PolyData:
    """Add the radius ratios of the triangles."""
    mesh.cell_data["radius_ratio"] = triangle_quality(*from_polydata(mesh)).radius_ratio
    return mesh


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
    """Return each material inside a ghost of the whole, the largest first."""
    region = grid.cell_data["region"]
    numbers, counts = np.unique(region, return_counts=True)
    views: list[ViewMesh] = []
    for material in numbers[np.argsort(-counts, kind="stable")][:_MAX_REGIONS].tolist():
        boundary = boundary_of(grid, region == material)
        if boundary.n_cells + sum(view.mesh.n_cells for view in views) > MAX_TRIANGLES:
            break
        boundary.clear_cell_data()
        views.append(ViewMesh(f"only {names[material]}", _add_quality(boundary), within=True))
    return views


def view_meshes(surface: pv.PolyData | None, volume: pv.UnstructuredGrid | None, key: list[Entry]) -> list[ViewMesh]:
    """Return the meshes of the 3-D view.

    Parameters
    ----------
    surface
        The surface as read.
    volume
        The tetrahedra as read. Meshes of more than :data:`.MAX_TRIANGLES` triangles are left
        out.
    key
        Names and colours of the materials.
    """
    meshes = [] if surface is None else [ViewMesh("surface", _add_edge_lengths(_add_quality(surface.copy(deep=False))))]
    if volume is not None:
        meshes += _views_of_volume(volume, key)
    return [mesh for mesh in meshes if 0 < mesh.mesh.n_cells <= MAX_TRIANGLES]


def _planes(numbers: NDArray[Any]) -> bytes:
    """Return the first bytes of all numbers, then the second ones and so on."""
    return numbers.view(np.uint8).reshape(len(numbers), -1).T.tobytes()


def _differences(numbers: NDArray[Any]) -> bytes:
    """Return the differences of whole numbers in zigzag code, as four planes of bytes."""
    steps = np.diff(numbers, prepend=0)
    return _planes(np.where(steps < 0, -2 * steps - 1, 2 * steps).astype("<u4"))


def measures_of(mesh: pv.PolyData) -> list[Measure]:
    """Return the measures by which a mesh can be coloured.

    Parameters
    ----------
    mesh
        Triangles.
    """
    return [m for m in MEASURES if m.data in mesh.array_names and np.isfinite(mesh[m.data]).all()]


def pack(meshes: list[ViewMesh], anatomical: bool = True) -> tuple[dict[str, Any], str]:
    """Pack meshes for the page.

    Parameters
    ----------
    meshes
        The meshes, in LPS if there is an anatomical frame; the first is shown first.
    anatomical
        Whether there is an anatomical frame.

    Returns
    -------
    tuple
        Description of the data for the script, and the data.
    """
    # `clean` numbers the used vertices in the order of the triangles, so differences are small
    shown = [view.mesh.clean(point_merging=False) for view in meshes]
    points = np.concatenate([mesh.points for mesh in shown])
    low, high = points.min(axis=0), points.max(axis=0)
    centre, half = 0.5 * (low + high), 0.5 * float((high - low).max()) or 1.0
    data = bytearray()

    def add(part: bytes) -> int:
        data.extend(part)
        return len(data) - len(part)

    listed = [
        {
            "name": view.name,
            "within": view.within,
            "point_count": mesh.n_points,
            "triangle_count": mesh.n_cells,
            "points": add(_differences(np.round(STEPS * (mesh.points - centre) / half).T.ravel())),
            "triangles": add(_differences(from_polydata(mesh)[1].ravel())),
            "colours": [_colour(measure, mesh, view.names, add) for measure in measures_of(mesh)],
        }
        for view, mesh in zip(meshes, shown, strict=True)
    ]
    about = {
        "meshes": listed,
        "step": 1.0 / STEPS,
        "half": half,
        "centre": centre.tolist(),
        "reach": (1.08 * np.abs((points - centre) / half @ np.transpose([_SIDEWAYS, _UPWARDS])).max(axis=0)).tolist(),
        "yaw": _YAW,
        "pitch": _PITCH,
        "letters": world_letters(anatomical),
        "anatomical": anatomical,
    }
    return about, base64.b64encode(zlib.compress(data, 9)).decode("ascii")


def _colour(
    measure: Measure, mesh: pv.PolyData, names: tuple[tuple[str, Any], ...], add: Callable[[bytes], int]
) -> dict[str, Any]:
    """Describe a measure for the script, and add its values to the data."""
    values = np.abs(mesh[measure.data])
    least, largest = float(values.min()), float(values.max())
    steps = 65535 if mesh.n_cells <= _WHOLE_VALUES else 255
    whole = np.round(steps * (values - least) / max(largest - least, 1e-300)).astype("<u2")
    low, high = (float(v) for v in np.percentile(values, _RANGE))
    worst = {"low": WORST, "high": 100.0 - WORST}.get(measure.worst)
    return {
        "name": measure.name,
        "unit": measure.unit,
        "on_triangles": measure.data in mesh.cell_data,
        "start": add(_planes(whole * np.uint16(65535 // steps))),
        "least": least,
        "largest": largest,
        "low": low,
        "high": high if high > low else low + max(abs(low), 1.0) * 1e-6,
        "worst": measure.worst,
        "names": [name for name, _ in names if measure.data == "material"],
        "palette": [part for _, shade in names for part in shade],
        "threshold": None if worst is None else float(np.percentile(values, worst)),
    }
