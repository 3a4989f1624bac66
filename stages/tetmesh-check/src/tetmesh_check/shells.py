"""The volumes that a surface of many materials bounds."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tetmesh_check.quality import Cells, Labels, Values


@dataclass(frozen=True)
class Shells:
    """The volumes of a surface of many materials: connected parts of one material each."""

    materials: Labels
    """Material of each volume, shape ``(v,)``, ascending."""
    sizes: Values
    """Size of each volume without its cavities, mm^3, shape ``(v,)``."""
    of_inside: Labels
    """Volume behind each triangle, shape ``(m,)``."""
    of_outside: Labels
    """Volume before it, shape ``(m,)``; where there is no material below 0, another number for each
    shell of the outside."""
    mixed: int
    """Number of wedges between sides of different materials. At such an edge, the order of the
    triangles contradicts their materials."""
    narrowest: Values
    """Smallest wedge of each material, degrees, shape ``(t,)``: no tetrahedron there has a wider
    smallest dihedral angle."""
    inside_out: int
    """Number of cavities that lie in no volume of their material, because their triangles are
    inside out."""

    def sheets(self) -> tuple[Cells, Labels]:
        """Return the pairs of volumes that touch, and the pair of each triangle.

        No two volumes or hollows have the same sheets as their boundary.
        """
        pairs, which = np.unique(np.stack([self.of_inside, self.of_outside], 1), axis=0, return_inverse=True)
        return pairs, which.ravel().astype(np.int64)
