"""Fills surfaces of one object and of many materials, and repeats attempts that miss a limit."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from isoparticles import _native
from isoparticles._native import Context, GridField, distances_both_ways

from tetmesh_check.arguments import Arguments, Method
from tetmesh_check.checks import SHAPE, Limits, OfShape, smallest_elsewhere, well_shaped
from tetmesh_check.errors import StageError
from tetmesh_check.forced import ForcedSides
from tetmesh_check.materials import Conformity, Sides, conform
from tetmesh_check.quality import Cells, Points, TetrahedronQuality, tetrahedron_quality
from tetmesh_check.surface import Surface
from tetmesh_check.tets.hxt import fill_by_hxt, hxt_job
from tetmesh_check.tets.tetgen import fill_by_tetgen, regular_volume
from tetmesh_check.tets.tetwild import MAX_BACKGROUND_NODES, fill_by_tetwild, tetwild_job
from tetmesh_check.tets.worker import Raw, Runner, TimeLimitError, UnavailableError
from tetmesh_check.topology import Components, Shells, tetrahedron_boundary

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

_CHANGES = ("below_before", "below_after", "tetrahedra_replaced", "tetrahedra_put", "vertices_taken", "vertices_put")
"""Keys of the counts of mending in the report."""


class Task(NamedTuple):
    """A surface to fill."""

    arguments: Arguments
    surface: Surface
    """A checked surface."""
    parts: Components | Shells
    """The components of the surface of one object, or the volumes of many materials."""
    field: GridField
    """Edge lengths, mm, without ``tet_size_factor``."""
    envelope: float = 0.0
    """For one object: maximum distance of the boundary of fTetWild from the surface, mm."""
    forced: tuple[ForcedSides, ForcedSides] | None = None
    """For many materials: the result of :func:`.find_forced`."""


class Filled(NamedTuple):
    """The tetrahedra."""

    points: Points
    """Positions, mm, shape ``(n, 3)``."""
    tetrahedra: Cells
    """Vertex indices in VTK order, shape ``(m, 4)``."""
    quality: TetrahedronQuality
    """Their measures."""
    forced: OfShape
    """The tetrahedra that the surface of many materials forces below a limit of shape."""
    conformity: Conformity | None
    """How they fit the interfaces between many materials; ``None`` for one object."""


class _Verdict(NamedTuple):
    """The quality of an attempt. Better attempts compare as greater."""

    fitting: int
    """Minus the number of faults at the interfaces of many materials."""
    near: bool
    """Whether the distance between boundary and surface is within the limit."""
    well: bool
    """Whether no limit of shape is missed."""
    scaled_jacobian: float
    """The minimum scaled Jacobian, except where the surface forces it."""


def _measured(task: Task, raw: Raw, found: Conformity | None) -> Filled:
    """Measure the tetrahedra; find those that the surface of many materials forces below a limit.

    At a corner of an edge with the dihedral angle b, whose two faces have the angles s and t, six
    times the volume over the product of the three edges is sin b sin s sin t. So the scaled
    Jacobian is at most sqrt(2) sin b. A tetrahedron on a triangle with a small angle must reach
    :data:`_FAIR` times the largest possible value there.
    """
    quality = tetrahedron_quality(raw.points, raw.tetrahedra)
    forced = {measure: np.zeros(len(raw.tetrahedra), dtype=np.bool_) for measure in SHAPE}
    if task.forced is not None and found is not None:
        (sides, standing), (needles, above) = (own.occupied(found) for own in task.forced)
        forced["min_dihedral"][standing] = True
        flat = np.sqrt(2.0) * np.sin(np.radians(sides.bound)) < task.arguments.limits.min_scaled_jacobian
        forced["scaled_jacobian"][standing[flat]] = True
        fair = quality.scaled_jacobian[above] >= _FAIR * needles.bound
        forced["scaled_jacobian"][above[fair]] = True
    return Filled(raw.points, raw.tetrahedra, quality, forced, found)


class _Attempts:
    """The attempts made so far, for the report, and the best of them."""

    def __init__(self, task: Task, method: Method, reason: str, context: Context) -> None:
        arguments = task.arguments
        self.task, self.context = task, context
        self.best: tuple[_Verdict, Filled, dict[str, Any]] | None = None
        told: dict[str, Any] = {"method": method, "reason": reason, "log": arguments.log.name, "attempts": []}
        self.results = context.results["tetrahedralizer"] = told
        context.verbose(f"tetrahedralizer {method}: {reason}; log: {arguments.log}")
        self.runner = Runner(arguments.log, arguments.max_seconds, context)

    def judge(self, raw: Raw, method: Method, algorithm: str = "") -> _Verdict:
        """Add the tetrahedra of an attempt to the report, and return their verdict."""
        surface, limits, found, distance = self.task.surface, self.task.arguments.limits, None, 0.0
        if surface.sides is not None:
            with self.context.step("find regions"):
                found = conform(len(raw.points), raw.tetrahedra, surface.triangles, surface.sides)
        filled = _measured(self.task, raw, found)
        smallest = smallest_elsewhere(filled.quality, filled.forced)
        entry = raw.summary | {"min_scaled_jacobian": smallest["scaled_jacobian"]}
        if found is None:
            entry |= {"method": method, "orientation_turned": raw.turned}
        else:
            entry |= {"algorithm": algorithm, "faults": found.faults, "min_dihedral": smallest["min_dihedral"]}
        if method == "ftetwild":
            boundary = tetrahedron_boundary(raw.tetrahedra).triangles
            ways = distances_both_ways(raw.points, boundary, surface.points, surface.triangles)
            distance = entry["max_distance"] = max(float(way.max()) for way in ways)
        near, well = distance <= limits.distance(self.task.envelope), well_shaped(filled.quality, limits)
        verdict = _Verdict(-found.faults if found else 0, near, well, smallest["scaled_jacobian"])
        self.results["attempts"].append(entry)
        # of equal attempts, the later one is used: it may be partly mended
        if self.best is None or verdict >= self.best[0]:
            self.best = verdict, filled, entry
        self.context.verbose(
            f"{algorithm or method}: minimum dihedral angle {smallest['min_dihedral']:.3g} degrees, "
            f"{distance:.3g} mm from the surface, {-verdict.fitting} faults at the interfaces"
        )
        return verdict


def mend(raw: Raw | Filled, triangles: Cells, sides: Sides, limits: Limits) -> tuple[Raw, Conformity] | None:
    """Replace the tetrahedra below a limit of shape or below 12 degrees, with the Rust code.

    Parameters
    ----------
    raw
        Positive tetrahedra. The vertices of the surface come first, and are kept.
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
    counts = [*found["below"], *found["changed_tetrahedra"], *found["changed_vertices"]]
    mended = {
        "goal_degrees": found["goal_degrees"],
        "moves": found["moves"],
        **dict(zip(_CHANGES, counts, strict=True)),
    }
    return Raw(found["points"], found["tetrahedra"], {"mended": mended}), Conformity(**found["fit"])


