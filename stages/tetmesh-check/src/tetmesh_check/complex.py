"""Checks and measures of a surface of many materials."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from isoparticles import _native

from tetmesh_check.errors import refuse_file
from tetmesh_check.materials import NOTHING
from tetmesh_check.quality import summarize_all, triangle_quality
from tetmesh_check.surface import TOOLS, Surface, place_of
from tetmesh_check.topology import Shells, members_of


def check_complex(path: Path, surface: Surface) -> Shells:
    """Refuse a surface of many materials that bounds no volumes.

    Parameters
    ----------
    path
        Its file, for the messages.
    surface
        The surface as read, with its ``sides``.

    Returns
    -------
    Shells
        Its volumes.

    Raises
    ------
    StageError
        If it has triangles without area or twice, is not closed for each material, has triangles on
        the wrong side, or cuts through itself.
    """
    assert surface.sides is not None, "the caller looked"
    refuse = partial(refuse_file, path, remedy=TOOLS)
    sides, points, triangles = surface.sides, surface.points, surface.triangles
    found = _native.check_complex(points, triangles, sides.inside, sides.outside, len(sides.table))
    flat, twice, wrong, crossing = found["flat"], found["duplicates"], found["open_edges"], found["crossing"]
    if len(flat):
        refuse(
            f"{len(flat)} triangles have no area, the first near {place_of(points, triangles[flat[0]])}",
            "no tetrahedron with a positive volume can have such a face",
        )
    if len(twice):
        refuse(
            f"{len(twice)} triangles occur more than once, the first near {place_of(points, triangles[twice[0]])}",
            "the space between two equal triangles is empty",
        )
    if wrong:
        words = ", ".join(f"{sides.names[number]} {count}" for number, count in wrong.items())
        refuse(
            f"the surfaces of {len(wrong)} materials are open or inconsistently oriented; number of such edges: "
            f"{words}",
            "such a material has no inside, so there is no volume to fill",
        )
    if found["shells"] is None:
        refuse(
            f"intersects itself: {len(np.unique(crossing))} triangles in {len(crossing)} pairs, the first near "
            f"{place_of(points, triangles[crossing[0, 0]])}",
            "points there would belong to two materials",
        )
    shells = Shells(**found["shells"])
    if shells.mixed or shells.inside_out or (shells.of_inside < 0).any():
        refuse(
            f"is inside out: {shells.mixed} wedges between neighbouring triangles lie in two materials, "
            f"{shells.inside_out} closed surfaces enclose nothing",
            "each triangle must be counter-clockwise as seen from the material of the lower number",
            remedy=f"reverse the winding of these triangles; {TOOLS}",
        )
    return shells


def describe_complex(surface: Surface, shells: Shells) -> dict[str, Any]:
    """Count and measure a surface of many materials for the report.

    Parameters
    ----------
    surface, shells
        The surface, and its volumes.

    Returns
    -------
    dict
        ``vertices, triangles, area_mm2``; ``junction_edges`` (edges with other than two triangles),
        ``junction_vertices`` (where junction edges end, or more than two of them meet),
        ``edges_by_triangles``, ``vertices_by_materials``; ``quality`` of all triangles;
        ``rms_turn_degrees`` between the normals of neighbouring triangles of one sheet;
        ``materials``, each with volume, parts, the smallest angle between two of its facets and the
        topology of its own closed surface; ``interfaces``, each pair with area, connected pieces,
        quality and turn.
    """
    assert surface.sides is not None, "the caller looked"
    sides, quality = surface.sides, triangle_quality(surface.points, surface.triangles)
    count = len(sides.table)
    found: dict[str, Any] = {
        **_native.describe_complex(surface.points, surface.triangles, sides.inside, sides.outside, count)
    }
    topologies, interfaces = found.pop("topologies"), found.pop("interfaces")
    areas = np.bincount(sides.inside, quality.area, count) + np.bincount(sides.outside, quality.area, count)
    volumes = np.bincount(shells.materials, shells.sizes, count)
    parts = np.bincount(shells.materials, minlength=count)
    pairs, which = sides.pairs()
    of_pairs = zip(pairs.tolist(), members_of(which, len(pairs)), interfaces, strict=True)
    return {
        "vertices": len(surface.points),
        "triangles": len(surface.triangles),
        "merged_points": surface.merged_points,
        "area_mm2": float(quality.area.sum()),
        "bounding_box_diagonal_mm": surface.bounding_box_diagonal,
        **found,
        "quality": summarize_all(quality),
        "materials": [
            {
                "number": number,
                "name": sides.names[number],
                "volume_mm3": None if number == NOTHING else float(volumes[number]),
                "components": None if number == NOTHING else int(parts[number]),
                "area_mm2": float(areas[number]),
                "smallest_wedge_degrees": None if number == NOTHING else float(shells.narrowest[number]),
                "topology": topology,
            }
            for number, topology in topologies.items()
        ],
        "interfaces": [
            {
                "inside": inside,
                "outside": outside,
                "name": sides.pair_name((inside, outside)),
                "triangles": len(own),
                "area_mm2": float(quality.area[own].sum()),
                "pieces": pieces,
                "rms_turn_degrees": turn,
                "quality": summarize_all(quality, own),
            }
            for (inside, outside), own, (pieces, turn) in of_pairs
        ],
    }
