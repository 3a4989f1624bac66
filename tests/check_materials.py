"""Check how well a surface of many materials preserves its labels, independently of the stages.

    python tests/check_materials.py CASE.surface.vtp LABELS.vti [--volume FILE] [--json FILE]

LABELS.vti is the output of `isoparticles-volume convert VOLUME -o LABELS.vti`. If
`--smallest-island` has reassigned voxels, use the indicator file of distfield instead, which
contains the material of each node. The check then does not compare these materials with the labels.
The material of every voxel centre is found by tracing lines through the voxel centres and the
triangles, starting outside. Junctions are compared by position; triangles and tetrahedra are
measured. The check shares no code with the programs that made the files. The last line is `PASSED`
or lists the differences; if there are differences, the exit code is 1.
"""

from __future__ import annotations

import argparse
import itertools
import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pyvista as pv
from numpy.typing import NDArray
from scipy import ndimage
from scipy.spatial import cKDTree

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

OFF_LATTICE = (3.1e-9, 7.3e-9)
"""Offsets of the traced lines from the voxel centres in y and z, as fractions of the spacing.

The offsets keep the lines away from the edges of capped faces. Positions have errors of about
1e-13 of the spacing. The distance from a facet to a centre can be as small as 3e-5 of the spacing,
and the facet must stay on the correct side of the centre.
"""
NEAR = 1.5
"""Maximum distance in voxels between matching junctions of the voxels and of the mesh."""
SMALL_COMPONENT = 8
"""Maximum number of voxels of a component that may be missing in the mesh."""
SMALL_JUNCTION = 2
"""Materials that meet along this many voxel edges or fewer need not meet in the mesh."""


def note(data: pv.DataSet, name: str) -> Any:
    """Parse a JSON string in the field data."""
    return json.loads(bytes(np.asarray(data.field_data[name]).astype(np.uint8)).decode())


def materials_of(labels: pv.ImageData, table: list[dict[str, Any]]) -> Integers:
    """Return the material of each voxel, shape (nx, ny, nz)."""
    if "material" in labels.point_data:
        return np.asarray(labels.point_data["material"]).reshape(labels.dimensions, order="F").astype(np.int64)
    values = np.asarray(labels.point_data["values"]).reshape(labels.dimensions, order="F").astype(np.int64)
    materials = np.zeros(labels.dimensions, dtype=np.int64)
    for number, row in enumerate(table):
        for label in row["labels"]:
            layer = label["layer"]
            own = values
            if layer:
                own = np.asarray(labels.point_data[f"values_of_layer_{layer}"]).reshape(labels.dimensions, order="F")
            materials[own == label["label"]] = number
    return materials


def into_voxels(points: Floats, labels: pv.ImageData) -> Floats:
    """Convert world positions into fractional voxel indices."""
    matrix = np.asarray(labels.direction_matrix).reshape(3, 3) * np.asarray(labels.spacing)
    return np.linalg.solve(matrix, (points - np.asarray(labels.origin)).T).T


def crossings(
    corners: Floats, inside: Integers, outside: Integers, size: tuple[int, ...]
) -> tuple[Integers, Floats, Integers, Integers]:
    """Find the crossings of triangles with lines along x through voxel centres.

    Returns the line numbers, the x positions, and the materials before and behind each crossing,
    sorted by line and x.
    """
    lines, places, before, behind = [], [], [], []
    yz = corners[:, :, 1:] - np.asarray(OFF_LATTICE)
    low = np.maximum(np.ceil(yz.min(axis=1)).astype(np.int64), 0)
    high = np.minimum(np.floor(yz.max(axis=1)).astype(np.int64), np.asarray(size[1:]) - 1)
    # `area` is twice the signed area of the projection onto the y-z plane. It is positive if a line
    # along +x crosses the triangle from the material inside to the material outside.
    a, b, c = yz[:, 0], yz[:, 1], yz[:, 2]
    area = (b[:, 0] - a[:, 0]) * (c[:, 1] - a[:, 1]) - (b[:, 1] - a[:, 1]) * (c[:, 0] - a[:, 0])
    span = np.maximum(high - low + 1, 0)
    for t in np.flatnonzero((span.prod(axis=1) > 0) & (area != 0.0)):
        y, z = np.meshgrid(np.arange(low[t, 0], high[t, 0] + 1), np.arange(low[t, 1], high[t, 1] + 1), indexing="ij")
        y, z = y.ravel(), z.ravel()
        u = ((b[t, 0] - y) * (c[t, 1] - z) - (b[t, 1] - z) * (c[t, 0] - y)) / area[t]
        v = ((c[t, 0] - y) * (a[t, 1] - z) - (c[t, 1] - z) * (a[t, 0] - y)) / area[t]
        hit = (u >= 0) & (v >= 0) & (u + v <= 1)
        if not hit.any():
            continue
        x = u * corners[t, 0, 0] + v * corners[t, 1, 0] + (1 - u - v) * corners[t, 2, 0]
        first, second = (inside[t], outside[t]) if area[t] > 0 else (outside[t], inside[t])
        count = int(hit.sum())
        lines.append(y[hit] * size[2] + z[hit])
        places.append(x[hit])
        before.append(np.full(count, first))
        behind.append(np.full(count, second))
    empty = np.empty(0)
    joined = [np.concatenate(parts) if parts else empty for parts in (lines, places, before, behind)]
    order = np.lexsort((joined[1], joined[0]))
    line, place, first, second = (part[order] for part in joined)
    return line.astype(np.int64), place, first.astype(np.int64), second.astype(np.int64)


