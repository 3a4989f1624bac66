"""``tetmesh-check-page``: one self-contained page about a case."""

from __future__ import annotations

from argparse import Namespace
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from isoparticles._native import check_output
from jinja2 import UndefinedError
from markupsafe import Markup

from tetmesh_check.datasets import from_polydata
from tetmesh_check.errors import StageError, guarded
from tetmesh_check.files import write_text
from tetmesh_check.parsing import Parser
from tetmesh_check.report.colours import key_of
from tetmesh_check.report.page.case import Case, dig, read_case
from tetmesh_check.report.page.scan import Scan, read_scan
from tetmesh_check.report.page.slices import facts, slices
from tetmesh_check.report.page.templates import render
from tetmesh_check.report.page.view3d import WORST, is_anatomical, pack, view_meshes
from tetmesh_check.surface import read_dataset

TOOL = "tetmesh-check-page"
_SECTIONS = (
    "what went wrong", "checks", "places", "volumes", "the mesh in the volume",
    "in three dimensions", "pictures", "materials", "parts and sets", "density", "fibres", "quality", "solve", "particles",
    "stages", "files", "how this was made", "methods",
)  # fmt: skip
"""The sections in order. The names of their templates have ``_`` instead of spaces."""
_OTHER_VERSION = (KeyError, IndexError, TypeError, ValueError, UndefinedError)
"""Errors that reports of another version cause."""


def _scan_of(case: Case) -> tuple[Scan | None, StageError | None]:
    """Read the input volume; return the error if it cannot be read."""
    if case.input is None:
        return None, None
    source = dig(case.reports, "distfield", "results", "meta", "source")
    asked = dig(case.reports, "distfield", "parameters", "materials")
    labels = asked or (source == "labels" if source else {"LABELS", "MATERIALS"} & set(case.parameters))
    try:
        return read_scan(case.input, bool(labels), dig(case.reports, "distfield", "parameters") or {}), None
    except StageError as error:
        return None, error


def _mesh_of(case: Case, stage: str, ending: str) -> Any:
    """Read a mesh; ``None`` if it is missing or cannot be shown."""
    path = case.file(stage, ending)
    mesh = read_dataset(path) if path else None
    return mesh if mesh is not None and mesh.n_cells and np.isfinite(mesh.points).all() else None


def _section(name: str, shown: dict[str, Any]) -> str:
    """Return the HTML of a section, or a note that its data are missing."""
    try:
        return render(name.replace(" ", "_"), **shown)
    except _OTHER_VERSION as error:
        return render("left_out", name=name, why=f"{type(error).__name__} {error}")


def page(case: Case, folder: Path) -> str:
    """Return the HTML of the page of a case.

    Parameters
    ----------
    case
        The case.
    folder
        Folder of the page. Links are relative to it.
    """
    surface = _mesh_of(case, "reconstruct", ".surface.vtp")
    scan, unreadable = _scan_of(case)
    key = key_of(case, scan, surface)
    anatomical = bool(scan and scan.anatomical) if surface is None else is_anatomical(surface)
    shown = {
        "case": case,
        "folder": folder,
        "key": key,
        "anatomical": anatomical,
        "scan": scan,
        "unreadable": unreadable,
        "facts": facts,
        "slices": slices,
        "mesh": None if surface is None else from_polydata(surface),
        "surface": surface,
        "volume": _mesh_of(case, "tetmesh-check", ".volume.vtu"),
        "view_meshes": view_meshes,
        "pack": pack,
        "worst": WORST,
    }
    parts = [_section(name, shown) for name in _SECTIONS]
    return render("page", case=case, body=Markup("\n").join(part for part in parts if part))


def write_page(
    tool: str, parsed: Namespace, usual: str, endings: Sequence[str], make: Callable[[Path], dict[str, str]]
) -> int:
    """Write a page and its other files, as the command line says.

    Parameters
    ----------
    tool
        Name of the program.
    parsed
        The arguments, with ``output`` and ``force``.
    usual
        Name of the page that an error message suggests.
    endings
        Endings of the files.
    make
        Returns the texts by ending; its argument is the folder of the page.

    Returns
    -------
    int
        The exit code.
    """

    def work() -> None:
        output: Path = parsed.output
        if output.suffix != ".html":
            raise StageError(f"{output}: does not end in .html", "the page is an HTML file", f"name it {usual}")
        for ending in endings:
            check_output(output.with_suffix(ending), parsed.force)
        for ending, text in make(output.parent.resolve()).items():
            write_text(output.with_suffix(ending), text)

    return guarded(tool, work)


def main(argv: Sequence[str] | None = None) -> int:
    """Run the program.

    Parameters
    ----------
    argv
        The command line without the program's name; that of the process by default.
    """
    parser = Parser(
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

    def make(folder: Path) -> dict[str, str]:
        return {".html": page(read_case(parsed.status.resolve()), folder)}

    return write_page(TOOL, parsed, "NAME.report.html", (".html",), make)
