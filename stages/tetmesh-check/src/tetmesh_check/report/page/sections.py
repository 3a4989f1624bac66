"""The parts of the page about the case as a whole: verdict, what went wrong, checks, files, pictures."""

from __future__ import annotations

import os
from collections.abc import Callable
from html import escape
from pathlib import Path
from typing import Any
from urllib.parse import quote

from tetmesh_check.report.page.advice import advice_for
from tetmesh_check.report.page.case import ENDED, STAGES, Case, dig
from tetmesh_check.report.page.charts import number
from tetmesh_check.report.page.html import (
    amount,
    duration,
    figure,
    filled,
    memory,
    picture_data,
    section,
    table,
    without_strip,
)
from tetmesh_check.report.page.key import Entry, legend
from tetmesh_check.report.page.places import pointer

_VERDICTS = {"pass": "passed", "warning": "warning", "fail": "failed"}
_STATES = {"done": "pass", "failed": "fail", "error": "fail", "interrupted": "warning"}
_KINDS_OF_FILES = (
    (".nrrd", "the volume"),
    (".truth.json", "exact properties of the phantom"),
    (".distfield.vti", "signed distance field"),
    (".sizefield.vti", "target edge length"),
    (".seeds.bin", "initial particles"),
    (".particles.bin", "final particles"),
    (".passes.csv", "energy and number of particles by pass"),
    (".surface.vtp", "surface: triangles in world coordinates"),
    (".volume.quadratic.vtu", "quadratic tetrahedra in world coordinates"),
    (".volume.mesh-complete.mesh.vtu", "export for SimVascular: tetrahedra"),
    (".volume.mesh-complete.exterior.vtp", "export for SimVascular: boundary"),
    (".volume.vtu", "tetrahedra in world coordinates"),
    (".volume.inp", "export for Abaqus and CalculiX"),
    (".volume.msh", "export for Gmsh, format 4.1"),
    (".volume.msh2", "export for Gmsh, format 2.2 (GetDP, FreeFEM)"),
    (".volume.med", "export for Salome and Code_Aster"),
    (".volume.vtk", "export in the legacy VTK format"),
    (".volume.feb", "export for FEBio"),
    (".volume.pts", "export for openCARP: vertices"),
    (".volume.elem", "export for openCARP: elements"),
    (".volume.lon", "export for openCARP: fibre directions"),
    (".volume.regions.csv", "regions of the exports"),
    (".boundary.vtp", "export: boundary of the tetrahedra"),
    (".xdmf", "export for FEniCS"),
    (".h5", "export for FEniCS: data"),
    (".report.json", "report: all measurements"),
    (".json", "report of the stage"),
    (".log", "log of the tetrahedralizer"),
    (".png", "picture"),
)


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
    return section(name.capitalize(), f"<p>Left out: the reports lack the data for this section ({why}).</p>")


def head(case: Case) -> str:
    """Write name, verdict and the figures that matter most.

    Parameters
    ----------
    case
        The case.
    """
    facts: list[tuple[str, str]] = []
    results, check = case.results, dig(case.reports, "reconstruct", "results", "check")
    known: tuple[tuple[Any, Callable[[float], str], str], ...] = (
        (dig(check, "vertices"), number, "surface vertices"),
        (dig(check, "triangles"), number, "surface triangles"),
        (dig(results, "volume", "tetrahedra"), number, "tetrahedra"),
        (
            dig(results, "volume", "quality", "min_dihedral", "min"),
            "{:.1f}\u00b0".format,
            "minimum dihedral angle of tetrahedra",
        ),
        (
            dig(results, "volume", "quality", "radius_ratio", "mean"),
            "{:.3f}".format,
            "mean radius ratio of tetrahedra (1 is regular)",
        ),
        (dig(results, "volume", "volume_mm3"), number, "volume of tetrahedra, mm\u00b3"),
    )
    facts += [(write(value), name) for value, write, name in known if value is not None]
    facts.append((duration(case.seconds), "all stages"))
    if case.peak_memory:
        facts.append((memory(case.peak_memory), "peak memory"))
    items = "".join(f"<li><b>{escape(value)}</b><span>{escape(name)}</span></li>" for value, name in facts)
    return (
        f'<header><p class="kicker">isoparticles: {escape(case.contents)}</p><h1>{escape(case.name)}</h1>'
        f'<p class="verdict {case.kind}">{escape(case.headline)}</p><ul class="numbers">{items}</ul></header>'
    )


def trouble(case: Case) -> str:
    """Write the error that ended the run, in its three parts.

    Parameters
    ----------
    case
        The case.
    """
    parts = []
    for stage in case.stages:
        if stage.error is not None:
            said = [
                (title, escape(str(stage.error.get(key) or "-")))
                for title, key in (("What happened", "what"), ("Why it matters", "why"), ("What to do", "next"))
            ]
            lines = "".join(f"<dt>{title}</dt><dd>{words}</dd>" for title, words in said)
            parts.append(f'<div class="trouble"><h3>{escape(stage.name)}</h3><dl>{lines}</dl></div>')
    return section("What went wrong", "".join(parts)) if parts else ""


def _tag(kind: str, words: str) -> str:
    return f'<span class="tag {escape(kind)}">{escape(words)}</span>'


