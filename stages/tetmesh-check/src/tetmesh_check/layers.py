"""Prism layers on walls, conforming to the tetrahedra inside.

The nodes of the wall stay, and the tetrahedra of the material get copies of them. A copy moves into
the material by the vector whose component along the normal of each adjacent wall triangle is the
thickness of all layers (least squares). At the rim, it stays in the planes of the caps. The nodes
nearby follow, and prisms fill the space between the wall and the copies. Where this makes a
tetrahedron or a prism poor, the layers get thinner, until all fit.
"""

from __future__ import annotations

from collections.abc import Set
from dataclasses import replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tetmesh_check.checks import Limits, below_limits
from tetmesh_check.errors import StageError
from tetmesh_check.export.mesh import MarkedMesh
from tetmesh_check.materials import NOBODY, NOTHING
from tetmesh_check.parts.model import Parts, Wall
from tetmesh_check.prisms import jacobians
from tetmesh_check.push import FOLLOWER_RINGS, NOISE, Followers, normal_system, normals_of, solve_in_turn
from tetmesh_check.quality import (
    Cells,
    Labels,
    Points,
    TetrahedronQuality,
    Values,
    tetrahedron_quality,
    triangle_quality,
)
from tetmesh_check.surface import Surface

MIN_SHARE = 0.1
"""Minimum thickness of layers, relative to the requested one: the check fails below it. Results of
flow near the wall depend on the first height, which is then an order of magnitude off."""
_FLOOR = 0.01
"""Share at which thinning ends. Layers of 1 % of the thickness hardly change the tetrahedra, which
fitted without layers. An element that is still poor has another cause."""
_STEP = 0.8
"""Factor by which the share is reduced where layers do not fit. The share found is then at least
0.8 of the maximum. From 1 to :data:`_FLOOR`, there are ln(0.01) / ln(0.8) = 21 steps."""
_SLOPE = 0.25
"""Maximum slope of the inner side of layers that get thinner, against the wall: the angles of their
prisms differ by at most arctan(0.25) = 14 degrees from those of full layers."""
_FLAT = 1e-9
"""Maximum difference from 1 of the length of the mean normal of a flat part. Its normals then
differ by about sqrt(2e-9) = 4.5e-5 from the mean, as with coordinates in single precision."""

_Mask = NDArray[np.bool_]


class _Shell(NamedTuple):
    """The boundary of the material of a wall."""

    faces: Labels
    """Indices of its triangles."""
    triangles: Cells
    """Their corners, outward from the material."""
    planes: Points
    """Unit normal of each triangle; on a cap or another flat part, that of the part."""
    is_flat: _Mask
    """Whether each triangle belongs to a flat part."""
    is_wall: _Mask
    """Whether each triangle belongs to the wall."""


class Layered(NamedTuple):
    """A mesh with layers on a wall."""

    mesh: MarkedMesh
    quality: TetrahedronQuality
    nodes: Labels
    """The nodes of the wall."""
    shares: Values
    """Thickness of the layers at each of them, relative to the requested one."""
    off_plane: float
    """Maximum distance by which a node left the plane of its cap, mm."""


def _shell(
    points: Points, triangles: Cells, marks: Labels, sides: tuple[_Mask, _Mask], wall: Wall, caps: Set[int]
) -> _Shell:
    """Return the boundary of the material of a wall.

    ``sides`` tells whether the material lies behind each triangle, and whether in front of it.
    """
    behind, front = sides
    faces = np.flatnonzero(behind | front)
    own, parts = triangles[faces], marks[faces]
    own[front[faces]] = own[front[faces]][:, [0, 2, 1]]
    planes, is_flat = normals_of(points, own)[0], np.zeros(len(own), dtype=bool)
    areas = triangle_quality(points, own).area
    for mark in np.unique(parts).tolist():
        on = parts == mark
        mean = areas[on] @ planes[on]
        length = float(np.linalg.norm(mean))
        if mark in caps or length > (1.0 - _FLAT) * areas[on].sum():
            planes[on], is_flat[on] = mean / length, True
    return _Shell(faces, own, planes, is_flat, np.isin(parts, sorted(wall.members)))