def _choose(arguments: Arguments, surface: Surface) -> tuple[Method, str]:
    """Resolve ``auto``; return the method and the reason."""
    if arguments.method != "auto":
        return arguments.method, f"--method {arguments.method} was given"
    if surface.sides is not None:
        return "hxt", "the surface has several materials, and Gmsh keeps the triangles between them"
    if arguments.order == 2:
        return "hxt", "--order 2 needs the vertices of the surface, which lie on F = 0"
    vertices = len(surface.points)
    method: Method = "ftetwild" if vertices <= MAX_FTETWILD_VERTICES else "hxt"
    side = "within" if method == "ftetwild" else "more than"
    return method, f"the surface has {vertices} vertices, {side} the limit of {MAX_FTETWILD_VERTICES} for fTetWild"


def _by_gmsh(task: Task, attempts: _Attempts, context: Context) -> None:
    """Fill the surface by HXT or, with many materials, by the first algorithm that keeps it."""
    arguments, surface = task.arguments, task.surface
    with context.step("background sizing"):
        job = hxt_job(surface, task.parts.sheets(), task.field, arguments.tet_size_factor)
    several = surface.sides is not None and arguments.method == "auto"
    algorithms = ALGORITHMS if several else ALGORITHMS[:1]
    for algorithm in algorithms:
        try:
            with context.step("tetrahedralize"):
                raw = fill_by_hxt(job | {"algorithm": algorithm}, attempts.runner)
        except StageError as error:
            final = algorithm == algorithms[-1] or isinstance(error, (TimeLimitError, UnavailableError))
            if final and attempts.best is None:
                raise
            attempts.results["attempts"].append({"algorithm": algorithm, "error": error.what})
            continue
        if attempts.judge(raw, "hxt", algorithm).fitting == 0:
            break


