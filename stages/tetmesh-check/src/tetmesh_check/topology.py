"""Topology of triangle meshes and of tetrahedra, computed by the Rust code from connectivity."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from isoparticles import _native

from tetmesh_check.quality import Cells, Labels, Values

NOT_MANIFOLD = ("open_edges", "nonmanifold_edges", "badly_oriented_edges", "nonmanifold_vertices")
"""Counts of a surface's topology that are 0 for a closed, oriented manifold."""


def members_of(labels: Labels, count: int) -> list[Labels]:
    """Return the indices of the members of each group, ascending, as one array per group.

    Parameters
    ----------
    labels
        Group of each member, numbered from 0.
    count
        Number of groups.
    """
    order = np.argsort(labels, kind="stable")
    return np.split(order, np.searchsorted(labels[order], np.arange(1, count)))


def pairs_of(inside: Labels, outside: Labels) -> tuple[Cells, Labels]:
    """Return the distinct pairs of labels, ascending, and the index of the pair of each entry.

    Parameters
    ----------
    inside, outside
        The labels.
    """
    pairs, which = np.unique(np.stack([inside, outside], 1), axis=0, return_inverse=True)
    return pairs, which.ravel().astype(np.int64)


class Components(NamedTuple):
    """The components of a closed surface.

    A component outside all bodies, or in a cavity, is the outer boundary of a body and must have a
    positive volume. A component inside a body is the boundary of a cavity and must have a negative
    volume.
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
        """Return body and outside (-1) of each component, and the component of each triangle."""
        outer = np.where(self.depths % 2 == 0, np.arange(len(self.depths)), self.parents)
        bodies = np.unique(outer, return_inverse=True)[1].ravel()
        return np.stack([bodies, np.full_like(bodies, -1)], axis=1), self.labels

    def cavities(self) -> tuple[Labels, Labels]:
        """Return the component of each triangle, and the components around cavities."""
        return self.labels, np.flatnonzero(self.depths % 2 == 1)


class Shells(NamedTuple):
    """The volumes of a surface of many materials: connected parts of one material each."""

    materials: Labels
    """Material of each volume, shape ``(v,)``, ascending."""
    sizes: Values
    """Size of each volume without its cavities, mm^3, shape ``(v,)``."""
    of_inside: Labels
    """Volume behind each triangle, shape ``(m,)``."""
    of_outside: Labels
    """Volume in front of each triangle, shape ``(m,)``. On the outside, this is a negative number,
    which differs for each shell."""
    mixed: int
    """Number of wedges between sides of different materials. At such an edge, the order of the
    triangles contradicts their materials."""
    narrowest: Values
    """Smallest wedge of each material, degrees, shape ``(t,)``. The minimum dihedral angle of a
    tetrahedron there cannot be larger."""
    inside_out: int
    """Number of cavities that lie in no volume of their material, because their triangles are
    inside out."""

    def sheets(self) -> tuple[Cells, Labels]:
        """Return the pairs of volumes that touch, and the pair of each triangle.

        A pair is called a sheet. No two volumes or cavities are bounded by the same sheets.
        """
        return pairs_of(self.of_inside, self.of_outside)

    def cavities(self) -> tuple[Labels, Labels]:
        """Return the number in front of each triangle, and those outside all volumes."""
        return self.of_outside, np.unique(self.of_outside[self.of_outside < 0])


class Boundary(NamedTuple):
    """The boundary of a volume mesh, and its bodies."""

    triangles: Cells
    """Faces of only one tetrahedron, counter-clockwise as seen from outside, shape ``(k, 3)``."""
    owners: Labels
    """The tetrahedron of each triangle, shape ``(k,)``."""
    bodies: Labels
    """Body of each tetrahedron, shape ``(m,)``, from 0; a body is connected through faces."""


def tetrahedron_boundary(tetrahedra: Cells) -> Boundary:
    """Find the boundary of a volume mesh, and its bodies.

    Parameters
    ----------
    tetrahedra
        Vertex indices in VTK order, shape ``(m, 4)``.
    """
    return Boundary(*_native.tetrahedron_boundary(int(tetrahedra.max(initial=-1)) + 1, tetrahedra))
