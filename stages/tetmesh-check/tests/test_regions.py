"""Tests of region labels, boundary marks and exported files."""

from __future__ import annotations

import csv
import json
import re
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
from complexes import nested_balls
from conftest import NEEDS_HXT, Run, ball, write_nrrd
from test_solve import block
from vtkmodules.vtkIOXdmf2 import vtkXdmfReader

from tetmesh_check.datasets import text_of
from tetmesh_check.errors import StageError
from tetmesh_check.export.formats import export
from tetmesh_check.export.mesh import MarkedMesh, materials_mesh, object_mesh, plain_names
from tetmesh_check.materials import Sides, conform
from tetmesh_check.parsing import FORMATS
from tetmesh_check.parts.find import find_parts
from tetmesh_check.quality import signed_tetrahedron_volumes
from tetmesh_check.regions import (
    CAP,
    SURFACE,
    check_labels,
    meshed_labels,
    regions_of,
    share_outside,
)
from tetmesh_check.surface import Surface, read_surface
from tetmesh_check.topology import tetrahedron_boundary
from tetmesh_check.volumes import read_label_volume


def vector(numbers: np.ndarray | list[float]) -> str:
    """Format a vector for an NRRD header."""
    return f"({','.join(repr(float(number)) for number in numbers)})"


def placed(space: str, steps: np.ndarray, origin: list[float]) -> dict[str, str]:
    """Return the header fields of a grid; ``steps`` has one axis per row."""
    return {"space": space, "space_directions": " ".join(map(vector, steps)), "space_origin": vector(origin)}


def halves(path: Path, header: dict[str, str] | None = None) -> Path:
    """Write labels 3 (x < 0) and 7 in a ball of radius 9 mm; outside it, a stray 9 for z > 0."""
    x, y, z = np.meshgrid(*3 * [np.arange(-12, 13)], indexing="ij")
    values = np.where(x < 0, 3, 7).astype(np.uint8)
    values[x**2 + y**2 + z**2 > 81] = 0
    values[(values == 0) & (z > 0)] = 9
    return write_nrrd(path, values, **(header or placed("left-posterior-superior", np.eye(3), [-12.0] * 3)))


def test_labels_are_sampled_in_the_world(tmp_path: Path) -> None:
    plain = read_label_volume(halves(tmp_path / "l.nrrd"))
    centres = np.array([[-3.0, 1, 1], [4.0, 2, -2], [-9.9, 0, 0], [2.0, 0, 9.7]])
    np.testing.assert_array_equal(regions_of(centres, plain, [3, 7]), [3, 7, 3, 7])
    # if the meshed labels are not given, the stray label 9 is also used
    np.testing.assert_array_equal(regions_of(centres, plain, None), [3, 7, 3, 9])

    # the same voxels in another frame: right-anterior-superior, with the first axis along -y
    steps = np.array([[0.0, -2.0, 0.0], [2.0, 0.0, 0.0], [0.0, 0.0, 2.0]])
    header = placed("RAS", steps, [1.0, 2.0, 3.0])
    turned = read_label_volume(halves(tmp_path / "r.nrrd", header))
    index = np.array([[9.0, 13, 13], [16.0, 14, 10]])
    ras = index @ steps + [1.0, 2.0, 3.0]
    np.testing.assert_array_equal(regions_of(ras * [-1, -1, 1], turned, None), [3, 7])
    assert turned.voxel_volume == pytest.approx(8.0)

    image = pv.ImageData(dimensions=(25,) * 3, origin=(-12,) * 3)
    image["labels"] = plain.values.ravel(order="F")
    image.save(tmp_path / "l.vti")
    np.testing.assert_array_equal(regions_of(centres, read_label_volume(tmp_path / "l.vti"), [3, 7]), [3, 7, 3, 7])


