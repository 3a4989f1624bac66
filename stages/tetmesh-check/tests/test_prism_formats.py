"""Tests of files with prisms: each is read back, by another program where there is one."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import meshio
import numpy as np
import pytest
import pyvista as pv
from conftest import NEEDS_HXT
from test_decks import keywords, whole
from test_layers import layered, materials

from tetmesh_check.export.formats import export
from tetmesh_check.export.mesh import MarkedMesh
from tetmesh_check.export.vtk import write_volume
from tetmesh_check.prisms import FACES, jacobians, scaled_jacobian
from tetmesh_check.quality import tetrahedron_quality

CCX = shutil.which("ccx")


@pytest.fixture(scope="module")
def mesh() -> MarkedMesh:
    """Return two plates with layers of prisms in the cartilage, and a set of its boundary."""
    made = materials("cartilage:bone/cartilage=2,0.1,1.5")
    made_mesh = layered(made)[0]
    marks = frozenset(number for number, name in made_mesh.parts.items() if "cartilage" in name)
    return replace(made_mesh, unions={"around": marks})


def written(mesh: MarkedMesh, folder: Path, kind: str, ending: str = "") -> Path:
    """Write one format; return its file."""
    export(mesh, folder / "b.volume.vtu", "b", kind)
    return folder / f"b.{ending or f'volume.{kind}'}"


def faces_of(mesh: MarkedMesh, name: str) -> list[tuple[int, ...]]:
    """Return the sorted nodes of the faces of a part or set."""
    (own,) = (own for own in mesh.named_sets if own.name == name)
    return sorted(tuple(sorted(face)) for block in mesh.faces_of(own.members) for face in block.nodes.tolist())


def check_cells(read: meshio.Mesh, mesh: MarkedMesh, groups: dict[str, np.ndarray] | None = None) -> None:
    """Compare cells, in any order, and the number of the group of each."""
    expected = [(block, mesh.regions) for block in mesh.elements_of()] + [
        (block, mesh.marks) for block in mesh.faces_of()
    ]
    for block, numbers in expected:
        cells = read.cells_dict[block.kind]
        order, own = np.lexsort(cells.T), np.lexsort(block.nodes.T)
        np.testing.assert_array_equal(cells[order], block.nodes[own])
        if groups is not None:
            pairs = zip(groups[block.kind][order].tolist(), numbers[block.members][own].tolist(), strict=True)
            assert len(set(pairs)) == len(set(numbers[block.members].tolist()))


def test_meshio_reads_gmsh_2(mesh: MarkedMesh, tmp_path: Path) -> None:
    read = meshio.read(written(mesh, tmp_path, "msh2"), file_format="gmsh")
    check_cells(read, mesh, read.cell_data_dict["gmsh:physical"])


def test_meshio_reads_nastran(mesh: MarkedMesh, tmp_path: Path) -> None:
    path = written(mesh, tmp_path, "bdf")
    read = meshio.read(path)
    check_cells(read, mesh, read.cell_data_dict["nastran:ref"])
    numbers = np.concatenate(read.cells_id)
    assert len(set(numbers.tolist())) == len(numbers) == len(mesh.regions) + len(mesh.marks)
    assert all(len(line) <= 80 for line in path.read_text().splitlines())


def test_meshio_reads_xdmf(mesh: MarkedMesh, tmp_path: Path) -> None:
    volume = meshio.read(written(mesh, tmp_path, "xdmf"))
    interfaces = meshio.read(tmp_path / "b.volume.interfaces.xdmf")
    for block in mesh.elements_of():
        np.testing.assert_array_equal(volume.cells_dict[block.kind], block.nodes)
        np.testing.assert_array_equal(volume.cell_data_dict["region"][block.kind], mesh.regions[block.members])
    for block in mesh.faces_of():
        np.testing.assert_array_equal(interfaces.cells_dict[block.kind], block.nodes)
        np.testing.assert_array_equal(interfaces.cell_data_dict["pair"][block.kind], mesh.marks[block.members])


def test_abaqus_surfaces_have_faces_of_prisms(mesh: MarkedMesh, tmp_path: Path) -> None:
    path = written(mesh, tmp_path, "inp")
    read = meshio.read(path)
    for block in mesh.elements_of():
        np.testing.assert_array_equal(read.cells_dict[block.kind], block.nodes)
    # S1, S2, ... in the manual, with nodes from 1
    sides = {
        4: ((1, 2, 3), (1, 4, 2), (2, 4, 3), (3, 4, 1)),
        6: ((1, 2, 3), (4, 6, 5), (1, 4, 5, 2), (2, 5, 6, 3), (3, 6, 4, 1)),
    }
    elements = [*mesh.tetrahedra.tolist(), *mesh.prisms.tolist()]
    cards = {
        name.split("=")[1].split(",")[0]: rows for name, rows in keywords(path) if name.startswith("SURFACE, NAME")
    }
    for own in mesh.named_sets:
        found = []
        for row in cards[own.name.upper()]:
            number, side = row.split(", S")
            nodes = elements[int(number) - 1]
            found.append(tuple(sorted(nodes[corner - 1] for corner in sides[len(nodes)][int(side) - 1])))
        assert sorted(found) == faces_of(mesh, own.name)


@pytest.mark.skipif(CCX is None, reason="no CalculiX (Debian, Ubuntu: apt-get install calculix-ccx)")
def test_calculix_passes_the_patch_test_with_prisms(mesh: MarkedMesh, tmp_path: Path) -> None:
    # with linear displacements of the boundary, conforming linear elements have them inside as well
    path = written(mesh, tmp_path, "inp")
    gradient = 1e-3 * np.array([[1.0, 0.3, -0.2], [0.4, -0.5, 0.6], [-0.7, 0.2, 0.9]])
    expected = mesh.points @ gradient.T
    written_mesh = pv.read(written(mesh, tmp_path, "vtk"))
    surface = written_mesh.extract_surface(pass_pointid=True, algorithm="dataset_surface")
    boundary = np.unique(surface.point_data["vtkOriginalPointIds"])
    assert len(boundary) < 0.9 * len(mesh.points)
    moved = "\n".join(
        f"{node + 1}, {axis + 1}, {axis + 1}, {expected[node, axis]:.12g}" for node in boundary for axis in range(3)
    )
    (tmp_path / "job.inp").write_text(
        f"""*INCLUDE, INPUT={path.name}
