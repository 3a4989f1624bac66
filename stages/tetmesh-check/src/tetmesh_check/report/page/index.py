"""``tetmesh-check-index``: one page and one CSV file over many cases."""

from __future__ import annotations

import csv
import io
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from tetmesh_check.errors import StageError
from tetmesh_check.parsing import Parser
from tetmesh_check.report.page.case import Case, dig, read_case
from tetmesh_check.report.page.program import write_page
from tetmesh_check.report.page.templates import render

TOOL = "tetmesh-check-index"
_MEASURES = {
    "surface_vertices": ("reconstruct", "check", "vertices"),
    "surface_triangles": ("reconstruct", "check", "triangles"),
    "triangle_radius_ratio_min": ("reconstruct", "check", "quality", "radius_ratio_min"),
    "triangle_radius_ratio_mean": ("reconstruct", "check", "quality", "radius_ratio_mean"),
    "tetrahedralizer": ("tetmesh-check", "tetrahedralizer", "method"),
    "tetrahedra": ("tetmesh-check", "volume", "tetrahedra"),
    "radius_ratio_min": ("tetmesh-check", "volume", "quality", "radius_ratio", "min"),
    "radius_ratio_mean": ("tetmesh-check", "volume", "quality", "radius_ratio", "mean"),
    "min_dihedral": ("tetmesh-check", "volume", "quality", "min_dihedral", "min"),
    "max_dihedral": ("tetmesh-check", "volume", "quality", "max_dihedral", "max"),
    "volume_mm3": ("tetmesh-check", "volume", "volume_mm3"),
    "poisson_cg_multigrid": ("tetmesh-check", "solve", "poisson", "multigrid", "iterations"),
    "conduction_cg_multigrid": ("tetmesh-check", "solve", "conduction", "multigrid", "iterations"),
    "elasticity_cg_multigrid": ("tetmesh-check", "solve", "elasticity", "multigrid", "iterations"),
}
"""Columns from reports: stage, and keys of its results."""


def summary(case: Case) -> dict[str, Any]:
    """Return the row of a case; unknown values are ``None``.

    Parameters
    ----------
    case
        The case.
    """
    line = {
        "name": case.name,
        "verdict": case.verdict,
        "headline": render("headline", case=case).unescape(),
        "goal": case.goal,
        "stage": dig(case.broken, "stage"),
        "input": case.input,
        "checks": len(case.checks),
        "checks_failed": len(case.failures),
        "warnings": len(case.warnings),
    }
    line |= {name: dig(case.reports, stage, "results", *keys) for name, (stage, *keys) in _MEASURES.items()}
    line |= {f"{stage['stage']}_seconds": stage["seconds"] for stage in case.stages}
    return line | {"seconds": case.seconds, "peak_memory_bytes": case.peak_memory}


def as_csv(lines: Sequence[dict[str, Any]]) -> str:
    """Write rows as CSV, with all columns that any row has.

    Parameters
    ----------
    lines
        Rows of :func:`summary`.
    """
    columns = list(dict.fromkeys(name for line in lines for name in line))
    stream = io.StringIO()
    writer = csv.DictWriter(stream, columns, lineterminator="\n")
    writer.writeheader()
    writer.writerows(lines)
    return stream.getvalue()


def read_cases(statuses: Sequence[Path]) -> list[Case]:
    """Read the cases; omit files that are not a status, with a warning.

    Parameters
    ----------
    statuses
        The status files.

    Raises
    ------
    StageError
        If no file is a status.
    """
    cases, errors = [], []
    for status in statuses:
        try:
            cases.append(read_case(status.resolve()))
        except StageError as error:
            print(f"warning: left out of the index: {error.what}", file=sys.stderr)
            errors.append(error)
    if not cases:
        raise errors[-1]
    return cases


def main(argv: Sequence[str] | None = None) -> int:
    """Run the program.

    Parameters
    ----------
    argv
        The command line without the program's name; that of the process by default.
    """
    parser = Parser(
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

    def make(folder: Path) -> dict[str, str]:
        cases = read_cases(parsed.statuses)
        lines = [summary(case) for case in cases]
        rows = list(zip(cases, lines, strict=True))
        name = parsed.output.with_suffix(".csv").name
        return {".csv": as_csv(lines), ".html": render("index", rows=rows, folder=folder, csv=name)}

    return write_page(TOOL, parsed, "index.html", (".csv", ".html"), make)
