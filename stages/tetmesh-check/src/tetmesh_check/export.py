"""The tetrahedra for other programs: Abaqus and CalculiX, Gmsh, MED, XDMF, VTK, FEBio, openCARP, SimVascular; and their boundary alone."""

from __future__ import annotations

import csv
import io
import json
import re
from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from tetmesh_check.field_data import add_text
from tetmesh_check.files import write_atomically
from tetmesh_check.materials import NOTHING
from tetmesh_check.med import write_med
from tetmesh_check.msh import write_msh, write_msh2
from tetmesh_check.polydata import to_polydata
from tetmesh_check.quality import Cells, Labels, Points
from tetmesh_check.regions import CAP, SURFACE
from tetmesh_check.xdmf import elements, facets, write_description, write_numbers

if TYPE_CHECKING:
    import pyvista as pv

NAMES = {SURFACE: "surface", CAP: "cap"}
"""What the parts of the boundary are called in sets and groups."""
RESERVED = ("volume", "nodes", "all")
"""Names of sets that are no region's: all elements in ``inp``, all nodes in ``feb``, everything in
the viewer of CalculiX."""
LONGEST_NAME = 80
"""Characters of the name of a set in CalculiX and of a group in MED."""


@dataclass(frozen=True)
class Materials:
    """What a mesh of many materials has beside one of one object."""

    table: list[dict[str, Any]]
    """What each number stands for, as the surface has it."""
    regions: dict[int, str]
    """Names of the regions by number, such as every format takes: letters, digits and underscores."""
    pairs: dict[int, str]
    """Names of the interfaces by mark, both regions' with ``_to_`` between them."""
    before: Labels
    """Tetrahedron before each triangle of the interfaces, shape ``(k,)``; -1 where the outside is."""


