"""Tests of forced tetrahedra: they are listed, and fail unless accepted."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from complexes import Made, sphere
from conftest import NEEDS_HXT, Run
from isoparticles._native import forced_sides

from tetmesh_check.checks import SHAPE, Check, Limits, OfShape, poor_tetrahedra, shape_checks, well_shaped
from tetmesh_check.forced import INSIDE, OUTSIDE
from tetmesh_check.quality import tetrahedron_quality

FLAT = np.array([[0.0, 0.0, 0.0], [2.0, 0.0, 0.0], [1.0, np.sqrt(3.0), 0.0]])
"""An equilateral triangle whose normal is +z."""


def with_neighbour(degrees: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the triangle, and a neighbour across its first edge at this angle in front of it."""
    turned = np.radians(degrees)
    apex = [1.0, np.sqrt(3.0) * np.cos(turned), np.sqrt(3.0) * np.sin(turned)]
    # both triangles are counter-clockwise as seen from the wedge
    return np.vstack([FLAT, apex]), np.array([[0, 1, 2], [1, 0, 3]])


def test_facets_that_meet_at_an_angle_allow_no_larger_one() -> None:
    points, triangles = with_neighbour(8.0)
    for facets, side in ((triangles, OUTSIDE), (triangles[:, ::-1], INSIDE)):
        facet, sides, bound = forced_sides(points, facets, 12.0)
        np.testing.assert_array_equal(facet, [0, 1])
        np.testing.assert_array_equal(sides, [side, side])
        np.testing.assert_allclose(bound, 8.0, atol=1e-3)
    assert len(forced_sides(points, triangles, 7.9)[0]) == 0


def test_forced_tetrahedra_fail_unless_accepted() -> None:
    points = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.2, 0.2, 0.02], [0.3, 0.3, 1.0]])
    tetrahedra = np.array([[0, 1, 2, 3], [0, 1, 2, 4]])
    quality = tetrahedron_quality(points, tetrahedra)
    only = np.array([True, False])

    def judged(forced: OfShape, accept: bool) -> dict[str, Check]:
        limits = Limits(min_dihedral=12.0, accept_forced=accept)
        return {check.name: check for check in shape_checks(quality, limits, forced)}

    assert not well_shaped(quality, Limits(min_dihedral=12.0))
    strict, accepting = (judged(dict.fromkeys(SHAPE, only), accept)["min_dihedral"] for accept in (False, True))
    assert strict.value == accepting.value == pytest.approx(quality.min_dihedral[0])
    assert strict.verdict == "fail"
    assert "1 of them forced by triangles" in strict.words
    assert "SCALE" in strict.words
    assert "--accept-forced" in strict.words
    assert accepting.verdict == "warning"
    assert accepting.words.startswith("fit but for 1 accepted tetrahedron: the minimum dihedral angle is ")
    # a poor tetrahedron without a forcing triangle must fail even if forced ones are accepted
    for forced in ({}, dict.fromkeys(SHAPE, ~only)):
        assert judged(forced, True)["min_dihedral"].verdict == "fail"
    # its position is listed
    assert "poor_tetrahedra" in judged({}, False)["min_dihedral"].words
    listed = poor_tetrahedra(points, tetrahedra, quality, Limits(min_dihedral=12.0))
    assert [entry["place_mm"] for entry in listed] == [pytest.approx([0.3, 0.3, 0.005])]
    assert listed[0]["min_dihedral"] == quality.min_dihedral[0]
    # a tetrahedron with zero volume is not accepted either
    flat = tetrahedron_quality(np.vstack([points, [0.2, 0.2, 0.0]]), np.array([[0, 1, 2, 5], [0, 1, 2, 4]]))
    positive = shape_checks(flat, Limits(accept_forced=True), dict.fromkeys(SHAPE, only))[0]
    assert (positive.name, positive.passed) == ("positive_volumes", False)


def flat_tetrahedron_in_a_ball(degrees: float) -> Made:
    """Return a ball around a flat tetrahedron, which is a material of its own."""
    turned = np.radians(degrees)
    apex = [1.0, np.sqrt(3.0) * np.cos(turned), np.sqrt(3.0) * np.sin(turned)]
    points, triangles = sphere(6.0, 3)
    inner = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]]) + len(points)
    material = np.repeat([1, 2], [len(triangles), len(inner)])
    return Made(
        np.vstack([points, FLAT, apex]), np.vstack([triangles, inner]), material, material - 1, ("body", "wedge")
    )


