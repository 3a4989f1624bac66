"""Tests of HXT: its meshes, when it is chosen, and what happens if it is missing."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from conftest import NEEDS_HXT, Run, ball, fake_library, merged, reversed_winding, tetrahedra, write_sizing
from isoparticles._native import changed_triangles, surface_components

from tetmesh_check import cli
from tetmesh_check.quality import signed_tetrahedron_volumes, tetrahedron_quality
from tetmesh_check.surface import history_of, read_surface
from tetmesh_check.tets import fill
from tetmesh_check.topology import tetrahedron_boundary

MISSING = "raise ImportError('libGLU.so.1: cannot open shared object file')\n"


@NEEDS_HXT
def test_ball_with_graded_sizing(tmp_path: Path, run: Run) -> None:
    path = tmp_path / "ball.vtp"
    ball(subdivisions=4).save(path)
    write_sizing(tmp_path / "h.vti", lambda world: 1.0 + 0.3 * (10.0 - np.linalg.norm(world, axis=1)).clip(0))
    for name, threads in (("first", 1), ("second", 3)):
        done = run(
            "ball.vtp", "--sizefield", "h.vti", "-o", f"{name}.vtu", "--method", "hxt", "--threads", threads, "--report",
            f"{name}.json",
        )  # fmt: skip
        assert done.returncode == 0, done.stderr
    points, cells, grid = tetrahedra(tmp_path / "first.vtu")
    surface = read_surface(path)
    quality = tetrahedron_quality(points, cells)
    assert quality.volume.min() > 0
    assert quality.min_dihedral.min() > 10
    assert quality.volume.sum() == pytest.approx(
        surface_components(surface.points, surface.triangles)["volumes"].sum(), rel=1e-12
    )
    outside = tetrahedron_boundary(cells)
    assert not outside.bodies.any()
    assert changed_triangles(surface.points, surface.triangles, points, outside.triangles) == [0, 0]
    # the surface vertices come first, in their original order
    np.testing.assert_array_equal(points[: len(surface.points)], surface.points)
    assert history_of(grid)["parameters"]["method"] == "hxt"

    results = json.loads((tmp_path / "first.json").read_text())["results"]
    assert results["tetrahedralizer"]["method"] == "hxt"
    assert results["tetrahedralizer"]["reason"] == "--method hxt was given"
    assert results["volume"]["boundary_kept"] is True
    assert results["volume"]["boundary_triangles"] == {"missing": 0, "added": 0}
    assert results["volume"]["edge_length_over_target"]["median"] == pytest.approx(1.0, abs=0.15)
    assert results["distance_mm"]["boundary_to_surface"]["max"] < 1e-9
    # the edge lengths must follow h, which is four times as large at the centre as at the surface
    centre = np.linalg.norm(points[cells].mean(axis=1), axis=1) < 3.0
    assert np.median(quality.edge_length[centre]) > 2.0 * np.median(quality.edge_length[~centre])

    # the mesh is identical for any number of threads
    again = tetrahedra(tmp_path / "second.vtu")
    np.testing.assert_array_equal(again[0], points)
    np.testing.assert_array_equal(again[1], cells)


@NEEDS_HXT
def test_cavities_and_bodies_within(tmp_path: Path, run: Run) -> None:
    balls = [ball(3.0).translate((20.0, 0, 0)), reversed_winding(ball(8.0, 3)), ball(10.0, 3), ball(5.0)]
    merged(*balls).save(tmp_path / "nested.vtp")
    done = run("nested.vtp", "-o", "nested.vtu", "--method", "hxt", "--report", "r.json")
    assert done.returncode == 0, done.stderr
    points, cells, _ = tetrahedra(tmp_path / "nested.vtu")
    results = json.loads((tmp_path / "r.json").read_text())["results"]
    assert results["volume"]["bodies"] == 3
    assert results["volume"]["boundary_kept"] is True
    volumes = signed_tetrahedron_volumes(points, cells)
    centres = points[cells].mean(axis=1)
    distance = np.linalg.norm(centres, axis=1)
    apart, inner = centres[:, 0] > 15.0, distance < 6.0
    for part, truth in (
        (apart, balls[0].volume),
        (inner, balls[3].volume),
        (~apart & ~inner, balls[2].volume - balls[1].volume),
    ):
        assert volumes[part].sum() == pytest.approx(truth, rel=1e-6)
    assert not ((distance > 6.0) & (distance < 7.0)).any()


def test_missing_hxt_is_an_error_when_asked_for(tmp_path: Path, run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    ball().save(tmp_path / "ball.vtp")
    fake_library(tmp_path, monkeypatch, "gmsh", MISSING)
    done = run("ball.vtp", "-o", "ball.vtu", "--method", "hxt", "--report", "r.json")
    assert done.returncode == 2
    assert "HXT is not available: ImportError: libGLU.so.1" in done.stderr
    assert "setup-env.sh" in done.stderr
    assert not (tmp_path / "ball.vtu").exists()
    assert json.loads((tmp_path / "r.json").read_text())["results"]["tetrahedralizer"]["method"] == "hxt"


def program(folder: Path, *words: str) -> tuple[int, dict]:
    """Run the program in this process, so that patches apply; return exit code and report."""
    report = folder / "r.json"
    code = cli.main([str(folder / "ball.vtp"), "-o", str(folder / "ball.vtu"), "-q", "--report", str(report), *words])
    return code, json.loads(report.read_text())


@NEEDS_HXT
def test_large_surfaces_go_to_hxt(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    ball().save(tmp_path / "ball.vtp")
    monkeypatch.setattr(fill, "MAX_FTETWILD_VERTICES", 161)
    code, report = program(tmp_path)
    assert code == 0
    assert report["results"]["tetrahedralizer"]["method"] == report["parameters"]["method"] == "hxt"
    assert "162 vertices, more than the limit of 161" in report["results"]["tetrahedralizer"]["reason"]


@pytest.mark.parametrize(
    ("code", "words"),
    [
        (MISSING, "HXT is not available: ImportError: libGLU.so.1"),
        ("def initialize(**k): raise RuntimeError('no luck')\n", "no luck"),
    ],
)
def test_ftetwild_steps_in_for_hxt(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, code: str, words: str) -> None:
    ball().save(tmp_path / "ball.vtp")
    fake_library(tmp_path, monkeypatch, "gmsh", code)
    monkeypatch.setattr(fill, "MAX_FTETWILD_VERTICES", 161)
    exit_code, report = program(tmp_path)
    assert exit_code == 0
    ran = report["results"]["tetrahedralizer"]
    assert ran["method"] == report["parameters"]["method"] == "ftetwild"
    assert words in ran["reason"]
    assert any(words in warning and "fTetWild fills the surface instead" in warning for warning in report["warnings"])
    assert words.split(": ")[-1] in (tmp_path / "ball.tetrahedra.log").read_text()
