#!/usr/bin/env python3
"""Make docs/results.md from its template and the rows of paper.py and growth.py.

    tests/results/page.py            # writes docs/results.md; or: make results-page
    tests/results/page.py --check    # whether the page matches the template and the rows

`{{name}}` in docs/results/template.md stands for a table or a number of `Page.pieces`. The text
from `{{if gpu}}` to `{{else}}` applies to rows with a GPU, the text from there to `{{end}}` to rows
without one. If a row is missing, the program ends with an error that contains the name of the row.
The figures of the paper are in `printed.py`.
"""

from __future__ import annotations

import argparse
import json
import math
import re
import sys
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import printed
from growth import COUNTS, MATERIALS, SERIES, STAGES, VOLUMES
from paper import H_OF_TABLE_3, LARGEST_H, MODES, OBJECTS, PACKING, SEEDS, SMALLEST_H, SWEEP, cases

Row = dict[str, Any]


class MissingRowError(Exception):
    """The JSON file lacks a row that the page needs."""


def load(path: Path) -> tuple[Row, dict[str, Row]]:
    """Return the head and the rows of a JSON file."""
    told = json.loads(path.read_text(encoding="utf-8"))
    return told["head"], told["rows"]


def table(columns: list[str], lines: list[list[str]]) -> str:
    """Format a Markdown table."""
    return "\n".join(["| " + " | ".join(line) + " |" for line in [columns, ["---"] * len(columns), *lines]])


def both(quality: Row) -> str:
    """Format the mean and minimum radius ratio."""
    return f"{quality['mean']:.3f} / {quality['smallest']:.2f}"


def span(values: list[float], digits: int) -> str:
    """Format the minimum and maximum."""
    return f"{min(values):,.{digits}f} to {max(values):,.{digits}f}"


def exponent(points: list[tuple[float, float]]) -> float | None:
    """Return the least-squares slope of log y over log x; None for fewer than three points."""
    if len(points) < 3:
        return None
    logs = [(math.log(x), math.log(y)) for x, y in points]
    mean_x, mean_y = (sum(log[i] for log in logs) / len(logs) for i in (0, 1))
    return sum((x - mean_x) * (y - mean_y) for x, y in logs) / sum((x - mean_x) ** 2 for x, _ in logs)


Runs = dict[str, Row]
"""Rows of a case by engine: cpu-1, cpu-all and, with a GPU, gpu."""


@dataclass
class Column:
    """A column of Tables 1 to 4."""

    heading: str
    cell: Callable[[str, Runs], str]
    """Function that returns the cell from the name and the rows of the case."""
    of_gpu: bool = False
    """Whether the column is omitted without a GPU."""


def pair(runs: Runs, key: str, form: str) -> str:
    """Format a figure of the CPU and, if there is a GPU, of the GPU."""
    return ", ".join(format(runs[engine][key], form) for engine in ("cpu-1", "gpu") if engine in runs)


def speed_up(runs: Runs) -> float:
    """Return the seconds of one CPU thread divided by the seconds of the GPU."""
    seconds: float = runs["cpu-1"]["settle"]
    device: float = runs["gpu"]["device"]
    return seconds / device


def lost(row: Row) -> float:
    """Return the percentage of the seeds of Table 3 that were deleted."""
    left: int = row["particles"]
    return 100 * (1 - left / int(row["seeds"]))


SWEPT = [f"{epsilon}/{delta} level {level}" for epsilon, delta, level in SWEEP]
OF_SWEEP = dict(zip(SWEPT, printed.TABLE_4, strict=True))

TIMES = [
    Column("one thread, s", lambda _, runs: f"{runs['cpu-1']['settle']:.2f}"),
    Column("all cores, s", lambda _, runs: f"{runs['cpu-all']['settle']:.2f}"),
    Column("GPU, s", lambda _, runs: f"{runs['gpu']['device']:.3f}", of_gpu=True),
    Column("GPU's process, s", lambda _, runs: f"{runs['gpu']['wall']:.2f}", of_gpu=True),
    Column("speed-up", lambda _, runs: f"{speed_up(runs):.1f}", of_gpu=True),
    Column("passes", lambda _, runs: pair(runs, "passes", "d")),
    Column("energy over ideal", lambda _, runs: pair(runs, "energy_ratio", ".3f")),
]
"""Columns of Tables 2, 3 and 4."""