def _vectors(points: Points, shell: _Shell) -> tuple[Labels, Points, Values]:
    """Return the nodes of the wall, and their movement for a thickness of 1 mm.

    The third array is the height (mm) at the corners of each wall triangle, shape ``(m, 3)``.
    """
    wall, rest = shell.triangles[shell.is_wall], shell.triangles[~shell.is_wall]
    nodes = np.unique(wall)
    slide = normal_system(points, rest, nodes, np.zeros(len(rest)), shell.planes[~shell.is_wall])
    push = normal_system(points, wall, nodes, np.full(len(wall), -1.0))
    vectors = solve_in_turn(slide, push, (NOISE, NOISE))
    heights = -np.einsum("mij,mj->mi", vectors[np.searchsorted(nodes, wall)], normals_of(points, wall)[0])
    return nodes, vectors, heights


def refuse_layers(parts: Parts, surface: Surface) -> None:
    """Refuse walls on which layers cannot lie, before the surface is filled."""
    sides = surface.sides
    ones = np.ones(len(parts.marks), dtype=np.int64)
    inside, outside = (ones, 0 * ones) if sides is None else (sides.inside, sides.outside)
    caps = {row.number for row in parts.rows if row.is_cap}
    taken: dict[int, Labels] = {}
    for wall in parts.walls:
        told, name = wall.layers.told, parts.names[wall.material]
        own = inside == wall.material, outside == wall.material
        shell = _shell(surface.points, surface.triangles, parts.marks, own, wall, caps)
        nodes, _, heights = _vectors(surface.points, shell)
        beyond = (inside + outside)[shell.faces] - wall.material
        inner = shell.triangles[~shell.is_wall & (beyond != NOTHING)]
        low = shell.triangles[shell.is_wall][heights < MIN_SHARE]
        for stuck, what, why, remedy in (
            (np.intersect1d(nodes, inner), "the wall ends inside the mesh", "layers can end only on the outer boundary",
             f"add the other interfaces of {name} to the wall"),
            (np.intersect1d(nodes, taken.get(wall.material, [])), "it touches another wall with layers",
             "layers of two options do not share their rim", "join both walls by + in one --layers"),
            (low, "the layers have no direction", "the wall folds there, or meets the other boundary without an edge",
             "end the wall at the rim of a cap, or smooth the surface (a larger SCALE or SIZE)"),
        ):  # fmt: skip
            if len(stuck):
                x, y, z = surface.shown(surface.points[stuck[:1]])[0]
                raise StageError(f"{told}: {what} at ({x:.6g}, {y:.6g}, {z:.6g}) mm", why, remedy)
        taken[wall.material] = np.append(taken.get(wall.material, nodes), nodes)
        corners = surface.points[shell.triangles]
        volume = float(np.einsum("ij,ij->", corners[:, 0], np.cross(corners[:, 1], corners[:, 2]))) / 6.0
        widest = 3.0 * volume / float(triangle_quality(surface.points, shell.triangles).area.sum())
        if (thickness := float(wall.layers.depths[-1])) >= widest:
            raise StageError(
                f"{told}: {wall.layers.count} layers are {thickness:.4g} mm thick, and {name} has no room for them",
                f"a convex body of its volume V and area A has an inradius of at most 3 V / A = {widest:.4g} mm",
                "use fewer or thinner layers",
            )


def _slides(shell: _Shell, faces: Cells, count: int) -> tuple[_Mask, Points]:
    """Return the nodes that belong to one flat part only, and the normals of their planes.

    ``faces`` are all triangles of the mesh, of which ``shell`` has some.
    """
    is_flat = np.zeros(len(faces), dtype=bool)
    is_flat[shell.faces[shell.is_flat & ~shell.is_wall]] = True
    planes, normals = np.zeros((count, 3)), shell.planes[shell.is_flat & ~shell.is_wall]
    planes[faces[is_flat]] = normals[:, None, :]
    slides = np.asarray(planes.any(axis=1))
    slides[faces[~is_flat]] = False
    crossed = np.einsum("mij,mj->mi", planes[faces[is_flat]], normals) < 1.0 - _FLAT
    slides[faces[is_flat][crossed]] = False
    planes[~slides] = 0.0
    return slides, planes


def _of_material(mesh: MarkedMesh, wall: Wall) -> _Mask:
    """Return whether each element belongs to the material; all do in a mesh of one object."""
    return np.asarray((mesh.regions == wall.material) | (mesh.materials is None))


