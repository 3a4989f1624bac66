"""Finds the parts and the sets of a surface, before it is filled."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tetmesh_check.errors import StageError
from tetmesh_check.export.mesh import PARTS, interface_names, plain_names
from tetmesh_check.materials import NOTHING
from tetmesh_check.parts.algebra import Definition
from tetmesh_check.parts.caps import NO_SIDE, SIDES, Border, cap_sides, connected
from tetmesh_check.parts.layers import Layers
from tetmesh_check.parts.model import NamedUnion, Part, Parts, SplitInterface, Wall
from tetmesh_check.parts.names import OBJECT_NAMES, WHY, Finder, refuse_taken, told
from tetmesh_check.parts.splits import Split
from tetmesh_check.parts.tags import Tag
from tetmesh_check.quality import Labels, Points, triangle_quality
from tetmesh_check.regions import SURFACE
from tetmesh_check.surface import Surface


def _interfaces(surface: Surface) -> tuple[Labels, list[Part], list[str]]:
    """Return the interface of each triangle, the interfaces, and the names of the materials."""
    sides = surface.sides
    if sides is None:
        marks = np.full(len(surface.triangles), SURFACE)
        return marks, [Part(SURFACE, PARTS[SURFACE], 1, NOTHING)], list(OBJECT_NAMES)
    pairs, which = sides.pairs()
    named = zip(pairs.tolist(), interface_names(sides), strict=True)
    rows = [Part(number, name, *pair) for number, (pair, name) in enumerate(named, 1)]
    return which + 1, rows, sides.names


def _split(
    rows: list[Part], marks: Labels, own: Labels | NDArray[np.bool_], parent: Part, name: str, **more: Any
) -> None:
    """Make a new part of some triangles of a part."""
    part = replace(parent, number=max(row.number for row in rows) + 1, name=name, **more)
    marks[own] = part.number
    rows.append(part)


def _add_caps(surface: Surface, border: Border | None, marks: Labels, rows: list[Part], names: list[str]) -> None:
    """Make a part of each connected cap of a material on a plane, largest first."""
    if surface.sides is None and surface.cap is None:
        return
    if surface.planes is not None:
        side, planes = surface.planes
    else:
        outer = np.ones(len(marks), dtype=bool) if surface.sides is None else surface.sides.outside == NOTHING
        side, planes = cap_sides(surface.points, surface.triangles, outer, surface.cap, border), list(SIDES)
    own = np.flatnonzero(side != NO_SIDE)
    if not len(own):
        return
    classes = marks[own] * len(planes) + side[own]
    pieces = connected(surface.points, surface.triangles[own], classes)
    areas = np.bincount(pieces, triangle_quality(surface.points, surface.triangles[own]).area)
    first = np.full(len(areas), len(own))
    np.minimum.at(first, pieces, np.arange(len(own)))
    plain = plain_names(names)
    counts: dict[int, int] = {}
    for piece in sorted(range(len(areas)), key=lambda piece: (classes[first[piece]], -areas[piece], first[piece])):
        number, plane = divmod(int(classes[first[piece]]), len(planes))
        parent = next(row for row in rows if row.number == number)
        counts[classes[first[piece]]] = count = counts.get(classes[first[piece]], 0) + 1
        owner = "" if surface.sides is None else f"{plain[parent.inside]}_"
        (name,) = plain_names([f"{owner}cap_{planes[plane]}_{count}"], [*plain, *(row.name for row in rows)])
        _split(rows, marks, own[pieces == piece], parent, name, is_cap=True)


def _inside(tag: Tag, positions: Points) -> NDArray[np.bool_]:
    """Return whether each position is in the shape of a tag."""
    away = positions - np.array(tag.numbers[:3])
    if tag.shape == "ball":
        return np.asarray(np.linalg.norm(away, axis=1) <= tag.numbers[3])
    return np.asarray(away @ np.array(tag.numbers[3:]) >= 0.0)


def _add_tags(surface: Surface, tags: Sequence[Tag], marks: Labels, rows: list[Part], names: list[str]) -> None:
    """Split the parts at the borders of the tags.

    A tag that takes a piece of one part is the name of this piece. The pieces of other tags are
    named ``TAG_on_PART``. A part that lies in a tag as a whole keeps its name.
    """
    centres = surface.shown(surface.points[surface.triangles].mean(axis=1))
    inside = np.zeros((len(marks), len(tags)), dtype=bool)
    find = Finder(rows, names, [])
    for tag, own in zip(tags, inside.T, strict=True):
        members = find.evaluate(tag.node, f"--tag {tag.text}={tag.name}")
        own[:] = np.isin(marks, sorted(members)) & _inside(tag, centres)
        if not own.any():
            box = [surface.shown(surface.points).min(axis=0), surface.shown(surface.points).max(axis=0)]
            low, high = (", ".join(f"{x:.6g}" for x in corner) for corner in box)
            raise StageError(
                f"--tag {tag.text}={tag.name} meets no triangle",
                WHY,
                f"check position and size (the surface extends from ({low}) to ({high}) mm); a tag applies to the outer "
                "boundary unless it names others, as in 'ball:X,Y,Z,RADIUS & a/b=NAME'",
            )
    keys, which = np.unique(np.column_stack([marks, inside]), axis=0, return_inverse=True)
    which, alone = which.ravel(), np.bincount(keys[:, 0])
    by_number = {row.number: row for row in rows}
    for key, (number, *flags) in enumerate(keys.tolist()):
        within = tuple(tag.name for tag, flag in zip(tags, flags, strict=True) if flag)
        parent = by_number[number]
        if alone[number] == 1 or not within:
            rows[rows.index(parent)] = replace(parent, within=within)
            continue
        own = which == key
        is_whole = len(within) == 1 and np.array_equal(inside[:, [tag.name for tag in tags].index(within[0])], own)
        taken = [*plain_names(names), *(tag.name for tag in tags), *(row.name for row in rows)]
        (name,) = within if is_whole else plain_names([f"{'_'.join(within)}_on_{parent.name}"], taken)
        _split(rows, marks, own, parent, name, tags=within, within=within)


def _add_sides(
    rows: list[Part], names: list[str], splits: Sequence[Split], tags: Sequence[Tag]
) -> tuple[list[SplitInterface], list[NamedUnion]]:
    """Add a part for the second side of each part of the split interfaces.

    A part keeps the side of its inside. The other side of ``bone_to_cartilage`` is
    ``cartilage_to_bone``, and that of a tag ``t`` is ``cartilage_t``. A side that tags divide is
    also a set, ``bone_to_cartilage_side``.
    """
    find, plain, found = Finder(rows, names, []), plain_names(names), []
    unions: list[NamedUnion] = []
    taken = [*plain, *(tag.name for tag in tags)]
    for split in splits:
        find.check_interface(split)
        members = find.evaluate(split.node, split.text)
        first: list[int] = []
        second: list[int] = []
        for row in [row for row in rows if row.number in members]:
            if row.twin:
                raise StageError(
                    f"{split.text}: the interface is given twice",
                    "an interface has one width",
                    "give it to only one --split or --gap; --gap also splits",
                )
            inside, outside = plain[row.inside], plain[row.outside]
            name = f"{outside}_to_{inside}" if row.name == f"{inside}_to_{outside}" else f"{outside}_{row.name}"
            (name,) = plain_names([name], [*taken, *(own.name for own in rows)])
            number = rows[-1].number + 1
            twin = replace(row, number=number, name=name, inside=row.outside, outside=row.inside, twin=row.number)
            rows[rows.index(row)] = replace(row, twin=number)
            rows.append(twin)
            for own in (row, twin):
                is_first = own.inside == find.material(split.node.names[0])
                (first if is_first else second).append(own.number)
        ends = [plain[find.material(name) or NOTHING] for name in split.node.names]
        contact = []
        for side, (own_name, other) in zip((first, second), (ends, ends[::-1]), strict=True):
            if len(side) == 1:
                contact.append(next(row.name for row in rows if row.number in side))
                continue
            used = [*taken, *(row.name for row in rows), *(union.name for union in unions)]
            (name,) = plain_names([f"{own_name}_to_{other}_side"], used)
            unions.append(NamedUnion(name, split.text, frozenset(side)))
            contact.append(name)
        found.append(SplitInterface(split, first, second, (contact[0], contact[1])))
    return found, unions


def _find_walls(layers: Sequence[Layers], rows: list[Part], find: Finder) -> list[Wall]:
    """Find the parts of the walls with layers, and the materials that get the layers."""
    walls: list[Wall] = []
    for own in layers:
        members = find.evaluate(own.wall.node, own.told)
        beside = {number for row in rows if row.number in members for number in (row.inside, row.outside)} - {NOTHING}
        names = ", ".join(find.names[number] for number in sorted(beside))
        number = find.material(own.material) if own.material else None
        if not beside:
            raise StageError(f"{own.told}: the wall has no triangle", WHY, "check the expression")
        if own.material and number not in beside:
            raise StageError(
                f"{own.told}: {own.material} is not a material beside this wall",
                "the layers are made from its elements",
                f"use {names.replace(', ', ' or ')}",
            )
        if number is None and len(beside) > 1:
            raise StageError(
                f"{own.told}: the wall has several materials: {names}",
                "the layers can lie in only one of them",
                f"name it, as in '--layers {find.names[max(beside)]}:{own.wall.text}'",
            )
        number = beside.pop() if number is None else number
        touching = frozenset(row.number for row in rows if number in (row.inside, row.outside))
        walls.append(Wall(own, members & touching, number))
    return walls


def find_parts(
    surface: Surface,
    border: Border | None = None,
    tags: Sequence[Tag] = (),
    definitions: Sequence[Definition] = (),
    splits: Sequence[Split] = (),
    layers: Sequence[Layers] = (),
) -> Parts:
    """Find the parts of a surface, and the sets.

    Parameters
    ----------
    surface
        The surface of one object or of many materials.
    border
        The faces of the volume, if known.
    tags, definitions
        The tags, and the expressions of the sets.
    splits
        The interfaces to split.
    layers
        The layers on walls.

    Raises
    ------
    StageError
        If a name is taken or unknown, a tag meets no triangle, a set or a wall is empty, or the
        material of layers is unclear.
    """
    marks, rows, names = _interfaces(surface)
    _add_caps(surface, border, marks, rows, names)
    refuse_taken([*tags, *definitions], [row.name for row in rows], names)
    if tags:
        _add_tags(surface, tags, marks, rows, names)
    used = np.flatnonzero(np.bincount(marks)).tolist()
    rows = sorted((row for row in rows if row.number in used), key=lambda row: row.number)
    sides, unions = _add_sides(rows, names, splits, tags)
    unions += [
        NamedUnion(tag.name, tag.text, frozenset(row.number for row in rows if tag.name in row.within))
        for tag in tags
        if all(row.name != tag.name for row in rows)
    ]
    refuse_taken(definitions, [row.name for row in rows] + [union.name for union in unions], names)
    find = Finder(rows, names, unions)
    for definition in definitions:
        members = find.evaluate(definition.node, told(definition))
        if not members:
            raise StageError(
                f"{told(definition)} is empty",
                WHY,
                f"the parts are {', '.join(row.name for row in rows[:20])}{' ...' if len(rows) > 20 else ''}",
            )
        unions.append(NamedUnion(definition.name, definition.text, members))
    return Parts(marks, rows, names, unions, sides, _find_walls(layers, rows, find))
