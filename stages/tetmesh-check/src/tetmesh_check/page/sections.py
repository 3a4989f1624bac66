"""The parts of the page, each from what the reports say; a part about which nothing is known is left out."""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from html import escape
from typing import Any

from tetmesh_check.page.case import Case, picture_data
from tetmesh_check.page.charts import curve, histogram, number

_VERDICTS = {"pass": "passed", "warning": "warning", "fail": "failed"}
_MEASURES = (
    ("radius_ratio", "radius ratio", "1 is regular"),
    ("scaled_jacobian", "scaled Jacobian", "1 is regular"),
    ("min_dihedral", "smallest dihedral angle, degrees", "70.5 is regular"),
    ("max_dihedral", "largest dihedral angle, degrees", "70.5 is regular"),
    ("aspect_ratio", "aspect ratio", "1 is regular"),
    ("edge_ratio", "longest over shortest edge", "1 is regular"),
    ("edge_length", "edge length, mm", ""),
)
_PROBLEMS = {
    "poisson": "Poisson's equation, known solution",
    "conduction": "Wave front of excitation in tissue with fibres",
    "elasticity": "Soft organ under its own weight",
}


def table(head: Sequence[str], rows: Iterable[Sequence[str]], text: Sequence[int] = (), kind: str = "") -> str:
    """Write a table; cells are HTML already.

    Parameters
    ----------
    head
        Names of the columns.
    rows
        Their cells.
    text
        Columns of words rather than numbers.
    kind
        Class of the table.
    """

    def cell(tag: str, column: int, content: str) -> str:
        return f"<{tag}{' class=text' if column in text else ''}>{content}</{tag}>"

    top = "".join(cell('th scope="col"', k, name).replace('</th scope="col">', "</th>") for k, name in enumerate(head))
    body = "".join(f"<tr>{''.join(cell('td', k, content) for k, content in enumerate(row))}</tr>" for row in rows)
    named = f' class="{kind}"' if kind else ""
    return f'<div class="wide"><table{named}><thead><tr>{top}</tr></thead><tbody>{body}</tbody></table></div>'


def figure(content: str, caption: str) -> str:
    """Write a figure with what is to be seen in it.

    Parameters
    ----------
    content
        Picture or chart.
    caption
        Plain text.
    """
    return f"<figure>{content}<figcaption>{escape(caption)}</figcaption></figure>"


def head(case: Case) -> str:
    """Write name, verdict and the figures that matter most.

    Parameters
    ----------
    case
        The case.
    """
    kind, words = case.verdict()
    facts: list[tuple[str, str]] = []
    if (volume := case.results.get("volume")) is not None:
        quality = volume["quality"]
        facts += [
            (number(case.results["surface"]["topology"]["triangles"]), "surface triangles"),
            (number(volume["tetrahedra"]), "tetrahedra"),
            (f"{quality['min_dihedral']['min']:.1f}\u00b0", "smallest dihedral angle"),
            (f"{quality['radius_ratio']['mean']:.3f}", "mean radius ratio"),
            (number(volume["volume_mm3"]), "volume, mm\u00b3"),
        ]
    facts += [(duration(case.seconds), "all stages"), (memory(case.peak_memory), "largest process")]
    items = "".join(f"<li><b>{escape(value)}</b><span>{escape(name)}</span></li>" for value, name in facts)
    return (
        f'<header><p class="kicker">isoparticles: surface and tetrahedra</p><h1>{escape(case.name)}</h1>'
        f'<p class="verdict {kind}">{escape(words)}</p><ul class="numbers">{items}</ul></header>'
    )


def duration(seconds: float) -> str:
    """Write a time for people.

    Parameters
    ----------
    seconds
        The time, s.
    """
    if seconds >= 90:
        return f"{seconds / 60:.1f} min"
    return f"{seconds:.1f} s" if seconds >= 1 else f"{1000 * seconds:.0f} ms"


def memory(size: float) -> str:
    """Write an amount of memory for people.

    Parameters
    ----------
    size
        In bytes.
    """
    return f"{size / 2**30:.1f} GiB" if size >= 2**30 else f"{size / 2**20:.0f} MiB"


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
    triangles = number(case.results.get("surface", {}).get("topology", {}).get("triangles", 0))
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
        (f'<span class="tag {check["verdict"]}">{_VERDICTS[check["verdict"]]}</span>', escape(check["words"]))
        for check in case.checks
    ]
    for stage, report in case.stages.items():
        if report["error"] is not None:
            rows.append(('<span class="tag fail">error</span>', f"{stage}: {escape(report['error']['what'])}"))
        if stage != "tetmesh-check":
            rows += [
                ('<span class="tag fail">failed</span>', f"{stage}: {escape(words)}")
                for words in report["failed_checks"]
            ]
        rows += [
            ('<span class="tag warning">warning</span>', f"{stage}: {escape(words)}")
            for words in report.get("warnings", [])
        ]
    return f"<section><h2>Checks</h2>{table(('verdict', 'in words'), rows, (0, 1), 'checks')}</section>" if rows else ""


def _histogram(
    summary: dict[str, Any], title: str, label: str, worst: str, second: bool = False, end: int | None = None
) -> str:
    edges, counts = summary["histogram"]["edges"], summary["histogram"]["counts"]
    marks = {"mean": summary["mean"], worst: summary["max" if worst == "largest" else "min"]}
    return histogram(edges[: None if end is None else end + 1], counts[:end], title, label, marks, second)


