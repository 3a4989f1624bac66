"""Comments and prose have at most 100 columns.

Links, tables, code blocks and generated pages may be wider.
"""

from __future__ import annotations

import io
import subprocess
import tokenize
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
WIDTH = 100
GENERATED = ("docs/commands.md", "docs/results.md", "docs/results/template.md")
SUFFIXES = {".rs", ".wgsl", ".py", ".sh", ".mk", ".md", ".toml", ".yml", ".yaml"}
NAMES = {"Makefile", "Snakefile", "Containerfile", "run"}


def files() -> list[str]:
    """Return the tracked files to check."""
    listed = subprocess.run(["git", "ls-files"], cwd=ROOT, capture_output=True, text=True, check=True)
    paths = [path for path in listed.stdout.splitlines() if (ROOT / path).is_file()]
    return [
        path for path in paths if (Path(path).suffix in SUFFIXES or Path(path).name in NAMES) and path not in GENERATED
    ]


def prose_of_markdown(text: str) -> Iterator[tuple[int, str]]:
    """Yield the numbers and text of lines outside code blocks and tables."""
    fenced = False
    for number, line in enumerate(text.splitlines(), 1):
        fence = line.lstrip().startswith("```")
        fenced ^= fence
        if not (fenced or fence or line.lstrip().startswith("|") or line.startswith("    ")):
            yield number, line


def prose_of_python(text: str) -> Iterator[tuple[int, str]]:
    """Yield the numbers and text of lines with comments or docstrings."""
    lines = text.splitlines()
    before = tokenize.NEWLINE
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        is_docstring = token.type == tokenize.STRING and before in (tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT)
        if is_docstring or (token.type == tokenize.COMMENT and token.line.lstrip().startswith("#")):
            for number in range(token.start[0], token.end[0] + 1):
                yield number, lines[number - 1]
        if token.type not in (tokenize.NL, tokenize.COMMENT):
            before = token.type


def prose_of_code(text: str, marks: tuple[str, ...]) -> Iterator[tuple[int, str]]:
    """Yield the numbers and text of lines that begin with a comment mark."""
    for number, line in enumerate(text.splitlines(), 1):
        if line.lstrip().startswith(marks) and not line.lstrip().startswith(("#[", "#!")):
            yield number, line


def prose(path: str, text: str) -> Iterator[tuple[int, str]]:
    """Yield the numbers and text of the lines of prose in a file."""
    suffix = Path(path).suffix
    if suffix == ".md":
        return prose_of_markdown(text)
    if suffix == ".py":
        return prose_of_python(text)
    return prose_of_code(text, ("//",) if suffix in {".rs", ".wgsl"} else ("#",))


def wide(path: str, text: str) -> list[str]:
    """Return messages about lines of prose that are too wide; a line with a link may be wider."""
    return [
        f"{path}:{number}: {len(line)} columns"
        for number, line in prose(path, text)
        if len(line) > WIDTH and "http" not in line and "](" not in line
    ]


def test_comments_and_prose_have_at_most_100_columns() -> None:
    found = [line for path in files() for line in wide(path, (ROOT / path).read_text(encoding="utf-8"))]
    assert not found, "\n".join(found)


@pytest.mark.parametrize(
    ("path", "start", "count"),
    [
        ("a.rs", "    // ", 1),
        ("a.rs", "let a = ", 0),
        ("a.rs", "    #[arg(", 0),
        ("a.wgsl", "// ", 1),
        ("a.py", "# ", 1),
        ("a.py", '"""', 1),
        ("a.py", 'a = "', 0),
        ("a.md", "word ", 1),
        ("a.md", "| cell ", 0),
        ("a.md", "see [a](b.md) ", 0),
        ("a.sh", "# ", 1),
    ],
)
def test_wide_prose_is_found(path: str, start: str, count: int) -> None:
    end = {'"""': '"""', 'a = "': '"'}.get(start, "")
    line = start + "x" * (WIDTH + 1 - len(start) - len(end)) + end
    assert len(wide(path, f"{line}\n")) == count
    assert not wide(path, f"{line[:50]}{end}\n")
