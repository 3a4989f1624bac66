"""Writes VTK files: the volume mesh, and exports."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pyvista as pv
from vtkmodules.vtkIOLegacy import vtkUnstructuredGridWriter
from vtkmodules.vtkIOXML import vtkXMLUnstructuredGridWriter

from tetmesh_check.datasets import add_text
from tetmesh_check.export.mesh import MarkedMesh
from tetmesh_check.files import write_atomically
from tetmesh_check.materials import NOTHING
from tetmesh_check.prisms import scaled_jacobian
from tetmesh_check.quality import Labels, Points, Values

_MEASURES = ("radius_ratio", "scaled_jacobian", "min_dihedral", "jacobian_bound")
"""Measures that the volume mesh has as cell data. Angles are in degrees."""
_KINDS = {
    "tetra": pv.CellType.TETRA,
    "tetra10": pv.CellType.QUADRATIC_TETRA,
    "wedge": pv.CellType.WEDGE,
}
_FORMAT = 2
"""Version of the file's layout, in the field data ``isoparticles_format``."""


def _add_space(dataset: pv.DataSet, mesh: MarkedMesh) -> None:
    """Store the world frame as the Rust stages do."""
    add_text(dataset, "space", json.dumps((mesh.space or "unnamed").capitalize()))


def _grid(mesh: MarkedMesh, points: Points) -> pv.UnstructuredGrid:
    grid = pv.UnstructuredGrid({_KINDS[block.kind]: block.nodes for block in mesh.elements_of()}, points)
    _add_space(grid, mesh)
    return grid


def _surface(mesh: MarkedMesh, faces: Labels) -> tuple[pv.PolyData, Labels]:
    """Return faces of the boundary, and the indices of their points in the mesh."""
    used = mesh.nodes_of(faces)
    blocks = [np.searchsorted(used, block.nodes) for block in mesh.faces_of(faces)]
    rows = [np.insert(nodes, 0, nodes.shape[1], axis=1).ravel() for nodes in blocks]
    surface = pv.PolyData(mesh.points[used], np.concatenate(rows))
    _add_space(surface, mesh)
    return surface, used


def write_volume(path: Path, mesh: MarkedMesh, measures: Mapping[str, Values], history: dict[str, Any]) -> None:
    """Write the volume mesh.

    Parameters
    ----------
    path
        A ``.vtu`` file.
    mesh
        The mesh. Points are written in double precision, regions and fields as cell data, and marks
        and fields of points as point data. The table of many materials is the text ``materials``.
    measures
        Measures of the elements by name: those of :class:`.TetrahedronQuality`, or
        ``jacobian_bound``, the lower bound of each quadratic element's Jacobian over that of the
        straight one. Prisms get their scaled Jacobian, and NaN for the others.
    history
        Program, parameters and inputs of the file.
    """
    grid = _grid(mesh, mesh.shown)
    prisms = np.full(len(mesh.prisms), np.nan)
    for name in [name for name in _MEASURES if name in measures]:
        own = scaled_jacobian(mesh.points, mesh.prisms) if name == "scaled_jacobian" else prisms
        grid.cell_data[name] = np.append(measures[name], own)
    grid.cell_data.update(mesh.fields)
    grid.point_data.update(mesh.point_fields)
    grid.cell_data["region"] = mesh.regions.astype(np.int32)
    grid.point_data["boundary"] = mesh.point_marks().astype(np.uint8)
    add_text(grid, "isoparticles_kind", "quadratic volume" if mesh.is_quadratic else "volume")
    grid.add_field_data(np.array([_FORMAT], dtype=np.uint32), "isoparticles_format")
    if mesh.materials is not None:
        add_text(grid, "materials", json.dumps(mesh.materials))
    add_text(grid, "history", json.dumps(history))
    writer = vtkXMLUnstructuredGridWriter()
    # 1.1 million tetrahedra take 0.8 s of CPU time and 36 MB. PyVista's `save` (level 5, text)
    # takes 1.5 s and 48 MB.
    writer.SetCompressionLevel(1)
    writer.SetDataModeToAppended()
    writer.EncodeAppendedDataOff()
    write_atomically(path, lambda temporary: _save(writer, grid, temporary))


