"""Slices of the input volume with the outline of the mesh."""

from __future__ import annotations

import base64
import json
import zlib
from dataclasses import dataclass
from typing import Any

import numpy as np
import pyvista as pv
from numpy.typing import NDArray
from PIL import Image

from tetmesh_check.datasets import to_polydata
from tetmesh_check.quality import Cells, Points
from tetmesh_check.report.colours import Entry
from tetmesh_check.report.page.scan import Scan
from tetmesh_check.report.page.templates import image_data, render

SLICES = 40
"""Maximum number of slices per plane."""
PIXELS = 288
"""Longest side of a slice on the page. Three planes of 40 slices of a CT take about 1.5 MB."""
_PLANES = ("sagittal", "coronal", "axial")
"""The plane across each axis of the body's world."""
_COLUMNS = 8
"""Slices side by side in a sheet."""
_MARGIN = 0.25
"""Margin of the volume around the mesh, relative to its longest side."""
_PERCENTILES = (0.5, 99.5)
"""Percentiles of the values shown as black and white, so that few voxels do not set the range."""
_NEAR = 0.35
"""Width of the cells of a grid, pixels. Of consecutive points in one cell, an outline keeps the
first."""
_TENTHS = 10
"""Steps per pixel to which outlines are rounded."""
_EQUAL = 0.99
"""Outlines count as equal if their lengths differ by less than 1 %, which the eye does not see."""


@dataclass(frozen=True)
class Shades:
    """Colours of some values. Other values get the colour of the nearest one."""

    values: NDArray[Any]
    """Labels, or the values of shades of grey, ascending, shape ``(n,)``."""
    colours: NDArray[np.uint8]
    """Shape ``(n, 3)``."""

    def image(self, values: NDArray[Any]) -> Image.Image:
        """Turn a slice into a picture with one pixel per voxel; the first axis points to the right.

        Parameters
        ----------
        values
            Shape ``(nx, ny)``. NaN is shown as the lowest value.
        """
        between = 0.5 * (self.values[1:] + self.values[:-1])
        nearest = np.searchsorted(between, np.nan_to_num(values, nan=self.values[0]))
        return Image.fromarray(self.colours[nearest].transpose(1, 0, 2))


def shades_of(scan: Scan, key: list[Entry]) -> Shades:
    """Choose the colours of labels, or shades of grey for a scan.

    Parameters
    ----------
    scan
        The volume.
    key
        Names and colours of its labels.
    """
    if scan.labels:
        # the background is black
        colours = {0: (0, 0, 0)} | {label: entry.colour for entry in key for label in entry.labels}
        values = np.array(sorted(colours))
        return Shades(values, np.array([colours[label] for label in values.tolist()], dtype=np.uint8))
    stride = max(1, round((scan.values.size / 4e6) ** (1 / 3)))
    sample = scan.values[::stride, ::stride, ::stride]
    sample = sample[np.isfinite(sample)]
    low, high = np.percentile(sample, _PERCENTILES)
    if low == high:
        low, high = sample.min(), sample.max()
    return Shades(np.linspace(low, high, 256), np.repeat(np.arange(256, dtype=np.uint8)[:, None], 3, axis=1))


def outlines(surface: pv.PolyData, places: NDArray[np.int64]) -> list[list[Points]]:
    """Cut a surface by planes across z into polygons, which are open where the surface is open.

    Parameters
    ----------
    surface
        Triangles.
    places
        Whole numbers: z of the planes, ascending.

    Returns
    -------
    list
        For each plane its polygons, each of shape ``(k, 2)``.
    """
    found: list[list[Points]] = [[] for _ in places]
    lines = surface.contour(places, scalars=surface.points[:, 2]).strip(join=True, max_length=surface.n_cells)
    for line in lines.cell:
        found[np.searchsorted(places, line.points[0, 2] - 0.5)].append(line.points[:, :2])
    return found


def path_of(polygons: list[Points]) -> str:
    """Write polygons as an SVG path in tenths of pixels.

    Parameters
    ----------
    polygons
        Positions in pixels, each of shape ``(k, 2)``.
    """
    words = []
    for polygon in polygons:
        moved = np.diff(np.floor(polygon / _NEAR), axis=0, prepend=np.inf).any(axis=1)
        whole = np.round(_TENTHS * polygon[moved]).astype(int)
        steps = " ".join(f"{x} {y}" for x, y in np.diff(whole, axis=0).tolist())
        closed = "z" if (polygon[0] == polygon[-1]).all() else ""
        if steps:
            words.append(f"M{whole[0, 0]} {whole[0, 1]}l{steps}{closed}")
    return "".join(words)


