"""Tests of tetrahedra of many materials: interfaces, exported files, and refused input."""

from __future__ import annotations

import json
from pathlib import Path
from xml.etree import ElementTree

import meshio
import numpy as np
import pytest
import pyvista as pv
from complexes import Made, cells_of_a_block, nested_balls, sectors_of_a_ball
from conftest import NEEDS_HXT, Run, ball, fake_library, tetrahedra, write_sizing
from test_solve import block

from tetmesh_check.datasets import text_of
from tetmesh_check.export.mesh import plain_names
from tetmesh_check.materials import NOBODY, Sides, conform
from tetmesh_check.quality import signed_tetrahedron_volumes, tetrahedron_quality
from tetmesh_check.surface import read_surface
from tetmesh_check.topology import tetrahedron_boundary


def results_of(path: Path) -> dict:
    return json.loads(path.read_text())["results"]


def halves() -> tuple[np.ndarray, np.ndarray, np.ndarray, Sides]:
    """Return a block of tetrahedra, and the interfaces of its halves: material 2 above, 1 below."""
    points, cells = block((2, 2, 2))

    def material(_x: np.ndarray, _y: np.ndarray, z: np.ndarray) -> np.ndarray:
        return np.where(z > 1, 2, 1)

    made = cells_of_a_block((2, 2, 2), material, ("below", "above"))
    np.testing.assert_array_equal(made.points, points)
    table = [{"name": name} for name in ("outside", *made.names)]
    return points, cells, made.triangles, Sides(made.inside, made.outside, table)


def test_regions_are_found_by_the_triangles_alone() -> None:
    points, cells, triangles, sides = halves()
    found = conform(len(points), cells, triangles, sides)
    assert found.faults == 0
    np.testing.assert_array_equal(found.regions, np.where(points[cells].mean(axis=1)[:, 2] > 1, 2, 1))
    for owner, wanted in ((found.behind, sides.inside), (found.before, sides.outside)):
        np.testing.assert_array_equal(np.where(owner == NOBODY, 0, found.regions[owner]), wanted)
        there = owner != NOBODY
        shared = (cells[owner[there]][:, :, None] == triangles[there][:, None, :]).any(axis=1).all(axis=1)
        assert shared.all()


def test_bodies_are_connected_through_faces() -> None:
    points, cells, triangles, sides = halves()
    # add a separate tetrahedron of material 1, with triangles that face inward
    apart = np.arange(4) + len(points)
    faces = apart[[[0, 1, 2], [0, 3, 1], [1, 3, 2], [0, 2, 3]]]
    three = Sides(np.append(sides.inside, [0] * 4), np.append(sides.outside, [1] * 4), sides.table)
    cells, triangles = np.concatenate([cells, [apart]]), np.concatenate([triangles, faces])
    assert conform(cells.max() + 1, cells, triangles, three).faults == 0
    np.testing.assert_array_equal(tetrahedron_boundary(cells).bodies, [*np.zeros(len(cells) - 1), 1])


def test_what_does_not_fit_is_counted() -> None:
    points, cells, triangles, sides = halves()
    # if a tetrahedron is missing, its triangles have no owner, and faces of its neighbours are open
    lost = conform(len(points), cells[1:], triangles, sides)
    assert lost.missing > 0
    assert lost.added > 0
    assert lost.missing + lost.added == lost.faults == 4


CASES: dict[str, Made] = {
    "nested": nested_balls((10.0, 6.0, 3.0), (3, 3, 2), ("body", "lung", "heart")),
    "sectors": sectors_of_a_ball(10.0, 3),
    "boxes": cells_of_a_block((6, 4, 4), lambda x, _y, _z: np.where(x < 3, 1, 2), ("left", "right"), 2.0),
    "columns": cells_of_a_block(
        (6, 6, 6),
        lambda x, y, z: np.where((abs(x - 3) < 2) & (abs(y - 3) < 2) & (abs(z - 3) < 2) & ((x < 3) == (y < 3)), 2, 1),
        ("body", "columns"),
    ),
    # one material with two cavities, which belong to the outside
    "hollows": cells_of_a_block(
        (9, 5, 5), lambda x, y, z: np.where((abs(x - 4.5) == 2) & (y == 2.5) & (z == 2.5), 0, 1), ("bone",), 2.0
    ),
    "cavity": cells_of_a_block(
        (9, 9, 9),
        lambda x, y, z: np.select(
            [np.maximum(np.maximum(abs(x - 4.5), abs(y - 4.5)), abs(z - 4.5)) < far for far in (1, 2, 4)], [0, 1, 2], 1
        ),
        ("bone", "marrow"),
    ),
}


