"""Fills a surface of many materials by Gmsh, which keeps the triangles between the volumes."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tetmesh_check.arguments import Arguments, Method
from tetmesh_check.checks import SHAPE, OfShape, smallest_elsewhere
from tetmesh_check.complex import Complex
from tetmesh_check.conform import Conformity, conform
from tetmesh_check.context import Context
from tetmesh_check.errors import ExitCode, StageError
from tetmesh_check.forced import ForcedSides
from tetmesh_check.mend import mend
from tetmesh_check.quality import Cells, Points, TetrahedronQuality, orient_positive, tetrahedron_quality
from tetmesh_check.sizing import SizingField, WorldGrid, world_grid
from tetmesh_check.surface import Surface
from tetmesh_check.tets.fill import Filled
from tetmesh_check.tets.hxt import HxtSettings, fill_complex_by_gmsh
from tetmesh_check.tets.worker import TimeLimit, TimeLimitError, UnavailableError, WorkerResult

ATTEMPTS = (HxtSettings(), HxtSettings(algorithm="delaunay"))
"""Attempts until one keeps all interfaces: HXT, then the older Delaunay of Gmsh, which fills some
complexes that HXT cannot fill. ``--method hxt`` omits the last. Single tetrahedra beyond a limit of
shape do not cause another attempt; they are mended (:mod:`.mend`)."""

_FAIR = 0.5
"""Required scaled Jacobian on a triangle with a small angle, relative to the largest possible
value. Mending aims at nine tenths of the possible value."""


@dataclass(frozen=True)
class ComplexTask:
    """A complex to fill, and the settings."""

    arguments: Arguments
    checked: Complex
    sides: ForcedSides
    """Where other triangles keep tetrahedra from the limit of the dihedral angle."""
    needles: ForcedSides
    """Both sides of the triangles with a small angle."""
    field: SizingField
    """Edge lengths, without the factor."""

    @property
    def surface(self) -> Surface:
        """The checked surface."""
        return self.checked.surface


@dataclass(frozen=True)
class FilledComplex(Filled):
    """The tetrahedra, and how they fit the interfaces; the vertices of the surface come first."""

    conformity: Conformity
    forced: OfShape
    """The tetrahedra that the surface forces below a limit."""

    @property
    def rank(self) -> tuple[int, float]:
        """A value that is larger for better attempts."""
        return -self.conformity.faults, smallest_elsewhere(self.quality, self.forced)["scaled_jacobian"]


def _judge(task: ComplexTask, raw: WorkerResult) -> FilledComplex:
    surface, points = task.checked.surface, raw.points
    if not np.array_equal(points[: len(surface.points)], surface.points):
        raise StageError(
            "the tetrahedralizer did not keep the vertices of the surface",
            "neighbouring materials share them",
            "try another --tet-size-factor",
        )
    tetrahedra, _turned = orient_positive(points, raw.tetrahedra)
    return _measured(task, points, tetrahedra, conform(len(points), tetrahedra, surface.triangles, task.checked.sides))


def _measured(task: ComplexTask, points: Points, tetrahedra: Cells, found: Conformity) -> FilledComplex:
    quality = tetrahedron_quality(points, tetrahedra)
    return FilledComplex(points, tetrahedra, quality, found, _forced(task, found, quality))


def _mend(task: ComplexTask, filled: FilledComplex, results: dict[str, Any]) -> FilledComplex:
    """Mend the tetrahedra that miss the goal, where that is possible."""
    mended = mend(
        filled.points, filled.tetrahedra, task.checked.surface.triangles, task.checked.sides, task.arguments.limits
    )
    if mended is None:
        return filled
    after = _measured(task, mended.points, mended.tetrahedra, mended.conformity)
    smallest = [smallest_elsewhere(one.quality, one.forced)["min_dihedral"] for one in (filled, after)]
    results["mended"] = {**mended.results, "min_dihedral_before": smallest[0], "min_dihedral_after": smallest[1]}
    return after


def _forced(task: ComplexTask, found: Conformity, quality: TetrahedronQuality) -> OfShape:
    """Return the tetrahedra that the surface forces below each limit.

    At a corner of an edge with the dihedral angle b, whose two faces have the angles s and t, six
    times the volume over the product of the three edges is sin b sin s sin t. So the scaled
    Jacobian is at most sqrt(2) sin b. A tetrahedron on a triangle with a small angle must reach
    :data:`_FAIR` times the largest possible value there.
    """
    kept = {measure: np.zeros(quality.volume.size, dtype=np.bool_) for measure in SHAPE}
    sides, standing = task.sides.occupied(found)
    kept["min_dihedral"][standing] = True
    flat = np.sqrt(2.0) * np.sin(np.radians(sides.bound)) < task.arguments.limits.min_scaled_jacobian
    kept["scaled_jacobian"][standing[flat]] = True
    needles, standing = task.needles.occupied(found)
    fair = quality.scaled_jacobian[standing] >= _FAIR * needles.bound
    kept["scaled_jacobian"][standing[fair]] = True
    return kept


def _attempt(
    task: ComplexTask, settings: HxtSettings, grid: WorldGrid, limit: TimeLimit, context: Context
) -> tuple[WorkerResult, FilledComplex]:
    """Fill the volumes once, and find the materials of the tetrahedra."""
    with context.step("tetrahedralize"):
        checked = task.checked
        raw = fill_complex_by_gmsh(checked.surface, checked.shells, grid, settings, task.arguments.log, limit, context)
    with context.step("find regions"):
        return raw, _judge(task, raw)


def _refuse_undecided(found: Conformity, log: Path) -> None:
    if found.undecided:
        raise StageError(
            f"the material of {found.undecided} tetrahedra is unknown: the tetrahedralizer lost "
            f"{found.missing} triangles of the interfaces",
            "without these triangles the materials are not separated; nothing was written",
            f"see its log, {log}, or try another --tet-size-factor",
        )


def fill_complex(task: ComplexTask, context: Context) -> FilledComplex:
    """Fill every volume of a complex; ``tetrahedralizer`` in the results describes the attempts.

    Raises
    ------
    StageError
        If no tetrahedralizer fills it so that each tetrahedron has a material.
    """
    attempts: list[dict[str, Any]] = []
    results: dict[str, Any] = {
        "method": Method.HXT,
        "reason": "the surface has several materials, and Gmsh keeps the triangles between them",
        "log": task.arguments.log.name,
        "attempts": attempts,
    }
    context.results["tetrahedralizer"] = results
    context.parameters["method"] = Method.HXT
    task.arguments.log.unlink(missing_ok=True)
    limit = TimeLimit.start(task.arguments.max_seconds)
    with context.step("background sizing"):
        grid = world_grid(task.field, task.checked.surface, task.arguments.tet_size_factor)
    best: FilledComplex | None = None
    failure: StageError | None = None
    for settings in ATTEMPTS if task.arguments.method is Method.AUTO else ATTEMPTS[:1]:
        tried: dict[str, Any] = {"algorithm": settings.algorithm}
        try:
            raw, filled = _attempt(task, settings, grid, limit, context)
        except StageError as error:
            final = isinstance(error, (TimeLimitError, UnavailableError))
            if error.code == ExitCode.INTERRUPTED or (final and best is None):
                raise
            attempts.append({**tried, "error": error.what})
            failure = error
            if final:
                break
            continue
        smallest = smallest_elsewhere(filled.quality, filled.forced)
        attempts.append(
            {
                **raw.summary,
                **tried,
                "faults": filled.conformity.faults,
                "min_dihedral": smallest["min_dihedral"],
                "min_scaled_jacobian": smallest["scaled_jacobian"],
            }
        )
        if best is None or filled.rank > best.rank:
            best = filled
            results.update(tried)
        if filled.conformity.faults == 0:
            break
        context.verbose(f"{settings.algorithm}: {filled.conformity.faults} faults at the interfaces")
    if best is None:
        assert failure is not None, "an attempt is made or fails"
        raise failure
    _refuse_undecided(best.conformity, task.arguments.log)
    if best.conformity.faults == 0:
        with context.step("mend tetrahedra"):
            best = _mend(task, best, results)
    return best