def _refuse_undecided(task: Task, filled: Filled) -> None:
    """Refuse tetrahedra without a material."""
    fit = filled.conformity
    if fit is not None and fit.undecided:
        raise StageError(
            f"the material of {fit.undecided} tetrahedra is unknown: the tetrahedralizer lost "
            f"{fit.missing} triangles of the interfaces",
            "without these triangles the materials are not separated; nothing was written",
            f"see its log, {task.arguments.log}, or try another --tet-size-factor",
        )


def _mend(task: Task, attempts: _Attempts, context: Context) -> _Verdict:
    """Mend the tetrahedra of Gmsh that miss a limit of shape or the goal; return the verdict."""
    assert attempts.best is not None, "Gmsh filled the surface"
    verdict, filled, entry = attempts.best
    _refuse_undecided(task, filled)
    surface, fit = task.surface, filled.conformity
    if verdict.fitting or (fit is None and verdict.well):
        return verdict
    inside = np.ones(len(surface.triangles), dtype=np.int64)
    with context.step("mend tetrahedra"):
        sides = surface.sides or Sides(inside, np.zeros_like(inside), [])
        mended = mend(filled, surface.triangles, sides, task.arguments.limits)
    if mended is None:
        return verdict
    if fit is None:
        return max(verdict, attempts.judge(mended[0], "hxt"))
    after = _measured(task, *mended)
    smallest = [smallest_elsewhere(one.quality, one.forced)["min_dihedral"] for one in (filled, after)]
    told = {"min_dihedral_before": smallest[0], "min_dihedral_after": smallest[1]}
    attempts.results["mended"] = mended[0].summary["mended"] | told
    attempts.best = verdict, after, entry
    return verdict


def _by_tetgen(task: Task, attempts: _Attempts, context: Context) -> None:
    with context.step("background sizing"):
        lengths = task.field.background(task.surface.points, task.surface.triangles, MAX_BACKGROUND_NODES)[2]
        largest = task.arguments.tet_size_factor * float(lengths.max())
    context.warn(
        "TetGen grades the tetrahedra by the edges of the surface; from the size field it uses only the maximum volume"
    )
    with context.step("tetrahedralize"):
        raw = fill_by_tetgen(task.surface, task.parts, regular_volume(largest), attempts.runner)
    attempts.judge(raw, "tetgen", "tetgen")


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
        verdict = attempts.judge(raw, "ftetwild")
        if verdict.near and verdict.well:
            break
        (energies if verdict.near else envelopes).pop(0)


def fill(task: Task, context: Context) -> Filled:
    """Fill a surface with the given tetrahedralizer, or with those that ``auto`` selects.

    Parameters
    ----------
    task
        The surface and the settings.
    context
        For messages, times, and ``tetrahedralizer`` in the results.

    Raises
    ------
    StageError
        If no permitted tetrahedralizer fills the surface, or if a tetrahedron has no material.
    """
    arguments, surface = task.arguments, task.surface
    chosen, reason = _choose(arguments, surface)
    attempts = _Attempts(task, chosen, reason, context)
    results = attempts.results
    may_move = surface.sides is None and arguments.method == "auto"
    if chosen == "hxt":
        second = ""
        try:
            _by_gmsh(task, attempts, context)
            verdict = _mend(task, attempts, context)
            small = arguments.order == 1 and len(surface.points) <= MAX_SECOND_TRY_VERTICES
            if may_move and small and not verdict.well:
                smallest = f"minimum scaled Jacobian {verdict.scaled_jacobian:.3g}"
                second = f"the tetrahedra of HXT miss a limit of shape ({smallest})"
                context.info(f"{second}; fTetWild fills the surface as well, which may take minutes")
        except StageError as error:
            if not may_move or isinstance(error, TimeLimitError):
                raise
            second = error.what
            context.warn(
                f"{error.what}. fTetWild fills the surface instead, which takes 13 s for 4,700 vertices and more than "
                f"20 minutes for 50,000; {error.next}"
            )
        if second:
            results["method"] = chosen = "ftetwild"
            results["reason"] = f"{reason}, but {second}"
    if chosen == "tetgen":
        _by_tetgen(task, attempts, context)
    if chosen == "ftetwild":
        _by_tetwild(task, attempts, context)
    assert attempts.best is not None, "an attempt is added or an error raised"
    _, filled, entry = attempts.best
    _refuse_undecided(task, filled)
    results |= {key: entry[key] for key in ("method", "algorithm") if key in entry}
    context.parameters["method"] = results["method"]
    if chosen != results["method"]:
        results["reason"] += ", and the result of fTetWild is not better"
    return filled
