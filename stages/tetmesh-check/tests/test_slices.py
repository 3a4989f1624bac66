"""Tests of slices of the volume: their orientation, and the outline of the mesh."""

from __future__ import annotations

import base64
import io
import re
from dataclasses import replace

import numpy as np
import pytest
import pyvista as pv
from conftest import ball, merged, volume_with_ball
from PIL import Image

from tetmesh_check.datasets import from_polydata, to_polydata
from tetmesh_check.report.colours import Entry
from tetmesh_check.report.page.scan import Scan
from tetmesh_check.report.page.slices import Shades, outlines, path_of, shades_of, slices, stacks

# grids with permuted, reversed and oblique axes
ROTATION = np.array([[0.96, -0.28, 0.0], [0.28, 0.96, 0.0], [0.0, 0.0, 1.0]])
GRIDS = {
    "LPS": np.eye(3),
    "RAS": np.diag([-1.0, -1.0, 1.0]),
    "ASL": np.array([[0.0, 0.0, 1.2], [-0.9, 0.0, 0.0], [0.0, 1.0, 0.0]]),
    "oblique": ROTATION,
}


def area(chain: np.ndarray) -> float:
    """Return the area of a closed polygon, shape ``(k, 2)``."""
    x, y = chain.T
    return abs(0.5 * float((x[:-1] * y[1:] - x[1:] * y[:-1]).sum()))


@pytest.mark.parametrize("at", [0, 3, -9])
def test_the_outline_is_the_intersection(at: int) -> None:
    surface = ball(10.0, 4)
    found = outlines(surface, np.array([at, 11]))
    ((chain,), nothing) = found
    assert nothing == []
    assert (chain[0] == chain[-1]).all()
    radius = np.sqrt(100.0 - at * at)
    assert np.linalg.norm(chain, axis=1).max() <= radius + 1e-5
    assert area(chain) == pytest.approx(np.pi * radius**2, abs=2.5)  # of at most 314


def test_several_and_open_outlines() -> None:
    surface = ball(1.0, 2).translate((0.0, 0.0, 1.1))
    both = merged(surface, surface.translate((5.0, 0.0, 0.0)))
    assert [len(polygons) for polygons in outlines(both, np.array([1, 2, 3]))] == [2, 2, 0]
    points, triangles = from_polydata(surface)
    half = to_polydata(points, triangles[points[triangles][:, :, 0].mean(axis=1) > 0])
    ((chain,),) = outlines(half, np.array([1]))
    assert (chain[0] != chain[-1]).any()


def test_the_middle_one_of_equal_outlines_is_shown_first() -> None:
    scan = Scan(np.zeros((20, 20, 20)), np.eye(3), np.zeros(3), True)
    block = pv.Box((4.2, 15.2, 2.2, 12.2, 1.2, 18.2), quads=False).triangulate()
    for stack in stacks(scan, shades_of(scan, []), from_polydata(block)):
        assert stack["first"] == len(stack["slices"]) // 2


def test_paths() -> None:
    square = np.array([[0.0, 0.0], [0.1, 0.0], [2.0, 0.0], [2.0, 2.0], [0.0, 0.0]])
    assert path_of([square]) == "M0 0l20 0 0 20 -20 -20z"
    assert path_of([np.array([[1.1, 1.1], [1.15, 1.1]])]) == ""


@pytest.mark.parametrize("name", GRIDS)
def test_the_patient_is_seen_as_radiologists_do(name: str) -> None:
    scan = volume_with_ball(GRIDS[name])
    shades = shades_of(scan, [])
    planes = stacks(scan, shades, None)
    assert [plane["name"] for plane in planes] == ["axial", "coronal", "sagittal"]
    letters = [plane["letters"] for plane in planes]
    assert letters == [["R", "L", "A", "P"], ["R", "L", "S", "I"], ["A", "P", "S", "I"]]
    assert [plane["towards"] for plane in planes] == [("I", "S"), ("A", "P"), ("R", "L")]
    assert scan.tilt == pytest.approx(np.degrees(np.arccos(0.96)) if name == "oblique" else 0.0, abs=1e-6)
    if name != "oblique":
        assert "".join(scan.letters(axis)[1] for axis in range(3)) == name
    # slices have the numbers of the file
    for plane, axis in zip(planes, (2, 1, 0), strict=True):
        grid = scan.world_axes.index(axis)
        numbers = plane["slices"] if scan.step[axis, grid] > 0 else plane["slices"][::-1]
        assert numbers == list(range(scan.values.shape[grid]))
    other = replace(scan, anatomical=False)
    assert stacks(other, shades, None)[0]["letters"] == ["\u2212x", "+x", "+y", "\u2212y"]


@pytest.mark.parametrize("name", GRIDS)
def test_the_outline_lies_where_the_ball_is(name: str) -> None:
    scan = volume_with_ball(GRIDS[name], labels=True)
    bright, dull = (230, 159, 0), (60, 50, 40)
    shades = shades_of(scan, [Entry("ball", bright, (2,)), Entry("floor", dull, (1,), False)])
    centre = scan.to_index(np.zeros((1, 3)))[0, [scan.world_axes.index(axis) for axis in (2, 1, 0)]]
    for stack, middle_slice in zip(stacks(scan, shades, from_polydata(ball(10.0, 4))), centre, strict=True):
        with Image.open(io.BytesIO(base64.b64decode(stack["image"].partition(",")[2]))) as opened:
            sheet = np.asarray(opened.convert("RGB"))
        n, (width, height) = stack["first"], stack["size"]
        assert abs(stack["slices"][n] - middle_slice) <= 0.5, "the longest outline is shown first"
        x, y = (n % stack["columns"]) * width, (n // stack["columns"]) * height
        inside = (sheet[y : y + height, x : x + width] == bright).all(axis=2)
        numbers = [int(k) for k in re.findall(r"-?\d+", stack["paths"][n])]
        chain = np.cumsum(np.array(numbers).reshape(-1, 2), axis=0) / 10.0
        chain = np.concatenate([chain, chain[:1]])
        assert inside.sum() == pytest.approx(area(chain), rel=0.06)
        rows, columns = np.nonzero(inside)
        middle = 0.5 * (chain.min(axis=0) + chain.max(axis=0))
        pixel = np.ptp(chain[:, 0]) / 20.0  # the diameter of the ball
        assert abs(columns.mean() + 0.5 - middle[0]) < 0.5 * pixel
        assert abs(rows.mean() + 0.5 - middle[1]) < 0.5 * pixel


def test_a_scan_is_shown_by_its_percentiles() -> None:
    scan = volume_with_ball()
    scan.values[0, 0, 0] = 30_000
    shades = shades_of(scan, [])
    assert 0.0 < shades.values[0] < 20.0
    assert 200.0 < shades.values[-1] < 230.0
    ramp = Shades(np.linspace(0.0, 100.0, 256), shades.colours)
    shown = np.asarray(ramp.image(np.array([[-5.0, 51.0], [np.nan, 200.0]])).convert("L"))
    np.testing.assert_array_equal(shown, [[0, 0], [130, 255]])
    flat = Scan(np.zeros((3, 3, 3), dtype=np.int16), np.eye(3), np.zeros(3), True)
    assert slices(flat, None, []).count('class="window"') == 3


def test_a_page_stays_small() -> None:
    values = np.random.default_rng(1).normal(size=(300, 300, 200)).astype(np.float32)
    scan = Scan(values, np.eye(3), np.zeros(3), True)
    text = slices(scan, None, [])
    assert text.count('type="range"') == 3
    assert 'max="39"' in text
    assert len(text) < 6e6
