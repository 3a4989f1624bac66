"""Fills surfaces of one object and of many materials, and repeats attempts that miss a limit."""

from __future__ import annotations

from dataclasses import dataclass
from dataclasses import field as made_by
from typing import Any, NamedTuple

import numpy as np
from isoparticles import _native
from isoparticles._native import Context, GridField, distances_both_ways

from tetmesh_check.arguments import Arguments, Method
from tetmesh_check.checks import SHAPE, Limits, OfShape, smallest_elsewhere, well_shaped
from tetmesh_check.complex import Complex
from tetmesh_check.conform import Conformity, conform
from tetmesh_check.errors import StageError
from tetmesh_check.forced import ForcedSides
from tetmesh_check.materials import Sides
from tetmesh_check.quality import Cells, Points, TetrahedronQuality, tetrahedron_quality
from tetmesh_check.surface import Surface
from tetmesh_check.tets.hxt import fill_by_hxt, hxt_job
from tetmesh_check.tets.tetgen import fill_by_tetgen, regular_volume
from tetmesh_check.tets.tetwild import MAX_BACKGROUND_NODES, fill_by_tetwild, tetwild_job
from tetmesh_check.tets.worker import Raw, Runner, TimeLimitError, UnavailableError
from tetmesh_check.topology import Components, tetrahedron_boundary

MAX_FTETWILD_VERTICES = 2_500
"""Maximum number of vertices of the surfaces that fTetWild fills by default. On two cores, fTetWild
takes 10 s for 2,538 vertices (`make surface INPUT=mickey_labels.nrrd LABELS=2 VERTICES=2500`) and
12.7 s for 4,731, two minutes for 10,000, and from twenty minutes to hours for 50,000 or more. HXT
takes 0.5 s for the first two, and then seconds. The tetrahedra of fTetWild are better (mean radius
ratio 0.90 and 0.85 instead of 0.79, minimum dihedral angle 22 instead of 19 degrees), but nearly
all surfaces pass the checks with both."""

MAX_SECOND_TRY_VERTICES = 20_000
"""Maximum number of vertices of the surfaces that ``auto`` fills again by fTetWild if a tetrahedron
of HXT misses a limit of shape and cannot be mended. This happens where parts of a surface nearly
touch: its fixed triangles leave only flat tetrahedra between them. Each of :data:`STOP_ENERGIES`
takes about four minutes."""

ENVELOPES = (1.0, 0.5, 0.25)
"""Envelopes of the attempts of fTetWild, relative to the given one. The next is used if the
boundary is too far from the surface: fTetWild keeps only samples of the boundary within the
envelope, so thin tips can lose more."""

STOP_ENERGIES = (1000.0, 30.0, 10.0)
"""Default stop energies of the attempts of fTetWild. The first is the fastest and suffices for a
good surface, because the refinement to the background also optimizes. The next is used if
tetrahedra miss a limit of shape."""

ALGORITHMS = ("hxt", "delaunay")
"""Attempts with many materials until one keeps all interfaces: HXT, then the older Delaunay of
Gmsh, which fills some surfaces that HXT cannot fill. ``--method hxt`` omits the last. Single
tetrahedra beyond a limit of shape do not cause another attempt; they are mended."""

_FAIR = 0.5
"""Required scaled Jacobian on a triangle with a small angle, relative to the largest possible
value. Mending aims at nine tenths of the possible value."""


class Task(NamedTuple):
    """A surface of one object to fill."""

    arguments: Arguments
    surface: Surface
    """A checked surface."""
    components: Components
    """Its components."""
    field: GridField
    """Edge lengths, mm, without the factor."""
    envelope: float
    """For fTetWild: largest distance of the boundary from the surface, mm."""


class ComplexTask(NamedTuple):
    """A surface of many materials to fill."""

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


@dataclass(frozen=True)
class Filled:
    """The tetrahedra."""

    points: Points
    """Positions, mm, shape ``(n, 3)``."""
    tetrahedra: Cells
    """Vertex indices in VTK order, shape ``(m, 4)``."""
    quality: TetrahedronQuality
    """Their measures."""
    conformity: Conformity | None = None
    """How they fit the interfaces between many materials; ``None`` for one object."""
    forced: OfShape = made_by(default_factory=dict)
    """The tetrahedra that the surface of many materials forces below a limit of shape."""


