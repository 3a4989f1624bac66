"""The tetrahedra for other programs: Abaqus and CalculiX, Gmsh, XDMF, VTK, FEBio, openCARP, SimVascular; and their boundary alone."""

from __future__ import annotations

import io
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import meshio
import numpy as np

from tetmesh_check.files import write_atomically
from tetmesh_check.polydata import to_polydata
from tetmesh_check.quality import Cells, Labels, Points
from tetmesh_check.regions import CAP, SURFACE

if TYPE_CHECKING:
    import pyvista as pv

NAMES = {SURFACE: "surface", CAP: "cap"}
"""What the parts of the boundary are called in sets and groups."""


@dataclass(frozen=True)
class MarkedMesh:
    """Tetrahedra and their boundary, each with its mark."""

    points: Points
    """World positions, mm, shape ``(n, 3)``."""
    tetrahedra: Cells
    """Vertex indices in VTK order, shape ``(m, 4)``."""
    regions: Labels
    """Label of each tetrahedron, shape ``(m,)``; all 1 where no label volume is given."""
    boundary: Cells
    """Triangles of the boundary, outward, shape ``(k, 3)``."""
    owners: Labels
    """Tetrahedron behind each of them, shape ``(k,)``."""
    marks: Labels
    """:data:`.SURFACE` or :data:`.CAP`, shape ``(k,)``."""

    def point_marks(self) -> Labels:
        """Mark of each point, shape ``(n,)``: 0 inside, else that of its triangles, :data:`.CAP` only where all are."""
        marks = np.zeros(len(self.points), dtype=np.int64)
        marks[self.boundary[self.marks == CAP]] = CAP
        marks[self.boundary[self.marks == SURFACE]] = SURFACE
        return marks


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
    """C3D4 elements; ELSET REGION_n; NSET and SURFACE of each part of the boundary (a point on its rim is in both sets)."""
    parts = [f"*HEADING\nisoparticles\n*NODE\n{_abaqus_nodes(mesh.points)}*ELEMENT, TYPE=C3D4, ELSET=VOLUME\n"]
    parts.append(_numbered(1, mesh.tetrahedra + 1))
    for label in np.unique(mesh.regions).tolist():
        parts.append(f"*ELSET, ELSET=REGION_{label}\n{_list(np.flatnonzero(mesh.regions == label) + 1)}")
    away = (mesh.tetrahedra[mesh.owners][:, :, None] != mesh.boundary[:, None, :]).all(axis=2)
    faces = _ABAQUS_FACE[away.argmax(axis=1)]
    for mark in (SURFACE, CAP):
        if mark in mesh.marks:
            own, name = mesh.marks == mark, NAMES[mark].upper()
            parts.append(f"*NSET, NSET={name}\n{_list(np.unique(mesh.boundary[own]) + 1)}")
            pairs = np.column_stack([mesh.owners[own] + 1, faces[own]])
            parts.append(f"*SURFACE, NAME={name}, TYPE=ELEMENT\n{_rows(pairs, '%d, S%d')}")
    path.write_text("".join(parts), encoding="ascii")


def _abaqus_nodes(points: Points) -> str:
    return _rows(np.column_stack([np.arange(1, len(points) + 1), points]), "%d, %.17g, %.17g, %.17g")


