"""Quadratic tetrahedra whose surface nodes lie on F = 0.

The Rust code (``common/mesh/src/tetrahedra/quadratic.rs``) places the nodes, and bounds the
Jacobian of every element.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from isoparticles._native import GridField

from tetmesh_check.checks import Check, check
from tetmesh_check.export.mesh import MarkedMesh
from tetmesh_check.quality import Values, summarize


class Quadratic(NamedTuple):
    """A quadratic mesh, and measures of its nodes."""

    mesh: MarkedMesh
    jacobian: Values
    """Minimum Bezier coefficient of each element's Jacobian over that of the straight tetrahedron,
    shape ``(m,)``; 1 for a straight element."""
    results: dict[str, Any]
    """Results for the report."""
    checks: list[Check]
    """Verdicts on the elements and nodes."""


def make_quadratic(mesh: MarkedMesh, field: GridField) -> Quadratic:
    """Add mid-edge nodes: on F = 0 on the surface, at midpoints elsewhere.

    Parameters
    ----------
    mesh
        Linear tetrahedra of one object.
    field
        F.
    """
    found = field.quadratic(mesh.points, mesh.tetrahedra, mesh.boundary, (~mesh.is_cap).astype(np.uint8))
    count = len(mesh.points)
    results: dict[str, Any] = {
        "nodes": count + len(found["nodes"]),
        "surface_nodes": found["surface_nodes"],
        "not_on_surface": found["drawn_back"] + found["too_far"],
        "drawn_back": found["drawn_back"],
        "too_far": found["too_far"],
        "distance_mm": {
            "vertices": summarize(found["vertex_distances"]),
            "middles_of_edges": summarize(found["midpoint_distances"]),
            "mid_edge_nodes": summarize(found["node_distances"]),
        },
        "volume_mm3": found["volume"],
        "volume_change_percent": 100.0 * (found["volume"] / found["straight_volume"] - 1.0),
        "jacobian": summarize(found["jacobian"], np.linspace(0.0, 1.0, 51)),
        "folded": found["folded"],
    }
    curved = replace(
        mesh,
        points=np.concatenate([mesh.points, found["nodes"]]),
        elements=np.column_stack([mesh.tetrahedra, found["of_cells"] + count]),
        faces=np.column_stack([mesh.boundary, found["of_triangles"] + count]),
    )
    folded = check("quadratic_jacobian", results["folded"])
    nodes = check("nodes_on_surface", results["not_on_surface"], **results)
    return Quadratic(curved, found["jacobian"], results, [folded, nodes])
