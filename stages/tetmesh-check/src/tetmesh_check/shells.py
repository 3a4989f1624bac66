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
    """Size of each volume, mm^3, cavities taken off, shape ``(v,)``."""
    of_inside: Labels
    """Volume behind each triangle, shape ``(m,)``."""
    of_outside: Labels
    """Volume before it, shape ``(m,)``; where there is no material below 0, another number for each
    shell of the outside."""
    mixed: int
    """Wedges between sides of different materials: at such an edge the order of the triangles
    contradicts their materials."""
    narrowest: Values
    """Smallest wedge of each material, degrees, shape ``(t,)``: no tetrahedron there has a wider
    smallest dihedral angle."""
    inside_out: int
    """Shells that bound a cavity which lies in no volume of its material: turned the wrong way
    round."""

    def sheets(self) -> tuple[Cells, Labels]:
        """Pairs of volumes that touch, and the pair of each triangle.

        Neither two volumes nor two hollows have the same sheets round them.
        """
        pairs, which = np.unique(np.stack([self.of_inside, self.of_outside], 1), axis=0, return_inverse=True)
        return pairs, which.ravel().astype(np.int64)
