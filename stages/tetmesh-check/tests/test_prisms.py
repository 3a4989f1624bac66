"""Tests of the measures of prisms, against VTK and known shapes."""

from __future__ import annotations

import numpy as np
import pytest
import pyvista as pv

from tetmesh_check.prisms import jacobians, scaled_jacobian

RIGHT_PRISM = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 0, 1], [0, 1, 1]])


def test_measures_of_prisms_are_those_of_vtk() -> None:
    points = np.concatenate([RIGHT_PRISM + 0.2 * noise for noise in np.random.default_rng(3).normal(size=(40, 6, 3))])
    prisms = np.arange(len(points)).reshape(-1, 6)
    grid = pv.UnstructuredGrid({pv.CellType.WEDGE: prisms}, points)
    coefficients = jacobians(points, prisms)
    np.testing.assert_allclose(coefficients.sum(axis=1) / 18.0, grid.compute_cell_sizes()["Volume"], atol=1e-12)
    measured = grid.cell_quality("scaled_jacobian")["scaled_jacobian"]
    np.testing.assert_allclose(scaled_jacobian(points, prisms), measured, atol=1e-12)
    regular = RIGHT_PRISM.copy()
    regular[[2, 5], :2] = [0.5, np.sqrt(0.75)]
    assert scaled_jacobian(regular, np.arange(6)[None])[0] == pytest.approx(1.0)


def test_a_prism_can_fold_between_positive_corners() -> None:
    # the second triangle is turned by 170 degrees, so that the prism shrinks to a point halfway
    folded = RIGHT_PRISM - [1.0 / 3.0, 1.0 / 3.0, 0.0]
    angle = np.radians(170.0)
    folded[3:, :2] = folded[3:, :2] @ np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    coefficients = jacobians(folded, np.arange(6)[None])[0]
    assert coefficients[:3].min() > 0.0
    assert coefficients[6:].min() > 0.0
    assert coefficients.min() < 0.0
