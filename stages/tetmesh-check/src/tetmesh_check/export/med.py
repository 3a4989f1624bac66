"""MED, the format of Salome and Code_Aster (HDF5), with regions as groups."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import meshio
import numpy as np

if TYPE_CHECKING:
    from tetmesh_check.export.mesh import MarkedMesh

_TETRAHEDRON = np.array([0, 2, 1, 3, 6, 5, 4, 7, 9, 8])
"""Nodes in the order of MED: its tetrahedra (but not its triangles) are wound the other way, and
the nodes on the edges follow."""


def write_med(mesh: MarkedMesh, path: Path) -> None:
    """Write elements and boundary as groups of the names that sets have in other formats.

    Parameters
    ----------
    mesh
        The tetrahedra.
    path
        The file.
    """
    regions, marks = np.unique(mesh.regions).tolist(), np.unique(mesh.marks).tolist()
    # families of elements have numbers below 0, each with the names of its groups
    names = [mesh.region_name(label) for label in regions] + [mesh.mark_name(mark) for mark in marks]
    families = {-number: [name] for number, name in enumerate(names, 1)}
    of_cells = -1 - np.searchsorted(regions, mesh.regions)
    of_faces = -1 - len(regions) - np.searchsorted(marks, mesh.marks)
    tetrahedron, triangle = mesh.kinds
    elements = mesh.elements
    made = meshio.Mesh(
        mesh.points,
        [
            (tetrahedron, elements[:, _TETRAHEDRON[: elements.shape[1]]]),
            (triangle, mesh.faces),
        ],
        cell_data={"cell_tags": [of_cells.astype(np.int64), of_faces.astype(np.int64)]},
    )
    made.cell_tags = families
    # by the name of the format, because a file that is being written has another ending
    meshio.write(path, made, file_format="med")
