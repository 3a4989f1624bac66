"""Tests of the quality measures against known shapes and VTK's Verdict."""

from __future__ import annotations

import numpy as np
import pytest
import pyvista as pv

from tetmesh_check.checks import counted, percent
from tetmesh_check.quality import centres_of, summarize, tetrahedron_quality, triangle_quality

REGULAR = np.array([[1.0, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]])


def random_tetrahedra(count: int) -> tuple[np.ndarray, np.ndarray]:
    points = np.random.default_rng(7).normal(size=(4 * count, 3))
    cells = np.arange(4 * count).reshape(-1, 4)
    a, b, c, d = (points[cells[:, k]] for k in range(4))
    negative = np.einsum("ij,ij->i", np.cross(b - a, c - a), d - a) < 0
    cells[negative] = cells[negative][:, [0, 2, 1, 3]]
    return points, cells


def test_regular_tetrahedron() -> None:
    for order, sign in (([0, 1, 2, 3], 1.0), ([0, 2, 1, 3], -1.0)):
        quality = tetrahedron_quality(REGULAR, np.array([order]))
        sign = np.sign(quality.volume[0])
        assert abs(quality.volume[0]) == pytest.approx(np.sqrt(8.0) ** 3 / (6 * np.sqrt(2)))
        assert quality.radius_ratio[0] == pytest.approx(1.0)
        assert quality.scaled_jacobian[0] == pytest.approx(sign)
        assert quality.min_dihedral[0] == pytest.approx(np.degrees(np.arccos(1 / 3)))
        assert quality.max_dihedral[0] == pytest.approx(np.degrees(np.arccos(1 / 3)))
        assert quality.aspect_ratio[0] == pytest.approx(1.0)
        assert quality.edge_ratio[0] == pytest.approx(1.0)


def test_rounding_errors_print_as_no_change() -> None:
    assert [percent(v) for v in (3.55e-13, -2e-9, 0.0, 0.00123, -1.5, 12.345)] == [
        "0 %", "0 %", "0 %", "+0.00123 %", "-1.5 %", "+12.3 %",
    ]  # fmt: skip
    assert counted(1, "triangle") == "1 triangle"
    assert counted(2, "body", "bodies") == "2 bodies"


def test_vtk_order_is_positive() -> None:
    corner = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
    assert tetrahedron_quality(corner, np.array([[0, 1, 2, 3]])).volume[0] == pytest.approx(1 / 6)
    assert tetrahedron_quality(corner, np.array([[0, 2, 1, 3]])).volume[0] == pytest.approx(-1 / 6)


def test_flat_tetrahedron_is_zero_not_nan() -> None:
    flat = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]])
    quality = tetrahedron_quality(flat, np.array([[0, 1, 2, 3], [0, 0, 0, 0]]))
    assert np.all(quality.radius_ratio == 0)
    assert np.all(quality.scaled_jacobian == 0)
    assert np.all(np.isinf(quality.aspect_ratio))
    assert not np.isnan(quality.min_dihedral).any()


def test_tetrahedra_agree_with_verdict() -> None:
    points, cells = random_tetrahedra(500)
    quality = tetrahedron_quality(points, cells)
    grid = pv.UnstructuredGrid({pv.CellType.TETRA: cells}, points)
    measured = grid.cell_quality(["radius_ratio", "scaled_jacobian", "aspect_ratio", "volume"])
    np.testing.assert_allclose(quality.volume, measured["volume"], rtol=1e-9)
    np.testing.assert_allclose(1.0 / quality.radius_ratio, measured["radius_ratio"], rtol=1e-7)
    np.testing.assert_allclose(quality.scaled_jacobian, measured["scaled_jacobian"], rtol=1e-9)
    np.testing.assert_allclose(quality.aspect_ratio, measured["aspect_ratio"], rtol=1e-7)


def dihedral_angles(corner: np.ndarray) -> list[float]:
    """Return the dihedral angle at each edge from its definition, degrees."""
    angles = []
    for i in range(4):
        for j in range(i + 1, 4):
            k, m = (x for x in range(4) if x not in (i, j))
            along = (corner[j] - corner[i]) / np.linalg.norm(corner[j] - corner[i])
            u, v = (corner[x] - corner[i] - ((corner[x] - corner[i]) @ along) * along for x in (k, m))
            angles.append(float(np.degrees(np.arccos(u @ v / np.linalg.norm(u) / np.linalg.norm(v)))))
    return angles


def test_dihedral_angles_against_the_definition() -> None:
    # the Verdict library cannot serve as a reference, because its minimum angle is the acute angle
    # between the planes
    points, cells = random_tetrahedra(100)
    quality = tetrahedron_quality(points, cells)
    truth = np.array([dihedral_angles(points[cell]) for cell in cells])
    np.testing.assert_allclose(quality.min_dihedral, truth.min(axis=1), rtol=1e-9)
    np.testing.assert_allclose(quality.max_dihedral, truth.max(axis=1), rtol=1e-9)


def test_triangles_against_closed_form() -> None:
    points = np.array([[0.0, 0, 0], [3, 0, 0], [0, 4, 0], [1, 0, 0], [0.5, np.sqrt(0.75), 0], [2, 0, 0]])
    quality = triangle_quality(points, np.array([[0, 1, 2], [0, 3, 4], [0, 1, 5]]))
    np.testing.assert_allclose(quality.area, [6.0, np.sqrt(3) / 4, 0.0])
    np.testing.assert_allclose(quality.radius_ratio, [2 * 1.0 / 2.5, 1.0, 0.0])
    np.testing.assert_allclose(quality.min_angle[:2], [np.degrees(np.arcsin(0.6)), 60.0])
    np.testing.assert_allclose(quality.max_angle[:2], [90.0, 60.0])


def test_summary_counts_everything_once() -> None:
    values = np.array([0.0, 0.5, 1.0, np.inf])
    summary = summarize(values, np.linspace(0, 1, 11))
    assert summary["count"] == 4
    assert summary["infinite"] == 1
    assert summary["mean"] == pytest.approx(0.5)
    assert sum(summary["histogram"]["counts"]) == 3


def test_centres() -> None:
    points, cells = random_tetrahedra(50)
    np.testing.assert_allclose(centres_of(points, cells), points[cells].mean(axis=1), rtol=1e-12, atol=1e-15)
    np.testing.assert_allclose(
        centres_of(points[:, 0], cells), points[cells].mean(axis=1)[:, 0], rtol=1e-12, atol=1e-15
    )