def test_bad_label_volumes_are_refused(tmp_path: Path) -> None:
    volume = read_label_volume(halves(tmp_path / "l.nrrd"))
    with pytest.raises(StageError, match="outside the label volume"):
        check_labels(np.full((5, 3), 40.0), volume, None)
    with pytest.raises(StageError, match="not in the label volume"):
        check_labels(np.zeros((5, 3)), volume, [4])
    check_labels(np.zeros((5, 3)), volume, None)
    write_nrrd(tmp_path / "flat.nrrd", np.ones((4, 4), dtype=np.uint8))
    write_nrrd(tmp_path / "real.nrrd", np.full((4, 4, 4), 0.5))
    write_nrrd(tmp_path / "none.nrrd", np.zeros((4, 4, 4), dtype=np.uint8))
    write_nrrd(tmp_path / "large.nrrd", np.full((4, 4, 4), 1 << 40))
    (tmp_path / "broken.nrrd").write_bytes((tmp_path / "l.nrrd").read_bytes()[:150])
    for name, words in (
        ("flat", "2 spatial axes"),
        ("large", "32 bits"),
        ("real", "not whole numbers"),
        ("none", "no label but 0"),
        ("broken", "cut short|header"),
        ("absent", "cannot read"),
    ):
        with pytest.raises(StageError, match=words):
            read_label_volume(tmp_path / f"{name}.nrrd")


TURN = np.array([[0.8, 0.6, 0.0], [-0.48, 0.64, 0.6], [0.36, -0.48, 0.8]])
"""A rotation matrix."""


@pytest.mark.parametrize(
    "steps", [2.0 * TURN, np.diag([-1.0, 1.0, 2.0]), np.array([[1.0, 0.2, 0], [0, 1, 0.3], [0, 0, 3]])]
)
@pytest.mark.parametrize(
    ("space", "signs"),
    [("left-posterior-superior", [1, 1, 1]), ("RAS", [-1, -1, 1]), ("Left-Anterior-Superior", [1, -1, 1]), ("scanner-xyz", [1, 1, 1])],
)  # fmt: skip
def test_oblique_and_left_handed_grids(tmp_path: Path, steps: np.ndarray, space: str, signs: list[int]) -> None:
    volume = read_label_volume(halves(tmp_path / "l.nrrd", placed(space, steps, [4.0, -5.0, 6.0])))
    index = np.argwhere(np.isin(volume.values, (3, 7)))[::7]
    world = signs * (index @ steps + [4.0, -5.0, 6.0])
    np.testing.assert_array_equal(regions_of(world, volume, None), volume.values[tuple(index.T)])
    assert volume.voxel_volume == pytest.approx(abs(np.linalg.det(steps)))
    assert share_outside(world, volume) == 0.0


def test_a_vti_with_direction(tmp_path: Path) -> None:
    values = read_label_volume(halves(tmp_path / "l.nrrd")).values
    image = pv.ImageData(dimensions=(25,) * 3, spacing=(1.0, 2.0, 3.0), origin=(5.0, 6.0, 7.0))
    image.direction_matrix = TURN
    image["labels"] = values.ravel(order="F")
    image.save(tmp_path / "l.vti")
    index = np.argwhere(values > 0)[::7]
    world = (index * [1.0, 2.0, 3.0]) @ TURN.T + [5.0, 6.0, 7.0]
    found = regions_of(world, read_label_volume(tmp_path / "l.vti"), None)
    np.testing.assert_array_equal(found, values[tuple(index.T)])


def test_meshed_labels_come_from_the_history() -> None:
    distfield = {"tool": "distfield", "parameters": {"labels": [3, 7]}, "inputs": []}
    nested = {"tool": "reconstruct", "parameters": {}, "inputs": [{"history": None}, {"history": distfield}]}
    assert meshed_labels(nested) == [3, 7]
    assert meshed_labels({"tool": "distfield", "parameters": {"iso": 5.0}}) is None
    assert meshed_labels(None) is None


