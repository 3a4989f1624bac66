"""A surface of many materials as a complex: refused where it bounds no volumes, and counted anew whatever its maker says of it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tetmesh_check.errors import StageError
from tetmesh_check.intersections import self_intersections
from tetmesh_check.materials import NOTHING, Sides
from tetmesh_check.quality import Cells, Labels, Points, TriangleQuality, Values, summarize_all, triangle_quality
from tetmesh_check.shells import Edges, Shells, edges_of, measure_shells, unbalanced_edges
from tetmesh_check.surface import Surface
from tetmesh_check.topology import connected_components, measure_topology, members_of

FLAT = 1e-12
"""Area of a triangle over the mean, up to which it has none."""
_ADVICE = "use a surface from reconstruct, or repair this surface first"


@dataclass(frozen=True)
class Complex:
    """A checked surface of many materials."""

    surface: Surface
    """Every vertex is in use."""
    sides: Sides
    edges: Edges
    shells: Shells
    quality: TriangleQuality
    """Of its triangles."""


def _place(points: Points, corners: Cells) -> str:
    x, y, z = points[corners].reshape(-1, 3).mean(axis=0)
    return f"({x:.6g}, {y:.6g}, {z:.6g}) mm"


def _compact(surface: Surface) -> Surface:
    used, local = np.unique(surface.triangles, return_inverse=True)
    if len(used) == len(surface.points):
        return surface
    return Surface(
        surface.points[used],
        local.reshape(-1, 3).astype(np.int64),
        surface.history,
        surface.merged_points,
        surface.cap,
        surface.sides,
    )


def _refuse_bad_triangles(path: Path, surface: Surface, quality: TriangleQuality) -> None:
    points, triangles = surface.points, surface.triangles
    flat = np.flatnonzero(quality.area <= FLAT * quality.area.mean())
    if len(flat):
        raise StageError(
            f"{path}: {len(flat)} triangles have no area, the first near {_place(points, triangles[flat[0]])}",
            "no tetrahedron with a positive volume can have such a face",
            _ADVICE,
        )
    _, first, uses = np.unique(np.sort(triangles, axis=1), axis=0, return_index=True, return_counts=True)
    if (uses > 1).any():
        twice = int(first[uses > 1][0])
        raise StageError(
            f"{path}: {int((uses > 1).sum())} triangles occur more than once, the first near "
            f"{_place(points, triangles[twice])}",
            "the space between two equal triangles is empty",
            _ADVICE,
        )


def check_complex(path: Path, surface: Surface) -> Complex:
    """Refuse a surface of many materials that bounds no volumes.

    Parameters
    ----------
    path
        Its file, for the messages.
    surface
        The surface as read, with its ``sides``.

    Raises
    ------
    StageError
        If it has triangles without area or twice, is not closed for each material, has triangles on the wrong side, or cuts through itself.
    """
    assert surface.sides is not None, "the caller looked"
    sides = surface.sides
    surface = _compact(surface)
    points, triangles = surface.points, surface.triangles
    quality = triangle_quality(points, triangles)
    _refuse_bad_triangles(path, surface, quality)
    edges = edges_of(len(points), triangles)
    wrong = unbalanced_edges(edges, sides)
    if wrong:
        words = ", ".join(f"{sides.names[number]} {count}" for number, count in wrong.items())
        raise StageError(
            f"{path}: the surfaces of {len(wrong)} materials are open or inconsistently oriented; number of such "
            f"edges: {words}",
            "such a material has no inside, so there is no volume to fill",
            _ADVICE,
        )
    crossing = self_intersections(points, triangles)
    if len(crossing):
        raise StageError(
            f"{path}: intersects itself: {len(np.unique(crossing))} triangles in {len(crossing)} pairs, the first near "
            f"{_place(points, triangles[crossing[0, 0]])}",
            "points there would belong to two materials",
            _ADVICE,
        )
    shells = measure_shells(points, triangles, sides, edges)
    if shells.mixed or shells.inside_out or (shells.of_inside < 0).any():
        raise StageError(
            f"{path}: is inside out: {shells.mixed} wedges between neighbouring triangles lie in two materials, "
            f"{shells.inside_out} closed surfaces enclose nothing",
            "each triangle must be counter-clockwise as seen from the material of the lower number",
            "reverse the winding of these triangles; " + _ADVICE,
        )
    return Complex(surface, sides, edges, shells, quality)


def _turns(surface: Surface, edges: Edges, which: Labels) -> tuple[Values, Labels]:
    """Angle between the normals of the two triangles on each edge within one sheet, degrees, and the pair of materials there."""
    both = np.flatnonzero(edges.uses == 2)
    order = np.argsort(edges.of, kind="stable")
    first = np.cumsum(edges.uses)[both] - 2
    one, other = order[first] // 3, order[first + 1] // 3
    a, b, c = (surface.points[surface.triangles[:, k]] for k in range(3))
    normals = np.cross(b - a, c - a)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    sine = np.linalg.norm(np.cross(normals[one], normals[other]), axis=1)
    cosine = np.einsum("ij,ij->i", normals[one], normals[other])
    turns: Values = np.degrees(np.arctan2(sine, cosine))
    same = which[one] == which[other]
    return turns[same], which[one][same]


def _rms(values: Values) -> float | None:
    return float(np.sqrt((values**2).mean())) if len(values) else None


def _pieces(edges: Edges, which: Labels, triangles: int) -> Labels:
    """Connected piece of a sheet that each triangle belongs to; pieces hang together through edges with two triangles."""
    order = np.argsort(edges.of, kind="stable")
    both = edges.uses == 2
    first = (np.cumsum(edges.uses) - edges.uses)[both]
    links = np.stack([order[first] // 3, order[first + 1] // 3], 1)
    links = links[which[links[:, 0]] == which[links[:, 1]]]
    return connected_components(triangles, links)


def _junctions(edges: Edges, sides: Sides, vertices: int, triangles: Cells) -> dict[str, Any]:
    """Count what lies on more than one sheet."""
    junction = edges.uses != 2
    ends = np.bincount(np.concatenate([edges.low[junction], edges.high[junction]]), minlength=vertices)
    corner = triangles.ravel()
    count = len(sides.table)
    pairs = np.unique(np.concatenate([corner * count + np.repeat(side, 3) for side in (sides.inside, sides.outside)]))
    met = np.bincount(pairs // count, minlength=vertices)
    number, of = np.unique(met, return_counts=True)
    uses, edges_with = np.unique(edges.uses, return_counts=True)
    return {
        "junction_edges": int(junction.sum()),
        "junction_vertices": int(((ends != 0) & (ends != 2)).sum()),
        "edges_by_triangles": dict(zip(map(str, uses.tolist()), edges_with.tolist(), strict=True)),
        "vertices_by_materials": dict(zip(map(str, number.tolist()), of.tolist(), strict=True)),
    }


def _materials(checked: Complex) -> list[dict[str, Any]]:
    """Each material's own closed surface."""
    surface, sides, shells = checked.surface, checked.sides, checked.shells
    listed = []
    count = len(sides.table)
    behind_of, before_of = members_of(sides.inside, count), members_of(sides.outside, count)
    for number in [NOTHING, *sides.present]:
        behind, before = behind_of[number], before_of[number]
        facets = np.concatenate([surface.triangles[behind], surface.triangles[before][:, [0, 2, 1]]])
        if not len(facets):
            continue
        used, local = np.unique(facets, return_inverse=True)
        topology = measure_topology(surface.points[used], local.reshape(-1, 3).astype(np.int64))
        own = shells.materials == number
        listed.append(
            {
                "number": number,
                "name": sides.names[number],
                "volume_mm3": float(shells.sizes[own].sum()) if number != NOTHING else None,
                "components": int(own.sum()) if number != NOTHING else None,
                "area_mm2": float(checked.quality.area[np.concatenate([behind, before])].sum()),
                "smallest_wedge_degrees": shells.narrowest.get(number),
                "topology": topology.as_dict(),
            }
        )
    return listed


