"""Tests of the documentation and of the version that it states.

Tables of figures in README.md and docs have a nearby command that measures them. It is in the
paragraph before or after the table, in the first paragraph of the section, or in a section of the
same page to which one of these paragraphs links.
"""

from __future__ import annotations

import ast
import os
import re
import sys
import tomllib
from pathlib import Path

import commands_page
import pytest

ROOT = Path(__file__).parents[1]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("**/*.md"))]

NUMBER = re.compile(r"^[-+~<]?\d[\d,.]*( ?%)?$")
"""A cell, or a part of a cell, that is a figure."""
SHARE = 0.5
"""Minimum fraction of figures among the cells of a column of figures."""
PROGRAMS = (
    "make|cargo|distfield|sizefield|seed|particles|reconstruct|phantom|tetmesh-check|isoparticles|python|perf|time"
)
COMMAND = re.compile(rf"(^|[ /`=])({PROGRAMS}) +[^ ]|(^|[ /])[\w-]+\.(py|sh)\b")
CODE = re.compile(r"`+([^`]+)`+")
LINK = re.compile(r"\]\(#([\w-]+)\)")


def cells(line: str) -> list[str]:
    """Return the cells of a row."""
    return [cell.strip() for cell in line.strip().strip("|").split("|")]


def is_figure(cell: str) -> bool:
    """Return whether a cell contains only numbers: `0.98 / 0.72`, `3 to 4`, `12, 13`."""
    parts = [part for part in re.split(r" / | to | and |, |; ", cell.replace("**", "")) if part]
    return bool(parts) and all(NUMBER.match(part.strip()) for part in parts)


def has_figures(rows: list[str]) -> bool:
    """Return whether any column except the first is a column of figures."""
    body = [cells(row) for row in rows[2:]]
    width = min((len(row) for row in body), default=0)
    return any(sum(is_figure(row[i]) for row in body) > SHARE * len(body) for i in range(1, width))


def anchor(heading: str) -> str:
    """Return the anchor of a link to a heading."""
    return re.sub(r"[^\w -]", "", heading.strip("# ").lower()).replace(" ", "-")


def sections(text: str) -> dict[str, list[str]]:
    """Return the lines below each heading, by the anchor of the heading."""
    found: dict[str, list[str]] = {"": []}
    name, fenced = "", False
    for line in text.splitlines():
        fenced ^= line.startswith("```")
        if line.startswith("#") and not fenced:
            name = anchor(line)
        found.setdefault(name, []).append(line)
    return found


def has_command(lines: list[str]) -> bool:
    """Return whether the lines contain a command: inline, in a fence, or indented."""
    codes = [*CODE.findall("\n".join(lines)), *(line for line in lines if line.startswith("    "))]
    return any(COMMAND.search(code) for code in codes)


def blocks(lines: list[str]) -> list[list[str]]:
    """Return the paragraphs and tables; a list belongs to the paragraph before it."""
    found: list[list[str]] = [[]]
    for line in lines:
        if line.strip():
            found[-1].append(line)
        elif found[-1]:
            found.append([])
    joined: list[list[str]] = []
    for block in found:
        if block and block[0].startswith("- ") and joined:
            joined[-1] += block
        elif block:
            joined.append(block)
    return joined


def without_command(text: str) -> list[str]:
    """Return the header rows of tables of figures that have no nearby command."""
    found = []
    parts = sections(text)
    for lines in parts.values():
        own = blocks(lines)
        for i, block in enumerate(own):
            if not block[0].startswith("|") or not has_figures(block):
                continue
            places = [own[j] for j in (i - 1, i + 1, 1) if 0 <= j < len(own) and not own[j][0].startswith("|")]
            beside = [line for place in places for line in place]
            links = [parts.get(name, []) for name in LINK.findall("\n".join(beside))]
            if not has_command(beside) and not any(map(has_command, links)):
                found.append(block[0])
    return found


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_tables_of_figures_have_their_command(page: Path) -> None:
    assert without_command(page.read_text(encoding="utf-8")) == []


def test_a_table_without_a_command_is_found() -> None:
    table = "| stage | s |\n|---|---|\n| seed | 0.4 |\n| particles | 1.2, 1.3 |\n"
    assert without_command(f"# Times\n\n{table}") == ["| stage | s |"]
    assert without_command(f"# Times\n\n`make bench-stages`:\n\n{table}") == []
    assert without_command(f"# How\n\n    make bench-stages\n\n# Times\n\n[How](#how)\n\n{table}") == []
    assert without_command("# Words\n\n| word | meaning |\n|---|---|\n| F | the field of 3 axes |\n") == []


def test_the_command_reference_is_current() -> None:
    programs = Path(os.environ.get("ISOPARTICLES_BIN", ROOT / "target" / "release"))
    tetmesh_check = Path(sys.executable).parent / "tetmesh-check"
    if not (programs / "distfield").exists() or not tetmesh_check.exists():
        pytest.skip("the programs are not built (make build env)")
    assert commands_page.page(programs, tetmesh_check) == commands_page.PAGE.read_text(encoding="utf-8"), (
        "stale: run tests/commands_page.py"
    )


def test_the_python_page_names_the_whole_package() -> None:
    package = ROOT / "pipelines" / "wheel" / "src" / "isoparticles"
    lines = (package / "__init__.py").read_text(encoding="utf-8").split("__all__ = ")[1]
    public = ast.literal_eval(lines[: lines.index("]") + 1])
    options = re.findall(r"^class (\w+)", (package / "_options.py").read_text(encoding="utf-8"), re.MULTILINE)
    page = (ROOT / "docs" / "python.md").read_text(encoding="utf-8")
    names = ["isoparticles", *(f"isoparticles.{name}" for name in public)]
    names += [f"isoparticles._options.{name}" for name in options]
    assert sorted(re.findall(r"^\.\. auto\w+:: (\S+)", page, re.MULTILINE)) == sorted(names)


def test_all_files_state_the_same_version() -> None:
    def first(path: str, pattern: str) -> str:
        found = re.search(pattern, (ROOT / path).read_text(encoding="utf-8"), re.MULTILINE)
        return found.group(1) if found else "none"

    version = tomllib.loads((ROOT / "Cargo.toml").read_text(encoding="utf-8"))["workspace"]["package"]["version"]
    date = first("CITATION.cff", r"^date-released: (\d{4}-\d\d-\d\d)$")
    locked = tomllib.loads((ROOT / "Cargo.lock").read_text(encoding="utf-8"))["package"]
    stated = {
        "CHANGELOG.md": first("CHANGELOG.md", rf"^## \[(.+)\] - {date}$"),
        "CITATION.cff": first("CITATION.cff", r"^version: (.+)$"),
        "conda": first("pipelines/conda/recipe.yaml", r'^  version: "(.+)"$'),
        "tetmesh-check": first("stages/tetmesh-check/pyproject.toml", r'^version = "(.+)"$'),
        "wheel": first("docs/user/install.md", r"isoparticles-([\d.]+)-cp311"),
        **{package["name"]: package["version"] for package in locked if "source" not in package},
    }
    assert len(stated) > 15
    assert stated == dict.fromkeys(stated, version)
