"""The mesh that is written in all formats: elements, boundary, marks and names."""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from itertools import count
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tetmesh_check.materials import NOBODY, Conformity, Sides
from tetmesh_check.quality import Cells, Labels, Points, Values
from tetmesh_check.regions import CAP, SURFACE
from tetmesh_check.space import turned
from tetmesh_check.topology import Boundary

SURFACE_NUMBER = 1000
"""SimNIBS adds this number to that of a tissue for its surface."""
PARTS = {SURFACE: "surface", CAP: "cap"}
"""Parts of the boundary of one object, by mark."""
RESERVED = ("volume", "nodes", "all")
"""Names that no region and no set may have. They are sets of all elements in ``inp``, of all nodes
in ``feb``, and of everything in the viewer of CalculiX."""
_LONGEST_NAME = 80
"""Maximum number of characters in the name of a set in CalculiX and of a group in MED."""


def plain_names(names: list[str], taken: Iterable[str] = ()) -> list[str]:
    """Convert names to letters, digits and underscores. All results differ, even ignoring case.

    Parameters
    ----------
    names
        Any names.
    taken
        Names that are not available, besides those that formats reserve.
    """
    used = {name.lower() for name in (*RESERVED, *taken)}
    plain: list[str] = []
    for name in names:
        word = re.sub(r"[^A-Za-z0-9_]+", "_", name).strip("_") or "material"
        unique = word = (word if word[0].isalpha() else f"m_{word}")[:_LONGEST_NAME]
        number = 2
        while unique.lower() in used:
            ending = f"_{number}"
            unique, number = word[: _LONGEST_NAME - len(ending)] + ending, number + 1
        used.add(unique.lower())
        plain.append(unique)
    return plain


class NamedSet(NamedTuple):
    """The elements of a region, or the faces of a part of the boundary."""

    number: int
    """Number of the region, or mark of the part."""
    name: str
    members: Labels
    """Indices of the elements or faces, ascending."""


class Block(NamedTuple):
    """Elements or faces of one kind."""

    kind: str
    """As in meshio: tetra, tetra10, wedge, triangle, triangle6 or quad."""
    members: Labels
    """Their indices among all elements or faces, ascending."""
    nodes: Cells
    """Their nodes."""


class Card(NamedTuple):
    """The elements of one region that share one material."""

    region: int
    name: str
    members: Labels
    """Indices of the elements, ascending."""
    modulus: float = 1.0
    """Young's modulus, N/mm^2, or in the unit of a file; 1 if it is unknown."""
    density: float = 1.0
    """Density, g/cm^3, or in the unit of a file; 1 if it is unknown."""


def _sets(numbers: Labels, names: Mapping[int, str]) -> list[NamedSet]:
    """Return the sets that are not empty, in the order of the names."""
    sets = [NamedSet(number, name, np.flatnonzero(numbers == number)) for number, name in names.items()]
    return [own for own in sets if len(own.members)]


def _blocks(members: Labels | None, *kinds: tuple[str, Cells]) -> list[Block]:
    """Return elements or faces by kind, without empty kinds; ``None`` selects all."""
    found, first = [], 0
    for kind, nodes in kinds:
        own = np.arange(first, first + len(nodes))
        own = own if members is None else members[(members >= first) & (members < first + len(nodes))]
        if len(own):
            found.append(Block(kind, own, nodes[own - first]))
        first += len(nodes)
    return found


