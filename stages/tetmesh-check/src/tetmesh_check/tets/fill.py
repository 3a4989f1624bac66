"""Fills the surface of one object, and repeats attempts that miss a limit."""

from __future__ import annotations

from dataclasses import dataclass
from dataclasses import field as made_by
from typing import Any, NamedTuple

import numpy as np
from isoparticles._native import Context, GridField, distances_both_ways

from tetmesh_check.arguments import Arguments, Method
from tetmesh_check.checks import OfShape, well_shaped
from tetmesh_check.conform import Conformity
from tetmesh_check.errors import StageError
from tetmesh_check.materials import Sides
from tetmesh_check.mend import mend
from tetmesh_check.quality import Cells, Points, TetrahedronQuality, tetrahedron_quality
from tetmesh_check.surface import Surface
from tetmesh_check.tets.hxt import fill_by_hxt, hxt_job
from tetmesh_check.tets.tetgen import fill_by_tetgen, regular_volume
from tetmesh_check.tets.tetwild import MAX_BACKGROUND_NODES, fill_by_tetwild
from tetmesh_check.tets.worker import Raw, Runner, TimeLimitError
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


class Task(NamedTuple):
    """A surface to fill."""

    arguments: Arguments
    surface: Surface
    """A checked surface."""
    components: Components
    """Its components."""
    field: GridField
    """Edge lengths, mm, without the factor."""
    envelope: float
    """For fTetWild: largest distance of the boundary from the surface, mm."""


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


class _Verdict(NamedTuple):
    """The quality of an attempt. Better attempts compare as greater."""

    near: bool
    """Whether the distance between boundary and surface is within the limit."""
    well: bool
    """Whether no limit of shape is missed."""
    scaled_jacobian: float
    """The minimum scaled Jacobian."""


class _Attempts:
    """The attempts made so far, for the report, and the best of them."""

    def __init__(self, task: Task, context: Context) -> None:
        self._task = task
        self._context = context
        self.entries: list[dict[str, Any]] = []
        self.best: tuple[_Verdict, Filled, Method] | None = None

    def add(self, raw: Raw, method: Method) -> _Verdict:
        """Judge a result."""
        surface, limits = self._task.surface, self._task.arguments.limits
        quality = tetrahedron_quality(raw.points, raw.tetrahedra)
        smallest = float(quality.scaled_jacobian.min())
        entry = {**raw.summary, "method": method, "orientation_turned": raw.turned, "min_scaled_jacobian": smallest}
        distance = 0.0
        if method is Method.FTETWILD:
            boundary = tetrahedron_boundary(raw.tetrahedra).triangles
            ways = distances_both_ways(raw.points, boundary, surface.points, surface.triangles)
            distance = entry["max_distance"] = max(float(way.max()) for way in ways)
        self.entries.append(entry)
        verdict = _Verdict(
            near=distance <= limits.distance(self._task.envelope),
            well=well_shaped(quality, limits),
            scaled_jacobian=smallest,
        )
        # the later of equal attempts counts: it may be partly mended
        if self.best is None or verdict >= self.best[0]:
            self.best = verdict, Filled(raw.points, raw.tetrahedra, quality), method
        angle = float(quality.min_dihedral.min())
        self._context.verbose(f"minimum dihedral angle {angle:.3g} degrees, {distance:.3g} mm from the surface")
        return verdict


def _choose(arguments: Arguments, vertices: int) -> tuple[Method, str]:
    """Resolve ``auto``; return the method and the reason."""
    if arguments.method is not Method.AUTO:
        return arguments.method, f"--method {arguments.method} was given"
    if arguments.order == 2:
        return Method.HXT, "--order 2 needs the vertices of the surface, which lie on F = 0"
    method, side = (Method.FTETWILD, "within") if vertices <= MAX_FTETWILD_VERTICES else (Method.HXT, "more than")
    return method, f"the surface has {vertices} vertices, {side} the limit of {MAX_FTETWILD_VERTICES} for fTetWild"


def _by_hxt(task: Task, attempts: _Attempts, runner: Runner, context: Context) -> _Verdict:
    """Fill the surface by HXT, and mend single tetrahedra that miss a limit of shape."""
    surface, arguments = task.surface, task.arguments
    with context.step("background sizing"):
        job = hxt_job(surface, task.components.sheets(), task.field, arguments.tet_size_factor)
    with context.step("tetrahedralize"):
        raw = fill_by_hxt(job, runner)
    verdict = attempts.add(raw, Method.HXT)
    if not verdict.well:
        inside = np.ones(len(surface.triangles), dtype=np.int64)
        with context.step("mend tetrahedra"):
            sides = Sides(inside, np.zeros_like(inside), [])
            mended = mend(raw.points, raw.tetrahedra, surface.triangles, sides, arguments.limits)
        if mended is not None:
            verdict = max(verdict, attempts.add(mended[0], Method.HXT))
    return verdict


