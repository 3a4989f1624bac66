"""Tests of gaps in quadratic meshes: a ball in a shell, whose sides are concentric spheres."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import pyvista as pv
from complexes import nested_balls
from conftest import NEEDS_HXT, Run, write_sizing
from febio import owner_of, read_febio
from isoparticles import _native
from test_gap import distances
from test_quadratic_materials import write_materials

pytestmark = NEEDS_HXT
OUTER, INNER, WIDTH = 10.0, 6.0, 0.2
PIECES = 4
"""Each curved triangle is read as this number squared of flat ones."""


def pieces_of(points: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the points and the triangles of a fine subdivision of quadratic triangles."""
    lattice = [(i, j, PIECES - i - j) for i in range(PIECES + 1) for j in range(PIECES + 1 - i)]
    number = {place: k for k, place in enumerate(lattice)}
    a, b, c = np.array(lattice).T / PIECES
    shapes = np.stack([a * (2 * a - 1), b * (2 * b - 1), c * (2 * c - 1), 4 * a * b, 4 * b * c, 4 * c * a], axis=1)
    found = np.einsum("ps,fsx->fpx", shapes, points[faces])
    up = [((i, j, k), (i - 1, j + 1, k), (i - 1, j, k + 1)) for i, j, k in lattice if i]
    down = [((i, j, k), (i - 1, j + 1, k), (i, j + 1, k - 1)) for i, j, k in lattice if i and k]
    local = np.array([[number[corner] for corner in corners] for corners in up + down])
    shift = len(lattice) * np.arange(len(faces))
    return found.reshape(-1, 3), (local[None] + shift[:, None, None]).reshape(-1, 3)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    place = tmp_path_factory.mktemp("gap")
    nested_balls((OUTER, INNER), (3, 2), ("shell", "core")).save(place / "b.surface.vtp")
    write_sizing(place / "h.vti", lambda world: np.full(len(world), 1.7), 14)
    indicators = [
        lambda world: OUTER - np.linalg.norm(world, axis=1),
        lambda world: np.zeros(len(world)),
        lambda world: np.linalg.norm(world, axis=1) - INNER,
    ]
    write_materials(place / "f.vti", indicators, ["outside", "shell", "core"])
    return place


def test_curved_sides_keep_their_distance(folder: Path, run: Run, tmp_path: Path) -> None:
    words = (
        folder / "b.surface.vtp",
        "--sizefield",
        folder / "h.vti",
        "--distfield",
        folder / "f.vti",
        "-o",
        "b.volume.vtu",
    )
    more = (
        "--order",
        2,
        "--gap",
        f"core/shell={WIDTH}",
        "--export",
        "feb",
        "--solve",
        "no",
        "-q",
        "--report",
        "r.json",
    )
    done = run(*words, *more)
    assert done.returncode == 0, done.stderr
    febio = read_febio(tmp_path / "b.volume.feb")
    assert febio.contacts == [("shell_to_core", "core_to_shell")]
    assert [owner_of(febio, name) for name in febio.contacts[0]] == ["shell", "core"]
    points = febio.points
    sides = [pieces_of(points, febio.surfaces[name]) for name in ("core_to_shell", "shell_to_core")]
    for (at, _), radius in zip(sides, (INNER - WIDTH / 2, INNER + WIDTH / 2), strict=True):
        np.testing.assert_allclose(np.linalg.norm(at, axis=1), radius, atol=0.02 * WIDTH)
    (one, first), (other, second) = sides
    both, shifted = np.concatenate([one, other]), second + len(one)
    for side, to in ((first, shifted), (shifted, first)):
        np.testing.assert_allclose(distances(both, side, to), WIDTH, rtol=0.01)

    grid = pv.read(tmp_path / "b.volume.quadratic.vtu")
    cells = np.asarray(grid.cells_dict[pv.CellType.QUADRATIC_TETRA]).astype(np.int64)
    coefficients = _native.jacobian_coefficients(np.asarray(grid.points)[cells].reshape(-1, 3))
    np.testing.assert_array_equal(np.asarray(grid.points), points)
    assert coefficients.min() > 0.0
    corners = points[cells[:, :4]]
    straight = np.abs(np.linalg.det(corners[:, 1:] - corners[:, :1]))
    np.testing.assert_allclose(grid.cell_data["jacobian_bound"], coefficients.min(axis=1) / straight, rtol=1e-9)
    volumes = {
        region: coefficients[np.asarray(grid.cell_data["region"]) == region].mean(axis=1).sum() / 6 for region in (1, 2)
    }
    whole, hole, core = (4.0 / 3.0 * np.pi * radius**3 for radius in (OUTER, INNER + WIDTH / 2, INNER - WIDTH / 2))
    assert [volumes[1], volumes[2]] == pytest.approx([whole - hole, core], rel=2e-3)

    results = json.loads((tmp_path / "r.json").read_text())["results"]
    (row,) = results["quadratic"]["split"]
    assert row["distance_mm"] == pytest.approx([WIDTH, WIDTH], rel=0.01)
    assert [check["verdict"] for check in results["checks"] if check["name"] == "gap_width"] == ["pass", "pass"]
