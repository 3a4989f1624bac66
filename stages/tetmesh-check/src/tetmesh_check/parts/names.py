"""Names in expressions: what they stand for, and refusals of unknown and taken names."""

from __future__ import annotations

import re
from collections.abc import Sequence
from difflib import get_close_matches
from typing import NoReturn

from tetmesh_check.errors import StageError
from tetmesh_check.export.mesh import RESERVED, plain_names
from tetmesh_check.materials import NOTHING
from tetmesh_check.parts.algebra import EVERYTHING, Definition, Members, Node, Operand
from tetmesh_check.parts.model import NamedUnion, Part
from tetmesh_check.parts.splits import Split
from tetmesh_check.parts.tags import Tag

OBJECT_NAMES = ("outside", "object")
"""Names of the two materials of one object in expressions."""
WHY = "a boundary condition or contact there would apply to nothing or to the wrong triangles"
"""Why an unknown name or an empty set matters."""
_KEYWORDS = ("caps", "outside", "object", *RESERVED)
_ARRAYS = (
    "mark", "pair", "points", "triangles", "elements", "region", "region_before", "boundary", "tetrahedron", "point",
    "apicobasal", "transmural", "rotational", "rotational_rv", "transventricular",
)  # fmt: skip
"""Arrays of XDMF and VTK files, beside which sets have arrays."""


class Finder:
    """Finds the members of operands by name."""

    def __init__(self, rows: list[Part], names: list[str], unions: list[NamedUnion]) -> None:
        self.rows, self.names, self.plain, self.unions = rows, names, plain_names(names), unions

    def material(self, name: str) -> int | None:
        """Return the number of a material, by its name or its name in groups."""
        return next((own.index(name) for own in (self.names, self.plain) if name in own), None)

    def evaluate(self, node: Node, where: str) -> Members:
        """Return the members of an expression.

        Parameters
        ----------
        node
            The expression.
        where
            Where it stands, for messages.

        Raises
        ------
        StageError
            If a name is unknown.
        """
        return node.evaluate(lambda operand: (self._pair if len(operand) == 2 else self._named)(operand, where))

    def _named(self, operand: Operand, where: str) -> Members:
        (name,) = operand
        known: dict[str, Members] = {
            EVERYTHING: frozenset(row.number for row in self.rows),
            "caps": frozenset(row.number for row in self.rows if row.is_cap),
            **{row.name: frozenset([row.number]) for row in self.rows},
            **{union.name: union.members for union in self.unions},
        }
        if name in known:
            return known[name]
        if (number := self.material(name)) is None:
            self.refuse(name, where, [*known, *self.names], "is not the name of a part, a material, a tag or a set")
        # a side of a split interface belongs to its inside only
        own = [row for row in self.rows if number == row.inside or (number == row.outside and not row.twin)]
        return frozenset(row.number for row in own)

    def _pair(self, operand: Operand, where: str) -> Members:
        numbers = [self.material(name) for name in operand]
        for name, number in zip(operand, numbers, strict=True):
            if number is None:
                self.refuse(name, where, self.names, "is not a material")
        found = frozenset(row.number for row in self.rows if {row.inside, row.outside} == set(numbers))
        if not found:
            pairs = list(dict.fromkeys((row.inside, row.outside) for row in self.rows))
            # an interface of two materials is not on the outside
            pairs = [pair for pair in pairs if NOTHING in numbers or NOTHING not in pair] or pairs
            touching = [f"{self.names[inside]}/{self.names[outside]}" for inside, outside in pairs]
            self.refuse("/".join(operand), where, touching, "is not an interface")
        return found

    def check_interface(self, split: Split) -> None:
        """Refuse an interface to split that is not between two materials."""
        if self.names == list(OBJECT_NAMES):
            raise StageError(
                f"{split.text}: the surface is that of one object",
                "an interface lies between two materials",
                "mesh the materials together (MATERIALS=bone:1,cartilage:2), or omit --split and --gap",
            )
        for name in split.node.names:
            if self.material(name) in (None, NOTHING):
                self.refuse(name, split.text, self.names[1:], "is not a material")

    def refuse(self, name: str, where: str, known: list[str], what: str) -> NoReturn:
        """Refuse a name; suggest similar known ones."""
        near = get_close_matches(name, known, n=3) or known
        raise StageError(
            f"{where}: '{name}' {what}",
            WHY,
            f"use one of {', '.join(near[:20])}{' ...' if len(near) > 20 else ''}",
        )


def told(definition: Definition) -> str:
    """Return a definition for messages."""
    return f"set '{definition.name} = {definition.text}'"


def option_name(name: str) -> str:
    """Return an option from the name of its value."""
    return f"--{name.replace('_', '-')}"


def told_option(expression: Definition) -> str:
    """Return an expression for messages, where an option gives it."""
    return f"{option_name(expression.name)} {expression.text}"


def refuse_taken(given: Sequence[Tag | Definition], taken: Sequence[str], names: Sequence[str]) -> None:
    """Refuse names of tags and sets that are taken by parts, materials, words or each other."""
    used = {name.lower() for name in (*_KEYWORDS, *_ARRAYS, *taken, *names, *plain_names(list(names)))}
    for one in given:
        if one.name.lower() in used or re.fullmatch(r"region_(minus_)?\d+", one.name.lower()):
            raise StageError(
                f"the name '{one.name}' of a {'tag' if isinstance(one, Tag) else 'set'} is already taken",
                "two groups of one name cannot be told apart in the exported files",
                "choose another name; parts, materials, tags and sets share their names, and "
                f"{', '.join((*_KEYWORDS, *_ARRAYS))} are reserved",
            )
        used.add(one.name.lower())


def check_early(
    tags: Sequence[Tag],
    definitions: Sequence[Definition],
    names: Sequence[str] | None,
    expressions: Sequence[Definition] = (),
    splits: Sequence[Split] = (),
) -> None:
    """Refuse what can be refused before there is a surface: taken names and unknown materials.

    Parameters
    ----------
    tags, definitions
        The tags and sets.
    names
        Names of the materials, ``outside`` first; empty for one object, ``None`` if unknown.
    expressions
        The expressions of options, by the name of the option.
    splits
        The interfaces to split.
    """
    refuse_taken([*tags, *definitions], [], names or [])
    if names is None:
        return
    finder = Finder([], list(names or OBJECT_NAMES), [])
    for split in splits:
        finder.check_interface(split)
    where = [*map(told, definitions), *map(told_option, expressions)]
    for definition, place in zip((*definitions, *expressions), where, strict=True):
        for name in (name for own in definition.node.leaves() if len(own) == 2 for name in own):
            if finder.material(name) is None:
                finder.refuse(name, place, finder.names, "is not a material")
