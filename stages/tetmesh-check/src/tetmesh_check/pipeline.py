"""The run of the stage: check the surface, fill it, measure, judge, write."""

from __future__ import annotations

import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from tetmesh_check.checks import Check, Limits, Measurements, run_checks, well_shaped
from tetmesh_check.context import Context
from tetmesh_check.distance import distances_both_ways, summarize_distances
from tetmesh_check.errors import ExitCode, StageError
from tetmesh_check.pictures import PictureJob, draw_pictures
from tetmesh_check.quality import summarize, summarize_all, tetrahedron_quality, triangle_quality
from tetmesh_check.sizing import Background, SizingField, background_mesh, read_sizing_field, uniform_sizing_field
from tetmesh_check.surface import Surface, check_surface, component_volumes, read_surface
from tetmesh_check.tetwild import TetwildResult, TetwildSettings, tetrahedralize
from tetmesh_check.topology import measure_topology, tetrahedron_boundary, tetrahedron_components, triangle_components
from tetmesh_check.volume import orient_positive, write_volume

ENVELOPE_FRACTION = 0.05
"""Default envelope over the edge length that 95 % of the surface exceed: small enough to keep good triangles as they are."""

COARSE_FRACTION = 0.05
"""Edge length outside the object over the diagonal of its bounding box, where h is smaller; fTetWild's own default."""

STOP_ENERGIES = (1000.0, 30.0, 10.0)
"""Default ends of fTetWild's optimization, before it turns to the background and after: the first is the quickest and enough
for a good surface, because refinement to the background optimizes anyway; when the tetrahedra then miss a limit of
shape, the next is tried."""


@dataclass(frozen=True)
class Arguments:
    """What the user asked for."""

    surface: Path
    output: Path
    sizefield: Path | None = None
    pictures: Path | None = None
    tet_size_factor: float = 1.0
    """Tetrahedron edge length over h."""
    envelope: float | None = None
    """Largest distance of the boundary from the surface, mm."""
    stop_energy: float | None = None
    """Largest AMIPS energy at which fTetWild stops; by default each of :data:`STOP_ENERGIES` in turn."""
    max_passes: int = 80
    max_seconds: float = 3600.0
    limits: Limits = field(default_factory=Limits)

    @property
    def name(self) -> str:
        """Name of the case: the output without ``.volume.vtu`` or ``.vtu``."""
        return self.output.name.removesuffix(".vtu").removesuffix(".volume")

    @property
    def log(self) -> Path:
        """Where fTetWild's log goes."""
        return self.output.with_name(f"{self.name}.tetwild.log")

    @property
    def picture_job(self) -> PictureJob | None:
        """The pictures to draw, if any."""
        return None if self.pictures is None else PictureJob(self.surface, self.output, self.pictures, self.name)

    def parameters(self) -> dict[str, Any]:
        """Parameters for the history, as given; what is resolved later is set during the run."""
        return {
            "tet_size_factor": self.tet_size_factor,
            "envelope": self.envelope,
            "stop_energy": self.stop_energy,
            "max_passes": self.max_passes,
            "min_dihedral": self.limits.min_dihedral,
            "min_scaled_jacobian": self.limits.min_scaled_jacobian,
            "max_volume_change": self.limits.max_volume_change,
            "max_distance": self.limits.max_distance,
        }


@dataclass(frozen=True)
class _Sizing:
    """Edge lengths for the tetrahedra."""

    background: Background
    """On the background mesh, the size factor applied."""
    edge_length: float
    """Where there is no background, mm."""
    at_surface: float
    """Edge length that 95 % of the surface exceed, without the factor, mm."""