def follow_lines(
    corners: Floats, inside: Integers, outside: Integers, size: tuple[int, ...]
) -> tuple[Integers, int, tuple[int, int]]:
    """Return the material at each voxel centre, the number of wrong crossings, and the contacts.

    A crossing is wrong if its first material is not the current material of the line. Contacts
    are neighbours of different materials along x. The two counts are the contacts with another
    material between the neighbours, and all contacts.
    """
    line, place, before, behind = crossings(corners, inside, outside, size)
    found = np.zeros(size, dtype=np.int64)
    wrong = interrupted = contacts = 0
    bounds = np.append(np.flatnonzero(np.diff(line, prepend=-1)), len(line))
    for start, end in itertools.pairwise(bounds):
        own = slice(start, end)
        row = found[:, line[start] // size[2], line[start] % size[2]]
        known = np.concatenate(([0], behind[own]))
        wrong += int((known[:-1] != before[own]).sum()) + int(known[-1] != 0)
        passed = np.searchsorted(place[own], np.arange(size[0]))
        row[:] = known[passed]
        differ = row[1:] != row[:-1]
        contacts += int(differ.sum())
        interrupted += int((differ & (np.diff(passed) > 1)).sum())
    return found, wrong, (interrupted, contacts)


def grid_junctions(materials: Integers, open_ones: bool) -> dict[tuple[int, ...], Floats]:
    """Return the midpoints (in voxels) of voxel edges where three or more materials meet.

    The keys are the materials. Everything beyond the volume is outside (material 0). If each of the
    four voxels at an edge differs from both face neighbours, the labels do not determine which
    opposite pair touches. `open_ones` selects these edges or all other edges.
    """
    padded = np.pad(materials, 1)
    found: dict[tuple[int, ...], list[Floats]] = {}
    for axis in range(3):
        u, v = (axis + 1) % 3, (axis + 2) % 3
        own = np.moveaxis(padded, (u, v, axis), (0, 1, 2))
        four = np.stack([own[:-1, :-1], own[1:, :-1], own[1:, 1:], own[:-1, 1:]])
        is_open = (four != np.roll(four, 1, axis=0)).all(axis=0)
        four.sort(axis=0)
        distinct = 1 + (np.diff(four, axis=0) != 0).sum(axis=0)
        for place in np.argwhere((distinct >= 3) & (is_open == open_ones)):
            names = tuple(np.unique(four[:, place[0], place[1], place[2]]).tolist())
            middle = np.empty(3)
            middle[[u, v, axis]] = place[0] - 0.5, place[1] - 0.5, place[2] - 1.0
            found.setdefault(names, []).append(middle)
    return {names: np.asarray(places) for names, places in found.items()}


def mesh_junctions(
    points: Floats, triangles: Integers, inside: Integers, outside: Integers
) -> dict[tuple[int, ...], Floats]:
    """Return the midpoints of mesh edges that do not have two triangles, by adjacent materials."""
    edges = np.sort(triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    owner = np.repeat(np.arange(len(triangles)), 3)
    unique, inverse, counts = np.unique(edges, axis=0, return_inverse=True, return_counts=True)
    order = np.argsort(inverse.ravel(), kind="stable")
    starts = np.concatenate(([0], np.cumsum(counts)))
    found: dict[tuple[int, ...], list[Floats]] = {}
    for edge in np.flatnonzero(counts != 2):
        own = owner[order[starts[edge] : starts[edge + 1]]]
        names = tuple(np.unique(np.concatenate((inside[own], outside[own]))).tolist())
        found.setdefault(names, []).append(points[unique[edge]].mean(axis=0))
    return {names: np.asarray(places) for names, places in found.items()}


def share_near(
    places: dict[tuple[int, ...], Floats], others: dict[tuple[int, ...], Floats], has: Any
) -> tuple[int, int]:
    """Count the points with a match within NEAR whose materials satisfy `has`, and all points."""
    near = total = 0
    for names, own in places.items():
        total += len(own)
        matching = [points for other, points in others.items() if has(names, other)]
        if matching:
            distance, _ = cKDTree(np.concatenate(matching)).query(own)
            near += int((distance < NEAR).sum())
    return near, total


def triangle_figures(points: Floats, triangles: Integers, pair: Integers) -> dict[str, float]:
    """Return radius ratios 2 r / R, angles, and angles between adjacent normals, in degrees."""
    corners = points[triangles]
    sides = corners[:, [2, 0, 1]] - corners[:, [1, 2, 0]]
    length = np.linalg.norm(sides, axis=2)
    normal = np.cross(sides[:, 2], -sides[:, 1])
    area = 0.5 * np.linalg.norm(normal, axis=1)
    half = 0.5 * length.sum(axis=1)
    ratio = 8.0 * area**2 / (half * length.prod(axis=1))
    a, b, c = length.T
    cosine = np.stack(
        [(b**2 + c**2 - a**2) / (2 * b * c), (c**2 + a**2 - b**2) / (2 * c * a), (a**2 + b**2 - c**2) / (2 * a * b)]
    )
    angles = np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0)))
    edges = np.sort(triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    _, inverse, counts = np.unique(edges, axis=0, return_inverse=True, return_counts=True)
    owner = np.repeat(np.arange(len(triangles)), 3)
    inner = np.flatnonzero(counts[inverse.ravel()] == 2)
    pairs = owner[inner[np.argsort(inverse.ravel()[inner], kind="stable")]].reshape(-1, 2)
    pairs = pairs[pair[pairs[:, 0]] == pair[pairs[:, 1]]]
    unit = normal / np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-300)
    turn = np.degrees(np.arccos(np.clip((unit[pairs[:, 0]] * unit[pairs[:, 1]]).sum(axis=1), -1.0, 1.0)))
    return {
        "radius_ratio_mean": float(ratio.mean()),
        "radius_ratio_smallest": float(ratio.min()),
        "angle_smallest": float(angles.min()),
        "angle_largest": float(angles.max()),
        "turn_rms": float(np.sqrt((turn**2).mean())),
    }