def _with_copies(mesh: MarkedMesh, shell: _Shell, wall: Wall, nodes: Labels) -> MarkedMesh:
    """Give the material copies of the nodes of the wall, one for each layer, still at the wall."""
    count, layers = len(mesh.points), wall.layers.count
    innermost = np.arange(count)
    innermost[nodes] = count + (layers - 1) * len(nodes) + np.arange(len(nodes))
    elements, faces = mesh.elements.copy(), mesh.faces.copy()
    own = _of_material(mesh, wall)[: len(elements)]
    elements[own] = innermost[elements[own]]
    rest = shell.faces[~shell.is_wall]
    faces[rest] = innermost[faces[rest]]
    points = np.concatenate([mesh.points, np.tile(mesh.points[nodes], (layers, 1))])
    return replace(mesh, points=points, elements=elements, faces=faces)


def _thinner(shares: Values, hit: _Mask, edges: Cells, rises: Values) -> Values:
    """Reduce the shares of the ``hit`` nodes, and limit the rise of shares along each edge."""
    shares = np.where(hit, _STEP * shares, shares)
    while True:
        lower = shares.copy()
        for start, end in (edges.T, edges.T[::-1]):
            np.minimum.at(lower, start, shares[end] + rises)
        if np.array_equal(lower, shares):
            return shares
        shares = lower


def _hit(poor: _Mask, elements: Cells, inner: Labels, count: int) -> _Mask:
    """Return which nodes of the inner side are nearest to poor tetrahedra, counted in elements.

    A poor tetrahedron has a node that followed, so it is at most
    :data:`.FOLLOWER_RINGS` elements away.
    """
    reached = np.zeros(count, dtype=bool)
    reached[elements[poor]] = True
    for _ in range(FOLLOWER_RINGS):
        if not reached[inner].any():
            reached[elements[reached[elements].any(axis=1)]] = True
    return reached[inner]


