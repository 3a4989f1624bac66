"""Gmsh 4.1 and 2.2: regions and parts of the boundary as physical groups.

4.1 is written by hand, because meshio leaves out an entity all of whose nodes belong to another,
and Gmsh refuses such a file.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import meshio
import numpy as np

if TYPE_CHECKING:
    from tetmesh_check.export.mesh import MarkedMesh
    from tetmesh_check.quality import Cells, Labels

_KIND = {3: 2, 6: 9, 4: 4, 10: 11}
"""Gmsh's number of a triangle or tetrahedron, by its nodes."""
_NODES = np.array([0, 1, 2, 3, 4, 5, 6, 7, 9, 8])
"""Nodes of a tetrahedron in the order of Gmsh, which exchanges the last two nodes of VTK."""


def _numbers(mesh: MarkedMesh) -> tuple[dict[int, str], Labels, dict[int, str], Labels]:
    """Numbers and names of the regions, the number of each tetrahedron; likewise of the boundary.

    Gmsh leaves out groups of a number below 1. Such a region has a number above all regions, and
    its name tells its label. The parts have numbers above those of the regions, because GetDP does
    not tell a region from a surface of its number: to each mark is added the first power of ten
    above all regions, so that with the one region 1 ``surface`` is 11 and ``cap`` 12.
    """
    labels, which = np.unique(mesh.regions, return_inverse=True)
    tags = labels.copy()
    below = labels < 1
    tags[below] = max(int(labels.max()), 0) + 1 + np.arange(below.sum())
    regions = {tag: mesh.region_name(label) for tag, label in zip(tags.tolist(), labels.tolist(), strict=True)}
    above = 10
    while above <= max(regions):
        above *= 10
    parts = {above + mark: mesh.mark_name(mark) for mark in np.unique(mesh.marks).tolist()}
    return regions, tags[which.ravel()], parts, above + mesh.marks


def write_msh2(mesh: MarkedMesh, path: Path) -> None:
    """Write version 2.2 as text, which more programs read than 4.1.

    Parameters
    ----------
    mesh
        The tetrahedra.
    path
        The file.
    """
    regions, of_tetrahedra, parts, of_faces = _numbers(mesh)
    tags = [of_tetrahedra.astype(np.int32), of_faces.astype(np.int32)]
    tetrahedron, triangle = mesh.kinds
    groups = {name: np.array([number, 3]) for number, name in regions.items()}
    groups.update({name: np.array([number, 2]) for number, name in parts.items()})
    made = meshio.Mesh(
        mesh.points,
        [(tetrahedron, mesh.elements.astype(np.int32)), (triangle, mesh.faces.astype(np.int32))],
        cell_data={"gmsh:physical": tags, "gmsh:geometrical": tags},
        field_data=groups,
    )
    meshio.write(path, made, file_format="gmsh22", binary=False)


def write_msh(mesh: MarkedMesh, path: Path) -> None:
    """Write version 4.1, binary: an entity and a group for each region and boundary part.

    Parameters
    ----------
    mesh
        The tetrahedra.
    path
        The file.
    """
    regions, of_tetrahedra, of_boundary, of_faces = _numbers(mesh)
    elements = mesh.elements[:, _NODES[: mesh.elements.shape[1]]]
    parts = [(2, number, mesh.faces[of_faces == number]) for number in of_boundary]
    parts += [(3, number, elements[of_tetrahedra == number]) for number in regions]
    names = [f'2 {number} "{name}"' for number, name in of_boundary.items()]
    names += [f'3 {number} "{name}"' for number, name in regions.items()]
    sections = {
        "MeshFormat": _text("4.1 1 8\n") + np.array([1], np.int32).tobytes() + b"\n",
        "PhysicalNames": _text("\n".join([str(len(names)), *names, ""])),
        "Entities": _entities(mesh, parts) + b"\n",
        "Nodes": _nodes(mesh, parts) + b"\n",
        "Elements": _elements(parts) + b"\n",
    }
    path.write_bytes(b"".join(_text(f"${name}\n") + body + _text(f"$End{name}\n") for name, body in sections.items()))


def _text(words: str) -> bytes:
    return words.encode("ascii")


def _sizes(*numbers: int) -> bytes:
    return np.array(numbers, np.uint64).tobytes()


def _tags(*numbers: int) -> bytes:
    return np.array(numbers, np.int32).tobytes()


def _entities(mesh: MarkedMesh, parts: list[tuple[int, int, Cells]]) -> bytes:
    """Each entity with its box and its physical group; without bounding entities."""
    dimensions = [dimension for dimension, _, _ in parts]
    written = [_sizes(0, 0, dimensions.count(2), dimensions.count(3))]
    for _, tag, cells in parts:
        corners = mesh.points[np.unique(cells)]
        box = np.concatenate([corners.min(axis=0), corners.max(axis=0)])
        written.append(_tags(tag) + box.tobytes() + _sizes(1) + _tags(tag) + _sizes(0))
    return b"".join(written)


def _nodes(mesh: MarkedMesh, parts: list[tuple[int, int, Cells]]) -> bytes:
    """The nodes, numbered from 1 as the points are, each with the first entity that has it."""
    left = np.ones(len(mesh.points), dtype=bool)
    blocks: list[tuple[int, int, Labels]] = []
    for dimension, tag, cells in parts:
        used = np.unique(cells)
        used = used[left[used]]
        left[used] = False
        blocks.append((dimension, tag, used))
    written = [_sizes(len(blocks), int((~left).sum()), 1, len(mesh.points))]
    for dimension, tag, used in blocks:
        written.append(_tags(dimension, tag, 0) + _sizes(len(used)))
        written.append((used + 1).astype(np.uint64).tobytes() + mesh.points[used].tobytes())
    return b"".join(written)


def _elements(parts: list[tuple[int, int, Cells]]) -> bytes:
    total = sum(len(cells) for _, _, cells in parts)
    written = [_sizes(len(parts), total, 1, total)]
    first = 1
    for dimension, tag, cells in parts:
        written.append(_tags(dimension, tag, _KIND[cells.shape[1]]) + _sizes(len(cells)))
        numbers = np.arange(first, first + len(cells))
        written.append(np.column_stack([numbers, cells + 1]).astype(np.uint64).tobytes())
        first += len(cells)
    return b"".join(written)
