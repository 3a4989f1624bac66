"""Tests of profiles. Each file is read with code that follows the reader of the target program."""

from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import meshio
import numpy as np
import pytest
import pyvista as pv
from complexes import nested_balls
from conftest import NEEDS_HXT, Run, ball, tetrahedra

from tetmesh_check.errors import StageError
from tetmesh_check.export.profiles import PROFILES, tissue_numbers
from tetmesh_check.parsing import options
from tetmesh_check.quality import signed_tetrahedron_volumes

CENTRE = np.array([2.0, -3.0, 1.0])
SIGNS = np.array([-1.0, -1.0, 1.0])
NAMES = ("White matter", "skin", "label_2")
"""Materials of nested balls, from the outside. Their SimNIBS numbers are 1, 5 and 2."""


def with_frame(path: Path) -> Path:
    """Add the frame LPS to a surface."""
    surface = pv.read(path)
    surface.add_field_data([json.dumps("Lps")], "space")
    surface.save(path)
    return path


def head(path: Path, names: tuple[str, ...] = NAMES) -> Path:
    made = nested_balls((10.0, 6.0, 3.0), (3, 3, 2), names)
    return with_frame(replace(made, points=made.points + CENTRE).save(path))


def run_for(run: Run, profile: str, surface: Path, *more: str) -> None:
    words = [surface, "-o", "v.volume.vtu", "--for", profile, "--method", "hxt", "--solve", "no", "-q", *more]
    done = run(*words, "--report", "r.json")
    assert done.returncode == 0, done.stderr


def volumes(points: np.ndarray, cells: np.ndarray, regions: np.ndarray) -> dict[int, float]:
    """Return the volume of each region."""
    found = signed_tetrahedron_volumes(points, cells)
    return {int(k): float(found[regions == k].sum()) for k in np.unique(regions)}


def flux(points: np.ndarray, triangles: np.ndarray) -> float:
    """Return the volume inside outward triangles: the flux of x / 3."""
    a, b, c = (points[triangles[:, k]] for k in range(3))
    return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6.0)


def read_as_simnibs(path: Path) -> tuple[np.ndarray, dict[int, tuple[np.ndarray, np.ndarray]]]:
    """Read a binary Gmsh 2 file in the order of the readers of SimNIBS and Brainstorm.

    Returns the nodes, and for each type of element (2 or 4) the first tags and the nodes from 0.
    """
    with path.open("rb") as file:
        assert file.readline() == b"$MeshFormat\n"
        assert file.readline().split() == [b"2.2", b"1", b"8"]
        assert file.read(5) == b"\x01\x00\x00\x00\n"
        assert file.readline() == b"$EndMeshFormat\n"
        while file.readline() != b"$Nodes\n":
            pass
        nodes = np.fromfile(file, [("id", "<i4"), ("at", "<f8", 3)], int(file.readline()))
        np.testing.assert_array_equal(nodes["id"], np.arange(1, len(nodes) + 1))
        assert file.read(1) == b"\n"
        assert [file.readline(), file.readline()] == [b"$EndNodes\n", b"$Elements\n"]
        left, first, found = int(file.readline()), 1, {}
        while left:
            kind, count, tags = np.fromfile(file, "<i4", 3).tolist()
            assert tags == 2
            rows = np.fromfile(file, "<i4", count * (3 + {2: 3, 4: 4}[kind])).reshape(count, -1)
            np.testing.assert_array_equal(rows[:, 0], np.arange(first, first + count))
            found[kind] = rows[:, 1], rows[:, 3:] - 1
            left, first = left - count, first + count
        assert file.readline() == b"\n"
        # nothing follows, because Brainstorm refuses unknown sections after the elements
        assert file.read() == b"$EndElements\n"
    return nodes["at"], found


