"""Connected components of a closed surface: their volumes and nesting."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from isoparticles import _native

from tetmesh_check.quality import Cells, Labels, Points, Values


@dataclass(frozen=True)
class Components:
    """The components of a closed surface.

    A component that lies in the open, or in a cavity, bounds a body from outside and must have a
    positive volume; one that lies in a body bounds a cavity and must have a negative one.
    """

    labels: Labels
    """Component of each triangle, numbered from 0."""
    volumes: Values
    """Signed volume of each component, mm^3."""
    depths: Labels
    """Number of other components that enclose each component."""
    parents: Labels
    """The innermost component that encloses each component, or -1."""

    def inside_out(self) -> Labels:
        """Return the numbers of the components with the wrong orientation."""
        outer = self.depths % 2 == 0
        wrong: Labels = np.flatnonzero(np.where(outer, self.volumes <= 0, self.volumes >= 0))
        return wrong

    def sheets(self) -> tuple[Cells, Labels]:
        """Return the body and the outside (-1) of each component, and each triangle's component."""
        outer = np.where(self.depths % 2 == 0, np.arange(len(self.depths)), self.parents)
        bodies = np.unique(outer, return_inverse=True)[1].ravel()
        return np.stack([bodies, np.full_like(bodies, -1)], axis=1), self.labels


def measure_components(points: Points, triangles: Cells) -> Components:
    """Find the components of a closed surface and their nesting.

    Parameters
    ----------
    points
        Positions, mm, shape ``(n, 3)``.
    triangles
        Vertex indices of a closed surface, shape ``(m, 3)``; components must not intersect each
        other.
    """
    return Components(**_native.surface_components(points, triangles))
