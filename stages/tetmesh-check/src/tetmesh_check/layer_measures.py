"""Measures prism layers for the report, and checks them."""

from __future__ import annotations

from typing import Any

import numpy as np

from tetmesh_check.checks import Check, check
from tetmesh_check.export.mesh import MarkedMesh
from tetmesh_check.layers import MIN_SHARE, Layered
from tetmesh_check.numerals import plain
from tetmesh_check.parts.model import Wall
from tetmesh_check.prisms import FACES, jacobians, scaled_jacobian
from tetmesh_check.push import normals_of
from tetmesh_check.quality import OUTWARD_FACES, Cells, Labels, Values, summarize

TOLERANCE = 10.0
"""Maximum difference of a first height from the requested one, percent; a warning above it. At a
node with four or more normals, a vector can meet the heights only approximately. On the bent pipe
of ``test_layers.py`` with edges of 0.6, 1 and 1.2 mm, 98 % of the heights or more are within 1.5 %,
and all within 5.2 %."""
_OFF_PLANE = 1e-6
"""Maximum distance of a node from the plane of its cap, mm: far above rounding errors, and far
below any edge."""


def loose_faces(mesh: MarkedMesh) -> int:
    """Count the faces at prisms that belong neither to two elements nor to one and the boundary."""
    is_near = np.zeros(len(mesh.points), dtype=bool)
    is_near[mesh.prisms] = True
    tetrahedra = mesh.tetrahedra[is_near[mesh.tetrahedra].sum(axis=1) >= 3]
    outer = mesh.outermost
    groups = (
        [*(tetrahedra[:, face] for face in OUTWARD_FACES), *(mesh.prisms[:, side] for side in FACES[:2]),
         mesh.faces[outer[: len(mesh.faces)]]],
        [*(mesh.prisms[:, side] for side in FACES[2:]), mesh.quads[outer[len(mesh.faces) :]]],
    )  # fmt: skip
    loose = 0
    for group in groups:
        faces = np.concatenate(group)
        faces = np.sort(faces[is_near[faces].all(axis=1)], axis=1)
        loose += int((np.unique(faces, axis=0, return_counts=True)[1] != 2).sum())
    return loose


def _lowest(nodes: Labels, shares: Values, triangles: Cells) -> Labels:
    """Return the indices of local minima of the shares below 1, by share; of equals, the first."""
    edges = np.searchsorted(nodes, triangles[:, [0, 1, 1, 2, 2, 0]]).reshape(-1, 2)
    rank = np.empty(len(nodes), dtype=np.int64)
    rank[np.argsort(shares, kind="stable")] = np.arange(len(nodes))
    is_lowest = shares < 1.0
    for start, end in (edges.T, edges.T[::-1]):
        is_lowest[start[rank[start] > rank[end]]] = False
    found = np.flatnonzero(is_lowest)
    return found[np.argsort(rank[found])]


def describe_layers(found: Layered, before: MarkedMesh, wall: Wall) -> tuple[dict[str, Any], list[Check]]:
    """Return the measures of the layers of one wall for the report, and their checks."""
    mesh, layers, shares = found.mesh, wall.layers, found.shares
    prisms = mesh.prisms[len(before.prisms) :]
    at, smallest = mesh.points, jacobians(mesh.points, prisms)
    size = len(prisms) // layers.count
    inner, outer = at[prisms[:size, :3]], at[prisms[:size, 3:]]
    full = (shares[np.searchsorted(found.nodes, prisms[:size, 3:])] == 1.0).all(axis=1)
    normals = normals_of(at, prisms[:size, 3:])[0]
    heights = np.einsum("mj,mj->m", (outer - inner).mean(axis=1), normals)
    lows = _lowest(found.nodes, shares, prisms[:size, 3:])
    results = {
        "layers": layers.wall.text,
        "parts": [mesh.parts[mark] for mark in sorted(wall.members)],
        "heights_mm": np.diff(layers.depths, prepend=0.0).tolist(),
        "thickness_mm": float(layers.depths[-1]),
        "prisms": len(prisms),
        "first_height_mm": summarize(heights[full]) if full.any() else None,
        "first_height_where_thinner_mm": summarize(heights[~full]) if not full.all() else None,
        "jacobian_mm3": float(smallest.min()),
        "scaled_jacobian": summarize(scaled_jacobian(at, prisms)),
        "volume_mm3": float(smallest.sum()) / 18.0,
        "off_plane_mm": found.off_plane,
        "nodes": len(shares),
        "thinner_nodes": int((shares < 1.0).sum()),
        "minimum_share": float(shares.min()),
        "thinner": [
            {"place_mm": mesh.shown[node].tolist(), "share": float(share)}
            for node, share in zip(found.nodes[lows].tolist(), shares[lows].tolist(), strict=True)
        ],
    }
    low, high = (float(pick(heights[full], initial=layers.first)) for pick in (np.min, np.max))
    off = 100.0 * max(high / layers.first - 1.0, 1.0 - low / layers.first)
    checks = [
        check("prism_jacobian", int((smallest.min(axis=1) <= 0.0).sum()), total=len(prisms)),
        check("layer_caps", found.off_plane, _OFF_PLANE, told=f"{found.off_plane:.2g}"),
        check("layer_thickness", int((shares < MIN_SHARE).sum()), total=len(shares), least=100.0 * MIN_SHARE),
        check("first_height", off, TOLERANCE, told=f"{low:.4g} to {high:.4g}", off=plain(off)),
    ]
    return results, checks