def marked_block(lower: int = 2, upper: int = 5) -> MarkedMesh:
    """A block whose halves are two regions and whose side x = 0 is a cap."""
    points, cells = block((3, 2, 4))
    outside = tetrahedron_boundary(cells)
    boundary = outside.triangles
    marks = np.where((points[boundary][..., 0] == 0.0).all(axis=1), CAP, SURFACE)
    regions = np.where(points[cells].mean(axis=1)[:, 2] < 2.0, lower, upper)
    return object_mesh(points, cells, regions, outside, marks)


def test_exported_files_are_read_back(tmp_path: Path) -> None:
    mesh = marked_block()
    cap_points = np.flatnonzero(mesh.points[:, 0] == 0.0)
    assert (mesh.marks == CAP).sum() == 16
    for kind in FORMATS:
        export(mesh, tmp_path / "b.volume.vtu", "b", kind)
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        "b.boundary.vtp", "b.volume.bdf", "b.volume.boundary.h5", "b.volume.boundary.xdmf", "b.volume.cap.vtx", "b.volume.elem", "b.volume.feb",
        "b.volume.h5", "b.volume.inp", "b.volume.k", "b.volume.lon", "b.volume.med",
        "b.volume.mesh-complete.exterior.vtp", "b.volume.mesh-complete.mesh-surfaces.cap.vtp",
        "b.volume.mesh-complete.mesh-surfaces.surface.vtp", "b.volume.mesh-complete.mesh.vtu",
        "b.volume.mesh-complete.walls_combined.vtp", "b.volume.msh", "b.volume.msh2",
        "b.volume.pts", "b.volume.regions.csv", "b.volume.surface.vtx", "b.volume.vtk", "b.volume.xdmf",
    ]  # fmt: skip

    abaqus = meshio.read(tmp_path / "b.volume.inp")
    np.testing.assert_array_equal(abaqus.cells_dict["tetra"], mesh.tetrahedra)
    np.testing.assert_allclose(abaqus.points, mesh.points, rtol=0, atol=0)
    np.testing.assert_array_equal(abaqus.cell_sets["REGION_5"][0], np.flatnonzero(mesh.regions == 5))
    np.testing.assert_array_equal(np.sort(abaqus.point_sets["CAP"]), cap_points)
    assert "TYPE=C3D4" in (tmp_path / "b.volume.inp").read_text()

    gmsh = meshio.read(tmp_path / "b.volume.msh2", "gmsh")
    np.testing.assert_array_equal(gmsh.cells_dict["tetra"], mesh.tetrahedra)
    np.testing.assert_array_equal(gmsh.cell_data_dict["gmsh:physical"]["tetra"], mesh.regions)
    np.testing.assert_array_equal(gmsh.cell_data_dict["gmsh:physical"]["triangle"], 10 + mesh.marks)
    assert gmsh.field_data["region_5"].tolist() == [5, 3]
    assert gmsh.field_data["cap"].tolist() == [10 + CAP, 2]

    # version 4.1 orders nodes and elements by entity
    gmsh = meshio.read(tmp_path / "b.volume.msh")
    by_region, by_mark = np.argsort(mesh.regions, kind="stable"), np.argsort(mesh.marks, kind="stable")
    np.testing.assert_array_equal(gmsh.points[gmsh.cells_dict["tetra"]], mesh.points[mesh.tetrahedra[by_region]])
    np.testing.assert_array_equal(gmsh.cell_data_dict["gmsh:physical"]["tetra"], mesh.regions[by_region])
    np.testing.assert_array_equal(gmsh.points[gmsh.cells_dict["triangle"]], mesh.points[mesh.boundary[by_mark]])
    np.testing.assert_array_equal(gmsh.cell_data_dict["gmsh:physical"]["triangle"], 10 + mesh.marks[by_mark])
    assert gmsh.field_data["cap"].tolist() == [10 + CAP, 2]

    facets = meshio.read(tmp_path / "b.volume.boundary.xdmf")
    np.testing.assert_array_equal(facets.points, mesh.points)
    np.testing.assert_array_equal(facets.cells_dict["triangle"], mesh.boundary)
    np.testing.assert_array_equal(facets.cell_data_dict["mark"]["triangle"], mesh.marks)

    reader = vtkXdmfReader()
    reader.SetFileName(str(tmp_path / "b.volume.xdmf"))
    reader.Update()
    xdmf = pv.wrap(reader.GetOutputDataObject(0))
    np.testing.assert_array_equal(xdmf.cells_dict[10], mesh.tetrahedra)
    np.testing.assert_array_equal(xdmf.points, mesh.points)
    np.testing.assert_array_equal(xdmf.cell_data["region"], mesh.regions)
    np.testing.assert_array_equal(xdmf.point_data["boundary"], mesh.point_marks())

    for read in (meshio.read, pv.read_meshio):
        again = read(tmp_path / "b.volume.xdmf")
        np.testing.assert_array_equal(again.points, mesh.points)
        np.testing.assert_array_equal(again.cells_dict["tetra" if read is meshio.read else 10], mesh.tetrahedra)

    surface = pv.read(tmp_path / "b.boundary.vtp")
    assert surface.is_manifold
    assert (np.asarray(surface.cell_data["mark"]) == SURFACE).sum() == len(mesh.boundary) - 16
    owners = np.asarray(surface.cell_data["tetrahedron"])
    at = np.asarray(surface.point_data["point"])[np.asarray(surface.faces).reshape(-1, 4)[:, 1:]]
    np.testing.assert_array_equal(at, mesh.boundary)
    for triangle, owner in zip(at, owners, strict=True):
        assert set(triangle) <= set(mesh.tetrahedra[owner])
    np.testing.assert_array_equal(surface.cell_data["region"], mesh.regions[owners])


