"""Measures of prisms (wedges, pentahedra).

The nodes of a prism are two triangles, and the normal of the first one points to the second. VTK,
Gmsh, Abaqus, FEBio and Nastran have the same order. With corners a0 .. a2 and b0 .. b2, the
position is (1 - t) a(r, s) + t b(r, s). The Jacobian at (r, s) is a weighted mean of three
quadratic polynomials in t, one for each edge from a_i to b_i. If all their Bernstein coefficients
are positive, the Jacobian is positive everywhere.
"""

from __future__ import annotations

import numpy as np

from tetmesh_check.quality import Cells, Points, Values

FACES = ((0, 2, 1), (3, 4, 5), (0, 1, 4, 3), (1, 2, 5, 4), (0, 3, 5, 2))
"""Faces of a prism, counter-clockwise as seen from outside."""


def jacobians(points: Points, prisms: Cells) -> Values:
    """Return the Bernstein coefficients of the Jacobian of each prism, mm^3, shape ``(m, 9)``.

    The first three and the last three are the Jacobians at the corners. The minimum of a row is a
    lower bound of the Jacobian, and its sum is 18 times the volume.
    """
    corners = points[prisms]
    first, second = corners[:, :3], corners[:, 3:]
    ends = [(side[:, 1] - side[:, 0], side[:, 2] - side[:, 0]) for side in (first, second)]
    (u, v), (x, y) = ends
    normals = np.stack([np.cross(u, v), 0.5 * (np.cross(u, y) + np.cross(x, v)), np.cross(x, y)], axis=1)
    found: Values = np.einsum("mki,mji->mkj", normals, second - first).reshape(-1, 9)
    return found


def scaled_jacobian(points: Points, prisms: Cells) -> Values:
    """Return the minimum scaled Jacobian at the corners; 1 is a right prism on a regular triangle.

    At a corner, it is 2 / sqrt(3) times the Jacobian, divided by the product of the lengths of the
    three edges there (Verdict).
    """
    corners = points[prisms]
    sides = corners.reshape(-1, 2, 3, 3)
    around = np.linalg.norm(sides - np.roll(sides, -1, axis=2), axis=3)
    along = np.linalg.norm(corners[:, 3:] - corners[:, :3], axis=2)
    lengths = around * np.roll(around, 1, axis=2) * along[:, None, :]
    at_corners = jacobians(points, prisms).reshape(-1, 3, 3)[:, ::2]
    least: Values = (2.0 / np.sqrt(3.0) * at_corners / np.maximum(lengths, 1e-300)).min(axis=(1, 2))
    return least
