"""Quadratic tetrahedra whose surface nodes lie on F = 0, or on the interfaces of many materials.

The Rust code (``common/mesh/src/tetrahedra/quadratic.rs``) places the nodes, and bounds the
Jacobian of every element.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from isoparticles._native import DistanceField, jacobian_coefficients

from tetmesh_check.checks import Check, check
from tetmesh_check.export.mesh import MarkedMesh
from tetmesh_check.gap import open_curved_gaps
from tetmesh_check.materials import Planes, Sides, materials_in_front
from tetmesh_check.parts.model import Parts
from tetmesh_check.quality import Values, signed_tetrahedron_volumes, summarize
from tetmesh_check.split import split


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


def make_quadratic(
    mesh: MarkedMesh, field: DistanceField, sides: Sides | None = None, planes: Planes | None = None
) -> Quadratic:
    """Add mid-edge nodes: where materials meet on their interfaces, at midpoints elsewhere.

    Parameters
    ----------
    mesh
        Linear tetrahedra.
    field
        F, or the indicators of many materials.
    sides
        The materials on both sides of the triangles of ``mesh``; ``None`` for one object, whose
        surface lies between 1 and 0 and whose caps stay flat.
    planes
        The planes at which the materials end.
    """
    curved = (~mesh.is_cap).astype(np.int64)
    between = (curved, np.zeros_like(curved)) if sides is None else (sides.inside, materials_in_front(sides, planes))
    found = field.quadratic(mesh.points, mesh.tetrahedra, mesh.boundary, *between)
    count = len(mesh.points)
    volumes, straight = found["volumes"], found["straight_volumes"]
    results: dict[str, Any] = {
        "nodes": count + len(found["nodes"]),
        "surface_nodes": found["surface_nodes"],
        "curve_nodes": found["curve_nodes"],
        "not_on_surface": found["drawn_back"] + found["not_reached"],
        "drawn_back": found["drawn_back"],
        "not_reached": found["not_reached"],
        "distance_mm": {
            "vertices": summarize(found["vertex_distances"]),
            "middles_of_edges": summarize(found["midpoint_distances"]),
            "mid_edge_nodes": summarize(found["node_distances"]),
        },
        "volume_mm3": float(volumes.sum()),
        "volume_change_percent": 100.0 * float(volumes.sum() / straight.sum() - 1.0),
        "regions": [
            {
                "name": own.name,
                "volume_mm3": float(volumes[own.members].sum()),
                "straight_volume_mm3": float(straight[own.members].sum()),
            }
            for own in mesh.region_sets
        ],
        "jacobian": summarize(found["jacobian"], np.linspace(0.0, 1.0, 51)),
        "folded": found["folded"],
    }
    curved_mesh = replace(
        mesh,
        points=np.concatenate([mesh.points, found["nodes"]]),
        elements=np.column_stack([mesh.tetrahedra, found["of_cells"] + count]),
        faces=np.column_stack([mesh.boundary, found["of_triangles"] + count]),
        point_fields={},
    )
    zero = "F = 0" if sides is None else "their interface"
    checks = [
        check("quadratic_jacobian", results["folded"]),
        check("nodes_on_surface", results["not_on_surface"], zero=zero, **results),
    ]
    return Quadratic(curved_mesh, found["jacobian"], results, checks)


def separate_curved(curved: Quadratic, parts: Parts) -> Quadratic:
    """Split the interfaces of a quadratic mesh and open their gaps.

    Distances of nodes and volumes in the results remain those of the joined mesh.

    Parameters
    ----------
    curved
        The joined mesh.
    parts
        The parts, with both sides of the split interfaces.
    """
    mesh = split(curved.mesh, parts)
    if not mesh.contacts or not any(interface.split.width for interface in parts.splits):
        return curved._replace(mesh=mesh)
    points, rows, checks = open_curved_gaps(mesh, parts)
    moved = np.flatnonzero((points != mesh.points).any(axis=1)[mesh.elements].any(axis=1))
    elements, jacobian = mesh.elements[moved], curved.jacobian.copy()
    straight = 6.0 * np.abs(signed_tetrahedron_volumes(points, elements[:, :4]))
    jacobian[moved] = jacobian_coefficients(points[elements].reshape(-1, 3)).min(axis=1) / np.maximum(straight, 1e-300)
    folded = curved.results["folded"] + int(((jacobian <= 0.0) & (curved.jacobian > 0.0)).sum())
    results = curved.results | {
        "jacobian": summarize(jacobian, np.linspace(0.0, 1.0, 51)), "folded": folded, "split": rows
    }  # fmt: skip
    checks = [check("quadratic_jacobian", folded), *curved.checks[1:], *checks]
    return Quadratic(replace(mesh, points=points), jacobian, results, checks)
