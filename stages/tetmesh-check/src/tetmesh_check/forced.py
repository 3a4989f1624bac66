"""Finds where the surface itself allows no good tetrahedron.

There, facets meet at a small angle or lie close in front of each other. The Rust module
``tetrahedra::forced`` explains and computes the bounds.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from isoparticles import _native
from numpy.typing import NDArray

from tetmesh_check.quality import Cells, Labels, Points, Values

INSIDE, OUTSIDE = 0, 1
"""Sides of a facet: behind it, and in front of it, where its normal points."""


@dataclass(frozen=True)
class ForcedSides:
    """The sides of facets on which no tetrahedron reaches a minimum dihedral angle."""

    facet: Labels
    """Index of the facet, ascending, shape ``(k,)``."""
    side: Labels
    """:data:`INSIDE` or :data:`OUTSIDE`, shape ``(k,)``."""
    bound: Values
    """Largest minimum dihedral angle of a tetrahedron there, degrees, shape ``(k,)``."""

    def where(self, kept: NDArray[np.bool_]) -> ForcedSides:
        """Select some of the sides; ``kept`` has the shape ``(k,)``."""
        return ForcedSides(self.facet[kept], self.side[kept], self.bound[kept])


def forced_sides(points: Points, triangles: Cells, angle: float) -> ForcedSides:
    """Find the sides of facets on which every tetrahedron has a smaller dihedral angle.

    Parameters
    ----------
    points
        Positions, mm, shape ``(n, 3)``.
    triangles
        Vertex indices, shape ``(m, 3)``; each has an area, and no two cross.
    angle
        Dihedral angle, degrees, above 0 and below 90.
    """
    return ForcedSides(*_native.forced_sides(points, triangles, angle))


def largest_jacobians(points: Points, triangles: Cells, angle: float) -> Values:
    """Return the largest scaled Jacobian of a tetrahedron on each triangle.

    Parameters
    ----------
    points
        Positions, mm, shape ``(n, 3)``.
    triangles
        Vertex indices, shape ``(m, 3)``; each has an area.
    angle
        Minimum dihedral angle of the tetrahedron, degrees, below 180.
    """
    return _native.largest_jacobians(points, triangles, angle)