@NEEDS_HXT
@pytest.mark.parametrize("name", CASES)
def test_regions_share_their_triangles(tmp_path: Path, run: Run, name: str) -> None:
    made = CASES[name]
    made.save(tmp_path / "c.surface.vtp")
    write_sizing(tmp_path / "h.vti", lambda world: np.full(len(world), 1.5), 20)
    words = ("c.surface.vtp", "--sizefield", "h.vti", "-o", "c.volume.vtu", "--report", "r.json", "--solve", "no")
    done = run(*words, "--min-dihedral", 12)
    assert done.returncode == 0, done.stderr
    surface = read_surface(tmp_path / "c.surface.vtp")
    points, cells, grid = tetrahedra(tmp_path / "c.volume.vtu")
    np.testing.assert_array_equal(points[: len(surface.points)], surface.points)
    region = np.asarray(grid.cell_data["region"])
    table = json.loads(text_of(grid, "materials") or "")
    assert [entry["name"] for entry in table] == ["outside", *made.names]

    # every surface triangle is a face between its two materials, and every face between regions is
    # a surface triangle
    faces = np.sort(
        np.concatenate([cells[:, list(face)] for face in ((0, 2, 1), (0, 1, 3), (1, 2, 3), (0, 3, 2))]), axis=1
    )
    owners: dict[tuple[int, ...], list[int]] = {}
    for face, owner in zip(map(tuple, faces.tolist()), np.tile(region, 4).tolist(), strict=True):
        owners.setdefault(face, []).append(owner)
    assert max(map(len, owners.values())) == 2
    differing = {face: sorted([*found, 0][:2]) for face, found in owners.items() if len(set([*found, 0][:2])) > 1}
    assert surface.sides is not None
    wanted = {
        tuple(sorted(corners)): [outside, inside]
        for corners, inside, outside in zip(
            surface.triangles.tolist(), surface.sides.inside.tolist(), surface.sides.outside.tolist(), strict=True
        )
    }
    assert differing == wanted

    results = results_of(tmp_path / "r.json")
    assert results["tetrahedralizer"]["algorithm"] == "hxt"
    volumes = signed_tetrahedron_volumes(points, cells)
    quality = tetrahedron_quality(points, cells)
    for entry, material in zip(results["volume"]["regions"], results["complex"]["materials"][1:], strict=True):
        own = region == entry["number"]
        assert entry["name"] == material["name"] == table[entry["number"]]["name"]
        assert volumes[own].sum() == pytest.approx(material["volume_mm3"], rel=1e-9)
        assert entry["volume_mm3"] == pytest.approx(volumes[own].sum())
        assert entry["parts"] == material["components"]
        assert entry["quality"]["min_dihedral"]["min"] == pytest.approx(quality.min_dihedral[own].min())
        assert entry["quality"]["radius_ratio"]["mean"] == pytest.approx(quality.radius_ratio[own].mean())
    assert {check["name"]: check["verdict"] for check in results["checks"]} == dict.fromkeys(
        ("positive_volumes", "min_dihedral", "min_scaled_jacobian", "interfaces_kept", "conforming", "region_parts", "volume_change"),
        "pass",
    )  # fmt: skip


@NEEDS_HXT
def test_the_same_bytes_whatever_the_threads(tmp_path: Path, run: Run) -> None:
    sectors_of_a_ball(10.0, 2).save(tmp_path / "c.vtp")
    for name, threads in (("one", 1), ("two", 3)):
        assert run("c.vtp", "-o", f"{name}.vtu", "--threads", threads, "--solve", "no", "-q").returncode == 0
    first, second = (tetrahedra(tmp_path / f"{name}.vtu") for name in ("one", "two"))
    np.testing.assert_array_equal(first[0], second[0])
    np.testing.assert_array_equal(first[1], second[1])


