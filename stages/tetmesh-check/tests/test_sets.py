"""Tests of sets in exported files, with readers of other programs where there are any."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import meshio
import numpy as np
import pytest
import pyvista as pv
from complexes import nested_balls
from conftest import NEEDS_HXT, Run
from test_decks import keywords, whole
from test_regions import marked_block

from tetmesh_check.datasets import text_of
from tetmesh_check.export.formats import export, export_paths
from tetmesh_check.export.mesh import MarkedMesh, numbered_sets
from tetmesh_check.parsing import FORMATS
from tetmesh_check.regions import CAP, SURFACE


def mesh_with_sets() -> MarkedMesh:
    """A block with a cap; the set ``inlet`` is the cap, ``both`` is the whole boundary."""
    return replace(marked_block(), unions={"inlet": frozenset([CAP]), "both": frozenset([SURFACE, CAP])})


def written(folder: Path, kind: str) -> MarkedMesh:
    mesh = mesh_with_sets()
    export(mesh, folder / "b.volume.vtu", "b", kind)
    return mesh


def members(mesh: MarkedMesh) -> dict[str, np.ndarray]:
    """Return the triangles of every part and set."""
    every = np.arange(len(mesh.marks))
    cap = np.flatnonzero(mesh.marks == CAP)
    return {"surface": np.setdiff1d(every, cap), "cap": cap, "inlet": cap, "both": every}


def test_unions_are_numbered_after_the_parts() -> None:
    mesh = mesh_with_sets()
    _, parts, unions = numbered_sets(mesh)
    assert [(own.name, own.number) for own in (*parts, *unions)] == [
        ("surface", 11), ("cap", 12), ("inlet", 13), ("both", 14),
    ]  # fmt: skip
    for own in (*parts, *unions):
        np.testing.assert_array_equal(own.members, members(mesh)[own.name])


def test_abaqus_has_a_surface_and_nodes_for_each_set(tmp_path: Path) -> None:
    mesh = written(tmp_path, "inp")
    nodes = meshio.read(tmp_path / "b.volume.inp").point_sets
    text = (tmp_path / "b.volume.inp").read_text()
    for name, own in members(mesh).items():
        np.testing.assert_array_equal(np.sort(nodes[name.upper()]), np.unique(mesh.boundary[own]))
        block = re.search(rf"\*SURFACE, NAME={name.upper()}, TYPE=ELEMENT\n([^*]*)", text)
        assert block is not None
        elements = [int(line.split(",")[0]) - 1 for line in block[1].splitlines()]
        np.testing.assert_array_equal(elements, mesh.owners[own])


def test_ls_dyna_has_segments_and_nodes_for_each_set(tmp_path: Path) -> None:
    mesh = written(tmp_path, "k")
    for kind, width in (("SET_SEGMENT_TITLE", 4), ("SET_NODE_LIST_TITLE", 1)):
        found = {cards[0]: cards[1:] for name, cards in keywords(tmp_path / "b.volume.k") if name == kind}
        assert list(found) == ["surface", "cap", "inlet", "both"]
        assert len({int(cards[0]) for cards in found.values()}) == 4
        for name, own in members(mesh).items():
            numbers = np.reshape(whole(found[name][1:], 10), (-1, width)) - 1
            expected = (
                mesh.boundary[own].take([0, 1, 2, 2], 1) if width == 4 else np.unique(mesh.boundary[own])[:, None]
            )
            np.testing.assert_array_equal(numbers, expected)


def test_nastran_has_a_node_set_for_each_set(tmp_path: Path) -> None:
    mesh = written(tmp_path, "bdf")
    text = (tmp_path / "b.volume.bdf").read_text()
    assert len(meshio.read(tmp_path / "b.volume.bdf").cells_dict["triangle"]) == len(mesh.boundary)
    numbers = {name: number for number, name in re.findall(r"\$ set (\d+): (\w+)\n", text)}
    assert numbers == {"inlet": "13", "both": "14"}
    for name, number in numbers.items():
        (card,) = re.findall(rf"SET1    ({int(number):8d}.*\n(?:\+.*\n)*)", text)
        nodes = whole(card.replace("+       ", "").splitlines(), 8)[1:]
        np.testing.assert_array_equal(np.array(nodes) - 1, np.unique(mesh.boundary[members(mesh)[name]]))


def test_febio_has_a_surface_for_each_set(tmp_path: Path) -> None:
    mesh = written(tmp_path, "feb")
    root = ElementTree.parse(tmp_path / "b.volume.feb").getroot()
    found = {
        surface.get("name"): [[int(n) - 1 for n in (face.text or "").split(",")] for face in surface]
        for surface in root.iterfind("Mesh/Surface")
    }
    for name, own in members(mesh).items():
        np.testing.assert_array_equal(found[name], mesh.boundary[own])


GMSH = """
import gmsh, json, sys
gmsh.initialize(interruptible=False)
gmsh.option.setNumber("General.Terminal", 0)
gmsh.open(sys.argv[1])
found = {}
for dimension, tag in gmsh.model.getPhysicalGroups(2):
    nodes = [gmsh.model.mesh.getElements(2, e)[2][0] for e in gmsh.model.getEntitiesForPhysicalGroup(2, tag)]
    found[gmsh.model.getPhysicalName(2, tag)] = [int(n) for of in nodes for n in of]