def organ_columns(figures: Callable[[str], list[str]], *headings: str) -> list[Column]:
    """Return the column of the organ names and the columns of the printed figures."""
    told = [Column(heading, lambda name, _, i=i: figures(name)[i]) for i, heading in enumerate(headings)]  # type: ignore[misc]
    return [Column("organ", lambda name, _: f"{name} ({printed.organ(name)})"), *told]


TABLE_1 = [
    *organ_columns(printed.quality, "printed, CPU", "printed, GPU"),
    Column("particles, CPU", lambda _, runs: both(runs["cpu-all"]["raw"])),
    Column("particles, GPU", lambda _, runs: both(runs["gpu"]["raw"]), of_gpu=True),
    Column(
        "GPU over CPU, %",
        lambda _, runs: f"{100 * (runs['gpu']['raw']['mean'] / runs['cpu-all']['raw']['mean'] - 1):+.2f}",
        of_gpu=True,
    ),
    Column("mesh, CPU", lambda _, runs: both(runs["cpu-all"]["finished"])),
    Column("mesh, GPU", lambda _, runs: both(runs["gpu"]["finished"]), of_gpu=True),
    Column("exit codes", lambda _, runs: ", ".join(str(run["exit_code"]) for run in runs.values())),
]
TABLE_2 = [
    *organ_columns(printed.times, "printed: CPU, s", "printed: GPU, s", "printed: speed-up"),
    Column("particles", lambda _, runs: pair(runs, "particles", ",")),
    *TIMES,
]
TABLE_3 = [
    Column("seeds", lambda name, _: f"{int(name):,}"),
    Column("printed: deleted, %", lambda name, _: ", ".join(f"{part:.1f}" for part in printed.lost(int(name)))),
    Column("printed: speed-up", lambda name, _: f"{printed.TABLE_3[int(name)][0] / printed.TABLE_3[int(name)][2]:.1f}"),
    Column("left", lambda _, runs: pair(runs, "particles", ",")),
    Column(
        "deleted, %", lambda _, runs: ", ".join(f"{lost(runs[key]):.1f}" for key in ("cpu-1", "gpu") if key in runs)
    ),
    *TIMES,
]
TABLE_4 = [
    Column("epsilon / delta, level", lambda name, _: name.replace("/", " / ").replace(" level", ", level")),
    Column("printed: particles", lambda name, _: "{1:,}, {3:,}".format(*OF_SWEEP[name])),
    Column("printed: speed-up", lambda name, _: f"{OF_SWEEP[name][0] / OF_SWEEP[name][2]:.1f}"),
    Column("h, mm", lambda _, runs: f"{runs['cpu-1']['h'][0]:.2f} to {runs['cpu-1']['h'][2]:.2f}"),
    Column("particles", lambda _, runs: pair(runs, "particles", ",")),
    *TIMES,
]
CASES = {"1": list(OBJECTS), "2": list(OBJECTS), "3": [str(count) for count in SEEDS], "4": SWEPT}
"""Names of the cases of each table."""