def _save(writer: Any, grid: pv.UnstructuredGrid, path: Path) -> None:
    writer.SetFileName(str(path))
    writer.SetInputData(grid)
    if not writer.Write():
        raise OSError(0, "VTK cannot write it", str(path))


def write_legacy(mesh: MarkedMesh, path: Path) -> None:
    """Write legacy VTK 4.2, binary, with ``region`` and fields as cell data (E always in N/mm^2).

    Point data are the fields of points, ``boundary`` (the marks), and for each union an array that
    is 1 on its triangles.
    """
    grid = _grid(mesh, mesh.points)
    grid.cell_data.update(mesh.fields)
    grid.point_data.update(mesh.point_fields)
    grid.cell_data["region"] = mesh.regions.astype(np.int32)
    grid.point_data["boundary"] = mesh.point_marks().astype(np.int32)
    for own in mesh.union_sets:
        grid.point_data[own.name] = np.zeros(len(mesh.points), dtype=np.int32)
        grid.point_data[own.name][mesh.nodes_of(own.members)] = 1
    add_text(grid, "regions", mesh.region_text())
    writer = vtkUnstructuredGridWriter()
    writer.SetFileVersion(42)
    writer.SetFileTypeToBinary()
    _save(writer, grid, path)


def write_simvascular_volume(mesh: MarkedMesh, path: Path) -> None:
    """Write SimVascular's mesh-complete.mesh.vtu, with numbers from 1 and regions."""
    grid = _grid(mesh, mesh.points)
    grid.point_data["GlobalNodeID"] = np.arange(1, len(mesh.points) + 1, dtype=np.int32)
    grid.cell_data["GlobalElementID"] = np.arange(1, len(mesh.elements) + 1, dtype=np.int32)
    grid.cell_data["ModelRegionID"] = mesh.regions.astype(np.int32)
    add_text(grid, "regions", mesh.region_text())
    grid.save(path)


def write_simvascular_faces(mesh: MarkedMesh, path: Path, triangles: Labels) -> None:
    """Write triangles as SimVascular does: with part (face), region, element and node numbers."""
    surface, used = _surface(mesh, triangles)
    owners = mesh.owners[triangles]
    surface.point_data["GlobalNodeID"] = (used + 1).astype(np.int32)
    surface.cell_data["GlobalElementID"] = (owners + 1).astype(np.int32)
    surface.cell_data["ModelFaceID"] = mesh.marks[triangles].astype(np.int32)
    surface.cell_data["ModelRegionID"] = mesh.regions[owners].astype(np.int32)
    add_text(surface, "parts", json.dumps(mesh.parts))
    surface.save(path)


def write_boundary(mesh: MarkedMesh, path: Path) -> None:
    """Write the boundary with ``mark``, ``tetrahedron`` (its owner), ``region`` and ``point``.

    With many materials, all interfaces are written: ``region`` is the material behind the triangle,
    and ``region_before`` that in front of it. For each union, there is an array that is 1 on its
    triangles. The text ``parts`` names the marks.
    """
    surface, used = _surface(mesh, np.arange(len(mesh.marks)))
    surface.cell_data["mark"] = mesh.marks
    surface.cell_data["tetrahedron"] = mesh.owners
    surface.cell_data["region"] = mesh.regions[mesh.owners]
    if mesh.materials is not None:
        surface.cell_data["region_before"] = np.where(mesh.outermost, NOTHING, mesh.regions[mesh.before])
        add_text(surface, "materials", json.dumps(mesh.materials))
    for name, marks in mesh.unions.items():
        surface.cell_data[name] = np.isin(mesh.marks, sorted(marks)).astype(np.uint8)
    surface.point_data["point"] = used
    add_text(surface, "parts", json.dumps(mesh.parts))
    add_text(surface, "regions", mesh.region_text())
    surface.save(path)
