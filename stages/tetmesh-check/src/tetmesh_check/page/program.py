"""``tetmesh-check-page``: one self-contained page from the reports, meshes and pictures of a case."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from html import escape
from importlib.resources import files
from pathlib import Path

import numpy as np
import pyvista as pv

from tetmesh_check import __version__
from tetmesh_check.context import guarded
from tetmesh_check.cut import cut_of
from tetmesh_check.errors import ExitCode, StageError
from tetmesh_check.files import refuse_existing, write_text
from tetmesh_check.page import measured, sections
from tetmesh_check.page.case import Case, read_case
from tetmesh_check.page.payload import MAX_TRIANGLES, ViewMesh, pack, view_of_cut
from tetmesh_check.parsing import program_parser
from tetmesh_check.polydata import from_polydata
from tetmesh_check.quality import Cells, Points, Values, triangle_quality
from tetmesh_check.surface import read_dataset

TOOL = "tetmesh-check-page"
_YAW, _PITCH = 0.63, 0.38
"""Where the eye is at first, radians: that of the pictures."""


def _edge_lengths(points: Points, triangles: Cells) -> Values:
    """Mean length of the edges round each vertex, mm, shape ``(n,)``; 0 at vertices without a triangle."""
    total, uses = np.zeros(len(points)), np.zeros(len(points))
    for k in range(3):
        a, b = triangles[:, k], triangles[:, (k + 1) % 3]
        length = np.linalg.norm(points[a] - points[b], axis=1)
        for end in (a, b):
            total += np.bincount(end, length, len(points))
            uses += np.bincount(end, minlength=len(points))
    return np.divide(total, uses, out=np.zeros(len(points)), where=uses > 0)


def view_meshes(surface: Path | None, volume: Path | None) -> list[ViewMesh]:
    """Read what the 3-D view shows: the surface, and the half of the tetrahedra behind a cut.

    Parameters
    ----------
    surface, volume
        The files; meshes of more than :data:`.MAX_TRIANGLES` triangles are left out.
    """
    meshes = []
    if surface is not None:
        points, triangles = from_polydata(read_dataset(surface))
        if len(triangles) <= MAX_TRIANGLES:
            quality = triangle_quality(points, triangles).radius_ratio
            meshes.append(ViewMesh("surface", points, triangles, quality, _edge_lengths(points, triangles)))
    if volume is not None:
        grid = read_dataset(volume)
        if isinstance(grid, pv.UnstructuredGrid) and pv.CellType.TETRA in grid.cells_dict:
            points = np.asarray(grid.points, dtype=np.float64)
            cut = cut_of(grid)
            if len(cut.triangles) <= MAX_TRIANGLES:
                sizes = _edge_lengths(points, cut.triangles)
                meshes.append(view_of_cut(points, np.asarray(grid.cell_data["radius_ratio"]), cut, sizes))
    return meshes


def document(title: str, body: str, scripts: str = "") -> str:
    """Write a page that needs nothing but itself.

    Parameters
    ----------
    title
        Of the window.
    body
        What it shows.
    scripts
        JavaScript; a note about each error goes to the ``html`` element, for tests.
    """
    style = files("tetmesh_check.page").joinpath("page.css").read_text(encoding="utf-8")
    script = f"<script>\n{scripts}</script>" if scripts else ""
    return (
        f'<!doctype html>\n<html lang="en">\n<head><meta charset="utf-8"><title>{escape(title)}</title>\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f'<link rel="icon" href="data:,">\n<style>\n{style}</style></head>\n<body><main>\n{body}\n'
        f"<footer>Written by tetmesh-check {escape(__version__)}. Lengths in mm, angles in degrees.</footer></main>\n{script}</body></html>\n"
    )


def page(case: Case) -> str:
    """Write the page of a case.

    Parameters
    ----------
    case
        The case.
    """
    parts: list[str] = [sections.head(case)]
    script = ""
    if meshes := view_meshes(case.surface, case.volume):
        parts.append(sections.view(*pack(meshes, _YAW, _PITCH)))
        script = files("tetmesh_check.page").joinpath("view.js").read_text(encoding="utf-8")
    writers: list[Callable[[Case], str]] = [
        sections.pictures,
        sections.checks,
        measured.quality,
        measured.solve,
        measured.particles,
        sections.stages,
        sections.provenance,
    ]
    for write in writers:
        try:
            parts.append(write(case))
        except (KeyError, IndexError, TypeError, ValueError) as error:  # a report of another version
            parts.append(sections.left_out(write.__name__, error))
    return document(f"{case.name}: surface and tetrahedra", "\n".join(part for part in parts if part), script)


def main(argv: Sequence[str] | None = None) -> int:
    """Run the program.

    Parameters
    ----------
    argv
        The command line without the program's name; that of the process by default.
    """
    parser = program_parser(
        TOOL,
        description="Writes one HTML page about a case, which needs no network and no other file: verdict, 3-D view, pictures, "
        "checks, quality, solves, particles, time and memory, parameters. It finds what make leaves beside the report: "
        "reports/STAGE.json, NAME.passes.csv, NAME.surface.vtp, NAME.volume.vtu and pictures/; what is not there is left out.",
        epilog="exit codes: 0 written; 2 bad usage or input, nothing written; 130 interrupted\n\nexample:\n"
        f"  {TOOL} out/heart/heart.report.json -o out/heart/heart.report.html",
    )
    parser.add_argument("report", metavar="NAME.report.json", type=Path, help="the report of tetmesh-check")
    parser.add_argument("-o", "--output", metavar="PAGE.html", type=Path, required=True, help="the page to write")
    parser.add_argument("--name", metavar="NAME", help="what the case is called (default: the name of the report)")
    parser.add_argument("--force", action="store_true", help="replace the page if it exists already")
    parsed = parser.parse_args(argv)

    def work() -> int:
        if parsed.output.suffix != ".html":
            raise StageError(f"{parsed.output}: does not end in .html", "it is a page", "name it NAME.report.html")
        refuse_existing([parsed.output], parsed.force)
        write_text(parsed.output, page(read_case(parsed.report, parsed.name)))
        return ExitCode.OK

    return guarded(TOOL, work)
