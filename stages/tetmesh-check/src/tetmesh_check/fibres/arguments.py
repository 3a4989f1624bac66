"""The options of the fibres, and their combinations."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from tetmesh_check.errors import StageError
from tetmesh_check.parts.algebra import Definition, Members
from tetmesh_check.parts.model import Parts
from tetmesh_check.parts.names import OBJECT_NAMES, Finder, option_name, told_option
from tetmesh_check.surface import Surface

Angles = tuple[float, float]
"""Angles at the endocardium and at the epicardium, degrees."""
DEFAULT_HELIX: Angles = (40.0, -50.0)
DEFAULT_SHEET: Angles = (-65.0, 25.0)
"""Both are the angles of Bayer et al. 2012, for the hearts of dogs."""
DEFAULT_OUTFLOW: Angles = (90.0, 0.0)
"""Helix angles of both outflow tracts in Doste et al. 2019."""
MAX_APEX_DISTANCE = 0.1
"""Maximum distance of ``--apex`` from the boundary of the muscle, relative to the diagonal of the
bounding box of the muscle. The wall of a heart is thinner."""
WHY = "fibres follow from harmonic functions with different values on these boundaries"
"""Why the boundaries matter."""
_SETS = ("endo", "endo_rv", "epi", "base", "outflow")
_NEEDS = {
    "apex_rv": {"endo_rv"},
    "helix_rv": {"endo_rv"},
    "helix_outflow": {"outflow"},
    "helix_outflow_rv": {"endo_rv", "outflow"},
}
"""The boundaries that an option needs."""
_OPTIONS = (*_SETS, "apex", "helix", "sheet", *_NEEDS)
_REQUIRED = ("endo", "epi", "base")


@dataclass(frozen=True)
class FibreArguments:
    """The options of the fibres."""

    material: str
    """Name of the muscle; ``object`` for one object."""
    sets: tuple[Definition, ...]
    """The boundaries ``endo``, ``epi`` and ``base``, and optionally ``endo_rv`` and ``outflow``."""
    apex: tuple[float, float, float] | None
    """A position near the apex, mm, in the world frame of the output; by default, the point of the
    epicardium that is farthest from the base and ``outflow``."""
    helix: Angles
    """Angles from the circumferential direction to the fibre."""
    sheet: Angles
    """Angles from the transmural direction to the sheet."""
    helix_rv: Angles | None = None
    """Helix angles of the right ventricle; by default those of the left one."""
    helix_outflow: Angles = DEFAULT_OUTFLOW
    """Helix angles at ``outflow``."""
    helix_outflow_rv: Angles | None = None
    """Helix angles at ``outflow`` in the right ventricle; by default those of the left one."""
    apex_rv: tuple[float, float, float] | None = None
    """A position near the apex of the right ventricle, mm; by default, the point of the epicardium
    nearest to the point of ``endo_rv`` that is farthest from the base and ``outflow``."""

    def parameters(self) -> dict[str, Any]:
        """Return the parameters with an effect, for the history."""
        sets = {one.name: one.text for one in self.sets}
        given = {**vars(self), "sets": sets}
        return {name: value for name, value in given.items() if _NEEDS.get(name, set()) <= sets.keys()}


def fibre_arguments(given: Mapping[str, Any]) -> FibreArguments | None:
    """Return the options of the fibres, or ``None`` without ``--fibres``.

    Parameters
    ----------
    given
        The values of all options by name.

    Raises
    ------
    StageError
        If an option lacks another one that it needs.
    """
    names = {name: option_name(name) for name in _OPTIONS}
    if given["fibres"] is None:
        if alone := [option for name, option in names.items() if given[name] is not None]:
            raise StageError(
                f"{', '.join(alone)} without --fibres",
                "the muscle that gets the fibres is unknown",
                "add --fibres with the name of the muscle (object for one object), or omit the other options",
            )
        return None
    if missing := [names[name] for name in _REQUIRED if given[name] is None]:
        raise StageError(
            f"--fibres without {', '.join(missing)}",
            "fibres follow from the endocardium, the epicardium and the base of the muscle",
            "add these options with sets such as 'wall/blood', 'wall/outside - caps' and caps",
        )
    for option, boundaries in _NEEDS.items():
        for boundary in sorted(boundaries):
            if given[option] is not None and given[boundary] is None:
                raise StageError(
                    f"{names[option]} without {names[boundary]}",
                    "it has no effect without this boundary",
                    f"add {names[boundary]} with a set, or omit {names[option]}",
                )
    sets = tuple(replace(given[name], name=name) for name in _SETS if given[name] is not None)
    helix, sheet = given["helix"] or DEFAULT_HELIX, given["sheet"] or DEFAULT_SHEET
    outflow = given["helix_outflow"] or DEFAULT_OUTFLOW
    right = (given["helix_rv"], outflow, given["helix_outflow_rv"], given["apex_rv"])
    return FibreArguments(given["fibres"], sets, given["apex"], helix, sheet, *right)


def check_tissue(arguments: FibreArguments | None, names: Sequence[str]) -> None:
    """Refuse fibres in an unknown material.

    Parameters
    ----------
    arguments
        The options, if fibres are made.
    names
        The names of the materials; empty for one object.
    """
    known = names or OBJECT_NAMES[1:]
    if arguments is not None and arguments.material not in known:
        raise StageError(
            f"--fibres {arguments.material}: there is no such material",
            "fibres need the tetrahedra of the muscle",
            f"use one of {', '.join(known)}",
        )


def find_boundaries(arguments: FibreArguments, parts: Parts, surface: Surface) -> dict[str, Members]:
    """Return the parts of each boundary of the muscle, by the name of the boundary.

    Parameters
    ----------
    arguments
        The options.
    parts
        The parts of the surface, and the sets.
    surface
        The surface.

    Raises
    ------
    StageError
        If a name is unknown, a boundary or the apex does not touch the muscle, or two boundaries
        overlap.
    """
    find = Finder(parts.rows, parts.names, parts.unions)
    number = find.material(arguments.material)
    touching = frozenset(row.number for row in parts.rows if number in (row.inside, row.outside))
    names = {row.number: row.name for row in parts.rows}
    known = f"the parts of its boundary are {', '.join(names[mark] for mark in sorted(touching))}"
    found: dict[str, Members] = {}
    for own in arguments.sets:
        option = told_option(own)
        members = find.evaluate(own.node, option) & touching
        # fibres are made before interfaces are split, when the sides are one part
        members |= {row.twin for row in parts.rows if row.twin and row.number in members}
        if not members:
            raise StageError(f"{option} does not touch {arguments.material}", WHY, known)
        for other, taken in found.items():
            if both := members & taken:
                shared = ", ".join(names[mark] for mark in sorted(both))
                told = f"{option} and {option_name(other)} share {shared}"
                raise StageError(told, WHY, f"remove it from one; {known}")
        found[own.name] = members
    own_points = surface.points[np.unique(surface.triangles[np.isin(parts.marks, sorted(touching))])]
    for name in ("apex", "apex_rv"):
        if (apex := getattr(arguments, name)) is None:
            continue
        away = float(np.linalg.norm(surface.shown(own_points) - apex, axis=1).min())
        if away > MAX_APEX_DISTANCE * float(np.linalg.norm(np.ptp(own_points, axis=0))):
            option = option_name(name)
            raise StageError(
                f"{option} {','.join(f'{x:g}' for x in apex)} is {away:.3g} mm from the boundary of "
                f"{arguments.material}",
                "the apex is the point of the muscle nearest to it, which would be another one",
                f"check the position and its frame, or omit {option}",
            )
    return found