class _Attempts:
    """The attempts made so far, for the report, and the best of them."""

    def __init__(self, task: Task | ComplexTask, method: Method, reason: str, context: Context) -> None:
        arguments = task.arguments
        self.entries: list[dict[str, Any]] = []
        self.best: tuple[tuple[float, ...], Filled, dict[str, Any]] | None = None
        self.results: dict[str, Any] = {"method": method, "reason": reason, "log": arguments.log.name}
        context.results["tetrahedralizer"] = self.results
        self.results["attempts"] = self.entries
        context.verbose(f"tetrahedralizer {method}: {reason}; log: {arguments.log}")
        self.runner = Runner(arguments.log, arguments.max_seconds, context)

    def add(self, rank: tuple[float, ...], filled: Filled, entry: dict[str, Any]) -> None:
        """Note a result, which is better than others of a smaller rank."""
        self.entries.append(entry)
        # the later of equal attempts counts: it may be partly mended
        if self.best is None or rank >= self.best[0]:
            self.best = rank, filled, entry


class _Verdict(NamedTuple):
    """The quality of an attempt with one object. Better attempts compare as greater."""

    near: bool
    """Whether the distance between boundary and surface is within the limit."""
    well: bool
    """Whether no limit of shape is missed."""
    scaled_jacobian: float
    """The minimum scaled Jacobian."""


def _judge(task: Task, raw: Raw, method: Method, attempts: _Attempts, context: Context) -> _Verdict:
    """Judge the tetrahedra of one object."""
    surface, limits = task.surface, task.arguments.limits
    quality = tetrahedron_quality(raw.points, raw.tetrahedra)
    smallest = float(quality.scaled_jacobian.min())
    entry = {**raw.summary, "method": method, "orientation_turned": raw.turned, "min_scaled_jacobian": smallest}
    distance = 0.0
    if method == "ftetwild":
        boundary = tetrahedron_boundary(raw.tetrahedra).triangles
        ways = distances_both_ways(raw.points, boundary, surface.points, surface.triangles)
        distance = entry["max_distance"] = max(float(way.max()) for way in ways)
    verdict = _Verdict(distance <= limits.distance(task.envelope), well_shaped(quality, limits), smallest)
    attempts.add(verdict, Filled(raw.points, raw.tetrahedra, quality), entry)
    angle = float(quality.min_dihedral.min())
    context.verbose(f"minimum dihedral angle {angle:.3g} degrees, {distance:.3g} mm from the surface")
    return verdict


def mend(raw: Raw, triangles: Cells, sides: Sides, limits: Limits) -> tuple[Raw, Conformity] | None:
    """Replace the tetrahedra below a limit of shape or 12 degrees locally, by the Rust code.

    Parameters
    ----------
    raw
        Tetrahedra, positive; the vertices of the surface come first, and stay.
    triangles
        Triangles of the interfaces, shape ``(k, 3)``.
    sides
        Their materials.
    limits
        The limits of the checks.

    Returns
    -------
    tuple or None
        The new mesh, and how it fits the interfaces. Its summary has, under ``mended``, the goal,
        the tetrahedra below it before and after, and the changes. ``None`` if nothing changes: if
        no tetrahedron is poor, if more than 1 % are, if the mesh does not fit the interfaces, or if
        no tetrahedron gets better.
    """
    interfaces = triangles, sides.inside, sides.outside
    found = _native.mend(raw.points, raw.tetrahedra, interfaces, limits.min_dihedral, limits.min_scaled_jacobian)
    if found is None:
        return None
    mended = {
        "goal_degrees": found["goal_degrees"],
        "below_before": found["below"][0],
        "below_after": found["below"][1],
        "moves": found["moves"],
        "tetrahedra_replaced": found["changed_tetrahedra"][0],
        "tetrahedra_put": found["changed_tetrahedra"][1],
        "vertices_put": found["changed_vertices"][1],
        "vertices_taken": found["changed_vertices"][0],
    }
    return Raw(found["points"], found["tetrahedra"], {"mended": mended}), Conformity(**found["fit"])


def _choose(arguments: Arguments, vertices: int) -> tuple[Method, str]:
    """Resolve ``auto`` for one object; return the method and the reason."""
    if arguments.method != "auto":
        return arguments.method, f"--method {arguments.method} was given"
    if arguments.order == 2:
        return "hxt", "--order 2 needs the vertices of the surface, which lie on F = 0"
    method: Method = "ftetwild" if vertices <= MAX_FTETWILD_VERTICES else "hxt"
    side = "within" if method == "ftetwild" else "more than"
    return method, f"the surface has {vertices} vertices, {side} the limit of {MAX_FTETWILD_VERTICES} for fTetWild"


