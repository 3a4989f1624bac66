"""The parts of a surface and the sets of parts.

Every triangle belongs to exactly one part. A part lies in one interface, on one cap or outside all
caps, and inside the same tags. A set is a union of parts: of a tag, or of an expression
(:mod:`.algebra`).
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from isoparticles import _native

from tetmesh_check.materials import NOTHING
from tetmesh_check.parts.algebra import Members
from tetmesh_check.parts.layers import Layers
from tetmesh_check.parts.splits import Split
from tetmesh_check.quality import Cells, Labels, Points
from tetmesh_check.surface import Surface

NO_PART = 0
"""Number that stands for no part."""


@dataclass(frozen=True)
class Part:
    """One part of the surface."""

    number: int
    """Mark of its triangles, from 1."""
    name: str
    inside: int
    """Number of the material behind it."""
    outside: int
    """Number of the material in front of it, 0 for the outside."""
    is_cap: bool = False
    """Whether a face of the volume cuts the object there."""
    tags: tuple[str, ...] = ()
    """The tags that split it off from another part; empty if none did."""
    within: tuple[str, ...] = ()
    """All tags that contain it."""
    twin: int = 0
    """Number of the other side if the interface is split, else 0."""

    @property
    def kind(self) -> str:
        """``tag``, ``cap``, ``skin`` (other boundary of the mesh) or ``interface``."""
        if self.tags:
            return "tag"
        return "cap" if self.is_cap else "skin" if self.outside == NOTHING else "interface"


@dataclass(frozen=True)
class NamedUnion:
    """A set: a union of parts."""

    name: str
    text: str
    """Its expression or shape."""
    members: Members
    """Numbers of its parts."""


@dataclass(frozen=True)
class SplitInterface:
    """The two sides of a split interface A/B."""

    split: Split
    first: list[int]
    """Numbers of the parts of A."""
    second: list[int]
    """Numbers of the parts of B."""
    contact: tuple[str, str]
    """Names of the two sides, each a part or a set."""

    @property
    def name(self) -> str:
        """The interface as given: ``A/B``."""
        return "/".join(self.split.node.names)


@dataclass(frozen=True)
class Wall:
    """A wall with prism layers."""

    layers: Layers
    members: Members
    """Numbers of its parts."""
    material: int
    """Number of the material that gets the layers."""


@dataclass(frozen=True)
class Parts:
    """The parts of a surface, and the sets of parts."""

    marks: Labels
    """Number of the part of each triangle, shape ``(m,)``."""
    rows: list[Part]
    names: list[str]
    """Names of the materials by number, ``outside`` first."""
    unions: list[NamedUnion]
    splits: list[SplitInterface] = field(default_factory=list)
    """The split interfaces."""
    walls: list[Wall] = field(default_factory=list)
    """The walls with prism layers."""

    @property
    def set_names(self) -> list[str]:
        """Names of the parts and of the sets."""
        return [row.name for row in self.rows] + [union.name for union in self.unions]

    def on(self, surface: Surface, points: Points, boundary: Cells) -> Labels:
        """Return the number of the part of each triangle of the boundary of one object.

        Each triangle gets the part of the input triangle nearest to its centroid. If triangles of
        two parts are equally near, the one with the more similar normal counts.

        Parameters
        ----------
        surface
            The input.
        points, boundary
            The boundary of the tetrahedra.
        """
        marks = _same_triangles(surface, self.marks, points, boundary)
        left = np.flatnonzero(marks == NO_PART)
        if len(left):
            first, *others = sorted(self.rows, key=lambda row: -np.count_nonzero(self.marks == row.number))
            marks[left] = first.number
            for row in others:
                flags = (self.marks == row.number).astype(np.uint8)
                near = _native.nearest_flags(points, boundary[left], surface.points, surface.triangles, flags)
                marks[left[near.astype(bool)]] = row.number
        return marks


def _same_triangles(surface: Surface, marks: Labels, points: Points, boundary: Cells) -> Labels:
    """Return the part of each triangle of the surface, and :data:`NO_PART` of other triangles."""
    used, local = np.unique(boundary, return_inverse=True)
    _, ids = np.unique(np.concatenate([surface.points, points[used]]), axis=0, return_inverse=True)
    ids = ids.ravel()
    corners = np.concatenate([ids[surface.triangles], ids[len(surface.points) + local.reshape(-1, 3)]])
    _, first, which = np.unique(np.sort(corners, axis=1), axis=0, return_index=True, return_inverse=True)
    count = len(surface.triangles)
    # the first of equal triangles is that of the surface, if it has one
    same = first[which.ravel()[count:]]
    return np.where(same < count, marks[np.minimum(same, count - 1)], NO_PART)
