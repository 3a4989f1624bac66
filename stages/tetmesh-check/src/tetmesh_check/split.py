"""Splits interfaces of a mesh of many materials: doubles their nodes and their triangles.

The tetrahedra around a node are connected through their faces, except those on the split
interfaces. Each connected group of them gets a node of its own. This separates the sides, including
the rim on the free surface. Rim nodes that a third material connects stay shared, like a crack tip.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tetmesh_check.export.mesh import MarkedMesh
from tetmesh_check.materials import NOBODY
from tetmesh_check.parts.model import Parts
from tetmesh_check.quality import OUTWARD_FACES, Cells, Labels, Values

_TURNED = [0, 2, 1, 5, 4, 3]
"""Nodes of a triangle in the opposite orientation; the last three are those of its edges."""


def split(mesh: MarkedMesh, parts: Parts) -> MarkedMesh:
    """Split the interfaces of a mesh.

    Returns the same mesh if no part has a second side, or if a triangle of an interface to split
    has no tetrahedron on a side. The latter fails the check ``interfaces_kept``.

    Parameters
    ----------
    mesh
        Linear or quadratic tetrahedra that share their nodes. The number and order of the
        tetrahedra, and the numbers of the nodes, stay; copies of nodes follow.
    parts
        The parts, with both sides of the split interfaces.
    """
    twins = {row.number: row.twin for row in parts.rows if row.twin}
    cut = np.flatnonzero(np.isin(mesh.marks, list(twins)))
    if not len(cut) or (mesh.owners[cut] == NOBODY).any() or (mesh.before[cut] == NOBODY).any():
        return mesh
    elements, copied = _doubled(mesh.elements, mesh.faces[cut], len(mesh.points))
    faces, held = mesh.faces.copy(), np.flatnonzero(mesh.owners != NOBODY)
    faces[held] = _of_element(faces[held], mesh.owners[held], mesh.elements, elements)
    others = _of_element(mesh.faces[cut], mesh.before[cut], mesh.elements, elements)
    before = mesh.before.copy()
    before[cut] = NOBODY
    return replace(
        mesh,
        points=np.concatenate([mesh.points, mesh.points[copied]]),
        point_fields=_point_fields(mesh, elements, copied),
        elements=elements,
        faces=np.concatenate([faces, others[:, _TURNED[: faces.shape[1]]]]),
        owners=np.concatenate([mesh.owners, mesh.before[cut]]),
        before=np.concatenate([before, np.full(len(cut), NOBODY)]),
        marks=np.concatenate([mesh.marks, [twins[mark] for mark in mesh.marks[cut].tolist()]]),
        contacts=[interface.contact for interface in parts.splits],
    )


def _point_fields(mesh: MarkedMesh, elements: Cells, copied: Labels) -> dict[str, Values]:
    """Return the fields of the points, which are NaN where no tetrahedron has fibres."""
    if not mesh.point_fields:
        return {}
    known = np.unique(elements[mesh.fields["fibre"].any(axis=1)])
    found = {name: np.full(len(mesh.points) + len(copied), np.nan) for name in mesh.point_fields}
    for name, values in mesh.point_fields.items():
        found[name][known] = np.append(values, values[copied])[known]
    return found


def _doubled(elements: Cells, cut: Cells, count: int) -> tuple[Cells, Labels]:
    """Give each connected group of tetrahedra around a node a node of its own.

    Returns the tetrahedra, and the node that each new node is a copy of. New nodes are numbered
    from ``count``.
    """
    nodes = np.unique(cut)
    near = np.flatnonzero(np.isin(elements, nodes).any(axis=1))
    cells = elements[near]
    faces = np.concatenate([cut[:, :3], *(cells[:, list(face)] for face in OUTWARD_FACES)])
    which = np.unique(np.sort(faces, axis=1), axis=0, return_inverse=True)[1].ravel()
    which[np.isin(which, which[: len(cut)])] = -1
    owner = np.tile(np.arange(len(cells)), 4)
    order = np.argsort(which[len(cut) :], kind="stable")
    sorted_which = which[len(cut) :][order]
    pairs = np.flatnonzero((sorted_which[1:] == sorted_which[:-1]) & (sorted_which[1:] >= 0))
    one, other = owner[order[pairs]], owner[order[pairs + 1]]
    pair, here, there = np.nonzero(cells[one][:, :, None] == cells[other][:, None, :])
    # a slot is a node of an element; slots of one group get the number of their first slot
    width = cells.shape[1]
    first, second = one[pair] * width + here, other[pair] * width + there
    group, last = np.arange(cells.size), np.zeros(0, dtype=np.int64)
    while not np.array_equal(group, last):
        last = group.copy()
        np.minimum.at(group, first, group[second])
        np.minimum.at(group, second, group[first])
        group = group[group]
    slots = np.flatnonzero(np.isin(cells, nodes))
    found, index = np.unique(np.stack([cells.ravel()[slots], group[slots]], 1), axis=0, return_inverse=True)
    numbers = found[:, 0].copy()
    again = np.flatnonzero(np.diff(numbers, prepend=-1) == 0)
    copied = numbers[again]
    numbers[again] = count + np.arange(len(again))
    cells.ravel()[slots] = numbers[index.ravel()]
    result = elements.copy()
    result[near] = cells
    return result, copied


def _of_element(faces: Cells, owners: Labels, before: Cells, after: Cells) -> Cells:
    """Return the nodes of faces in the new numbers of their elements."""
    slots = (before[owners][:, None, :] == faces[:, :, None]).argmax(axis=2)
    return np.take_along_axis(after[owners], slots, axis=1)