def _fit(
    mesh: MarkedMesh, shell: _Shell, wall: Wall, vectors: Points, before: TetrahedronQuality, limits: Limits
) -> tuple[Points, TetrahedronQuality, Values]:
    """Move the innermost nodes as far as all elements allow.

    Returns the positions, the shapes of the tetrahedra, and the share of each node of the wall.
    """
    triangles = shell.triangles[shell.is_wall]
    nodes, local = np.unique(triangles, return_inverse=True)
    local = local.reshape(-1, 3)
    count, thickness = len(mesh.points), float(wall.layers.depths[-1])
    inner = count - len(nodes) + np.arange(len(nodes))
    slides, planes = _slides(shell, mesh.faces, count)
    fixed = np.unique(np.concatenate([mesh.faces.ravel(), mesh.prisms.ravel()]))
    fixed = np.setdiff1d(fixed, np.setdiff1d(np.flatnonzero(slides), mesh.prisms))
    followers = Followers(mesh.points, mesh.tetrahedra, inner, fixed, planes)
    edges = np.unique(np.sort(local[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1), axis=0)
    at = mesh.points[nodes]
    rises = _SLOPE * np.linalg.norm(at[edges[:, 0]] - at[edges[:, 1]], axis=1) / thickness
    columns = np.column_stack([inner[local], triangles])
    was_below, shares = np.stack([*below_limits(before, limits).values()]), np.ones(len(nodes))
    while True:
        points = mesh.points.copy()
        points[inner] = at + thickness * shares[:, None] * vectors
        points = followers.follow(points)
        quality = tetrahedron_quality(points, mesh.tetrahedra)
        poor = (quality.volume <= 0.0) & (before.volume > 0.0)
        poor |= np.any(np.stack([*below_limits(quality, limits).values()]) & ~was_below, axis=0)
        folded = jacobians(points, columns).min(axis=1) <= 0.0
        if not (poor.any() or folded.any()):
            return points, quality, shares
        if shares.min() < _FLOOR:
            broken = mesh.shown[mesh.tetrahedra[poor] if poor.any() else triangles[folded]][0].mean(axis=0)
            raise StageError(
                f"{wall.layers.told}: no layers fit at ({', '.join(f'{x:.6g}' for x in broken)}) mm, not even of "
                f"{100.0 * _FLOOR:g} % of their thickness",
                "a tetrahedron or prism there would be inverted, or below a shape limit",
                "smooth the surface (a larger SCALE or SIZE), or lower --min-dihedral or --min-scaled-jacobian",
            )
        hit = _hit(poor, mesh.tetrahedra, inner, count)
        hit[local[folded]] = True
        shares = _thinner(shares, hit, edges, rises)


def _rim(shell: _Shell, count: int) -> tuple[Labels, Labels, Cells]:
    """Return the triangles beside each edge of the rim, and its nodes.

    The first array has indices of triangles of the wall, among these. The second one has indices of
    the other triangles, in the shell.
    """
    wall, rest = shell.triangles[shell.is_wall], shell.triangles[~shell.is_wall]
    ours, theirs = (corners[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2) for corners in (wall, rest))
    # two outward triangles have opposite directions at their common edge
    keys = ours[:, 1] * count + ours[:, 0], theirs[:, 0] * count + theirs[:, 1]
    _, one, other = np.intersect1d(*keys, return_indices=True)
    return one // 3, np.flatnonzero(~shell.is_wall)[other // 3], theirs[other]


def _stacked(mesh: MarkedMesh, copies: MarkedMesh, shell: _Shell, wall: Wall, nodes: Labels) -> MarkedMesh:
    """Return ``copies`` with prisms between the wall and the copied nodes.

    ``mesh`` is the mesh without the copies. The first prisms own the triangles of the wall. Each
    edge of the rim gets a quadrilateral for each layer.
    """
    levels = np.vstack([nodes, np.arange(len(mesh.points), len(copies.points)).reshape(-1, len(nodes))])
    local = np.searchsorted(nodes, shell.triangles[shell.is_wall])
    ours, theirs, rim = _rim(shell, len(mesh.points))
    a, b = np.searchsorted(nodes, rim).T
    pairs = list(pairwise(levels))
    prisms = np.concatenate([np.column_stack([inner[local], outer[local]]) for outer, inner in pairs])
    quads = np.concatenate([np.column_stack([outer[a], outer[b], inner[b], inner[a]]) for outer, inner in pairs])
    on, first = shell.faces[shell.is_wall], len(mesh.regions) + np.arange(len(local))
    owners, in_front = mesh.owners.copy(), mesh.before.copy()
    is_behind = _of_material(mesh, wall)[owners[on]] & (owners[on] != NOBODY)
    regions = mesh.regions[np.where(is_behind, owners[on], in_front[on])]
    owners[on[is_behind]], in_front[on[~is_behind]] = first[is_behind], first[~is_behind]
    return replace(
        copies,
        prisms=np.concatenate([mesh.prisms, prisms]),
        quads=np.concatenate([mesh.quads, quads]),
        regions=np.append(mesh.regions, np.tile(regions, len(pairs))),
        owners=np.append(owners, (first[ours] + len(local) * np.arange(len(pairs))[:, None]).ravel()),
        before=np.append(in_front, np.full(len(quads), NOBODY)),
        marks=np.append(mesh.marks, np.tile(mesh.marks[shell.faces[theirs]], len(pairs))),
    )


def add_layers(mesh: MarkedMesh, wall: Wall, before: TetrahedronQuality, limits: Limits) -> Layered:
    """Add the layers of one wall.

    Parameters
    ----------
    mesh
        Linear tetrahedra, and the prisms of other walls.
    wall
        The wall. Its nodes stay; their copies get the next numbers, layer by layer.
    before
        The shapes of the tetrahedra.
    limits
        The limits of shape. Layers make no tetrahedron miss them.

    Raises
    ------
    StageError
        If the wall is incomplete, or no layers fit.
    """
    own, marks = np.append(_of_material(mesh, wall), False), mesh.marks[: len(mesh.faces)]
    sides = own[mesh.owners[: len(marks)]], own[mesh.before[: len(marks)]]
    shell = _shell(mesh.points, mesh.faces, marks, sides, wall, mesh.caps)
    if shell.is_wall.sum() != np.isin(marks, sorted(wall.members)).sum():
        raise StageError(
            f"{wall.layers.told}: the tetrahedralizer lost triangles of the wall",
            "the layers would have holes; nothing was written",
            "see NAME.tetrahedra.log, or use another --tet-size-factor",
        )
    nodes, vectors, _ = _vectors(mesh.points, shell)
    copies = _with_copies(mesh, shell, wall, nodes)
    points, quality, shares = _fit(copies, shell, wall, vectors, before, limits)
    at, depths = mesh.points[nodes], wall.layers.depths
    steps = (points[-len(nodes) :] - at) / depths[-1]
    points[len(mesh.points) : -len(nodes)] = (at + depths[:-1, None, None] * steps).reshape(-1, 3)
    is_cap = ~shell.is_wall & shell.is_flat
    shift = points[copies.faces[shell.faces[is_cap]]] - mesh.points[mesh.faces[shell.faces[is_cap]]]
    off = np.abs(np.einsum("mij,mj->mi", shift, shell.planes[is_cap]))
    made = _stacked(mesh, replace(copies, points=points), shell, wall, nodes)
    return Layered(made, quality, nodes, shares, float(off.max(initial=0.0)))
