"""Writers of the tetrahedra, or of their boundary, for other programs."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from tetmesh_check.export.med import write_med
from tetmesh_check.export.mesh import MarkedMesh, add_regions, unstructured
from tetmesh_check.export.msh import write_msh, write_msh2
from tetmesh_check.export.xdmf import elements, facets, write_description, write_numbers
from tetmesh_check.field_data import add_text
from tetmesh_check.files import write_atomically
from tetmesh_check.materials import NOTHING
from tetmesh_check.polydata import to_polydata
from tetmesh_check.quality import Cells, Labels, Points


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
"""Number of the face of a C3D4 that lies opposite its first, second, ... node: S1 is 1-2-3, S2
1-4-2, S3 2-4-3, S4 3-4-1."""


def _abaqus(mesh: MarkedMesh, path: Path) -> None:
    """Abaqus: an ELSET for each region; an NSET and a SURFACE for each part of the boundary.

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
    # a field has 20 characters, and CalculiX refuses more: 13 digits with both signs and an
    # exponent are 19
    return _rows(np.column_stack([np.arange(1, len(points) + 1), points]), "%d, %.13g, %.13g, %.13g")


def _febio(mesh: MarkedMesh, path: Path) -> None:
    """FEBio 4.0: a placeholder material for each region, a surface for each boundary part."""

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
    """The fibres of openCARP: x for all elements, because a label map has no fibres."""
    path.write_text("1\n" + "1 0 0\n" * len(mesh.tetrahedra), encoding="ascii")


def _vtk(mesh: MarkedMesh, path: Path) -> None:
    """Legacy VTK 4.2, binary, with ``region`` of cells and ``boundary`` of points."""
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
    """SimVascular's exterior.vtp: boundary part and element of each triangle."""
    shown = mesh.outermost()
    used, local = np.unique(mesh.boundary[shown], return_inverse=True)
    surface = to_polydata(mesh.points[used], local.reshape(-1, 3))
    surface.point_data["GlobalNodeID"] = (used + 1).astype(np.int32)
    surface.cell_data["GlobalElementID"] = (mesh.owners[shown] + 1).astype(np.int32)
    surface.cell_data["ModelFaceID"] = mesh.marks[shown].astype(np.int32)
    surface.save(path)


def _triangles(mesh: MarkedMesh, path: Path) -> None:
    """The boundary with ``mark``, ``tetrahedron`` (its owner), ``region`` and ``point``.

    Of many materials all interfaces: ``region`` is that behind the triangle, ``region_before`` the
    other.
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