@NEEDS_HXT
@pytest.mark.parametrize("profile", ["simnibs", "brainstorm"])
def test_head_models_have_tissue_numbers_in_mm_and_ras(tmp_path: Path, run: Run, profile: str) -> None:
    run_for(run, profile, head(tmp_path / "s.vtp"))
    points, cells, grid = tetrahedra(tmp_path / "v.volume.vtu")
    new = np.array([0, 1, 5, 2])
    regions = new[np.asarray(grid.cell_data["region"])]
    at, found = read_as_simnibs(tmp_path / "v.volume.msh")
    assert list(found) == [2, 4], "triangles come first"
    np.testing.assert_array_equal(at, points)
    np.testing.assert_allclose(at.mean(axis=0), CENTRE * SIGNS, atol=1.0)
    np.testing.assert_array_equal(found[4][0], regions)
    np.testing.assert_array_equal(found[4][1], cells)
    # white matter has precedence and owns both of its interfaces; gray matter owns the other one
    tags, triangles = found[2]
    assert set(tags.tolist()) == {1001, 1002}
    inside = volumes(points, cells, regions)
    assert flux(at, triangles[tags == 1001]) == pytest.approx(inside[1])
    assert flux(at, triangles[tags == 1002]) == pytest.approx(inside[2])
    named = meshio.read(tmp_path / "v.volume.msh", "gmsh").field_data
    assert {name: tag.tolist() for name, tag in named.items()} == {
        "White_matter": [1, 3], "skin": [5, 3], "label_2": [2, 3],
        "White_matter_surface": [1001, 2], "label_2_surface": [1002, 2],
    }  # fmt: skip
    table = (tmp_path / "v.volume.regions.csv").read_text().splitlines()
    assert table[1:] == ["1,White_matter,White matter,1", "2,label_2,label_2,3", "5,skin,skin,2"]


@NEEDS_HXT
def test_opencarp_gets_micrometres_and_lists_of_nodes(tmp_path: Path, run: Run) -> None:
    surface = ball(9.0, 3)
    surface.cell_data["cap"] = (np.asarray(surface.cell_centers().points)[:, 2] > 8.0).astype(np.int64)
    surface.save(tmp_path / "s.vtp")
    run_for(run, "opencarp", tmp_path / "s.vtp")
    points, cells, _ = tetrahedra(tmp_path / "v.volume.vtu")
    at = np.loadtxt(tmp_path / "v.volume.pts", skiprows=1)
    np.testing.assert_allclose(at, 1000.0 * points, atol=1e-3)
    elements = [line.split() for line in (tmp_path / "v.volume.elem").read_text().splitlines()[1:]]
    np.testing.assert_array_equal([[int(n) for n in element[1:5]] for element in elements], cells)
    lists = {}
    for part in ("surface", "cap_z1_1"):
        count, domain, *nodes = (tmp_path / f"v.volume.{part}.vtx").read_text().split()
        assert (int(count), domain) == (len(nodes), "extra")
        lists[part] = np.array(nodes, dtype=int)
        np.testing.assert_allclose(np.linalg.norm(points[lists[part]], axis=1), 9.0, atol=0.1)
    assert points[lists["cap_z1_1"]][:, 2].min() > 7.0
    written = json.loads((tmp_path / "r.json").read_text())["results"]["exports"]
    assert sorted(written) == sorted(path.name for path in tmp_path.glob("v.volume.*") if path.suffix != ".vtu")
    again = run("s.vtp", "-o", "v.volume.vtu", "--export", "carp")
    assert "already exists" in again.stderr


@NEEDS_HXT
def test_febio_and_calculix_get_their_files(tmp_path: Path, run: Run) -> None:
    ball(9.0, 3).save(tmp_path / "s.vtp")
    run_for(run, "febio", tmp_path / "s.vtp")
    points, cells, _ = tetrahedra(tmp_path / "v.volume.vtu")
    febio = ElementTree.parse(tmp_path / "v.volume.feb").getroot()
    at = [[float(x) for x in (node.text or "").split(",")] for node in febio.iterfind("Mesh/Nodes/node")]
    np.testing.assert_array_equal(at, points)
    assert not (tmp_path / "v.volume.inp").exists()
    run_for(run, "calculix", tmp_path / "s.vtp", "--unit", "m", "--force")
    abaqus = meshio.read(tmp_path / "v.volume.inp")
    np.testing.assert_array_equal(abaqus.cells_dict["tetra"], cells)
    np.testing.assert_allclose(abaqus.points, 0.001 * points, rtol=1e-12)


DOLFINX = """
import gmsh, json
gmsh.initialize(interruptible=False)
gmsh.option.setNumber("General.Terminal", 0)
gmsh.open("v.volume.msh")
numbers, points, _ = gmsh.model.mesh.getNodes()
found = {}
for dimension, tag in gmsh.model.getPhysicalGroups():
    for entity in gmsh.model.getEntitiesForPhysicalGroup(dimension, tag):
        kinds, _, nodes = gmsh.model.mesh.getElements(dimension, entity)
        assert len(kinds) == 1
        found[gmsh.model.getPhysicalName(dimension, tag)] = [tag, int(kinds[0]), nodes[0].tolist()]
print(json.dumps([numbers.tolist(), points.tolist(), found]))
"""
"""Reads a file with the calls of ``dolfinx.io.gmsh.read_from_msh`` (0.10)."""


