"""Tests of the colours of materials, also as people with colour-vision deficiencies see them."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
from conftest import volume_with_ball

from tetmesh_check.report.colours import PALETTE, distinct, key_of, material_colours

VISION = {
    "normal": np.eye(3),
    "protanopia": [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998]],
    "deuteranopia": [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.01182, 0.04294, 0.968881]],
    "tritanopia": [[1.255528, -0.076749, -0.178779], [-0.078411, 0.930809, 0.147602], [0.004733, 0.691367, 0.3039]],
}
"""Machado, Oliveira and Fernandes (2009), severity 1, for linear sRGB."""
XYZ = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]])


def lab(colours: np.ndarray, vision: str) -> np.ndarray:
    """Return CIELAB coordinates of sRGB bytes as seen with a kind of vision."""
    share = colours / 255.0
    linear = np.where(share <= 0.04045, share / 12.92, ((share + 0.055) / 1.055) ** 2.4)
    seen = np.clip(linear @ np.array(VISION[vision]).T, 0.0, 1.0) @ XYZ.T / XYZ.sum(axis=1)
    f = np.where(seen > 0.008856, np.cbrt(seen), 7.787 * seen + 16 / 116)
    return np.stack([116 * f[:, 1] - 16, 500 * (f[:, 0] - f[:, 1]), 200 * (f[:, 1] - f[:, 2])], axis=1)


def closest(colours: np.ndarray) -> float:
    """Return the smallest distance of two colours for any kind of vision."""
    places = np.stack([lab(colours, vision) for vision in VISION])
    apart = np.linalg.norm(places[:, :, None] - places[:, None], axis=3)
    return float(apart[:, ~np.eye(len(colours), dtype=bool)].min())


def test_colours_differ_for_every_vision() -> None:
    colours = distinct(PALETTE).astype(float)
    assert closest(colours[:7]) > 16.0
    assert closest(colours) > 13.8
    # neither invisible on black slices nor on white pages
    lightness = lab(colours, "normal")[:, 0]
    assert lightness.min() > 35.0
    assert lightness.max() < 92.0


def test_few_materials_take_the_palette_in_order() -> None:
    colours = material_colours(6, [(1, 0), (2, 1), (5, 4)])
    np.testing.assert_array_equal(colours[0], 0)
    np.testing.assert_array_equal(colours[1:], distinct(PALETTE[:5]))
    assert material_colours(1).shape == (1, 3)


def test_many_materials_differ_from_their_neighbours() -> None:
    count = 200
    generator = np.random.default_rng(1)
    sides = np.column_stack([np.arange(count), (np.arange(count) + 20) % count])
    sides = np.concatenate([sides, generator.integers(0, count, (300, 2))])
    sides = sides[sides[:, 0] != sides[:, 1]]
    colours = material_colours(count, sides)
    assert len(np.unique(colours, axis=0)) == count
    places = lab(colours.astype(float), "normal")
    apart = np.linalg.norm(places[sides[:, 0]] - places[sides[:, 1]], axis=1)
    assert apart.min() > 13.0
    # repeated colours look the same
    palette = lab(distinct(PALETTE).astype(float), "normal")
    assert np.linalg.norm(places[1:, None] - palette[None], axis=2).min(axis=1).max() < 3.0


def test_the_material_of_an_object_with_planes_has_its_labels() -> None:
    table = [("outside", [0]), ("object", [1, 2])]
    materials = [{"name": name, "labels": [{"label": own, "layer": 0} for own in labels]} for name, labels in table]
    case = SimpleNamespace(reports={"distfield": {"parameters": {"labels": [1, 2], "materials": materials}}})
    (entry,) = key_of(case, volume_with_ball(labels=True), None)  # type: ignore[arg-type]
    assert (entry.name, entry.labels, entry.meshed) == ("object", (1, 2), True)
