"""Tests of TetGen: its meshes, and what happens if it is missing or crashes."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from complexes import Made, nested_balls
from conftest import NEEDS_TETGEN, Run, ball, fake_library, merged, reversed_winding, tetrahedra, write_sizing

from tetmesh_check.quality import signed_tetrahedron_volumes
from tetmesh_check.surface import check_surface, read_surface
from tetmesh_check.tets.tetgen import cavity_points, regular_volume


def nested(path: Path) -> list:
    """Write a ball, a hollow ball and a ball in its cavity."""
    balls = [ball(3.0).translate((20.0, 0, 0)), reversed_winding(ball(8.0, 3)), ball(10.0, 3), ball(5.0)]
    merged(*balls).save(path)
    return balls


def test_cavities_are_found(tmp_path: Path) -> None:
    nested(tmp_path / "nested.vtp")
    surface = read_surface(tmp_path / "nested.vtp")
    _, components = check_surface(tmp_path / "nested.vtp", surface)
    points = cavity_points(surface, components)
    assert points.shape == (1, 3)
    assert 7.5 < np.linalg.norm(points[0]) < 8.0
    assert regular_volume(2.0) == pytest.approx(8.0 / (6.0 * np.sqrt(2.0)))


@NEEDS_TETGEN
def test_cavities_and_bodies_within(tmp_path: Path, run: Run) -> None:
    balls = nested(tmp_path / "nested.vtp")
    write_sizing(tmp_path / "h.vti", lambda world: np.full(len(world), 1.5), half_width=25)
    done = run("nested.vtp", "--sizefield", "h.vti", "-o", "nested.vtu", "--method", "tetgen", "--report", "r.json")
    points, cells, _ = tetrahedra(tmp_path / "nested.vtu")
    results = json.loads((tmp_path / "r.json").read_text())["results"]
    assert results["tetrahedralizer"]["method"] == "tetgen"
    assert results["volume"]["bodies"] == 3
    assert results["volume"]["boundary_kept"] is True
    volumes = signed_tetrahedron_volumes(points, cells)
    assert volumes.min() > 0.0
    # TetGen's final optimization may create a few tetrahedra above the maximum volume
    assert np.percentile(volumes, 95) < 1.5 * regular_volume(1.5)
    truth = balls[0].volume + balls[2].volume - balls[1].volume + balls[3].volume
    assert volumes.sum() == pytest.approx(truth, rel=1e-6)
    assert "only the maximum volume" in done.stderr


def around_a_void() -> Made:
    """Return a core and a shell, and a void between another shell and the outermost material."""
    made = nested_balls((10.0, 8.0, 6.0, 3.0), (3, 3, 3, 2), ("case", "void", "shell", "core"))
    number = np.array([0, 1, 0, 2, 3])
    inside, outside = number[made.inside], number[made.outside]
    is_turned = inside < outside
    return Made(
        made.points,
        np.where(is_turned[:, None], made.triangles[:, ::-1], made.triangles),
        np.where(is_turned, outside, inside),
        np.where(is_turned, inside, outside),
        ("case", "shell", "core"),
    )


def test_the_outside_has_a_point_at_each_shell(tmp_path: Path) -> None:
    surface = read_surface(around_a_void().save(tmp_path / "s.vtp"))
    _, shells = check_surface(tmp_path / "s.vtp", surface)
    away = np.sort(np.linalg.norm(cavity_points(surface, shells), axis=1))
    # flat triangles lie inside their spheres
    np.testing.assert_allclose(away, [6.0, 8.0, 10.0], rtol=0.01)


@NEEDS_TETGEN
def test_many_materials_keep_their_interfaces(tmp_path: Path, run: Run) -> None:
    around_a_void().save(tmp_path / "s.vtp")
    write_sizing(tmp_path / "h.vti", lambda world: np.full(len(world), 1.2))
    done = run(
        "s.vtp",
        "--sizefield",
        "h.vti",
        "-o",
        "s.volume.vtu",
        "--method",
        "tetgen",
        "--report",
        "r.json",
        "--solve",
        "no",
    )
    assert done.returncode in (0, 1), done.stderr
    results = json.loads((tmp_path / "r.json").read_text())["results"]
    assert results["tetrahedralizer"]["method"] == "tetgen"
    volume = results["volume"]
    assert volume["interfaces_kept"]
    assert volume["undecided_tetrahedra"] == volume["crowded_faces"] == 0
    assert [row["name"] for row in volume["regions"]] == ["case", "shell", "core"]
    for row in volume["regions"]:
        assert row["volume_mm3"] == pytest.approx(row["surface_volume_mm3"], rel=1e-9)


@pytest.mark.parametrize(
    ("code", "words"),
    [
        ("raise ImportError('no such thing')\n", "TetGen is not available: ImportError: no such thing"),
        ("import os, signal\nos.kill(os.getpid(), signal.SIGSEGV)\n", "the tetrahedralizer (TetGen) crashed: SIGSEGV"),
    ],
)
def test_where_it_is_missing_or_crashes(
    tmp_path: Path, run: Run, monkeypatch: pytest.MonkeyPatch, code: str, words: str
) -> None:
    ball().save(tmp_path / "ball.vtp")
    fake_library(tmp_path, monkeypatch, "tetgen", code)
    done = run("ball.vtp", "-o", "ball.vtu", "--method", "tetgen")
    assert done.returncode == 2
    assert words in done.stderr
    assert not (tmp_path / "ball.vtu").exists()