def _febio(mesh: MarkedMesh, path: Path) -> None:
    """FEBio 4.0: tet4 elements and a material for each region, to be replaced; a surface for each part of the boundary."""

    def elements(tag: str, first: int, cells: Cells) -> str:
        columns = ",".join(["%d"] * cells.shape[1])
        rows = np.column_stack([np.arange(first, first + len(cells)), cells + 1])
        return _rows(rows, f'<{tag} id="%d">{columns}</{tag}>')

    labels = np.unique(mesh.regions).tolist()
    nodes = np.column_stack([np.arange(1, len(mesh.points) + 1), mesh.points])
    materials = "".join(
        f'<material id="{number}" name="region_{label}" type="neo-Hookean">'
        "<density>1</density><E>1</E><v>0.3</v></material>\n"
        for number, label in enumerate(labels, 1)
    )
    parts, first = [], 1
    for label in labels:
        own = mesh.tetrahedra[mesh.regions == label]
        parts.append(f'<Elements type="tet4" name="region_{label}">\n{elements("elem", first, own)}</Elements>\n')
        first += len(own)
    for mark in np.unique(mesh.marks).tolist():
        own = mesh.boundary[mesh.marks == mark]
        parts.append(f'<Surface name="{NAMES[mark]}">\n{elements("tri3", 1, own)}</Surface>\n')
    domains = "".join(f'<SolidDomain name="region_{label}" mat="region_{label}"/>\n' for label in labels)
    path.write_text(
        f"""<?xml version="1.0" encoding="ISO-8859-1"?>
<febio_spec version="4.0"><Module type="solid"/>
<Material>
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


def _unstructured(mesh: MarkedMesh) -> pv.UnstructuredGrid:
    import pyvista as pv

    return pv.UnstructuredGrid({pv.CellType.TETRA: mesh.tetrahedra}, mesh.points)


def _vtk(mesh: MarkedMesh, path: Path) -> None:
    """Legacy VTK 4.2, binary, which more programs read than later ones: tetrahedra with ``region``, points with ``boundary``."""
    from vtkmodules.vtkIOLegacy import vtkUnstructuredGridWriter

    grid = _unstructured(mesh)
    grid.cell_data["region"] = mesh.regions.astype(np.int32)
    grid.point_data["boundary"] = mesh.point_marks().astype(np.int32)
    writer = vtkUnstructuredGridWriter()
    writer.SetFileName(str(path))
    writer.SetFileVersion(42)
    writer.SetFileTypeToBinary()
    writer.SetInputData(grid)
    if not writer.Write():
        raise OSError(0, "VTK cannot write it", str(path))


def _simvascular_volume(mesh: MarkedMesh, path: Path) -> None:
    """SimVascular's mesh-complete.mesh.vtu: numbers from 1, and the region of each element."""
    grid = _unstructured(mesh)
    grid.point_data["GlobalNodeID"] = np.arange(1, len(mesh.points) + 1, dtype=np.int32)
    grid.cell_data["GlobalElementID"] = np.arange(1, len(mesh.tetrahedra) + 1, dtype=np.int32)
    grid.cell_data["ModelRegionID"] = mesh.regions.astype(np.int32)
    grid.save(path)


def _simvascular_boundary(mesh: MarkedMesh, path: Path) -> None:
    """SimVascular's mesh-complete.exterior.vtp: faces by their part of the boundary, and the element behind each."""
    used, local = np.unique(mesh.boundary, return_inverse=True)
    surface = to_polydata(mesh.points[used], local.reshape(-1, 3))
    surface.point_data["GlobalNodeID"] = (used + 1).astype(np.int32)
    surface.cell_data["GlobalElementID"] = (mesh.owners + 1).astype(np.int32)
    surface.cell_data["ModelFaceID"] = mesh.marks.astype(np.int32)
    surface.save(path)


def _gmsh(mesh: MarkedMesh, path: Path) -> None:
    """Version 2.2, binary: physical groups of dimension 3 (``region_n``, tag n) and 2 (``surface``, ``cap``)."""
    groups = {f"region_{label}": np.array([label, 3]) for label in np.unique(mesh.regions)}
    groups.update({NAMES[mark]: np.array([mark, 2]) for mark in np.unique(mesh.marks).tolist()})
    tags = [mesh.regions.astype(np.int32), mesh.marks.astype(np.int32)]
    meshio.write(
        path,
        meshio.Mesh(
            mesh.points,
            [("tetra", mesh.tetrahedra.astype(np.int32)), ("triangle", mesh.boundary.astype(np.int32))],
            cell_data={"gmsh:physical": tags, "gmsh:geometrical": tags},
            field_data=groups,
        ),
        file_format="gmsh22",
        binary=True,
    )


def _xdmf(mesh: MarkedMesh, path: Path) -> None:
    """Tetrahedra with ``region``, points with ``boundary``; the numbers are in the file itself, as text.

    By hand, because meshio's writer wants HDF5 for any XDMF.
    """

    def item(values: Points | Cells | Labels) -> str:
        kind = 'NumberType="Float" Precision="8"' if values.dtype == np.float64 else 'NumberType="Int" Precision="8"'
        size = " ".join(map(str, values.shape))
        rows = _rows(values, "%.17g" if values.dtype == np.float64 else "%d")
        return f'<DataItem Format="XML" {kind} Dimensions="{size}">\n{rows}</DataItem>\n'

    path.write_text(
        f'''<?xml version="1.0"?>
<Xdmf Version="3.0"><Domain><Grid Name="volume" GridType="Uniform">
<Geometry GeometryType="XYZ">{item(mesh.points)}</Geometry>
<Topology TopologyType="Tetrahedron" NumberOfElements="{len(mesh.tetrahedra)}">{item(mesh.tetrahedra)}</Topology>
<Attribute Name="region" AttributeType="Scalar" Center="Cell">{item(mesh.regions)}</Attribute>
<Attribute Name="boundary" AttributeType="Scalar" Center="Node">{item(mesh.point_marks())}</Attribute>
</Grid></Domain></Xdmf>
''',
        encoding="utf-8",
    )


def _triangles(mesh: MarkedMesh, path: Path) -> None:
    """The boundary with ``mark``, ``tetrahedron`` (its owner), ``region`` of that, and ``point`` in the volume mesh."""
    used, local = np.unique(mesh.boundary, return_inverse=True)
    surface = to_polydata(mesh.points[used], local.reshape(-1, 3))
    surface.cell_data["mark"] = mesh.marks
    surface.cell_data["tetrahedron"] = mesh.owners
    surface.cell_data["region"] = mesh.regions[mesh.owners]
    surface.point_data["point"] = used
    surface.save(path)


_WRITE: dict[str, dict[str, Callable[[MarkedMesh, Path], None]]] = {
    "inp": {"volume.inp": _abaqus},
    "msh": {"volume.msh": _gmsh},
    "xdmf": {"volume.xdmf": _xdmf},
    "vtp": {"boundary.vtp": _triangles},
    "vtk": {"volume.vtk": _vtk},
    "feb": {"volume.feb": _febio},
    "carp": {"volume.pts": _carp_points, "volume.elem": _carp_elements, "volume.lon": _carp_fibres},
    "simvascular": {
        "volume.mesh-complete.mesh.vtu": _simvascular_volume,
        "volume.mesh-complete.exterior.vtp": _simvascular_boundary,
    },
}
"""The files of each format, ``NAME.`` before each, and what writes them. All but the boundary begin with ``volume``, by which the rest of the
project knows them as results of this stage."""

_PER_MM = {"mm": 1.0, "m": 1e-3, "um": 1e3}


def export_paths(output: Path, name: str, kind: str) -> list[Path]:
    """Files of one format, beside the volume mesh.

    Parameters
    ----------
    output
        The volume mesh.
    name
        Name of the case.
    kind
        One of :data:`.FORMATS`.
    """
    return [output.with_name(f"{name}.{ending}") for ending in _WRITE[kind]]


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
    for path, write in zip(export_paths(output, name, kind), _WRITE[kind].values(), strict=True):

        def into(temporary: Path, write: Callable[[MarkedMesh, Path], None] = write) -> None:
            write(scaled, temporary)

        write_atomically(path, into)
