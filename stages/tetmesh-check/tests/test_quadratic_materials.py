"""Tests of quadratic tetrahedra of many materials: a double bubble, its volumes, and its files."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from xml.etree import ElementTree

import meshio
import numpy as np
import pytest
import pyvista as pv
from complexes import Made, split
from conftest import NEEDS_HXT, Run, write_sizing
from scipy.ndimage import spline_filter
from test_quadratic import of_ball, write_distance

from tetmesh_check.datasets import add_text, text_of
from tetmesh_check.errors import StageError
from tetmesh_check.fields import read_distance_field
from tetmesh_check.parsing import FORMATS, LINEAR_FORMATS

RADIUS, SHIFT = 8.0, 4.0
"""Two balls with centres at x = -SHIFT and SHIFT overlap; the plane x = 0 separates the materials
``left`` and ``right``."""
RIM = np.sqrt(RADIUS**2 - SHIFT**2)
"""Radius of the circle where both materials and the outside meet."""
NAMES = ["outside", "left", "right"]
EXACT = 4.0 / 3.0 * np.pi * RADIUS**3 - np.pi * (RADIUS - SHIFT) ** 2 * (2.0 * RADIUS + SHIFT) / 3.0
"""Volume of each material: the ball without the cap beyond the plane."""


def from_left(world: np.ndarray) -> np.ndarray:
    return np.linalg.norm(world - np.array([-SHIFT, 0.0, 0.0]), axis=1) - RADIUS


def from_right(world: np.ndarray) -> np.ndarray:
    return np.linalg.norm(world - np.array([SHIFT, 0.0, 0.0]), axis=1) - RADIUS


def write_materials(
    path: Path,
    indicators: list[Callable[[np.ndarray], np.ndarray]],
    names: list[str],
    planes: dict[str, int] | None = None,
) -> Path:
    """Write indicators on a grid around the origin, as distfield does; all bricks are known.

    ``planes`` maps names to axes: the materials end at planes through the origin.
    """
    bricks, spacing = 16, 0.5
    count = 4 * bricks + 1
    grid = pv.ImageData(dimensions=(count,) * 3, origin=(-0.5 * spacing * (count - 1),) * 3, spacing=(spacing,) * 3)
    blocks = []
    for indicator in indicators:
        values = indicator(np.asarray(grid.points, dtype=float)).reshape((count,) * 3)
        # a block has 4 coefficients along each axis, the first of them one node before the brick
        padded = np.pad(spline_filter(values, mode="mirror"), (1, 2), mode="reflect")
        blocks.append(padded.reshape((bricks + 1, 4) * 3).transpose(0, 2, 4, 1, 3, 5).ravel())
    row = {
        "first": [0, 0, 0], "size": [count] * 3, "surrounds": False, "bricks": bricks**3, "coefficients": len(blocks[0])
    }  # fmt: skip
    geometry = {
        "size": [count] * 3, "spacing": [spacing] * 3, "directions": np.eye(3).ravel().tolist(),
        "origin": list(grid.origin), "space": "Unnamed",
    }  # fmt: skip
    add_text(grid, "isoparticles_kind", "materials")
    add_text(grid, "geometry", json.dumps(geometry))
    add_text(grid, "materials", json.dumps([{"name": name, "labels": [], **row} for name in names]))
    add_text(
        grid,
        "history",
        json.dumps({"tool": "distfield", "version": "0", "command_line": "", "parameters": {}, "inputs": []}),
    )
    arrays = {
        "isoparticles_format": np.array([2 if planes else 1], np.uint32),
        "brick_fill": np.full(bricks**3, 2**16 - 1, np.uint16),
        "indicator_bricks": np.tile(np.arange(bricks**3, dtype=np.uint32), len(names)),
        "indicator_coefficients": np.concatenate(blocks).astype(np.float32),
    }
    if planes:
        middle, unit = [0.5 * spacing * (count - 1)] * 3, np.eye(3).tolist()
        add_text(
            grid,
            "bounds",
            json.dumps([{"name": name, "point": middle, "normal": unit[axis]} for name, axis in planes.items()]),
        )
    for name, values in arrays.items():
        grid.field_data.set_array(values, name)
    grid.save(path)
    return path


def write_bubble(path: Path) -> Path:
    """Write the indicators of the double bubble: smooth functions, equal on every interface."""
    indicators = [
        lambda world: np.zeros(len(world)),
        lambda world: 2.0 * from_left(world),
        lambda world: 2.0 * from_right(world),
    ]
    return write_materials(path, indicators, NAMES)


def double_bubble(times: int) -> Made:
    """Return the surface of the double bubble, whose vertices lie on its interfaces and its rim."""
    points = np.array([[-1.0, 0, 0], [1, 0, 0], [0, 0, 0], [0, 1, 0], [0, 0, 1], [0, -1, 0], [0, 0, -1]])
    rim = [(3 + k, 3 + (k + 1) % 4) for k in range(4)]
    triangles = np.array([(0, b, a) for a, b in rim] + [(1, a, b) for a, b in rim] + [(2, b, a) for a, b in rim])
    inside, outside = np.repeat([1, 2, 2], 4), np.repeat([0, 0, 1], 4)
    for _ in range(times):
        points, triangles = split(points, triangles)
    # in polar coordinates around the x axis, the octahedron becomes two caps and its square a disc
    reach = np.abs(points).sum(axis=1)
    away = np.linalg.norm(points[:, 1:], axis=1)
    direction = points[:, 1:] / np.maximum(away, 1e-12)[:, None]
    angle = np.arctan2(away, np.abs(points[:, 0])) / (np.pi / 2) * np.arccos(-SHIFT / RADIUS)
    is_cap = reach > 1.0 - 1e-9
    x = np.where(is_cap, np.sign(points[:, 0]) * (SHIFT + RADIUS * np.cos(angle)), 0.0)
    across = np.where(is_cap, RADIUS * np.sin(angle), RIM * reach)
    points = np.column_stack([np.where(points[:, 0] == 0.0, 0.0, x), across[:, None] * direction])
    return Made(points, triangles, np.tile(inside, 4**times), np.tile(outside, 4**times), tuple(NAMES[1:]))


def fill_bubble(folder: Path, run: Run, times: int, *more: str) -> dict:
    """Fill the double bubble with quadratic tetrahedra; return the results in the report."""
    double_bubble(times).save(folder / "b.surface.vtp")
    write_bubble(folder / "f.vti")
    write_sizing(folder / "h.vti", lambda world: np.full(len(world), 12.0 / 2**times), 14)
    done = run(
        "b.surface.vtp", "--sizefield", "h.vti", "--distfield", "f.vti", "-o", "b.volume.vtu", "--order", 2, "--solve", "no",
        "--report", "r.json", "--force", "-q", *more,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    results: dict = json.loads((folder / "r.json").read_text())["results"]
    return results


def distances(at: np.ndarray, pair: tuple[int, int]) -> np.ndarray:
    """Return the exact distances from the interface of two materials."""
    return np.abs({(1, 0): from_left(at), (2, 0): from_right(at), (2, 1): at[:, 0]}[pair])


@NEEDS_HXT
def test_volumes_converge_and_nodes_lie_on_interfaces_and_on_the_rim(tmp_path: Path, run: Run) -> None:
    errors = []
    for times in (2, 3):
        found = fill_bubble(tmp_path, run, times)["quadratic"]
        assert found["not_on_surface"] == found["folded"] == 0
        assert found["curve_nodes"] == 4 * 2**times
        errors.append(
            [
                max(abs(own[key] / EXACT - 1.0) for own in found["regions"])
                for key in ("straight_volume_mm3", "volume_mm3")
            ]
        )
    # Measured on the coarse and the fine mesh: 12 % and 3.2 % with linear elements (order 1.90),
    # 0.22 % and 0.015 % with quadratic elements (order 3.90).
    orders = np.log2(np.array(errors[0]) / errors[1])
    assert orders[0] == pytest.approx(2.0, abs=0.2)
    assert orders[1] > 3.5

    grid = pv.read(tmp_path / "b.volume.quadratic.vtu")
    cells, points = grid.cells_dict[pv.CellType.QUADRATIC_TETRA], np.asarray(grid.points)
    assert [row["name"] for row in json.loads(text_of(grid, "materials") or "")] == NAMES
    assert set(grid.cell_data["region"]) == {1, 2}
    # conforming: an edge has the same node in all its elements
    edges = np.concatenate([np.sort(cells[:, [a, b]]) for a, b in ((0, 1), (1, 2), (0, 2), (0, 3), (1, 3), (2, 3))])
    pairs = np.unique(np.column_stack([edges, cells[:, 4:].T.ravel()]), axis=0)
    assert len(pairs) == len(np.unique(edges, axis=0)) == len(points) - len(np.unique(cells[:, :4]))
    amid = {(a, b): node for a, b, node in pairs.tolist()}
    surface = double_bubble(3)
    straight, curved = {}, {}
    for pair in ((1, 0), (2, 0), (2, 1)):
        own = surface.triangles[(surface.inside == pair[0]) & (surface.outside == pair[1])]
        ends = np.unique(np.sort(np.concatenate([own[:, [0, 1]], own[:, [1, 2]], own[:, [2, 0]]])), axis=0)
        # the tetrahedra keep the vertices of the surface, with the same numbers
        straight[pair] = distances(surface.points[ends].mean(axis=1), pair).max()
        curved[pair] = distances(points[[amid[a, b] for a, b in ends.tolist()]], pair).max()
    # the rim belongs to all three interfaces, so its nodes lie on the exact circle
    assert max(curved.values()) < 1e-5
    assert 0.05 < straight[1, 0] < 0.2


@NEEDS_HXT
def test_cap_nodes_lie_in_their_plane_and_rim_nodes_on_both(tmp_path: Path, run: Run) -> None:
    # the left half of the double bubble; the interface to the right half is now a cap
    whole = double_bubble(3)
    own = (whole.inside == 1) | (whole.outside == 1)
    is_cap = whole.outside[own] == 1
    triangles = np.where(is_cap[:, None], whole.triangles[own][:, ::-1], whole.triangles[own])
    used, local = np.unique(triangles, return_inverse=True)
    half = Made(whole.points[used], local.reshape(-1, 3), np.ones(len(triangles)), np.zeros(len(triangles)), ("left",))
    half.save(tmp_path / "b.vtp", cap=is_cap.astype(np.int64))
    surface = pv.read(tmp_path / "b.vtp")
    meta = json.loads(text_of(surface, "meta") or "")
    add_text(surface, "meta", json.dumps({**meta, "caps": ["cut"]}))
    surface.save(tmp_path / "b.surface.vtp")
    indicators = [lambda world: np.zeros(len(world)), lambda world: 2.0 * from_left(world)]
    write_materials(tmp_path / "f.vti", indicators, NAMES[:2], {"cut": 0})
    write_sizing(tmp_path / "h.vti", lambda world: np.full(len(world), 1.5), 14)
    done = run(
        "b.surface.vtp", "--sizefield", "h.vti", "--distfield", "f.vti", "-o", "b.volume.vtu", "--order", 2,
        "--solve", "no", "--report", "r.json", "-q",
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    results = json.loads((tmp_path / "r.json").read_text())["results"]
    assert [row["name"] for row in results["boundary"]["parts"]] == ["left_to_outside", "left_cap_cut_1"]
    found = results["quadratic"]
    assert found["not_on_surface"] == found["folded"] == 0
    assert found["curve_nodes"] == 32
    # linear elements lose 3.2 % of the volume, all of it at the ball
    assert found["regions"][0]["volume_mm3"] == pytest.approx(EXACT, rel=2e-4)
    grid = pv.read(tmp_path / "b.volume.quadratic.vtu")
    cells, points = grid.cells_dict[pv.CellType.QUADRATIC_TETRA], np.asarray(grid.points)
    ends = points[cells[:, [[0, 1], [1, 2], [0, 2], [0, 3], [1, 3], [2, 3]]]]
    middles = points[cells[:, 4:]]
    in_plane = (np.abs(ends[..., 0]) < 1e-9).all(axis=-1)
    on_ball = (np.abs(from_left(ends.reshape(-1, 3))) < 1e-5).reshape(ends.shape[:3]).all(axis=-1)
    assert np.abs(middles[in_plane][:, 0]).max() < 1e-9
    assert (in_plane & on_ball).any()
    assert np.abs(np.linalg.norm(middles[in_plane & on_ball][:, 1:], axis=1) - RIM).max() < 1e-5


@NEEDS_HXT
def test_every_format_has_the_quadratic_mesh_in_metres(tmp_path: Path, run: Run) -> None:
    kinds = [kind for kind in FORMATS if kind not in LINEAR_FORMATS]
    fill_bubble(tmp_path, run, 1, "--export", ",".join(kinds), "--unit", "m")
    grid = pv.read(tmp_path / "b.volume.quadratic.vtu")
    cells, points = grid.cells_dict[pv.CellType.QUADRATIC_TETRA], 0.001 * np.asarray(grid.points)
    volume = {number: float((grid.cell_data["region"] == number).sum()) for number in (1, 2)}
    for kind in ("inp", "bdf", "msh", "msh2", "med", "xdmf"):
        again = meshio.read(
            tmp_path / f"b.volume.{kind}", {"inp": "abaqus", "msh": "gmsh", "msh2": "gmsh", "bdf": "nastran"}.get(kind)
        )
        found = again.points[again.cells_dict["tetra10"]]
        box = [np.sort(found[..., axis].ravel()) for axis in range(3)]
        np.testing.assert_allclose(
            box, [np.sort(points[cells][..., axis].ravel()) for axis in range(3)], atol=1e-9, err_msg=kind
        )
    again = meshio.read(tmp_path / "b.volume.msh2", "gmsh")
    assert {"left", "right", "left_to_outside", "right_to_outside", "right_to_left"} == set(again.field_data)
    for number, name in enumerate(("left", "right"), 1):
        assert (again.cell_data_dict["gmsh:physical"]["tetra10"] == again.field_data[name][0]).sum() == volume[number]
    # the quadratic triangles of the disc lie in its plane, those of the cap on its sphere
    tags = again.cell_data_dict["gmsh:physical"]["triangle6"]
    for name, pair in (("left_to_outside", (1, 0)), ("right_to_left", (2, 1))):
        nodes = np.unique(again.cells_dict["triangle6"][tags == again.field_data[name][0]])
        assert distances(1000.0 * again.points[nodes], pair).max() < 1e-5
    np.testing.assert_allclose(pv.read(tmp_path / "b.volume.vtk").points, points, atol=1e-12)
    febio = ElementTree.parse(tmp_path / "b.volume.feb").getroot()
    assert {one.get("name") for one in febio.iterfind("Mesh/Surface")} >= {"right_to_left", "left_to_outside"}
    nodes = [[float(x) for x in (node.text or "").split(",")] for node in febio.iterfind("Mesh/Nodes/node")]
    np.testing.assert_allclose(nodes, points, atol=1e-12)


GMSH = """
import gmsh
gmsh.initialize(interruptible=False)
gmsh.option.setNumber("General.Terminal", 0)
gmsh.open("b.volume.msh")
_, (own,), _ = gmsh.model.mesh.getElements(3, 1)
print(min(gmsh.model.mesh.getElementQualities(own, "minDetJac")))
print(*(gmsh.model.getPhysicalName(*group) for group in gmsh.model.getPhysicalGroups()))
"""


@NEEDS_HXT
def test_gmsh_finds_positive_jacobians_and_all_groups(tmp_path: Path, run: Run) -> None:
    fill_bubble(tmp_path, run, 2, "--export", "msh")
    done = subprocess.run([sys.executable, "-c", GMSH], cwd=tmp_path, capture_output=True, text=True, check=True)
    smallest, names = done.stdout.splitlines()
    assert float(smallest) > 0.0
    assert set(names.split()) == {"left", "right", "left_to_outside", "right_to_outside", "right_to_left"}


def test_a_field_of_other_materials_is_refused(tmp_path: Path, run: Run) -> None:
    surface = double_bubble(1)
    write_bubble(tmp_path / "f.vti")
    field, history = read_distance_field(tmp_path / "f.vti", surface.points, NAMES)
    assert history["tool"] == "distfield"
    assert field.materials == NAMES
    with pytest.raises(StageError, match="of left, right; the surface is that of one object"):
        read_distance_field(tmp_path / "f.vti", surface.points, [])
    with pytest.raises(StageError, match="of left, right; the surface is that of left, bone"):
        read_distance_field(tmp_path / "f.vti", surface.points, ["outside", "left", "bone"])
    with pytest.raises(StageError, match="of left, right; the surface is that of left, right, cut"):
        read_distance_field(tmp_path / "f.vti", surface.points, [*NAMES, "cut"])
    write_distance(tmp_path / "one.vti", of_ball)
    surface.save(tmp_path / "b.vtp")
    done = run("b.vtp", "-o", "b.vtu", "--order", 2, "--distfield", "one.vti")
    assert done.returncode == 2
    assert "is the field of one object; the surface is that of left, right" in done.stderr
