"""The run of the stage: check the surface, fill it, measure, judge, write."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from isoparticles import _native
from isoparticles._native import Context, DistanceField, GridField

from tetmesh_check.arguments import Arguments
from tetmesh_check.checks import Check, complex_checks, conclude, object_checks, shape_checks, surface_volume_checks
from tetmesh_check.density.mapping import map_density, read_density
from tetmesh_check.errors import StageError
from tetmesh_check.export.formats import export
from tetmesh_check.export.mesh import MarkedMesh
from tetmesh_check.export.profiles import renumbered
from tetmesh_check.export.vtk import write_volume
from tetmesh_check.fem.currents import Forward
from tetmesh_check.fem.solve import VolumeMesh, solve_on
from tetmesh_check.fibres.arguments import find_boundaries
from tetmesh_check.fields import read_distance_field, read_sizing_field, uniform_sizing_field
from tetmesh_check.forced import find_forced
from tetmesh_check.gap import refuse_wide
from tetmesh_check.layers import refuse_layers
from tetmesh_check.measures import mark, measure, separate
from tetmesh_check.parts.caps import Border
from tetmesh_check.parts.find import find_parts
from tetmesh_check.parts.model import Parts
from tetmesh_check.quadratic import make_quadratic, separate_curved
from tetmesh_check.quality import Values, summarize, triangle_quality
from tetmesh_check.regions import check_labels, distfield_parameter, has_scale, meshed_labels
from tetmesh_check.report.rendering import drawing
from tetmesh_check.space import output_space, turned
from tetmesh_check.surface import Surface, check_surface, read_surface
from tetmesh_check.tets.fill import Filled, Task, fill
from tetmesh_check.volumes import InputVolume, read_label_volume

ENVELOPE_FRACTION = 0.05
"""Default envelope, relative to the edge length that 95 % of the surface exceeds. It is small
enough to keep thin walls apart."""
BYTES_AT_LEAST = 600 * 2**20
"""Memory of the program without a mesh; see :data:`BYTES_PER_VERTEX`."""
BYTES_PER_VERTEX = 5100
"""Memory for each vertex of the surface. Both constants are from the line through 896 MiB for the
55,626 vertices of `heart` and 2,050 MiB for the 292,825 of `ribs`, with 15 to 20 tetrahedra per
vertex (docs/developer/performance.md, real volumes, `make CASE=heart` and `make CASE=ribs`)."""


def _read(
    arguments: Arguments, context: Context
) -> tuple[Surface, GridField | None, DistanceField | None, InputVolume | None, Border | None]:
    """Read the surface, h, F, the labels and the faces of the volume.

    A surface that needs too much memory is refused.

    All are in LPS. A surface without a frame is assumed to be in the frame of the field h.
    """
    surface = read_surface(arguments.surface)
    context.add_input(arguments.surface, surface.history)
    context.check_memory(
        BYTES_AT_LEAST + BYTES_PER_VERTEX * len(surface.points),
        f"{arguments.surface}: tetrahedra for {len(surface.points):,} vertices",
        "make a coarser surface (sizefield --min-size, --quality coarse)",
    )
    sizing = field = labels = border = None
    if arguments.sizefield is not None:
        sizing, history, border = read_sizing_field(arguments.sizefield)
        context.add_input(arguments.sizefield, history)
        if surface.space is None and (space := distfield_parameter(history, "space")):
            points = turned(surface.points) if space == "ras" else surface.points
            surface = replace(surface, points=points, space=space)
    if arguments.order == 2 and arguments.distfield is not None:
        names = [] if surface.sides is None else surface.sides.names
        names += [] if surface.planes is None else surface.planes.names
        field, history = read_distance_field(arguments.distfield, surface.points, names)
        context.add_input(arguments.distfield, history)
    if arguments.labels_volume is not None:
        labels = read_label_volume(arguments.labels_volume)
        context.add_input(arguments.labels_volume, None)
    space = output_space(arguments.space, surface.space, distfield_parameter(surface.history, "file_space"))
    context.parameters["space"] = space
    return replace(surface, space=space), sizing, field, labels, border


def _parts(arguments: Arguments, surface: Surface, border: Border | None, context: Context) -> Parts:
    """Find the parts of the surface; refuse what does not suit them, and existing outputs."""
    sides = surface.sides
    names = [] if sides is None else [sides.names[number] for number in sides.present]
    arguments.check_material_names(names)
    if sides is not None:
        arguments.refuse_for_materials()
    with context.step("find parts"):
        parts = find_parts(surface, border, arguments.tags, arguments.sets, arguments.splits, arguments.layers)
    context.check_outputs(arguments.export_paths(sides is not None, parts.set_names))
    return parts


def _edge_lengths(surface: Surface, sizing: GridField | None, context: Context) -> tuple[GridField, Values]:
    """Return the field of edge lengths, and the edge lengths at the surface, mm."""
    if sizing is not None:
        at_surface = sizing.trilinear(surface.points)
        summary = summarize(at_surface, np.linspace(0.0, float(at_surface.max()), 51))
        context.results["sizing"] = {"voxel_mm": sizing.voxel, "at_surface": summary}
        return sizing, at_surface
    lengths = triangle_quality(surface.points, surface.triangles).edge_length
    median = float(np.median(lengths))
    context.warn(f"no --sizefield was given: all tetrahedra get the median edge length of the surface, {median:.4g} mm")
    return uniform_sizing_field(surface, median), lengths


def _task(
    arguments: Arguments, surface: Surface, sizing: GridField | None, labels: InputVolume | None, context: Context
) -> Task:
    """Check the surface; find the edge lengths, and the envelope or the forced sides."""
    with context.step("check surface"):
        found, parts = check_surface(arguments.surface, surface)
        context.results["surface" if surface.sides is None else "complex"] = found
        if labels is not None:
            check_labels(surface.points, labels, meshed_labels(surface.history))
    field, at_surface = _edge_lengths(surface, sizing, context)
    if surface.sides is None:
        envelope = arguments.envelope
        if envelope is None:
            envelope = ENVELOPE_FRACTION * float(np.percentile(at_surface, 5))
        if envelope >= 0.1 * surface.bounding_box_diagonal:
            raise StageError(
                f"--envelope {envelope:g} mm is more than a tenth of the object "
                f"({surface.bounding_box_diagonal:.4g} mm across)",
                "the tetrahedra could differ from the object by that much",
                "choose a smaller envelope, or omit --envelope",
            )
        context.parameters.update(envelope=envelope, max_distance=arguments.limits.distance(envelope))
        return Task(arguments, surface, parts, field, envelope)
    with context.step("find forced tetrahedra"):
        forced = find_forced(surface, arguments.limits, context)
    return Task(arguments, surface, parts, field, forced=forced)


def _curve(
    arguments: Arguments,
    marked: MarkedMesh,
    parts: Parts,
    field: DistanceField,
    surface: Surface,
    context: Context,
) -> tuple[MarkedMesh, list[Check]]:
    """Add a node on each edge, split interfaces, open gaps, write this mesh, and check it."""
    path, sides = arguments.quadratic, surface.sides
    with context.step("quadratic"):
        curved = separate_curved(make_quadratic(marked, field, sides, surface.planes), parts)
        mesh = curved.mesh
        write_volume(path, mesh, {"jacobian_bound": curved.jacobian}, context.history())
    found = context.results["quadratic"] = {"file": path.name, **curved.results, "nodes": len(mesh.points)}
    nodes, middles = (found["distance_mm"][key].get("max", 0.0) for key in ("mid_edge_nodes", "middles_of_edges"))
    told = (
        f"{found['nodes']:,} nodes, minimum Jacobian {float(curved.jacobian.min()):.2f}; surface nodes are at most "
        f"{nodes:.2g} mm from {'F = 0' if sides is None else 'their interface'} (edge midpoints: {middles:.2g} mm)"
    )
    context.closing.append(("quadratic", told))
    return mesh, curved.checks


def _judge(task: Task, filled: Filled, context: Context) -> list[Check]:
    """Return the checks of the tetrahedra and of the volumes inside the surface."""
    results, limits = context.results, task.arguments.limits
    if task.surface.sides is None:
        bodies = int(task.parts.sheets()[0].max()) + 1
        own = object_checks(results, bodies, limits, context.parameters["max_distance"])
    else:
        materials, interfaces = len(task.surface.sides.present), len(results["complex"]["interfaces"])
        context.closing.append(("materials", f"{materials}, {interfaces} interfaces"))
        own = complex_checks(results["volume"], limits)
    scaled = surface_volume_checks(results["volumes"], has_scale(task.surface.history))
    return [*shape_checks(filled.quality, limits, filled.forced), *own, *scaled]


def _currents(task: Task, filled: Filled) -> Forward | None:
    """Return the problem of currents if there is a source and the mesh fits the interfaces."""
    arguments, sides, found = task.arguments.forward, task.surface.sides, filled.conformity
    if arguments.source is None or sides is None or found is None or found.faults:
        return None
    # positions and directions change the same signs, from LPS to RAS and back
    density = task.surface.shown(np.array(arguments.density))
    return Forward(arguments, sides, task.surface.triangles, found, density)


def _solve(task: Task, filled: Filled, mesh: VolumeMesh, marked: MarkedMesh, context: Context) -> list[Check]:
    """Solve the test problems; add the potential of a source to the written mesh `marked`."""
    arguments = task.arguments
    currents = _currents(task, filled)
    checks, potential = solve_on(mesh, arguments.solve, arguments.solve_seconds, context, currents)
    # doubled nodes and prisms have no potential
    if potential is not None and len(potential) == len(marked.points):
        marked = replace(marked, point_fields=marked.point_fields | {"potential": potential})
        with context.step("write the potential"):
            write_volume(arguments.output, marked, filled.quality._asdict(), context.history())
    return checks


def run(arguments: Arguments, context: Context) -> list[str]:
    """Do the work of the stage.

    Parameters
    ----------
    arguments
        The arguments of the command line.
    context
        The context of the run.

    Returns
    -------
    list of str
        The messages of the failed checks; empty if the mesh is fit.

    Raises
    ------
    StageError
        If the surface cannot be filled; only the log is written then. If the run is interrupted
        after the mesh is written, the mesh remains.
    """
    _native.set_threads(context.threads)
    with context.step("read"):
        surface, sizing, field, labels, border = _read(arguments, context)
    context.verbose(f"{arguments.surface}: {len(surface.points)} vertices, {len(surface.triangles)} triangles")
    parts = _parts(arguments, surface, border, context)
    boundaries = None if arguments.fibres is None else find_boundaries(arguments.fibres, parts, surface)
    scan = None
    if arguments.density is not None:
        with context.step("read density"):
            scan = read_density(arguments.density, surface, context)
    task = _task(arguments, surface, sizing, labels, context)
    refuse_wide(parts, surface)
    refuse_layers(parts, surface)
    filled = fill(task, context)
    mesh = measure(task, filled, context)
    marked = mark(task.surface, mesh, filled.conformity, parts, labels, context)
    if scan is not None:
        with context.step("map density"):
            marked = map_density(scan, marked, mesh.volumes, context)
    if arguments.fibres is not None and boundaries is not None:
        # SciPy and scikit-fem may be missing without this option
        from tetmesh_check.fibres.mapping import map_fibres

        with context.step("fibres"):
            marked = map_fibres(arguments.fibres, boundaries, marked, context)
    joined = marked
    marked, filled, checks = separate(task, joined, filled, parts, context)
    with context.step("write"):
        # the mesh remains if a later step fails
        write_volume(arguments.output, marked, filled.quality._asdict(), context.history())
    written, many = marked, surface.sides is not None
    with drawing(arguments, context, many):
        checks += _judge(task, filled, context)
        if field is not None:
            marked, more = _curve(arguments, joined, parts, field, surface, context)
            checks += more
        exported = renumbered(marked, arguments.profile)
        for kind in arguments.exports:
            with context.step(f"export {kind}"):
                export(exported, arguments.output, arguments.name, kind, arguments.unit)
        exports = arguments.export_paths(many, [own.name for own in exported.named_sets])
        context.results["exports"] = [path.name for path in exports]
        checks += _solve(task, filled, mesh, written, context)
    return conclude(checks, filled.quality, context)
