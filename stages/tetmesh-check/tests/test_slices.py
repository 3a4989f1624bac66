"""Tests of slices of the volume: their orientation, and the outline of the mesh."""

from __future__ import annotations

import base64
import io
import re

import numpy as np
import pytest
from conftest import ball, volume_with_ball
from PIL import Image

from tetmesh_check.polydata import from_polydata
from tetmesh_check.report.page.key import Entry
from tetmesh_check.report.page.scan import Scan
from tetmesh_check.report.page.slices import Window, _stack, outline, path_of, planes_of, slices, window_of

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


@pytest.mark.parametrize("at", [0.0, 3.3, -9.9])
def test_the_outline_is_the_intersection(at: float) -> None:
    points, triangles = from_polydata(ball(10.0, 4))
    (chain,) = outline(points, triangles, 2, at)
    assert (chain[0] == chain[-1]).all()
    np.testing.assert_allclose(chain[:, 2], at, atol=1e-12)
    assert area(chain[:, :2]) == pytest.approx(np.pi * (100.0 - at * at), abs=2.5)  # of at most 314
    assert outline(points, triangles, 2, 10.5) == []


def test_several_and_open_outlines() -> None:
    points, triangles = from_polydata(ball(1.0, 2))
    two = np.concatenate([points, points + np.array([5.0, 0.0, 0.0])])
    both = np.concatenate([triangles, triangles + len(points)])
    assert len(outline(two, both, 2, 0.1)) == 2
    half = triangles[points[triangles][:, :, 0].mean(axis=1) > 0]
    (chain,) = outline(points, half, 2, 0.1)
    assert (chain[0] != chain[-1]).any()


def test_paths() -> None:
    square = np.array([[0.0, 0.0], [0.1, 0.0], [2.0, 0.0], [2.0, 2.0], [0.0, 0.0]])
    assert path_of([square]) == "M0 0l20 0 0 20 -20 -20z"
    assert path_of([np.array([[1.0, 1.0], [1.05, 1.0]])]) == ""


@pytest.mark.parametrize("name", GRIDS)
def test_the_patient_is_seen_as_radiologists_do(name: str) -> None:
    scan = volume_with_ball(GRIDS[name])
    planes = planes_of(scan)
    assert [scan.plane(plane.axis) for plane in planes] == ["axial", "coronal", "sagittal"]
    window = window_of(scan, [])
    letters = [_stack(scan, plane, window, None)["letters"] for plane in planes]
    assert letters == [["R", "L", "A", "P"], ["R", "L", "S", "I"], ["A", "P", "S", "I"]]
    assert scan.tilt == pytest.approx(np.degrees(np.arccos(0.96)) if name == "oblique" else 0.0, abs=1e-6)
    if name != "oblique":
        assert "".join(scan.letters(axis)[1] for axis in range(3)) == name
    other = Scan(scan.values, scan.step, scan.origin, False, False)
    assert _stack(other, planes_of(other)[0], window, None)["letters"] == ["\u2212x", "+x", "+y", "\u2212y"]


@pytest.mark.parametrize("name", GRIDS)
def test_the_outline_lies_where_the_ball_is(name: str) -> None:
    scan = volume_with_ball(GRIDS[name], labels=True)
    surface = ball(10.0, 4)
    points, triangles = from_polydata(surface)
    bright, dull = (230, 159, 0), (60, 50, 40)
    window = window_of(scan, [Entry("ball", bright, (2,)), Entry("floor", dull, (1,), False)])
    for plane in planes_of(scan):
        stack = _stack(scan, plane, window, (scan.to_index(points), triangles))
        with Image.open(io.BytesIO(base64.b64decode(stack["image"].partition(",")[2]))) as opened:
            sheet = np.asarray(opened.convert("RGB"))
        n, (width, height) = stack["first"], stack["size"]
        x, y = (n % stack["columns"]) * width, (n // stack["columns"]) * height
        inside = (sheet[y : y + height, x : x + width] == bright).all(axis=2)
        numbers = [int(k) for k in re.findall(r"-?\d+", stack["paths"][n])]
        chain = np.cumsum(np.array(numbers).reshape(-1, 2), axis=0) / 10.0
        chain = np.concatenate([chain, chain[:1]])
        assert inside.sum() == pytest.approx(area(chain), rel=0.06)
        rows, columns = np.nonzero(inside)
        middle = 0.5 * (chain.min(axis=0) + chain.max(axis=0))
        pixel = 1.0 / stack["millimetres"]
        assert abs(columns.mean() + 0.5 - middle[0]) < 0.5 * pixel
        assert abs(rows.mean() + 0.5 - middle[1]) < 0.5 * pixel


def test_a_scan_is_shown_by_its_percentiles() -> None:
    scan = volume_with_ball()
    scan.values[0, 0, 0] = 30_000
    window = window_of(scan, [])
    assert 0.0 < window.low < 20.0
    assert 200.0 < window.high < 230.0
    shades = np.asarray(Window(0.0, 100.0, {}).image(np.array([[-5.0, 50.0], [np.nan, 200.0]])))
    np.testing.assert_array_equal(shades, [[0, 0], [128, 255]])
    flat = Scan(np.zeros((3, 3, 3), dtype=np.int16), np.eye(3), np.zeros(3), True, False)
    assert slices(flat, None, []).count('class="window"') == 3


def test_a_page_stays_small() -> None:
    values = np.random.default_rng(1).normal(size=(300, 300, 200)).astype(np.float32)
    scan = Scan(values, np.eye(3), np.zeros(3), True, False)
    text = slices(scan, None, [])
    assert text.count('type="range"') == 3
    assert 'max="39"' in text
    assert len(text) < 6e6