def table_of(path: Path) -> list[dict[str, str]]:
    """Read the table of regions that accompanies every export."""
    with path.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def test_negative_labels_have_groups_of_their_own(tmp_path: Path) -> None:
    mesh = marked_block(-5, 7)
    for kind in FORMATS:
        export(mesh, tmp_path / "b.volume.vtu", "b", kind)
    counts = {"region_minus_5": int((mesh.regions == -5).sum()), "region_7": int((mesh.regions == 7).sum())}
    for name in ("b.volume.msh", "b.volume.msh2"):
        gmsh = meshio.read(tmp_path / name, "gmsh")
        tags = gmsh.cell_data_dict["gmsh:physical"]["tetra"]
        groups = {name: tag for name, (tag, dimension) in gmsh.field_data.items() if dimension == 3}
        assert min(groups.values()) > 0
        assert groups["region_7"] == 7
        assert {name: int((tags == tag).sum()) for name, tag in groups.items()} == counts
    assert {row["name"]: row["labels"] for row in table_of(tmp_path / "b.volume.regions.csv")} == {
        "region_minus_5": "-5",
        "region_7": "7",
    }


def materials_of_block(names: tuple[str, str], labels: tuple[int, int]) -> MarkedMesh:
    """Return the block as two materials with one label each; the first is the lower half."""
    entries = [{"name": name, "labels": [{"layer": 0, "label": k}]} for name, k in zip(names, labels, strict=True)]
    table = [{"name": "outside", "labels": []}, *entries]
    plain = plain_names([entry["name"] for entry in table])
    regions = [{"region": k, "name": plain[k], "material": names[k - 1], "labels": [labels[k - 1]]} for k in (1, 2)]
    return replace(marked_block(1, 2), table=regions, parts={1: "inner", 2: "outer"}, materials=table)