def plain_names(names: list[str], taken: Iterable[str] = RESERVED) -> list[str]:
    """Write names with letters, digits and underscores alone, no two the same but for the case of letters.

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
    """Label of each tetrahedron, shape ``(m,)``; all 1 where no label volume is given. Of many materials the number of its own."""
    boundary: Cells
    """Triangles of the boundary, outward, shape ``(k, 3)``. Of many materials those of all interfaces."""
    owners: Labels
    """Tetrahedron behind each of them, shape ``(k,)``."""
    marks: Labels
    """:data:`.SURFACE` or :data:`.CAP`, shape ``(k,)``. Of many materials the number of the pair, from 1 on."""
    materials: Materials | None = None
    """What is known of many materials; ``None`` for one object."""
    middle: Cells | None = None
    """Nodes amid the edges of each tetrahedron in VTK order, shape ``(m, 6)``; ``None`` where all edges are straight."""
    boundary_middle: Cells | None = None
    """Nodes amid the edges of each triangle of the boundary, shape ``(k, 3)``."""
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
        """What meshio calls the elements and the triangles."""
        return ("tetra", "triangle") if self.middle is None else ("tetra10", "triangle6")

    def region_name(self, label: int) -> str:
        """What a region is called in sets and groups."""
        return f"region_{label}".replace("-", "minus_") if self.materials is None else self.materials.regions[label]

    def region_table(self) -> list[Region]:
        """What each number of a region stands for, ascending."""
        return [self._region(number) for number in np.unique(self.regions).tolist()]

    def _region(self, number: int) -> Region:
        name = self.region_name(number)
        if self.materials is None:
            return Region(number, name, name, [number] if self.labels is None else self.labels)
        entry = self.materials.table[number]
        return Region(number, name, str(entry["name"]), [one["label"] for one in entry.get("labels", [])])

    def mark_name(self, mark: int) -> str:
        """What a part of the boundary, or an interface, is called in sets and groups."""
        return NAMES[mark] if self.materials is None else self.materials.pairs[mark]

    def outermost(self) -> NDArray[np.bool_]:
        """Which triangles lie on the boundary of the whole, shape ``(k,)``."""
        if self.materials is None:
            return np.ones(len(self.boundary), dtype=bool)
        alone: NDArray[np.bool_] = self.materials.before < 0
        return alone

    def point_marks(self) -> Labels:
        """Mark of each point, shape ``(n,)``: 0 inside, else that of its triangles, :data:`.CAP` only where all are.

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
        Where it goes.
    mesh
        Whose regions they are.
    """
    add_text(dataset, "regions", json.dumps([asdict(row) for row in mesh.region_table()]))


def _regions_csv(mesh: MarkedMesh, path: Path) -> None:
    """The table of regions, a row a region; several labels are separated by spaces."""
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(["region", "name", "material", "labels"])
        for row in mesh.region_table():
            writer.writerow([row.region, row.name, row.material, " ".join(map(str, row.labels))])


def _rows(values: Points | Cells | Labels, form: str) -> str:
    """Numbers as text, a row a line."""
    text = io.StringIO()
    np.savetxt(text, values, form)
    return text.getvalue()


def _numbered(first: int, rows: Cells, separator: str = ", ") -> str:
    """Rows of whole numbers, each behind its own number, from ``first`` on."""
    numbers = np.arange(first, first + len(rows))
    return _rows(np.column_stack([numbers, rows]), separator.join(["%d"] * (rows.shape[1] + 1)))


def _list(members: Labels) -> str:
    """Members of a set, sixteen a line as Abaqus allows."""
    rows = [", ".join(map(str, members[at : at + 16].tolist())) for at in range(0, len(members), 16)]
    return ",\n".join(rows) + "\n"


_ABAQUS_FACE = np.array([3, 4, 2, 1])
"""Number of the face of a C3D4 that lies opposite its first, second, ... node: S1 is 1-2-3, S2 1-4-2, S3 2-4-3, S4 3-4-1."""


def _abaqus(mesh: MarkedMesh, path: Path) -> None:
    """C3D4 or C3D10 elements; ELSET of each region; NSET and SURFACE of each part of the boundary (a point on its rim is in both sets).

    The surface of an interface consists of faces of the elements behind it.
    """
    kind = "C3D4" if mesh.middle is None else "C3D10"
    regions = "".join(f"** {row.words()}\n" for row in mesh.region_table())
    parts = [
        f"*HEADING\nisoparticles\n{regions}*NODE\n{_abaqus_nodes(mesh.points)}*ELEMENT, TYPE={kind}, ELSET=VOLUME\n"
    ]
    parts.append(_numbered(1, mesh.elements + 1))
    for label in np.unique(mesh.regions).tolist():
        parts.append(
            f"*ELSET, ELSET={mesh.region_name(label).upper()}\n{_list(np.flatnonzero(mesh.regions == label) + 1)}"
        )
    away = (mesh.tetrahedra[mesh.owners][:, :, None] != mesh.boundary[:, None, :]).all(axis=2)
    faces = _ABAQUS_FACE[away.argmax(axis=1)]
    for mark in np.unique(mesh.marks).tolist():
        own, name = mesh.marks == mark, mesh.mark_name(mark).upper()
        parts.append(f"*NSET, NSET={name}\n{_list(np.unique(mesh.faces[own]) + 1)}")
        pairs = np.column_stack([mesh.owners[own] + 1, faces[own]])
        parts.append(f"*SURFACE, NAME={name}, TYPE=ELEMENT\n{_rows(pairs, '%d, S%d')}")
    path.write_text("".join(parts), encoding="ascii")


def _abaqus_nodes(points: Points) -> str:
    # a field has 20 characters, and CalculiX refuses more: 13 digits with both signs and an exponent are 19
    return _rows(np.column_stack([np.arange(1, len(points) + 1), points]), "%d, %.13g, %.13g, %.13g")


def _febio(mesh: MarkedMesh, path: Path) -> None:
    """FEBio 4.0: tet4 or tet10 elements and a material for each region, to be replaced; a surface for each part of the boundary."""

    def elements(tag: str, first: int, cells: Cells) -> str:
        columns = ",".join(["%d"] * cells.shape[1])
        rows = np.column_stack([np.arange(first, first + len(cells)), cells + 1])
        return _rows(rows, f'<{tag} id="%d">{columns}</{tag}>')

    tetrahedron, triangle = ("tet4", "tri3") if mesh.middle is None else ("tet10", "tri6")
    labels = np.unique(mesh.regions).tolist()
    nodes = np.column_stack([np.arange(1, len(mesh.points) + 1), mesh.points])
    materials = "".join(
        f'<material id="{number}" name="{mesh.region_name(label)}" type="neo-Hookean">'
        "<density>1</density><E>1</E><v>0.3</v></material>\n"
        for number, label in enumerate(labels, 1)
    )
    parts, first = [], 1
    for label in labels:
        own = mesh.elements[mesh.regions == label]
        parts.append(
            f'<Elements type="{tetrahedron}" name="{mesh.region_name(label)}">\n{elements("elem", first, own)}</Elements>\n'
        )
        first += len(own)
    for mark in np.unique(mesh.marks).tolist():
        own = mesh.faces[mesh.marks == mark]
        parts.append(f'<Surface name="{mesh.mark_name(mark)}">\n{elements(triangle, 1, own)}</Surface>\n')
    regions = "".join(f"<!-- {row.words()} -->\n" for row in mesh.region_table())
    names = map(mesh.region_name, labels)
    domains = "".join(f'<SolidDomain name="{name}" mat="{name}"/>\n' for name in names)
    path.write_text(
        f"""<?xml version="1.0" encoding="ISO-8859-1"?>
