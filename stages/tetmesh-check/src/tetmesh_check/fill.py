"""Which tetrahedralizer fills the surface, and how often it is tried."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import Any

from tetmesh_check.checks import Limits, well_shaped
from tetmesh_check.components import Components
from tetmesh_check.context import Context
from tetmesh_check.errors import ExitCode, StageError
from tetmesh_check.hxt import HxtSettings, fill_by_hxt
from tetmesh_check.quality import Cells, Points, tetrahedron_quality
from tetmesh_check.sizing import Background, SizingField, background_mesh, world_grid
from tetmesh_check.surface import Surface
from tetmesh_check.tetgen import TetgenSettings, fill_by_tetgen, regular_volume
from tetmesh_check.tetwild import TetwildSettings, fill_by_tetwild
from tetmesh_check.volume import orient_positive
from tetmesh_check.worker import TimeLimit, TimeLimitError, WorkerResult

MAX_FTETWILD_VERTICES = 5_000
"""Largest surface that fTetWild is given by default: it takes about half a minute for that many vertices on two cores, two for
10,000, and twenty to hours from 50,000 on, where HXT takes seconds. Its tetrahedra are the better ones (mean radius ratio 0.86
in place of 0.79), but those of both pass every check."""

COARSE_FRACTION = 0.05
"""Edge length outside the object over the diagonal of its bounding box, where h is smaller; fTetWild's own default."""

STOP_ENERGIES = (1000.0, 30.0, 10.0)
"""Default ends of fTetWild's optimization, before it turns to the background and after: the first is the quickest and enough
for a good surface, because refinement to the background optimizes anyway; when the tetrahedra then miss a limit of
shape, the next is tried."""


class Method(StrEnum):
    """Who makes the tetrahedra."""

    AUTO = "auto"
    """fTetWild up to :data:`MAX_FTETWILD_VERTICES`, HXT beyond; fTetWild also where HXT cannot be had or fails."""
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
    """fTetWild is tried again with more patience while a limit of shape is missed."""
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


def _choose(method: Method, vertices: int, keep_vertices: bool) -> tuple[Method, str]:
    """Resolve ``auto``, and say why."""
    if method is not Method.AUTO:
        return method, f"--method {method} was given"
    if keep_vertices:
        return Method.HXT, "--order 2 wants the vertices where the surface has them, on F = 0"
    if vertices > MAX_FTETWILD_VERTICES:
        return (
            Method.HXT,
            f"the surface has {vertices} vertices, more than the {MAX_FTETWILD_VERTICES} left to fTetWild",
        )
    return Method.FTETWILD, f"the surface has {vertices} vertices, not more than {MAX_FTETWILD_VERTICES}"


class _Attempts:
    """The attempts made so far, for the report, and the best of them."""

    def __init__(self, limits: Limits, results: dict[str, Any]) -> None:
        self._limits = limits
        self._list: list[dict[str, Any]] = results.setdefault("attempts", [])
        self._worst = 0.0
        self.best: Filled | None = None

    def add(self, raw: WorkerResult) -> tuple[bool, float]:
        """Judge a result; returns whether it is within the limits of shape, and its smallest dihedral angle."""
        tetrahedra, turned = orient_positive(raw.points, raw.tetrahedra)
        quality = tetrahedron_quality(raw.points, tetrahedra)
        worst = float(quality.scaled_jacobian.min())
        self._list.append({**raw.summary, "orientation_turned": turned, "min_scaled_jacobian": worst})
        if self.best is None or worst > self._worst:
            self._worst, self.best = worst, Filled(raw.points, tetrahedra)
        return well_shaped(quality, self._limits), float(quality.min_dihedral.min())


def _by_hxt(task: Task, attempts: _Attempts, limit: TimeLimit, context: Context) -> None:
    with context.step("background sizing"):
        grid = world_grid(task.field, task.surface, task.tet_size_factor)
    with context.step("tetrahedralize"):
        raw = fill_by_hxt(task.surface, task.components, grid, HxtSettings(), task.log, limit, context)
    attempts.add(raw)


def _by_tetgen(task: Task, attempts: _Attempts, limit: TimeLimit, context: Context) -> None:
    with context.step("background sizing"):
        largest = task.tet_size_factor * float(background_mesh(task.field, task.surface).values.max())
    context.warn(
        "TetGen grades the tetrahedra by the edges of the surface alone: of the size field it is told the largest volume only"
    )
    with context.step("tetrahedralize"):
        settings = TetgenSettings(max_volume=regular_volume(largest))
        raw = fill_by_tetgen(task.surface, task.components, settings, task.log, limit, context)
    attempts.add(raw)


def _by_tetwild(task: Task, attempts: _Attempts, limit: TimeLimit, context: Context) -> None:
    """Have the surface filled, again and with more patience where the result is not well shaped."""
    diagonal = task.surface.bounding_box_diagonal
    with context.step("background sizing"):
        plain = background_mesh(task.field, task.surface)
        background = Background(plain.points, plain.tetrahedra, task.tet_size_factor * plain.values, plain.stride)
    # fTetWild meshes the whole box at this length and only then refines to the background: the coarser, the less work
    # goes into tetrahedra outside the object, which are thrown away.
    coarse = min(max(float(background.values.max()), COARSE_FRACTION * diagonal), diagonal)
    for energy in STOP_ENERGIES if task.stop_energy is None else (task.stop_energy,):
        settings = TetwildSettings(
            epsilon=task.envelope / diagonal,
            edge_length=coarse,
            stop_energy=energy,
            max_passes=task.max_passes,
            threads=context.common.thread_count,
        )
        try:
            with context.step("tetrahedralize"):
                raw = fill_by_tetwild(task.surface, background, settings, task.log, limit, context)
        except StageError as error:
            if attempts.best is None or error.code == ExitCode.INTERRUPTED:
                raise
            context.warn(f"another attempt at better tetrahedra came to nothing: {error.what}")
            break
        well, smallest = attempts.add(raw)
        if well:
            break
        context.verbose(f"stop energy {energy:g}: smallest dihedral angle {smallest:.3g} degrees")


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
    attempts = _Attempts(task.limits, results)
    context.verbose(f"tetrahedralizer {chosen}: {reason}; log: {task.log}")
    task.log.unlink(missing_ok=True)
    limit = TimeLimit.start(task.max_seconds)
    if chosen is Method.HXT:
        try:
            _by_hxt(task, attempts, limit, context)
        except StageError as error:
            if task.method is Method.HXT or error.code == ExitCode.INTERRUPTED or isinstance(error, TimeLimitError):
                raise
            context.warn(f"{error.what}. fTetWild fills the surface instead, which may take hours; {error.next_step}")
            chosen = Method.FTETWILD
            results.update(method=chosen, reason=f"{reason}, but {error.what}")
    if chosen is Method.TETGEN:
        _by_tetgen(task, attempts, limit, context)
    if chosen is Method.FTETWILD:
        _by_tetwild(task, attempts, limit, context)
    context.parameters["method"] = chosen
    assert attempts.best is not None, "an attempt is added or an error raised"
    return attempts.best
