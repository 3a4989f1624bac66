"""The parts of the page about regions: volumes, and of many materials what lies between them."""

from __future__ import annotations

from html import escape
from typing import Any

from tetmesh_check.colours import region_colours
from tetmesh_check.page.case import STAGES, Case, dig
from tetmesh_check.page.charts import number
from tetmesh_check.page.html import section, table
from tetmesh_check.volume_table import COLUMNS, with_changes

_MANY = 24
"""Rows that are shown at once; the rest is there to be opened."""


def _swatch(colour: Any, name: str) -> str:
    red, green, blue = (int(part) for part in colour)
    style = f"display:inline-block;width:.8em;height:.8em;margin-right:.4em;background:rgb({red},{green},{blue})"
    return f'<i style="{style}"></i>{escape(name)}'


def _long_table(head: tuple[str, ...], rows: list[tuple[str, ...]], words: str) -> str:
    shown = table(head, rows[:_MANY], (0,))
    if len(rows) <= _MANY:
        return shown
    rest = table(head, rows[_MANY:], (0,))
    return f"{shown}<details><summary>{len(rows) - _MANY} more {words}</summary><div>{rest}</div></details>"


def _region_rows(case: Case) -> list[tuple[str, ...]]:
    counted = case.results["complex"]["materials"]
    colours = region_colours(1 + max(entry["number"] for entry in counted))
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
                _swatch(colours[material["number"]], material["name"]),
                number(material["volume_mm3"]),
                str(material["components"]),
                number(region["tetrahedra"]) if region else "-",
                *shape,
            )
        )
    return rows


def _interface_rows(case: Case) -> list[tuple[str, ...]]:
    rows: list[tuple[str, ...]] = []
    for pair in sorted(case.results["complex"]["interfaces"], key=lambda entry: -entry["area_mm2"]):
        quality = pair["quality"]
        turn = pair["rms_turn_degrees"]
        rows.append(
            (
                escape(pair["name"].replace("/", " / ")),
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


def _currents(case: Case) -> str:
    figures = dig(case.results, "solve", "forward")
    if figures is None:
        return ""
    rows = [
        (
            escape(entry["name"]),
            number(entry["conductivity_s_per_m"]),
            *(number(entry["potential_mv"][key]) for key in ("min", "mean", "max")),
            number(entry["passing_ua"]),
            f"{entry['net_ua']:.1e}",
        )
        for entry in figures["regions"]
    ]
    head = ("material", "conductivity, S/m", "lowest, mV", "mean", "highest", "current in and out, \u00b5A", "net")
    return (
        f"<h3>Potential of a current in {escape(figures['source'])}</h3>{table(head, rows, (0,))}"
        f"<p>What leaves a material enters its neighbours: a share of {figures['imbalance']:.1e} of the current is lost or gained.</p>"
    )


def _forced_rows(case: Case, by: str, possible: str) -> list[tuple[str, ...]]:
    return [
        (
            escape(entry["material"]),
            ", ".join(f"{x:.2f}" for x in entry["place_mm"]),
            *(number(entry[key]) for key in (possible, "min_dihedral", "min_scaled_jacobian")),
        )
        for entry in dig(case.results, "volume", by) or []
    ]


def _flat(case: Case) -> str:
    """What the surface forces to be flat, and what was mended."""
    parts = []
    mended = dig(case.results, "tetrahedralizer", "mended")
    if mended is not None:
        before, after, smallest, now = (
            number(mended[key]) for key in ("below_before", "below_after", "min_dihedral_before", "min_dihedral_after")
        )
        parts.append(
            f"<p>{before} tetrahedra were below {number(mended['goal_degrees'])} degrees, the limit of the scaled Jacobian, or what the "
            f"surface allows of them; mended where they lay, {after} are left. The smallest angle that it does not force below the limit "
            f"was {smallest} degrees and is {now} now.</p>"
        )
    rows = _forced_rows(case, "forced_by_surface", "possible_degrees")
    if rows:
        limit = dig(case.reports, STAGES[-1], "parameters", "min_dihedral")
        words = "" if limit is None else f" of {number(limit)} degrees"
        smallest = min(entry["min_dihedral"] for entry in case.results["volume"]["forced_by_surface"])
        head = ("material", "place, mm", "possible, degrees", "smallest dihedral angle", "scaled Jacobian")
        parts.append(
            f"<p>On {number(len(rows))} sides of triangles no tetrahedron can reach the limit{words}, whoever makes it, since other "
            f"triangles meet them at less or lie close before them, as where a thin layer ends. The smallest angle that came out "
            f"is of {number(smallest)} degrees.</p>"
            f"{_long_table(head, rows, 'places')}"
        )
    rows = _forced_rows(case, "forced_by_triangle", "possible_scaled_jacobian")
    if rows:
        head = ("material", "place, mm", "possible scaled Jacobian", "smallest dihedral angle", "scaled Jacobian")
        parts.append(
            f"<p>{number(len(rows))} tetrahedra stand on triangles of so small an angle that none can have both the dihedral angles and the "
            f"scaled Jacobian that are asked for, whoever makes it.</p>"
            f"{_long_table(head, rows, 'needles')}"
        )
    return f"<h3>Flat tetrahedra</h3>{''.join(parts)}" if parts else ""


def volumes(case: Case) -> str:
    """Write the table of volumes, a row a material; nothing where none are known.

    Parameters
    ----------
    case
        The case.
    """
    told = case.results.get("volumes") or dig(case.reports, "reconstruct", "results", "volumes") or []
    rows = []
    for row in map(with_changes, told):
        changes = row["change_percent"]
        cells = [
            "-" if row.get(key) is None else number(row[key]) + (f" ({changes[key]:+.2f} %)" if key in changes else "")
            for key in COLUMNS
        ]
        rows.append((escape(str(row["name"])), *cells))
    if not rows:
        return ""
    words = "<p>In percent: the difference from the voxels, or from F where the volume holds no labels.</p>"
    head = ("material", *(f"{name}, mm\u00b3" for name in COLUMNS.values()))
    return section("Volumes", _long_table(head, rows, "materials") + words)


def materials(case: Case) -> str:
    """Write a row a material and a row an interface; nothing for one object.

    Parameters
    ----------
    case
        The case.
    """
    counted = case.results.get("complex")
    if counted is None:
        return ""
    regions = _long_table(
        ("material", "volume, mm\u00b3", "parts", "tetrahedra", "smallest dihedral angle", "largest", "radius ratio, smallest", "mean"),
        _region_rows(case),
        "materials",
    )  # fmt: skip
    interfaces = _long_table(
        ("interface", "area, mm\u00b2", "pieces", "triangles", "radius ratio, smallest", "mean", "smallest angle", "largest", "turn"),
        _interface_rows(case),
        "interfaces",
    )  # fmt: skip
    turn = counted["rms_turn_degrees"]
    words = (
        f"<p>{number(counted['junction_edges'])} edges are junctions of three and more sheets, which end or meet in "
        f"{number(counted['junction_vertices'])} points. The turn is that of the normal from a triangle to its neighbour on the same sheet, "
        f"root mean square, degrees{'' if turn is None else f'; {number(turn)} over all'}.</p>"
    )
    return section("Materials", f"{regions}<h3>Interfaces</h3>{interfaces}{words}{_flat(case)}{_currents(case)}")