def marks_of(made: Made) -> tuple[list[tuple[int, int]], np.ndarray]:
    pairs, which = np.unique(np.stack([made.inside, made.outside], 1), axis=0, return_inverse=True)
    return list(map(tuple, pairs.tolist())), which.ravel() + 1


@NEEDS_HXT
def test_other_programs_find_regions_and_interfaces(tmp_path: Path, run: Run) -> None:
    made = CASES["nested"]
    names = ("Body, whole", "2nd lung", "body whole")
    named = Made(made.points, made.triangles, made.inside, made.outside, names)
    named.save(tmp_path / "c.surface.vtp")
    words = ("c.surface.vtp", "-o", "c.volume.vtu", "--report", "r.json", "--solve", "no", "--tet-size-factor", 2, "-q")
    done = run(*words, "--export", "inp,msh2,xdmf,vtp,vtk,feb,carp,simvascular")
    assert done.returncode == 0, done.stderr
    plain = ["Body_whole", "m_2nd_lung", "body_whole_2"]
    assert plain_names(["outside", *names])[1:] == plain
    surface = read_surface(tmp_path / "c.surface.vtp")
    points, cells, grid = tetrahedra(tmp_path / "c.volume.vtu")
    region = np.asarray(grid.cell_data["region"])
    pairs, marks = marks_of(made)
    triangles = surface.triangles
    called = ["Body_whole_to_outside", "m_2nd_lung_to_Body_whole", "body_whole_2_to_m_2nd_lung"]

    abaqus = meshio.read(tmp_path / "c.volume.inp")
    np.testing.assert_array_equal(abaqus.cells_dict["tetra"], cells)
    for number, name in enumerate(plain, 1):
        np.testing.assert_array_equal(abaqus.cell_sets[name.upper()][0], np.flatnonzero(region == number))
    for mark, name in enumerate(called, 1):
        on = np.unique(triangles[marks == mark])
        np.testing.assert_array_equal(np.sort(abaqus.point_sets[name.upper()]), on)
    # each face of an interface must refer to an element on the inner side of the interface
    text = (tmp_path / "c.volume.inp").read_text()
    rows = text.split(f"*SURFACE, NAME={called[2].upper()}, TYPE=ELEMENT\n")[1].split("*")[0].split("\n")[:-1]
    corners = {"S1": (0, 1, 2), "S2": (0, 3, 1), "S3": (1, 3, 2), "S4": (2, 3, 0)}
    listed = []
    for row in rows:
        element, face = row.split(", ")
        assert region[int(element) - 1] == 3
        listed.append(sorted(cells[int(element) - 1][list(corners[face])].tolist()))
    assert sorted(listed) == sorted(map(sorted, triangles[marks == 3].tolist()))

    gmsh = meshio.read(tmp_path / "c.volume.msh2", "gmsh")
    np.testing.assert_array_equal(gmsh.cell_data_dict["gmsh:physical"]["tetra"], region)
    np.testing.assert_array_equal(gmsh.cell_data_dict["gmsh:physical"]["triangle"], 10 + marks)
    np.testing.assert_array_equal(gmsh.cells_dict["triangle"], triangles)
    assert {name: tag.tolist() for name, tag in gmsh.field_data.items()} == {
        **{name: [number, 3] for number, name in enumerate(plain, 1)},
        **{name: [10 + mark, 2] for mark, name in enumerate(called, 1)},
    }

    volume, facets = (meshio.read(tmp_path / f"c.volume{end}.xdmf") for end in ("", ".interfaces"))
    np.testing.assert_array_equal(volume.cell_data_dict["region"]["tetra"], region)
    np.testing.assert_array_equal(facets.points, points)
    np.testing.assert_array_equal(facets.cells_dict["triangle"], triangles)
    np.testing.assert_array_equal(facets.cell_data_dict["pair"]["triangle"], marks)

    boundary = pv.read(tmp_path / "c.boundary.vtp")
    np.testing.assert_array_equal(boundary.cell_data["mark"], marks)
    np.testing.assert_array_equal(boundary.cell_data["region"], made.inside)
    np.testing.assert_array_equal(boundary.cell_data["region_before"], made.outside)
    assert [entry["name"] for entry in json.loads(text_of(boundary, "materials") or "")][1:] == list(names)

    legacy = pv.read(tmp_path / "c.volume.vtk")
    np.testing.assert_array_equal(legacy.cell_data["region"], region)
    outer = np.unique(triangles[made.outside == 0])
    np.testing.assert_array_equal(np.flatnonzero(legacy.point_data["boundary"]), outer)

    tags = [int(line.split()[-1]) for line in (tmp_path / "c.volume.elem").read_text().splitlines()[1:]]
    np.testing.assert_array_equal(tags, region)

    febio = ElementTree.parse(tmp_path / "c.volume.feb").getroot()
    parts = {part.get("name"): len(part) for part in febio.iterfind("Mesh/Elements")}
    assert parts == {name: int((region == number).sum()) for number, name in enumerate(plain, 1)}
    surfaces = {part.get("name"): len(part) for part in febio.iterfind("Mesh/Surface")}
    assert surfaces == {name: int((marks == mark).sum()) for mark, name in enumerate(called, 1)}

    complete, exterior = (pv.read(tmp_path / f"c.volume.mesh-complete.{end}") for end in ("mesh.vtu", "exterior.vtp"))
    np.testing.assert_array_equal(complete.cell_data["ModelRegionID"], region)
    assert exterior.is_manifold
    assert set(np.asarray(exterior.cell_data["ModelFaceID"])) == {1}
    assert exterior.n_cells == int((made.outside == 0).sum())
    assert pairs == [(1, 0), (2, 1), (3, 2)]


