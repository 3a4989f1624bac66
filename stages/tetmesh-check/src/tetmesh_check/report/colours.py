"""Colours of materials and labels: the same in slices, pictures and tables."""

from __future__ import annotations

import json
from collections import Counter
from dataclasses import dataclass
from itertools import cycle
from typing import Any

import numpy as np
import pyvista as pv
from numpy.typing import ArrayLike, NDArray

from tetmesh_check.datasets import text_of
from tetmesh_check.materials import INSIDE, OUTSIDE
from tetmesh_check.report.page.case import Case, dig
from tetmesh_check.report.page.scan import Scan

PALETTE = [
    "#e69f00", "#56b4e9", "#009e73", "#f0e442", "#0072b2", "#d55e00", "#cc79a7", "#8700f0", "#b4e196", "#695a2d",
    "#9678ff", "#ff005a", "#3cf0d2", "#963c78", "#5a4bc3", "#c3a54b", "#ff7896", "#96e1ff", "#a50096", "#7896f0",
]  # fmt: skip
"""Okabe and Ito's seven colours (2008), and 13 more, each as far as possible from those before.

The distance of two colours is the minimum of their CIELAB distances for normal vision, protanopia,
deuteranopia and tritanopia (Machado et al. 2009). The minimum distance is 16.0 among the first
seven colours and 13.9 among all (``tests/test_colours.py``)."""
_MUTED = 3
"""For labels that were not meshed, the difference between their colour and dark grey is divided by
this number."""
_GREY = 48


def material_colours(count: int, sides: ArrayLike = ()) -> NDArray[np.uint8]:
    """Return the colours of materials by number, bytes, shape ``(count, 3)``.

    All colours differ. If there are more materials than colours in :data:`PALETTE`, colours repeat
    with changes that are not visible. Materials that touch get different colours if possible.

    Parameters
    ----------
    count
        Number of materials, including the outside.
    sides
        Pairs of materials that touch, shape ``(m, 2)``.
    """
    touching: list[set[int]] = [set() for _ in range(count)]
    for a, b in np.unique(np.reshape(sides, (-1, 2)).astype(np.int64), axis=0).tolist():
        touching[a].add(b)
        touching[b].add(a)
    size = len(PALETTE)
    chosen: dict[int, int] = {}
    for number in range(1, count):
        uses = Counter(chosen[other] for other in touching[number] if other in chosen)
        order = [(number - 1 + step) % size for step in range(size)]
        chosen[number] = min(order, key=lambda place: uses[place])
    return distinct(["#000000", *(PALETTE[place] for place in chosen.values())][:count])


def materials_of(surface: pv.PolyData) -> tuple[list[dict[str, Any]], NDArray[np.uint8]]:
    """Return the table of materials by number, the outside first, and their colours.

    Parameters
    ----------
    surface
        A surface of many materials as read.
    """
    table = json.loads(text_of(surface, "meta") or "{}").get("materials") or []
    sides = np.column_stack([surface.cell_data[INSIDE], surface.cell_data[OUTSIDE]])
    return table, material_colours(len(table), sides)


def distinct(colours: list[str]) -> NDArray[np.uint8]:
    """Return colours as bytes, shape ``(n, 3)``, changed slightly where they repeat.

    Parameters
    ----------
    colours
        Hexadecimal, as in :data:`PALETTE`.
    """
    found: dict[int, None] = {}
    uses: Counter[int] = Counter()
    for colour in colours:
        first = number = int(colour[1:], 16)
        while number in found:
            uses[first] += 1
            # the bits of the count go to the lowest bits of red, green and blue in turn
            number = first ^ sum(((uses[first] >> bit) & 1) << (8 * (bit % 3) + bit // 3) for bit in range(24))
        found[number] = None
    return np.array(list(found), dtype=">u4").view(np.uint8).reshape(-1, 4)[:, 1:]


@dataclass(frozen=True)
class Entry:
    """A material, or a label that was not meshed as part of one."""

    name: str
    colour: tuple[int, int, int]
    labels: tuple[int, ...] = ()
    """Labels of the first layer."""
    meshed: bool = True


def _labels(entries: Any) -> tuple[int, ...]:
    """Return the labels of the first layer in a list of labels of a report."""
    found = [entry if isinstance(entry, dict) else {"label": entry, "layer": 0} for entry in entries or []]
    return tuple(int(entry["label"]) for entry in found if entry["layer"] == 0)


def key_of(case: Case, scan: Scan | None, surface: pv.PolyData | None) -> list[Entry]:
    """Return the materials by number, then the other labels; empty for a scan.

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
    shades = [shade if own else _muted(shade) for shade, own in zip(cycle(PALETTE), bright, strict=False)]
    used = [f"#{bytes(entry.colour).hex()}" for entry in entries]
    for label, colour, own in zip(other, distinct([*used, *shades]).tolist()[len(used) :], bright, strict=True):
        entries.append(Entry(scan.names.get(label, f"label {label}"), tuple(colour), (label,), own))
    return entries


def _muted(shade: str) -> str:
    return "#" + bytes(_GREY + (part - _GREY) // _MUTED for part in bytes.fromhex(shade[1:])).hex()
