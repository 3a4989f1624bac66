"""Which material each tetrahedron belongs to, and whether tetrahedra and interfaces fit together, by their connectivity alone.

What the tetrahedralizer says of its volumes is not asked. Tetrahedra hang together through faces that are no triangle of an interface;
each triangle tells what the tetrahedra behind it and before it belong to.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tetmesh_check.materials import NOTHING, Sides
from tetmesh_check.quality import Cells, Labels
from tetmesh_check.topology import Boundary, connected_components, equal_faces, outward_faces

NOBODY = -1
"""In place of a tetrahedron that is not there."""


@dataclass(frozen=True)
class Conformity:
    """How tetrahedra and interfaces fit together."""

    regions: Labels
    """Material of each tetrahedron, shape ``(m,)``; 0 where nothing or too much tells it."""
    parts: Labels
    """Face-connected part of a region that each belongs to, shape ``(m,)``."""
    behind: Labels
    """Tetrahedron behind each triangle of the interfaces, shape ``(k,)``; :data:`NOBODY` where it is missing."""
    before: Labels
    """Tetrahedron before it; :data:`NOBODY` where the outside is, or where it is missing."""
    missing: int
    """Triangles that are no face of a tetrahedron of the right material on each of their sides."""
    added: int
    """Faces with one tetrahedron that are no triangle of the interfaces."""
    crowded: int
    """Faces of more than two tetrahedra."""
    undecided: int
    """Tetrahedra whose material nothing tells, or different triangles tell differently."""

    @property
    def faults(self) -> int:
        """All faults together: 0 for a conforming mesh of the regions."""
        return self.missing + self.added + self.crowded + self.undecided


def _odd(faces: Cells) -> Labels:
    """Whether each column is an odd permutation of its sorted one, shape ``(n,)``, 0 or 1."""
    a, b, c = faces
    odd: Labels = ((a > b).astype(np.int64) + (b > c) + (a > c)) % 2
    return odd


def conform(tetrahedra: Cells, triangles: Cells, sides: Sides) -> Conformity:
    """Find the material of each tetrahedron, and what does not fit.

    Parameters
    ----------
    tetrahedra
        Vertex indices in VTK order, positive, shape ``(m, 4)``.
    triangles
        Those of the interfaces, in the same vertices, none twice, shape ``(k, 3)``.
    sides
        Their materials.
    """
    size, count = len(tetrahedra), len(triangles)
    order, same = equal_faces(tetrahedra, triangles)
    starts = np.flatnonzero(np.concatenate([[True], ~same]))
    uses = np.diff(starts, append=len(order))
    # where a triangle is, and what is equal to it
    at = np.flatnonzero(order >= 4 * size)
    group = np.searchsorted(starts, at, side="right") - 1
    at_triangle, found = np.zeros(len(order), dtype=np.bool_), []
    for k in range(int(uses[group].max(initial=0))):
        there = k < uses[group]
        place = starts[group[there]] + k
        at_triangle[place] = True
        found.append(np.stack([order[place], order[at[there]] - 4 * size]))
    faces, triangle = np.concatenate([np.empty((2, 0), dtype=np.int64), *found], axis=1)
    first = np.argsort(faces, kind="stable")
    first = first[faces[first] < 4 * size]
    faces, triangle = faces[first], triangle[first]
    added = int((uses == 1).sum() - (uses[group] == 1).sum())
    np.subtract.at(uses, group, 1)
    crowded = int((uses > 2).sum())

    links = np.flatnonzero(same & ~at_triangle[:-1])
    # face number f belongs to tetrahedron f modulo their number
    parts = connected_components(size, np.stack([order[links] % size, order[links + 1] % size], 1))

    tetrahedron = faces % size
    # the outward face of a tetrahedron behind a triangle is wound like it
    is_behind = _odd(outward_faces(tetrahedra, faces)[0]) == _odd(triangles.T)[triangle]
    behind, before = np.full(count, NOBODY, dtype=np.int64), np.full(count, NOBODY, dtype=np.int64)
    behind[triangle[is_behind]] = tetrahedron[is_behind]
    before[triangle[~is_behind]] = tetrahedron[~is_behind]

    told = np.where(is_behind, sides.inside[triangle], sides.outside[triangle])
    part_count = int(parts.max(initial=-1)) + 1
    low, high = np.full(part_count, np.iinfo(np.int64).max), np.full(part_count, NOTHING)
    np.minimum.at(low, parts[tetrahedron], told)
    np.maximum.at(high, parts[tetrahedron], told)
    material = np.where(low == high, low, NOTHING)
    regions = material[parts]

    def fits(owner: Labels, wanted: Labels) -> Labels:
        """Whether the tetrahedron on one side is of the material there; none must be where that is the outside."""
        found = np.where(owner == NOBODY, NOTHING, regions[owner])
        right: Labels = (found == wanted) & ((owner == NOBODY) == (wanted == NOTHING))
        return right

    return Conformity(
        regions,
        parts,
        behind,
        before,
        missing=int((~(fits(behind, sides.inside) & fits(before, sides.outside))).sum()),
        added=added,
        crowded=crowded,
        undecided=int((regions == NOTHING).sum()),
    )


def outside_of(found: Conformity, triangles: Cells) -> Boundary:
    """Find the outside of a mesh without a fault, and its bodies, from what is known of its triangles and parts.

    Parameters
    ----------
    found
        How it fits the interfaces.
    triangles
        Those of the interfaces, shape ``(k, 3)``.
    """
    assert found.faults == 0, "only then are all faces at the border triangles"
    last, first = np.flatnonzero(found.before == NOBODY), np.flatnonzero(found.behind == NOBODY)
    joined = (found.before != NOBODY) & (found.behind != NOBODY)
    links = np.stack([found.parts[found.behind[joined]], found.parts[found.before[joined]]], 1)
    bodies = connected_components(int(found.parts.max()) + 1, links)
    return Boundary(
        np.concatenate([triangles[last], triangles[first][:, ::-1]]),
        np.concatenate([found.behind[last], found.before[first]]),
        bodies[found.parts],
    )