def _prepare_sizing(surface: Surface, sizing: SizingField | None, factor: float, context: Context) -> _Sizing:
    if sizing is None:
        lengths = triangle_quality(surface.points, surface.triangles).edge_length
        median = float(np.median(lengths))
        context.warn(
            f"no --sizefield was given: all tetrahedra get the median edge length of the surface, {median:.4g} mm"
        )
        at_surface = lengths
        background = background_mesh(uniform_sizing_field(surface, median), surface)
    else:
        at_surface = sizing.at(surface.points)
        background = background_mesh(sizing, surface)
        context.results["sizing"] = {
            "voxel_mm": sizing.voxel,
            "at_surface": summarize(at_surface),
            "background_nodes": len(background.points),
            "background_tetrahedra": len(background.tetrahedra),
            "background_stride_voxels": background.stride,
        }
    scaled = Background(background.points, background.tetrahedra, factor * background.values, background.stride)
    # fTetWild meshes the whole box at this length and only then refines to the background: the coarser, the less work
    # goes into tetrahedra outside the object, which are thrown away.
    coarse = max(float(scaled.values.max()), COARSE_FRACTION * surface.bounding_box_diagonal)
    return _Sizing(scaled, coarse, float(np.percentile(at_surface, 5)))


def _surface_results(surface: Surface, topology: dict[str, int]) -> dict[str, Any]:
    return {
        "topology": topology,
        "merged_points": surface.merged_points,
        "area_mm2": float(triangle_quality(surface.points, surface.triangles).area.sum()),
        "volume_mm3": surface.volume(),
        "bounding_box_diagonal_mm": surface.bounding_box_diagonal,
        "quality": summarize_all(triangle_quality(surface.points, surface.triangles)),
    }


def _measure(
    surface: Surface,
    sizing: SizingField | None,
    filled: TetwildResult,
    envelope: float,
    arguments: Arguments,
    context: Context,
) -> tuple[Measurements, list[Check]]:
    points, tetrahedra = filled.points, filled.tetrahedra
    with context.step("measure quality"):
        quality = tetrahedron_quality(points, tetrahedra)
        boundary = tetrahedron_boundary(tetrahedra)
        boundary_topology = measure_topology(points, boundary)
        surface_topology = measure_topology(surface.points, surface.triangles)
        labels = triangle_components(len(surface.points), surface.triangles)
        bodies = int((component_volumes(surface.points, surface.triangles, labels) > 0).sum())
        context.results["volume"] = {
            "points": len(points),
            "tetrahedra": len(tetrahedra),
            "bodies": tetrahedron_components(tetrahedra),
            "volume_mm3": float(quality.volume.sum()),
            "quality": summarize_all(quality),
            "boundary_topology": {
                **boundary_topology.as_dict(),
                "unused_vertices": 0,
                "vertices": len(np.unique(boundary)),
            },
            "boundary_quality": summarize_all(triangle_quality(points, boundary)),
        }
        if sizing is not None:
            wanted = arguments.tet_size_factor * sizing.at(points[tetrahedra].mean(axis=1))
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
        surface_volume=surface.volume(),
        surface_bodies=bodies,
        surface_topology=surface_topology,
        boundary_topology=boundary_topology,
        bodies=context.results["volume"]["bodies"],
        boundary_distance=float(to_surface.max()),
        surface_distance=float(to_boundary.max()),
        envelope=envelope,
    )
    return measured, run_checks(measured, arguments.limits)


def _fill(surface: Surface, sizes: _Sizing, envelope: float, arguments: Arguments, context: Context) -> TetwildResult:
    """Have the surface filled, again and with more patience where the result is not well shaped."""
    energies = STOP_ENERGIES if arguments.stop_energy is None else (arguments.stop_energy,)
    deadline = time.monotonic() + arguments.max_seconds
    arguments.log.unlink(missing_ok=True)
    attempts: list[dict[str, Any]] = []
    best: tuple[float, TetwildResult] | None = None
    for energy in energies:
        settings = TetwildSettings(
            envelope=envelope,
            edge_length=min(sizes.edge_length, surface.bounding_box_diagonal),
            stop_energy=energy,
            max_passes=arguments.max_passes,
            seconds_left=deadline - time.monotonic(),
            max_seconds=arguments.max_seconds,
            threads=context.common.thread_count,
        )
        try:
            raw = tetrahedralize(surface, sizes.background, settings, arguments.log, context)
        except StageError as error:
            if best is None or error.code == ExitCode.INTERRUPTED:
                raise
            context.warn(f"another attempt at better tetrahedra came to nothing: {error.what}")
            break
        tetrahedra, turned = orient_positive(raw.points, raw.tetrahedra)
        quality = tetrahedron_quality(raw.points, tetrahedra)
        worst = float(quality.scaled_jacobian.min())
        attempts.append(
            {**raw.summary, "stop_energy": energy, "orientation_turned": turned, "min_scaled_jacobian": worst}
        )
        if best is None or worst > best[0]:
            best = worst, TetwildResult(raw.points, tetrahedra, raw.summary)
        if well_shaped(quality, arguments.limits):
            break
        context.verbose(f"stop energy {energy:g}: smallest dihedral angle {quality.min_dihedral.min():.3g} degrees")
    context.results["tetwild"] = {"log": arguments.log.name, "attempts": attempts}
    assert best is not None, "the loop runs at least once"
    return best[1]


