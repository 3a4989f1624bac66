"""``tetmesh-check-index``: one page and one CSV file over many cases."""

from __future__ import annotations

import csv
import io
import os
import sys
from collections.abc import Sequence
from html import escape
from pathlib import Path
from typing import Any
from urllib.parse import quote

from tetmesh_check.context import guarded
from tetmesh_check.errors import ExitCode, InterruptedRunError, StageError
from tetmesh_check.files import refuse_existing, write_text
from tetmesh_check.page.case import Case, case_name, dig, picture_data, read_case
from tetmesh_check.page.charts import number
from tetmesh_check.page.html import duration, memory, table
from tetmesh_check.page.program import document
from tetmesh_check.parsing import program_parser

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
    line: dict[str, Any] = {
        "name": case.name,
        "outcome": case.report.get("outcome"),
        "checks": len(case.checks),
        "checks_failed": sum(check["verdict"] == "fail" for check in case.checks),
        "warnings": sum(len(report.get("warnings", [])) for report in case.stages.values()),
    }
    surface, volume = results.get("surface"), results.get("volume")
    line.update(
        surface_vertices=dig(surface, "topology", "vertices"),
        surface_triangles=dig(surface, "topology", "triangles"),
        triangle_radius_ratio_min=dig(surface, "quality", "radius_ratio", "min"),
        triangle_radius_ratio_mean=dig(surface, "quality", "radius_ratio", "mean"),
        tetrahedralizer=dig(results, "tetrahedralizer", "method"),
        tetrahedra=dig(volume, "tetrahedra"),
        radius_ratio_min=dig(volume, "quality", "radius_ratio", "min"),
        radius_ratio_mean=dig(volume, "quality", "radius_ratio", "mean"),
        min_dihedral=dig(volume, "quality", "min_dihedral", "min"),
        max_dihedral=dig(volume, "quality", "max_dihedral", "max"),
        volume_mm3=dig(volume, "volume_mm3"),
    )
    for problem in ("poisson", "conduction", "elasticity"):
        for run in ("multigrid", "jacobi"):
            line[f"{problem}_cg_{run}"] = dig(results, "solve", problem, run, "iterations")
    line.update({f"{stage}_seconds": report["seconds"] for stage, report in case.stages.items()})
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


def _row(case: Case, report: Path, output: Path) -> tuple[str, ...]:
    line = summary(case)
    kind, words = case.verdict()
    page = report.with_name(f"{case_name(report)}.report.html")
    name = escape(case.name)
    if page.is_file():
        name = f'<a href="{quote(Path(os.path.relpath(page, output.parent)).as_posix())}">{name}</a>'
    picture = ""
    if "surface" in case.pictures:
        address, width, height = picture_data(case.pictures["surface"], _THUMBNAIL_WIDTH)
        alt = f"{escape(case.name, quote=True)}: the surface"
        picture = f'<img src="{address}" width="{width}" height="{height}" alt="{alt}">'

    def known(key: str, digits: int = 3) -> str:
        return "-" if line[key] is None else number(line[key], digits)

    solved = [known(f"{problem}_cg_jacobi") for problem in ("poisson", "conduction", "elasticity")]
    return (
        picture,
        f'<b>{name}</b><br><span class="tag {kind}" title="{escape(words, quote=True)}">'
        + {"pass": "fit", "warning": "fit, with warnings", "fail": "not fit"}[kind]
        + "</span>",
        known("surface_triangles"),
        known("triangle_radius_ratio_mean"),
        known("tetrahedra"),
        f"{known('radius_ratio_min')} / {known('radius_ratio_mean')}",
        known("min_dihedral"),
        " / ".join(solved),
        duration(line["seconds"]),
        memory(line["peak_memory_bytes"]),
    )


def index(cases: Sequence[tuple[Path, Case]], output: Path) -> str:
    """Write the page.

    Parameters
    ----------
    cases
        Each with its report, which the page of the case lies beside.
    output
        Where the page goes; it links to those of the cases.
    """
    unfit = sum(case.verdict()[0] == "fail" for _, case in cases)
    verdict = (
        f"Not fit for simulation: {unfit} of {len(cases)} cases"
        if unfit
        else f"All {len(cases)} cases are fit for simulation"
    )
    head = (
        "", "case", "triangles", "mean radius ratio", "tetrahedra", "radius ratio, smallest / mean",
        "smallest dihedral", "CG: Poisson / conduction / elasticity", "all stages", "largest process",
    )  # fmt: skip
    rows = [_row(case, report, output) for report, case in cases]
    body = (
        '<header><p class="kicker">isoparticles: surface and tetrahedra</p><h1>Cases</h1>'
        f'<p class="verdict {"fail" if unfit else "pass"}">{verdict}</p></header>'
        f"<section>{table(head, rows, (0, 1), 'cases')}<p class=soft>The same in numbers: "
        f'<a href="{quote(output.with_suffix(".csv").name)}">{escape(output.with_suffix(".csv").name)}</a>. CG: iterations of conjugate '
        "gradients with Jacobi's preconditioner, where problems were solved.</p></section>"
    )
    return document("Cases: surfaces and tetrahedra", body)


def read_cases(reports: Sequence[Path]) -> list[tuple[Path, Case]]:
    """Read what is known about each case; a file that is no such report is left out with a warning.

    Parameters
    ----------
    reports
        Those of ``tetmesh-check``.

    Raises
    ------
    StageError
        If none of them is one.
    """
    cases = []
    last: StageError | None = None
    for report in reports:
        try:
            cases.append((report, read_case(report)))
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
        description="Writes a page over many cases, with links to theirs, and a CSV file beside it with a line a case.",
        epilog="exit codes: 0 written; 2 bad usage or input, nothing written; 130 interrupted\n\nexample:\n"
        f"  {TOOL} out/*/*.report.json -o out/index.html",
    )
    parser.add_argument("reports", metavar="NAME.report.json", type=Path, nargs="+", help="reports of tetmesh-check")
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
            raise StageError(f"{output}: does not end in .html", "it is a page", "name it index.html")
        refuse_existing([output, output.with_suffix(".csv")], parsed.force)
        cases = read_cases(parsed.reports)
        page, lines = index(cases, output), as_csv([summary(case) for _, case in cases])
        write_text(output.with_suffix(".csv"), lines)
        write_text(output, page)
        return ExitCode.OK

    return guarded(TOOL, work)
