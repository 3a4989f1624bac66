"""The key of a label map: what its labels are called, and their colours on the page."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pyvista as pv

from tetmesh_check.materials import INSIDE
from tetmesh_check.report.colours import PALETTE, distinct, material_colours, materials_of
from tetmesh_check.report.page.case import Case, dig
from tetmesh_check.report.page.scan import Scan

Colour = tuple[int, int, int]
_MUTED = 3
"""Labels that were not meshed keep this fraction of their colour's difference from dark grey:
1/3."""
_GREY = 48


@dataclass(frozen=True)
class Entry:
    """A material, or a label that was not meshed as part of one."""

    name: str
    colour: Colour
    labels: tuple[int, ...] = ()
    """Labels of the first layer."""
    meshed: bool = True


def _labels(entries: Any) -> tuple[int, ...]:
    """Return the labels of the first layer in a list of labels of a report."""
    found = [entry if isinstance(entry, dict) else {"label": entry, "layer": 0} for entry in entries or []]
    return tuple(int(entry["label"]) for entry in found if entry["layer"] == 0)


def key_of(case: Case, scan: Scan | None, surface: pv.PolyData | None) -> list[Entry]:
    """Return the materials by number, then other labels; empty for a scan.

    Parameters
    ----------
    case
        The case.
    scan
        The volume, if it could be read.
    surface
        The surface, if there is one.
    """
    if surface is not None and INSIDE in surface.cell_data:
        table, colours = materials_of(surface)
    else:
        table = dig(case.reports, "distfield", "parameters", "materials") or []
        colours = material_colours(len(table))
    rows = zip(table, colours.tolist(), strict=True)
    entries = [Entry(str(row["name"]), tuple(colour), _labels(row.get("labels"))) for row, colour in rows][1:]
    if scan is None or not scan.labels:
        return entries
    known = {0, *(label for entry in entries for label in entry.labels)}
    meshed = set(_labels(dig(case.reports, "distfield", "parameters", "labels")))
    other = [int(label) for label in np.unique(scan.values).tolist() if label not in known]
    bright = [not entries and (not meshed or label in meshed) for label in other]
    shades = [PALETTE[place % len(PALETTE)] for place in range(len(other))]
    shades = [shade if own else _muted(shade) for shade, own in zip(shades, bright, strict=True)]
    used = [f"#{bytes(entry.colour).hex()}" for entry in entries]
    for label, colour, own in zip(other, distinct([*used, *shades]).tolist()[len(used) :], bright, strict=True):
        entries.append(Entry(scan.names.get(label, f"label {label}"), tuple(colour), (label,), own))
    return entries


def _muted(shade: str) -> str:
    return "#" + bytes(_GREY + (part - _GREY) // _MUTED for part in bytes.fromhex(shade[1:])).hex()
