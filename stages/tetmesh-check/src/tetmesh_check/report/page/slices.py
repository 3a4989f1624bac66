"""Slices of the input volume with the outline of the mesh."""

from __future__ import annotations

import base64
import json
import zlib
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from tetmesh_check.quality import Cells, Points
from tetmesh_check.report.page.images import image_data
from tetmesh_check.report.page.key import Colour, Entry
from tetmesh_check.report.page.scan import Scan
from tetmesh_check.report.page.templates import render

SLICES = 40
"""Largest number of slices a plane."""
PIXELS = 288
"""Longest side of a slice in the page: three planes of 40 slices of a CT then take about 1.5 MB."""
_MARGIN = 0.25
"""Margin of the volume around the mesh, relative to its longest side."""
_PERCENTILES = (0.5, 99.5)
"""Percentiles of the values shown as black and white, so that few voxels do not set the range."""
_NEAR = 0.35
"""Points of an outline nearer to each other than this are thinned out, pixels."""
_TENTHS = 10
"""Outlines are kept to a tenth of a pixel."""
_BACKGROUND = (0, 0, 0)


@dataclass(frozen=True)
class Plane:
    """A stack of slices across a grid axis, as the reader looks at it."""

    axis: int
    """Across which the slices lie."""
    right: int
    """Grid axis that runs along the picture's width."""
    down: int
    """Grid axis that runs along its height."""
    flip_right: bool
    """Whether the width runs against that axis."""
    flip_down: bool


def planes_of(scan: Scan) -> list[Plane]:
    """Lay out the three planes in radiological convention, or with z up.

    Parameters
    ----------
    scan
        The volume.
    """
    world = scan.world_axes
    grid_of = {axis: world.index(axis) for axis in range(3)}
    planes = []
    for across, right, up in ((2, 0, 1), (1, 0, 2), (0, 1, 2)):
        axis, along, upward = grid_of[across], grid_of[right], grid_of[up]
        # in LPS y grows towards the back, which is down
        grows_down = scan.anatomical and up == 1
        positive_down = scan.step[up, upward] > 0
        planes.append(
            Plane(axis, along, upward, bool(scan.step[right, along] < 0), bool(positive_down != grows_down)),
        )
    return planes


def outline(points: Points, triangles: Cells, axis: int, at: float) -> list[Points]:
    """Cut a surface by a plane: closed polygons (open ones where the surface is).

    Each crossed edge has one point, computed once, so that neighbours share it to the last bit. A
    vertex on the plane counts as above it.

    Parameters
    ----------
    points
        Positions in the grid's frame, shape ``(n, 3)``.
    triangles
        Vertex indices, shape ``(m, 3)``.
    axis, at
        The plane: where this coordinate has this value.
    """
    above = points[:, axis] >= at
    sides = above[triangles]
    mixed = sides.any(axis=1) & ~sides.all(axis=1)
    if not mixed.any():
        return []
    cut, sides = triangles[mixed], sides[mixed]
    # the corner that is alone on its side, and the two edges from it
    lonely = np.where(sides.sum(axis=1) == 1, sides.argmax(axis=1), (~sides).argmax(axis=1))
    rows = np.arange(len(cut))
    apex = cut[rows, lonely]
    others = np.stack([cut[rows, (lonely + 1) % 3], cut[rows, (lonely + 2) % 3]], axis=1)
    ends = np.sort(np.stack([np.repeat(apex, 2), others.ravel()], axis=1), axis=1)
    edges, number = np.unique(ends, axis=0, return_inverse=True)
    low, high = points[edges[:, 0]], points[edges[:, 1]]
    share = (at - low[:, axis]) / (high[:, axis] - low[:, axis])
    places = low + share[:, None] * (high - low)
    return [places[chain] for chain in _chains(number.reshape(-1, 2), len(edges))]


def _chains(pairs: NDArray[np.int64], count: int) -> list[list[int]]:
    """Join pairs of numbers end to end."""
    neighbours: list[list[int]] = [[] for _ in range(count)]
    for a, b in pairs.tolist():
        neighbours[a].append(b)
        neighbours[b].append(a)
    chains = []
    # open ends first, so that a chain is walked from one end to the other
    for start in sorted(range(count), key=lambda k: len(neighbours[k]) != 1):
        while neighbours[start]:
            chain = [start]
            while neighbours[chain[-1]]:
                here = chain[-1]
                there = neighbours[here].pop()
                neighbours[there].remove(here)
                chain.append(there)
            chains.append(chain)
    return chains