def _by_hxt(task: Task, attempts: _Attempts, context: Context) -> _Verdict:
    """Fill the surface by HXT, and mend single tetrahedra that miss a limit of shape."""
    surface, arguments = task.surface, task.arguments
    with context.step("background sizing"):
        job = hxt_job(surface, task.components.sheets(), task.field, arguments.tet_size_factor)
    with context.step("tetrahedralize"):
        raw = fill_by_hxt(job, attempts.runner)
    verdict = _judge(task, raw, "hxt", attempts, context)
    if not verdict.well:
        inside = np.ones(len(surface.triangles), dtype=np.int64)
        with context.step("mend tetrahedra"):
            mended = mend(raw, surface.triangles, Sides(inside, np.zeros_like(inside), []), arguments.limits)
        if mended is not None:
            verdict = max(verdict, _judge(task, mended[0], "hxt", attempts, context))
    return verdict


def _by_tetgen(task: Task, attempts: _Attempts, context: Context) -> None:
    with context.step("background sizing"):
        lengths = task.field.background(task.surface.points, task.surface.triangles, MAX_BACKGROUND_NODES)[2]
        largest = task.arguments.tet_size_factor * float(lengths.max())
    context.warn(
        "TetGen grades the tetrahedra by the edges of the surface; from the size field it uses only the maximum volume"
    )
    with context.step("tetrahedralize"):
        raw = fill_by_tetgen(task.surface, task.components, regular_volume(largest), attempts.runner)
    _judge(task, raw, "tetgen", attempts, context)


def _by_tetwild(task: Task, attempts: _Attempts, context: Context) -> None:
    """Fill the surface by fTetWild, in several attempts if necessary.

    The next attempt has a lower stop energy if tetrahedra miss a limit of shape, and a smaller
    envelope if the boundary is too far from the surface.
    """
    surface, arguments = task.surface, task.arguments
    with context.step("background sizing"):
        job = tetwild_job(surface, task.field, arguments.tet_size_factor)
    job |= {"num_opt_iter": arguments.max_passes, "num_threads": context.threads}
    energies = list(STOP_ENERGIES if arguments.stop_energy is None else (arguments.stop_energy,))
    envelopes = [share * task.envelope for share in ENVELOPES]
    while energies and envelopes:
        context.verbose(f"stop energy {energies[0]:g}, envelope {envelopes[0]:.3g} mm")
        settings = {"stop_energy": energies[0], "epsilon": envelopes[0] / surface.bounding_box_diagonal}
        try:
            with context.step("tetrahedralize"):
                raw = fill_by_tetwild(job | settings, attempts.runner)
        except StageError as error:
            if attempts.best is None:
                raise
            context.warn(f"another attempt at better tetrahedra failed: {error.what}")
            break
        verdict = _judge(task, raw, "ftetwild", attempts, context)
        if verdict.near and verdict.well:
            break
        (energies if verdict.near else envelopes).pop(0)


def fill(task: Task, context: Context) -> Filled:
    """Fill the surface of one object by the given tetrahedralizer, or by one that suits it.

    Parameters
    ----------
    task
        The surface and the settings.
    context
        For messages, times, and ``tetrahedralizer`` in the results.

    Raises
    ------
    StageError
        If no permitted tetrahedralizer fills it.
    """
    arguments, vertices = task.arguments, len(task.surface.points)
    chosen, reason = _choose(arguments, vertices)
    attempts = _Attempts(task, chosen, reason, context)
    results = attempts.results
    if chosen == "hxt":
        second = ""
        try:
            verdict = _by_hxt(task, attempts, context)
            may_move = arguments.method == "auto" and arguments.order == 1
            if may_move and vertices <= MAX_SECOND_TRY_VERTICES and not verdict.well:
                smallest = f"minimum scaled Jacobian {verdict.scaled_jacobian:.3g}"
                second = f"the tetrahedra of HXT miss a limit of shape ({smallest})"
                context.info(f"{second}; fTetWild fills the surface as well, which may take minutes")
        except StageError as error:
            if arguments.method == "hxt" or isinstance(error, TimeLimitError):
                raise
            second = error.what
            context.warn(f"{error.what}. fTetWild fills the surface instead, which may take hours; {error.next}")
        if second:
            results["method"] = chosen = "ftetwild"
            results["reason"] = f"{reason}, but {second}"
    if chosen == "tetgen":
        _by_tetgen(task, attempts, context)
    if chosen == "ftetwild":
        _by_tetwild(task, attempts, context)
    assert attempts.best is not None, "an attempt is added or an error raised"
    _, filled, entry = attempts.best
    results["method"] = context.parameters["method"] = entry["method"]
    if chosen != entry["method"]:
        results["reason"] += ", and the result of fTetWild is not better"
    return filled


