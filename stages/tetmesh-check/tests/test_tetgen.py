"""Tests of TetGen: its meshes, and what happens if it is missing or crashes."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
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
