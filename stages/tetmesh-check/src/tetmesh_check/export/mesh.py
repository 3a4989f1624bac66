"""The tetrahedra to be written: their boundary, marks and names, whatever the format."""

from __future__ import annotations

import json
import re
from collections.abc import Iterable
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from tetmesh_check.field_data import add_text
from tetmesh_check.quality import Cells, Labels, Points
from tetmesh_check.regions import CAP, SURFACE

if TYPE_CHECKING:
    import pyvista as pv

NAMES = {SURFACE: "surface", CAP: "cap"}
"""Names of the parts of the boundary in sets and groups."""
RESERVED = ("volume", "nodes", "all")
"""Names of sets that no region may have: all elements in ``inp``, all nodes in ``feb``, everything
in the viewer of CalculiX."""
LONGEST_NAME = 80
"""Characters of the name of a set in CalculiX and of a group in MED."""


@dataclass(frozen=True)
class Materials:
    """The additional data of a mesh of many materials."""

    table: list[dict[str, Any]]
    """Name and labels of each material, by number, as in the surface."""
    regions: dict[int, str]
    """Names of the regions by number, such as every format takes: letters, digits and
    underscores."""
    pairs: dict[int, str]
    """Names of the interfaces by mark, both regions' with ``_to_`` between them."""
    before: Labels
    """Tetrahedron before each triangle of the interfaces, shape ``(k,)``; -1 where the outside
    is."""


def plain_names(names: list[str], taken: Iterable[str] = RESERVED) -> list[str]:
    """Rewrite names with letters, digits and underscores; all differ, ignoring case.

    Parameters
    ----------
    names
        Any names.
    taken
        Names that none of them may have.
    """
    used = {name.lower() for name in taken}
    plain: list[str] = []
    for name in names:
        word = re.sub(r"[^A-Za-z0-9_]+", "_", name).strip("_") or "material"
        unique = word = (word if word[0].isalpha() else f"m_{word}")[:LONGEST_NAME]
        number = 2
        while unique.lower() in used:
            ending = f"_{number}"
            unique, number = word[: LONGEST_NAME - len(ending)] + ending, number + 1
        used.add(unique.lower())
        plain.append(unique)
    return plain


@dataclass(frozen=True)
class Region:
    """A row of the table of regions."""

    region: int
    """Number of its tetrahedra."""
    name: str
    """Name in sets and groups."""
    material: str
    """Name in the volume."""
    labels: list[int]
    """Its labels in the volume; none where they are not known."""

    def words(self) -> str:
        """The row in words, ASCII."""
        return f"region {self.region}: {self.name}, labels {' '.join(map(str, self.labels)) or 'unknown'}"


@dataclass(frozen=True)
class MarkedMesh:
    """Tetrahedra and their boundary, each with its mark."""

    points: Points
    """World positions, mm, shape ``(n, 3)``."""
    tetrahedra: Cells
    """Vertex indices in VTK order, shape ``(m, 4)``."""
    regions: Labels
    """Label of each tetrahedron, shape ``(m,)``; all 1 where no label volume is given. Of many
    materials the number of its own."""
    boundary: Cells
    """Triangles of the boundary, outward, shape ``(k, 3)``. Of many materials those of all
    interfaces."""
    owners: Labels
    """Tetrahedron behind each of them, shape ``(k,)``."""
    marks: Labels
    """:data:`.SURFACE` or :data:`.CAP`, shape ``(k,)``. Of many materials the number of the pair,
    from 1 on."""
    materials: Materials | None = None
    """Data of many materials; ``None`` for one object."""
    middle: Cells | None = None
    """Nodes on the edges of each tetrahedron in VTK order, shape ``(m, 6)``; ``None`` for linear
    tetrahedra."""
    boundary_middle: Cells | None = None
    """Nodes on the edges of each triangle of the boundary, shape ``(k, 3)``."""
    labels: list[int] | None = None
    """Labels of the one region of an object, empty where they are not known; ``None`` where the
    regions are labels or materials."""

    @property
    def elements(self) -> Cells:
        """All nodes of each tetrahedron, shape ``(m, 4)`` or ``(m, 10)``."""
        return self.tetrahedra if self.middle is None else np.column_stack([self.tetrahedra, self.middle])

    @property
    def faces(self) -> Cells:
        """All nodes of each triangle of the boundary, shape ``(k, 3)`` or ``(k, 6)``."""
        return self.boundary if self.boundary_middle is None else np.column_stack([self.boundary, self.boundary_middle])

    @property
    def kinds(self) -> tuple[str, str]:
        """Names of the types of elements and triangles in meshio."""
        return ("tetra", "triangle") if self.middle is None else ("tetra10", "triangle6")

    def region_name(self, label: int) -> str:
        """Return the name of a region in sets and groups."""
        return f"region_{label}".replace("-", "minus_") if self.materials is None else self.materials.regions[label]

    def region_table(self) -> list[Region]:
        """Return the regions, ascending by number."""
        return [self._region(number) for number in np.unique(self.regions).tolist()]

    def _region(self, number: int) -> Region:
        name = self.region_name(number)
        if self.materials is None:
            return Region(number, name, name, [number] if self.labels is None else self.labels)
        entry = self.materials.table[number]
        return Region(number, name, str(entry["name"]), [one["label"] for one in entry.get("labels", [])])

    def mark_name(self, mark: int) -> str:
        """Return the name of a part of the boundary, or of an interface, in sets and groups."""
        return NAMES[mark] if self.materials is None else self.materials.pairs[mark]

    def outermost(self) -> NDArray[np.bool_]:
        """Return whether each triangle lies on the boundary of the whole mesh, shape ``(k,)``."""
        if self.materials is None:
            return np.ones(len(self.boundary), dtype=bool)
        alone: NDArray[np.bool_] = self.materials.before < 0
        return alone

    def point_marks(self) -> Labels:
        """Mark of each point, shape ``(n,)``: 0 inside, else that of its triangles.

        Of many materials it is :data:`.SURFACE` on the boundary of the whole.
        """
        marks = np.zeros(len(self.points), dtype=np.int64)
        if self.materials is not None:
            marks[self.faces[self.outermost()]] = SURFACE
            return marks
        marks[self.faces[self.marks == CAP]] = CAP
        marks[self.faces[self.marks == SURFACE]] = SURFACE
        return marks


def add_regions(dataset: pv.DataSet, mesh: MarkedMesh) -> None:
    """Put the table of regions into the field data, as JSON in the text ``regions``.

    Parameters
    ----------
    dataset
        The data set.
    mesh
        The mesh with the regions.
    """
    add_text(dataset, "regions", json.dumps([asdict(row) for row in mesh.region_table()]))


def unstructured(mesh: MarkedMesh) -> pv.UnstructuredGrid:
    """Turn the mesh into VTK's own.

    Parameters
    ----------
    mesh
        The tetrahedra.
    """
    import pyvista as pv

    kind = pv.CellType.TETRA if mesh.middle is None else pv.CellType.QUADRATIC_TETRA
    return pv.UnstructuredGrid({kind: mesh.elements}, mesh.points)
