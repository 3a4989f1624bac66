"""The parts of the page, each from what the reports say; a part about which nothing is known is left out."""

from __future__ import annotations

import json
from collections.abc import Callable
from html import escape
from typing import Any

from tetmesh_check.page.case import Case, dig, picture_data
from tetmesh_check.page.charts import number
from tetmesh_check.page.html import duration, figure, memory, table

_VERDICTS = {"pass": "passed", "warning": "warning", "fail": "failed"}


def left_out(name: str, error: Exception) -> str:
    """Write a note in place of a part that cannot be made from what the reports hold.

    Parameters
    ----------
    name
        Of the part.
    error
        What is missing.
    """
    why = escape(f"{type(error).__name__} {error}")
    return f"<section><h2>{escape(name.capitalize())}</h2><p>Left out: the reports lack what it is made from ({why}).</p></section>"


def head(case: Case) -> str:
    """Write name, verdict and the figures that matter most.

    Parameters
    ----------
    case
        The case.
    """
    kind, words = case.verdict()
    facts: list[tuple[str, str]] = []
    results = case.results
    known: tuple[tuple[Any, Callable[[float], str], str], ...] = (
        (dig(results, "surface", "topology", "triangles"), number, "surface triangles"),
        (dig(results, "volume", "tetrahedra"), number, "tetrahedra"),
        (dig(results, "volume", "quality", "min_dihedral", "min"), "{:.1f}\u00b0".format, "smallest dihedral angle"),
        (dig(results, "volume", "quality", "radius_ratio", "mean"), "{:.3f}".format, "mean radius ratio"),
        (dig(results, "volume", "volume_mm3"), number, "volume, mm\u00b3"),
    )
    if dig(results, "volume") is not None:
        facts += [(write(value), name) for value, write, name in known if value is not None]
    facts += [(duration(case.seconds), "all stages"), (memory(case.peak_memory), "largest process")]
    items = "".join(f"<li><b>{escape(value)}</b><span>{escape(name)}</span></li>" for value, name in facts)
    return (
        f'<header><p class="kicker">isoparticles: surface and tetrahedra</p><h1>{escape(case.name)}</h1>'
        f'<p class="verdict {kind}">{escape(words)}</p><ul class="numbers">{items}</ul></header>'
    )


def view(about: dict[str, Any], data: str) -> str:
    """Write the 3-D view.

    Parameters
    ----------
    about, data
        Those of :func:`.pack`.
    """
    options = "".join(
        f"<option value={mesh['name']}>{mesh['name']}, {number(mesh['triangle_count'])} triangles</option>"
        for mesh in about["meshes"]
    )
    text = json.dumps(about).replace("<", "\\u003c")
    return (
        '<section><h2>In three dimensions</h2><figure class="viewer"><div class="controls">'
        f'<label>Show <select id="view-mesh">{options}</select></label>'
        '<label>Colour <select id="view-colour"><option value="0">plain</option><option value="1">quality</option>'
        '<option value="2">edge length</option></select></label>'
        '<label><input type="checkbox" id="view-edges" checked> edges</label>'
        '<span class="scale" id="view-bar" hidden><i></i><span id="view-scale"></span></span></div>'
        '<canvas id="view" tabindex="0" role="img" aria-label="The mesh in three dimensions, to be turned with the mouse, a '
        'finger or the arrow keys"></canvas><figcaption id="view-note">Drag to turn, wheel or two fingers to come nearer, shift and '
        "drag to move; arrow keys, + and -, 0 to start again. The cut shows whole tetrahedra.</figcaption></figure>"
        f'<script type="application/json" id="view-about">{text}</script>'
        f'<script type="text/plain" id="view-data">{data}</script></section>'
    )


def pictures(case: Case) -> str:
    """Write the pictures.

    Parameters
    ----------
    case
        The case.
    """
    triangles = number(dig(case.results, "surface", "topology", "triangles") or 0)
    words = {
        "surface": f"The surface with its {triangles} triangles.",
        "closeup": "Close-up of the surface, coloured by the radius ratio of its triangles; yellow is equilateral.",
        "cut": "Cut through the tetrahedra, coloured by their radius ratio; yellow is regular.",
    }
    parts = []
    for kind, path in case.pictures.items():
        address, width, height = picture_data(path)
        alt = escape(f"{case.name}: {words[kind]}", quote=True)
        parts.append(
            figure(f'<img src="{address}" width="{width}" height="{height}" alt="{alt}" loading="lazy">', words[kind])
        )
    return f'<section><h2>Pictures</h2><div class="grid three">{"".join(parts)}</div></section>' if parts else ""


def checks(case: Case) -> str:
    """Write the verdicts in words.

    Parameters
    ----------
    case
        The case.
    """
    rows = [
        (
            f'<span class="tag {escape(check["verdict"])}">{_VERDICTS.get(check["verdict"], "unknown")}</span>',
            escape(check["words"]),
        )
        for check in case.checks
    ]
    for stage, report in case.stages.items():
        if report["error"] is not None:
            rows.append(
                ('<span class="tag fail">error</span>', f"{stage}: {escape(str(dig(report, 'error', 'what')))}")
            )
        if stage != "tetmesh-check":
            rows += [
                ('<span class="tag fail">failed</span>', f"{stage}: {escape(words)}")
                for words in report.get("failed_checks", [])
            ]
        rows += [
            ('<span class="tag warning">warning</span>', f"{stage}: {escape(words)}")
            for words in report.get("warnings", [])
        ]
    return f"<section><h2>Checks</h2>{table(('verdict', 'in words'), rows, (0, 1), 'checks')}</section>" if rows else ""


def stages(case: Case) -> str:
    """Write time and memory by stage, and the steps of each.

    Parameters
    ----------
    case
        The case.
    """
    longest = max((report["seconds"] for report in case.stages.values()), default=0.0) or 1.0
    rows = [
        (
            stage,
            duration(report["seconds"]),
            f'<span class="bar"><i style="width:{100 * report["seconds"] / longest:.1f}%"></i></span>',
            memory(report.get("peak_memory_bytes") or 0),
            str(report.get("threads", "-")),
        )
        for stage, report in case.stages.items()
    ]
    steps = [
        (stage, escape(step["name"]), duration(step["seconds"]))
        for stage, report in case.stages.items()
        for step in report.get("steps", [])
    ]
    names = ("stage", "time", "", "largest process", "threads")
    detail = table(("stage", "step", "time"), steps, (1,))
    return (
        f"<section><h2>Time and memory</h2>{table(names, rows, (2,))}"
        f"<details><summary>The steps of every stage</summary><div>{detail}</div></details></section>"
    )


def provenance(case: Case) -> str:
    """Write parameters, command lines and the hashes of the inputs.

    Parameters
    ----------
    case
        The case.
    """
    parts = []
    for stage, report in case.stages.items():
        parameters = [
            (escape(name), escape(json.dumps(value))) for name, value in sorted(report.get("parameters", {}).items())
        ]
        inputs = [
            (escape(entry["path"]), f"<code>{escape(entry['blake3'])}</code>") for entry in report.get("inputs", [])
        ]
        parts.append(
            f"<details><summary>{stage} {escape(str(report.get('version', '')))}</summary><div><pre>{escape(report['command_line'])}</pre>"
            + table(("parameter", "value"), parameters, (1,))
            + table(("input", "BLAKE3"), inputs, (1,))
            + "</div></details>"
        )
    return f"<section><h2>Parameters and provenance</h2>{''.join(parts)}</section>"
