"""The meshes of the 3-D view as text: whole numbers, differences, deflate, base64."""

from __future__ import annotations

import base64
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from isoparticles import _native

from tetmesh_check.quality import Cells, Points, Values

STEPS = 8191
"""Steps over half of the longest side of the object: a ten-thousandth of it is well below a
pixel."""
MAX_TRIANGLES = 1_000_000
"""Larger meshes are left out of the view: a page of ribs with 579,140 triangles and 287,010 on the
cut holds 5.5 MB of them."""


_WHOLE_VALUES = 300_000
"""Values of larger meshes are kept to 8 bits of their range instead of 16, which deflate to half as
much."""
_RANGE = (1.0, 99.0)
"""Percentiles at the ends of the colour bar: the few best and worst do not decide what all others
look like."""
WORST = 1.0
"""Percent of the triangles that 'worst' shows."""


@dataclass(frozen=True)
class Colour:
    """A measure that a mesh can be coloured by."""

    name: str
    """As the page calls it."""
    unit: str
    """Empty, or with a space before it, as in ``" mm"``."""
    values: Values
    """One a triangle, shape ``(m,)``, or one a vertex, shape ``(n,)``."""
    on_triangles: bool
    worst: str = ""
    """``low`` or ``high``: which end is bad; empty where none is."""
    names: tuple[tuple[str, tuple[int, int, int]], ...] = ()
    """For values that are whole numbers from 0: the name and the colour of each."""


@dataclass(frozen=True)
class ViewMesh:
    """One of the meshes to look at."""

    name: str
    """Name on the page."""
    points: Points
    """Positions, mm, shape ``(n, 3)``."""
    triangles: Cells
    """Vertex indices, shape ``(m, 3)``."""
    colours: list[Colour]
    """Colours to choose from. The first states which end is bad if the chosen one does not."""
    within: bool = False
    """Whether it lies inside the object, and is shown within a ghost of the first mesh."""


def _bytes_of_differences(values: Any) -> bytes:
    """Zigzag differences of whole numbers, as four planes of bytes."""
    differences = np.diff(values.astype(np.int64), prepend=0)
    zigzag = np.where(differences < 0, -2 * differences - 1, 2 * differences).astype("<u4")
    return bytes(zigzag.view(np.uint8).reshape(-1, 4).T.tobytes())


def _in_order_of_use(triangles: Cells) -> tuple[Cells, Any]:
    """Renumber vertices by first use; return new triangles and old numbers."""
    used, first, local = np.unique(triangles, return_index=True, return_inverse=True)
    order = np.argsort(first, kind="stable")
    rank = np.empty(len(used), dtype=np.int64)
    rank[order] = np.arange(len(used))
    return rank[local.reshape(-1, 3)], used[order]


def world_letters(anatomical: bool) -> list[list[str]]:
    """Name the directions of the axes of the world, the positive one first.

    Parameters
    ----------
    anatomical
        Whether the world is that of the body (LPS).
    """
    return [["L", "R"], ["P", "A"], ["S", "I"]] if anatomical else [[f"+{a}", f"\u2212{a}"] for a in "xyz"]


def pack(meshes: list[ViewMesh], yaw: float, pitch: float, anatomical: bool = True) -> tuple[dict[str, Any], str]:
    """Pack meshes for the page.

    Parameters
    ----------
    meshes
        The meshes; the first is shown first.
    yaw, pitch
        Initial direction of view, radians.
    anatomical
        Whether the world is that of the body (LPS).

    Returns
    -------
    tuple
        Description of the data for the script, and the data.
    """
    low = np.min([mesh.points[np.unique(mesh.triangles)].min(axis=0) for mesh in meshes], axis=0)
    high = np.max([mesh.points[np.unique(mesh.triangles)].max(axis=0) for mesh in meshes], axis=0)
    centre, half = 0.5 * (low + high), 0.5 * float((high - low).max()) or 1.0
    parts: list[bytes] = []
    listed = []

    def add(part: bytes) -> int:
        start = sum(map(len, parts))
        parts.append(part)
        return start

    reach = np.zeros(2)
    for mesh in meshes:
        order = _native.morton_order(mesh.points[mesh.triangles].mean(axis=1))
        triangles, used = _in_order_of_use(mesh.triangles[order])
        centred = (mesh.points[used] - centre) / half
        reach = np.maximum(reach, _reach(centred, yaw, pitch))
        listed.append(
            {
                "name": mesh.name,
                "within": mesh.within,
                "point_count": len(used),
                "triangle_count": len(triangles),
                "points": add(_bytes_of_differences(np.round(STEPS * centred).astype(np.int64).T.ravel())),
                "triangles": add(_bytes_of_differences(triangles.ravel())),
                "colours": [
                    _colour(colour, colour.values[order if colour.on_triangles else used], len(triangles), add)
                    for colour in mesh.colours
                ],
            }
        )
    about = {
        "meshes": listed,
        "step": 1.0 / STEPS,
        "half": half,
        "centre": [float(v) for v in centre],
        "reach": [float(v) for v in 1.08 * reach],
        "yaw": yaw,
        "pitch": pitch,
        "letters": world_letters(anatomical),
        "anatomical": anatomical,
    }
    return about, base64.b64encode(zlib.compress(b"".join(parts), 9)).decode("ascii")


def _colour(colour: Colour, values: Values, triangles: int, add: Callable[[bytes], int]) -> dict[str, Any]:
    """Describe a measure for the script, and add its values to the data."""
    least, largest = float(values.min()), float(values.max())
    share = (values - least) / max(largest - least, 1e-300)
    steps = 65535 if triangles <= _WHOLE_VALUES else 255
    whole = np.round(steps * share).astype("<u2") * np.uint16(65535 // steps)
    low, high = (float(v) for v in np.percentile(values, _RANGE))
    worst = {"low": WORST, "high": 100.0 - WORST}.get(colour.worst)
    return {
        "name": colour.name,
        "unit": colour.unit,
        "on_triangles": colour.on_triangles,
        "start": add(whole.view(np.uint8).reshape(-1, 2).T.tobytes()),
        "least": least,
        "largest": largest,
        "low": low,
        "high": high if high > low else low + max(abs(low), 1.0) * 1e-6,
        "worst": colour.worst,
        "names": [name for name, _ in colour.names],
        "palette": [part for _, shade in colour.names for part in shade],
        "threshold": None if worst is None else float(np.percentile(values, worst)),
    }


def _reach(points: Points, yaw: float, pitch: float) -> Any:
    """Largest distances from the middle of the picture, sideways and upwards."""
    across = points @ [np.cos(yaw), np.sin(yaw), 0.0]
    upwards = points @ [-np.sin(pitch) * np.sin(yaw), np.sin(pitch) * np.cos(yaw), np.cos(pitch)]
    return np.array([np.abs(across).max(), np.abs(upwards).max()])
