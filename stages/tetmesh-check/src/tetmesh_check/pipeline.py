"""The run of the stage: check the surface, fill it, measure, judge, write."""

from __future__ import annotations

from typing import Any

import numpy as np
from isoparticles._native import GridField

from tetmesh_check.arguments import Arguments
from tetmesh_check.checks import Measurements, conclude, poor_tetrahedra, run_checks, surface_volume_checks
from tetmesh_check.components import Components
from tetmesh_check.context import Context
from tetmesh_check.distance import distances_both_ways, summarize_distances
from tetmesh_check.errors import StageError
from tetmesh_check.export.formats import export
from tetmesh_check.export.mesh import MarkedMesh
from tetmesh_check.export.volume import write_quadratic, write_volume
from tetmesh_check.fem.forward import resolve_source
from tetmesh_check.fem.solve import VolumeMesh, solve_on
from tetmesh_check.fields import read_distance_field
from tetmesh_check.labels import LabelVolume, read_label_volume
from tetmesh_check.materials_run import run_materials
from tetmesh_check.memory import check_memory
from tetmesh_check.quadratic import Quadratic, make_quadratic
from tetmesh_check.quality import Values, centres_of, summarize, summarize_all, tetrahedron_quality, triangle_quality
from tetmesh_check.regions import (
    CAP,
    boundary_marks,
    check_labels,
    has_scale,
    meshed_labels,
    regions_of,
    share_outside,
)
from tetmesh_check.report.drawing import drawing
from tetmesh_check.sizing import SizingField, read_sizing_field, uniform_sizing_field
from tetmesh_check.surface import Surface, check_surface, read_surface
from tetmesh_check.tets.fill import Filled, Task, fill
from tetmesh_check.topology import Topology, changed_triangles, measure_topology, tetrahedron_boundary
from tetmesh_check.volume_table import volume_table

MAX_SHARE_OUTSIDE = 0.05
"""Share of the tetrahedra outside the label volume above which there is a warning."""
ENVELOPE_FRACTION = 0.05
"""Default envelope over the edge length that 95 % of the surface exceed: small enough that thin walls stay apart."""


def _size(surface: Surface, sizing: SizingField | None, context: Context) -> tuple[SizingField, Values]:
    """Edge lengths everywhere, and those at the surface, mm."""
    if sizing is not None:
        at_surface = sizing.at(surface.points)
        bins = np.linspace(0.0, float(at_surface.max()), 51)
        context.results["sizing"] = {"voxel_mm": sizing.grid.voxel, "at_surface": summarize(at_surface, bins)}
        return sizing, at_surface
    lengths = triangle_quality(surface.points, surface.triangles).edge_length
    median = float(np.median(lengths))
    context.warn(f"no --sizefield was given: all tetrahedra get the median edge length of the surface, {median:.4g} mm")
    return uniform_sizing_field(surface, median), lengths


def _surface_results(surface: Surface, topology: Topology, components: Components) -> dict[str, Any]:
    quality = triangle_quality(surface.points, surface.triangles)
    return {
        "topology": topology.as_dict(),
        "merged_points": surface.merged_points,
        "area_mm2": float(quality.area.sum()),
        "volume_mm3": float(components.volumes.sum()),
        "bounding_box_diagonal_mm": surface.bounding_box_diagonal,
        "quality": summarize_all(quality),
    }


