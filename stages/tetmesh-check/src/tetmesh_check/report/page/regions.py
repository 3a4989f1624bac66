"""The parts of the page about regions: volumes, and of many materials what lies between them."""

from __future__ import annotations

from html import escape

from tetmesh_check.report.page.case import Case, dig
from tetmesh_check.report.page.charts import number
from tetmesh_check.report.page.html import section, table
from tetmesh_check.report.page.key import Entry, swatch
from tetmesh_check.volume_table import COLUMNS, with_changes

_MANY = 24
"""Rows that are shown at once; the rest is there to be opened."""


def _named(name: str, key: list[Entry]) -> str:
    """Write a name with its colour, or two names of an interface with theirs."""
    colours = {entry.name: entry.colour for entry in key}
    parts = [name] if name in colours else name.split("/")
    return " / ".join(swatch(part, colours.get(part)) for part in parts)


def _change(change: float) -> str:
    """A change in percent with two decimals, without a sign where it rounds to zero."""
    return "0 %" if abs(change) < 0.005 else f"{change:+.2f} %"


def _long_table(head: tuple[str, ...], rows: list[tuple[str, ...]], words: str) -> str:
    shown = table(head, rows[:_MANY], (0,))
    if len(rows) <= _MANY:
        return shown
    rest = table(head, rows[_MANY:], (0,))
    return f"{shown}<details><summary>{len(rows) - _MANY} more {words}</summary><div>{rest}</div></details>"


def _region_rows(case: Case, key: list[Entry]) -> list[tuple[str, ...]]:
    counted = case.results["complex"]["materials"]
    by_number = {entry["number"]: entry for entry in dig(case.results, "volume", "regions") or []}
    rows: list[tuple[str, ...]] = []
    for material in sorted(counted, key=lambda entry: -(entry["volume_mm3"] or 0.0)):
        if material["volume_mm3"] is None:  # the outside
            continue
        region = by_number.get(material["number"], {})
        quality = region.get("quality")
        shape: tuple[str, ...] = ("-",) * 4
        if quality is not None:
            shape = (
                number(quality["min_dihedral"]["min"]),
                number(quality["max_dihedral"]["max"]),
                number(quality["radius_ratio"]["min"]),
                number(quality["radius_ratio"]["mean"]),
            )
        rows.append(
            (
                _named(material["name"], key),
                number(material["volume_mm3"]),
                str(material["components"]),
                number(region["tetrahedra"]) if region else "-",
                *shape,
            )
        )
    return rows


def _interface_rows(case: Case, key: list[Entry]) -> list[tuple[str, ...]]:
    rows: list[tuple[str, ...]] = []
    for pair in sorted(case.results["complex"]["interfaces"], key=lambda entry: -entry["area_mm2"]):
        quality = pair["quality"]
        turn = pair["rms_turn_degrees"]
        rows.append(
            (
                _named(pair["name"], key),
                number(pair["area_mm2"]),
                str(pair["pieces"]),
                number(pair["triangles"]),
                number(quality["radius_ratio"]["min"]),
                number(quality["radius_ratio"]["mean"]),
                number(quality["min_angle"]["min"]),
                number(quality["max_angle"]["max"]),
                "-" if turn is None else number(turn),
            )
        )
    return rows


def _currents(case: Case, key: list[Entry]) -> str:
    figures = dig(case.results, "solve", "forward")
    if figures is None:
        return ""
    rows = [
        (
            _named(entry["name"], key),
            number(entry["conductivity_s_per_m"]),
            *(number(entry["potential_mv"][key]) for key in ("min", "mean", "max")),
            number(entry["passing_ua"]),
            number(entry["net_ua"], 2),
        )
        for entry in figures["regions"]
    ]
    head = ("material", "conductivity, S/m", "minimum, mV", "mean", "maximum", "current in and out, \u00b5A", "net")
    return (
        f"<h3>Potential of a current in {escape(figures['source'])}</h3>{table(head, rows, (0,))}"
        f"<p>For each material, the currents in and out differ by at most the fraction {number(figures['imbalance'], 2)}.</p>"
    )


def _mended(case: Case) -> str:
    mended = dig(case.results, "tetrahedralizer", "mended")
    if not isinstance(mended, dict) or "min_dihedral_before" not in mended:
        return ""
    before, after, smallest, now = (
        number(mended[key]) for key in ("below_before", "below_after", "min_dihedral_before", "min_dihedral_after")
    )
    return (
        f"<h3>Improved tetrahedra</h3><p>{before} tetrahedra were below {number(mended['goal_degrees'])} degrees, "
        f"below the limit of the scaled Jacobian, or below what the surface allows. Local improvement leaves {after} "
        "of them. The minimum dihedral angle, without the tetrahedra that the surface limits, changed from "
        f"{smallest} to {now} degrees.</p>"
    )


def volumes(case: Case, key: list[Entry]) -> str:
    """Write the table of volumes, a row a material; nothing where none are known.

    Parameters
    ----------
    case
        The case.
    key
        What the materials are called, and their colours.
    """
    told = case.results.get("volumes") or dig(case.reports, "reconstruct", "results", "volumes") or []
    rows = []
    for row in map(with_changes, told):
        changes = row["change_percent"]
        cells = [
            "-"
            if row.get(key) is None
            else number(row[key]) + (f" ({_change(changes[key])})" if key in changes else "")
            for key in COLUMNS
        ]
        rows.append((_named(str(row["name"]), key), *cells))
    if not rows:
        return ""
    words = (
        "<p>Percentages are relative to the voxels, or to the distance field F if the volume has no labels. Two checks "
        "compare these volumes: the surface mesh against the voxels or F, and the tetrahedra against the surface mesh.</p>"
    )
    head = ("material", *(f"{name}, mm\u00b3" for name in COLUMNS.values()))
    return section("Volumes", _long_table(head, rows, "materials") + words)


def materials(case: Case, key: list[Entry]) -> str:
    """Write a row a material and a row an interface; nothing for one object.

    Parameters
    ----------
    case
        The case.
    key
        What the materials are called, and their colours.
    """
    counted = case.results.get("complex")
    if counted is None:
        return ""
    regions = _long_table(
        (
            "material", "volume, mm\u00b3", "parts", "tetrahedra", "minimum dihedral angle", "maximum",
            "minimum radius ratio", "mean",
        ),
        _region_rows(case, key),
        "materials",
    )  # fmt: skip
    interfaces = _long_table(
        (
            "interface", "area, mm\u00b2", "pieces", "triangles", "minimum radius ratio", "mean", "minimum angle",
            "maximum", "turn",
        ),
        _interface_rows(case, key),
        "interfaces",
    )  # fmt: skip
    turn = counted["rms_turn_degrees"]
    words = (
        f"<p>The junction curves, where three or more materials meet, have {number(counted['junction_edges'])} edges "
        f"and {number(counted['junction_vertices'])} end points or junction points. The turn is the root mean square "
        "angle between the normals of neighbouring triangles of an interface, "
        f"degrees{'' if turn is None else f' ({number(turn)} over all interfaces)'}.</p>"
    )
    return section("Materials", f"{regions}<h3>Interfaces</h3>{interfaces}{words}{_mended(case)}{_currents(case, key)}")
