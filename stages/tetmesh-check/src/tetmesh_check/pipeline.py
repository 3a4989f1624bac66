"""The run of the stage: check the surface, fill it, measure, judge, write."""

from __future__ import annotations

from dataclasses import replace

from isoparticles import _native

from tetmesh_check.arguments import Arguments
from tetmesh_check.checks import conclude, surface_volume_checks
from tetmesh_check.context import Context
from tetmesh_check.export.formats import export
from tetmesh_check.export.vtk import write_volume
from tetmesh_check.fem.solve import solve_on
from tetmesh_check.fields import read_distance_field
from tetmesh_check.files import refuse_existing
from tetmesh_check.labels import read_label_volume
from tetmesh_check.materials_run import ManyMaterials
from tetmesh_check.memory import check_memory
from tetmesh_check.one_object import OneObject
from tetmesh_check.regions import has_scale
from tetmesh_check.report.drawing import drawing
from tetmesh_check.sizing import read_sizing_field
from tetmesh_check.subject import Inputs
from tetmesh_check.surface import read_surface


def _read(arguments: Arguments, context: Context) -> Inputs:
    """Read the files, and refuse a surface that needs more memory than there is."""
    surface = read_surface(arguments.surface)
    context.add_input(arguments.surface, surface.history)
    check_memory(len(surface.points), arguments.surface, context.common.max_memory)
    sizing = field = labels = None
    if arguments.sizefield is not None:
        sizing = read_sizing_field(arguments.sizefield)
        context.add_input(arguments.sizefield, sizing.history)
    if arguments.order == 2 and arguments.distfield is not None and surface.sides is None:
        field, history = read_distance_field(arguments.distfield, surface.points)
        context.add_input(arguments.distfield, history)
    if arguments.labels_volume is not None:
        labels = read_label_volume(arguments.labels_volume)
        context.add_input(arguments.labels_volume, None)
    return Inputs(surface, sizing, field, labels)


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
        If there is no volume mesh; then only the log is written. An interrupt after that leaves the
        complete mesh.
    """
    _native.set_threads(context.common.threads)
    with context.step("read"):
        inputs = _read(arguments, context)
    surface = inputs.surface
    context.verbose(f"{arguments.surface}: {len(surface.points)} vertices, {len(surface.triangles)} triangles")
    subject = (OneObject if surface.sides is None else ManyMaterials)(arguments, inputs, context)
    exported = arguments.export_paths(subject.many)
    refuse_existing(exported, context.common.force)
    subject.check_surface()
    subject.fill()
    mesh, quality = subject.measure()
    marked = subject.mark()
    with context.step("write"):
        # before anything is solved, so that a later failure leaves the mesh
        write_volume(arguments.output, marked, quality, context.history())
    checks = subject.checks()
    checks += surface_volume_checks(context.results["volumes"], has_scale(surface.history))
    curved, more = subject.curve(marked)
    checks += more
    for kind in arguments.exports:
        with context.step(f"export {kind}"):
            export(curved, arguments.output, arguments.name, kind, arguments.unit)
    context.results["exports"] = [path.name for path in exported]
    job = arguments.picture_job
    with drawing(None if job is None else replace(job, many=subject.many), context):
        checks += solve_on(mesh, arguments.solve, context, subject.currents())
    return conclude(checks, quality, context)