def _first(found: list[list[Points]]) -> int:
    """Return the first slice to show: that with the longest outline, the middle one of equals."""
    lengths = np.array([sum(np.linalg.norm(np.diff(p, axis=0), axis=1).sum() for p in each) for each in found])
    equal = np.flatnonzero(lengths >= _EQUAL * lengths.max())
    return int(equal[np.abs(equal - len(found) // 2).argmin()])


def _stack(scan: Scan, shown: Scan, axis: int, shades: Shades, mesh: tuple[Points, Cells] | None) -> dict[str, Any]:
    """Describe the slices across an axis of the world, from the upright part that is shown."""
    across = scan.world_axes.index(axis)
    right, down = (other for other in range(3) if other != axis)
    # in LPS, y points to the back, which is at the bottom of an axial slice
    downwards = 1 if axis == 2 and scan.anatomical else -1
    last = shown.values.shape[axis] - 1
    low, high = 0, last
    if mesh is not None:  # no slices far from the mesh
        ends = np.floor(mesh[0][:, axis].min()) - 1, np.ceil(mesh[0][:, axis].max()) + 1
        low, high = np.clip(ends, 0, last).astype(int).tolist()
    chosen = np.round(np.linspace(low, high, min(SLICES, high - low + 1))).astype(int)
    grid = np.array(shown.values.shape)[[right, down]]
    extent = grid * shown.spacing[[right, down]]
    width, height = size = np.maximum(np.round(PIXELS * extent / extent.max()), 1).astype(int).tolist()
    columns = min(len(chosen), _COLUMNS)
    sheet = Image.new("RGB", (columns * width, -(-len(chosen) // columns) * height))
    filtering = Image.Resampling.NEAREST if scan.labels else Image.Resampling.BILINEAR
    for n, k in enumerate(chosen):
        cut = np.take(shown.values, k, axis=axis)[:, ::downwards]
        sheet.paste(shades.image(cut).resize(size, filtering), (n % columns * width, n // columns * height))
    found: list[list[Points]] = [[] for _ in chosen]
    if mesh is not None:
        pixels = (mesh[0][:, [right, down]] + 0.5) / grid * size
        if downwards < 0:
            pixels[:, 1] = height - pixels[:, 1]
        surface = to_polydata(np.column_stack([pixels, mesh[0][:, axis]]), mesh[1])
        found = outlines(surface, chosen)
    positions = shown.origin + np.outer(chosen, shown.step[:, axis])
    return {
        "name": _PLANES[axis] if scan.anatomical else f"across {'xyz'[axis]}",
        "letters": [*shown.letters(right), *shown.letters(down)[::downwards]],  # left, right, top, bottom
        "size": size,
        "columns": columns,
        "sheet": sheet.size,
        "image": image_data(sheet, lossless=scan.labels),
        "slices": np.round(scan.to_index(positions)[:, across]).astype(int).tolist(),
        "paths": [path_of(polygons) for polygons in found],
        "towards": shown.letters(axis),
        "first": _first(found),
    }


def slices(scan: Scan, mesh: tuple[Points, Cells] | None, key: list[Entry]) -> str:
    """Return the HTML of three stacks of slices with the outline of the mesh.

    They are shown in radiological convention, or with z up if the world is not that of the body.

    Parameters
    ----------
    scan
        The volume.
    mesh
        Positions in the world, mm, and triangles; ``None`` if no surface was made.
    key
        Names and colours of the labels.
    """
    shades = shades_of(scan, key)
    planes = stacks(scan, shades, mesh)
    about = {
        "planes": [{name: plane[name] for name in ("size", "columns", "slices", "paths")} for plane in planes],
        "names": {",".join(map(str, entry.colour)): entry.name for entry in key if scan.labels},
    }
    text = json.dumps(about, separators=(",", ":"))
    data = base64.b64encode(zlib.compress(text.encode("utf-8"), 9)).decode("ascii")
    scale, outlined = f"{1 / _TENTHS:g}", mesh is not None
    return render("slices", scan=scan, shades=shades, planes=planes, key=key, outlined=outlined, scale=scale, data=data)


def stacks(scan: Scan, shades: Shades, mesh: tuple[Points, Cells] | None) -> list[dict[str, Any]]:
    """Describe the slices of the three planes: axial, coronal and sagittal.

    Parameters
    ----------
    scan
        The volume.
    shades
        Colours of its values.
    mesh
        Positions in the world, mm, and triangles.
    """
    shown = scan.upright()
    if mesh is not None:
        shown = shown.around(shown.to_index(mesh[0]), _MARGIN)
        mesh = shown.to_index(mesh[0]), mesh[1]
    return [_stack(scan, shown, axis, shades, mesh) for axis in (2, 1, 0)]


def facts(scan: Scan, name: str, key: list[Entry]) -> str:
    """Return the HTML of a table about the input.

    Parameters
    ----------
    scan
        The volume.
    name
        Name of its file.
    key
        Names and colours of the labels.
    """
    if not scan.labels:
        finite = scan.values[np.isfinite(scan.values)]
        middle = np.percentile(finite[:: max(1, finite.size // 1_000_000)], [5, 50, 95]).tolist()
        return render("facts", scan=scan, name=name, low=float(finite.min()), high=float(finite.max()), middle=middle)
    entries = {label: entry for entry in key for label in entry.labels}
    labels, counts = (part.tolist() for part in np.unique(scan.values, return_counts=True))
    listed = [(label, entries[label], count) for label, count in zip(labels, counts, strict=True) if label in entries]
    return render("facts", scan=scan, name=name, listed=listed, background=0 in labels)