def test_every_export_tells_the_labels_of_its_regions(tmp_path: Path) -> None:
    mesh = materials_of_block(("left, lung", "Heart"), (7, 9))
    told = [
        {"region": 1, "name": "left_lung", "material": "left, lung", "labels": [7]},
        {"region": 2, "name": "Heart", "material": "Heart", "labels": [9]},
    ]
    for kind in FORMATS:
        folder = tmp_path / kind
        folder.mkdir()
        export(mesh, folder / "b.volume.vtu", "b", kind)
        assert table_of(folder / "b.volume.regions.csv") == [
            {key: str(value).strip("[]") for key, value in row.items()} for row in told
        ]
    for name in ("vtk/b.volume.vtk", "simvascular/b.volume.mesh-complete.mesh.vtu", "vtp/b.boundary.vtp"):
        assert json.loads(text_of(pv.read(tmp_path / name), "regions") or "") == told
    information = ElementTree.parse(tmp_path / "xdmf/b.volume.xdmf").getroot().find("Domain/Grid/Information")
    assert information is not None
    assert json.loads(information.get("Value", "")) == told
    assert meshio.read(tmp_path / "xdmf/b.volume.xdmf").field_data["Heart"].tolist() == [2, 3]
    assert "** region 2: Heart, labels 9\n" in (tmp_path / "inp/b.volume.inp").read_text()
    assert "<!-- region 2: Heart, labels 9 -->" in (tmp_path / "feb/b.volume.feb").read_text()


@pytest.mark.parametrize(
    "names",
    [("Volume", "Rest"), ("VOLUME", "volume"), ("nodes", "All"), ("a b", "A_b"), ("x" * 90 + "1", "x" * 90 + "2")],
)
def test_every_material_has_sets_of_its_own(tmp_path: Path, names: tuple[str, str]) -> None:
    mesh = materials_of_block(names, (1, 2))
    for kind in ("inp", "msh2", "feb", "med"):
        export(mesh, tmp_path / "b.volume.vtu", "b", kind)
    abaqus = meshio.read(tmp_path / "b.volume.inp")
    own = [region.name.upper() for region in mesh.region_sets]
    assert len({*own, "VOLUME", "NODES", "ALL"}) == 5
    assert max(map(len, own)) <= 80
    for number, name in enumerate(own, 1):
        np.testing.assert_array_equal(abaqus.cell_sets[name][0], np.flatnonzero(mesh.regions == number))
    text = (tmp_path / "b.volume.inp").read_text()
    sets = re.findall(r"ELSET=(\w+)", text)
    assert len(sets) == len(set(sets)) == 3
    gmsh = meshio.read(tmp_path / "b.volume.msh2", "gmsh")
    assert len(gmsh.field_data) == 4
    febio = ElementTree.parse(tmp_path / "b.volume.feb").getroot()
    assert len({str(part.get("name")).lower() for part in febio.iterfind("Mesh/*")}) == 5


def test_tetrahedra_without_a_material_are_in_no_set(tmp_path: Path) -> None:
    mesh = materials_of_block(("a", "b"), (1, 2))
    undecided = np.where(np.arange(len(mesh.regions)) == 0, 0, mesh.regions)
    for kind in FORMATS:
        export(replace(mesh, regions=undecided), tmp_path / "b.volume.vtu", "b", kind)
    assert [row["name"] for row in table_of(tmp_path / "b.volume.regions.csv")] == ["a", "b"]
    abaqus = meshio.read(tmp_path / "b.volume.inp")
    np.testing.assert_array_equal(abaqus.cell_sets["A"][0], np.flatnonzero(undecided == 1))


def test_an_interface_called_like_a_material_has_a_name_of_its_own() -> None:
    names = ("a", "b", "b_to_a")
    made = nested_balls((3.0, 2.0, 1.0), (1, 1, 1), names)
    table = [{"name": name, "labels": []} for name in ("outside", *names)]
    sides, cells = Sides(made.inside, made.outside, table), np.zeros((0, 4), dtype=np.int64)
    found = conform(len(made.points), cells, made.triangles, sides)
    mesh = materials_mesh(made.points, cells, found, made.triangles, sides)
    assert list(mesh.parts.values()) == ["a_to_outside", "b_to_a_2", "b_to_a_to_b"]


