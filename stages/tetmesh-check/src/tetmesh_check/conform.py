"""Finds the material of each tetrahedron, and whether tetrahedra and interfaces fit together.

The tetrahedralizer's own volumes are not used. The Rust code finds the materials from connectivity
alone: tetrahedra are connected through faces that are not triangles of an interface, and each
triangle states the materials on its two sides.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from isoparticles import _native

from tetmesh_check.materials import Sides
from tetmesh_check.quality import Cells, Labels
from tetmesh_check.topology import Boundary

NOBODY = -1
"""Stands for a tetrahedron that does not exist."""


@dataclass(frozen=True)
class Conformity:
    """Conformity of tetrahedra and interfaces."""

    regions: Labels
    """Material of each tetrahedron, shape ``(m,)``; 0 if the triangles state none or several."""
    parts: Labels
    """Part of each tetrahedron: connected through faces that are no triangles, shape ``(m,)``."""
    bodies: Labels
    """Body of each tetrahedron: connected through faces, shape ``(m,)``."""
    behind: Labels
    """Tetrahedron behind each triangle of the interfaces, or :data:`NOBODY`, shape ``(k,)``."""
    before: Labels
    """Tetrahedron in front of each triangle, or :data:`NOBODY`, shape ``(k,)``."""
    missing: int
    """Triangles that are not a face of a tetrahedron of the right material on each side."""
    added: int
    """Faces of only one tetrahedron that are not triangles of the interfaces."""
    crowded: int
    """Faces of more than two tetrahedra."""
    undecided: int
    """Tetrahedra without a material."""

    @property
    def faults(self) -> int:
        """Number of all faults; 0 for a conforming mesh of the regions."""
        return self.missing + self.added + self.crowded + self.undecided


def conform(vertices: int, tetrahedra: Cells, triangles: Cells, sides: Sides) -> Conformity:
    """Find the material of each tetrahedron, and count what does not fit.

    Parameters
    ----------
    vertices
        Number of vertices.
    tetrahedra
        Vertex indices in VTK order, positive, shape ``(m, 4)``.
    triangles
        Triangles of the interfaces with the same vertices, none twice, shape ``(k, 3)``.
    sides
        Their materials.
    """
    return Conformity(**_native.conform(vertices, tetrahedra, triangles, sides.inside, sides.outside))


def outside_of(found: Conformity, triangles: Cells) -> Boundary:
    """Return the boundary of a conforming mesh.

    Parameters
    ----------
    found
        Its conformity with the interfaces.
    triangles
        Triangles of the interfaces, shape ``(k, 3)``.
    """
    assert found.faults == 0, "only then are all faces of the boundary triangles"
    last, first = np.flatnonzero(found.before == NOBODY), np.flatnonzero(found.behind == NOBODY)
    return Boundary(
        np.concatenate([triangles[last], triangles[first][:, ::-1]]),
        np.concatenate([found.behind[last], found.before[first]]),
        found.bodies,
    )
