"""Topology of triangle meshes and of tetrahedra, computed by the Rust code from connectivity."""

from __future__ import annotations

from dataclasses import asdict, dataclass

import numpy as np
from isoparticles import _native

from tetmesh_check.quality import Cells, Labels, Points


def members_of(labels: Labels, count: int) -> list[Labels]:
    """Return the indices of the members of each group, ascending, as one array per group.

    Parameters
    ----------
    labels
        Group of each, from 0 on.
    count
        Number of groups.
    """
    order = np.argsort(labels, kind="stable")
    return np.split(order, np.searchsorted(labels[order], np.arange(1, count)))


@dataclass(frozen=True)
class Topology:
    """Counts that state whether a triangle mesh is a closed oriented surface."""

    vertices: int
    triangles: int
    edges: int
    unused_vertices: int
    open_edges: int
    """Edges with one triangle."""
    nonmanifold_edges: int
    """Edges with three or more triangles."""
    badly_oriented_edges: int
    """Edges whose two triangles disagree on which side is out."""
    nonmanifold_vertices: int
    """Vertices whose triangles form more than one fan."""
    components: int
    euler_characteristic: int
    """Vertices in use minus edges plus triangles: 2 for each sphere, 0 for a torus."""

    @property
    def is_closed_manifold(self) -> bool:
        """Whether the mesh is a closed, oriented 2-manifold."""
        return not (self.open_edges or self.nonmanifold_edges or self.badly_oriented_edges or self.nonmanifold_vertices)

    def as_dict(self) -> dict[str, int]:
        """Write the counts for the report."""
        return asdict(self)


def measure_topology(points: Points, triangles: Cells) -> Topology:
    """Count edges, fans and components of a triangle mesh.

    Parameters
    ----------
    points
        Positions, shape ``(n, 3)``; only their number matters.
    triangles
        Vertex indices, shape ``(m, 3)``.
    """
    return Topology(**_native.surface_topology(len(points), triangles))


@dataclass(frozen=True)
class Boundary:
    """The outside of a volume mesh."""

    triangles: Cells
    """Faces of only one tetrahedron, counter-clockwise as seen from outside, shape ``(k, 3)``."""
    owners: Labels
    """The tetrahedron of each, shape ``(k,)``."""
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


def changed_triangles(before: tuple[Points, Cells], after: tuple[Points, Cells]) -> tuple[int, int]:
    """Compare two triangle meshes by the exact coordinates and the cyclic order of corners.

    Parameters
    ----------
    before, after
        Points and triangles of the two meshes; the vertices of one have different positions.

    Returns
    -------
    tuple
        Number of triangles of the first that the second lacks, and the reverse.
    """
    missing, added = _native.changed_triangles(*before, *after)
    return missing, added