def describe_complex(checked: Complex) -> dict[str, Any]:
    """Count and measure a complex for the report.

    Parameters
    ----------
    checked
        The complex.

    Returns
    -------
    dict
        ``vertices, triangles, area_mm2``; ``junction_edges`` (edges with other than two triangles), ``junction_vertices`` (where
        junction edges end, or more than two of them meet), ``edges_by_triangles``, ``vertices_by_materials``; ``quality`` of all triangles;
        ``rms_turn_degrees`` between the normals of neighbouring triangles of one sheet; ``materials``, each with volume, parts, the
        smallest angle between two of its facets and the topology of its own closed surface; ``interfaces``, each pair with area,
        connected pieces, quality and turn.
    """
    surface, sides, edges = checked.surface, checked.sides, checked.edges
    pairs, which = sides.pairs()
    turns, pair_of_turn = _turns(surface, edges, which)
    pieces = _pieces(edges, which, len(surface.triangles))
    interfaces = []
    triangles_of, turns_of = members_of(which, len(pairs)), members_of(pair_of_turn, len(pairs))
    for k, (inside, outside) in enumerate(pairs.tolist()):
        own = triangles_of[k]
        part = TriangleQuality(
            **{name: getattr(checked.quality, name)[own] for name in TriangleQuality.__dataclass_fields__}
        )
        interfaces.append(
            {
                "inside": inside,
                "outside": outside,
                "name": sides.pair_name((inside, outside)),
                "triangles": len(own),
                "area_mm2": float(part.area.sum()),
                "pieces": len(np.unique(pieces[own])),
                "rms_turn_degrees": _rms(turns[turns_of[k]]),
                "quality": summarize_all(part),
            }
        )
    return {
        "vertices": len(surface.points),
        "triangles": len(surface.triangles),
        "merged_points": surface.merged_points,
        "area_mm2": float(checked.quality.area.sum()),
        "bounding_box_diagonal_mm": surface.bounding_box_diagonal,
        **_junctions(edges, sides, len(surface.points), surface.triangles),
        "quality": summarize_all(checked.quality),
        "rms_turn_degrees": _rms(turns),
        "materials": _materials(checked),
        "interfaces": interfaces,
    }
