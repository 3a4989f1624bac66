"""Tetrahedra that came out flat are mended where they lie; everything else stays as it is, and what comes out is looked at anew."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tetmesh_check.cavity import Goal, Part, Triangle
from tetmesh_check.checks import Limits
from tetmesh_check.conform import NOBODY, Conformity
from tetmesh_check.forced import ForcedSides, largest_jacobians
from tetmesh_check.quality import Cells, Labels, Points, TetrahedronQuality, signed_tetrahedron_volumes

GOAL_DEGREES = 12.0
"""Smallest dihedral angle that mending aims at where the surface allows it, degrees; --min-dihedral where that is more."""
MOST = 1000
"""Tries to mend a tetrahedron in one round at most, the worst first: one takes 0.1 to 0.3 s. It is a number of tries and no time, so that
the same bytes come out on a slower machine."""
SHARE = 0.01
"""Share of tetrahedra below the goal above which a mesh is not flat here and there, but bad as a whole: it stays as it is."""
ROUNDS = 4
"""How often those left are tried again, while it helps: what was mended beside them may have made room."""
_RINGS = 3
"""Tetrahedra within so many of a bad one are looked at: a cavity begins with those that share a vertex with it, and grows from there."""


def goal_of(limits: Limits) -> Goal:
    """Give what tetrahedra are mended to reach: more than the checks ask for, where the surface allows it."""
    return Goal(max(GOAL_DEGREES, limits.min_dihedral), limits.min_scaled_jacobian, limits.min_dihedral)


@dataclass(frozen=True)
class Mended:
    """A mesh in part made anew."""

    points: Points
    """Positions, mm, shape ``(n, 3)``; the vertices of the surface come first, in their order."""
    tetrahedra: Cells
    """Vertex indices in VTK order, shape ``(m, 4)``."""
    conformity: Conformity
    results: dict[str, Any]
    """For the report: the goal, how many were below it before and are after, and what was done."""


def _faces_by_part(tetrahedra: Cells, parts: Labels) -> set[tuple[int, ...]]:
    """Outward faces that are not between two tetrahedra of one part, from their smallest vertex on, with the part."""
    found: set[tuple[int, ...]] = set()
    for cell, part in zip(tetrahedra.tolist(), parts.tolist(), strict=True):
        for i, j, k in ((0, 2, 1), (0, 1, 3), (1, 2, 3), (0, 3, 2)):
            face = (cell[i], cell[j], cell[k])
            first = face.index(min(face))
            face = face[first:] + face[:first]
            other = (face[0], face[2], face[1], part)
            if other in found:
                found.remove(other)
            else:
                found.add((*face, part))
    return found


def _renewed(found: Conformity, triangles: Cells, gone: Labels, new: Cells, parts: Labels) -> Conformity:
    """What holds of the regions when some tetrahedra give way to others; the new ones are the last."""
    size = len(found.regions)
    kept = np.ones(size, dtype=np.bool_)
    kept[gone] = False
    number = np.where(kept, np.cumsum(kept) - 1, NOBODY)
    material = np.zeros(int(found.parts.max()) + 1, dtype=np.int64)
    material[found.parts] = found.regions
    owner: dict[tuple[int, ...], int] = {}
    first = int(kept.sum())
    for k, (cell, part) in enumerate(zip(np.sort(new, axis=1).tolist(), parts.tolist(), strict=True), start=first):
        for left in range(4):
            owner[(*cell[:left], *cell[left + 1 :], part)] = k

    def of(beside: Labels) -> Labels:
        result = np.where(beside == NOBODY, NOBODY, number[beside])
        for k in np.flatnonzero((beside != NOBODY) & (result == NOBODY)).tolist():
            result[k] = owner[(*sorted(triangles[k].tolist()), int(found.parts[beside[k]]))]
        return result

    return Conformity(
        np.concatenate([found.regions[kept], material[parts]]),
        np.concatenate([found.parts[kept], parts]),
        of(found.behind),
        of(found.before),
        found.missing,
        found.added,
        found.crowded,
        found.undecided,
    )


def mend(
    mesh: tuple[Points, Cells],
    found: Conformity,
    quality: TetrahedronQuality,
    triangles: Cells,
    forced: tuple[ForcedSides, Labels],
    goal: Goal,
) -> Mended | None:
    """Mend the tetrahedra below a goal; ``None`` where there is none, more than a share of them, or none becomes better.

    Parameters
    ----------
    mesh
        Positions, mm, shape ``(n, 3)``, and vertex indices in VTK order, shape ``(m, 4)``.
    found
        How they fit the interfaces: without a fault.
    quality
        Their shapes.
    triangles
        Those of the interfaces, shape ``(k, 3)``.
    forced
        Where the surface forces angles below the goal, and the tetrahedron that stands on each of these sides.
    goal
        What each tetrahedron is to reach.
    """
    points, tetrahedra = mesh
    below = (quality.min_dihedral < goal.min_dihedral) | (quality.scaled_jacobian < goal.min_scaled_jacobian)
    if not 0 < below.sum() <= max(1.0, SHARE * len(tetrahedra)):
        return None
    bounds: dict[tuple[Triangle, int], float] = {}
    for facet, standing, bound in zip(
        forced[0].facet.tolist(), forced[1].tolist(), forced[0].bound.tolist(), strict=True
    ):
        a, b, c = sorted(triangles[facet].tolist())
        bounds[(a, b, c), int(found.parts[standing])] = bound
    possible = largest_jacobians(points, triangles, goal.least)
    needles: dict[Triangle, float] = {}
    for facet in np.flatnonzero(possible < goal.min_scaled_jacobian).tolist():
        a, b, c = sorted(triangles[facet].tolist())
        needles[a, b, c] = float(possible[facet])
    part = _Neighbourhood((points, tetrahedra), found.parts, below, (bounds, needles), goal)
    before = part.count()
    for _ in range(ROUNDS):
        if not part.sweep():
            break
    if not part.moves:
        return None
    gone, new, parts, places = part.changes()
    assert _faces_by_part(tetrahedra[gone], found.parts[gone]) == _faces_by_part(new, parts), "a cavity was left open"
    used = np.concatenate([points, places])
    assert signed_tetrahedron_volumes(used, new).min() > 0.0, "a star is turned round"
    kept = np.ones(len(tetrahedra), dtype=np.bool_)
    kept[gone] = False
    every = np.concatenate([tetrahedra[kept], new])
    conformity = _renewed(found, triangles, gone, new, parts)
    # vertices that no tetrahedron has any more go; those of the surface are in use
    there = np.zeros(len(used), dtype=np.bool_)
    there[every.ravel()] = True
    results = {
        "goal_degrees": goal.min_dihedral,
        "below_before": before,
        "below_after": part.count(),
        "moves": part.moves,
        "tetrahedra_replaced": len(gone),
        "tetrahedra_put": len(new),
        "vertices_put": int(there[len(points) :].sum()),
        "vertices_taken": int((~there[: len(points)]).sum()),
    }
    return Mended(used[there], (np.cumsum(there) - 1)[every], conformity, results)


class _Neighbourhood:
    """What lies round the bad tetrahedra, with numbers of its own; what is forced as for :class:`.Part`, in those of the whole."""

    def __init__(
        self,
        mesh: tuple[Points, Cells],
        parts: Labels,
        bad: NDArray[np.bool_],
        forced: tuple[dict[tuple[Triangle, int], float], dict[Triangle, float]],
        goal: Goal,
    ) -> None:
        points, tetrahedra = mesh
        marked = np.zeros(len(points), dtype=np.bool_)
        marked[tetrahedra[bad].ravel()] = True
        near = marked[tetrahedra].any(axis=1)
        for _ in range(_RINGS - 1):
            marked[tetrahedra[near].ravel()] = True
            near = marked[tetrahedra].any(axis=1)
        self._near = np.flatnonzero(near)
        self._used, local = np.unique(tetrahedra[self._near], return_inverse=True)
        self._total = len(points)
        place = np.full(len(points), NOBODY, dtype=np.int64)
        place[self._used] = np.arange(len(self._used))
        own = {
            ((int(place[a]), int(place[b]), int(place[c])), part): bound
            for ((a, b, c), part), bound in forced[0].items()
        }
        needles = {(int(place[a]), int(place[b]), int(place[c])): bound for (a, b, c), bound in forced[1].items()}
        self._part = Part(points[self._used], local.reshape(-1, 4), parts[self._near], own, goal, needles)

    @property
    def moves(self) -> int:
        """Cavities that were filled anew."""
        return self._part.moves

    def count(self) -> int:
        """Tetrahedra below the goal, or what the surface allows of it."""
        return len(self._part.bad())

    def sweep(self) -> int:
        """Try to mend each bad tetrahedron that is there, the worst first; how many cavities were filled anew."""
        before = self._part.moves
        for number in self._part.bad()[:MOST]:
            if number in self._part.tetrahedra:
                self._part.mend(number)
        return self._part.moves - before

    def changes(self) -> tuple[Labels, Cells, Labels, Points]:
        """Tetrahedra that went, those that came in the numbers of the whole, the parts of these, and the places of new vertices."""
        part, old = self._part, len(self._near)
        gone = [k for k in range(old) if k not in part.tetrahedra]
        new = [k for k in part.tetrahedra if k >= old]
        added = len(part.points) - len(self._used)
        number = np.concatenate([self._used, self._total + np.arange(added)])
        cells = number[np.array([part.tetrahedra[k] for k in new], dtype=np.int64).reshape(-1, 4)]
        places = np.array(part.points[len(self._used) :], dtype=np.float64).reshape(-1, 3)
        return self._near[gone], cells, np.array([part.region[k] for k in new], dtype=np.int64), places
