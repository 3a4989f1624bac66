"""Which tetrahedralizer fills the surface, and how often it is tried."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import Any

import numpy as np

from tetmesh_check.checks import Limits, well_shaped
from tetmesh_check.components import Components
from tetmesh_check.context import Context
from tetmesh_check.distance import distances_both_ways
from tetmesh_check.errors import ExitCode, StageError
from tetmesh_check.export.volume import orient_positive
from tetmesh_check.materials import NOTHING, Sides
from tetmesh_check.mend import mend
from tetmesh_check.quality import Cells, Points, tetrahedron_quality
from tetmesh_check.sizing import Background, SizingField, background_mesh, world_grid
from tetmesh_check.surface import Surface
from tetmesh_check.tets.hxt import HxtSettings, fill_by_hxt
from tetmesh_check.tets.tetgen import TetgenSettings, fill_by_tetgen, regular_volume
from tetmesh_check.tets.tetwild import TetwildSettings, fill_by_tetwild
from tetmesh_check.tets.worker import TimeLimit, TimeLimitError, WorkerResult
from tetmesh_check.topology import tetrahedron_boundary

MAX_FTETWILD_VERTICES = 5_000
"""Largest surface that fTetWild is given by default: it takes about half a minute for that many vertices on two cores, two for
10,000, and twenty to hours from 50,000 on, where HXT takes seconds. Its tetrahedra are the better ones (mean radius ratio 0.86
in place of 0.79), but those of both pass the checks on nearly every surface."""

MAX_SECOND_TRY_VERTICES = 20_000
"""Largest surface that ``auto`` gives to fTetWild, too, where a tetrahedron of HXT's misses a limit of shape and cannot be mended: sheets of
a surface that nearly touch leave flat ones between its fixed triangles. Some four minutes for each of :data:`STOP_ENERGIES` that it takes."""

ENVELOPES = (1.0, 0.5, 0.25)
"""Envelopes that fTetWild is given in turn, over the one asked for, while the boundary strays by more than may be: it keeps its own
samples of the boundary within the envelope, and a thin tip may lose more."""

COARSE_FRACTION = 0.05
"""Edge length outside the object over the diagonal of its bounding box, where h is smaller; fTetWild's own default."""

STOP_ENERGIES = (1000.0, 30.0, 10.0)
"""Default ends of fTetWild's optimization, before it turns to the background and after: the first is the quickest and enough
for a good surface, because refinement to the background optimizes anyway; when the tetrahedra then miss a limit of
shape, the next is tried."""


class Method(StrEnum):
    """Who makes the tetrahedra."""

    AUTO = "auto"
    """fTetWild up to :data:`MAX_FTETWILD_VERTICES`, HXT beyond; fTetWild also where HXT cannot be had or fails, or misses a limit of shape
    that mending does not cure."""
    FTETWILD = "ftetwild"
    HXT = "hxt"
    TETGEN = "tetgen"
    """By hand only."""


@dataclass(frozen=True)
class Task:
    """What is to be filled, and how."""

    surface: Surface
    """A checked surface."""
    components: Components
    """Its components."""
    field: SizingField
    """Edge lengths, without the factor."""
    tet_size_factor: float
    """Tetrahedron edge length over h."""
    method: Method
    envelope: float
    """For fTetWild: largest distance of the boundary from the surface, mm."""
    stop_energy: float | None
    """For fTetWild: largest AMIPS energy at which it stops; by default each of :data:`STOP_ENERGIES` in turn."""
    max_passes: int
    """For fTetWild."""
    max_seconds: float
    """The time that all attempts together may take, s."""
    limits: Limits
    """fTetWild is tried again with more patience while a limit of shape is missed, in a smaller envelope while the boundary strays."""
    log: Path
    """Where the tetrahedralizer's output goes."""
    keep_vertices: bool = False
    """Whether the vertices have to stay where the surface has them: ``auto`` is HXT then."""


@dataclass(frozen=True)
class Filled:
    """The tetrahedra."""

    points: Points
    """Positions, mm, shape ``(n, 3)``."""
    tetrahedra: Cells
    """Vertex indices in VTK order, shape ``(m, 4)``."""

    @property
    def mesh(self) -> tuple[Points, Cells]:
        """Both."""
        return self.points, self.tetrahedra


def _choose(method: Method, vertices: int, keep_vertices: bool) -> tuple[Method, str]:
    """Resolve ``auto``, and say why."""
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
    """How good an attempt is, the worst first."""

    near: bool
    """Whether boundary and surface are no farther apart than may be."""
    well: bool
    """Whether no limit of shape is missed."""
    scaled_jacobian: float
    """The smallest."""


