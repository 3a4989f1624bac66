"""Tests of currents through several materials: closed form in nested balls, and conservation."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from complexes import nested_balls
from conftest import NEEDS_HXT, Run, tetrahedra, write_sizing
from test_solve import FOREVER, block, elements

from tetmesh_check.fem.assembly import linear_elements
from tetmesh_check.fem.forward import potential_of
from tetmesh_check.quality import tetrahedron_quality

RADII = (10.0, 6.0, 4.0)
CONDUCTIVITY = (0.2, 0.05, 0.5)
"""Conductivities of the layers, S/m, the outermost first."""


def exact(points: np.ndarray, density: float) -> np.ndarray:
    """Return the potential (mV) of a uniform impressed current along x in the innermost ball.

    In layer i, it is (A_i r + B_i / r^2) cos(theta), with B = 0 in the innermost layer. The
    potential and the radial current are continuous. The radial current is zero at the outer radius.
    """
    count = len(RADII)
    matrix, right = np.zeros((2 * count, 2 * count)), np.zeros(2 * count)
    matrix[0, :2] = 1.0, -2.0 / RADII[0] ** 3
    matrix[1, 2 * count - 1] = 1.0
    for k in range(1, count):
        r = RADII[k]
        outer, inner = 2 * (k - 1), 2 * k
        matrix[2 * k, outer : outer + 2] = r, r**-2
        matrix[2 * k, inner : inner + 2] = -r, -(r**-2)
        matrix[2 * k + 1, outer : outer + 2] = CONDUCTIVITY[k - 1], -2.0 * CONDUCTIVITY[k - 1] / r**3
        matrix[2 * k + 1, inner : inner + 2] = -CONDUCTIVITY[k], 2.0 * CONDUCTIVITY[k] / r**3
        # only the innermost ball has an impressed current in addition to the conduction current
        right[2 * k + 1] = -density if k == count - 1 else 0.0
    factors = np.linalg.solve(matrix, right).reshape(count, 2)
    r = np.linalg.norm(points, axis=1)
    layer = np.clip((r[:, None] < np.array(RADII)).sum(axis=1) - 1, 0, count - 1)
    a, b = factors[layer].T
    return (a + b / np.maximum(r, 1e-9) ** 3) * points[:, 0]


def solved(folder: Path, run: Run, subdivisions: tuple[int, ...], h: float) -> tuple[float, dict, np.ndarray]:
    """Solve on nested balls; return the relative L2 error, the results and the potential."""
    nested_balls(RADII, subdivisions, ("body", "lung", "heart")).save(folder / "c.vtp")
    write_sizing(folder / "h.vti", lambda world: np.full(len(world), h))
    words = [
        "c.vtp",
        "--sizefield",
        "h.vti",
        "-o",
        "c.vtu",
        "--force",
        "--report",
        "r.json",
        "-q",
        "--source",
        "heart=2,0,0",
    ]
    given = [
        f"--conductivity={name}={value}" for name, value in zip(("body", "lung", "heart"), CONDUCTIVITY, strict=True)
    ]
    done = run(*words, *given)
    assert done.returncode == 0, done.stderr
    points, cells, grid = tetrahedra(folder / "c.vtu")
    results = json.loads((folder / "r.json").read_text())["results"]
    regions = np.asarray(grid.cell_data["region"]).astype(np.int64)
    sigma = np.array([1.0, *CONDUCTIVITY])[regions]
    impressed = np.multiply.outer([2.0, 0.0, 0.0], regions[:, None] == 3)
    basis = linear_elements(elements(points, cells))
    potential, _current, figures = potential_of(basis, sigma, impressed, FOREVER)
    assert figures["multigrid"]["converged"]
    truth = exact(points, 2.0)
    weight = np.bincount(cells.ravel(), np.repeat(tetrahedron_quality(points, cells).volume, 4))
    error = np.sqrt(weight @ (potential - truth) ** 2 / (weight @ truth**2))
    return float(error), results, potential


def test_the_closed_form_is_one() -> None:
    """By differences, the current is continuous at the interfaces and zero at the outer surface."""
    step = 1e-6
    slopes = []
    for r in (RADII[0] - 2 * step, *(RADII[k] + s * step for k in (1, 2) for s in (2, -2))):
        at = np.array([[r - step, 0.0, 0.0], [r + step, 0.0, 0.0]])
        slopes.append(float(np.diff(exact(at, 2.0))[0] / (2 * step)))
    body, lung, heart = CONDUCTIVITY
    assert slopes[0] == pytest.approx(0.0, abs=1e-4)
    assert body * slopes[1] == pytest.approx(lung * slopes[2], rel=1e-4)
    assert lung * slopes[3] == pytest.approx(heart * slopes[4] - 2.0, rel=1e-4)


@NEEDS_HXT
def test_nested_balls_of_different_conductivity(tmp_path: Path, run: Run) -> None:
    coarse, _, _ = solved(tmp_path, run, (2, 2, 2), 2.0)
    fine, results, potential = solved(tmp_path, run, (3, 3, 3), 1.0)
    assert fine < 0.05
    # with linear elements, the error of the potential is proportional to h^2, so half the edge
    # length gives about a quarter of the error
    assert 3.0 < coarse / fine < 5.5
    figures = results["solve"]["forward"]
    assert figures["source"] == "heart"
    assert figures["imbalance"] < 1e-6
    checks = {check["name"]: check for check in results["checks"]}
    assert checks["current_conserved"]["verdict"] == "pass"
    assert checks["current_conserved"]["value"] == figures["imbalance"]
    regions = {entry["name"]: entry for entry in figures["regions"]}
    assert [regions[name]["conductivity_s_per_m"] for name in ("body", "lung", "heart")] == list(CONDUCTIVITY)
    # the maximum potential is on the surface of the source
    assert regions["heart"]["potential_mv"]["max"] == pytest.approx(potential.max(), rel=1e-6)
    assert regions["heart"]["potential_mv"]["max"] == pytest.approx(exact(np.array([[4.0, 0, 0]]), 2.0)[0], rel=0.05)
    assert regions["body"]["potential_mv"]["max"] == pytest.approx(exact(np.array([[6.0, 0, 0]]), 2.0)[0], rel=0.05)
    written = tetrahedra(tmp_path / "c.vtu")[2].point_data["potential"]
    np.testing.assert_allclose(written, potential, atol=1e-8 * np.abs(potential).max())
    # the currents into and out of the lung through its interface with the body nearly cancel
    through = {entry["name"]: entry for entry in figures["interfaces"]}
    assert abs(through["lung/body"]["net_ua"]) < 0.01 * through["lung/body"]["passing_ua"]
    assert through["body/outside"]["net_ua"] == 0.0


@NEEDS_HXT
def test_a_skipped_source_is_a_warning(tmp_path: Path, run: Run) -> None:
    nested_balls(RADII, (2, 2, 2), ("body", "lung", "heart")).save(tmp_path / "c.vtp")
    done = run("c.vtp", "-o", "c.vtu", "-q", "--source", "heart", "--solve", "no")
    assert done.returncode == 0
    assert "warning: no problem is solved: --solve no was given" in done.stderr


def test_a_bar_of_two_materials() -> None:
    """For a uniform source in one half of a bar, the solution of linear elements is exact."""
    points, cells = block((4, 2, 2))
    first = points[cells].mean(axis=1)[:, 0] < 2.0
    basis = linear_elements(elements(points, cells))
    impressed = np.multiply.outer([3.0, 0.0, 0.0], first[:, None])
    potential, current, figures = potential_of(basis, np.where(first, 0.5, 0.1), impressed, FOREVER)
    assert figures["multigrid"]["converged"]
    assert figures["parts"] == 1
    # No current leaves the bar. In the source, the conduction current cancels the impressed
    # current; elsewhere, both are zero.
    np.testing.assert_allclose(current, 0.0, atol=1e-6)
    truth = np.minimum(points[:, 0], 2.0) * 3.0 / 0.5
    np.testing.assert_allclose(potential - potential[0], truth - truth[0], atol=1e-5)
