"""The meshes of the 3-D view as text: whole numbers, differences, deflate, base64."""

from __future__ import annotations

import base64
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from isoparticles import _native
from numpy.typing import NDArray

from tetmesh_check.quality import Cells, Points, Values
from tetmesh_check.report.page.scan import world_letters

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


def _planes(numbers: NDArray[Any]) -> bytes:
    """Return the first bytes of all numbers, then the second ones and so on."""
    return numbers.view(np.uint8).reshape(len(numbers), -1).T.tobytes()


def _differences(numbers: NDArray[Any]) -> bytes:
    """Return zigzag differences of whole numbers, as four planes of bytes."""
    steps = np.diff(numbers, prepend=0)
    return _planes(np.where(steps < 0, -2 * steps - 1, 2 * steps).astype("<u4"))


def _in_order_of_use(triangles: Cells) -> tuple[Cells, NDArray[np.int64]]:
    """Renumber vertices by first use; return new triangles and old numbers."""
    used, first, local = np.unique(triangles, return_index=True, return_inverse=True)
    order = np.argsort(first)
    return np.argsort(order)[local.reshape(-1, 3)], used[order]


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
    orders = [_native.morton_order(mesh.points[mesh.triangles].mean(axis=1)) for mesh in meshes]
    numbered = [_in_order_of_use(mesh.triangles[order]) for mesh, order in zip(meshes, orders, strict=True)]
    points = np.concatenate([mesh.points[used] for mesh, (_, used) in zip(meshes, numbered, strict=True)])
    low, high = points.min(axis=0), points.max(axis=0)
    centre, half = 0.5 * (low + high), 0.5 * float((high - low).max()) or 1.0
    data = bytearray()

    def add(part: bytes) -> int:
        data.extend(part)
        return len(data) - len(part)

    listed = []
    for mesh, order, (triangles, used) in zip(meshes, orders, numbered, strict=True):
        places = np.round(STEPS * (mesh.points[used] - centre) / half)
        listed.append(
            {
                "name": mesh.name,
                "within": mesh.within,
                "point_count": len(used),
                "triangle_count": len(triangles),
                "points": add(_differences(places.T.ravel())),
                "triangles": add(_differences(triangles.ravel())),
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
        "centre": centre.tolist(),
        "reach": (1.08 * _reach((points - centre) / half, yaw, pitch)).tolist(),
        "yaw": yaw,
        "pitch": pitch,
        "letters": world_letters(anatomical),
        "anatomical": anatomical,
    }
    return about, base64.b64encode(zlib.compress(data, 9)).decode("ascii")


def _colour(colour: Colour, values: Values, triangles: int, add: Callable[[bytes], int]) -> dict[str, Any]:
    """Describe a measure for the script, and add its values to the data."""
    least, largest = float(values.min()), float(values.max())
    steps = 65535 if triangles <= _WHOLE_VALUES else 255
    whole = np.round(steps * (values - least) / max(largest - least, 1e-300)).astype("<u2")
    low, high = (float(v) for v in np.percentile(values, _RANGE))
    worst = {"low": WORST, "high": 100.0 - WORST}.get(colour.worst)
    return {
        "name": colour.name,
        "unit": colour.unit,
        "on_triangles": colour.on_triangles,
        "start": add(_planes(whole * np.uint16(65535 // steps))),
        "least": least,
        "largest": largest,
        "low": low,
        "high": high if high > low else low + max(abs(low), 1.0) * 1e-6,
        "worst": colour.worst,
        "names": [name for name, _ in colour.names],
        "palette": [part for _, shade in colour.names for part in shade],
        "threshold": None if worst is None else float(np.percentile(values, worst)),
    }


def _reach(points: Points, yaw: float, pitch: float) -> Points:
    """Largest distances from the middle of the picture, sideways and upwards."""
    across = points @ [np.cos(yaw), np.sin(yaw), 0.0]
    upwards = points @ [-np.sin(pitch) * np.sin(yaw), np.sin(pitch) * np.cos(yaw), np.cos(pitch)]
    return np.array([np.abs(across).max(), np.abs(upwards).max()])