def _measure(
    surface: Surface,
    topology: Topology,
    components: Components,
    sizing: SizingField | None,
    filled: Filled,
    envelope: float,
    arguments: Arguments,
    context: Context,
) -> tuple[Measurements, VolumeMesh]:
    points, tetrahedra = filled.points, filled.tetrahedra
    with context.step("measure quality"):
        quality = tetrahedron_quality(points, tetrahedra)
        outside = tetrahedron_boundary(tetrahedra)
        boundary, bodies = outside.triangles, int(outside.bodies.max()) + 1
        boundary_topology = measure_topology(points, boundary)
        missing, added = changed_triangles((surface.points, surface.triangles), (points, boundary))
        context.results["volume"] = {
            "points": len(points),
            "tetrahedra": len(tetrahedra),
            "bodies": bodies,
            "volume_mm3": float(quality.volume.sum()),
            "quality": summarize_all(quality),
            "poor_tetrahedra": poor_tetrahedra(points, tetrahedra, quality, arguments.limits),
            "boundary_kept": missing == added == 0,
            "boundary_triangles": {"missing": missing, "added": added},
            "boundary_topology": {
                **boundary_topology.as_dict(),
                "unused_vertices": 0,
                "vertices": len(np.unique(boundary)),
            },
            "boundary_quality": summarize_all(triangle_quality(points, boundary)),
        }
        context.results["volumes"] = volume_table(surface.volumes, {"object": float(quality.volume.sum())})
        if sizing is not None:
            wanted = arguments.tet_size_factor * sizing.at(centres_of(points, tetrahedra))
            context.results["volume"]["edge_length_over_target"] = summarize(
                quality.edge_length / wanted, np.linspace(0.0, 3.0, 61)
            )
    with context.step("measure distances"):
        to_surface, to_boundary = distances_both_ways((points, boundary), (surface.points, surface.triangles))
        context.results["distance_mm"] = {
            "boundary_to_surface": summarize_distances(to_surface),
            "surface_to_boundary": summarize_distances(to_boundary),
        }
    measured = Measurements(
        quality=quality,
        surface_volume=float(components.volumes.sum()),
        surface_bodies=int((components.volumes > 0).sum()),
        surface_topology=topology,
        boundary_topology=boundary_topology,
        bodies=bodies,
        boundary_distance=float(to_surface.max()),
        surface_distance=float(to_boundary.max()),
        envelope=envelope,
    )
    return measured, VolumeMesh(points, tetrahedra, quality.volume, outside)