@NEEDS_HXT
def test_what_the_surface_forces_is_listed_and_fails_unless_accepted(tmp_path: Path, run: Run) -> None:
    flat_tetrahedron_in_a_ball(6.0).save(tmp_path / "c.vtp")
    words = ("c.vtp", "-o", "c.vtu", "--report", "r.json", "--solve", "no", "--force")
    limits = ("--min-dihedral", 6.5, "--min-scaled-jacobian", 0.02)
    done = run(*words, *limits)
    assert done.returncode == 1, done.stderr
    assert "on 2 triangles, no tetrahedron can reach the minimum dihedral angle of 6.5 degrees" in done.stderr
    assert "1 of them forced by triangles of the surface" in done.stderr
    done = run(*words, *limits, "--accept-forced")
    assert done.returncode == 0, done.stderr
    assert "warning: fit but for 1 accepted tetrahedron: the minimum dihedral angle is 6 degrees" in done.stderr
    results = json.loads((tmp_path / "r.json").read_text())["results"]
    volume, listed = results["volume"], results["volume"]["forced_by_surface"]
    assert [entry["material"] for entry in listed] == ["wedge", "wedge"]
    for entry in listed:
        assert entry["possible_degrees"] == pytest.approx(6.0, abs=1e-3)
        assert entry["min_dihedral"] == pytest.approx(6.0)
        np.testing.assert_allclose(entry["place_mm"], [1.0, 0.55, 0.05], atol=0.1)
    assert [entry["forced"] for entry in volume["regions"]] == [0, 1]
    assert volume["quality"]["min_dihedral"]["min"] == pytest.approx(6.0)
    assert volume["smallest_elsewhere"]["min_dihedral"] >= 6.5
    # with limits that every tetrahedron can reach, the list of forcing triangles must be empty
    done = run("c.vtp", "-o", "d.vtu", "--report", "d.json", "--solve", "no", "--min-scaled-jacobian", 0.02)
    assert done.returncode == 0, done.stderr
    assert json.loads((tmp_path / "d.json").read_text())["results"]["volume"]["forced_by_surface"] == []


@NEEDS_HXT
def test_what_a_triangle_forces_by_its_own_angle_is_listed_and_judged_by_what_it_allows(
    tmp_path: Path, run: Run
) -> None:
    # One material is a single tetrahedron on a triangle with an angle of 2.6 degrees. At the corner
    # with this angle, the third edge of the tetrahedron rises steeply; the dihedral angle at this
    # edge is 5.3 degrees.
    half, rise = np.radians(1.3), np.arcsin(np.tan(np.radians(1.3)) / np.tan(np.radians(2.65)))
    inner = 2.0 * np.array(
        [
            [0.0, 0.0, 0.0],
            [1.0, -np.tan(half), 0.0],
            [1.0, np.tan(half), 0.0],
            [0.5 * np.cos(rise), 0.0, 0.5 * np.sin(rise)],
        ]
    )
    points, triangles = sphere(6.0, 3)
    faces = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]]) + len(points)
    material = np.repeat([1, 2], [len(triangles), len(faces)])
    made = Made(np.vstack([points, inner]), np.vstack([triangles, faces]), material, material - 1, ("body", "wedge"))
    made.save(tmp_path / "c.vtp")
    assert run("c.vtp", "-o", "d.vtu", "--solve", "no").returncode == 1
    done = run("c.vtp", "-o", "c.vtu", "--report", "r.json", "--solve", "no", "--accept-forced")
    assert done.returncode == 0, done.stderr
    assert "with a small angle, no tetrahedron can reach both a dihedral angle of 5 degrees" in done.stderr
    volume = json.loads((tmp_path / "r.json").read_text())["results"]["volume"]
    listed = volume["forced_by_triangle"]
    assert {entry["material"] for entry in listed} == {"body", "wedge"}
    for entry in listed:
        assert entry["possible_scaled_jacobian"] < 0.05
        assert entry["min_scaled_jacobian"] > 0.5 * entry["possible_scaled_jacobian"]
        assert entry["min_dihedral"] >= 5.0
    assert volume["quality"]["scaled_jacobian"]["min"] < 0.05 <= volume["smallest_elsewhere"]["scaled_jacobian"]
