#!/usr/bin/env python3
"""Write docs/commands.md, the command reference, from the ``--help`` of the programs.

    tests/commands_page.py --bin target/release --tetmesh-check .venv/bin/tetmesh-check

``tests/test_docs.py`` fails if the page is out of date.
"""

from __future__ import annotations

import argparse
import os
import subprocess
from pathlib import Path

ROOT = Path(__file__).parents[1]
PAGE = ROOT / "docs" / "commands.md"
STAGES = ("distfield", "sizefield", "seed", "particles", "reconstruct")
TOOLS = (("isoparticles-volume", "info"), ("isoparticles-volume", "convert"), ("phantom",))
HEAD = """\
# Command reference

`make` sets most of these options by its variables ([choose a size](user/size.md)). This page shows the
`--help` of every program. `tests/commands_page.py` writes it.
"""


def help_of(command: list[str]) -> str:
    """Run a command with ``--help``, 100 columns wide, and return what it prints."""
    environment = {**os.environ, "COLUMNS": "100", "NO_COLOR": "1"}
    done = subprocess.run([*command, "--help"], capture_output=True, text=True, check=True, env=environment)
    return "\n".join(line.rstrip() for line in done.stdout.strip().splitlines())


def page(bin_folder: Path, tetmesh_check: Path) -> str:
    """Return the text of the page.

    Parameters
    ----------
    bin_folder
        Folder of the Rust programs.
    tetmesh_check
        The program of the last stage.
    """
    commands = [(name, [str(bin_folder / name)]) for name in STAGES]
    commands.append(("tetmesh-check", [str(tetmesh_check)]))
    commands.append(("isoparticles-read", [str(tetmesh_check.with_name("isoparticles-read"))]))
    commands += [(" ".join(words), [str(bin_folder / words[0]), *words[1:]]) for words in TOOLS]
    parts = [f"\n## {name}\n\n```text\n{help_of(command)}\n```\n" for name, command in commands]
    return HEAD + "".join(parts)


def main() -> None:
    """Write the page."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--bin", type=Path, default=ROOT / "target" / "release")
    parser.add_argument("--tetmesh-check", type=Path, default=ROOT / ".venv" / "bin" / "tetmesh-check")
    arguments = parser.parse_args()
    PAGE.write_text(page(arguments.bin, arguments.tetmesh_check), encoding="utf-8")


if __name__ == "__main__":
    main()