@NEEDS_HXT
def test_limits_decide_on_the_exit_code(tmp_path: Path, run: Run) -> None:
    sectors_of_a_ball(10.0, 2).save(tmp_path / "c.vtp")
    words = ("c.vtp", "-o", "c.vtu", "--solve", "no", "--report", "r.json", "-q")
    done = run(*words, "--min-dihedral", 45)
    assert done.returncode == 1, done.stderr
    assert (tmp_path / "c.vtu").is_file()
    ran = results_of(tmp_path / "r.json")["tetrahedralizer"]
    # tetrahedra below a limit must not trigger another attempt
    assert [attempt["algorithm"] for attempt in ran["attempts"]] == ["hxt"]
    assert ran["algorithm"] == "hxt"
    assert "already exists" in run(*words).stderr


def test_what_takes_one_object_only_is_refused(tmp_path: Path, run: Run) -> None:
    sectors_of_a_ball(10.0, 1).save(tmp_path / "c.vtp")
    ball().save(tmp_path / "ball.vtp")
    for words, said in (
        (("--method", "ftetwild"), "--method ftetwild supports one object only"),
        (("--source", "lung"), "'lung' is not a material of the surface: one, two, three"),
        (("--conductivity", "two=0.2"), "--conductivity was given without --source"),
        (("--conductivity", "two"), "'two' is not NAME=VALUE"),
        (("--conductivity", "two=0"), "not a number"),
        (("--source", "two=0,0,0"), "three numbers that are not all 0"),
    ):
        done = run("c.vtp", "-o", "c.vtu", *words, "-q")
        assert done.returncode == 2, done.stderr
        assert said in done.stderr
        assert "what to do" in done.stderr
        assert not (tmp_path / "c.vtu").exists()
    done = run("ball.vtp", "-o", "c.vtu", "--source", "two", "-q")
    assert done.returncode == 2
    assert "the surface is that of one object" in done.stderr


def test_missing_gmsh_is_an_error(tmp_path: Path, run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    sectors_of_a_ball(10.0, 1).save(tmp_path / "c.vtp")
    fake_library(tmp_path, monkeypatch, "gmsh", "raise ImportError('libGLU.so.1: cannot open shared object file')\n")
    done = run("c.vtp", "-o", "c.vtu", "-q")
    assert done.returncode == 2
    assert "HXT is not available: ImportError: libGLU.so.1" in done.stderr
    assert "setup-env.sh" in done.stderr
    assert not (tmp_path / "c.vtu").exists()