def quality(case: Case) -> str:
    """Write histograms and percentiles of quality.

    Parameters
    ----------
    case
        The case.
    """
    if (volume := case.results.get("volume")) is None:
        return ""
    triangles, tetrahedra = case.results["surface"]["quality"], volume["quality"]
    charts = [
        figure(
            _histogram(triangles["radius_ratio"], "Surface triangles", "radius ratio", "smallest"),
            "Twice the inradius over the circumradius, the measure of the paper's Fig. 9: 1 is equilateral.",
        ),
        figure(
            _histogram(tetrahedra["radius_ratio"], "Tetrahedra", "radius ratio", "smallest", True),
            "Three times the inradius over the circumradius: 1 is regular.",
        ),
        figure(
            _histogram(triangles["min_angle"], "Surface triangles", "smallest angle, degrees", "smallest"),
            "The smallest angle of each triangle: 60 degrees is equilateral.",
        ),
        figure(
            _histogram(
                tetrahedra["min_dihedral"], "Tetrahedra", "smallest dihedral angle, degrees", "smallest", True, 24
            ),
            "The smallest angle between two faces of each tetrahedron: 70.5 degrees is regular.",
        ),
    ]
    if "histogram" in (sizes := case.results.get("sizing", {}).get("at_surface", {})):
        charts.append(
            figure(
                _histogram(sizes, "h on the surface", "target edge length, mm", "largest"),
                "The edge length that the size field asks for, at the vertices of the surface.",
            )
        )
    if (over := volume.get("edge_length_over_target")) is not None:
        charts.append(
            figure(
                _histogram(over, "Tetrahedra", "edge length over target", "largest", True),
                "Mean edge of each tetrahedron over what the size field asks for there.",
            )
        )
    rows = [
        (
            escape(name) + (f' <span class="soft">({remark})</span>' if remark else ""),
            *(number(s[key]) for key in ("min",)),
            *(number(s["percentiles"][key]) for key in ("p1", "p5", "p50", "p95", "p99")),
            number(s["max"]),
            number(s["mean"]),
        )
        for key_name, name, remark in _MEASURES
        for s in (tetrahedra[key_name],)
    ]
    numbers = "<h3>Tetrahedra in numbers</h3>" + table(
        ("tetrahedra", "smallest", "1 %", "5 %", "median", "95 %", "99 %", "largest", "mean"), rows
    )
    shown = f'<div class="grid">{"".join(charts)}</div>'
    return f"<section><h2>Quality</h2>{shown}{numbers}{_distances(case)}</section>"


def _distances(case: Case) -> str:
    distance, volume = case.results["distance_mm"], case.results["volume"]
    before = case.results["surface"]["volume_mm3"]
    change = 100.0 * (volume["volume_mm3"] / before - 1.0)
    rows = [
        (words, number(s["mean"]), number(s["p99"]), number(s["max"]))
        for words, s in (
            ("from the boundary of the tetrahedra to the surface", distance["boundary_to_surface"]),
            ("from the surface to the boundary of the tetrahedra", distance["surface_to_boundary"]),
        )
    ]
    kept = "the same triangles, bit for bit" if volume["boundary_kept"] else "other triangles within the envelope"
    return (
        "<h3>Tetrahedra against the surface</h3>"
        + table(("distance, mm", "mean", "99 %", "largest"), rows)
        + f"<p>The boundary of the tetrahedra consists of {kept}; their volume differs by {change:+.2g} % from that inside the surface.</p>"
    )


def solve(case: Case) -> str:
    """Write what the problems solved on the mesh say.

    Parameters
    ----------
    case
        The case.
    """
    results = case.results.get("solve")
    if results is None:
        return ""
    rows = []
    for name, title in _PROBLEMS.items():
        if name not in results or "jacobi" not in results[name]:
            continue
        figures = results[name]
        said = {
            "poisson": lambda f: (
                f"error {100 * f['relative_l2_error']:.2g} % (gradient {100 * f['relative_h1_error']:.2g} %, "
                f"{f['best_approximation']:.2f} times the interpolation's)"
            ),
            "conduction": lambda f: (
                f"potential {f['potential_range_mv'][0]:.1f} to {f['potential_range_mv'][1]:.1f} mV"
            ),
            "elasticity": lambda f: (
                f"largest displacement {number(f['max_displacement_mm'])} mm, energy {number(f['strain_energy_mj'])} mJ"
            ),
        }[name](figures)
        condition = figures["plain"]["condition"]
        rows.append(
            (
                title,
                number(figures["unknowns"]),
                number(figures["plain"]["iterations"]),
                number(figures["jacobi"]["iterations"]),
                "-" if condition is None else f"{condition:.2g}",
                duration(figures["seconds"]),
                said,
            )
        )
    reason = "" if results["reason"] is None else f"<p>Not all was solved: {escape(results['reason'])}.</p>"
    if not rows:
        return f"<section><h2>Solve</h2>{reason}</section>"
    columns = ("problem", "unknowns", "CG, plain", "CG, Jacobi", "condition", "time", "result")
    return (
        "<section><h2>Solve</h2><p>Linear elements and conjugate gradients (CG) to a residual of 1e-8: fewer iterations mean an easier "
        f"time for any solver.</p>{table(columns, rows, (6,))}{reason}</section>"
    )


def particles(case: Case) -> str:
    """Write how the particles settled.

    Parameters
    ----------
    case
        The case.
    """
    if len(case.passes) < 2:
        return ""
    steps = [float(k + 1) for k in range(len(case.passes))]
    energy = curve(steps, [row["energy"] for row in case.passes], "Energy of the particles", "pass", "energy")
    count = curve(steps, [row["count"] for row in case.passes], "Number of particles", "pass", "particles", True)
    last = case.passes[-1]
    return (
        '<section><h2>Particles</h2><div class="grid">'
        + figure(energy, "The sum of all energies, pass by pass, until it no longer falls.")
        + figure(
            count,
            f"Particles are added where there is room and taken away where it is crowded; {number(last['count'])} at the end.",
        )
        + "</div></section>"
    )


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
