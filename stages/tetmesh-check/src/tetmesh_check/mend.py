"""The Rust code replaces poor tetrahedra locally. Surface and materials do not change."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from isoparticles import _native

from tetmesh_check.checks import Limits
from tetmesh_check.conform import Conformity
from tetmesh_check.materials import Sides
from tetmesh_check.quality import Cells, Points


@dataclass(frozen=True)
class Mended:
    """A mended mesh."""

    points: Points
    """Positions, mm, shape ``(n, 3)``; the vertices of the surface come first, in their order."""
    tetrahedra: Cells
    """Vertex indices in VTK order, shape ``(m, 4)``."""
    conformity: Conformity
    results: dict[str, Any]
    """For the report: the goal, the tetrahedra below it before and after, and the changes."""


def mend(points: Points, tetrahedra: Cells, triangles: Cells, sides: Sides, limits: Limits) -> Mended | None:
    """Mend the tetrahedra below a limit of shape or 12 degrees.

    Parameters
    ----------
    points
        Positions, mm, shape ``(n, 3)``; the vertices of the surface come first.
    tetrahedra
        Vertex indices in VTK order, positive, shape ``(m, 4)``.
    triangles
        Triangles of the interfaces, shape ``(k, 3)``.
    sides
        Their materials.
    limits
        The limits of the checks.

    Returns
    -------
    Mended or None
        ``None`` if nothing changes: if no tetrahedron is poor, if more than 1 % are, if the mesh
        does not fit the interfaces, or if no tetrahedron gets better.
    """
    interfaces = triangles, sides.inside, sides.outside
    found = _native.mend(points, tetrahedra, interfaces, limits.min_dihedral, limits.min_scaled_jacobian)
    if found is None:
        return None
    results = {
        "goal_degrees": found["goal_degrees"],
        "below_before": found["below"][0],
        "below_after": found["below"][1],
        "moves": found["moves"],
        "tetrahedra_replaced": found["changed_tetrahedra"][0],
        "tetrahedra_put": found["changed_tetrahedra"][1],
        "vertices_put": found["changed_vertices"][1],
        "vertices_taken": found["changed_vertices"][0],
    }
    return Mended(found["points"], found["tetrahedra"], Conformity(**found["fit"]), results)