print(json.dumps([gmsh.model.mesh.getNodes()[0].tolist(), gmsh.model.mesh.getNodes()[1].tolist(), found]))
"""


@NEEDS_HXT
@pytest.mark.parametrize("kind", ["msh", "med"])
def test_gmsh_finds_a_group_for_each_set(tmp_path: Path, kind: str) -> None:
    mesh = written(tmp_path, kind)
    command = [sys.executable, "-c", GMSH, f"b.volume.{kind}"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=True)
    numbers, points, groups = json.loads(done.stdout)
    at = np.empty((max(numbers) + 1, 3))
    at[numbers] = np.reshape(points, (-1, 3))
    for name, own in members(mesh).items():
        found = at[np.reshape(groups[name], (-1, 3))].mean(axis=1)
        expected = mesh.points[mesh.boundary[own]].mean(axis=1)
        found, expected = (np.round(centres, 9) for centres in (found, expected))
        np.testing.assert_array_equal(found[np.lexsort(found.T)], expected[np.lexsort(expected.T)])


def test_med_families_name_parts_and_sets(tmp_path: Path) -> None:
    mesh = written(tmp_path, "med")
    again = meshio.read(tmp_path / "b.volume.med")
    tags = again.cell_data_dict["cell_tags"]["triangle"]
    for name, own in members(mesh).items():
        families = [tag for tag, names in again.cell_tags.items() if name in names]
        np.testing.assert_array_equal(np.flatnonzero(np.isin(tags, families)), own)


def test_gmsh_files_list_the_parts_of_each_set(tmp_path: Path) -> None:
    for kind in ("msh", "msh2"):
        written(tmp_path, kind)
        assert b"\nset inlet: 12\nset both: 11 12\n" in (tmp_path / f"b.volume.{kind}").read_bytes()
    again = meshio.read(tmp_path / "b.volume.msh2", "gmsh")
    assert sorted(again.field_data) == ["cap", "region_2", "region_5", "surface"]


def test_xdmf_has_tags_and_an_array_for_each_set(tmp_path: Path) -> None:
    mesh = written(tmp_path, "xdmf")
    again = meshio.read(tmp_path / "b.volume.boundary.xdmf")
    marks = again.cell_data_dict["mark"]["triangle"]
    assert next(iter(again.cell_data)) == "mark", "FEniCS reads the first array"
    for name, own in members(mesh).items():
        if name in mesh.unions:
            np.testing.assert_array_equal(np.flatnonzero(again.cell_data_dict[name]["triangle"]), own)
        else:
            number, dimension = again.field_data[name].tolist()
            assert dimension == 2
            np.testing.assert_array_equal(np.flatnonzero(marks == number), own)


def test_vtk_files_have_an_array_for_each_set(tmp_path: Path) -> None:
    for kind in ("vtp", "vtk"):
        mesh = written(tmp_path, kind)
    surface, grid = pv.read(tmp_path / "b.boundary.vtp"), pv.read(tmp_path / "b.volume.vtk")
    assert json.loads(text_of(surface, "parts") or "") == {"1": "surface", "2": "cap"}
    for name in mesh.unions:
        own = members(mesh)[name]
        np.testing.assert_array_equal(np.flatnonzero(surface.cell_data[name]), own)
        np.testing.assert_array_equal(np.flatnonzero(grid.point_data[name]), np.unique(mesh.boundary[own]))


def test_opencarp_has_nodes_for_each_set(tmp_path: Path) -> None:
    mesh = written(tmp_path, "carp")
    for name, own in members(mesh).items():
        count, domain, *nodes = (tmp_path / f"b.volume.{name}.vtx").read_text().split()
        assert (int(count), domain) == (len(nodes), "extra")
        np.testing.assert_array_equal(np.array(nodes, dtype=int), np.unique(mesh.boundary[own]))


def test_simvascular_finds_a_face_for_each_part_and_set(tmp_path: Path) -> None:
    mesh = written(tmp_path, "simvascular")
    volume = pv.read(tmp_path / "b.volume.mesh-complete.mesh.vtu")
    nodes, elements = np.asarray(volume.point_data["GlobalNodeID"]), np.asarray(volume.cell_data["GlobalElementID"])
    cells = np.asarray(volume.cells_dict[10])
    faces = {name: f"mesh-surfaces.{name}" for name in members(mesh)} | {"walls": "walls_combined", "all": "exterior"}
    expected = members(mesh) | {"walls": members(mesh)["surface"], "all": members(mesh)["both"]}
    for name, ending in faces.items():
        face, own = pv.read(tmp_path / f"b.volume.mesh-complete.{ending}.vtp"), expected[name]
        for data, array in (("point_data", "GlobalNodeID"), ("cell_data", "GlobalElementID")):
            # SimVascular casts these arrays to vtkIntArray
            assert getattr(face, data)[array].dtype == np.int32
        # as svMultiPhysics does, find the points of the face in the volume, bit for bit
        at = np.searchsorted(nodes, face.point_data["GlobalNodeID"])
        np.testing.assert_array_equal(volume.points[at], face.points)
        np.testing.assert_array_equal(at[np.asarray(face.regular_faces)], mesh.boundary[own])
        owners = np.searchsorted(elements, face.cell_data["GlobalElementID"])
        for triangle, owner in zip(mesh.boundary[own], owners, strict=True):
            assert set(triangle) <= set(cells[owner])
        np.testing.assert_array_equal(face.cell_data["ModelFaceID"], mesh.marks[own])
        np.testing.assert_array_equal(face.cell_data["ModelRegionID"], mesh.regions[mesh.owners[own]])


def test_the_files_of_sets_are_known_before_they_are_written(tmp_path: Path) -> None:
    mesh = mesh_with_sets()
    names = [own.name for own in mesh.named_sets]
    export_paths_of = export_paths(tmp_path / "b.volume.vtu", "b", FORMATS, False, names)
    for kind in FORMATS:
        export(mesh, tmp_path / "b.volume.vtu", "b", kind)
    assert sorted(tmp_path.iterdir()) == sorted(export_paths_of)


def test_a_set_without_triangles_is_in_no_file(tmp_path: Path) -> None:
    # fTetWild may lose a small part
    mesh = replace(mesh_with_sets(), marks=np.full(len(marked_block().marks), SURFACE))
    for kind in FORMATS:
        export(mesh, tmp_path / "b.volume.vtu", "b", kind)
    assert not list(tmp_path.glob("*inlet*"))
    assert "INLET" not in (tmp_path / "b.volume.inp").read_text()
    assert "inlet" not in meshio.read(tmp_path / "b.volume.msh").field_data


@NEEDS_HXT
def test_simvascular_gets_its_files_from_the_command_line(tmp_path: Path, run: Run) -> None:
    nested_balls((9.0, 5.0), (2, 2), ("wall", "lumen")).save(tmp_path / "s.vtp")
    words = ["--for", "simvascular", "--set", "inside=wall/lumen", "--method", "hxt", "--solve", "no", "-q"]
    done = run("s.vtp", "-o", "v.volume.vtu", *words, "--report", "r.json")
    assert done.returncode == 0, done.stderr
    listed = json.loads((tmp_path / "r.json").read_text())["results"]["exports"]
    assert sorted(name.removeprefix("v.volume.mesh-complete.") for name in listed) == [
        "exterior.vtp", "mesh-surfaces.inside.vtp", "mesh-surfaces.lumen_to_wall.vtp",
        "mesh-surfaces.wall_to_outside.vtp", "mesh.vtu", "v.volume.regions.csv", "walls_combined.vtp",
    ]  # fmt: skip
    assert all((tmp_path / name).exists() for name in listed)