def test_cardiac_and_vascular_solvers_find_their_files(tmp_path: Path) -> None:
    mesh = marked_block()
    for kind in ("carp", "simvascular", "vtk", "feb"):
        export(mesh, tmp_path / "b.volume.vtu", "b", kind, unit="m")
    lines = (tmp_path / "b.volume.pts").read_text().splitlines()
    assert int(lines[0]) == len(mesh.points)
    np.testing.assert_allclose(np.loadtxt(lines[1:]), 1000.0 * mesh.points)
    lines = (tmp_path / "b.volume.elem").read_text().splitlines()
    assert int(lines[0]) == len(mesh.tetrahedra)
    assert all(line.startswith("Tt ") for line in lines[1:])
    numbers = np.loadtxt([line[3:] for line in lines[1:]], dtype=int)
    np.testing.assert_array_equal(numbers, np.column_stack([mesh.tetrahedra, mesh.regions]))
    fibres = np.loadtxt((tmp_path / "b.volume.lon").read_text().splitlines()[1:])
    assert fibres.shape == (len(mesh.tetrahedra), 3)
    np.testing.assert_allclose(np.linalg.norm(fibres, axis=1), 1.0)

    volume, faces = (pv.read(tmp_path / f"b.volume.mesh-complete.{end}") for end in ("mesh.vtu", "exterior.vtp"))
    np.testing.assert_allclose(volume.points, 0.001 * mesh.points)
    np.testing.assert_array_equal(volume.cell_data["ModelRegionID"], mesh.regions)
    at = np.asarray(faces.point_data["GlobalNodeID"])[np.asarray(faces.regular_faces)] - 1
    np.testing.assert_array_equal(at, mesh.boundary)
    np.testing.assert_array_equal(faces.cell_data["ModelFaceID"], mesh.marks)
    np.testing.assert_array_equal(np.asarray(faces.cell_data["GlobalElementID"]) - 1, mesh.owners)

    legacy = pv.read(tmp_path / "b.volume.vtk")
    np.testing.assert_allclose(legacy.points, 0.001 * mesh.points)
    np.testing.assert_array_equal(legacy.cell_data["region"], mesh.regions)
    np.testing.assert_array_equal(meshio.read(tmp_path / "b.volume.vtk").cells_dict["tetra"], mesh.tetrahedra)

    febio = ElementTree.parse(tmp_path / "b.volume.feb").getroot()
    nodes = np.array([[float(x) for x in (node.text or "").split(",")] for node in febio.iterfind("Mesh/Nodes/node")])
    np.testing.assert_allclose(nodes, 0.001 * mesh.points)
    cells, names = [], []
    for elements in febio.iterfind("Mesh/Elements"):
        names.append(elements.get("name"))
        cells += [[int(n) for n in (element.text or "").split(",")] for element in elements]
    order = np.argsort(mesh.regions, kind="stable")
    np.testing.assert_array_equal(np.array(cells) - 1, mesh.tetrahedra[order])
    assert names == ["region_2", "region_5"]
    assert [domain.get("mat") for domain in febio.iterfind("MeshDomains/SolidDomain")] == names
    counts = {surface.get("name"): len(surface) for surface in febio.iterfind("Mesh/Surface")}
    assert counts == {"surface": len(mesh.boundary) - 16, "cap": 16}


CCX = shutil.which("ccx")


