"""Chooses the tetrahedralizer of a surface, and repeats attempts that fail a limit."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from tetmesh_check.arguments import Arguments, Method
from tetmesh_check.checks import well_shaped
from tetmesh_check.components import Components
from tetmesh_check.context import Context
from tetmesh_check.distance import distances_both_ways
from tetmesh_check.errors import ExitCode, StageError
from tetmesh_check.materials import NOTHING, Sides
from tetmesh_check.mend import mend
from tetmesh_check.quality import Cells, Points, TetrahedronQuality, orient_positive, tetrahedron_quality
from tetmesh_check.sizing import Background, SizingField, background_mesh, world_grid
from tetmesh_check.surface import Surface
from tetmesh_check.tets.hxt import HxtSettings, fill_by_hxt
from tetmesh_check.tets.tetgen import TetgenSettings, fill_by_tetgen, regular_volume
from tetmesh_check.tets.tetwild import TetwildSettings, fill_by_tetwild
from tetmesh_check.tets.worker import TimeLimit, TimeLimitError, WorkerResult
from tetmesh_check.topology import tetrahedron_boundary

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

COARSE_FRACTION = 0.05
"""Minimum edge length outside the object, relative to the diagonal of its bounding box. The default
of fTetWild."""

STOP_ENERGIES = (1000.0, 30.0, 10.0)
"""Default stop energies of the attempts of fTetWild. The first is the fastest and suffices for a
good surface, because the refinement to the background also optimizes. The next is used if
tetrahedra miss a limit of shape."""


@dataclass(frozen=True)
class Task:
    """A surface of one object to fill, and the settings."""

    arguments: Arguments
    surface: Surface
    """A checked surface."""
    components: Components
    """Its components."""
    field: SizingField
    """Edge lengths, without the factor."""
    envelope: float
    """For fTetWild: largest distance of the boundary from the surface, mm."""
    keep_vertices: bool
    """Whether the vertices of the surface must stay in place. If so, ``auto`` chooses HXT."""


@dataclass(frozen=True)
class Filled:
    """The tetrahedra."""

    points: Points
    """Positions, mm, shape ``(n, 3)``."""
    tetrahedra: Cells
    """Vertex indices in VTK order, shape ``(m, 4)``."""
    quality: TetrahedronQuality
    """Their measures."""

    @property
    def mesh(self) -> tuple[Points, Cells]:
        """The points and the tetrahedra."""
        return self.points, self.tetrahedra


def _choose(method: Method, vertices: int, keep_vertices: bool) -> tuple[Method, str]:
    """Resolve ``auto``; return the method and the reason."""
    if method is not Method.AUTO:
        return method, f"--method {method} was given"
    if keep_vertices:
        return Method.HXT, "--order 2 needs the vertices of the surface, which lie on F = 0"
    if vertices > MAX_FTETWILD_VERTICES:
        return (
            Method.HXT,
            f"the surface has {vertices} vertices, more than the limit of {MAX_FTETWILD_VERTICES} for fTetWild",
        )
    return (
        Method.FTETWILD,
        f"the surface has {vertices} vertices, within the limit of {MAX_FTETWILD_VERTICES} for fTetWild",
    )


@dataclass(frozen=True, order=True)
class _Verdict:
    """The quality of an attempt. Better attempts compare as greater."""

    near: bool
    """Whether the distance between boundary and surface is within the limit."""
    well: bool
    """Whether no limit of shape is missed."""
    scaled_jacobian: float
    """The minimum scaled Jacobian."""


class _Attempts:
    """The attempts made so far, for the report, and the best of them."""

    def __init__(self, task: Task, results: dict[str, Any]) -> None:
        self._task = task
        self._list: list[dict[str, Any]] = results.setdefault("attempts", [])
        self._best: tuple[_Verdict, Filled, Method] | None = None

    def add(self, raw: WorkerResult, method: Method) -> tuple[_Verdict, str]:
        """Judge a result; return the verdict, and a text about it."""
        task = self._task
        tetrahedra, turned = orient_positive(raw.points, raw.tetrahedra)
        quality = tetrahedron_quality(raw.points, tetrahedra)
        distance = 0.0
        if method is Method.FTETWILD:
            boundary = (raw.points, tetrahedron_boundary(tetrahedra).triangles)
            ways = distances_both_ways(boundary, (task.surface.points, task.surface.triangles))
            distance = max(float(way.max()) for way in ways)
        verdict = _Verdict(
            near=distance <= task.arguments.limits.distance(task.envelope),
            well=well_shaped(quality, task.arguments.limits),
            scaled_jacobian=float(quality.scaled_jacobian.min()),
        )
        self._list.append(
            {
                **raw.summary,
                "method": method,
                "orientation_turned": turned,
                "min_scaled_jacobian": verdict.scaled_jacobian,
                **({"max_distance": distance} if method is Method.FTETWILD else {}),
            }
        )
        # the later of equal attempts counts: it may be partly mended
        if self._best is None or verdict >= self._best[0]:
            self._best = verdict, Filled(raw.points, tetrahedra, quality), method
        smallest = float(quality.min_dihedral.min())
        return verdict, f"minimum dihedral angle {smallest:.3g} degrees, {distance:.3g} mm from the surface"

    @property
    def is_any(self) -> bool:
        """Whether an attempt has succeeded."""
        return self._best is not None

    @property
    def best(self) -> tuple[Filled, Method]:
        """The best result and its method."""
        assert self._best is not None, "an attempt is added or an error raised"
        return self._best[1:]


def _by_hxt(task: Task, attempts: _Attempts, limit: TimeLimit, context: Context) -> _Verdict:
    """Fill the surface by HXT, and mend single tetrahedra that miss a limit of shape."""
    with context.step("background sizing"):
        grid = world_grid(task.field, task.surface, task.arguments.tet_size_factor)
    with context.step("tetrahedralize"):
        raw = fill_by_hxt(task.surface, task.components, grid, HxtSettings(), task.arguments.log, limit, context)
    verdict, _ = attempts.add(raw, Method.HXT)
    if not verdict.well:
        with context.step("mend tetrahedra"):
            mended = _mended(task, *attempts.best[0].mesh)
        if mended is not None:
            verdict = max(verdict, attempts.add(mended, Method.HXT)[0])
    return verdict


def _mended(task: Task, points: Points, tetrahedra: Cells) -> WorkerResult | None:
    """Mend tetrahedra whose boundary consists of the triangles of the surface.

    Return ``None`` if it does not, or if nothing is mended.
    """
    triangles, vertices = task.surface.triangles, task.surface.points
    inside, outside = np.ones(len(triangles), dtype=np.int64), np.full(len(triangles), NOTHING, dtype=np.int64)
    if not np.array_equal(points[: len(vertices)], vertices):
        return None
    mended = mend(points, tetrahedra, triangles, Sides(inside, outside, []), task.arguments.limits)
    if mended is None:
        return None
    return WorkerResult(mended.points, mended.tetrahedra, "", {"mended": mended.results})


def _by_tetgen(task: Task, attempts: _Attempts, limit: TimeLimit, context: Context) -> None:
    with context.step("background sizing"):
        largest = task.arguments.tet_size_factor * float(background_mesh(task.field, task.surface).values.max())
    context.warn(
        "TetGen grades the tetrahedra by the edges of the surface; from the size field it uses only the maximum volume"
    )
    with context.step("tetrahedralize"):
        settings = TetgenSettings(max_volume=regular_volume(largest))
        raw = fill_by_tetgen(task.surface, task.components, settings, task.arguments.log, limit, context)
    attempts.add(raw, Method.TETGEN)


def _by_tetwild(task: Task, attempts: _Attempts, limit: TimeLimit, context: Context) -> None:
    """Fill the surface by fTetWild, in several attempts if necessary.

    The next attempt has a lower stop energy if tetrahedra miss a limit of shape, and a smaller
    envelope if the boundary is too far from the surface.
    """
    diagonal = task.surface.bounding_box_diagonal
    with context.step("background sizing"):
        plain = background_mesh(task.field, task.surface)
        background = Background(
            plain.points, plain.tetrahedra, task.arguments.tet_size_factor * plain.values, plain.stride
        )
    # fTetWild first meshes the whole box at this length, then refines to the background. A large
    # length saves work on tetrahedra outside the object, which are removed.
    coarse = min(max(float(background.values.max()), COARSE_FRACTION * diagonal), diagonal)
    energies = list(STOP_ENERGIES if task.arguments.stop_energy is None else (task.arguments.stop_energy,))
    envelopes = [share * task.envelope for share in ENVELOPES]
    while energies and envelopes:
        settings = TetwildSettings(
            epsilon=envelopes[0] / diagonal,
            edge_length=coarse,
            stop_energy=energies[0],
            max_passes=task.arguments.max_passes,
            threads=context.common.thread_count,
        )
        try:
            with context.step("tetrahedralize"):
                raw = fill_by_tetwild(task.surface, background, settings, task.arguments.log, limit, context)
        except StageError as error:
            if not attempts.is_any or error.code == ExitCode.INTERRUPTED:
                raise
            context.warn(f"another attempt at better tetrahedra failed: {error.what}")
            break
        verdict, told = attempts.add(raw, Method.FTETWILD)
        context.verbose(f"stop energy {energies[0]:g}, envelope {envelopes[0]:.3g} mm: {told}")
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
    chosen, reason = _choose(task.arguments.method, len(task.surface.points), task.keep_vertices)
    results: dict[str, Any] = {"method": chosen, "reason": reason, "log": task.arguments.log.name}
    context.results["tetrahedralizer"] = results
    attempts = _Attempts(task, results)
    context.verbose(f"tetrahedralizer {chosen}: {reason}; log: {task.arguments.log}")
    task.arguments.log.unlink(missing_ok=True)
    limit = TimeLimit.start(task.arguments.max_seconds)
    if chosen is Method.HXT:
        second = ""
        try:
            verdict = _by_hxt(task, attempts, limit, context)
            small_enough = len(task.surface.points) <= MAX_SECOND_TRY_VERTICES and not task.keep_vertices
            if task.arguments.method is Method.AUTO and small_enough and not verdict.well:
                smallest = f"minimum scaled Jacobian {verdict.scaled_jacobian:.3g}"
                second = f"the tetrahedra of HXT miss a limit of shape ({smallest})"
                context.info(f"{second}; fTetWild fills the surface as well, which may take minutes")
        except StageError as error:
            if (
                task.arguments.method is Method.HXT
                or error.code == ExitCode.INTERRUPTED
                or isinstance(error, TimeLimitError)
            ):
                raise
            second = error.what
            context.warn(f"{error.what}. fTetWild fills the surface instead, which may take hours; {error.next_step}")
        if second:
            results["method"] = chosen = Method.FTETWILD
            results["reason"] = f"{reason}, but {second}"
    if chosen is Method.TETGEN:
        _by_tetgen(task, attempts, limit, context)
    if chosen is Method.FTETWILD:
        _by_tetwild(task, attempts, limit, context)
    filled, results["method"] = attempts.best
    if chosen is not results["method"]:
        results["reason"] += ", and the result of fTetWild is not better"
    context.parameters["method"] = results["method"]
    return filled