class _Attempts:
    """The attempts made so far, for the report, and the best of them."""

    def __init__(self, task: Task, results: dict[str, Any]) -> None:
        self._task = task
        self._list: list[dict[str, Any]] = results.setdefault("attempts", [])
        self._best: tuple[_Verdict, Filled, Method] | None = None

    def add(self, raw: WorkerResult, method: Method) -> tuple[_Verdict, str]:
        """Judge a result; returns how good it is, and that in words."""
        task = self._task
        tetrahedra, turned = orient_positive(raw.points, raw.tetrahedra)
        quality = tetrahedron_quality(raw.points, tetrahedra)
        distance = 0.0
        if method is Method.FTETWILD:
            boundary = (raw.points, tetrahedron_boundary(tetrahedra).triangles)
            ways = distances_both_ways(boundary, (task.surface.points, task.surface.triangles))
            distance = max(float(way.max()) for way in ways)
        verdict = _Verdict(
            near=distance <= task.limits.distance(task.envelope),
            well=well_shaped(quality, task.limits),
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
        # of equals the later: what was mended in part is better than what was not
        if self._best is None or verdict >= self._best[0]:
            self._best = verdict, Filled(raw.points, tetrahedra), method
        smallest = float(quality.min_dihedral.min())
        return verdict, f"minimum dihedral angle {smallest:.3g} degrees, {distance:.3g} mm from the surface"

    @property
    def is_any(self) -> bool:
        """Whether there is any."""
        return self._best is not None

    @property
    def best(self) -> tuple[Filled, Method]:
        """The best of them, and whose it is."""
        assert self._best is not None, "an attempt is added or an error raised"
        return self._best[1:]


def _by_hxt(task: Task, attempts: _Attempts, limit: TimeLimit, context: Context) -> _Verdict:
    """Have the surface filled by HXT, and single tetrahedra that miss a limit of shape mended."""
    with context.step("background sizing"):
        grid = world_grid(task.field, task.surface, task.tet_size_factor)
    with context.step("tetrahedralize"):
        raw = fill_by_hxt(task.surface, task.components, grid, HxtSettings(), task.log, limit, context)
    verdict, _ = attempts.add(raw, Method.HXT)
    if not verdict.well:
        with context.step("mend tetrahedra"):
            mended = _mended(task, *attempts.best[0].mesh)
        if mended is not None:
            verdict = max(verdict, attempts.add(mended, Method.HXT)[0])
    return verdict


def _mended(task: Task, points: Points, tetrahedra: Cells) -> WorkerResult | None:
    """Mend tetrahedra that have the triangles of the surface as their faces; ``None`` where they do not, or nothing is mended."""
    triangles, vertices = task.surface.triangles, task.surface.points
    inside, outside = np.ones(len(triangles), dtype=np.int64), np.full(len(triangles), NOTHING, dtype=np.int64)
    if not np.array_equal(points[: len(vertices)], vertices):
        return None
    mended = mend(points, tetrahedra, triangles, Sides(inside, outside, []), task.limits)
    if mended is None:
        return None
    return WorkerResult(mended.points, mended.tetrahedra, "", {"mended": mended.results})


def _by_tetgen(task: Task, attempts: _Attempts, limit: TimeLimit, context: Context) -> None:
    with context.step("background sizing"):
        largest = task.tet_size_factor * float(background_mesh(task.field, task.surface).values.max())
    context.warn(
        "TetGen grades the tetrahedra by the edges of the surface; from the size field it uses only the maximum volume"
    )
    with context.step("tetrahedralize"):
        settings = TetgenSettings(max_volume=regular_volume(largest))
        raw = fill_by_tetgen(task.surface, task.components, settings, task.log, limit, context)
    attempts.add(raw, Method.TETGEN)


def _by_tetwild(task: Task, attempts: _Attempts, limit: TimeLimit, context: Context) -> None:
    """Have the surface filled, again with more patience where tetrahedra are ill-shaped, in a smaller envelope where the boundary strays."""
    diagonal = task.surface.bounding_box_diagonal
    with context.step("background sizing"):
        plain = background_mesh(task.field, task.surface)
        background = Background(plain.points, plain.tetrahedra, task.tet_size_factor * plain.values, plain.stride)
    # fTetWild meshes the whole box at this length and only then refines to the background: the coarser, the less work
    # goes into tetrahedra outside the object, which are thrown away.
    coarse = min(max(float(background.values.max()), COARSE_FRACTION * diagonal), diagonal)
    energies = list(STOP_ENERGIES if task.stop_energy is None else (task.stop_energy,))
    envelopes = [share * task.envelope for share in ENVELOPES]
    while energies and envelopes:
        settings = TetwildSettings(
            epsilon=envelopes[0] / diagonal,
            edge_length=coarse,
            stop_energy=energies[0],
            max_passes=task.max_passes,
            threads=context.common.thread_count,
        )
        try:
            with context.step("tetrahedralize"):
                raw = fill_by_tetwild(task.surface, background, settings, task.log, limit, context)
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
    """Have a surface filled by the tetrahedralizer that was asked for, or that suits it.

    Parameters
    ----------
    task
        What is to be filled, and how.
    context
        For messages, times, and ``tetrahedralizer`` in the results.

    Raises
    ------
    StageError
        If no tetrahedralizer that may be used fills it.
    """
    chosen, reason = _choose(task.method, len(task.surface.points), task.keep_vertices)
    results: dict[str, Any] = {"method": chosen, "reason": reason, "log": task.log.name}
    context.results["tetrahedralizer"] = results
    attempts = _Attempts(task, results)
    context.verbose(f"tetrahedralizer {chosen}: {reason}; log: {task.log}")
    task.log.unlink(missing_ok=True)
    limit = TimeLimit.start(task.max_seconds)
    if chosen is Method.HXT:
        second = ""
        try:
            verdict = _by_hxt(task, attempts, limit, context)
            small_enough = len(task.surface.points) <= MAX_SECOND_TRY_VERTICES and not task.keep_vertices
            if task.method is Method.AUTO and small_enough and not verdict.well:
                smallest = f"minimum scaled Jacobian {verdict.scaled_jacobian:.3g}"
                second = f"the tetrahedra of HXT miss a limit of shape ({smallest})"
                context.info(f"{second}; fTetWild fills the surface as well, which may take minutes")
        except StageError as error:
            if task.method is Method.HXT or error.code == ExitCode.INTERRUPTED or isinstance(error, TimeLimitError):
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
