"""Tests of fields read from files: their position, and the background mesh made from them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import pyvista as pv
from conftest import ball, write_sizing

from tetmesh_check.errors import StageError
from tetmesh_check.fields import read_sizing_field
from tetmesh_check.quality import signed_tetrahedron_volumes
from tetmesh_check.surface import read_surface


def linear(world: np.ndarray) -> np.ndarray:
    return 5.0 + world @ np.array([0.1, -0.05, 0.2])


def test_trilinear_is_exact_for_a_linear_field_and_clamped_outside(tmp_path: Path) -> None:
    field, history, _ = read_sizing_field(write_sizing(tmp_path / "s.vti", linear))
    samples = np.random.default_rng(1).uniform(-12, 12, size=(200, 3))
    np.testing.assert_allclose(field.trilinear(samples), linear(samples), rtol=1e-6)
    np.testing.assert_allclose(field.trilinear(np.array([[40.0, 0, 0]])), linear(np.array([[12.0, 0, 0]])), rtol=1e-6)
    assert field.voxel == pytest.approx(1.0)
    assert history == {"tool": "sizefield", "version": "0"}


def test_oblique_left_handed_placement(tmp_path: Path) -> None:
    axes = np.array([[0.0, 1, 0], [np.sqrt(0.5), 0, -np.sqrt(0.5)], [np.sqrt(0.5), 0, np.sqrt(0.5)]]) @ np.diag(
        [1, 1, -1]
    )
    assert np.linalg.det(axes) * np.linalg.det(np.diag([1, 1, -1])) != 0
    image = pv.ImageData(dimensions=(9, 10, 11), spacing=(1.0, 2.0, 0.5), origin=(3, -4, 5))
    image.direction_matrix = axes
    index = np.stack(np.meshgrid(range(9), range(10), range(11), indexing="ij"), -1).reshape(-1, 3)
    world = (index * [1.0, 2.0, 0.5]) @ axes.T + [3, -4, 5]
    order = np.lexsort(index.T[[0, 1, 2]])  # x fastest
    image["sizing"] = (20 + linear(world[order])).astype(np.float32)
    image.save(tmp_path / "s.vti")
    field, *_ = read_sizing_field(tmp_path / "s.vti")
    np.testing.assert_allclose(field.trilinear(world), 20 + linear(world), rtol=1e-6)


@pytest.mark.parametrize("max_nodes", [100_000, 800])
def test_background_covers_the_object_without_gaps(tmp_path: Path, max_nodes: int) -> None:
    ball(8.0).save(tmp_path / "b.vtp")
    surface = read_surface(tmp_path / "b.vtp")
    field, *_ = read_sizing_field(write_sizing(tmp_path / "s.vti", linear))
    points, cells, values, stride = field.background(surface.points, surface.triangles, max_nodes)
    assert len(points) <= max_nodes
    assert (stride == 1) == (max_nodes > 10_000)
    # five tetrahedra fill each cube
    volumes = np.abs(signed_tetrahedron_volumes(points, cells))
    cubes = len(cells) / 5
    assert volumes.sum() == pytest.approx(cubes * stride**3)
    grid = pv.UnstructuredGrid({pv.CellType.TETRA: cells}, points)
    inside = np.random.default_rng(2).normal(size=(500, 3))
    inside *= 8.0 / np.maximum(np.linalg.norm(inside, axis=1), 1e-9)[:, None] * np.linspace(0, 1, 500)[:, None]
    assert (grid.find_containing_cell(inside) >= 0).all()
    np.testing.assert_allclose(values, linear(points), rtol=1e-5)
    # adjacent cubes share face diagonals, so each face belongs to one or two tetrahedra
    faces = np.sort(np.concatenate([cells[:, f] for f in ([0, 1, 2], [0, 1, 3], [0, 2, 3], [1, 2, 3])]), 1)
    _, uses = np.unique(faces, axis=0, return_counts=True)
    assert uses.max() == 2
    border = (uses == 1).sum()
    assert border % 2 == 0
    assert border < 0.5 * len(uses)


@pytest.mark.parametrize("max_nodes", [100_000, 800])
def test_world_grid_covers_the_object(tmp_path: Path, max_nodes: int) -> None:
    ball(8.0).save(tmp_path / "b.vtp")
    surface = read_surface(tmp_path / "b.vtp")
    field, *_ = read_sizing_field(write_sizing(tmp_path / "s.vti", linear))
    values, origin, spacing = field.world_grid(surface.points, max_nodes)
    assert values.size <= max_nodes
    assert (spacing == 1.0) == (max_nodes > 10_000)
    nodes = np.array(origin) + spacing * np.argwhere(np.ones(values.shape))
    np.testing.assert_allclose(values.ravel(), linear(nodes), rtol=0.03)  # clamped beyond 12 mm
    assert (nodes.min(axis=0) <= surface.points.min(axis=0)).all()
    assert (nodes.max(axis=0) >= surface.points.max(axis=0)).all()


def test_files_that_are_no_size_field(tmp_path: Path) -> None:
    image = pv.ImageData(dimensions=(4, 4, 4))
    image["signed_distance"] = np.zeros(64, dtype=np.float32)
    image.save(tmp_path / "wrong.vti")
    with pytest.raises(StageError, match="signed_distance"):
        read_sizing_field(tmp_path / "wrong.vti")
    for name, value in (("zero", 0.0), ("nan", np.nan), ("negative", -1.0)):
        write_sizing(tmp_path / f"{name}.vti", lambda world, v=value: np.full(len(world), v))
        with pytest.raises(StageError, match="not positive and finite"):
            read_sizing_field(tmp_path / f"{name}.vti")
    ball().save(tmp_path / "ball.vtp")
    with pytest.raises(StageError, match="not an image"):
        read_sizing_field(tmp_path / "ball.vtp")