@dataclass(frozen=True)
class MarkedMesh:
    """Tetrahedra, prisms and their boundary, each with its mark."""

    points: Points
    """World positions, shape ``(n, 3)``: in mm and LPS (:attr:`space`), or as written to a file."""
    elements: Cells
    """Nodes of the tetrahedra in VTK order, shape ``(m, 4)``, or ``(m, 10)`` for quadratic ones."""
    regions: Labels
    """Region of each tetrahedron, shape ``(m,)``: its label, 1 without a label volume, or the
    number of its material."""
    faces: Cells
    """Nodes of the triangles of the boundary, outward, shape ``(k, 3)`` or ``(k, 6)``. With many
    materials, the triangles of all interfaces."""
    owners: Labels
    """Tetrahedron behind each triangle, shape ``(k,)``."""
    before: Labels
    """Tetrahedron in front of each triangle, shape ``(k,)``; :data:`.NOBODY` for the outside."""
    marks: Labels
    """Number of the part of each triangle, from 1, shape ``(k,)``."""
    table: list[dict[str, Any]]
    """A row for each region, ascending by number: ``region`` (the number), ``name`` (in sets and
    groups), ``material`` (its name in the volume), and ``labels`` (in the volume, if known)."""
    parts: dict[int, str]
    """Names of the parts of the boundary, or of the interfaces, by mark."""
    caps: frozenset[int] = frozenset()
    """Marks of the parts where the border of the volume cuts the object."""
    unions: dict[str, frozenset[int]] = field(default_factory=dict)
    """Marks of the parts of each further set, by name."""
    contacts: list[tuple[str, str]] = field(default_factory=list)
    """Names of the two parts or unions of each contact pair."""
    materials: list[dict[str, Any]] | None = None
    """Name and labels of each material, by number, as in the surface; ``None`` for one object."""
    space: str | None = None
    """World frame of the files: lps, ras, or ``None`` if the frame of ``points`` is unknown."""
    fields: dict[str, Values] = field(default_factory=dict)
    """More values of each tetrahedron, by name, shape ``(m,)`` or ``(m, 3)``."""
    point_fields: dict[str, Values] = field(default_factory=dict)
    """Values of each point, by name, shape ``(n,)``; empty for quadratic elements."""
    cards: list[Card] = field(default_factory=list)
    """Materials of the regions whose stiffness is known."""
    prisms: Cells = field(default_factory=lambda: np.zeros((0, 6), dtype=np.int64))
    """Nodes of the prisms (:mod:`.prisms`), shape ``(p, 6)``. As elements, they follow the
    tetrahedra: in ``regions``, ``owners`` and ``before``, and in sets."""
    quads: Cells = field(default_factory=lambda: np.zeros((0, 4), dtype=np.int64))
    """Nodes of the quadrilaterals of the boundary, outward, shape ``(q, 4)``. As faces, they follow
    the triangles: in ``owners``, ``before`` and ``marks``, and in sets."""

    @property
    def shown(self) -> Points:
        """The positions in the world frame of the files, mm, shape ``(n, 3)``."""
        return turned(self.points) if self.space == "ras" else self.points

    @property
    def frame(self) -> str:
        """The world frame in words, for comments in the files."""
        return f"world frame {self.space.upper() if self.space else 'of the input'}"

    @property
    def tetrahedra(self) -> Cells:
        """The corners of the tetrahedra, shape ``(m, 4)``."""
        return self.elements[:, :4]

    @property
    def boundary(self) -> Cells:
        """The corners of the triangles of the boundary, shape ``(k, 3)``."""
        return self.faces[:, :3]

    @property
    def is_quadratic(self) -> bool:
        """Whether there are nodes on the edges."""
        return bool(self.elements.shape[1] == 10)

    def elements_of(self, members: Labels | None = None) -> list[Block]:
        """Return elements by kind; all by default."""
        return _blocks(members, ("tetra10" if self.is_quadratic else "tetra", self.elements), ("wedge", self.prisms))

    def faces_of(self, members: Labels | None = None) -> list[Block]:
        """Return faces of the boundary by kind; all by default."""
        return _blocks(members, ("triangle6" if self.is_quadratic else "triangle", self.faces), ("quad", self.quads))

    def nodes_of(self, members: Labels) -> Labels:
        """Return the nodes of faces, ascending."""
        return np.unique(np.concatenate([members[:0], *(block.nodes.ravel() for block in self.faces_of(members))]))

    @property
    def region_sets(self) -> list[NamedSet]:
        """The elements of each region."""
        return _sets(self.regions, {row["region"]: row["name"] for row in self.table})

    @property
    def solids(self) -> list[Card]:
        """The cards, and one more for each region without a card."""
        known = {card.region for card in self.cards}
        return self.cards + [Card(*own) for own in self.region_sets if own.number not in known]

    @property
    def part_sets(self) -> list[NamedSet]:
        """The faces of each part of the boundary, or of each interface."""
        return _sets(self.marks, self.parts)

    @property
    def union_sets(self) -> list[NamedSet]:
        """The faces of each union of parts that is not empty, numbered after the parts."""
        last = max(self.parts, default=0)
        members = [np.flatnonzero(np.isin(self.marks, sorted(marks))) for marks in self.unions.values()]
        named = zip(self.unions, members, strict=True)
        return [NamedSet(last + number, name, own) for number, (name, own) in enumerate(named, 1) if len(own)]

    @property
    def named_sets(self) -> list[NamedSet]:
        """The faces of each part and of each union."""
        return self.part_sets + self.union_sets

    def unions_of(self, mark: int) -> list[str]:
        """Return the names of the unions that contain a part.

        Parameters
        ----------
        mark
            The mark of the part.
        """
        return [name for name, marks in self.unions.items() if mark in marks]

    @property
    def is_cap(self) -> NDArray[np.bool_]:
        """Whether each face belongs to a cap."""
        return np.isin(self.marks, sorted(self.caps))

    @property
    def outermost(self) -> NDArray[np.bool_]:
        """Whether each face lies on the boundary of the whole mesh."""
        alone: NDArray[np.bool_] = self.before == NOBODY
        return alone

    def region_text(self) -> str:
        """Return the table of regions as JSON."""
        return json.dumps(self.table)

    def point_marks(self) -> Labels:
        """Return the mark of each point, shape ``(n,)``: 0 inside, else that of its faces.

        The mark is :data:`.CAP` on caps and :data:`.SURFACE` on the rest of the boundary of the
        whole mesh. A point with faces of both has :data:`.SURFACE`.
        """
        marks = np.zeros(len(self.points), dtype=np.int64)
        is_cap = self.is_cap
        marks[self.nodes_of(np.flatnonzero(is_cap))] = CAP
        marks[self.nodes_of(np.flatnonzero(self.outermost & ~is_cap))] = SURFACE
        return marks


