"""Writes Gmsh 4.1 and 2.2, and MED, with regions and parts of the boundary as groups.

Gmsh 4.1 gets the fields of the elements as views. MED also gets those of the points. meshio needs a
value for each element of a file, so a boundary face gets that of the element behind it. Gmsh 4.1
gets no fields of points, because meshio mixes them up. Gmsh 2.2 gets no fields, because meshio
cannot read them.

meshio writes 2.2 and MED (Salome, Code_Aster). It is not used for 4.1: it omits an entity if all
its nodes belong to other entities, and Gmsh refuses such a file.
"""

from __future__ import annotations

from itertools import count
from pathlib import Path
from struct import pack

import h5py
import meshio
import numpy as np

from tetmesh_check.export.mesh import Block, MarkedMesh, NamedSet, numbered_sets
from tetmesh_check.quality import Cells, Labels, Values

_KIND = {"triangle": 2, "triangle6": 9, "quad": 3, "tetra": 4, "tetra10": 11, "wedge": 6}
"""Gmsh's number of each kind."""
_GMSH_NODES = {"tetra10": [0, 1, 2, 3, 4, 5, 6, 7, 9, 8]}
"""Nodes in the order of Gmsh, which exchanges the last two nodes of VTK."""
_MED_NODES = {"tetra": [0, 2, 1, 3], "tetra10": [0, 2, 1, 3, 6, 5, 4, 7, 9, 8], "wedge": [0, 2, 1, 3, 5, 4]}
"""Nodes in the order of MED: its elements (but not its faces) are wound the other way, and the
nodes on the edges follow."""


def _comment(mesh: MarkedMesh) -> str:
    return f"isoparticles; {mesh.frame}"


def _comments(mesh: MarkedMesh, parts: list[NamedSet]) -> str:
    """Return the comments of a file, with the numbers of the parts of each union."""
    numbers = {part.number: own.number for part, own in zip(mesh.part_sets, parts, strict=True)}
    lines = [
        f"set {name}: {' '.join(str(numbers[mark]) for mark in sorted(marks) if mark in numbers)}"
        for name, marks in mesh.unions.items()
    ]
    return "\n".join([_comment(mesh), *lines])


def _numbers(sets: list[NamedSet], size: int) -> Labels:
    """Return the number of the set of each element or triangle."""
    numbers = np.zeros(size, dtype=np.int64)
    for own in sets:
        numbers[own.members] = own.number
    return numbers


def _ordered(block: Block, orders: dict[str, list[int]]) -> Cells:
    """Return the nodes of a block in the order of a format."""
    return block.nodes[:, orders[block.kind]] if block.kind in orders else block.nodes


def _fields(mesh: MarkedMesh, elements: Labels) -> dict[str, Values]:
    """Return the fields of some elements by name; NaN for :data:`.NOBODY`, the last index."""
    return {
        name: np.concatenate([values, np.full_like(values[:1], np.nan)])[elements]
        for name, values in mesh.fields.items()
    }


def _meshio(
    mesh: MarkedMesh, orders: dict[str, list[int]], regions: list[NamedSet], parts: list[NamedSet], tags: list[str]
) -> meshio.Mesh:
    """Return elements and boundary, with the numbers of their sets under each tag."""
    cells, numbers = [], []
    for blocks, sets, size in ((mesh.elements_of(), regions, mesh.regions), (mesh.faces_of(), parts, mesh.marks)):
        of_all = _numbers(sets, len(size))
        cells += [(block.kind, _ordered(block, orders)) for block in blocks]
        numbers += [of_all[block.members] for block in blocks]
    return meshio.Mesh(mesh.points, cells, cell_data=dict.fromkeys(tags, numbers))


def write_med(mesh: MarkedMesh, path: Path) -> None:
    """Write elements and boundary as groups. Sets have the same names in other formats.

    Parameters
    ----------
    mesh
        The tetrahedra.
    path
        The file.
    """
    # in MED, a family of elements has a negative number, and the names of its groups
    families = count(-1, -1)
    regions, parts = (
        [own._replace(number=next(families)) for own in sets] for sets in (mesh.region_sets, mesh.part_sets)
    )
    groups = {own.number: [own.name] for own in regions}
    for part, own in zip(mesh.part_sets, parts, strict=True):
        groups[own.number] = [part.name, *mesh.unions_of(part.number)]
    made = _meshio(mesh, _MED_NODES, regions, parts, ["cell_tags"])
    made.cell_tags = groups
    made.point_data = mesh.point_fields
    ends = np.cumsum([len(block.data) for block in made.cells])[:-1]
    for name, values in _fields(mesh, np.concatenate([np.arange(len(mesh.regions)), mesh.owners])).items():
        made.cell_data[name] = np.split(values, ends)
    # meshio would otherwise choose the format by the name of the file
    meshio.write(path, made, file_format="med")
    with h5py.File(path, "r+") as file:
        file["ENS_MAA/mesh"].attrs["DES"] = np.bytes_(_comment(mesh))
        for field in file["CHA"].values():
            # meshio writes one name, and the MED library expects one for each component
            names = "XYZ" if field.attrs["NCO"] == 3 else " "
            field.attrs["NOM"] = np.bytes_("".join(f"{name:<16}" for name in names))