class Page:
    """All values that the template may contain by name."""

    def __init__(self, paper: tuple[Row, dict[str, Row]], growth: tuple[Row, dict[str, Row]]) -> None:
        self.head, self.rows = paper
        self.growth_head, self.growth = growth
        self.gpu = self.head["adapter"] is not None
        self.stems = {(case.table, case.name, case.mode): case.stem for case in cases(["1", "2", "3", "4"], False)}

    def row(self, place: str, name: str, mode: str, engine: str) -> Row:
        """Return a row of Tables 1 to 4."""
        stem = self.stems["2" if place == "1" else place, name, mode]
        key = f"1 {stem}.{engine}" if place == "1" else f"{stem} {engine}"
        if key not in self.rows:
            raise MissingRowError(f"no row '{key}' in the rows of paper.py")
        return self.rows[key]

    def runs(self, place: str, name: str, mode: str = "as printed") -> Runs:
        """Return the rows of a case by engine."""
        engines = [*([] if place == "1" else ["cpu-1"]), "cpu-all", *(["gpu"] if self.gpu else [])]
        return {engine: self.row(place, name, mode, engine) for engine in engines}

    def table(self, place: str, columns: list[Column], mode: str = "as printed") -> str:
        """Format one of Tables 1 to 4."""
        shown = [column for column in columns if self.gpu or not column.of_gpu]
        of_case = {name: self.runs(place, name, mode) for name in CASES[place]}
        lines = [[column.cell(name, runs) for column in shown] for name, runs in of_case.items()]
        return table([column.heading for column in shown], lines)

    def sizes(self, series: str) -> list[int]:
        """Return the sizes of a series."""
        if series == "cores":
            return sorted({int(row["size"]) for row in self.growth.values() if row["series"] == "cores"})
        return {"volume": [edge**3 for edge in VOLUMES], "particles": COUNTS, "materials": MATERIALS}[series]

    def grown(self, series: str, size: int, stage: str, engine: str) -> Row | None:
        """Return a row of a series; None if this or an earlier stage was omitted as too slow."""
        key = f"{series} {size:09.0f} {stage}{engine and ' ' + engine}"
        if key in self.growth:
            row = self.growth[key]
            return None if "left_out" in row else row
        begun = f"{series} {size:09.0f} "
        if any("left_out" in row for name, row in self.growth.items() if name.startswith(begun)):
            return None
        raise MissingRowError(f"no row '{key}' in the rows of growth.py")

    def columns(self, series: str) -> list[tuple[str, str, str]]:
        """Return the stage, engine and heading of each column."""
        engines = ["cpu"] if series == "cores" or self.growth_head["adapter"] is None else ["cpu", "gpu"]
        found = []
        for stage in STAGES:
            if stage == "particles":
                found += [(stage, engine, f"particles, {engine.upper()}") for engine in engines]
            else:
                found.append((stage, "", stage))
        return found

    def table_growth(self, series: str) -> str:
        """Format the seconds and MiB of every stage by size, with the fitted exponents."""
        columns, lines = self.columns(series), []
        points: dict[str, list[tuple[float, float]]] = {}
        memory: dict[str, list[tuple[float, float]]] = {}
        for size in self.sizes(series):
            line = [f"{round(size ** (1 / 3))}³" if series == "volume" else f"{size:,}"]
            for stage, engine, heading in columns:
                row = self.grown(series, size, stage, engine)
                if row is None:
                    line.append("-")
                    continue
                failed = " (exit code 1)" if row.get("exit_code") else ""
                line.append(f"{row['seconds']:.2f}, {row['bytes'] / 2**20:,.0f}{failed}")
                points.setdefault(heading, []).append((size, row["seconds"]))
                memory.setdefault(heading, []).append((size, row["bytes"]))
            lines.append(line)
        for name, found in (("exponent of time", points), ("exponent of memory", memory)):
            fits = [exponent(found.get(heading, [])[-4:]) for *_, heading in columns]
            lines.append([name, *("-" if fit is None else f"{fit:.2f}" for fit in fits)])
        first = {"volume": "voxels", "particles": "particles asked for", "cores": "threads", "materials": "materials"}[
            series
        ]
        return table([first, *(f"{heading}: s, MiB" for *_, heading in columns)], lines)

    def machine(self) -> str:
        """Describe the machine, date and commit of the figures."""
        head = self.head
        gpu = str(head["adapter"]).split(" (")[0] if self.gpu else "no GPU"
        return f"{head['processor']}, {head['cores']} cores, {gpu}; {head['date']}, commit {head['commit']}"

    def pieces(self) -> dict[str, Callable[[], str]]:
        """Return the functions that make the text for each name in the template."""

        def difference(key: str, mode: str) -> str:
            every = [self.runs("1", name, mode) for name in OBJECTS]
            return (
                f"{max(100 * abs(runs['gpu'][key]['mean'] / runs['cpu-all'][key]['mean'] - 1) for runs in every):.2f}"
            )

        def raw(key: str, mode: str) -> str:
            every = [run for name in OBJECTS for run in self.runs("1", name, mode).values()]
            return span([run["raw"][key] for run in every], 3 if key == "mean" else 2)

        def ribs(engine: str, key: str, digits: int = 2, mode: str = "as printed") -> str:
            return f"{self.row('2', 'torso ribcage', mode, engine)[key]:.{digits}f}"

        def over(place: str, figure: Callable[[Row], float], digits: int) -> str:
            every = [run for name in CASES[place] for run in self.runs(place, name).values()]
            return span([figure(run) for run in every], digits)

        def speed_ups(place: str) -> str:
            return span([speed_up(self.runs(place, name)) for name in CASES[place]], 1)

        def speed_ups_of_defaults() -> str:
            return span([speed_up(self.runs("2", name, "defaults")) for name in OBJECTS], 0)

        return {
            "machine": self.machine,
            "side by side": lambda: str(self.head["beside"]),
            "growth machine": lambda: f"{self.growth_head['date']}, commit {self.growth_head['commit']}",
            **{f"table 1 {mode}": partial(self.table, "1", TABLE_1, mode) for mode in MODES},
            **{f"table 2 {mode}": partial(self.table, "2", TABLE_2, mode) for mode in MODES},
            "table 3": partial(self.table, "3", TABLE_3),
            "table 4": partial(self.table, "4", TABLE_4),
            "packing": lambda: f"{PACKING:g}",
            "h of table 3": lambda: f"{H_OF_TABLE_3:g}",
            "largest h": lambda: f"{LARGEST_H:g}",
            **{f"smallest h of level {level}": partial(format, h, "g") for level, h in SMALLEST_H.items()},
            **{f"{key} ratios {mode}": partial(raw, key, mode) for key in ("mean", "smallest") for mode in MODES},
            **{f"difference of particles {mode}": partial(difference, "raw", mode) for mode in MODES},
            **{f"difference of meshes {mode}": partial(difference, "finished", mode) for mode in MODES},
            "speed-ups of the defaults": speed_ups_of_defaults,
            "devices of table 4": lambda: span([self.runs("4", name)["gpu"]["device"] for name in CASES["4"]], 2),
            "ribcage device": partial(ribs, "gpu", "device", 3),
            "ribcage process": partial(ribs, "gpu", "wall"),
            "ribcage device defaults": partial(ribs, "gpu", "device", 3, "defaults"),
            "ribcage thread defaults": partial(ribs, "cpu-1", "settle", 1, "defaults"),
            "ribcage thread": partial(ribs, "cpu-1", "settle", 1),
            "ribcage cores": partial(ribs, "cpu-all", "settle"),
            **{f"speed-ups of table {place}": partial(speed_ups, place) for place in "234"},
            **{
                f"energies of table {place}": partial(over, place, lambda run: run["energy_ratio"], 2)
                for place in "234"
            },
            "deleted": partial(over, "3", lost, 1),
            "counts of table 4": partial(over, "4", lambda run: run["particles"], 0),
            **{f"growth by {series}": partial(self.table_growth, series) for series in SERIES},
        }

    def text(self, template: str) -> str:
        """Fill in the template."""
        pieces = self.pieces()

        def piece(match: re.Match[str]) -> str:
            name = match.group(1)
            if name not in pieces:
                raise MissingRowError(f"the template asks for '{name}', which is none of {', '.join(pieces)}")
            return pieces[name]()

        # {{if gpu}} ... {{else}} ... {{end}}
        choice = re.compile(r"\{\{if gpu\}\}(.*?)\{\{else\}\}(.*?)\{\{end\}\}", re.DOTALL)
        template = choice.sub(lambda match: match.group(1 if self.gpu else 2), template)
        return re.sub(r"\n{3,}", "\n\n", re.sub(r"\{\{([^}]+)\}\}", piece, template))


def main() -> int:
    """Run the program; return 1 if the page cannot be made or, with --check, differs."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "--folder", type=Path, default=Path("docs/results"), help="of template.md, paper.json and growth.json"
    )
    parser.add_argument("--output", "-o", type=Path, default=Path("docs/results.md"))
    parser.add_argument("--check", action="store_true", help="write nothing: 1 if the page differs")
    arguments = parser.parse_args()
    template = (arguments.folder / "template.md").read_text(encoding="utf-8")
    try:
        page = Page(load(arguments.folder / "paper.json"), load(arguments.folder / "growth.json"))
        text = page.text(template)
    except (MissingRowError, FileNotFoundError) as why:
        print(
            f"{why}\n  why it matters: the page would have a gap\n"
            "  what to do: make bench-paper, make bench-growth; rows that are there are not run again",
            file=sys.stderr,
        )
        return 1
    if arguments.check:
        found = arguments.output.read_text(encoding="utf-8") if arguments.output.exists() else ""
        if found != text:
            print(
                f"{arguments.output} is not what template and rows give; make results-page writes it", file=sys.stderr
            )
        return int(found != text)
    arguments.output.write_text(text, encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
