"""The Rust code replaces poor tetrahedra locally. Surface and materials do not change."""

from __future__ import annotations

from isoparticles import _native

from tetmesh_check.checks import Limits
from tetmesh_check.conform import Conformity
from tetmesh_check.materials import Sides
from tetmesh_check.quality import Cells, Points
from tetmesh_check.tets.worker import Raw


def mend(
    points: Points, tetrahedra: Cells, triangles: Cells, sides: Sides, limits: Limits
) -> tuple[Raw, Conformity] | None:
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
    tuple or None
        The new mesh, and how it fits the interfaces. Its summary has, under ``mended``, the goal,
        the tetrahedra below it before and after, and the changes. ``None`` if nothing changes: if
        no tetrahedron is poor, if more than 1 % are, if the mesh does not fit the interfaces, or if
        no tetrahedron gets better.
    """
    interfaces = triangles, sides.inside, sides.outside
    found = _native.mend(points, tetrahedra, interfaces, limits.min_dihedral, limits.min_scaled_jacobian)
    if found is None:
        return None
    mended = {
        "goal_degrees": found["goal_degrees"],
        "below_before": found["below"][0],
        "below_after": found["below"][1],
        "moves": found["moves"],
        "tetrahedra_replaced": found["changed_tetrahedra"][0],
        "tetrahedra_put": found["changed_tetrahedra"][1],
        "vertices_put": found["changed_vertices"][1],
        "vertices_taken": found["changed_vertices"][0],
    }
    return Raw(found["points"], found["tetrahedra"], {"mended": mended}), Conformity(**found["fit"])