def _measured(task: ComplexTask, raw: Raw, found: Conformity) -> Filled:
    """Find the tetrahedra that the surface forces below each limit.

    At a corner of an edge with the dihedral angle b, whose two faces have the angles s and t, six
    times the volume over the product of the three edges is sin b sin s sin t. So the scaled
    Jacobian is at most sqrt(2) sin b. A tetrahedron on a triangle with a small angle must reach
    :data:`_FAIR` times the largest possible value there.
    """
    quality = tetrahedron_quality(raw.points, raw.tetrahedra)
    forced = {measure: np.zeros(len(raw.tetrahedra), dtype=np.bool_) for measure in SHAPE}
    sides, standing = task.sides.occupied(found)
    forced["min_dihedral"][standing] = True
    flat = np.sqrt(2.0) * np.sin(np.radians(sides.bound)) < task.arguments.limits.min_scaled_jacobian
    forced["scaled_jacobian"][standing[flat]] = True
    needles, standing = task.needles.occupied(found)
    fair = quality.scaled_jacobian[standing] >= _FAIR * needles.bound
    forced["scaled_jacobian"][standing[fair]] = True
    return Filled(raw.points, raw.tetrahedra, quality, found, forced)


def _mended(task: ComplexTask, filled: Filled, results: dict[str, Any]) -> Filled:
    """Mend the tetrahedra that miss the goal, where that is possible."""
    raw = Raw(filled.points, filled.tetrahedra, {})
    mended = mend(raw, task.surface.triangles, task.checked.sides, task.arguments.limits)
    if mended is None:
        return filled
    after = _measured(task, *mended)
    smallest = [smallest_elsewhere(one.quality, one.forced)["min_dihedral"] for one in (filled, after)]
    results["mended"] = mended[0].summary["mended"]
    results["mended"] |= {"min_dihedral_before": smallest[0], "min_dihedral_after": smallest[1]}
    return after


def fill_complex(task: ComplexTask, context: Context) -> Filled:
    """Fill every volume of many materials; ``tetrahedralizer`` in the results has the attempts.

    Raises
    ------
    StageError
        If no tetrahedralizer fills it so that each tetrahedron has a material.
    """
    arguments, surface, sides = task.arguments, task.surface, task.checked.sides
    reason = "the surface has several materials, and Gmsh keeps the triangles between them"
    attempts = _Attempts(task, "hxt", reason, context)
    context.parameters["method"] = "hxt"
    with context.step("background sizing"):
        job = hxt_job(surface, task.checked.shells.sheets(), task.field, arguments.tet_size_factor)
    algorithms = ALGORITHMS if arguments.method == "auto" else ALGORITHMS[:1]
    for algorithm in algorithms:
        try:
            with context.step("tetrahedralize"):
                raw = fill_by_hxt(job | {"algorithm": algorithm}, attempts.runner)
        except StageError as error:
            final = algorithm == algorithms[-1] or isinstance(error, (TimeLimitError, UnavailableError))
            if final and attempts.best is None:
                raise
            attempts.entries.append({"algorithm": algorithm, "error": error.what})
            continue
        with context.step("find regions"):
            found = conform(len(raw.points), raw.tetrahedra, surface.triangles, sides)
            filled = _measured(task, raw, found)
        smallest = smallest_elsewhere(filled.quality, filled.forced)
        entry = {
            **raw.summary,
            "algorithm": algorithm,
            "faults": found.faults,
            "min_dihedral": smallest["min_dihedral"],
            "min_scaled_jacobian": smallest["scaled_jacobian"],
        }
        attempts.add((-found.faults, smallest["scaled_jacobian"]), filled, entry)
        if found.faults == 0:
            break
        context.verbose(f"{algorithm}: {found.faults} faults at the interfaces")
    assert attempts.best is not None, "an attempt is added or an error raised"
    _, filled, entry = attempts.best
    attempts.results["algorithm"] = entry["algorithm"]
    fit = filled.conformity
    assert fit is not None, "there are materials"
    if fit.undecided:
        raise StageError(
            f"the material of {fit.undecided} tetrahedra is unknown: the tetrahedralizer lost "
            f"{fit.missing} triangles of the interfaces",
            "without these triangles the materials are not separated; nothing was written",
            f"see its log, {arguments.log}, or try another --tet-size-factor",
        )
    if fit.faults:
        return filled
    with context.step("mend tetrahedra"):
        return _mended(task, filled, attempts.results)
