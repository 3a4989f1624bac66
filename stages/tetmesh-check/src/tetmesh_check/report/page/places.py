"""The lists of places on the page.

They are those in the reports of all stages: tetrahedra and triangles below a limit, and parts
of the volume that a stage changed.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

from tetmesh_check.report.page.case import STAGES, Case, dig
from tetmesh_check.report.page.payload import world_letters

SHOWN = 10
"""Rows of a table that are visible at once."""
LISTED = 200
"""Maximum number of rows of a table; the JSON report has the rest."""
_EVENTS = {
    "broken": "broken into pieces",
    "gone": "part removed",
    "joined": "parts joined",
    "shortened": "thin end removed",
    "filled": "narrow gap filled",
}
"""Effects of the scale on a part, by the names in the report of ``distfield``."""

Entry = dict[str, Any]


@dataclass(frozen=True)
class PlaceList:
    """One list of places in a report."""

    title: str
    """Heading above the table."""
    stage: str
    """Stage whose report has the list."""
    find: Callable[[Any], list[Entry]]
    """Takes the entries from the results of the stage."""
    columns: tuple[tuple[str, str], ...]
    """Key of an entry and heading of its column, beside the place."""
    words: str
    """A sentence below the title."""


def _at(*keys: str) -> Callable[[Any], list[Entry]]:
    return lambda results: dig(results, *keys) or []


def _scale_events(results: Any) -> list[Entry]:
    """Events of all materials, or of the one object, with the name of the material."""
    owners = [("object", dig(results, "meta", "scale_changes"))]
    owners += [(entry["name"], entry.get("scale_changes")) for entry in dig(results, "materials") or []]
    return [
        {**event, "material": name, "kind": _EVENTS.get(event["kind"], event["kind"])}
        for name, changes in owners
        for event in dig(changes, "events") or []
    ]


_MEASURED = (("min_dihedral", "minimum dihedral angle, degrees"), ("min_scaled_jacobian", "scaled Jacobian"))
LISTS = (
    PlaceList(
        "Tetrahedra below a limit of shape",
        STAGES[-1],
        _at("volume", "poor_tetrahedra"),
        _MEASURED,
        "The flattest come first. A place is the centroid of the tetrahedron.",
    ),
    PlaceList(
        "Dihedral angles limited by the surface",
        STAGES[-1],
        _at("volume", "forced_by_surface"),
        (("material", "material"), ("possible_degrees", "possible angle, degrees"), *_MEASURED),
        "No tetrahedron on these triangles can reach the limit of the dihedral angle. Other triangles meet them at a "
        "smaller angle or lie close in front of them, for example where a thin layer ends.",
    ),
    PlaceList(
        "Scaled Jacobians limited by the surface",
        STAGES[-1],
        _at("volume", "forced_by_triangle"),
        (("material", "material"), ("possible_scaled_jacobian", "possible scaled Jacobian"), *_MEASURED),
        "These triangles have a small angle. No tetrahedron on them can reach both the limit of the dihedral angle "
        "and that of the scaled Jacobian.",
    ),
    PlaceList(
        "Triangles limited by junction curves",
        "reconstruct",
        _at("check", "poor_between_curves"),
        (("radius_ratio", "radius ratio"),),
        "Junction curves meet here at a small angle or bend within one edge length, so these triangles cannot reach "
        "the limit of the radius ratio.",
    ),
    PlaceList(
        "Components too small for their edge length",
        "sizefield",
        _at("fields", "too_small"),
        (("size", "extent, mm"), ("h", "edge length h, mm")),
        "Each of these components needed more particles than h allows, and got them.",
    ),
    PlaceList(
        "Voxels of overlapping materials",
        "distfield",
        _at("overlaps"),
        (("kept", "kept by"), ("lost", "lost by"), ("voxels", "voxels")),
        "These voxels were in two segments or masks.",
    ),
    PlaceList(
        "Small islands given to the materials around them",
        "distfield",
        _at("islands"),
        (("name", "material"), ("count", "islands"), ("voxels", "voxels"), ("largest", "largest, voxels")),
        "A place is the largest island of the material.",
    ),
    PlaceList(
        "Changes made by the scale",
        "distfield",
        _scale_events,
        (("material", "material"), ("kind", "change"), ("volume", "volume, mm\u00b3")),
        "At most 20 changes of each kind are listed, the largest first.",
    ),
)
"""All lists, in the order of the page."""


def place_of(entry: Entry, anatomical: bool) -> str:
    """Write a place, mm, with the letters that the 3-D view uses; nothing where an entry has none.

    Parameters
    ----------
    entry
        One of a list; its place is under ``place_mm`` or ``place``.
    anatomical
        Whether the world is that of the body.
    """
    place = entry.get("place_mm") or entry.get("place")
    if place is None:
        return ""
    written = []
    for (positive, negative), name, value in zip(world_letters(True), "xyz", place, strict=True):
        if anatomical:
            written.append(f"{negative if value < 0 else positive}\u00a0{abs(value):.2f}")
        else:
            written.append(f"{name}\u00a0{value:.2f}")
    return ",\u00a0".join(written)


def found_in(case: Case) -> Iterator[tuple[PlaceList, list[Entry]]]:
    """Give the lists of places that the reports of a case hold, without the empty ones.

    Parameters
    ----------
    case
        The case.
    """
    for listed in LISTS:
        entries = listed.find(dig(case.reports, listed.stage, "results"))
        if entries:
            yield listed, entries