*NSET, NSET=EVERY, GENERATE
1, {len(mesh.points)}
*MATERIAL, NAME=TISSUE
*ELASTIC
1.0, 0.3
*SOLID SECTION, ELSET=VOLUME, MATERIAL=TISSUE
*STEP
*STATIC
*BOUNDARY
{moved}
*NODE PRINT, NSET=EVERY
U
*END STEP
"""
    )
    subprocess.run([str(CCX), "job"], cwd=tmp_path, check=True, capture_output=True)
    rows = [line.split() for line in (tmp_path / "job.dat").read_text().splitlines()]
    found = {int(row[0]): row[1:] for row in rows if len(row) == 4 and row[0].isdigit()}
    values = np.array([found[node + 1] for node in range(len(mesh.points))], dtype=float)
    np.testing.assert_allclose(values, expected, atol=1e-6 * np.abs(expected).max())


def test_febio_has_prism_domains_with_the_material_of_the_region(mesh: MarkedMesh, tmp_path: Path) -> None:
    root = ElementTree.parse(written(mesh, tmp_path, "feb")).getroot()
    found = {group.get("name"): group for group in root.iterfind("Mesh/Elements")}
    assert {name: group.get("type") for name, group in found.items()} == {
        "bone": "tet4", "cartilage": "tet4", "cartilage_prisms": "penta6",
    }  # fmt: skip
    cells = [[int(word) - 1 for word in (row.text or "").split(",")] for row in found["cartilage_prisms"]]
    np.testing.assert_array_equal(cells, mesh.prisms)
    numbers = [int(row.get("id") or 0) for group in found.values() for row in group]
    assert numbers == list(range(1, len(mesh.regions) + 1))
    domains = {row.get("name"): row.get("mat") for row in root.iterfind("MeshDomains/SolidDomain")}
    assert domains == {"bone": "bone", "cartilage": "cartilage", "cartilage_prisms": "cartilage"}
    for surface in root.iterfind("Mesh/Surface"):
        rows = [(row.tag, tuple(sorted(int(word) - 1 for word in (row.text or "").split(",")))) for row in surface]
        assert sorted(nodes for _, nodes in rows) == faces_of(mesh, surface.get("name") or "")
        assert {tag: len(nodes) for tag, nodes in rows}.items() <= {"tri3": 3, "quad4": 4}.items()
        assert [int(row.get("id") or 0) for row in surface] == list(range(1, len(rows) + 1))


def test_ls_dyna_has_pentahedra_as_bricks_that_repeat_nodes(mesh: MarkedMesh, tmp_path: Path) -> None:
    found = keywords(written(mesh, tmp_path, "k"))
    rows = np.array([whole([card], 8) for name, cards in found if name == "ELEMENT_SOLID" for card in cards])
    bricks = rows[rows[:, 0] > len(mesh.tetrahedra), 2:] - 1
    # N1 N2 N3 N4 N5 N5 N6 N6 in the manual: its triangles are N1 N2 N5 and N4 N3 N6
    np.testing.assert_array_equal(bricks[:, [4, 6]], bricks[:, [5, 7]])
    one, two, three, four, five, six = bricks[:, [0, 1, 2, 3, 4, 6]].T
    np.testing.assert_array_equal(np.stack([two, one, five, three, four, six], 1), mesh.prisms)
    hexahedra = pv.UnstructuredGrid({pv.CellType.HEXAHEDRON: bricks}, mesh.points)
    assert np.asarray(hexahedra.compute_cell_sizes()["Volume"]) == pytest.approx(
        jacobians(mesh.points, mesh.prisms).sum(1) / 18.0
    )
    assert [cards for name, cards in found if name in ("CONTROL_SOLID", "SECTION_SOLID")] == [
        [f"{1:10d}"],
        [f"{1:10d}{1:10d}"],
    ]
    (segments,) = (cards for name, cards in found if name == "SET_SEGMENT_TITLE" and cards[0] == "around")
    read = sorted(
        tuple(sorted(set(row))) for row in (np.array([whole([card], 10) for card in segments[2:]]) - 1).tolist()
    )
    assert read == faces_of(mesh, "around")


def test_pyvista_reads_the_vtk_formats(mesh: MarkedMesh, tmp_path: Path) -> None:
    quality = tetrahedron_quality(mesh.points, mesh.tetrahedra)
    write_volume(tmp_path / "b.volume.vtu", mesh, quality._asdict(), {})
    count = len(mesh.tetrahedra)
    for path in (tmp_path / "b.volume.vtu", written(mesh, tmp_path, "vtk")):
        grid = pv.read(path)
        np.testing.assert_array_equal(grid.cells_dict[pv.CellType.WEDGE], mesh.prisms)
        np.testing.assert_array_equal(grid.cell_data["region"], mesh.regions)
        volumes = np.asarray(grid.compute_cell_sizes()["Volume"])
        assert volumes.min() > 0.0
        assert volumes.sum() == pytest.approx(144.0, rel=1e-12)
        wedge = grid.GetCell(count)
        faces = [
            [wedge.GetFace(k).GetPointId(i) for i in range(wedge.GetFace(k).GetNumberOfPoints())] for k in range(5)
        ]
        assert sorted(map(sorted, faces)) == sorted(sorted(mesh.prisms[0, list(side)].tolist()) for side in FACES)
    stored = pv.read(tmp_path / "b.volume.vtu").cell_data["scaled_jacobian"]
    np.testing.assert_allclose(stored, [*quality.scaled_jacobian, *scaled_jacobian(mesh.points, mesh.prisms)])
    boundary = pv.read(written(mesh, tmp_path, "vtp", "boundary.vtp"))
    np.testing.assert_array_equal(boundary.cell_data["mark"], mesh.marks)
    cells = [np.asarray(boundary.point_data["point"])[face].tolist() for face in boundary.irregular_faces]
    assert cells == [face for block in mesh.faces_of() for face in block.nodes.tolist()]


GMSH = """
import json, sys
import gmsh
gmsh.initialize()
told = {}
for path in ("b.volume.msh", "b.volume.med"):
    gmsh.open(path)
    groups = {gmsh.model.getPhysicalName(*group): group for group in gmsh.model.getPhysicalGroups()}
    tags, at, _ = gmsh.model.mesh.getNodes()
    positions = dict(zip(tags.tolist(), at.reshape(-1, 3).tolist()))
    kinds = {}
    for name, group in groups.items():
        for entity in gmsh.model.getEntitiesForPhysicalGroup(*group):
            for kind, numbers, nodes in zip(*gmsh.model.mesh.getElements(group[0], entity)):
                found = kinds.setdefault(str(kind), [0, 1e300, []])
                found[0] += len(numbers)
                if group[0] == 3:
                    found[1] = min(found[1], *gmsh.model.mesh.getElementQualities(numbers, "minDetJac"))
                if kind == 6:
                    found[2] += [positions[node] for node in nodes.tolist()]
    told[path] = {"kinds": kinds, "names": sorted(groups)}
print(json.dumps(told))
"""


@NEEDS_HXT
def test_gmsh_reads_its_format_and_med(mesh: MarkedMesh, tmp_path: Path) -> None:
    for kind in ("msh", "med"):
        written(mesh, tmp_path, kind)
    done = subprocess.run([sys.executable, "-c", GMSH], cwd=tmp_path, check=True, capture_output=True, text=True)
    for told in json.loads(done.stdout.splitlines()[-1]).values():
        assert {"bone", "cartilage", "around", "bone_to_outside"} <= set(told["names"])
        kinds = told["kinds"]
        assert kinds["4"][0] == len(mesh.tetrahedra)
        assert kinds["6"][0] == len(mesh.prisms)
        assert kinds["4"][1] > 0.0
        assert kinds["6"][1] > 0.0
        np.testing.assert_allclose(np.reshape(kinds["6"][2], (-1, 6, 3)), mesh.points[mesh.prisms], rtol=1e-15)
