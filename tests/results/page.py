#!/usr/bin/env python3
"""docs/results.md of its template and of the rows that paper.py and growth.py have left.

    tests/results/page.py            # writes docs/results.md; or: make results-page
    tests/results/page.py --check    # whether it is what the template and the rows give

`{{name}}` in docs/results/template.md stands for a table or a number of `Page.pieces`. A row that is not there ends it with its name. The
printed figures of the paper stand in `printed.py` beside this file.
"""

from __future__ import annotations

import argparse
import json
import math
import re
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import printed
from growth import COUNTS, MATERIALS, SERIES, STAGES, VOLUMES
from paper import H_OF_TABLE_3, LARGEST_H, MODES, OBJECTS, PACKING, SEEDS, SMALLEST_H, SWEEP, cases

Row = dict[str, Any]


class MissingRowError(Exception):
    """A row that the page asks for and the JSON has not."""


def load(path: Path) -> tuple[Row, dict[str, Row]]:
    """Head and rows of a file of rows."""
    told = json.loads(path.read_text(encoding="utf-8"))
    return told["head"], told["rows"]


def table(columns: list[str], lines: list[list[str]]) -> str:
    """A table of Markdown."""
    return "\n".join(["| " + " | ".join(line) + " |" for line in [columns, ["---"] * len(columns), *lines]])


def both(quality: Row) -> str:
    """Mean and smallest radius ratio."""
    return f"{quality['mean']:.3f} / {quality['smallest']:.2f}"


def span(values: list[float], digits: int) -> str:
    """The least and the greatest."""
    return f"{min(values):,.{digits}f} to {max(values):,.{digits}f}"


def exponent(points: list[tuple[float, float]]) -> float | None:
    """The slope of the line through the logarithms, by least squares; None of fewer than three points."""
    if len(points) < 3:
        return None
    logs = [(math.log(x), math.log(y)) for x, y in points]
    mean_x, mean_y = (sum(log[i] for log in logs) / len(logs) for i in (0, 1))
    return sum((x - mean_x) * (y - mean_y) for x, y in logs) / sum((x - mean_x) ** 2 for x, _ in logs)


