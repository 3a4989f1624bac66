"""The data that the templates show, beside what the case itself has."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from urllib.parse import quote

from markupsafe import Markup

from tetmesh_check.report.page.advice import advice_for
from tetmesh_check.report.page.case import ENDED, STAGES, Case, dig
from tetmesh_check.report.page.charts import Axis, Limit, curve, histogram
from tetmesh_check.report.page.html import filled, picture_data, without_strip

Row = dict[str, Any]


def check_rows(case: Case) -> list[Row]:
    """List checks and warnings with advice: failed ones first, then warnings, then passes."""

    def row(kind: str, said: str, words: str = "") -> Row:
        verdict = {"pass": "passed", "warning": "warning", "fail": "failed"}.get(kind, "unknown")
        advice = advice_for(words, case.parameters) if words and kind != "pass" else ""
        return {"kind": kind, "verdict": verdict, "said": said, "advice": advice}

    own = [row(check["verdict"], check["words"], check["words"]) for check in case.checks]
    own.sort(key=lambda entry: str(entry["kind"] != "warning"))
    told = {check["words"] for check in case.checks}
    # the failed checks of tetmesh-check are among its checks
    failures = [(s, w) for s, w in case.failures if s != STAGES[-1] or not case.checks]
    return [
        *(row("fail", f"{s}: {w}", w) for s, w in failures),
        *(entry for entry in own if entry["kind"] == "fail"),
        *(row("warning", f"{s}: {w}") for s, w in case.warnings if w not in told),
        *(entry for entry in own if entry["kind"] != "fail"),
    ]


def file_rows(case: Case, page_folder: Path) -> Iterator[Row]:
    """List the files of the case that exist, with links from the folder of the page."""
    for stage in case.stages:
        if stage.state not in ENDED:
            continue
        exports = dig(stage.report, "results", "exports") or []
        names = [*stage.outputs, *stage.kept, *exports, *([stage.report_file] if stage.report_file else [])]
        for name in dict.fromkeys(names):
            path = case.folder / name
            if path.is_file():
                link = quote(Path(os.path.relpath(path, page_folder)).as_posix())
                size = path.stat().st_size
                yield {"name": name, "link": link, "kept": name in stage.kept, "stage": stage.name, "size": size}


def pictures(case: Case) -> dict[str, tuple[str, int, int]]:
    """Return the pictures by kind: data address, width and height."""
    changes = {"closeup": filled, "regions": without_strip}
    return {kind: picture_data(path, change=changes.get(kind)) for kind, path in case.pictures.items()}


def region_rows(case: Case) -> list[Row]:
    """List the materials, the largest first, with what is known of their tetrahedra."""
    counted = dig(case.results, "complex", "materials") or []
    by_number = {entry["number"]: entry for entry in dig(case.results, "volume", "regions") or []}
    return [
        {**entry, "region": by_number.get(entry["number"], {})}
        for entry in sorted(counted, key=lambda entry: -(entry["volume_mm3"] or 0.0))
        if entry["volume_mm3"] is not None  # the outside has none
    ]


def chart(
    summary: dict[str, Any],
    title: str,
    measure: str,
    things: str,
    worst: str,
    limit: float | None = None,
    second: bool = False,
    end: int | None = None,
) -> Markup:
    """Draw the histogram of a summary in a report.

    Parameters
    ----------
    summary
        As in the report.
    title, measure, things
        See :class:`.Axis`.
    worst
        ``minimum`` or ``maximum``, which is marked.
    limit
        Of the check, if there is one.
    second
        Whether to use the second colour.
    end
        Number of bins to show; all by default.
    """
    edges, counts = summary["histogram"]["edges"], summary["histogram"]["counts"][:end]
    beyond = summary["count"] - summary["infinite"] - sum(counts)
    below = sum(edge < 0 for edge in edges[:-1])
    if not any(counts[:below]):  # half of the range of a scaled Jacobian is for inverted tetrahedra
        edges, counts = edges[below:], counts[below:]
    marks = {"mean": summary["mean"], worst: summary["max" if worst == "maximum" else "min"]}
    shown = None if limit is None else Limit(float(limit))
    axis = Axis(title, measure, things)
    return Markup(histogram(edges[: len(counts) + 1], counts, axis, marks, shown, second, beyond))


def chart_of_counts(shape: dict[str, Any], limit: float | None) -> Markup:
    """Draw the radius ratios of triangles as ``reconstruct`` reports them."""
    counts = shape["radius_ratio_histogram"]
    edges = [k / len(counts) for k in range(len(counts) + 1)]
    marks = {"mean": shape["radius_ratio_mean"], "minimum": shape["radius_ratio_min"]}
    axis = Axis("Surface triangles", "radius ratio", "triangles")
    return Markup(histogram(edges, counts, axis, marks, None if limit is None else Limit(float(limit))))


def curve_of(case: Case, key: str, title: str, label: str = "", second: bool = False) -> Markup:
    """Draw a column of the log of ``particles`` against the pass."""
    steps = [float(k + 1) for k in range(len(case.passes))]
    return Markup(curve(steps, [row[key] for row in case.passes], title, "pass", label or key, second))