def unbalanced_edges(triangles: Integers, inside: Integers, outside: Integers, count: int) -> int:
    """Return the number of edges at which the outward boundary of a material is not closed."""
    wrong = 0
    for number in range(count):
        turned = np.concatenate((triangles[inside == number], triangles[outside == number][:, ::-1]))
        ends = turned[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
        sign = np.where(ends[:, 0] < ends[:, 1], 1, -1)
        _, inverse = np.unique(np.sort(ends, axis=1), axis=0, return_inverse=True)
        wrong += int((np.bincount(inverse.ravel(), weights=sign) != 0).sum()) if len(ends) else 0
    return wrong


def smallest_dihedrals(volume: pv.UnstructuredGrid) -> Floats:
    """Return the minimum dihedral angle of each tetrahedron in degrees."""
    corners = np.asarray(volume.points)[volume.cells_dict[pv.CellType.TETRA]]
    faces = [(1, 2, 3), (0, 3, 2), (0, 1, 3), (0, 2, 1)]
    normals = np.stack(
        [np.cross(corners[:, j] - corners[:, i], corners[:, k] - corners[:, i]) for i, j, k in faces], axis=1
    )
    normals /= np.linalg.norm(normals, axis=2, keepdims=True)
    angles = [
        180.0 - np.degrees(np.arccos(np.clip((normals[:, i] * normals[:, j]).sum(axis=1), -1, 1)))
        for i in range(4)
        for j in range(i)
    ]
    smallest: Floats = np.min(angles, axis=0)
    return smallest


def lost_components(materials: Integers, found: Integers) -> list[str]:
    """Return components above SMALL_COMPONENT voxels that lost their material in all voxels."""
    lost = []
    for number in np.unique(materials[materials > 0]).tolist():
        parts, count = ndimage.label(materials == number)
        sizes = np.bincount(parts.ravel(), minlength=count + 1)
        kept = np.bincount(parts[found == number].ravel(), minlength=count + 1)
        lost += [
            f"{number}: {sizes[part]} voxels"
            for part in range(1, count + 1)
            if sizes[part] > SMALL_COMPONENT and kept[part] == 0
        ]
    return lost


def look(surface: pv.PolyData, labels: pv.ImageData, volume: pv.UnstructuredGrid | None) -> dict[str, Any]:
    """Compute all figures."""
    table = note(surface, "meta")["materials"]
    materials = materials_of(labels, table)
    points = np.asarray(surface.points, dtype=np.float64)
    triangles = surface.regular_faces.astype(np.int64)
    inside, outside = (
        np.asarray(surface.cell_data[f"material_{side}"]).astype(np.int64) for side in ("inside", "outside")
    )
    in_voxels = into_voxels(points, labels)
    # Conversion to the coordinates of a left-handed grid mirrors the triangles. Reversing the
    # vertex order restores their orientation.
    corners = in_voxels[triangles]
    if np.linalg.det(np.asarray(labels.direction_matrix).reshape(3, 3)) < 0:
        corners = corners[:, ::-1]
    found, wrong, counted = follow_lines(corners, inside, outside, materials.shape)
    interrupted, contacts = counted
    for axes in ((1, 2, 0), (2, 0, 1)):
        turned = tuple(materials.shape[axis] for axis in axes)
        _, _, counted = follow_lines(corners[:, :, axes], inside, outside, turned)
        interrupted, contacts = interrupted + counted[0], contacts + counted[1]
    grid, left_open = grid_junctions(materials, open_ones=False), grid_junctions(materials, open_ones=True)
    mesh = mesh_junctions(in_voxels, triangles, inside, outside)
    has = lambda names, other: set(names) <= set(other) or set(other) <= set(names)  # noqa: E731
    kept, junctions = share_near(grid, mesh, has)
    open_kept, open_junctions = share_near(left_open, mesh, has)
    every = {
        names: np.concatenate([places[names] for places in (grid, left_open) if names in places])
        for names in grid.keys() | left_open.keys()
    }
    real, edges = share_near(mesh, every, has)
    lost = [
        names
        for names, places in every.items()
        if len(places) > SMALL_JUNCTION and not any(set(names) <= set(other) for other in mesh)
    ]
    figures: dict[str, Any] = {
        "materials": len(table),
        "vertices": len(points),
        "triangles": len(triangles),
        "voxels_changed": int((found != materials).sum()),
        "voxels_changed_percent": 100.0 * float((found != materials).mean()),
        "crossings_wrong": wrong,
        "unbalanced_edges": unbalanced_edges(triangles, inside, outside, len(table)),
        "components_lost": lost_components(materials, found),
        "contacts_interrupted": interrupted,
        "contacts": contacts,
        "junctions_lost": junctions - kept,
        "junctions_kept_percent": 100.0 * (kept + open_kept) / max(junctions + open_junctions, 1),
        "junctions_left_open": open_junctions,
        "junctions_left_open_that_are_there": open_kept,
        "junctions_spurious_percent": 100.0 * (1.0 - real / max(edges, 1)),
        "materials_that_no_longer_meet": [list(names) for names in lost],
        **triangle_figures(points, triangles, inside * len(table) + outside),
    }
    if volume is not None:
        smallest = smallest_dihedrals(volume)
        figures |= {
            "tetrahedra": len(smallest),
            "dihedral_smallest": float(smallest.min()),
            "dihedral_1_percent": float(np.percentile(smallest, 1)),
        }
    return figures


def main() -> int:
    """Run the program."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("surface", type=Path)
    parser.add_argument("labels", type=Path)
    parser.add_argument("--volume", type=Path, help="the tetrahedra")
    parser.add_argument(
        "--scaled", action="store_true", help="the labels were smoothed: voxels and junctions may have changed"
    )
    parser.add_argument("--json", type=Path, help="write the figures to this file")
    arguments = parser.parse_args()
    volume = pv.read(arguments.volume) if arguments.volume else None
    figures = look(pv.read(arguments.surface), pv.read(arguments.labels), volume)
    if arguments.json:
        arguments.json.write_text(json.dumps(figures, indent=1) + "\n")
    for name, value in figures.items():
        print(f"{name:32} {value:.4g}" if isinstance(value, float) else f"{name:32} {value}")
    must_be_none = ["crossings_wrong", "unbalanced_edges"]
    if not arguments.scaled:
        must_be_none += ["voxels_changed", "components_lost", "materials_that_no_longer_meet", "junctions_lost"]
    differing = [name for name in must_be_none if figures[name]]
    print("PASSED" if not differing else f"DIFFERS: {', '.join(differing)}")
    return 1 if differing else 0


if __name__ == "__main__":
    sys.exit(main())
