"""The meshes of the 3-D view as text: whole numbers, differences, deflate, base64."""

from __future__ import annotations

import base64
import zlib
from dataclasses import dataclass
from typing import Any

import numpy as np

from tetmesh_check.cut import Cut
from tetmesh_check.intersections import morton_order
from tetmesh_check.quality import Cells, Points, Values

STEPS = 8191
"""Steps over half of the longest side of the object: a ten-thousandth of it is well below a pixel."""
MAX_TRIANGLES = 1_000_000
"""Larger meshes are left out of the view: a page of ribs with 579,140 triangles and 287,010 on the cut holds 5.5 MB of them."""


@dataclass(frozen=True)
class ViewMesh:
    """One of the meshes to look at."""

    name: str
    """What the page calls it."""
    points: Points
    """Positions, mm, shape ``(n, 3)``."""
    triangles: Cells
    """Vertex indices, shape ``(m, 3)``."""
    quality: Values
    """Radius ratio, 0 to 1, shape ``(m,)``."""
    size: Values
    """Edge length, mm, shape ``(n,)``."""


def _bytes_of_differences(values: Any) -> bytes:
    """Zigzag differences of whole numbers, as four planes of bytes: mostly zeros, which deflate well."""
    differences = np.diff(values.astype(np.int64), prepend=0)
    zigzag = np.where(differences < 0, -2 * differences - 1, 2 * differences).astype("<u4")
    return bytes(zigzag.view(np.uint8).reshape(-1, 4).T.tobytes())


def _in_order_of_use(triangles: Cells) -> tuple[Cells, Any]:
    """Renumber vertices by first use, so that neighbours have near numbers; new triangles, old numbers."""
    used, first, local = np.unique(triangles, return_index=True, return_inverse=True)
    order = np.argsort(first, kind="stable")
    rank = np.empty(len(used), dtype=np.int64)
    rank[order] = np.arange(len(used))
    return rank[local.reshape(-1, 3)], used[order]


def pack(meshes: list[ViewMesh], yaw: float, pitch: float) -> tuple[dict[str, Any], str]:
    """Pack meshes for the page.

    Parameters
    ----------
    meshes
        Those to look at; the first one is shown first.
    yaw, pitch
        Where the eye is at first, radians.

    Returns
    -------
    tuple
        What the script must know about the data, and the data.
    """
    low = np.min([mesh.points[np.unique(mesh.triangles)].min(axis=0) for mesh in meshes], axis=0)
    high = np.max([mesh.points[np.unique(mesh.triangles)].max(axis=0) for mesh in meshes], axis=0)
    centre, half = 0.5 * (low + high), 0.5 * float((high - low).max()) or 1.0
    sizes = np.concatenate([mesh.size[np.unique(mesh.triangles)] for mesh in meshes])  # other points have none
    size_low, size_high = (float(v) for v in np.percentile(sizes, [1, 99]))
    parts: list[bytes] = []
    listed = []

    def add(part: bytes) -> int:
        start = sum(map(len, parts))
        parts.append(part)
        return start

    reach = np.zeros(2)
    for mesh in meshes:
        order = morton_order(mesh.points[mesh.triangles].mean(axis=1))
        triangles, used = _in_order_of_use(mesh.triangles[order])
        centred = (mesh.points[used] - centre) / half
        reach = np.maximum(reach, _reach(centred, yaw, pitch))
        share = (mesh.size[used] - size_low) / max(size_high - size_low, 1e-12)
        listed.append(
            {
                "name": mesh.name,
                "point_count": len(used),
                "triangle_count": len(triangles),
                "points": add(_bytes_of_differences(np.round(STEPS * centred).astype(np.int64).T.ravel())),
                "triangles": add(_bytes_of_differences(triangles.ravel())),
                "quality": add(np.round(255 * np.clip(mesh.quality[order], 0, 1)).astype(np.uint8).tobytes()),
                "size": add(np.round(255 * np.clip(share, 0, 1)).astype(np.uint8).tobytes()),
            }
        )
    about = {
        "meshes": listed,
        "step": 1.0 / STEPS,
        "reach": [float(v) for v in 1.08 * reach],
        "yaw": yaw,
        "pitch": pitch,
        "scales": ["", "radius ratio, 0 to 1 (best)", f"edge length, {size_low:.3g} to {size_high:.3g} mm"],
    }
    return about, base64.b64encode(zlib.compress(b"".join(parts), 9)).decode("ascii")


def _reach(points: Points, yaw: float, pitch: float) -> Any:
    """How far points reach from the middle of the picture, to the side and upwards; shape ``(2,)``."""
    across = points @ [np.cos(yaw), np.sin(yaw), 0.0]
    upwards = points @ [-np.sin(pitch) * np.sin(yaw), np.sin(pitch) * np.cos(yaw), np.cos(pitch)]
    return np.array([np.abs(across).max(), np.abs(upwards).max()])


def view_of_cut(points: Points, radius_ratio: Values, cut: Cut, size: Values) -> ViewMesh:
    """The half behind the cut, coloured by the quality of its tetrahedra.

    Parameters
    ----------
    points
        Positions, mm, shape ``(n, 3)``.
    radius_ratio
        Of every tetrahedron, shape ``(m,)``.
    cut
        The cut.
    size
        Edge length at every point, mm, shape ``(n,)``.
    """
    return ViewMesh("cut", points, cut.triangles, radius_ratio[cut.owners], size)