def checks(case: Case) -> str:
    """Write the verdicts in words, with what to do about those that are not passes.

    Parameters
    ----------
    case
        The case.
    """
    failed: list[tuple[str, str, str]] = []
    passed: list[tuple[str, str, str]] = []
    for check in sorted(case.checks, key=lambda check: str(check["verdict"] != "warning")):
        kind, words = check["verdict"], check["words"]
        advice = "" if kind == "pass" else advice_for(words, case.parameters)
        row = (_tag(kind, _VERDICTS.get(kind, "unknown")), escape(words), escape(advice))
        (failed if kind == "fail" else passed).append(row)
    said = {check["words"] for check in case.checks}
    # the failed checks of tetmesh-check are among its checks
    own = [(s, w) for s, w in case.failures if s != STAGES[-1] or not case.checks]
    failed = [
        (_tag("fail", "failed"), f"{s}: {escape(w)}", escape(advice_for(w, case.parameters))) for s, w in own
    ] + failed
    warned = [(_tag("warning", "warning"), f"{s}: {escape(w)}", "") for s, w in case.warnings if w not in said]
    rows = [*failed, *warned, *passed]
    if not rows:
        return ""
    if not any(row[2] for row in rows):
        shown = table(("verdict", "check or warning"), [row[:2] for row in rows], (0, 1), "checks")
        return section("Checks", shown + pointer(case))
    return section(
        "Checks", table(("verdict", "check or warning", "what to do"), rows, (0, 1, 2), "checks") + pointer(case)
    )


def stage_states(case: Case) -> str:
    """Write how each stage ended, its time and memory, and its steps.

    Parameters
    ----------
    case
        The case.
    """
    longest = max((stage.seconds or 0.0 for stage in case.stages), default=0.0) or 1.0
    rows = []
    for stage in case.stages:
        report = stage.report or {}
        kind = _STATES.get(stage.state, "neutral")
        known = stage.seconds is not None
        rows.append(
            (
                escape(stage.name),
                _tag("warning" if kind == "pass" and stage.warnings else kind, stage.state),
                duration(stage.seconds or 0.0) if known else "-",
                f'<span class="bar"><i style="width:{100 * (stage.seconds or 0.0) / longest:.1f}%"></i></span>' if known else "",
                memory(report["peak_memory_bytes"]) if report.get("peak_memory_bytes") else "-",
                str(report.get("threads", "-")),
            )
        )  # fmt: skip
    steps = [
        (stage, escape(step["name"]), duration(step["seconds"]))
        for stage, report in case.reports.items()
        for step in report.get("steps", [])
    ]
    names = ("stage", "state", "time", "", "peak memory", "threads")
    detail = table(("stage", "step", "time"), steps, (1,))
    more = f"<details><summary>The steps of every stage</summary><div>{detail}</div></details>" if steps else ""
    return section("Stages", table(names, rows, (1, 3)) + more)


def files(case: Case, page_folder: Path) -> str:
    """Write links to the files of the case, with their sizes.

    Parameters
    ----------
    case
        The case.
    page_folder
        Where the page goes: links lead from there.
    """
    rows = []
    for stage in case.stages:
        if stage.state not in ENDED:
            continue
        exports = dig(stage.report, "results", "exports") or []
        names = [*stage.outputs, *stage.kept, *exports, *([stage.report_file] if stage.report_file else [])]
        for name in dict.fromkeys(names):
            path = case.folder / name
            if not path.is_file():
                continue
            link = quote(Path(os.path.relpath(path, page_folder)).as_posix())
            plain = name.replace(".failed.", ".")
            kind = next((words for ending, words in _KINDS_OF_FILES if plain.endswith(ending)), "")
            if name in stage.kept:
                kind = f"{kind or 'output'}; kept, although a check failed"
            rows.append((f'<a href="{link}">{escape(name)}</a>', escape(kind), stage.name, amount(path.stat().st_size)))
    return section("Files", table(("file", "what it is", "stage", "size"), rows, (0, 1, 2))) if rows else ""


def pictures(case: Case, key: list[Entry]) -> str:
    """Write the pictures.

    Parameters
    ----------
    case
        The case.
    key
        What the materials are called, and their colours.
    """
    count = dig(case.results, "complex", "triangles") or dig(case.results, "surface", "topology", "triangles")
    triangles = number(count or 0)
    materials = [entry for entry in key if entry.meshed] if "regions" in case.pictures else []
    words = {
        "surface": f"The surface, {triangles} triangles{', coloured by the materials' if materials else ''}.",
        "closeup": "Detail of the surface, coloured by the radius ratio of its triangles (1 is equilateral).",
        "cut": "Cut through the tetrahedra, coloured by their radius ratio (1 is regular).",
        "regions": "Cut through the tetrahedra, coloured by their materials.",
    }
    changes = {"closeup": filled, "regions": without_strip}
    parts = []
    for kind, path in case.pictures.items():
        address, width, height = picture_data(path, change=changes.get(kind))
        alt = escape(f"{case.name}: {words[kind]}", quote=True)
        image = f'<img src="{address}" width="{width}" height="{height}" alt="{alt}" loading="lazy">'
        parts.append(figure(image, words[kind]))
    grid = f'<div class="grid pictures">{"".join(parts)}</div>{legend(materials)}'
    return section("Pictures", grid) if parts else ""
