"""The volume mesh as a VTK file: tetrahedra, their quality, and where they came from."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pyvista as pv
from vtkmodules.vtkIOXML import vtkXMLUnstructuredGridWriter

from tetmesh_check.export.mesh import MarkedMesh, unstructured
from tetmesh_check.field_data import add_text
from tetmesh_check.files import write_atomically
from tetmesh_check.quality import Cells, Points, TetrahedronQuality, Values, signed_tetrahedron_volumes

KIND = "volume"
"""Kind of the file, in the field data ``isoparticles_kind``."""
QUADRATIC_KIND = "quadratic volume"
"""The same of the mesh with a node amid each edge."""
FORMAT = 2
"""Version of the file's layout, in the field data ``isoparticles_format``."""


def orient_positive(points: Points, tetrahedra: Cells) -> tuple[Cells, bool]:
    """Bring tetrahedra that are all wound the other way into VTK's order.

    Single inverted tetrahedra among positive ones are a fault of the mesh and stay as they are.

    Parameters
    ----------
    points
        Positions, mm, shape ``(n, 3)``.
    tetrahedra
        Vertex indices, shape ``(m, 4)``.

    Returns
    -------
    tuple
        The tetrahedra, and whether they were turned.
    """
    volumes = signed_tetrahedron_volumes(points, tetrahedra)
    if (volumes < 0).sum() <= (volumes > 0).sum():
        return tetrahedra, False
    return tetrahedra[:, [0, 2, 1, 3]], True


def write_volume(path: Path, mesh: MarkedMesh, quality: TetrahedronQuality, history: dict[str, Any]) -> None:
    """Write the volume mesh.

    Parameters
    ----------
    path
        A ``.vtu`` file.
    mesh
        Its points are written in double precision, the regions of its tetrahedra and the marks of
        its points as data; the table of many materials as a text, ``materials``.
    quality
        Its radius ratio, scaled Jacobian and smallest dihedral angle (degrees) go along as cell
        data.
    history
        Program, parameters and inputs of the file.
    """
    measures = {name: getattr(quality, name) for name in ("radius_ratio", "scaled_jacobian", "min_dihedral")}
    _write(path, mesh, KIND, measures, history)


def write_quadratic(path: Path, mesh: MarkedMesh, jacobian: Values, history: dict[str, Any]) -> None:
    """Write the mesh with a node amid each edge.

    Parameters
    ----------
    path
        A ``.vtu`` file.
    mesh
        Its elements have ten nodes.
    jacobian
        Lower bound of each element's Jacobian over that of the straight one.
    history
        Program, parameters and inputs of the file.
    """
    _write(path, mesh, QUADRATIC_KIND, {"jacobian_bound": jacobian}, history)


def _write(path: Path, mesh: MarkedMesh, kind: str, measures: dict[str, Values], history: dict[str, Any]) -> None:
    grid = unstructured(mesh)
    for name, values in measures.items():
        grid.cell_data[name] = values
    grid.cell_data["region"] = mesh.regions.astype(np.int32)
    grid.point_data["boundary"] = mesh.point_marks().astype(np.uint8)
    add_text(grid, "isoparticles_kind", kind)
    grid.add_field_data(np.array([FORMAT], dtype=np.uint32), "isoparticles_format")
    if mesh.materials is not None:
        add_text(grid, "materials", json.dumps(mesh.materials.table))
    add_text(grid, "history", json.dumps(history))
    write_atomically(path, lambda temporary: _save(grid, temporary))


def _save(grid: pv.UnstructuredGrid, path: Path) -> None:
    writer = vtkXMLUnstructuredGridWriter()
    writer.SetFileName(str(path))
    writer.SetInputData(grid)
    # 1.1 million tetrahedra take 0.8 s of CPU time and 36 MB. PyVista's `save` (level 5, text)
    # takes 1.5 s and 48 MB.
    writer.SetCompressionLevel(1)
    writer.SetDataModeToAppended()
    writer.EncodeAppendedDataOff()
    if not writer.Write():
        raise OSError(f"cannot write {path}")
