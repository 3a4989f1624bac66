"""``tetmesh-check-index``: one page and one CSV file over many cases."""

from __future__ import annotations

import csv
import io
import os
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any
from urllib.parse import quote

from tetmesh_check.context import guarded
from tetmesh_check.errors import ExitCode, InterruptedRunError, StageError
from tetmesh_check.files import refuse_existing, write_text
from tetmesh_check.parsing import program_parser
from tetmesh_check.report.page.case import STAGES, Case, count_of, dig, read_case
from tetmesh_check.report.page.html import picture_data
from tetmesh_check.report.page.program import document
from tetmesh_check.report.page.templates import render

TOOL = "tetmesh-check-index"
_THUMBNAIL_WIDTH = 320


def summary(case: Case) -> dict[str, Any]:
    """Condense a case to one line; what is not known is ``None``.

    Parameters
    ----------
    case
        The case.
    """
    results = case.results
    stopped = case.broken
    line: dict[str, Any] = {
        "name": case.name,
        "verdict": case.verdict,
        "headline": case.headline,
        "goal": case.goal,
        "stage": stopped.name if stopped else None,
        "input": str(case.input) if case.input else None,
        "checks": len(case.checks),
        "checks_failed": len(case.failures),
        "warnings": len(case.warnings),
    }
    check = dig(case.reports, "reconstruct", "results", "check")
    volume = results.get("volume")
    line.update(
        surface_vertices=dig(check, "vertices"),
        surface_triangles=dig(check, "triangles"),
        triangle_radius_ratio_min=dig(check, "quality", "radius_ratio_min"),
        triangle_radius_ratio_mean=dig(check, "quality", "radius_ratio_mean"),
        tetrahedralizer=dig(results, "tetrahedralizer", "method"),
        tetrahedra=dig(volume, "tetrahedra"),
        radius_ratio_min=dig(volume, "quality", "radius_ratio", "min"),
        radius_ratio_mean=dig(volume, "quality", "radius_ratio", "mean"),
        min_dihedral=dig(volume, "quality", "min_dihedral", "min"),
        max_dihedral=dig(volume, "quality", "max_dihedral", "max"),
        volume_mm3=dig(volume, "volume_mm3"),
    )
    for problem in ("poisson", "conduction", "elasticity"):
        line[f"{problem}_cg_multigrid"] = dig(results, "solve", problem, "multigrid", "iterations")
    line.update({f"{stage.name}_seconds": stage.seconds for stage in case.stages})
    line.update(seconds=case.seconds, peak_memory_bytes=int(case.peak_memory))
    return line


def as_csv(lines: Sequence[dict[str, Any]]) -> str:
    """Write the summaries as CSV, with every column that any of them has.

    Parameters
    ----------
    lines
        Those of :func:`summary`.
    """
    columns = list(dict.fromkeys(name for line in lines for name in line))
    stream = io.StringIO()
    writer = csv.DictWriter(stream, columns, lineterminator="\n")
    writer.writeheader()
    writer.writerows(lines)
    return stream.getvalue()


_TAGS = {
    "passed": "fit", "warning": "fit", "failed": "not fit", "error": "no mesh", "interrupted": "interrupted", "running": "running",
}  # fmt: skip


def _tag(case: Case) -> str:
    """The verdict in a word or two."""
    words = _TAGS.get(case.verdict, "no mesh")
    if case.goal not in ("mesh", STAGES[-1]):
        words = {"fit": "made", "not fit": "not valid", "no mesh": "not made"}.get(words, words)
    if case.accepted:
        words += " but for accepted elements"
    if case.verdict in ("passed", "warning") and case.warnings:
        words += f", {count_of(len(case.warnings), 'warning')}"
    if case.verdict == "error" and case.broken:
        words += f": {case.broken.name}"
    return words


def _row(case: Case, output: Path) -> dict[str, Any]:
    there = case.page is not None and case.page.is_file()
    picture = case.pictures.get("surface")
    return {
        "case": case,
        "line": summary(case),
        "tag": _tag(case),
        "link": quote(Path(os.path.relpath(case.page, output.parent)).as_posix()) if case.page and there else "",
        "picture": picture and picture_data(picture, _THUMBNAIL_WIDTH),
    }


def _verdict(cases: Sequence[Case]) -> tuple[str, str]:
    """Class and words of the verdict over all cases."""
    unfit = sum(case.kind == "fail" for case in cases)
    warned = sum(len(case.warnings) for case in cases)
    open_ends = sum(case.verdict in ("interrupted", "running") for case in cases)
    total = count_of(len(cases), "case")
    if unfit:
        return "fail", f"Not fit: {unfit} of {total}"
    if open_ends:
        return "warning", f"Not finished: {open_ends} of {total}"
    if warned:
        return "warning", f"{total}, none failed, {count_of(warned, 'warning')}"
    return "pass", f"{total}, none failed, no warnings"


def index(cases: Sequence[Case], output: Path) -> str:
    """Write the page.

    Parameters
    ----------
    cases
        The cases to list, each with the path of its page.
    output
        Path of the page, which links to the pages of the cases.
    """
    kind, verdict = _verdict(cases)
    rows = [_row(case, output) for case in cases]
    body = render("index", kind=kind, verdict=verdict, rows=rows, csv=output.with_suffix(".csv").name)
    return document("Cases of isoparticles", body)


def read_cases(statuses: Sequence[Path]) -> list[Case]:
    """Read what is known about each case; a file that is no status is left out with a warning.

    Parameters
    ----------
    statuses
        Those of the cases.

    Raises
    ------
    StageError
        If none of them is one.
    """
    cases = []
    last: StageError | None = None
    for status in statuses:
        try:
            cases.append(read_case(Path(os.path.realpath(status))))
        except InterruptedRunError:
            raise
        except StageError as error:
            print(f"warning: left out of the index: {error.what}", file=sys.stderr)
            last = error
    if last is not None and not cases:
        raise last
    return cases


def main(argv: Sequence[str] | None = None) -> int:
    """Run the program.

    Parameters
    ----------
    argv
        The command line without the program's name; that of the process by default.
    """
    parser = program_parser(
        TOOL,
        description="Writes a page with a row for each case, failed ones included, and a link to the page of the case. It also writes the "
        "rows as a CSV file. It reads NAME.status.json of each case, which make writes, and the reports that are listed there.",
        epilog="exit codes: 0 written; 2 bad usage or input, nothing written; 130 interrupted\n\nexample:\n"
        f"  {TOOL} out/*/*.status.json -o out/index.html",
    )
    parser.add_argument("statuses", metavar="NAME.status.json", type=Path, nargs="+", help="the status of each case")
    parser.add_argument(
        "-o",
        "--output",
        metavar="INDEX.html",
        type=Path,
        required=True,
        help="the page to write; INDEX.csv goes beside it",
    )
    parser.add_argument("--force", action="store_true", help="replace page and CSV if they exist already")
    parsed = parser.parse_args(argv)
    output: Path = parsed.output

    def work() -> int:
        if output.suffix != ".html":
            raise StageError(f"{output}: does not end in .html", "the page is an HTML file", "name it index.html")
        refuse_existing([output, output.with_suffix(".csv")], parsed.force)
        cases = read_cases(parsed.statuses)
        page = index(cases, Path(os.path.realpath(output)))
        lines = as_csv([summary(case) for case in cases])
        write_text(output.with_suffix(".csv"), lines)
        write_text(output, page)
        return ExitCode.OK

    return guarded(TOOL, work)
