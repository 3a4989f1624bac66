"""Which material each tetrahedron belongs to, and whether tetrahedra and interfaces fit together, by their connectivity alone.

What the tetrahedralizer says of its volumes is not asked. Tetrahedra hang together through faces that are no triangle of an interface;
each triangle tells what the tetrahedra behind it and before it belong to.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tetmesh_check.materials import NOTHING, Sides
from tetmesh_check.quality import Cells, Labels
from tetmesh_check.topology import connected_components, faces_of, number_faces

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
        Those of the interfaces, in the same vertices, shape ``(k, 3)``.
    sides
        Their materials.
    """
    size, count = len(tetrahedra), len(triangles)
    # face number f belongs to tetrahedron f modulo their number
    faces = faces_of(tetrahedra)
    number = number_faces(np.concatenate([faces, triangles.T], axis=1))
    total = int(number.max(initial=-1)) + 1
    of_face, of_triangle = number[: 4 * size], number[4 * size :]
    uses = np.bincount(of_face, minlength=total)
    triangle_of = np.full(total, NOBODY, dtype=np.int64)
    triangle_of[of_triangle] = np.arange(count)

    order = np.argsort(of_face, kind="stable")
    same = of_face[order[1:]] == of_face[order[:-1]]
    same &= triangle_of[of_face[order[1:]]] == NOBODY
    parts = connected_components(size, np.stack([order[:-1][same] % size, order[1:][same] % size], 1))

    at = np.flatnonzero(triangle_of[of_face] != NOBODY)
    triangle, tetrahedron = triangle_of[of_face[at]], at % size
    # the outward face of a tetrahedron behind a triangle is wound like it
    is_behind = _odd(faces[:, at]) == _odd(triangles.T)[triangle]
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

    alone = (uses == 1) & (triangle_of == NOBODY)
    return Conformity(
        regions,
        parts,
        behind,
        before,
        missing=int((~(fits(behind, sides.inside) & fits(before, sides.outside))).sum()),
        added=int(alone.sum()),
        crowded=int((uses > 2).sum()),
        undecided=int((regions == NOTHING).sum()),
    )
