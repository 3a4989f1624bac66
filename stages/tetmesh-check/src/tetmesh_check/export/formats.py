"""Writes each export format: binary files with functions, text files with templates."""

from __future__ import annotations

import csv
from collections.abc import Callable, Iterable
from dataclasses import replace
from functools import partial
from io import StringIO
from pathlib import Path
from xml.sax.saxutils import quoteattr

import h5py
import numpy as np
from jinja2 import Environment, PackageLoader, StrictUndefined

from tetmesh_check.export.cards import in_units
from tetmesh_check.export.gmsh import write_med, write_msh, write_msh2, write_simnibs
from tetmesh_check.export.mesh import Block, MarkedMesh, numbered_sets
from tetmesh_check.export.vtk import write_boundary, write_legacy, write_simvascular_faces, write_simvascular_volume
from tetmesh_check.files import write_atomically
from tetmesh_check.quality import Cells, Labels, Points, Values

Writer = Callable[[MarkedMesh, Path], None]


def _regions_csv(mesh: MarkedMesh, path: Path) -> None:
    """Write the table of regions, one row per region; labels are separated by spaces."""
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.DictWriter(file, ("region", "name", "material", "labels"), lineterminator="\n")
        writer.writeheader()
        writer.writerows({**row, "labels": " ".join(map(str, row["labels"]))} for row in mesh.table)


def _rows(form: str, *columns: Points | Cells | Labels) -> str:
    """Format rows of numbers, one per line, without a line break at the end."""
    text = StringIO()
    np.savetxt(text, np.column_stack(columns), form)
    return text.getvalue().removesuffix("\n")


def _members(members: Labels) -> str:
    """Format the numbers of the members of a set, sixteen per line, the maximum of Abaqus."""
    numbers = (members + 1).tolist()
    return ",\n".join(", ".join(map(str, numbers[at : at + 16])) for at in range(0, len(numbers), 16))


def _cards(numbers: Labels, width: int, first: str = "", other: str = "") -> str:
    """Format numbers in fields of this width, eight per line.

    ``first`` precedes the first line, and ``other`` each of the other lines.
    """
    fields = [f"{number:{width}d}" for number in numbers.tolist()]
    lines = ["".join(fields[at : at + 8]) for at in range(0, len(fields), 8)]
    return first + f"\n{other}".join(lines)


_ABAQUS_FACES = {
    "tetra": ((0, 1, 2), (0, 3, 1), (1, 3, 2), (2, 3, 0)),
    "wedge": ((0, 1, 2), (3, 5, 4), (0, 1, 4, 3), (1, 2, 5, 4), (2, 0, 3, 5)),
}
"""Corners of the faces S1, S2, ... of a C3D4 or C3D10, and of a C3D6."""


def _element_faces(mesh: MarkedMesh, members: Labels) -> Cells:
    """Return the element behind each face, and the number of its face in Abaqus."""
    found = []
    for faces in mesh.faces_of(members):
        corners = faces.nodes[:, :4] if faces.kind == "quad" else faces.nodes[:, :3]
        owners = mesh.owners[faces.members]
        for kind, first, cells in (("tetra", 0, mesh.tetrahedra), ("wedge", len(mesh.elements), mesh.prisms)):
            own = np.flatnonzero((owners >= first) & (owners < first + len(cells)))
            is_on = (cells[owners[own] - first][:, :, None] == corners[own][:, None, :]).any(axis=2)
            sides = [is_on[:, side].all(axis=1) for side in _ABAQUS_FACES[kind]]
            found.append(np.column_stack([owners[own] + 1, 1 + np.argmax(sides, axis=0)]))
    return np.concatenate(found)


_TEMPLATES = Environment(
    loader=PackageLoader("tetmesh_check.export"),
    undefined=StrictUndefined,
    trim_blocks=True,
    lstrip_blocks=True,
    keep_trailing_newline=True,
)
_TEMPLATES.globals.update(
    rows=_rows, members=_members, cards=_cards, element_faces=_element_faces, numbered_sets=numbered_sets, np=np,
    quoteattr=quoteattr,
)  # fmt: skip


def _text(mesh: MarkedMesh, path: Path, template: str, **values: object) -> None:
    path.write_text(_TEMPLATES.get_template(template).render(mesh=mesh, **values), encoding="utf-8")


def _texts(*templates: str) -> dict[str, Writer]:
    return {template: partial(_text, template=template) for template in templates}


def _nodes(mesh: MarkedMesh, path: Path, part: str) -> None:
    """Write the nodes of a part or union for openCARP, numbered from 0 as in ``.pts``."""
    own = next(own for own in mesh.named_sets if own.name == part)
    _text(mesh, path, "nodes.vtx", nodes=mesh.nodes_of(own.members))


def _face(mesh: MarkedMesh, path: Path, part: str) -> None:
    """Write a part or union for SimVascular."""
    own = next(own for own in mesh.named_sets if own.name == part)
    write_simvascular_faces(mesh, path, own.members)


