"""Finds where the surface itself allows no good tetrahedron.

There, facets meet at a small angle or lie close in front of each other. The Rust module
``tetrahedra::forced`` explains and computes the bounds.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from isoparticles import _native
from isoparticles._native import Context
from numpy.typing import NDArray

from tetmesh_check.checks import REMEDY, Limits, counted, shape_of
from tetmesh_check.materials import NOBODY, NOTHING, Conformity
from tetmesh_check.quality import Labels, TetrahedronQuality, Values, centres_of
from tetmesh_check.surface import Surface, place_of

INSIDE, OUTSIDE = 0, 1
"""Sides of a facet: behind it, and in front of it, where its normal points."""


class ForcedSides(NamedTuple):
    """The sides of facets on which no tetrahedron reaches a limit of shape."""

    facet: Labels
    """Index of the facet, ascending, shape ``(k,)``."""
    side: Labels
    """:data:`INSIDE` or :data:`OUTSIDE`, shape ``(k,)``."""
    bound: Values
    """The maximum that a tetrahedron can reach there: of its minimum dihedral angle, degrees, or of
    its scaled Jacobian, shape ``(k,)``."""

    def where(self, kept: NDArray[Any]) -> ForcedSides:
        """Select some of the sides by a mask or by their indices."""
        return ForcedSides(self.facet[kept], self.side[kept], self.bound[kept])

    def occupied(self, found: Conformity) -> tuple[ForcedSides, Labels]:
        """Return the sides with a tetrahedron, the lowest bound first, and these tetrahedra."""
        order = np.argsort(self.bound, kind="stable")
        facet = self.facet[order]
        standing = np.where(self.side[order] == INSIDE, found.behind[facet], found.before[facet])
        there = standing != NOBODY
        return self.where(order[there]), standing[there]


def find_forced(surface: Surface, limits: Limits, context: Context) -> tuple[ForcedSides, ForcedSides]:
    """Find where the surface allows no tetrahedron within the limits of shape, and warn of it.

    Parameters
    ----------
    surface
        The checked surface.
    limits
        The limits of shape.
    context
        For the warnings.

    Returns
    -------
    tuple
        Sides on which no tetrahedron reaches the limit of the dihedral angle, because of other
        triangles; both sides of the triangles whose own angles are too small for both limits.
    """
    assert surface.sides is not None, "only many materials force tetrahedra"
    sides, angle = surface.sides, limits.min_dihedral
    found = ForcedSides(*_native.forced_sides(surface.points, surface.triangles, angle))
    material = np.where(found.side == INSIDE, sides.inside[found.facet], sides.outside[found.facet])
    by_surface, material = found.where(material != NOTHING), material[material != NOTHING]
    if len(material):
        triangles, bound, place = _sharpest(by_surface, surface)
        context.warn(
            f"on {triangles}, no tetrahedron can reach the minimum dihedral angle of {angle:g} degrees "
            "(--min-dihedral), because other triangles meet them at a smaller angle or lie close in front of them. "
            f"The worst place allows {bound} degrees, in {sides.names[material[by_surface.bound.argmin()]]} at {place} "
            f"(all places: forced_by_surface in the report); {REMEDY}"
        )
    possible = _native.largest_jacobians(surface.points, surface.triangles, angle)
    thin = np.flatnonzero(possible < limits.min_scaled_jacobian)
    by_triangle = ForcedSides(thin, np.full(len(thin), INSIDE), possible[thin])
    if len(thin):
        triangles, bound, place = _sharpest(by_triangle, surface)
        context.warn(
            f"on {triangles} with a small angle, no tetrahedron can reach both a dihedral angle of {angle:g} degrees "
            f"and a scaled Jacobian of {limits.min_scaled_jacobian:g} (--min-dihedral, --min-scaled-jacobian). The "
            f"worst place allows a scaled Jacobian of {bound}, at {place} (all places: forced_by_triangle in the "
            f"report); {REMEDY}"
        )
    return by_surface, ForcedSides(thin.repeat(2), np.tile([INSIDE, OUTSIDE], len(thin)), possible[thin].repeat(2))


def _sharpest(found: ForcedSides, surface: Surface) -> tuple[str, str, str]:
    """Write the number of triangles, and the bound and the place of that with the lowest bound."""
    sharpest = int(found.bound.argmin())
    place = place_of(surface, surface.triangles[found.facet[sharpest]])
    return counted(len(found.facet), "triangle"), f"{found.bound[sharpest]:.3g}", place


def list_forced(
    sides: ForcedSides, possible: str, surface: Surface, found: Conformity, quality: TetrahedronQuality
) -> list[dict[str, Any]]:
    """List the tetrahedra on forced sides for the report, the lowest bound first.

    Parameters
    ----------
    sides
        The sides.
    possible
        Key of the bound in the report.
    surface
        The surface.
    found, quality
        Conformity and quality of the tetrahedra.
    """
    occupied, tetrahedra = sides.occupied(found)
    centres = surface.shown(centres_of(surface.points, surface.triangles[occupied.facet]))
    names = surface.sides.names if surface.sides is not None else []
    return [
        {"place_mm": place, "material": names[found.regions[cell]], possible: bound, **shape_of(quality, cell)}
        for place, bound, cell in zip(centres.tolist(), occupied.bound.tolist(), tetrahedra.tolist(), strict=True)
    ]