def _mark(surface: Surface, mesh: VolumeMesh, labels: LabelVolume | None, context: Context) -> MarkedMesh:
    """Find the region of each tetrahedron, and the part of the boundary each of its triangles belongs to."""
    regions = np.ones(len(mesh.tetrahedra), dtype=np.int64)
    if labels is not None:
        with context.step("regions"):
            wanted = meshed_labels(surface.history)
            centres = centres_of(mesh.points, mesh.tetrahedra)
            outside_labels = share_outside(centres, labels)
            regions = regions_of(centres, labels, wanted)
        if outside_labels > MAX_SHARE_OUTSIDE:
            context.warn(
                f"{100.0 * outside_labels:.3g} % of the tetrahedra lie outside the label volume and get the region of "
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
    outside = mesh.boundary.triangles
    marks = boundary_marks(surface, mesh.points, outside)
    cap = marks == CAP
    areas = triangle_quality(mesh.points, outside).area
    context.results["boundary"] = {
        "surface": {"triangles": int((~cap).sum()), "area_mm2": float(areas[~cap].sum())},
        "cap": {"triangles": int(cap.sum()), "area_mm2": float(areas[cap].sum())},
    }
    known = None if labels is not None else meshed_labels(surface.history) or []
    return MarkedMesh(mesh.points, mesh.tetrahedra, regions, outside, mesh.boundary.owners, marks, labels=known)


def _curve(marked: MarkedMesh, field: GridField, arguments: Arguments, context: Context) -> Quadratic:
    """Put a node amid each edge, write that mesh, and tell of it."""
    with context.step("quadratic"):
        curved = make_quadratic(marked, field)
        write_quadratic(arguments.quadratic, curved.mesh, curved.jacobian, context.history())
    context.results["quadratic"] = {"file": arguments.quadratic.name, **curved.results}
    left = curved.results["distance_mm"]
    context.closing.append(
        (
            "quadratic",
            f"{curved.results['nodes']:,} nodes, minimum Jacobian {float(curved.jacobian.min()):.2f}; surface nodes "
            f"are at most {left['mid_edge_nodes'].get('max', 0.0):.2g} mm from F = 0 (edge midpoints: "
            f"{left['middles_of_edges'].get('max', 0.0):.2g} mm)",
        )
    )
    return curved


def run(arguments: Arguments, context: Context) -> list[str]:
    """Do the work of the stage.

    Parameters
    ----------
    arguments
        What the user asked for.
    context
        The frame of the run.

    Returns
    -------
    list of str
        The checks that failed, in words; empty when the mesh is fit.

    Raises
    ------
    StageError
        If there is no volume mesh; nothing but the log is written then. An interrupt after that leaves the mesh, whole.
    """
    with context.step("read"):
        surface = read_surface(arguments.surface)
        context.add_input(arguments.surface, surface.history)
        check_memory(len(surface.points), arguments.surface, context.common.max_memory)
        sizing = None
        if arguments.sizefield is not None:
            sizing = read_sizing_field(arguments.sizefield)
            context.add_input(arguments.sizefield, sizing.history)
        field = None
        if arguments.order == 2 and arguments.distfield is not None and surface.sides is None:
            field, history = read_distance_field(arguments.distfield, surface.points)
            context.add_input(arguments.distfield, history)
        labels = None
        if arguments.labels_volume is not None:
            labels = read_label_volume(arguments.labels_volume)
            context.add_input(arguments.labels_volume, None)
    context.verbose(f"{arguments.surface}: {len(surface.points)} vertices, {len(surface.triangles)} triangles")

    if surface.sides is not None:
        return run_materials(arguments, surface, (_size(surface, sizing, context)[0], sizing), context)
    resolve_source(arguments.forward, None)
    with context.step("check surface"):
        topology, components = check_surface(arguments.surface, surface)
        context.results["surface"] = _surface_results(surface, topology, components)
        if labels is not None:
            check_labels(surface.points, labels, meshed_labels(surface.history))

    field_everywhere, at_surface = _size(surface, sizing, context)
    envelope = arguments.envelope
    if envelope is None:
        envelope = ENVELOPE_FRACTION * float(np.percentile(at_surface, 5))
    if envelope >= 0.1 * surface.bounding_box_diagonal:
        raise StageError(
            f"--envelope {envelope:g} mm is more than a tenth of the object ({surface.bounding_box_diagonal:.4g} mm across)",
            "the tetrahedra could differ from the object by that much",
            "choose a smaller envelope, or omit --envelope",
        )
    context.parameters["envelope"] = envelope
    context.parameters["max_distance"] = arguments.limits.distance(envelope)
    task = Task(
        surface=surface,
        components=components,
        field=field_everywhere,
        tet_size_factor=arguments.tet_size_factor,
        method=arguments.method,
        envelope=envelope,
        stop_energy=arguments.stop_energy,
        max_passes=arguments.max_passes,
        max_seconds=arguments.max_seconds,
        limits=arguments.limits,
        log=arguments.log,
        keep_vertices=field is not None,
    )
    filled = fill(task, context)

    measured, mesh = _measure(surface, topology, components, sizing, filled, envelope, arguments, context)
    # before anything is solved: what took long is safe, whatever becomes of the rest
    marked = _mark(surface, mesh, labels, context)
    with context.step("write"):
        write_volume(arguments.output, marked, measured.quality, context.history())
    checks = run_checks(measured, arguments.limits)
    checks += surface_volume_checks(context.results["volumes"], has_scale(surface.history))
    exported = marked
    if field is not None:
        curved = _curve(marked, field, arguments, context)
        exported, checks = curved.mesh, checks + curved.checks()
    for kind in arguments.exports:
        with context.step(f"export {kind}"):
            export(exported, arguments.output, arguments.name, kind, arguments.unit)
    context.results["exports"] = [path.name for path in arguments.export_paths()]
    with drawing(arguments.picture_job, context):
        checks += solve_on(mesh, arguments.solve, context)
    return conclude(checks, measured.quality, context)