def path_of(chains: list[Points]) -> str:
    """Write polygons as an SVG path in tenths of pixels.

    Parameters
    ----------
    chains
        Positions in pixels, each of shape ``(k, 2)``.
    """
    words = []
    for chain in chains:
        kept = [chain[0]]
        for point in chain[1:]:
            if np.abs(point - kept[-1]).max() >= _NEAR:
                kept.append(point)
        closed = len(chain) > 2 and bool((chain[0] == chain[-1]).all())
        whole = np.round(_TENTHS * np.array(kept)).astype(int)
        steps = np.diff(whole, axis=0)
        words.append(
            f"M{whole[0][0]} {whole[0][1]}l" + " ".join(f"{x} {y}" for x, y in steps.tolist()) + ("z" if closed else "")
        )
    return "".join(word for word in words if not word.endswith(("l", "lz")))


@dataclass(frozen=True)
class Window:
    """Conversion of values to shades: by their range for a scan, by colours for labels."""

    low: float
    high: float
    colours: dict[int, Colour]
    """Colours of the labels; empty for a scan."""

    def image(self, values: NDArray[Any]) -> Image.Image:
        """Turn a slice into a picture, one pixel a voxel; the first axis runs to the right.

        Parameters
        ----------
        values
            Shape ``(nx, ny)``.
        """
        if self.colours:
            keys = np.array(sorted(self.colours))
            shades = np.array([self.colours[key] for key in keys.tolist()], dtype=np.uint8)
            return Image.fromarray(shades[np.searchsorted(keys, values).clip(0, len(keys) - 1)].transpose(1, 0, 2))
        share = (np.nan_to_num(values.astype(np.float64), nan=self.low) - self.low) / max(self.high - self.low, 1e-300)
        return Image.fromarray(np.round(255 * share.clip(0, 1)).astype(np.uint8).T)


def window_of(scan: Scan, key: list[Entry]) -> Window:
    """Choose shades or colours for a volume.

    Parameters
    ----------
    scan
        The volume.
    key
        Names and colours of its labels.
    """
    if scan.labels:
        return Window(0.0, 0.0, {0: _BACKGROUND} | {label: entry.colour for entry in key for label in entry.labels})
    stride = max(1, round((scan.values.size / 4e6) ** (1 / 3)))
    sample = scan.values[::stride, ::stride, ::stride]
    low, high = np.percentile(sample[np.isfinite(sample)], _PERCENTILES)
    if low == high:
        low, high = float(sample.min()), float(sample.max())
    return Window(float(low), float(high), {})


def _shown(scan: Scan, index: Points | None) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """First and last voxel along each axis that the page shows."""
    last = np.array(scan.values.shape) - 1
    if index is None:
        return np.zeros(3, dtype=np.int64), last
    low, high = index.min(axis=0), index.max(axis=0)
    margin = _MARGIN * float(((high - low) * scan.spacing).max()) / scan.spacing
    first = np.clip(np.floor(low - margin), 0, last).astype(np.int64)
    return first, np.clip(np.ceil(high + margin), first, last).astype(np.int64)


