"""Measures the tetrahedra for the report, and marks their regions and their boundary."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from isoparticles._native import Context, changed_triangles, distances_both_ways, surface_topology

from tetmesh_check.checks import Check, check, counted, percent, poor_tetrahedra, smallest_elsewhere
from tetmesh_check.export.mesh import MarkedMesh, materials_mesh, object_mesh
from tetmesh_check.fem.solve import VolumeMesh
from tetmesh_check.forced import list_forced
from tetmesh_check.gap import open_gaps
from tetmesh_check.layer_measures import describe_layers, loose_faces
from tetmesh_check.layers import add_layers
from tetmesh_check.materials import NOTHING, Conformity
from tetmesh_check.parts.measure import describe_parts
from tetmesh_check.parts.model import Parts
from tetmesh_check.quality import (
    Labels,
    Values,
    centres_of,
    summarize,
    summarize_all,
    summarize_distances,
    triangle_quality,
)
from tetmesh_check.regions import meshed_labels, regions_of, share_outside
from tetmesh_check.split import split
from tetmesh_check.surface import Surface, volume_table
from tetmesh_check.tets.fill import Filled, Task
from tetmesh_check.topology import Boundary, tetrahedron_boundary
from tetmesh_check.volumes import InputVolume

MAX_SHARE_OUTSIDE = 0.05
"""Share of the tetrahedra outside the label volume above which there is a warning."""


def _boundary(surface: Surface, filled: Filled, outside: Boundary) -> dict[str, Any]:
    """Compare the boundary of the tetrahedra with the triangles of the surface of one object."""
    missing, added = changed_triangles(surface.points, surface.triangles, filled.points, outside.triangles)
    topology = surface_topology(len(filled.points), outside.triangles)
    used = len(np.unique(outside.triangles))
    return {
        "boundary_kept": missing == added == 0,
        "boundary_triangles": {"missing": missing, "added": added},
        "boundary_topology": {**topology, "unused_vertices": 0, "vertices": used},
    }


def _shapes(task: Task, filled: Filled) -> dict[str, Any]:
    """Return the shapes of the tetrahedra."""
    points, quality, limits = task.surface.shown(filled.points), filled.quality, task.arguments.limits
    return {
        "points": len(points),
        "quality": summarize_all(quality),
        "poor_tetrahedra": poor_tetrahedra(points, filled.tetrahedra, quality, limits),
    }


def _interfaces(task: Task, filled: Filled, found: Conformity, volumes: Values, context: Context) -> dict[str, Any]:
    """Measure the regions of many materials, and how they fit the triangles between them."""
    assert task.forced is not None, "there are many materials"
    quality, regions = filled.quality, []
    for material in context.results["complex"]["materials"]:
        number = material["number"]
        if number == NOTHING:
            continue
        own = np.flatnonzero(found.regions == number)
        entry: dict[str, Any] = {
            "number": number,
            "name": material["name"],
            "tetrahedra": len(own),
            "parts": len(np.unique(found.parts[own])),
            "surface_parts": material["components"],
            "volume_mm3": float(volumes[own].sum()),
            "surface_volume_mm3": material["volume_mm3"],
        }
        if len(own):
            entry["quality"] = summarize_all(quality, own)
            entry["forced"] = int(filled.forced["min_dihedral"][own].sum())
        regions.append(entry)
    return {
        "interfaces_kept": found.missing == found.added == 0,
        "interface_triangles": {"missing": found.missing, "added": found.added},
        "crowded_faces": found.crowded,
        "undecided_tetrahedra": found.undecided,
        "forced_by_surface": list_forced(task.forced[0], "possible_degrees", task.surface, found, quality),
        "forced_by_triangle": list_forced(task.forced[1], "possible_scaled_jacobian", task.surface, found, quality),
        "smallest_elsewhere": smallest_elsewhere(quality, filled.forced),
        "regions": regions,
    }


def measure(task: Task, filled: Filled, context: Context) -> VolumeMesh:
    """Measure the tetrahedra for the report, and their distance from the surface of one object.

    Parameters
    ----------
    task, filled
        The surface, and the tetrahedra that fill it.
    context
        For the results.
    """
    surface, arguments, results = task.surface, task.arguments, context.results
    points, tetrahedra, quality, found = filled.points, filled.tetrahedra, filled.quality, filled.conformity
    with context.step("measure quality"):
        outside = tetrahedron_boundary(tetrahedra)
        volume = results["volume"] = {
            **_shapes(task, filled),
            "tetrahedra": len(tetrahedra),
            "bodies": int(outside.bodies.max()) + 1,
            "volume_mm3": float(quality.volume.sum()),
            "boundary_quality": summarize_all(triangle_quality(points, outside.triangles)),
        }
        if arguments.sizefield is not None:
            wanted = arguments.tet_size_factor * task.field.trilinear(centres_of(points, tetrahedra))
            volume["edge_length_over_target"] = summarize(quality.edge_length / wanted, np.linspace(0.0, 3.0, 61))
        if found is None:
            volume |= _boundary(surface, filled, outside)
        else:
            volume |= _interfaces(task, filled, found, quality.volume, context)
        regions = volume.get("regions", [{"name": "object", **volume}])
        results["volumes"] = volume_table(surface.volumes, {one["name"]: one["volume_mm3"] for one in regions})
    if found is None:
        with context.step("measure distances"):
            ways = distances_both_ways(points, outside.triangles, surface.points, surface.triangles)
            names = ("boundary_to_surface", "surface_to_boundary")
            results["distance_mm"] = {name: summarize_distances(way) for name, way in zip(names, ways, strict=True)}
    return VolumeMesh(points, tetrahedra, quality.volume, outside)


def _labels(mesh: VolumeMesh, surface: Surface, labels: InputVolume, context: Context) -> Labels:
    """Find the label of each tetrahedron, and measure the regions."""
    with context.step("regions"):
        centres = centres_of(mesh.points, mesh.tetrahedra)
        outside = share_outside(centres, labels)
        regions = regions_of(centres, labels, meshed_labels(surface.history))
    if outside > MAX_SHARE_OUTSIDE:
        context.warn(
            f"{100.0 * outside:.3g} % of the tetrahedra lie outside the label volume and get the region of "
            "the nearest voxel; check that the label volume belongs to this case (--labels-volume)"
        )
    context.results["regions"] = {
        str(label): {
            "tetrahedra": int((regions == label).sum()),
            "volume_mm3": float(mesh.volumes[regions == label].sum()),
            "voxels_mm3": float((labels.values == label).sum() * labels.voxel_volume),
        }
        for label in np.unique(regions).tolist()
    }
    return regions


def mark(
    surface: Surface,
    mesh: VolumeMesh,
    found: Conformity | None,
    parts: Parts,
    labels: InputVolume | None,
    context: Context,
) -> MarkedMesh:
    """Find the regions of the tetrahedra and the parts of their boundary.

    Parameters
    ----------
    surface, mesh
        The surface, and the tetrahedra that fill it.
    found
        How they fit the interfaces between many materials; ``None`` for one object.
    parts
        The parts of the surface.
    labels
        The label volume of one object, if there is one.
    context
        For the results.
    """
    outside, marks = mesh.boundary, parts.marks
    if surface.sides is not None and found is not None:
        marked = materials_mesh(mesh.points, mesh.tetrahedra, found, surface.triangles, surface.sides)
    else:
        if labels is None:
            regions, known = np.ones(len(mesh.tetrahedra), dtype=np.int64), meshed_labels(surface.history) or []
        else:
            regions, known = _labels(mesh, surface, labels, context), None
        marks = parts.on(surface, mesh.points, outside.triangles)
        marked = object_mesh(mesh.points, mesh.tetrahedra, regions, outside, marks, known)
    return replace(
        marked,
        marks=marks,
        parts={part.number: part.name for part in parts.rows},
        caps=frozenset(part.number for part in parts.rows if part.is_cap),
        unions={union.name: union.members for union in parts.unions},
        space=surface.space,
    )


def separate(
    task: Task, marked: MarkedMesh, filled: Filled, parts: Parts, context: Context
) -> tuple[MarkedMesh, Filled, list[Check]]:
    """Split interfaces and open their gaps, add layers to walls, and measure the parts.

    Parameters
    ----------
    task
        The surface.
    marked, filled
        The joined tetrahedra. In the report, points and shapes are then those of the open mesh;
        volumes, outer triangles and the fit to the interfaces remain those of the joined one.
    parts
        The parts, with both sides of the split interfaces, and the walls.
    context
        For the results.
    """
    result, checks = split(marked, parts), []
    if parts.splits and not result.contacts:
        context.warn("no interface is split, because tetrahedra beside triangles of the interfaces are missing")
    if result.contacts:
        with context.step("split interfaces"):
            opened = open_gaps(result, parts, filled.quality, task.arguments.limits)
        result, before, checks = replace(result, points=opened.points), filled.quality, opened.checks
        filled = filled._replace(points=result.points, tetrahedra=result.tetrahedra, quality=opened.quality)
        assert filled.conformity is not None, "there are many materials"
        context.results["volume"] |= _shapes(task, filled)
        context.results["volume"] |= _interfaces(task, filled, filled.conformity, before.volume, context)
        context.results["split"] = {
            "interfaces": opened.results,
            "min_dihedral": {
                "before": float(before.min_dihedral.min()),
                "after": float(opened.quality.min_dihedral.min()),
            },
            "regions": [
                {
                    "name": own.name,
                    "joined_mm3": float(before.volume[own.members].sum()),
                    "volume_mm3": float(opened.quality.volume[own.members].sum()),
                }
                for own in result.region_sets
            ],
        }
        for row in opened.results:
            _tell(row, context)
    if parts.walls:
        with context.step("layers"):
            result, filled, checks = _with_layers(task, result, filled, parts, context)
    with context.step("measure parts"):
        context.results["boundary"] = describe_parts(parts, result)
    return result, filled, checks


def _with_layers(
    task: Task, mesh: MarkedMesh, filled: Filled, parts: Parts, context: Context
) -> tuple[MarkedMesh, Filled, list[Check]]:
    """Add the layers of all walls, and measure them.

    In the report, points and shapes are then those of the mesh with layers; volumes and outer
    triangles remain those of the mesh without.
    """
    limits, before = task.arguments.limits, filled.quality
    quality, rows, checks = before, [], []
    for wall in parts.walls:
        found = add_layers(mesh, wall, quality, limits)
        row, own = describe_layers(found, mesh, wall)
        mesh, quality = found.mesh, found.quality
        rows.append(row)
        checks += own
        _tell_layers(row, wall.layers.told, context)
    volumes = [float(before.volume.sum()), float(quality.volume.sum() + sum(row["volume_mm3"] for row in rows))]
    change = 100.0 * (volumes[1] / volumes[0] - 1.0)
    checks.append(check("layer_faces", loose_faces(mesh)))
    checks.append(check("layer_volume", change, limits.max_volume_change, told=percent(change)))
    filled = filled._replace(points=mesh.points, tetrahedra=mesh.tetrahedra, quality=quality)
    context.results["volume"] |= _shapes(task, filled)
    if filled.conformity is not None:
        context.results["volume"] |= _interfaces(task, filled, filled.conformity, before.volume, context)
    smallest = {"before": float(before.min_dihedral.min()), "after": float(quality.min_dihedral.min())}
    total = {"without_mm3": volumes[0], "with_mm3": volumes[1]}
    context.results["layers"] = {"walls": rows, "volume": total, "min_dihedral": smallest}
    return mesh, filled, checks


def _tell_layers(found: dict[str, Any], option: str, context: Context) -> None:
    """Add the layers of a wall to the closing table; warn where they are thinner."""
    heights = found["first_height_mm"]
    told = "no full layers" if heights is None else f"first height {heights['min']:.4g} to {heights['max']:.4g} mm"
    context.closing.append(("layers", f"{found['prisms']:,} prisms, {told}"))
    if places := found["thinner"]:
        x, y, z = places[0]["place_mm"]
        context.warn(
            f"{option}: the layers are thinner at {counted(found['thinner_nodes'], 'node')} of "
            f"{found['nodes']:,}, in {counted(len(places), 'place')}, down to {100.0 * places[0]['share']:.3g} % of "
            f"their thickness at ({x:.6g}, {y:.6g}, {z:.6g}) mm (all: layers in the report)"
        )


def _tell(found: dict[str, Any], context: Context) -> None:
    """Add a split interface to the closing table; warn of positions without a checked gap."""
    name, told, width = found["interface"], f"{found['doubled_nodes']:,} nodes doubled", found.get("width_mm")
    if not found["doubled_nodes"]:
        context.warn(f"{name}: no node is doubled, because each is on a rim that another material connects")
    elif width and found["distance_mm"] is None:
        low, high = found["distance_at_rims_and_bends_mm"]
        context.warn(
            f"{name}: the width of the gap is not checked, because all of it is next to rims and bends, with distances "
            f"of {low:.4g} to {high:.4g} mm"
        )
    elif width:
        low, high = found["distance_mm"]
        told += f"; gap of {width:g} mm: {low:.4g} to {high:.4g} mm"
    context.closing.append((name, told))
    if places := found["shared_nodes_mm"]:
        x, y, z = places[0]
        context.warn(
            f"{name}: another material connects both sides at {counted(len(places), 'node')} of the rim (first at "
            f"({x:.6g}, {y:.6g}, {z:.6g}) mm; all: split in the report)" + ("; the gap closes there" if width else "")
        )