def numbered_sets(mesh: MarkedMesh, largest: int = 2**31 - 1) -> tuple[list[NamedSet], list[NamedSet], list[NamedSet]]:
    """Return the regions, the parts of the boundary and the unions with unique, positive numbers.

    A region with a number below 1 or above ``largest`` gets a number above those of the other
    regions: Gmsh, LS-DYNA and Nastran require positive ones. GetDP groups and Nastran properties
    need different numbers for regions and surfaces. So the number of a part is its mark plus the
    first power of ten above all regions: with only region 1, ``surface`` is 11. Unions follow.
    Marks above :data:`SURFACE_NUMBER` are kept.
    """
    regions, parts = mesh.region_sets, mesh.part_sets
    kept = {own.number for own in regions if 1 <= own.number <= largest}
    free = count(1 + max(kept, default=0))
    regions = [own if own.number in kept else own._replace(number=next(free)) for own in regions]
    last = max((own.number for own in regions), default=0)
    above = 0 if all(own.number > SURFACE_NUMBER for own in parts) else 10 ** len(str(last))
    parts, unions = ([own._replace(number=above + own.number) for own in sets] for sets in (parts, mesh.union_sets))
    return regions, parts, unions


def object_mesh(
    points: Points,
    tetrahedra: Cells,
    regions: Labels,
    boundary: Boundary,
    marks: Labels,
    labels: list[int] | None = None,
) -> MarkedMesh:
    """Name the regions and the parts of the boundary of one object.

    Parameters
    ----------
    points, tetrahedra
        Its mesh.
    regions
        Label of each tetrahedron.
    boundary
        The boundary of the tetrahedra.
    marks
        :data:`.SURFACE` or :data:`.CAP` for each triangle.
    labels
        Labels of the single region, empty if unknown; ``None`` if the regions are labels.
    """
    numbers = np.unique(regions).tolist()
    names = [f"region_{number}".replace("-", "minus_") for number in numbers]
    table = [
        {"region": number, "name": name, "material": name, "labels": [number] if labels is None else labels}
        for number, name in zip(numbers, names, strict=True)
    ]
    before = np.full(len(marks), NOBODY)
    return MarkedMesh(
        points, tetrahedra, regions, boundary.triangles, boundary.owners, before, marks, table, PARTS, frozenset([CAP])
    )


def interface_names(sides: Sides) -> list[str]:
    """Return the names of the interfaces between materials, in the order of their marks."""
    names = plain_names(sides.names)
    return plain_names([f"{names[a]}_to_{names[b]}" for a, b in sides.pairs()[0].tolist()], names)


def materials_mesh(points: Points, tetrahedra: Cells, found: Conformity, triangles: Cells, sides: Sides) -> MarkedMesh:
    """Name the regions and the interfaces of many materials.

    Parameters
    ----------
    points, tetrahedra
        The mesh.
    found
        Its conformity with the interfaces.
    triangles
        Triangles of the interfaces.
    sides
        Their materials.
    """
    names = plain_names(sides.names)
    _, which = sides.pairs()
    table = [
        {
            "region": number,
            "name": names[number],
            "material": sides.names[number],
            "labels": [one["label"] for one in sides.table[number].get("labels", [])],
        }
        for number in sides.present
    ]
    parts = dict(enumerate(interface_names(sides), 1))
    return MarkedMesh(
        points, tetrahedra, found.regions, triangles, found.behind, found.before, which + 1, table, parts,
        materials=sides.table,
    )  # fmt: skip
