"""Tests of surfaces of many materials: volumes, counts, and refused input."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import isoparticles as iso
import numpy as np
import pytest
import pyvista as pv
from complexes import Made, cells_of_a_block, nested_balls, sectors_of_a_ball
from conftest import NEEDS_HXT

from tetmesh_check.errors import StageError
from tetmesh_check.surface import check_surface, read_surface
from tetmesh_check.topology import Shells


def checked(made: Made, folder: Path, **arrays: np.ndarray) -> tuple[dict[str, Any], Shells]:
    """Write, read and check a complex; return its measures and its volumes."""
    path = made.save(folder / "c.surface.vtp", **arrays)
    measures, shells = check_surface(path, read_surface(path))
    assert isinstance(shells, Shells)
    return measures, shells


def by_name(entries: list[dict]) -> dict[str, dict]:
    return {entry["name"]: entry for entry in entries}


def test_nested_balls(tmp_path: Path) -> None:
    found, shells = checked(nested_balls((10.0, 5.0), (3, 2), ("body", "heart")), tmp_path)
    assert found["junction_edges"] == found["junction_vertices"] == 0
    body, heart = (by_name(found["materials"])[name] for name in ("body", "heart"))
    assert heart["volume_mm3"] == pytest.approx(4.0 / 3.0 * np.pi * 125.0, rel=0.04)
    assert body["volume_mm3"] + heart["volume_mm3"] == pytest.approx(4.0 / 3.0 * np.pi * 1000.0, rel=0.02)
    # the body is one part with a cavity, so its surface has two components
    assert (body["components"], body["topology"]["components"], body["topology"]["euler_characteristic"]) == (1, 2, 4)
    assert shells.sheets()[0].tolist() == [[0, -1], [1, 0]]
    names = [entry["name"] for entry in found["interfaces"]]
    assert names == ["body/outside", "heart/body"]
    # the angle between the normals of adjacent triangles has an RMS of about edge length / (sqrt(3)
    # radius), in radians
    turn = found["interfaces"][0]["rms_turn_degrees"]
    edge = found["interfaces"][0]["quality"]["edge_length"]["mean"]
    assert turn == pytest.approx(np.degrees(edge / 10.0 / np.sqrt(3.0)), rel=0.1)


def test_sectors_of_a_ball(tmp_path: Path) -> None:
    found, _ = checked(sectors_of_a_ball(10.0, 3), tmp_path)
    # after three subdivisions, each half of the axis and each half of the three meridians has 2^3
    # segments
    assert found["junction_edges"] == 8 * (2 + 6)
    assert found["junction_vertices"] == 2
    assert found["edges_by_triangles"] == {2: found["edges_by_triangles"][2], 3: 64}
    assert found["vertices_by_materials"][4] == 2
    assert found["vertices_by_materials"][3] == 15 + 3 * 15
    parts = by_name(found["materials"])
    third = 4.0 / 9.0 * np.pi * 1000.0
    for name in ("one", "two", "three"):
        assert parts[name]["volume_mm3"] == pytest.approx(third, rel=0.03)
        assert parts[name]["topology"]["euler_characteristic"] == 2
    sheets = by_name(found["interfaces"])
    assert set(sheets) == {"one/outside", "two/outside", "three/outside", "two/one", "three/one", "three/two"}
    for name in ("two/one", "three/one", "three/two"):
        assert sheets[name]["rms_turn_degrees"] == pytest.approx(0.0, abs=1e-6)
        assert sheets[name]["area_mm2"] == pytest.approx(50.0 * np.pi, rel=0.02)


def test_volumes_and_areas_converge_with_the_square_of_the_edges(tmp_path: Path) -> None:
    errors = []
    for times in (2, 3, 4):
        found, _ = checked(sectors_of_a_ball(10.0, times), tmp_path)
        volume = by_name(found["materials"])["one"]["volume_mm3"]
        errors.append(abs(volume - 4.0 / 9.0 * np.pi * 1000.0))
    assert 3.7 < errors[0] / errors[1] < 4.3
    assert 3.7 < errors[1] / errors[2] < 4.3


def test_four_regions_of_a_cube_meet_in_a_point(tmp_path: Path) -> None:
    def material(x: np.ndarray, y: np.ndarray, z: np.ndarray) -> np.ndarray:
        return np.where(z > 2, 4, np.where(x < 2, 1, np.where(y < 2, 2, 3)))

    found, _ = checked(cells_of_a_block((4, 4, 4), material, ("a", "b", "c", "d")), tmp_path)
    volumes = [by_name(found["materials"])[name]["volume_mm3"] for name in "abcd"]
    np.testing.assert_allclose(volumes, [16.0, 8.0, 8.0, 32.0])
    assert len(found["interfaces"]) == 4 + 6
    assert by_name(found["interfaces"])["d/a"]["area_mm2"] == pytest.approx(8.0)
    # Four materials meet at the centre. The outside and three regions meet at one point of the
    # bottom, and at three points where the plane z = 2 cuts the outer surface.
    assert found["vertices_by_materials"][4] == 1 + 1 + 3
    assert found["vertices_by_materials"].keys() == {2, 3, 4}


def test_parts_that_touch_along_an_edge_are_kept_asunder(tmp_path: Path) -> None:
    """Two columns of material 2 touch along an edge, in a block of material 1."""

    def material(x: np.ndarray, y: np.ndarray, z: np.ndarray) -> np.ndarray:
        inner = (abs(x - 2) < 1) & (abs(y - 2) < 1) & (abs(z - 2) < 1)
        return np.where(inner & ((x < 2) == (y < 2)), 2, 1)

    found, shells = checked(cells_of_a_block((4, 4, 4), material, ("body", "columns")), tmp_path)
    assert shells.materials.tolist() == [1, 2, 2]
    np.testing.assert_allclose(shells.sizes, [60.0, 2.0, 2.0])
    assert found["edges_by_triangles"][4] == 2
    columns = by_name(found["materials"])["columns"]
    assert (columns["components"], columns["topology"]["nonmanifold_edges"]) == (2, 2)


def test_materials_within_cavities_of_each_other(tmp_path: Path) -> None:
    """Bone contains marrow, which contains a second part of bone with a cavity of the outside."""

    def material(x: np.ndarray, y: np.ndarray, z: np.ndarray) -> np.ndarray:
        far = np.maximum(np.maximum(abs(x - 4.5), abs(y - 4.5)), abs(z - 4.5))
        return np.select([far < 1, far < 2, far < 4], [0, 1, 2], 1)

    _, shells = checked(cells_of_a_block((9, 9, 9), material, ("bone", "marrow")), tmp_path)
    assert shells.materials.tolist() == [1, 1, 2]
    np.testing.assert_allclose(np.sort(shells.sizes), [26.0, 316.0, 386.0])
    assert shells.sizes[2] == pytest.approx(316.0)


def refused(made: Made, folder: Path, words: str, **arrays: np.ndarray) -> None:
    with pytest.raises(StageError, match=words) as caught:
        checked(made, folder, **arrays)
    assert caught.value.why
    assert caught.value.next


def test_what_bounds_no_volumes_is_refused(tmp_path: Path) -> None:
    good = sectors_of_a_ball(10.0, 2)
    gap = Made(good.points, good.triangles[1:], good.inside[1:], good.outside[1:], good.names)
    refused(gap, tmp_path, r"are open or inconsistently oriented.*outside 3, one 3")
    turned = good.triangles.copy()
    turned[0] = turned[0, ::-1]
    refused(
        Made(good.points, turned, good.inside, good.outside, good.names), tmp_path, "open or inconsistently oriented"
    )
    other = good.inside.copy()
    other[0] = 2 if other[0] != 2 else 3
    refused(good, tmp_path, "open or inconsistently oriented", material_inside=other)
    inside_out = Made(good.points, good.triangles[:, ::-1], good.inside, good.outside, good.names)
    refused(inside_out, tmp_path, "inside out")
    twice = Made(
        good.points,
        np.concatenate([good.triangles, good.triangles[:1], good.triangles[:1, ::-1]]),
        np.append(good.inside, 2 * [good.inside[0]]),
        np.append(good.outside, 2 * [good.outside[0]]),
        good.names,
    )
    refused(twice, tmp_path, "more than once")
    balls = nested_balls((10.0, 5.0), (2, 2), ("body", "heart"))
    apart = balls.points.copy()
    apart[162:] += [8.0, 0.0, 0.0]
    refused(Made(apart, balls.triangles, balls.inside, balls.outside, balls.names), tmp_path, "intersects itself")
    flat = balls.points.copy()
    a, b, c = balls.triangles[0]
    flat[c] = 0.5 * (flat[a] + flat[b])
    refused(Made(flat, balls.triangles, balls.inside, balls.outside, balls.names), tmp_path, "have no area")


def test_an_incomplete_table_is_refused(tmp_path: Path) -> None:
    good = nested_balls((10.0, 5.0), (1, 1), ("body", "heart"))
    refused(good, tmp_path, "the table contains 0 to 2", material_inside=good.inside + 2)
    refused(good, tmp_path, "not the higher of their two", material_outside=good.inside)
    refused(good, tmp_path, "whole number from 0", material_outside=good.outside - 1)
    path = good.save(tmp_path / "c.vtp")
    surface = pv.read(path)
    surface.field_data.clear()
    surface.save(path)
    with pytest.raises(StageError, match="no table of materials"):
        read_surface(path)
    surface.cell_data.remove("material_outside")
    surface.save(path)
    with pytest.raises(StageError, match="only the cell array 'material_inside'"):
        read_surface(path)


def test_the_surface_of_one_object_has_no_sides(tmp_path: Path) -> None:
    surface = pv.Icosphere(radius=3.0, nsub=1)
    surface.save(tmp_path / "ball.vtp")
    assert read_surface(tmp_path / "ball.vtp").sides is None


@NEEDS_HXT
def test_the_surface_of_one_material_is_filled() -> None:
    away = np.linalg.norm(np.moveaxis(np.indices((25, 25, 25)), 0, -1) - 12.0, axis=-1)
    labels = np.select([away < 5.0, away < 9.0], [2, 1], 0).astype(np.uint8)
    whole = iso.mesh(labels, materials={"shell": 1, "core": 2}, size=2, backend="cpu")
    with pytest.warns(iso.MeshWarning, match="the volume changes by"):
        filled = iso.fill(whole.result, whole.size, method="hxt", solve="no")
    for row in filled.report["results"]["volume"]["regions"]:
        own = iso.fill(whole.result.of(row["name"]), whole.size, method="hxt", solve="no")
        assert own.failed_checks == []
        assert own.report["results"]["volume"]["volume_mm3"] == pytest.approx(row["volume_mm3"], rel=1e-9)
