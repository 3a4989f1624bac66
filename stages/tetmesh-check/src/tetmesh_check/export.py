"""The tetrahedra for other programs: Abaqus (.inp), Gmsh (.msh), XDMF; and their boundary as triangles (.vtp)."""

from __future__ import annotations

import io
from dataclasses import dataclass
from pathlib import Path

import meshio
import numpy as np

from tetmesh_check.files import write_atomically
from tetmesh_check.polydata import to_polydata
from tetmesh_check.quality import Cells, Labels, Points
from tetmesh_check.regions import CAP, SURFACE

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


def _abaqus(mesh: MarkedMesh, path: Path) -> None:
    """C3D4 elements; ELSET REGION_n; NSET of each part of the boundary (a point on its rim is in both)."""
    elements = {f"REGION_{label}": [np.flatnonzero(mesh.regions == label)] for label in np.unique(mesh.regions)}
    nodes = {
        NAMES[mark].upper(): np.unique(mesh.boundary[mesh.marks == mark])
        for mark in (SURFACE, CAP)
        if mark in mesh.marks
    }
    meshio.write(
        path,
        meshio.Mesh(mesh.points, [("tetra", mesh.tetrahedra)], cell_sets=elements, point_sets=nodes),
        file_format="abaqus",
    )


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
        text = io.StringIO()
        np.savetxt(text, values, "%.17g" if values.dtype == np.float64 else "%d")
        size = " ".join(map(str, values.shape))
        return f'<DataItem Format="XML" {kind} Dimensions="{size}">\n{text.getvalue()}</DataItem>\n'

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


_WRITE = {"inp": _abaqus, "msh": _gmsh, "xdmf": _xdmf, "vtp": _triangles}


def export_path(output: Path, name: str, kind: str) -> Path:
    """File of one format, beside the volume mesh.

    Parameters
    ----------
    output
        The volume mesh.
    name
        Name of the case.
    kind
        One of :data:`.FORMATS`.
    """
    return output.with_name(f"{name}.boundary.vtp" if kind == "vtp" else f"{name}.volume.{kind}")


def export(mesh: MarkedMesh, path: Path, kind: str) -> None:
    """Write the mesh for another program, whole or not at all.

    Parameters
    ----------
    mesh
        The tetrahedra.
    path
        The file.
    kind
        One of :data:`.FORMATS`.
    """
    write_atomically(path, lambda temporary: _WRITE[kind](mesh, temporary))
