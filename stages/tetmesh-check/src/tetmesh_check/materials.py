"""The materials on both sides of each triangle, their names, and the material of each tetrahedron.

A surface of many materials is a complex: each triangle lies between two materials, and triangles
meet along junction edges and share their vertices. Material 0 is the outside. A triangle is
counter-clockwise as seen from the material with the lower number; the other one is called its
inside.

The tetrahedralizer's own volumes are not used. The Rust code finds the materials of tetrahedra from
connectivity alone: tetrahedra are connected through faces that are not triangles of an interface,
and each triangle states the materials on its two sides.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pyvista as pv
from isoparticles import _native

from tetmesh_check.datasets import text_of
from tetmesh_check.errors import refuse_file
from tetmesh_check.quality import Cells, Labels
from tetmesh_check.topology import pairs_of

INSIDE, OUTSIDE = "material_inside", "material_outside"
"""Cell arrays of a surface of many materials."""
CAP = "cap"
"""Cell array with the number of the plane at which a material ends, from 1; 0 elsewhere."""
NOTHING = 0
"""Number of the outside in tables of materials."""
NOBODY = -1
"""Index that stands for no tetrahedron."""


@dataclass(frozen=True)
class Sides:
    """The two materials that each triangle of a surface lies between."""

    inside: Labels
    """Number of the material behind each triangle, the higher of the two, shape ``(m,)``."""
    outside: Labels
    """Number of the material in front of each triangle, shape ``(m,)``; 0 for the outside."""
    table: list[dict[str, Any]]
    """A row for each material by number: ``name`` and, if known, ``labels``."""

    @property
    def names(self) -> list[str]:
        """Names by number, ``outside`` first."""
        return [str(entry["name"]) for entry in self.table]

    @property
    def present(self) -> list[int]:
        """Numbers of the materials that have triangles, ascending, without the outside."""
        return sorted({*np.unique(self.inside).tolist(), *np.unique(self.outside).tolist()} - {NOTHING})

    def pairs(self) -> tuple[Cells, Labels]:
        """Return the pairs ``(inside, outside)`` that touch, and the pair of each triangle."""
        return pairs_of(self.inside, self.outside)

    def pair_name(self, pair: tuple[int, int]) -> str:
        """Return the name of an interface: both names, the inside first.

        Parameters
        ----------
        pair
            Numbers of the inside and of the outside.
        """
        return f"{self.names[pair[0]]}/{self.names[pair[1]]}"


class Planes(NamedTuple):
    """The planes at which materials end (``distfield --border flat``)."""

    of_triangles: Labels
    """Number of the plane in which each triangle lies, from 0; -1 elsewhere. Shape ``(m,)``."""
    names: list[str]
    """Names of the planes by number."""


def read_planes(surface: pv.PolyData) -> Planes | None:
    """Return the planes at which the materials of a surface end; ``None`` if there are none.

    Parameters
    ----------
    surface
        The surface of many materials, as read.
    """
    if CAP not in surface.cell_data:
        return None
    numbers = np.asarray(surface.cell_data[CAP]).ravel().astype(np.int64) - 1
    try:
        names = [str(name) for name in json.loads(text_of(surface, "meta") or "{}").get("caps", [])]
    except (ValueError, TypeError, AttributeError):
        names = []
    unnamed = range(len(names), int(numbers.max(initial=-1)) + 1)
    return Planes(numbers, names + [str(number + 1) for number in unnamed])


def materials_in_front(sides: Sides, planes: Planes | None) -> Labels:
    """Return the material in front of each triangle, by its number in the distance field.

    In the field, the space beyond each plane is a material with a number after those of the
    surface.

    Parameters
    ----------
    sides, planes
        The materials of the surface, and the planes at which they end.
    """
    if planes is None:
        return sides.outside
    return np.where(planes.of_triangles < 0, sides.outside, len(sides.table) + planes.of_triangles)


def _is_of_one(surface: pv.PolyData) -> bool:
    """Return whether the metadata of a surface name the only material inside it."""
    try:
        return "material" in json.loads(text_of(surface, "meta") or "{}")
    except (ValueError, TypeError):
        return False


def read_sides(path: Path, surface: pv.PolyData) -> Sides | None:
    """Return the materials of a surface; ``None`` for that of one object or of one material.

    A surface of one material of several (``reconstruct --each``) has the text ``material`` in its
    metadata, and only the array of the materials outside.

    Parameters
    ----------
    path
        The file, for the messages.
    surface
        The file as read.

    Raises
    ------
    StageError
        If the arrays or the table of materials (field data ``meta``, ``materials``) are incomplete
        or do not fit together.
    """
    refuse = partial(refuse_file, path, remedy="give the surface that reconstruct wrote for many materials")
    arrays = {name: np.asarray(surface.cell_data[name]) for name in (INSIDE, OUTSIDE) if name in surface.cell_data}
    if not arrays or (list(arrays) == [OUTSIDE] and _is_of_one(surface)):
        return None
    if len(arrays) == 1:
        between = "a triangle lies between two materials"
        refuse(f"has only the cell array '{next(iter(arrays))}' of '{INSIDE}' and '{OUTSIDE}'", between)
    for name, values in arrays.items():
        if values.ndim != 1 or not np.issubdtype(values.dtype, np.integer) or (values < 0).any():
            whole = f"the cell array '{name}' does not have one whole number from 0 for each triangle"
            refuse(whole, "it is the number of a material")
    inside, outside = (values.astype(np.int64) for values in arrays.values())
    meaning = "it says what the numbers of the materials stand for"
    try:
        table = json.loads(text_of(surface, "meta") or "{}")["materials"]
        names = [entry["name"] for entry in table]
        named = len(set(names)) == len(names) and all(isinstance(name, str) for name in names)
    except (ValueError, KeyError, TypeError):
        named = False
    if not named:
        missing = "has no table of materials ('materials' of the text 'meta' in its field data), or two of one name"
        refuse(missing, meaning)
    if inside.max(initial=0) >= len(table):
        known = f"has a triangle of material {int(inside.max())}; the table contains 0 to {len(table) - 1}"
        refuse(known, meaning)
    wrong = np.flatnonzero(inside <= outside)
    if len(wrong):
        refuse(
            f"the inside of {len(wrong)} triangles is not the higher of their two materials, "
            f"the first is number {int(wrong[0])}",
            "which side of a triangle is which would be unclear",
        )
    return Sides(inside, outside, table)


class Conformity(NamedTuple):
    """How tetrahedra fit the interfaces between materials."""

    regions: Labels
    """Material of each tetrahedron, shape ``(m,)``; 0 if the triangles state none or several."""
    parts: Labels
    """Part of each tetrahedron: connected through faces that are not triangles, shape ``(m,)``."""
    behind: Labels
    """Tetrahedron behind each triangle of the interfaces, or :data:`NOBODY`, shape ``(k,)``."""
    before: Labels
    """Tetrahedron in front of each triangle, or :data:`NOBODY`, shape ``(k,)``."""
    missing: int
    """Triangles that are not a face of a tetrahedron of the right material on each side."""
    added: int
    """Faces of only one tetrahedron that are not triangles of the interfaces."""
    crowded: int
    """Faces of more than two tetrahedra."""
    undecided: int
    """Tetrahedra without a material."""

    @property
    def faults(self) -> int:
        """Number of all faults; 0 for a conforming mesh of the regions."""
        return self.missing + self.added + self.crowded + self.undecided


def conform(vertices: int, tetrahedra: Cells, triangles: Cells, sides: Sides) -> Conformity:
    """Find the material of each tetrahedron, and count what does not fit.

    Parameters
    ----------
    vertices
        Number of vertices.
    tetrahedra
        Vertex indices in VTK order, positive, shape ``(m, 4)``.
    triangles
        Triangles of the interfaces, with the same vertex indices and without duplicates, shape
        ``(k, 3)``.
    sides
        Their materials.
    """
    return Conformity(**_native.conform(vertices, tetrahedra, triangles, sides.inside, sides.outside))