def _by_tetgen(task: Task, attempts: _Attempts, runner: Runner, context: Context) -> None:
    with context.step("background sizing"):
        lengths = task.field.background(task.surface.points, task.surface.triangles, MAX_BACKGROUND_NODES)[2]
        largest = task.arguments.tet_size_factor * float(lengths.max())
    context.warn(
        "TetGen grades the tetrahedra by the edges of the surface; from the size field it uses only the maximum volume"
    )
    with context.step("tetrahedralize"):
        raw = fill_by_tetgen(task.surface, task.components, regular_volume(largest), runner)
    attempts.add(raw, Method.TETGEN)


def _by_tetwild(task: Task, attempts: _Attempts, runner: Runner, context: Context) -> None:
    """Fill the surface by fTetWild, in several attempts if necessary.

    The next attempt has a lower stop energy if tetrahedra miss a limit of shape, and a smaller
    envelope if the boundary is too far from the surface.
    """
    surface, arguments = task.surface, task.arguments
    with context.step("background sizing"):
        points, tetrahedra, lengths, stride = task.field.background(
            surface.points, surface.triangles, MAX_BACKGROUND_NODES
        )
        background = points, tetrahedra, arguments.tet_size_factor * lengths, stride
    energies = list(STOP_ENERGIES if arguments.stop_energy is None else (arguments.stop_energy,))
    envelopes = [share * task.envelope for share in ENVELOPES]
    while energies and envelopes:
        context.verbose(f"stop energy {energies[0]:g}, envelope {envelopes[0]:.3g} mm")
        settings = {
            "stop_energy": energies[0],
            "num_opt_iter": arguments.max_passes,
            "num_threads": context.threads,
        }
        try:
            with context.step("tetrahedralize"):
                raw = fill_by_tetwild(surface, background, settings, envelopes[0], runner)
        except StageError as error:
            if attempts.best is None:
                raise
            context.warn(f"another attempt at better tetrahedra failed: {error.what}")
            break
        verdict = attempts.add(raw, Method.FTETWILD)
        if verdict.near and verdict.well:
            break
        (energies if verdict.near else envelopes).pop(0)


def fill(task: Task, context: Context) -> Filled:
    """Fill a surface by the given tetrahedralizer, or by one that suits it.

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
    attempts = _Attempts(task, context)
    results: dict[str, Any] = {"method": chosen, "reason": reason, "log": arguments.log.name}
    results["attempts"] = attempts.entries
    context.results["tetrahedralizer"] = results
    context.verbose(f"tetrahedralizer {chosen}: {reason}; log: {arguments.log}")
    runner = Runner(arguments.log, arguments.max_seconds, context)
    if chosen is Method.HXT:
        second = ""
        try:
            verdict = _by_hxt(task, attempts, runner, context)
            may_move = arguments.method is Method.AUTO and arguments.order == 1
            if may_move and vertices <= MAX_SECOND_TRY_VERTICES and not verdict.well:
                smallest = f"minimum scaled Jacobian {verdict.scaled_jacobian:.3g}"
                second = f"the tetrahedra of HXT miss a limit of shape ({smallest})"
                context.info(f"{second}; fTetWild fills the surface as well, which may take minutes")
        except StageError as error:
            if arguments.method is Method.HXT or isinstance(error, TimeLimitError):
                raise
            second = error.what
            context.warn(f"{error.what}. fTetWild fills the surface instead, which may take hours; {error.next}")
        if second:
            results["method"] = chosen = Method.FTETWILD
            results["reason"] = f"{reason}, but {second}"
    if chosen is Method.TETGEN:
        _by_tetgen(task, attempts, runner, context)
    if chosen is Method.FTETWILD:
        _by_tetwild(task, attempts, runner, context)
    assert attempts.best is not None, "an attempt is added or an error raised"
    _, filled, results["method"] = attempts.best
    if chosen is not results["method"]:
        results["reason"] += ", and the result of fTetWild is not better"
    context.parameters["method"] = results["method"]
    return filled