def _first(paths: list[str]) -> int:
    """Choose the first slice to show: the longest outline in the middle half of a stack."""
    middle = range(len(paths) // 4, len(paths) - len(paths) // 4)
    longest = max(middle, key=lambda n: len(paths[n]))
    return longest if paths[longest] else len(paths) // 2


def _stack(scan: Scan, plane: Plane, window: Window, mesh: tuple[Points, Cells] | None) -> dict[str, Any]:
    """One plane: a sheet with its slices, and their outlines."""
    first, last = _shown(scan, None if mesh is None else mesh[0])
    axis, right, down = plane.axis, plane.right, plane.down
    low, high = int(first[axis]), int(last[axis])
    if mesh is not None:  # no slices far before and behind the mesh
        low = max(low, int(np.floor(mesh[0][:, axis].min())) - 1)
        high = min(high, int(np.ceil(mesh[0][:, axis].max())) + 1)
    low, high = min(low, high), max(low, high)
    chosen = np.unique(np.round(np.linspace(low, high, min(SLICES, high - low + 1))).astype(int)).tolist()
    extent = [float((last[k] - first[k] + 1) * scan.spacing[k]) for k in (right, down)]
    pixel = max(extent) / PIXELS
    size = tuple(max(1, round(length / pixel)) for length in extent)
    scale = [size[0] / extent[0], size[1] / extent[1]]
    columns = max(1, min(len(chosen), 8))
    sheet = Image.new("RGB" if window.colours else "L", (columns * size[0], -(-len(chosen) // columns) * size[1]))
    paths = []
    order = (right, down)
    for n, k in enumerate(chosen):
        cut = np.take(scan.values, k, axis=axis)  # the two other axes in their order
        if right > down:
            cut = cut.T
        cut = cut[first[right] : last[right] + 1, first[down] : last[down] + 1]
        cut = cut[:: -1 if plane.flip_right else 1, :: -1 if plane.flip_down else 1]
        filtering = Image.Resampling.NEAREST if window.colours else Image.Resampling.BOX
        if not window.colours and max(size) > max(cut.shape):
            filtering = Image.Resampling.BILINEAR
        picture = window.image(cut).resize((size[0], size[1]), filtering)
        sheet.paste(picture, ((n % columns) * size[0], (n // columns) * size[1]))
        chains = []
        for chain in outline(*mesh, axis, float(k)) if mesh is not None else []:
            flat = np.empty((len(chain), 2))
            for side, grid in enumerate(order):
                place = (chain[:, grid] - first[grid] + 0.5) * scan.spacing[grid] * scale[side]
                flat[:, side] = size[side] - place if (plane.flip_right, plane.flip_down)[side] else place
            chains.append(flat)
        paths.append(path_of(chains))
    ends = [scan.letters(right)[:: -1 if plane.flip_right else 1], scan.letters(down)[:: -1 if plane.flip_down else 1]]
    return {
        "name": scan.plane(axis),
        "letters": [ends[0][0], ends[0][1], ends[1][0], ends[1][1]],  # left, right, top, bottom
        "size": list(size),
        "columns": columns,
        "sheet": [sheet.width, sheet.height],
        "image": image_data(sheet, lossless=bool(window.colours)),
        "slices": chosen,
        "paths": paths,
        "towards": list(scan.letters(axis)),
        "spacing": float(scan.spacing[axis]),
        "first": _first(paths),
        "millimetres": pixel,
    }


def slices(scan: Scan, mesh: tuple[Points, Cells] | None, key: list[Entry]) -> str:
    """Write three stacks of slices with the outline of the mesh.

    Parameters
    ----------
    scan
        The volume.
    mesh
        Positions in the world, mm, and triangles; ``None`` if no surface was made.
    key
        Names and colours of the labels.
    """
    window = window_of(scan, key)
    placed = None if mesh is None else (scan.to_index(mesh[0]), mesh[1])
    planes = [_stack(scan, plane, window, placed) for plane in planes_of(scan)]
    kept = ("size", "columns", "slices", "paths", "spacing")
    about = {
        "planes": [{name: plane[name] for name in kept} for plane in planes],
        "names": {",".join(map(str, entry.colour)): entry.name for entry in key if window.colours},
    }
    text = json.dumps(about, separators=(",", ":"))
    data = base64.b64encode(zlib.compress(text.encode("utf-8"), 9)).decode("ascii")
    shown = {"scan": scan, "window": window, "planes": planes, "key": key, "outlined": mesh is not None}
    return render("slices", data=data, scale=f"{1 / _TENTHS:g}", **shown)


def facts(scan: Scan, name: str, key: list[Entry]) -> str:
    """Write what the input is.

    Parameters
    ----------
    scan
        The volume.
    name
        Name of its file.
    key
        Names and colours of the labels.
    """
    about: dict[str, Any] = {
        "spacing": scan.spacing.tolist(),
        "extent": [float(n * h) for n, h in zip(scan.values.shape, scan.spacing, strict=True)],
        "directions": [scan.letters(axis)[1] for axis in range(3)],
    }
    if scan.labels:
        found, counts = (part.tolist() for part in np.unique(scan.values, return_counts=True))
        entries = {label: entry for entry in key for label in entry.labels}
        pairs = zip(found, counts, strict=True)
        about["listed"] = [(label, entries[label], count) for label, count in pairs if label in entries]
        about |= {"background": 0 in found, "voxel": float(abs(np.linalg.det(scan.step)))}
    else:
        finite = scan.values[np.isfinite(scan.values)]
        middle = np.percentile(finite[:: max(1, finite.size // 1_000_000)], [5, 50, 95]).tolist()
        about |= {"low": float(finite.min()), "high": float(finite.max()), "middle": middle}
    return render("facts", scan=scan, name=name, **about)