@NEEDS_HXT
def test_fenicsx_finds_cells_facets_and_all_nodes(tmp_path: Path, run: Run) -> None:
    run_for(run, "fenicsx", head(tmp_path / "s.vtp", ("body", "lung", "heart")))
    points, cells, grid = tetrahedra(tmp_path / "v.volume.vtu")
    done = subprocess.run([sys.executable, "-c", DOLFINX], cwd=tmp_path, capture_output=True, text=True, check=True)
    numbers, at, found = json.loads(done.stdout)
    # dolfinx asserts that the numbers of the nodes have no gaps
    assert sorted(numbers) == list(range(1, len(points) + 1))
    sorted_points = np.reshape(at, (-1, 3))[np.argsort(numbers)]
    np.testing.assert_array_equal(sorted_points, points)
    region = np.asarray(grid.cell_data["region"])
    for number, name in enumerate(("body", "lung", "heart"), 1):
        tag, kind, nodes = found[name]
        assert (tag, kind) == (number, 4)
        np.testing.assert_array_equal(np.reshape(nodes, (-1, 4)) - 1, cells[region == number])
    tag, kind, nodes = found["heart_to_lung"]
    assert (tag, kind) == (13, 2)
    assert flux(points, np.reshape(nodes, (-1, 3)) - 1) == pytest.approx(volumes(points, cells, region)[3])


def test_the_command_line_offers_every_profile() -> None:
    offered = next(option for option in options() if option["name"] == "for")
    assert offered["choices"] == list(PROFILES)
    keys = Path(__file__).parents[3] / "pipelines" / "case" / "src" / "keys.rs"
    assert f"&{json.dumps(list(PROFILES))}" in keys.read_text()


MANY: dict[str, Any] = {"materials": ["outside", "white", "skull"], "volume": True}
ONE: dict[str, Any] = {"materials": [], "volume": True}


@pytest.mark.parametrize(
    ("known", "given", "told"),
    [
        (MANY, "--for simnibs --space lps", "--space lps with --for simnibs"),
        (MANY, "--for brainstorm --unit m", "--unit m with --for brainstorm"),
        (ONE, "--for febio --export inp,feb", "--export inp,feb with --for febio"),
        (ONE, "--for opencarp --order 2 --distfield f.vti", "--for opencarp with --order 2"),
        (ONE, "--for simnibs", "the surface is that of one object"),
        (ONE, "--for gmsh", "invalid choice"),
        ({**MANY, "materials": ["outside", "white", "lungs"]}, "--for simnibs", "'lungs' is not a tissue"),
        ({**MANY, "materials": ["outside", "bone", "skull"]}, "--for simnibs", "are both tissue 4"),
        pytest.param(MANY, "--for simnibs --space ras --unit mm", None, marks=NEEDS_HXT),
        (ONE, "--for calculix --unit m --space ras", None),
        (ONE, "--for febio --export feb", None),
    ],
)
def test_contradictory_options_are_refused_early(run: Run, known: dict[str, Any], given: str, told: str | None) -> None:
    checked = run("--check-options", json.dumps(known), "s.vtp", "-o", "s.volume.vtu", *given.split())
    assert checked.returncode == (0 if told is None else 2), checked.stderr
    if told is not None:
        assert told in checked.stderr
        assert "what to do" in checked.stderr


def test_wrong_names_are_refused_before_the_tetrahedra(tmp_path: Path, run: Run) -> None:
    head(tmp_path / "s.vtp", ("skin", "lungs", "white"))
    done = run("s.vtp", "-o", "v.volume.vtu", "--for", "simnibs", "-q")
    assert done.returncode == 2
    assert "'lungs' is not a tissue" in done.stderr
    assert [path.name for path in tmp_path.iterdir()] == ["s.vtp"]


def test_names_of_tissues() -> None:
    assert tissue_numbers(["Gray Matter", "CSF", "label_10", "Spongy-bone"]) == [2, 3, 10, 8]
    with pytest.raises(StageError, match="'label_11' is not a tissue"):
        tissue_numbers(["label_11"])
