"""Better tetrahedra in a small part of a mesh: cavities are emptied and filled anew by the star of one point.

The star of a point is the tetrahedra from it to the faces of a cavity. The point is a vertex on the cavity (that is a flip, or the removal
of an edge), or a new place within it (a vertex is put there, and those that lay within the cavity go: with the cavity round one vertex this
moves it). A cavity grows by the tetrahedron behind the worst face, like those of Klingner and Shewchuk, "Aggressive tetrahedral mesh
improvement" (2007). Faces between regions bound a cavity and are never crossed, so that they and their vertices stay.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import reduce
from itertools import combinations
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tetmesh_check.quality import OUTWARD_FACES, Cells, Labels, Points, Values

Tetrahedron = tuple[int, int, int, int]
Triangle = tuple[int, int, int]

MARGIN = 0.01
"""How much better than before, as a share of the goal, the worst of a cavity has to become, but where _EASED holds."""
_EASED = 0.05
"""Share by which what fails together has to become less where the worst gains less than MARGIN: a twentieth, so that no move is made for
rounding. The number of tries ends the search."""
_GROWTH = 6
"""Sizes of a cavity that are tried. Of 392 tetrahedra (thorax_labels at 3 mm) one sweep left 139 with this and 10 steps, and 137 with 12 and
14 steps, in more than three times the time."""
_DIRECTIONS = np.array([[x, y, z] for x in (-1, 0, 1) for y in (-1, 0, 1) for z in (-1, 0, 1)], dtype=np.float64)
_DIRECTIONS /= np.maximum(np.linalg.norm(_DIRECTIONS, axis=1, keepdims=True), 1.0)
_CORNERS = ((0, 1, 2), (0, 3, 4), (1, 3, 5), (2, 4, 5))
"""For each vertex, the three of the sides (01, 02, 03, 12, 13, 23) that meet in it."""
_STEPS = 10
"""Steps of the search for a place: the first is a third of the mean edge, and each that finds nothing better halves it."""


class Aims(NamedTuple):
    """What tetrahedra are to reach, of shapes that fit theirs, and the limits of the checks, 0 where the surface allows none to keep them."""

    angle: Values
    """Dihedral angle, degrees."""
    jacobian: Values
    least_angle: Values
    least_jacobian: Values


@dataclass(frozen=True)
class Goal:
    """What a tetrahedron is to reach."""

    min_dihedral: float
    """Degrees."""
    min_scaled_jacobian: float
    least: float = 0.0
    """Degrees that are asked for wherever the surface allows them: the limit of the check."""

    @property
    def plain(self) -> Aims:
        """Where the surface forces nothing."""
        return Aims(
            *(np.array(x) for x in (self.min_dihedral, self.min_scaled_jacobian, self.least, self.min_scaled_jacobian))
        )

    def beside(self, bound: float) -> tuple[float, float, float, float]:
        """What to aim at, and what the checks ask for, where the surface allows no larger dihedral angle: in the order of :class:`Aims`.

        The aim is nine tenths of what is possible at best (there the scaled Jacobian is at most sqrt(2) sin of the angle), or the limit of the
        check if that can be reached.

        Parameters
        ----------
        bound
            The largest possible, degrees.
        """
        least = self.least if bound >= self.least else 0.0
        angle = min(self.min_dihedral, max(_NEARLY * bound, least))
        flat = float(np.sqrt(2.0) * np.sin(np.radians(bound)))
        if flat < self.min_scaled_jacobian:
            return angle, _NEARLY * flat, least, 0.0
        return angle, self.min_scaled_jacobian, least, self.min_scaled_jacobian


_NEARLY = 0.9
"""Share of what is possible at a forced side that is aimed at: all of it would take the one tetrahedron that fills the place exactly."""


def measure(corners: list[Points], aims: Aims) -> Values:
    """How near a tetrahedron comes to its aims, at most 1; below a half where a check would fail, and not above 0 where it is not positive.

    Of dihedral angle and scaled Jacobian the smaller counts. Where an aim cannot be reached, as beside a triangle of a small angle, none is so
    bought with a failed check: what is at its limit is worth a half, and what lies below it less.

    Parameters
    ----------
    corners
        Positions of the four vertices in VTK's order, each of shape ``(3, ...)``.
    aims
        What is worth 1, and the limits.
    """
    a, b, c, d = corners
    sides = [b - a, c - a, d - a, c - b, d - b, d - c]
    lengths = [np.sqrt(_dot(side, side)) for side in sides]
    # outward, opposite to d, c, a and b
    normals = [_cross(sides[i], sides[j]) for i, j in ((1, 0), (0, 2), (3, 4), (2, 1))]
    six = -_dot(normals[0], sides[2])
    with np.errstate(divide="ignore", invalid="ignore"):
        sizes = [np.sqrt(_dot(normal, normal)) for normal in normals]
        cosine = reduce(
            np.maximum, [-_dot(normals[i], normals[j]) / (sizes[i] * sizes[j]) for i, j in combinations(range(4), 2)]
        )
        product = reduce(np.maximum, [lengths[i] * lengths[j] * lengths[k] for i, j, k in _CORNERS])
        jacobian = _staged(np.sqrt(2.0) * six / product, aims.least_jacobian, aims.jacobian)
    angle = _staged(np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))), aims.least_angle, aims.angle)
    found = np.where(six > 0.0, np.minimum(np.minimum(jacobian, angle), 1.0), np.minimum(jacobian, 0.0))
    result: Values = np.nan_to_num(found, nan=-1.0)
    return result


_AT_LIMIT = 0.5
"""What a tetrahedron at a limit of the checks is worth; see :func:`measure`."""


def _staged(found: Values, limit: Values, aim: Values) -> Values:
    """:data:`_AT_LIMIT` at a limit and 1 at an aim, linear between and below."""
    with np.errstate(divide="ignore", invalid="ignore"):
        above = _AT_LIMIT + (1.0 - _AT_LIMIT) * (found - limit) / (aim - limit)
        result: Values = np.where(found < limit, _AT_LIMIT * found / limit, np.where(aim > limit, above, 1.0))
    return result


def _lack(values: Values, bar: float = 1.0) -> float:
    """What some tetrahedra lack together to a bar, so that one bad one does not give way to many that are nearly as bad."""
    return float(np.square(np.maximum(0.0, bar - values)).sum())


def _ascending(face: Triangle) -> Triangle:
    a, b, c = sorted(face)
    return a, b, c


def _dot(u: Points, v: Points) -> Values:
    products: Values = u[0] * v[0] + u[1] * v[1] + u[2] * v[2]
    return products


def _cross(u: Points, v: Points) -> Points:
    shape = np.broadcast_shapes(u.shape, v.shape)
    result = np.empty(shape)
    result[0] = u[1] * v[2] - u[2] * v[1]
    result[1] = u[2] * v[0] - u[0] * v[2]
    result[2] = u[0] * v[1] - u[1] * v[0]
    return result


Filling = tuple[list[int], list[Tetrahedron], Values, NDArray[np.float64] | None]
"""Tetrahedra that go, those that come, their values, and the place of a new vertex."""


class Part:
    """Some of the tetrahedra of a mesh, and what they hang together by.

    Parameters
    ----------
    points
        Positions, mm, shape ``(n, 3)``.
    tetrahedra
        Vertex indices in VTK order, shape ``(m, 4)``.
    regions
        Of each tetrahedron, shape ``(m,)``.
    forced
        The largest dihedral angle possible, degrees, on faces (vertices ascending) in the region on that side, where it is below the goal.
    goal
        What each tetrahedron is to reach.
    needles
        The largest scaled Jacobian possible, on either side, on faces of a small angle (vertices ascending) where it is below the goal.
    """

    def __init__(
        self,
        points: Points,
        tetrahedra: Cells,
        regions: Labels,
        forced: dict[tuple[Triangle, int], float],
        goal: Goal,
        needles: dict[Triangle, float] | None = None,
    ) -> None:
        self.points = [*points]
        self.goal = goal
        self.forced = forced
        self.needles = needles or {}
        self.tetrahedra: dict[int, Tetrahedron] = {}
        self.region: dict[int, int] = {}
        self.value: dict[int, float] = {}
        self.moves = 0
        self._hopeless: set[int] = set()
        self._next = 0
        self._of_vertex: dict[int, set[int]] = {}
        self._of_face: dict[Triangle, list[int]] = {}
        cells = [tuple(cell) for cell in tetrahedra.tolist()]
        values = self._values(cells, regions.tolist())
        for cell, region, value in zip(cells, regions.tolist(), values.tolist(), strict=True):
            self._add(cell, region, value)

    def _add(self, cell: Tetrahedron, region: int, value: float) -> int:
        number = self._next
        self._next += 1
        self.tetrahedra[number], self.region[number], self.value[number] = cell, region, value
        for vertex in cell:
            self._of_vertex.setdefault(vertex, set()).add(number)
        for face in combinations(sorted(cell), 3):
            self._of_face.setdefault(face, []).append(number)
        return number

    def _remove(self, number: int) -> None:
        cell = self.tetrahedra.pop(number)
        del self.region[number], self.value[number]
        for vertex in cell:
            self._of_vertex[vertex].discard(number)
        for face in combinations(sorted(cell), 3):
            self._of_face[face].remove(number)

    def _aims(self, faces: list[list[Triangle]], regions: list[int]) -> Aims:
        """What tetrahedra with these faces are to reach, by tetrahedron."""
        aims = Aims(*(np.full(len(faces), x) for x in self.goal.plain))
        for k, (own, region) in enumerate(zip(faces, regions, strict=True)):
            for face in own:
                bound = self.forced.get((face, region))
                if bound is not None:
                    for values, allowed in zip(aims, self.goal.beside(bound), strict=True):
                        values[k] = min(values[k], allowed)
                possible = self.needles.get(face)
                if possible is not None:
                    aims.jacobian[k], aims.least_jacobian[k] = min(aims.jacobian[k], _NEARLY * possible), 0.0
        return aims

    def _values(self, cells: list[Tetrahedron], regions: list[int]) -> Values:
        corners = np.array([[self.points[v] for v in cell] for cell in cells])
        faces = [list(combinations(sorted(cell), 3)) for cell in cells]
        return measure([corners[:, k].T for k in range(4)], self._aims(faces, regions))

    def bad(self) -> list[int]:
        """Tetrahedra below the goal, or what the surface allows of it; the worst first."""
        return sorted((n for n, value in self.value.items() if value < 1.0), key=lambda n: (self.value[n], n))

    def across(self, number: int, face: Triangle) -> int | None:
        """The tetrahedron of the same region behind a face."""
        for other in self._of_face[_ascending(face)]:
            if other != number and self.region[other] == self.region[number]:
                return other
        return None

    def faces(self, cavity: list[int]) -> list[tuple[Triangle, int]]:
        """Outward faces of a cavity with the tetrahedron that each belongs to."""
        found: dict[Triangle, tuple[Triangle, int] | None] = {}
        for number in cavity:
            cell = self.tetrahedra[number]
            for i, j, k in OUTWARD_FACES:
                face = (cell[i], cell[j], cell[k])
                key = _ascending(face)
                found[key] = None if key in found else (face, number)
        return [entry for entry in found.values() if entry is not None]

    def _round(self, number: int, simplex: tuple[int, ...]) -> list[int]:
        region = self.region[number]
        common = set.intersection(*(self._of_vertex[vertex] for vertex in simplex))
        return sorted(other for other in common if self.region[other] == region)

    def cavities(self, number: int) -> list[list[int]]:
        """Those that a tetrahedron's mending may begin with: round its edges, its faces, its vertices, and itself."""
        cell = tuple(sorted(self.tetrahedra[number]))
        found = [self._round(number, simplex) for size in (2, 3, 1) for simplex in combinations(cell, size)]
        return [cavity for cavity in found if cavity] + [[number]]

    def _flips(self, faces: list[tuple[Triangle, int]], region: int) -> Iterator[tuple[list[Tetrahedron], Values]]:
        """The stars of the vertices of a cavity that are positive."""
        apexes = sorted({vertex for face, _ in faces for vertex in face})
        corners = np.array([[self.points[v] for v in face] for face, _ in faces])
        own = np.array([[apex in face for face, _ in faces] for apex in apexes])
        tips = np.array([self.points[v] for v in apexes])
        values = measure([*(corners[:, k].T[:, None, :] for k in (0, 2, 1)), tips.T[:, :, None]], self.goal.plain)
        values[own] = 1.0
        for k in np.flatnonzero(values.min(axis=1) > 0.0):
            cells = [(face[0], face[2], face[1], apexes[k]) for face, _ in faces if apexes[k] not in face]
            yield cells, self._values(cells, [region] * len(cells))

    def _search(
        self, faces: list[tuple[Triangle, int]], region: int, start: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], Values]:
        """The place whose star has the largest smallest value, by a pattern search, and the values of the star."""
        corners = np.array([[self.points[v] for v in face] for face, _ in faces])
        base = [corners[:, k].T[:, None, :] for k in (0, 2, 1)]
        aims = self._aims([[_ascending(face)] for face, _ in faces], [region] * len(faces))
        step = 0.3 * float(np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).mean())
        place, best, values = start, -np.inf, np.empty(0)
        for _ in range(_STEPS):
            tried = place + step * _DIRECTIONS
            found = measure([*base, tried.T[:, :, None]], aims)
            least = found.min(axis=1)
            k = int(least.argmax())
            if least[k] > best:
                best, place, values = float(least[k]), tried[k], found[k]
                if best >= 1.0:
                    break
            else:
                step *= 0.5
        return place, values

    def mend(self, number: int) -> bool:
        """Fill a cavity round a tetrahedron anew where its worst becomes better; whether one was found.

        Where none does by enough, and some of a cavity fail a check, what fails together is to become less, and the worst no worse. One new
        place often makes two of one beside a short edge or a flat fold of the surface, each better than it but not by much, and leaves
        room for the next.

        Parameters
        ----------
        number
            The tetrahedron.
        """
        if number in self._hopeless:
            return False
        region = self.region[number]
        chosen: tuple[float, Filling] | None = None
        eased: tuple[float, Filling] | None = None
        for cavity in self.cavities(number):
            for filling in self._fillings(cavity, region):
                values, before = filling[2], np.array([self.value[n] for n in filling[0]])
                least = float(values.min())
                if least <= 0.0:
                    continue
                better = least >= before.min() + MARGIN and _lack(values) < _lack(before)
                if better and (chosen is None or least > chosen[0]):
                    chosen = (least, filling)
                failing, was = _lack(values, _AT_LIMIT), _lack(before, _AT_LIMIT)
                if (
                    failing < (1.0 - _EASED) * was
                    and least >= before.min()
                    and (eased is None or was - failing > eased[0])
                ):
                    eased = (was - failing, filling)
            if chosen is not None and chosen[0] >= 1.0:
                break
        chosen = chosen or eased
        if chosen is None:
            # until something changes beside it
            self._hopeless.add(number)
            return False
        cavity, cells, values, place = chosen[1]
        if place is not None:
            self.points.append(place)
        for old in cavity:
            self._remove(old)
        for cell, value in zip(cells, values.tolist(), strict=True):
            self._add(cell, region, value)
        self._hopeless.difference_update(*(self._of_vertex[vertex] for cell in cells for vertex in cell))
        self.moves += 1
        return True

    def _fillings(self, cavity: list[int], region: int) -> Iterator[Filling]:
        """Fillings of a cavity and of what it grows to."""
        faces = self.faces(cavity)
        yield from ((cavity, cells, values, None) for cells, values in self._flips(faces, region))
        apex = len(self.points)
        place = np.mean([self.points[v] for n in cavity for v in self.tetrahedra[n]], axis=0)
        cavity = list(cavity)
        for _ in range(_GROWTH):
            faces = self.faces(cavity)
            cells = [(face[0], face[2], face[1], apex) for face, _ in faces]
            place, values = self._search(faces, region, place)
            yield list(cavity), cells, values, place
            for k in np.argsort(values, kind="stable"):
                if values[k] >= 1.0:
                    return
                other = self.across(faces[k][1], faces[k][0])
                if other is not None:
                    cavity.append(other)
                    break
            else:
                return