def _arrays(mesh: MarkedMesh, stem: str) -> dict[str, Points | Cells | Labels | Values]:
    """Return the arrays of an XDMF file by name.

    The boundary uses the points of the volume: FEniCS reads the triangles as tags of facets. For
    each union, there is an array that is 1 on its triangles.
    """

    def cells(blocks: list[Block]) -> Cells | Labels:
        """Return the nodes of one kind, or of several kinds, each after its number in XDMF."""
        if len(blocks) == 1:
            return blocks[0].nodes
        rows = [np.insert(block.nodes, 0, _XDMF_KINDS[block.kind], axis=1).ravel() for block in blocks]
        return np.concatenate(rows)

    if stem != "volume":
        flags = {name: np.isin(mesh.marks, sorted(marks)).astype(np.int64) for name, marks in mesh.unions.items()}
        return {"triangles": cells(mesh.faces_of()), "mark" if mesh.materials is None else "pair": mesh.marks, **flags}
    return {
        "points": mesh.points,
        "elements": cells(mesh.elements_of()),
        "region": mesh.regions,
        "boundary": mesh.point_marks(),
        **mesh.fields,
        **mesh.point_fields,
    }


def _numbers(mesh: MarkedMesh, path: Path, stem: str) -> None:
    with h5py.File(path, "w") as file:
        file.update(_arrays(mesh, stem))


def _description(mesh: MarkedMesh, path: Path, stem: str, name: str) -> None:
    _text(mesh, path, "grid.xdmf", stem=stem, name=name, arrays=_arrays(mesh, stem))


_XDMF_KINDS = {"triangle": 4, "quad": 5, "tetra": 6, "wedge": 8}
"""Number of each kind in an XDMF topology of several kinds."""

_WRITE: dict[str, dict[str, Writer]] = {
    "inp": _texts("volume.inp"),
    "k": _texts("volume.k"),
    "bdf": _texts("volume.bdf"),
    "msh": {"volume.msh": write_msh},
    "msh2": {"volume.msh2": write_msh2},
    "med": {"volume.med": write_med},
    "simnibs": {"volume.msh": write_simnibs},
    "vtp": {"boundary.vtp": write_boundary},
    "vtk": {"volume.vtk": write_legacy},
    "feb": _texts("volume.feb"),
    "carp": _texts("volume.pts", "volume.elem", "volume.lon"),
    "simvascular": {
        "volume.mesh-complete.mesh.vtu": write_simvascular_volume,
        "volume.mesh-complete.exterior.vtp": lambda mesh, path: write_simvascular_faces(
            mesh, path, np.flatnonzero(mesh.outermost)
        ),
        "volume.mesh-complete.walls_combined.vtp": lambda mesh, path: write_simvascular_faces(
            mesh, path, np.flatnonzero(mesh.outermost & ~mesh.is_cap)
        ),
    },
}
"""For each format, the files (without ``NAME.``) and the functions that write them. :func:`_files`
adds XDMF, the files of parts and unions and the table of regions. ``pipelines/case/src/folder.rs``
recognizes the results of this stage by the beginnings ``volume`` and ``boundary``."""

_PER_MM = {"mm": 1.0, "m": 1e-3, "um": 1e3}


def _files(name: str, kind: str, many: bool, parts: Iterable[str]) -> dict[str, Writer]:
    written = dict(_WRITE.get(kind, {}))
    if kind == "carp":
        written.update({f"volume.{part}.vtx": partial(_nodes, part=part) for part in parts})
    if kind == "simvascular":
        faces = {f"volume.mesh-complete.mesh-surfaces.{part}.vtp": partial(_face, part=part) for part in parts}
        written.update(faces)
    if kind == "xdmf":
        for stem in ("volume", f"volume.{'interfaces' if many else 'boundary'}"):
            # FEniCS opens the HDF5 file that has the name of the XDMF file
            written[f"{stem}.h5"] = partial(_numbers, stem=stem)
            written[f"{stem}.xdmf"] = partial(_description, stem=stem, name=name)
    return written | {"volume.regions.csv": _regions_csv}


def export_paths(
    output: Path, name: str, kinds: tuple[str, ...], many: bool = False, parts: Iterable[str] = ()
) -> list[Path]:
    """Return the files of some formats, without duplicates, in the folder of the volume mesh.

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
    parts
        Names of the parts and unions, if known.
    """
    endings = dict.fromkeys(ending for kind in kinds for ending in _files(name, kind, many, parts))
    return [output.with_name(f"{name}.{ending}") for ending in endings]


def export(mesh: MarkedMesh, output: Path, name: str, kind: str, unit: str = "mm") -> None:
    """Write the mesh in one format. Each file is written atomically.

    Parameters
    ----------
    mesh
        The tetrahedra.
    output
        The volume mesh; the files are written to its folder.
    name
        Name of the case.
    kind
        One of :data:`.FORMATS`, or of the formats of a profile.
    unit
        Unit of the coordinates: ``mm``, ``m`` or ``um``. openCARP files are always in micrometres.
    """
    unit = "um" if kind == "carp" else unit
    scaled = in_units(replace(mesh, points=mesh.shown * _PER_MM[unit]), unit)
    parts = [own.name for own in mesh.named_sets]
    for ending, write in _files(name, kind, mesh.materials is not None, parts).items():
        write_atomically(output.with_name(f"{name}.{ending}"), partial(write, scaled))