def _draw(job: PictureJob, context: Context) -> None:
    with context.step("pictures"):
        try:
            job.folder.mkdir(parents=True, exist_ok=True)
            drawn, skipped = draw_pictures(job)
        except OSError as error:
            drawn, skipped = [], {"all": str(error)}
    context.results["pictures"] = {"drawn": drawn, "skipped": skipped}
    for reason in sorted(set(skipped.values())):
        names = ", ".join(name for name, why in skipped.items() if why == reason)
        context.warn(f"pictures skipped ({names}): {reason}")


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
        If there is no volume mesh; nothing but the log is written then.
    """
    with context.step("read"):
        surface = read_surface(arguments.surface)
        context.add_input(arguments.surface, surface.history)
        sizing = None
        if arguments.sizefield is not None:
            sizing = read_sizing_field(arguments.sizefield)
            context.add_input(arguments.sizefield, sizing.history)
    context.verbose(f"{arguments.surface}: {len(surface.points)} vertices, {len(surface.triangles)} triangles")

    with context.step("check surface"):
        topology = check_surface(arguments.surface, surface)
        context.results["surface"] = _surface_results(surface, topology.as_dict())

    with context.step("background sizing"):
        sizes = _prepare_sizing(surface, sizing, arguments.tet_size_factor, context)
    envelope = arguments.envelope if arguments.envelope is not None else ENVELOPE_FRACTION * sizes.at_surface
    if envelope >= 0.1 * surface.bounding_box_diagonal:
        raise StageError(
            f"--envelope {envelope:g} mm is more than a tenth of the object ({surface.bounding_box_diagonal:.4g} mm across)",
            "the tetrahedra would not resemble it",
            "give a smaller one, or leave it out",
        )
    context.parameters["envelope"] = envelope
    context.parameters["max_distance"] = (
        arguments.limits.max_distance if arguments.limits.max_distance is not None else 2.0 * envelope
    )
    context.verbose(f"envelope {envelope:.4g} mm, edge length up to {sizes.edge_length:.4g} mm; log: {arguments.log}")
    with context.step("tetrahedralize"):
        filled = _fill(surface, sizes, envelope, arguments, context)

    measured, checks = _measure(surface, sizing, filled, envelope, arguments, context)
    with context.step("write"):
        write_volume(arguments.output, filled.points, filled.tetrahedra, measured.quality, context.history())
    if (job := arguments.picture_job) is not None:
        _draw(job, context)

    context.results["checks"] = [check.as_dict() for check in checks]
    quality = measured.quality
    context.closing += [
        ("tetrahedra", f"{len(filled.tetrahedra):,}"),
        ("radius ratio", f"mean {quality.radius_ratio.mean():.3f}, smallest {quality.radius_ratio.min():.3f}"),
        ("dihedral angle", f"{quality.min_dihedral.min():.1f} to {quality.max_dihedral.max():.1f} degrees"),
    ]
    for check in checks:
        if not check.passed and not check.required:
            context.warn(check.words)
    return [check.words for check in checks if check.required and not check.passed]
