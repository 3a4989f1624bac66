"""Moves the two sides of split interfaces apart until the distance between them is the gap.

A node moves by the vector d whose component along the normal of each adjacent triangle of its side
is half the gap, into its material (least squares). Its tangential component keeps the node on its
other triangles, such as the free surface at the rim. The measured distances of the triangles
correct these vectors in the same way. Interior nodes nearby follow. A node that both sides share
stays. Each curved triangle of quadratic tetrahedra is treated as the four triangles between its
nodes.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from isoparticles._native import distances_to
from numpy.typing import NDArray

from tetmesh_check.checks import SHAPE, Check, Limits, check, counted
from tetmesh_check.errors import StageError
from tetmesh_check.export.mesh import MarkedMesh
from tetmesh_check.numerals import plain
from tetmesh_check.parts.model import Parts, SplitInterface
from tetmesh_check.push import NOISE, SHARP, Followers, normal_system, normals_of, solve_in_turn
from tetmesh_check.quality import Cells, Labels, Points, TetrahedronQuality, Values, centres_of, tetrahedron_quality
from tetmesh_check.surface import Surface

TOLERANCE = 0.01
"""Maximum difference between the distance of the sides and the width of the gap, relative to it."""
_OBLIQUE = 0.25
"""Like :data:`.NOISE`, for the normals of the surfaces on which a node slides: sin^2(30 degrees).
At a smaller angle to the interface, sliding would move the node by more than the gap."""
_FINE = 1e-3
"""Like :data:`.NOISE`, for corrections: sin^2(1.8 degrees). They are small, so a node may slide: by
0.16 gaps, if a triangle at this angle to its neighbours is 1 % too close (0.005 / sin 1.8). On the
steeper waves of ``test_gap.py``, errors after 40 rounds are 0.9 to 2.9 % with :data:`.NOISE`, 0.1
to 1.0 % with 1e-3, and 0.1 to 1.1 % with 1e-4."""
_ROUNDS = 40
"""Maximum number of corrections. They end when the maximum error is below :data:`TOLERANCE`. The
wavy plates of ``test_gap.py`` need 2 to 12."""


_QUARTERS = ((0, 3, 5), (3, 1, 4), (5, 4, 2), (3, 4, 5))
"""Nodes of the triangles between the nodes of a quadratic triangle."""
_EDGES = ((0, 1), (1, 2), (0, 2), (0, 3), (1, 3), (2, 3))
"""Corners beside the nodes 4 to 9 of a quadratic tetrahedron."""


class _Side(NamedTuple):
    """One side of a gap."""

    faces: Labels
    """Its triangles, as indices of the boundary."""
    triangles: Cells
    """Their corners, outward from its material."""
    nodes: Labels
    tapers: NDArray[np.bool_]
    """Whether each node belongs to a triangle with a shared node, where the gap closes."""
    local: Cells
    """The corners of the triangles as indices of ``nodes``."""
    is_firm: NDArray[np.bool_]
    """Whether the distance of each node is checked: not on the rim, next to a shared node or on a
    sharp bend."""
    is_inner: NDArray[np.bool_]
    """Whether the distance of the centre of each triangle is checked: it has no corner on the rim
    or next to a shared node."""


_Pair = tuple[_Side, _Side]


class Opened(NamedTuple):
    """A mesh with gaps."""

    points: Points
    quality: TetrahedronQuality
    results: list[dict[str, Any]]
    """Measures of each split interface, for the report."""
    checks: list[Check]


def refuse_wide(parts: Parts, surface: Surface) -> None:
    """Refuse a gap that is wider than a material can give way, before the surface is filled."""
    for interface in parts.splits:
        if not interface.split.width:
            continue
        on = np.isin(parts.marks, interface.first + interface.second)
        for numbers in (interface.first, interface.second):
            row = next(row for row in parts.rows if row.number in numbers)
            assert surface.sides is not None, "there are several materials"
            rest = ~on & ((surface.sides.inside == row.inside) | (surface.sides.outside == row.inside))
            if not rest.any():
                continue
            positions = _nodes_and_centres(surface.points, np.unique(surface.triangles[on]), surface.triangles[on])
            away = distances_to(positions, surface.points, surface.triangles[rest])
            if 0.5 * interface.split.width >= (thickest := float(away.max())):
                raise StageError(
                    f"{interface.split.text}: each side moves by {0.5 * interface.split.width:g} mm, but "
                    f"{parts.names[row.inside]} is at most {thickest:.3g} mm thick there",
                    "the moved side would cross the material",
                    f"choose a width well below {2.0 * thickest:.3g} mm",
                )


def open_gaps(mesh: MarkedMesh, parts: Parts, quality: TetrahedronQuality, limits: Limits) -> Opened:
    """Open the gaps of a split mesh.

    Parameters
    ----------
    mesh
        Linear tetrahedra, with split interfaces.
    parts
        The parts.
    quality
        The shapes of the tetrahedra.
    limits
        The limits of shape. A gap makes no tetrahedron miss them.

    Raises
    ------
    StageError
        If a tetrahedron does not fit into the material beside the gap.
    """
    points, results, checks = _opened(mesh, parts)
    if gaps := [interface for interface in parts.splits if interface.split.width]:
        before, quality = quality, tetrahedron_quality(points, mesh.tetrahedra)
        _refuse_poor(mesh, gaps, before, quality, limits)
    return Opened(points, quality, results, checks)


def open_curved_gaps(mesh: MarkedMesh, parts: Parts) -> tuple[Points, list[dict[str, Any]], list[Check]]:
    """Open the gaps of a split mesh of quadratic tetrahedra; return nodes, measures and checks.

    Other mid-edge nodes move by the mean of the ends of their edge.

    Parameters
    ----------
    mesh
        Quadratic tetrahedra, with split interfaces.
    parts
        The parts.
    """
    owners, before, marks = (np.repeat(values, 4) for values in (mesh.owners, mesh.before, mesh.marks))
    quarters = mesh.faces[:, _QUARTERS].reshape(-1, 3)
    flat = replace(mesh, elements=mesh.tetrahedra, faces=quarters, owners=owners, before=before, marks=marks)
    points, results, checks = _opened(flat, parts)
    moving = [number for own in parts.splits if own.split.width for number in own.first + own.second]
    on_side = np.unique(mesh.faces[np.isin(mesh.marks, moving)])
    shift, middles = points - mesh.points, mesh.elements[:, 4:]
    is_free = ~np.isin(middles, on_side)
    shift[middles[is_free]] = shift[mesh.elements[:, _EDGES][is_free]].mean(axis=1)
    return mesh.points + shift, results, checks


def _opened(mesh: MarkedMesh, parts: Parts) -> tuple[Points, list[dict[str, Any]], list[Check]]:
    """Return the positions of the nodes with open gaps, measures and checks."""
    sides = [_sides(mesh, interface) for interface in parts.splits]
    pairs = [(own.split.width, pair) for own, pair in zip(parts.splits, sides, strict=True) if own.split.width]
    points = _moved(mesh, pairs) if pairs else mesh.points
    results, checks = [], []
    for interface, pair in zip(parts.splits, sides, strict=True):
        found = _describe(mesh, interface, pair, points)
        if found.get("distance_mm"):
            low, high = found["distance_mm"]
            off = 100.0 * max(high / interface.split.width - 1.0, 1.0 - low / interface.split.width)
            told = f"{low:.4g} to {high:.4g} mm"
            checks.append(
                check("gap_width", off, 100.0 * TOLERANCE, gap=interface.split.text, told=told, off=plain(off))
            )
        results.append(found)
    return points, results, checks


def _describe(mesh: MarkedMesh, interface: SplitInterface, pair: _Pair, points: Points) -> dict[str, Any]:
    """Return the measures of a split interface for the report."""
    one, other = pair
    shared = np.intersect1d(one.nodes, other.nodes)
    found: dict[str, Any] = {
        "interface": interface.name,
        "sides": [[mesh.parts[mark] for mark in marks] for marks in (interface.first, interface.second)],
        "triangles": len(one.triangles),
        "doubled_nodes": len(one.nodes) - len(shared),
        "shared_nodes_mm": mesh.shown[shared].tolist(),
    }
    if interface.split.width:
        firm, loose = [], []
        for side, to in ((one, other), (other, one)):
            at_nodes, at_centres = _distances(points, side, to)
            for is_checked, values in ((side.is_firm, at_nodes), (side.is_inner, at_centres)):
                firm.append(values[is_checked])
                loose.append(values[~is_checked])
        found["width_mm"] = interface.split.width
        for key, parts in (("distance_mm", firm), ("distance_at_rims_and_bends_mm", loose)):
            joined = np.concatenate(parts)
            found[key] = [float(joined.min()), float(joined.max())] if len(joined) else None
    return found


def _sides(mesh: MarkedMesh, interface: SplitInterface) -> _Pair:
    """Return the two sides of a split interface, before they move."""
    own = [np.flatnonzero(np.isin(mesh.marks, numbers)) for numbers in (interface.first, interface.second)]
    at_rim = np.unique(np.delete(mesh.boundary, np.concatenate(own), axis=0))
    shared = np.intersect1d(mesh.boundary[own[0]], mesh.boundary[own[1]])
    found = []
    for faces in own:
        corners = mesh.boundary[faces]
        nodes = np.unique(corners)
        normals, angles = normals_of(mesh.points, corners)
        local = np.searchsorted(nodes, corners)
        mean = np.zeros((len(nodes), 3))
        np.add.at(mean, local, angles[:, :, None] * normals[:, None, :])
        mean /= np.maximum(np.linalg.norm(mean, axis=1, keepdims=True), 1e-300)
        cosine = np.ones(len(nodes))
        np.minimum.at(cosine, local, np.einsum("mij,mj->mi", mean[local], normals))
        tapers = np.isin(nodes, corners[np.isin(corners, shared).any(axis=1)])
        is_inner = ~(tapers | np.isin(nodes, at_rim))
        is_firm, is_whole = is_inner & (cosine > SHARP), np.asarray(is_inner[local].all(axis=1))
        found.append(_Side(faces, corners, nodes, tapers, local, is_firm, is_whole))
    return found[0], found[1]


def _nodes_and_centres(points: Points, nodes: Labels, triangles: Cells) -> Points:
    """Return the positions of nodes, then those of the centres of triangles."""
    return np.concatenate([points[nodes], centres_of(points, triangles)])


def _distances(points: Points, side: _Side, other: _Side) -> tuple[Values, Values]:
    """Return the distances of the nodes and of the centres of a side from the other side."""
    found = distances_to(_nodes_and_centres(points, side.nodes, side.triangles), points, other.triangles)
    return found[: len(side.nodes)], found[len(side.nodes) :]


def _vectors(mesh: MarkedMesh, nodes: Labels, is_side: NDArray[np.bool_], heights: Values, least: float) -> Points:
    """Return the vectors by which nodes move if each triangle of a side moves by its height."""
    sides, others = (normal_system(mesh.points, mesh.boundary[own], nodes, heights[own]) for own in (is_side, ~is_side))
    return solve_in_turn(sides, others, (least, _OBLIQUE))


def _moved(mesh: MarkedMesh, pairs: list[tuple[float, _Pair]]) -> Points:
    """Return the positions with open gaps: those with the smallest maximum error."""
    nodes = np.unique(np.concatenate([side.nodes for _, sides in pairs for side in sides]))
    is_side, heights = np.zeros(len(mesh.marks), dtype=bool), np.zeros(len(mesh.marks))
    stays, tapers = np.zeros((2, len(nodes), 1), dtype=bool)
    for width, sides in pairs:
        stays[np.searchsorted(nodes, np.intersect1d(sides[0].nodes, sides[1].nodes))] = True
        for side in sides:
            is_side[side.faces], heights[side.faces] = True, -0.5 * width
            tapers[np.searchsorted(nodes, side.nodes[side.tapers])] = True
    vectors = np.where(stays, 0.0, _vectors(mesh, nodes, is_side, heights, NOISE))
    points, best, least = mesh.points.copy(), mesh.points[nodes], np.inf
    for _ in range(_ROUNDS):
        points[nodes] = mesh.points[nodes] + vectors
        worst = 0.0
        for width, (one, other) in pairs:
            for side, to in ((one, other), (other, one)):
                at_nodes, at_centres = _distances(points, side, to)
                checked = np.concatenate([at_nodes[side.is_firm], at_centres[side.is_inner]])
                worst = max(worst, float(np.abs(checked / width - 1.0).max(initial=0.0)))
                heights[side.faces] = 0.5 * (at_centres - width)
        if worst < least:
            best, least = points[nodes], worst
        if worst < TOLERANCE:
            break
        vectors += np.where(tapers, 0.0, _vectors(mesh, nodes, is_side, heights, _FINE))
    points[nodes] = best
    return Followers(mesh.points, mesh.tetrahedra, nodes, np.unique(mesh.boundary)).follow(points)


def _refuse_poor(
    mesh: MarkedMesh,
    gaps: list[SplitInterface],
    before: TetrahedronQuality,
    after: TetrahedronQuality,
    limits: Limits,
) -> None:
    """Refuse gaps that leave a tetrahedron inverted, or below a limit that it met."""
    for measure, (name, what, unit) in SHAPE.items():
        old, new, limit = getattr(before, measure), getattr(after, measure), getattr(limits, name)
        is_inverted = (after.volume <= 0.0) & (before.volume > 0.0)
        is_poor = is_inverted if is_inverted.any() else (new < limit) & (old >= limit)
        if not is_poor.any():
            continue
        # dihedral angles do not show an inversion, volumes do
        worst = int(np.where(is_poor, after.volume if is_inverted.any() else new, np.inf).argmin())
        x, y, z = mesh.shown[mesh.tetrahedra[worst]].mean(axis=0)
        region = next((row["name"] for row in mesh.table if row["region"] == mesh.regions[worst]), "a region")
        change = (
            f"{counted(int(is_inverted.sum()), 'tetrahedron is', 'tetrahedra are')} inverted"
            if is_inverted.any()
            else f"the {what} of a tetrahedron falls from {old[worst]:.3g} to {new[worst]:.3g}{unit} (limit {limit:g})"
        )
        raise StageError(
            f"{' '.join(gap.split.text for gap in gaps)}: {region} has too little room at ({x:.6g}, {y:.6g}, {z:.6g}) "
            f"mm: {change}",
            "half of the gap does not fit into the material or its elements",
            "choose a narrower gap, larger elements, or a lower limit (--min-dihedral, --min-scaled-jacobian)",
        )
