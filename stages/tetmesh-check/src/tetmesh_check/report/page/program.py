"""``tetmesh-check-page``: one self-contained page about a case."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from importlib.resources import files
from pathlib import Path

import numpy as np
import pyvista as pv
from jinja2 import UndefinedError
from markupsafe import Markup

from tetmesh_check import __version__
from tetmesh_check.context import guarded
from tetmesh_check.errors import ExitCode, InterruptedRunError, StageError
from tetmesh_check.files import refuse_existing, write_text
from tetmesh_check.parsing import program_parser
from tetmesh_check.polydata import from_polydata
from tetmesh_check.report.page import places, sections
from tetmesh_check.report.page.case import Case, dig, read_case
from tetmesh_check.report.page.html import contents
from tetmesh_check.report.page.key import Entry, key_of
from tetmesh_check.report.page.scan import Scan, read_scan
from tetmesh_check.report.page.slices import facts, slices
from tetmesh_check.report.page.templates import render
from tetmesh_check.report.page.view3d import is_anatomical, view, view_meshes
from tetmesh_check.surface import read_dataset
from tetmesh_check.volume_table import COLUMNS

TOOL = "tetmesh-check-page"
_MANY = 24
"""Rows of a table of materials that are visible at once."""
_OTHER_VERSION = (KeyError, IndexError, TypeError, ValueError, UndefinedError)
"""Errors that reports of another version cause."""


def document(title: str, body: str, scripts: Sequence[str] = ()) -> str:
    """Write a page that needs no other files.

    Parameters
    ----------
    title
        Of the window.
    body
        HTML.
    scripts
        Names of files of JavaScript beside this one.
    """

    def text(name: str) -> Markup:
        return Markup(files("tetmesh_check.report.page").joinpath(name).read_text(encoding="utf-8"))

    code = [text(name) for name in scripts]
    return render("document", title=title, body=Markup(body), style=text("page.css"), scripts=code, version=__version__)


def _is_labels(case: Case) -> bool:
    """Whether the volume holds labels, by what was done with it, or was to be."""
    if dig(case.reports, "distfield", "parameters", "materials"):
        return True
    source = dig(case.reports, "distfield", "results", "meta", "source")
    return bool(source == "labels") if source else not {"LABELS", "MATERIALS"}.isdisjoint(case.parameters)


def scan_of(case: Case) -> Scan | StageError | None:
    """Read the input volume of a case; the error where it cannot be read.

    Parameters
    ----------
    case
        The case.
    """
    if case.input is None:
        return None
    try:
        return read_scan(case.input, _is_labels(case), dig(case.reports, "distfield", "parameters", "series"))
    except InterruptedRunError:
        raise
    except StageError as error:
        return error
    except _OTHER_VERSION as error:
        return StageError(
            f"{type(error).__name__} {error}", "the page shows its slices", "run make for this case again"
        )


def anatomy(case: Case, scan: Scan | StageError | None, surface: pv.PolyData | None, key: list[Entry]) -> str:
    """Write facts and slices of the input, or why it cannot be shown.

    Parameters
    ----------
    case
        The case.
    scan
        The volume, as :func:`scan_of` gives it.
    surface
        The triangles as read.
    key
        Names and colours of the labels.
    """
    if scan is None or case.input is None:
        return ""
    if isinstance(scan, StageError):
        return render("unreadable", error=scan)
    mesh = None if surface is None else from_polydata(surface)
    return facts(scan, case.input.name, key) + "\n" + slices(scan, mesh, key)


def _only_if_it_can_be_read(path: Path | None) -> pv.PolyData | None:
    """The surface, unless there is none or an empty one."""
    if path is None:
        return None
    surface = read_dataset(path)
    if not isinstance(surface, pv.PolyData) or surface.n_cells == 0 or not np.isfinite(surface.points).all():
        return None
    return surface


def quality(case: Case) -> str:
    """Write histograms and percentiles of quality."""
    return render("quality", case=case, chart=sections.chart, chart_of_counts=sections.chart_of_counts)


def page(case: Case, folder: Path) -> str:
    """Write the page of a case.

    Parameters
    ----------
    case
        The case.
    folder
        Path of the page; links are relative to it.
    """
    surface = _only_if_it_can_be_read(case.surface)
    scan = scan_of(case)
    by_scan = isinstance(scan, Scan) and scan.anatomical
    anatomical = by_scan if surface is None else is_anatomical(surface)
    try:
        key = key_of(case, scan if isinstance(scan, Scan) else None, surface)
    except _OTHER_VERSION:
        key = []
    found = list(places.found_in(case))
    many = {"case": case, "key": key, "many": _MANY}
    shown = {"found": found, "anatomical": anatomical, "place_of": places.place_of}
    writers: dict[str, Callable[[], str]] = {
        "what went wrong": lambda: render("trouble", case=case),
        "checks": lambda: render("checks", rows=sections.check_rows(case), places=found),
        "places": lambda: render("places", shown=places.SHOWN, limit=places.LISTED, **shown),
        "volumes": lambda: render("volumes", columns=COLUMNS, **many),
        "the mesh in the volume": lambda: anatomy(case, scan, surface, key),
        "in three dimensions": lambda: view(view_meshes(surface, case.volume, key), anatomical, key),
        "pictures": lambda: render("pictures", case=case, key=key, pictures=sections.pictures(case)),
        "materials": lambda: render("materials", regions=sections.region_rows(case), **many),
        "quality": lambda: quality(case),
        "solve": lambda: render("solve", case=case),
        "particles": lambda: render("particles", case=case, curve_of=sections.curve_of),
        "stages": lambda: render("stages", case=case),
        "files": lambda: render("files", rows=list(sections.file_rows(case, folder))),
        "how this was made": lambda: render("provenance", case=case),
        "methods": lambda: render("methods", case=case),
    }
    parts = []
    for name, write in writers.items():
        try:
            parts.append(write())
        except _OTHER_VERSION as error:
            parts.append(render("left_out", name=name, why=f"{type(error).__name__} {error}"))
    body = "\n".join(part for part in parts if part)
    scripts = [
        name for mark, name in (("slices-data", "slices.js"), ("view-data", "view.js")) if f'id="{mark}"' in body
    ]
    return document(f"{case.name}: {case.contents}", f"{render('head', case=case)}\n{contents(body)}\n{body}", scripts)


def main(argv: Sequence[str] | None = None) -> int:
    """Run the program.

    Parameters
    ----------
    argv
        The command line without the program's name; that of the process by default.
    """
    parser = program_parser(
        TOOL,
        description="Writes the page of a case, one HTML file that works offline. It shows verdict, checks with advice, slices of the "
        "volume with the mesh, a 3-D view, pictures, quality, solves, particles, stages, files and commands. It reads "
        "NAME.status.json, which make writes, and the files that are listed there. A part whose files are missing is omitted.",
        epilog="exit codes: 0 written; 2 bad usage or input, nothing written; 130 interrupted\n\nexample:\n"
        f"  {TOOL} out/heart/heart.status.json -o out/heart/heart.report.html",
    )
    parser.add_argument("status", metavar="NAME.status.json", type=Path, help="the status of the case")
    parser.add_argument("-o", "--output", metavar="PAGE.html", type=Path, required=True, help="the page to write")
    parser.add_argument("--force", action="store_true", help="replace the page if it exists already")
    parsed = parser.parse_args(argv)

    def work() -> int:
        if parsed.output.suffix != ".html":
            raise StageError(
                f"{parsed.output}: does not end in .html", "the page is an HTML file", "name it NAME.report.html"
            )
        refuse_existing([parsed.output], parsed.force)
        folder = Path(os.path.realpath(parsed.output.parent))
        write_text(parsed.output, page(read_case(Path(os.path.realpath(parsed.status))), folder))
        return ExitCode.OK

    return guarded(TOOL, work)