<febio_spec version="4.0"><Module type="solid"/>
{regions}<Material>
{materials}</Material>
<Mesh>
<Nodes name="nodes">
{_rows(nodes, '<node id="%d">%.17g,%.17g,%.17g</node>')}</Nodes>
{"".join(parts)}</Mesh>
<MeshDomains>
{domains}</MeshDomains>
</febio_spec>
""",
        encoding="ascii",
    )


def _carp_points(mesh: MarkedMesh, path: Path) -> None:
    """The nodes of openCARP, in its unit, micrometres."""
    path.write_text(f"{len(mesh.points)}\n{_rows(mesh.points, '%.9g %.9g %.9g')}", encoding="ascii")


def _carp_elements(mesh: MarkedMesh, path: Path) -> None:
    """The elements of openCARP with their region; nodes count from 0."""
    rows = np.column_stack([mesh.tetrahedra, mesh.regions])
    path.write_text(f"{len(rows)}\n{_rows(rows, 'Tt %d %d %d %d %d')}", encoding="ascii")


def _carp_fibres(mesh: MarkedMesh, path: Path) -> None:
    """The fibres of openCARP, one direction an element: x everywhere, since a volume of tissues tells none."""
    path.write_text("1\n" + "1 0 0\n" * len(mesh.tetrahedra), encoding="ascii")


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


def _vtk(mesh: MarkedMesh, path: Path) -> None:
    """Legacy VTK 4.2, binary, which more programs read than later ones: tetrahedra with ``region``, points with ``boundary``."""
    from vtkmodules.vtkIOLegacy import vtkUnstructuredGridWriter

    grid = unstructured(mesh)
    grid.cell_data["region"] = mesh.regions.astype(np.int32)
    grid.point_data["boundary"] = mesh.point_marks().astype(np.int32)
    add_regions(grid, mesh)
    writer = vtkUnstructuredGridWriter()
    writer.SetFileName(str(path))
    writer.SetFileVersion(42)
    writer.SetFileTypeToBinary()
    writer.SetInputData(grid)
    if not writer.Write():
        raise OSError(0, "VTK cannot write it", str(path))


def _simvascular_volume(mesh: MarkedMesh, path: Path) -> None:
    """SimVascular's mesh-complete.mesh.vtu: numbers from 1, and the region of each element."""
    grid = unstructured(mesh)
    grid.point_data["GlobalNodeID"] = np.arange(1, len(mesh.points) + 1, dtype=np.int32)
    grid.cell_data["GlobalElementID"] = np.arange(1, len(mesh.tetrahedra) + 1, dtype=np.int32)
    grid.cell_data["ModelRegionID"] = mesh.regions.astype(np.int32)
    add_regions(grid, mesh)
    grid.save(path)


def _simvascular_boundary(mesh: MarkedMesh, path: Path) -> None:
    """SimVascular's mesh-complete.exterior.vtp: faces by their part of the boundary, and the element behind each."""
    shown = mesh.outermost()
    used, local = np.unique(mesh.boundary[shown], return_inverse=True)
    surface = to_polydata(mesh.points[used], local.reshape(-1, 3))
    surface.point_data["GlobalNodeID"] = (used + 1).astype(np.int32)
    surface.cell_data["GlobalElementID"] = (mesh.owners[shown] + 1).astype(np.int32)
    surface.cell_data["ModelFaceID"] = mesh.marks[shown].astype(np.int32)
    surface.save(path)