class Page:
    """All that the template may name."""

    def __init__(self, paper: tuple[Row, dict[str, Row]], growth: tuple[Row, dict[str, Row]]) -> None:
        self.head, self.rows = paper
        self.growth_head, self.growth = growth
        self.stems = {(case.table, case.name, case.mode): case.stem for case in cases(["1", "2", "3", "4"], False)}

    def row(self, place: str, name: str, mode: str, engine: str) -> Row:
        """A row of Tables 1 to 4."""
        stem = self.stems["2" if place == "1" else place, name, mode]
        key = f"1 {stem}.{engine}" if place == "1" else f"{stem} {engine}"
        if key not in self.rows:
            raise MissingRowError(f"no row '{key}' in the rows of paper.py")
        return self.rows[key]

    def speed_up(self, place: str, name: str, mode: str) -> float:
        """Device seconds over those of one thread."""
        seconds: float = self.row(place, name, mode, "cpu-1")["settle"]
        device: float = self.row(place, name, mode, "gpu")["device"]
        return seconds / device

    def table_1(self, mode: str) -> str:
        """Quality, CPU beside GPU."""
        lines = []
        for name in OBJECTS:
            cpu, gpu = (self.row("1", name, mode, engine) for engine in ("cpu-all", "gpu"))
            off = 100 * (gpu["raw"]["mean"] / cpu["raw"]["mean"] - 1)
            lines.append(
                [
                    f"{name} ({printed.organ(name)})", *printed.quality(name),
                    both(cpu["raw"]), both(gpu["raw"]), f"{off:+.2f}", both(cpu["finished"]), both(gpu["finished"]),
                    f"{cpu['exit_code']}, {gpu['exit_code']}",
                ]
            )  # fmt: skip
        columns = ["organ", "printed, CPU", "printed, GPU", "particles, CPU", "particles, GPU", "GPU over CPU, %"]
        return table([*columns, "mesh, CPU", "mesh, GPU", "exit codes"], lines)

    def table_2(self, mode: str) -> str:
        """Times of the organs."""
        lines = []
        for name in OBJECTS:
            one, every, gpu = (self.row("2", name, mode, engine) for engine in ("cpu-1", "cpu-all", "gpu"))
            lines.append(
                [
                    f"{name} ({printed.organ(name)})", *printed.times(name), f"{one['particles']:,}", f"{gpu['particles']:,}",
                    f"{one['settle']:.2f}", f"{every['settle']:.2f}", f"{gpu['device']:.3f}", f"{gpu['wall']:.2f}",
                    f"{self.speed_up('2', name, mode):.0f}", f"{one['passes']}, {gpu['passes']}",
                    f"{one['energy_ratio']:.3f}, {gpu['energy_ratio']:.3f}",
                ]
            )  # fmt: skip
        columns = [
            "organ",
            "printed: CPU, s",
            "GPU, s",
            "speed-up",
            "particles, CPU",
            "GPU",
            "one thread, s",
            "all cores, s",
        ]
        return table([*columns, "GPU, s", "GPU's process, s", "speed-up", "passes", "energy over ideal"], lines)

    def lost(self, seeds: int, engine: str) -> float:
        """Percent of the seeds of Table 3 that were deleted."""
        row = self.row("3", str(seeds), "as printed", engine)
        left: int = row["particles"]
        return 100 * (1 - left / int(row["seeds"]))

    def table_3(self) -> str:
        """Seeds without insertion."""
        lines = []
        for seeds in SEEDS:
            rows = [self.row("3", str(seeds), "as printed", engine) for engine in ("cpu-1", "cpu-all", "gpu")]
            one, every, gpu = rows
            told = printed.TABLE_3[seeds]
            lines.append(
                [
                    f"{seeds:,}", f"{100 * (1 - told[1] / seeds):.1f}, {100 * (1 - told[3] / seeds):.1f}", f"{told[0] / told[2]:.1f}",
                    f"{one['particles']:,}, {gpu['particles']:,}", f"{self.lost(seeds, 'cpu-1'):.1f}, {self.lost(seeds, 'gpu'):.1f}",
                    f"{one['energy_ratio']:.3f}, {gpu['energy_ratio']:.3f}", f"{one['passes']}, {gpu['passes']}",
                    f"{one['settle']:.2f}", f"{every['settle']:.2f}", f"{gpu['device']:.3f}",
                    f"{self.speed_up('3', str(seeds), 'as printed'):.0f}",
                ]
            )  # fmt: skip
        columns = [
            "seeds",
            "printed: deleted, %",
            "speed-up",
            "left, CPU, GPU",
            "deleted, %",
            "energy over ideal",
            "passes",
        ]
        return table([*columns, "one thread, s", "all cores, s", "GPU, s", "speed-up"], lines)

    def table_4(self) -> str:
        """The sweep over epsilon and delta."""
        lines = []
        for (epsilon, delta, level), told in zip(SWEEP, printed.TABLE_4, strict=True):
            name = f"{epsilon}/{delta} level {level}"
            one, every, gpu = (self.row("4", name, "as printed", engine) for engine in ("cpu-1", "cpu-all", "gpu"))
            lines.append(
                [
                    f"{epsilon} / {delta}, {level}", f"{told[1]:,}, {told[3]:,}", f"{told[0] / told[2]:.1f}",
                    f"{one['h'][0]:.2f} to {one['h'][2]:.2f}", f"{one['particles']:,}, {gpu['particles']:,}",
                    f"{one['energy_ratio']:.3f}, {gpu['energy_ratio']:.3f}", f"{one['passes']}, {gpu['passes']}",
                    f"{one['settle']:.2f}", f"{every['settle']:.2f}", f"{gpu['device']:.3f}", f"{self.speed_up('4', name, 'as printed'):.0f}",
                ]
            )  # fmt: skip
        columns = ["epsilon / delta, level", "printed: particles, CPU, GPU", "speed-up", "h, mm", "particles, CPU, GPU"]
        return table(
            [*columns, "energy over ideal", "passes", "one thread, s", "all cores, s", "GPU, s", "speed-up"], lines
        )

    def sizes(self, series: str) -> list[int]:
        """The sizes of a series."""
        if series == "cores":
            return sorted({int(row["size"]) for row in self.growth.values() if row["series"] == "cores"})
        return {"volume": [edge**3 for edge in VOLUMES], "particles": COUNTS, "materials": MATERIALS}[series]

    def grown(self, series: str, size: int, stage: str, engine: str) -> Row | None:
        """A row of a series; None where it, or a stage before it, was left out as too long."""
        key = f"{series} {size:09.0f} {stage}{engine and ' ' + engine}"
        if key in self.growth:
            row = self.growth[key]
            return None if "left_out" in row else row
        begun = f"{series} {size:09.0f} "
        if any("left_out" in row for name, row in self.growth.items() if name.startswith(begun)):
            return None
        raise MissingRowError(f"no row '{key}' in the rows of growth.py")

    def columns(self, series: str) -> list[tuple[str, str, str]]:
        """Stage, engine and heading."""
        engines = ["cpu"] if series == "cores" else ["cpu", "gpu"]
        found = []
        for stage in STAGES:
            if stage == "particles":
                found += [(stage, engine, f"particles, {engine.upper()}") for engine in engines]
            else:
                found.append((stage, "", stage))
        return found

    def table_growth(self, series: str) -> str:
        """Seconds and MiB of every stage by size, and the exponents."""
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
                line.append(f"{row['seconds']:.2f}, {row['bytes'] / 2**20:,.0f}")
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
        """Where and of what the figures are."""
        head = self.head
        gpu = str(head["adapter"]).split(" (")[0]
        return f"{head['processor']}, {head['cores']} cores, {gpu}; {head['date']}, commit {head['commit']}"

    def pieces(self) -> dict[str, Callable[[], str]]:
        """What stands for each name of the template."""
        organs = [(name, mode) for name in OBJECTS for mode in MODES]
        printed_rows = [
            *(("2", name, "as printed") for name in OBJECTS), *(("4", f"{e}/{d} level {n}", "as printed") for e, d, n in SWEEP)
        ]  # fmt: skip

        def difference(key: str) -> str:
            found = [[self.row("1", *organ, engine)[key]["mean"] for engine in ("gpu", "cpu-all")] for organ in organs]
            return f"{max(100 * abs(gpu / cpu - 1) for gpu, cpu in found):.2f}"

        def ribs(engine: str, key: str, digits: int = 2) -> str:
            return f"{self.row('2', 'torso ribcage', 'as printed', engine)[key]:.{digits}f}"

        def energies(rows: list[tuple[str, str, str]]) -> str:
            return span([self.row(*row, engine)["energy_ratio"] for row in rows for engine in ("cpu-1", "gpu")], 2)

        return {
            "machine": self.machine,
            "side by side": lambda: str(self.head["beside"]),
            "growth machine": lambda: f"{self.growth_head['date']}, commit {self.growth_head['commit']}",
            "table 1 as printed": lambda: self.table_1("as printed"),
            "table 1 defaults": lambda: self.table_1("defaults"),
            "table 2 as printed": lambda: self.table_2("as printed"),
            "table 2 defaults": lambda: self.table_2("defaults"),
            "table 3": self.table_3,
            "table 4": self.table_4,
            "packing": lambda: f"{PACKING:g}",
            "h of table 3": lambda: f"{H_OF_TABLE_3:g}",
            "largest h": lambda: f"{LARGEST_H:g}",
            "smallest h of level 4": lambda: f"{SMALLEST_H[4]:g}",
            "smallest h of level 7": lambda: f"{SMALLEST_H[7]:g}",
            "difference of particles": lambda: difference("raw"),
            "difference of meshes": lambda: difference("finished"),
            "ribcage device": lambda: ribs("gpu", "device", 3),
            "ribcage process": lambda: ribs("gpu", "wall"),
            "ribcage thread": lambda: ribs("cpu-1", "settle", 1),
            "ribcage cores": lambda: ribs("cpu-all", "settle"),
            "speed-ups of table 2": lambda: span([self.speed_up("2", name, "as printed") for name in OBJECTS], 0),
            "speed-ups of table 3": lambda: span([self.speed_up("3", str(n), "as printed") for n in SEEDS], 0),
            "speed-ups of table 4": lambda: span([self.speed_up(*row) for row in printed_rows if row[0] == "4"], 0),
            "deleted": lambda: span([self.lost(n, engine) for n in SEEDS for engine in ("cpu-1", "gpu")], 1),
            "energies as printed": lambda: energies(printed_rows),
            "energies of table 3": lambda: energies([("3", str(n), "as printed") for n in SEEDS]),
            "counts of table 4": lambda: span([self.row(*row, "gpu")["particles"] for row in printed_rows if row[0] == "4"], 0),
            **{f"growth by {series}": partial(self.table_growth, series) for series in SERIES},
        }  # fmt: skip

    def text(self, template: str) -> str:
        """The page."""
        pieces = self.pieces()

        def piece(match: re.Match[str]) -> str:
            name = match.group(1)
            if name not in pieces:
                raise MissingRowError(f"the template asks for '{name}', which is none of {', '.join(pieces)}")
            return pieces[name]()

        return re.sub(r"\{\{([^}]+)\}\}", piece, template)


def main() -> int:
    """Reads the command line; 1 where the page cannot be made, or is not what it should be."""
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