@pytest.mark.skipif(CCX is None, reason="no CalculiX (Debian, Ubuntu: apt-get install calculix-ccx)")
def test_calculix_solves_a_pressure_on_the_exported_surface(tmp_path: Path) -> None:
    # under uniform pressure, the strain is -p / (3 K), which linear elements reproduce exactly
    mesh = marked_block()
    export(mesh, tmp_path / "b.volume.vtu", "b", "inp")
    modulus, ratio, pressure = 1000.0, 0.3, 10.0
    origin, on_x, on_y = (
        int(np.flatnonzero((mesh.points == corner).all(axis=1))[0]) + 1
        for corner in ([0.0, 0, 0], [3.0, 0, 0], [0.0, 2, 0])
    )
    (tmp_path / "job.inp").write_text(
        f"""*INCLUDE, INPUT=b.volume.inp
*MATERIAL, NAME=TISSUE
*ELASTIC
{modulus}, {ratio}
*SOLID SECTION, ELSET=REGION_2, MATERIAL=TISSUE
*SOLID SECTION, ELSET=REGION_5, MATERIAL=TISSUE
*BOUNDARY
{origin}, 1, 3
{on_x}, 2, 3
{on_y}, 3, 3
*STEP
*STATIC
*DSLOAD
SURFACE, P, {pressure}
CAP, P, {pressure}
*NODE PRINT, NSET=SURFACE
U
*END STEP
"""
    )
    done = subprocess.run([str(CCX), "job"], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout[-2000:]
    rows = [line.split() for line in (tmp_path / "job.dat").read_text().splitlines()]
    moved = np.array([[float(x) for x in row] for row in rows if len(row) == 4 and row[0].isdigit()])
    points = mesh.points[moved[:, 0].astype(int) - 1]
    assert len(moved) == len(np.unique(mesh.boundary[mesh.marks == SURFACE]))
    strain = -pressure * (1.0 - 2.0 * ratio) / modulus
    np.testing.assert_allclose(moved[:, 1:], strain * points, atol=1e-7)


def test_points_on_the_rim_of_a_cap_belong_to_the_surface() -> None:
    mesh = marked_block()
    inner = (mesh.points[:, 0] == 0) & (mesh.points[:, 1] == 1) & (mesh.points[:, 2] > 0) & (mesh.points[:, 2] < 4)
    np.testing.assert_array_equal(mesh.point_marks() == CAP, inner)


def test_the_nearest_triangle_counts_and_not_the_nearest_centre() -> None:
    # The side x = 0 of a fine block is the cap. In the input surface, this side consists of only
    # two triangles.
    points, cells = block((8, 8, 8))
    fine = tetrahedron_boundary(cells).triangles
    on_cap = (points[fine][..., 0] == 0.0).all(axis=1)
    corners = np.array([[0.0, 0, 0], [0, 8, 0], [0, 8, 8], [0, 0, 8]])
    coarse = len(points) + np.array([[0, 2, 1], [0, 3, 2]])
    triangles = np.concatenate([fine[~on_cap], coarse])
    cap = np.arange(len(triangles)) >= len(triangles) - 2
    surface = Surface(np.concatenate([points, corners]), triangles, None, 0, cap)
    marks = find_parts(surface).on(surface, points, fine)
    np.testing.assert_array_equal(marks == CAP, on_cap)


def test_normals_settle_ties() -> None:
    # a cap and a wall at the same position, with opposite normals
    points = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]])
    surface = Surface(points, np.array([[0, 1, 2], [0, 2, 1]]), None, 0, np.array([True, False]))
    marks = find_parts(surface).on(surface, points + 1e-9, np.array([[1, 2, 0], [2, 1, 0]]))
    np.testing.assert_array_equal(marks, [CAP, SURFACE])


@NEEDS_HXT
def test_gmsh_opens_its_file(tmp_path: Path) -> None:
    block = marked_block()
    # every node of region 37 also belongs to another region
    regions = block.regions.copy()
    regions[(block.tetrahedra == block.boundary[0, 0]).any(axis=1).argmax()] = 37
    table = [*block.table, {"region": 37, "name": "region_37", "material": "region_37", "labels": [37]}]
    export(replace(block, regions=regions, table=table), tmp_path / "b.vtu", "b", "msh")
    code = (
        "import gmsh; gmsh.initialize(interruptible=False); gmsh.option.setNumber('General.Terminal', 0); "
        "gmsh.open('b.volume.msh'); print([gmsh.model.getPhysicalName(*g) for g in gmsh.model.getPhysicalGroups()])"
    )
    done = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "['surface', 'cap', 'region_2', 'region_5', 'region_37']"


