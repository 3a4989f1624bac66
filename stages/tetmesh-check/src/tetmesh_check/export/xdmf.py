"""XDMF: a description in XML and numbers in HDF5, for elements and boundary.

h5py writes the files: meshio would write points and cells of each file again, but FEniCS reads the
triangles as tags of facets, which must use the same points. FEniCS opens the HDF5 file with the
name of the description, whatever file the description states.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING
from xml.sax.saxutils import escape, quoteattr

import h5py
import numpy as np

if TYPE_CHECKING:
    from tetmesh_check.export.mesh import MarkedMesh
    from tetmesh_check.quality import Cells, Labels, Points

_KINDS = {4: "Tetrahedron", 10: "Tetrahedron_10", 3: "Triangle", 6: "Triangle_6"}


@dataclass(frozen=True)
class Grid:
    """Elements or triangles, and what is known of each."""

    name: str
    """Name in the file, ``volume``, ``boundary`` or ``interfaces``."""
    cells: str
    """Which of ``arrays`` are the cells."""
    data: dict[tuple[str, str], str]
    """Arrays by name and place (``Cell`` or ``Node``)."""
    arrays: dict[str, Points | Cells | Labels]
    """Contents of the HDF5 file of the grid."""


def elements(mesh: MarkedMesh) -> Grid:
    """Tetrahedra with their ``region`` and points with their ``boundary``.

    Parameters
    ----------
    mesh
        The tetrahedra.
    """
    arrays: dict[str, Points | Cells | Labels] = {
        "points": mesh.points,
        "elements": mesh.elements,
        "region": mesh.regions,
        "boundary": mesh.point_marks(),
    }
    return Grid("volume", "elements", {("region", "Cell"): "region", ("boundary", "Node"): "boundary"}, arrays)


def facets(mesh: MarkedMesh) -> Grid:
    """Triangles with their ``mark`` or, for many materials, their ``pair``.

    Parameters
    ----------
    mesh
        The tetrahedra.
    """
    name, tag = ("boundary", "mark") if mesh.materials is None else ("interfaces", "pair")
    return Grid(name, "triangles", {(tag, "Cell"): tag}, {"triangles": mesh.faces, tag: mesh.marks})


def write_numbers(mesh: MarkedMesh, path: Path, grid: Callable[[MarkedMesh], Grid]) -> None:
    """Write the numbers of a grid.

    Parameters
    ----------
    mesh
        The tetrahedra.
    path
        The HDF5 file.
    grid
        :func:`elements` or :func:`facets`.
    """
    with h5py.File(path, "w") as file:
        for name, values in grid(mesh).arrays.items():
            file[name] = values


def write_description(
    mesh: MarkedMesh, path: Path, grid: Callable[[MarkedMesh], Grid], numbers: str, points: str
) -> None:
    """Write the description of a grid.

    Parameters
    ----------
    mesh
        The tetrahedra.
    path
        The XDMF file.
    grid
        :func:`elements` or :func:`facets`.
    numbers
        The HDF5 file with its numbers.
    points
        The HDF5 file with the points, that of the elements.
    """
    shown = grid(mesh)

    def item(file: str, what: str, values: Points | Cells | Labels) -> str:
        kind = "Float" if values.dtype == np.float64 else "Int"
        size = " ".join(map(str, values.shape))
        place = f"{escape(file)}:/{what}"
        return f'<DataItem Format="HDF" NumberType="{kind}" Precision="8" Dimensions="{size}">{place}</DataItem>'

    attributes = "".join(
        f'<Attribute Name="{name}" AttributeType="Scalar" Center="{place}">{item(numbers, what, shown.arrays[what])}</Attribute>\n'
        for (name, place), what in shown.data.items()
    )
    table = mesh.region_table()
    # the text is in the form in which meshio reads names of tags: key, dimension, number
    names = "".join(f'<map key="{row.name}" dim="3">{row.region}</map>' for row in table)
    regions = quoteattr(json.dumps([asdict(row) for row in table]))
    information = f'<Information Name="regions" Value={regions}><![CDATA[<main>{names}</main>]]></Information>\n'
    cells = shown.arrays[shown.cells]
    count, nodes = cells.shape
    path.write_text(
        f"""<?xml version="1.0"?>
<Xdmf Version="3.0"><Domain><Grid Name="{shown.name}" GridType="Uniform">
<Geometry GeometryType="XYZ">{item(points, "points", mesh.points)}</Geometry>
<Topology TopologyType="{_KINDS[nodes]}" NumberOfElements="{count}">{item(numbers, shown.cells, cells)}</Topology>
{attributes}{information}</Grid></Domain></Xdmf>
""",
        encoding="utf-8",
    )
