"""The programs in the wheel, and the command line of ``isoparticles-case``."""

from __future__ import annotations

import os
import shutil
import sys
from collections.abc import Sequence
from pathlib import Path

import tetmesh_check

HERE = Path(__file__).resolve().parent
BIN = HERE / "bin" if (HERE / "bin").is_dir() else Path(os.environ.get("ISOPARTICLES_BIN", HERE / "bin"))
"""The folder of the programs: in the wheel, or that of a checkout."""


class UsageError(Exception):
    """An invalid command line: what is wrong, why it matters, what to do."""

    def __init__(self, what: str, why: str, what_next: str) -> None:
        super().__init__(f"error: {what}\n  why it matters: {why}\n  what to do: {what_next}")


def program(name: str) -> str:
    """Return the path of one of the programs in the wheel."""
    ending = ".exe" if os.name == "nt" else ""
    return str(BIN / f"{name}{ending}")


def scripts() -> Path:
    """Return the folder of the commands that were installed together with this one."""
    name = f"tetmesh-check{'.exe' if os.name == 'nt' else ''}"
    for folder in (Path(sys.argv[0]).resolve().parent, Path(sys.executable).parent):
        if (folder / name).is_file():
            return folder
    found = shutil.which("tetmesh-check")
    if found is None:
        raise UsageError(
            "tetmesh-check: not found beside isoparticles or in PATH",
            "it makes the tetrahedra",
            "reinstall the package isoparticles",
        )
    return Path(found).parent


def case_arguments(goal: str, settings: Sequence[str], options: Sequence[str] = ()) -> list[str]:
    """Return the command line of ``isoparticles-case``."""
    package = Path(tetmesh_check.__file__).parent
    tetrahedra = sorted(map(str, [*package.glob("*.*"), *package.glob("*/*.py"), *HERE.glob("_native.*")]))
    pages = sorted(str(file) for file in (package / "report" / "page").rglob("*.*"))
    return [
        program("isoparticles-case"),
        goal,
        *settings,
        *options,
        "--bin",
        str(BIN),
        "--tetmesh-check",
        str(scripts() / "tetmesh-check"),
        "--tetmesh-files",
        *tetrahedra,
        "--page-files",
        *pages,
    ]