def test_a_wrong_label_volume_is_refused_before_anything_is_filled(tmp_path: Path, run: Run) -> None:
    ball(9.0, 3).save(tmp_path / "ball.vtp")
    halves(tmp_path / "l.nrrd", placed("LPS", np.eye(3), [100.0] * 3))
    done = run("ball.vtp", "-o", "ball.vtu", "--labels-volume", "l.nrrd", "-q")
    assert done.returncode == 2
    assert "outside the label volume" in done.stderr
    assert "what to do" in done.stderr
    assert sorted(path.name for path in tmp_path.iterdir()) == ["ball.vtp", "l.nrrd"]


def test_tetrahedra_outside_the_label_volume_are_told(tmp_path: Path, run: Run) -> None:
    ball(9.0).save(tmp_path / "ball.vtp")
    halves(tmp_path / "l.nrrd", placed("LPS", np.eye(3), [-5.0, -12.0, -12.0]))
    done = run("ball.vtp", "-o", "ball.vtu", "--labels-volume", "l.nrrd", "--max-passes", 3, "--solve", "no", "-q")
    assert done.returncode == 0, done.stderr
    assert "% of the tetrahedra lie outside the label volume" in done.stderr


@NEEDS_HXT
def test_regions_and_exports_from_the_command_line(tmp_path: Path, run: Run) -> None:
    surface = ball(9.0, 3)
    surface.cell_data["cap"] = (np.asarray(surface.cell_centers().points)[:, 2] > 8.0).astype(np.int64)
    surface.save(tmp_path / "ball.surface.vtp")
    halves(tmp_path / "l.nrrd")
    words = ("ball.surface.vtp", "-o", "ball.volume.vtu", "--method", "hxt", "--labels-volume", "l.nrrd", "-q")
    done = run(*words, "--export", "inp,msh,xdmf,vtp", "--report", "r.json")
    assert done.returncode == 0, done.stderr
    results = json.loads((tmp_path / "r.json").read_text())["results"]
    assert results["exports"] == [
        "ball.volume.inp", "ball.volume.regions.csv", "ball.volume.msh",
        "ball.volume.h5", "ball.volume.xdmf", "ball.volume.boundary.h5", "ball.volume.boundary.xdmf",
        "ball.boundary.vtp",
    ]  # fmt: skip
    grid = pv.read(tmp_path / "ball.volume.vtu")
    cells = np.asarray(grid.cells_dict[10]).astype(np.int64)
    region = np.asarray(grid.cell_data["region"])
    centres = np.asarray(grid.points)[cells].mean(axis=1)
    np.testing.assert_array_equal(region[centres[:, 0] < -1.0] == 7, False)
    volumes = signed_tetrahedron_volumes(np.asarray(grid.points), cells)
    assert results["regions"]["3"]["volume_mm3"] == pytest.approx(volumes[region == 3].sum())
    assert results["regions"]["3"]["volume_mm3"] == pytest.approx(results["regions"]["3"]["voxels_mm3"], rel=0.1)
    marked = read_surface(tmp_path / "ball.surface.vtp")
    counts = {part["name"]: part["triangles"] for part in results["boundary"]["parts"]}
    assert counts["cap_z1_1"] == int(marked.cap.sum()) > 0
    assert set(np.unique(grid.point_data["boundary"])) == {0, SURFACE, CAP}

    again = run(*words, "--export", "inp", "--force")
    assert again.returncode == 0
    (tmp_path / "ball.volume.vtu").unlink()
    refused = run(*words, "--export", "inp")
    assert refused.returncode == 2
    assert "ball.volume.inp: already exists" in refused.stderr