def _triangles(mesh: MarkedMesh, path: Path) -> None:
    """The boundary with ``mark``, ``tetrahedron`` (its owner), ``region`` of that, and ``point`` in the volume mesh.

    Of many materials all interfaces: ``region`` is that behind the triangle, ``region_before`` the other.
    """
    used, local = np.unique(mesh.boundary, return_inverse=True)
    surface = to_polydata(mesh.points[used], local.reshape(-1, 3))
    surface.cell_data["mark"] = mesh.marks
    surface.cell_data["tetrahedron"] = mesh.owners
    surface.cell_data["region"] = mesh.regions[mesh.owners]
    if mesh.materials is not None:
        before = mesh.materials.before
        surface.cell_data["region_before"] = np.where(before < 0, NOTHING, mesh.regions[before])
        add_text(surface, "materials", json.dumps(mesh.materials.table))
    surface.point_data["point"] = used
    add_regions(surface, mesh)
    surface.save(path)


_WRITE: dict[str, dict[str, Callable[[MarkedMesh, Path], None]]] = {
    "inp": {"volume.inp": _abaqus},
    "msh": {"volume.msh": write_msh},
    "msh2": {"volume.msh2": write_msh2},
    "med": {"volume.med": write_med},
    "vtp": {"boundary.vtp": _triangles},
    "vtk": {"volume.vtk": _vtk},
    "feb": {"volume.feb": _febio},
    "carp": {"volume.pts": _carp_points, "volume.elem": _carp_elements, "volume.lon": _carp_fibres},
    "simvascular": {
        "volume.mesh-complete.mesh.vtu": _simvascular_volume,
        "volume.mesh-complete.exterior.vtp": _simvascular_boundary,
    },
}
"""The files of each format but XDMF, ``NAME.`` before each, and what writes them; the table of
regions comes with each. All but the boundary begin with ``volume``, by which the rest of the
project knows them as results of this stage."""

_PER_MM = {"mm": 1.0, "m": 1e-3, "um": 1e3}


def export_paths(output: Path, name: str, kinds: tuple[str, ...], many: bool = False) -> list[Path]:
    """Files of some formats, beside the volume mesh, each once.

    Parameters
    ----------
    output
        The volume mesh.
    name
        Name of the case.
    kinds
        Of :data:`.FORMATS`.
    many
        Whether there are many materials.
    """
    endings = dict.fromkeys(ending for kind in kinds for ending in _files(name, kind, many))
    return [output.with_name(f"{name}.{ending}") for ending in endings]


def _files(name: str, kind: str, many: bool) -> dict[str, Callable[[MarkedMesh, Path], None]]:
    written: dict[str, Callable[[MarkedMesh, Path], None]] = {"volume.regions.csv": _regions_csv}
    if kind != "xdmf":
        return _WRITE[kind] | written
    for stem, grid in (("volume", elements), (f"volume.{'interfaces' if many else 'boundary'}", facets)):
        numbers = f"{stem}.h5"
        written[numbers] = partial(write_numbers, grid=grid)
        written[f"{stem}.xdmf"] = partial(
            write_description, grid=grid, numbers=f"{name}.{numbers}", points=f"{name}.volume.h5"
        )
    return written


def export(mesh: MarkedMesh, output: Path, name: str, kind: str, unit: str = "mm") -> None:
    """Write the mesh for another program, each file whole or not at all.

    Parameters
    ----------
    mesh
        The tetrahedra.
    output
        The volume mesh; the files lie beside it.
    name
        Name of the case.
    kind
        One of :data:`.FORMATS`.
    unit
        One of :data:`.UNITS`, that of the coordinates; openCARP has micrometres whatever it is.
    """
    scale = _PER_MM["um" if kind == "carp" else unit]
    scaled = mesh if scale == 1.0 else replace(mesh, points=mesh.points * scale)
    for ending, write in _files(name, kind, mesh.materials is not None).items():

        def into(temporary: Path, write: Callable[[MarkedMesh, Path], None] = write) -> None:
            write(scaled, temporary)

        write_atomically(output.with_name(f"{name}.{ending}"), into)
