"""Fills a surface of many materials by Gmsh, which keeps the triangles between the volumes."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from isoparticles._native import Context, GridField

from tetmesh_check.arguments import Arguments, Method
from tetmesh_check.checks import SHAPE, OfShape, smallest_elsewhere
from tetmesh_check.complex import Complex
from tetmesh_check.conform import Conformity, conform
from tetmesh_check.errors import StageError
from tetmesh_check.forced import ForcedSides
from tetmesh_check.mend import mend
from tetmesh_check.quality import TetrahedronQuality, tetrahedron_quality
from tetmesh_check.surface import Surface
from tetmesh_check.tets.fill import Filled
from tetmesh_check.tets.hxt import fill_by_hxt, hxt_job
from tetmesh_check.tets.worker import Raw, Runner, TimeLimitError, UnavailableError

ALGORITHMS = ("hxt", "delaunay")
"""Attempts until one keeps all interfaces: HXT, then the older Delaunay of Gmsh, which fills some
complexes that HXT cannot fill. ``--method hxt`` omits the last. Single tetrahedra beyond a limit of
shape do not cause another attempt; they are mended (:mod:`.mend`)."""

_FAIR = 0.5
"""Required scaled Jacobian on a triangle with a small angle, relative to the largest possible
value. Mending aims at nine tenths of the possible value."""


class ComplexTask(NamedTuple):
    """A complex to fill."""

    arguments: Arguments
    checked: Complex
    sides: ForcedSides
    """Where other triangles keep tetrahedra from the limit of the dihedral angle."""
    needles: ForcedSides
    """Both sides of the triangles with a small angle."""
    field: GridField
    """Edge lengths, mm, without the factor."""

    @property
    def surface(self) -> Surface:
        """The checked surface."""
        return self.checked.surface


def _measured(task: ComplexTask, raw: Raw, found: Conformity) -> Filled:
    quality = tetrahedron_quality(raw.points, raw.tetrahedra)
    return Filled(raw.points, raw.tetrahedra, quality, found, _forced(task, found, quality))


def _mend(task: ComplexTask, filled: Filled, results: dict[str, Any]) -> Filled:
    """Mend the tetrahedra that miss the goal, where that is possible."""
    triangles, limits = task.surface.triangles, task.arguments.limits
    mended = mend(filled.points, filled.tetrahedra, triangles, task.checked.sides, limits)
    if mended is None:
        return filled
    after = _measured(task, *mended)
    smallest = [smallest_elsewhere(one.quality, one.forced)["min_dihedral"] for one in (filled, after)]
    results.update(mended[0].summary)
    results["mended"] |= {"min_dihedral_before": smallest[0], "min_dihedral_after": smallest[1]}
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


def fill_complex(task: ComplexTask, context: Context) -> Filled:
    """Fill every volume of a complex; ``tetrahedralizer`` in the results describes the attempts.

    Raises
    ------
    StageError
        If no tetrahedralizer fills it so that each tetrahedron has a material.
    """
    arguments, checked = task.arguments, task.checked
    attempts: list[dict[str, Any]] = []
    results: dict[str, Any] = {
        "method": Method.HXT,
        "reason": "the surface has several materials, and Gmsh keeps the triangles between them",
        "log": arguments.log.name,
        "attempts": attempts,
    }
    context.results["tetrahedralizer"] = results
    context.parameters["method"] = Method.HXT
    runner = Runner(arguments.log, arguments.max_seconds, context)
    with context.step("background sizing"):
        job = hxt_job(task.surface, checked.shells.sheets(), task.field, arguments.tet_size_factor)
    best: tuple[tuple[int, float], Conformity, Filled] | None = None
    failure = None
    for algorithm in ALGORITHMS if arguments.method is Method.AUTO else ALGORITHMS[:1]:
        try:
            with context.step("tetrahedralize"):
                raw = fill_by_hxt(job | {"algorithm": algorithm}, runner)
        except StageError as error:
            attempts.append({"algorithm": algorithm, "error": error.what})
            failure = error
            if isinstance(error, (TimeLimitError, UnavailableError)):
                break
            continue
        with context.step("find regions"):
            found = conform(len(raw.points), raw.tetrahedra, task.surface.triangles, checked.sides)
            filled = _measured(task, raw, found)
        smallest = smallest_elsewhere(filled.quality, filled.forced)
        attempts.append(
            {
                **raw.summary,
                "algorithm": algorithm,
                "faults": found.faults,
                "min_dihedral": smallest["min_dihedral"],
                "min_scaled_jacobian": smallest["scaled_jacobian"],
            }
        )
        rank = -found.faults, smallest["scaled_jacobian"]
        if best is None or rank > best[0]:
            best = rank, found, filled
            results["algorithm"] = algorithm
        if found.faults == 0:
            break
        context.verbose(f"{algorithm}: {found.faults} faults at the interfaces")
    if best is None:
        assert failure is not None, "an attempt is made or fails"
        raise failure
    _, found, filled = best
    if found.undecided:
        raise StageError(
            f"the material of {found.undecided} tetrahedra is unknown: the tetrahedralizer lost "
            f"{found.missing} triangles of the interfaces",
            "without these triangles the materials are not separated; nothing was written",
            f"see its log, {arguments.log}, or try another --tet-size-factor",
        )
    if found.faults:
        return filled
    with context.step("mend tetrahedra"):
        return _mend(task, filled, results)