def write_simnibs(mesh: MarkedMesh, path: Path) -> None:
    """Write version 2.2, binary, with the triangles first, as SimNIBS does.

    Parameters
    ----------
    mesh
        Linear tetrahedra, with the numbers of SimNIBS.
    path
        The file.
    """
    regions, parts, _ = numbered_sets(mesh)
    cells = [("triangle", mesh.faces), ("tetra", mesh.elements)]
    numbers = [_numbers(parts, len(mesh.faces)), _numbers(regions, len(mesh.elements))]
    made = meshio.Mesh(mesh.points, cells, cell_data=dict.fromkeys(("gmsh:physical", "gmsh:geometrical"), numbers))
    _write_msh2(mesh, made, (regions, parts), path, binary=True)


def write_msh2(mesh: MarkedMesh, path: Path) -> None:
    """Write version 2.2, as text. More programs read it than 4.1.

    An element has only one group there, so the comments list the groups of each union.

    Parameters
    ----------
    mesh
        The tetrahedra.
    path
        The file.
    """
    regions, parts, _ = numbered_sets(mesh)
    made = _meshio(mesh, {}, regions, parts, ["gmsh:physical", "gmsh:geometrical"])
    _write_msh2(mesh, made, (regions, parts), path, binary=False)


def _write_msh2(
    mesh: MarkedMesh, made: meshio.Mesh, sets_of: tuple[list[NamedSet], list[NamedSet]], path: Path, binary: bool
) -> None:
    """Write a mesh of meshio with the names of the sets and a comment."""
    for dimension, sets in zip((3, 2), sets_of, strict=True):
        made.field_data.update({own.name: np.array([own.number, dimension]) for own in sets})
    meshio.write(path, made, file_format="gmsh22", binary=binary)
    # some programs skip unknown sections only if they precede the nodes
    header, end, rest = path.read_bytes().partition(b"$EndMeshFormat\n")
    comment = f"$Comments\n{_comments(mesh, sets_of[1])}\n$EndComments\n".encode()
    path.write_bytes(header + end + comment + rest)


def write_msh(mesh: MarkedMesh, path: Path) -> None:
    """Write version 4.1, binary: an entity and a group for each region and boundary part.

    The entities have no bounding entities. Nodes are numbered like the points, from 1. Each one is
    listed with the first entity that uses it. A union is a group of the entities of its parts. Its
    number is above theirs, because dolfinx keeps only the smallest number of a triangle, and the
    comments list its parts.

    Parameters
    ----------
    mesh
        The tetrahedra.
    path
        The file.
    """
    regions, parts, unions = numbered_sets(mesh)
    sets = [(2, own, mesh.faces_of(own.members)) for own in parts]
    sets += [(3, own, mesh.elements_of(own.members)) for own in regions]
    names = [f'{dimension} {own.number} "{own.name}"' for dimension, own, _ in sets]
    names += [f'2 {own.number} "{own.name}"' for own in unions]
    number_of = {own.name: own.number for own in unions}
    more = [[number_of[name] for name in mesh.unions_of(part.number)] for part in mesh.part_sets]
    more += [[] for _ in regions]
    entities = [pack("<4Q", 0, 0, len(parts), len(regions))]
    nodes: list[bytes] = []
    cells_of: list[bytes] = []
    elements: list[Labels] = []
    is_left, first, count = np.ones(len(mesh.points), dtype=bool), 1, 0
    for (dimension, own, blocks), further in zip(sets, more, strict=True):
        used = np.unique(np.concatenate([block.nodes.ravel() for block in blocks]))
        corners = mesh.points[used]
        box = np.concatenate([corners.min(axis=0), corners.max(axis=0)])
        groups = [own.number, *further]
        entities.append(pack(f"<i6dQ{len(groups)}iQ", own.number, *box, len(groups), *groups, 0))
        used = used[is_left[used]]
        is_left[used] = False
        nodes += [pack("<3iQ", dimension, own.number, 0, len(used)), _whole(used + 1), mesh.points[used].tobytes()]
        for block in blocks:
            rows = np.column_stack([np.arange(first, first + len(block.nodes)), _ordered(block, _GMSH_NODES) + 1])
            cells_of += [pack("<3iQ", dimension, own.number, _KIND[block.kind], len(rows)), _whole(rows)]
            elements.append(block.members if dimension == 3 else mesh.owners[block.members])
            first += len(rows)
            count += 1
    sections = [
        ("MeshFormat", [b"4.1 1 8\n", pack("<i", 1)]),
        ("Comments", [_comments(mesh, parts).encode()]),
        ("PhysicalNames", ["\n".join([str(len(names)), *names]).encode()]),
        ("Entities", entities),
        ("Nodes", [pack("<4Q", len(sets), int((~is_left).sum()), 1, len(mesh.points)), *nodes]),
        ("Elements", [pack("<4Q", count, first - 1, 1, first - 1), *cells_of]),
    ]
    views = _fields(mesh, np.concatenate(elements)).items()
    sections += [("ElementData", _view(name, values)) for name, values in views]
    with path.open("wb") as file:
        for name, body in sections:
            file.writelines([f"${name}\n".encode(), *body, f"\n$End{name}\n".encode()])


def _view(name: str, values: Values) -> list[bytes]:
    """Return the values of all elements of a file, which are numbered from 1."""
    rows = values.reshape(len(values), -1)
    table = np.empty(len(rows), dtype=[("number", "<i4"), ("values", "<f8", (rows.shape[1],))])
    table["number"], table["values"] = np.arange(1, len(rows) + 1), rows
    # one text, the name; one real number, the time; three whole numbers: step, components, rows
    return [f'1\n"{name}"\n1\n0\n3\n0\n{rows.shape[1]}\n{len(rows)}\n'.encode(), table.tobytes()]


def _whole(numbers: Cells | Labels) -> bytes:
    return numbers.astype(np.uint64).tobytes()
