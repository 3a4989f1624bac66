"""``isoparticles GOAL ...`` makes a case; ``isoparticles STAGE ...`` runs one stage.

The goals are the same as in the Makefile. This module only translates command lines: goals go to
the program ``isoparticles-case``, ``--min-size 2`` becomes ``MIN_SIZE=2``, and stages get their
arguments unchanged.
"""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Sequence
from importlib.metadata import version
from pathlib import Path
from typing import NoReturn

from isoparticles._programs import BIN, HERE, UsageError, case_arguments, program

STAGES = ("distfield", "sizefield", "seed", "particles", "reconstruct", "tetmesh-check")
VOLUME_GOALS = {
    "info": "describe a volume and suggest options",
    "mesh": "mesh a volume with tetrahedra and write a report page",
    "surface": "mesh only the surface of a volume",
}
"""Goals whose first argument is the volume. Unlike in the Makefile, the stages are not goals."""
TOOLS = {
    "convert": "write a volume as a VTK image (.vti)",
    "read": "write an HDF5, MATLAB or Zarr file as a VTK image",
}
"""Goals without a case. ``isoparticles-volume`` and ``isoparticles-read`` perform them."""
NAME_GOALS = {
    "verdict": "print the outcome of a case",
    "page": "regenerate the page of a case",
    "clean": "remove the results folder of a case",
}
"""Goals whose first argument is the name of the results."""
SHORT = {"-o": "OUT", "--output": "OUT"}
VERBOSITY = frozenset({"-q", "-v", "-vv"})
BATCH = {"--time-limit": "--time-limit", "--goal": "--as-far-as"}
"""Options of ``batch`` only, with their names in ``isoparticles-case``."""


def settings_of(words: Sequence[str], first: str, known: dict[str, str]) -> tuple[list[str], list[str]]:
    """Convert options to settings.

    Parameters
    ----------
    words
        The words after the goal. ``--min-size 2``, ``--min-size=2`` and ``MIN_SIZE=2`` are
        equivalent.
    first
        The key that a bare word sets.
    known
        Options to pass on, and the names under which to pass them.

    Returns
    -------
    tuple
        Settings ``KEY=VALUE``, and the options to pass on.
    """
    settings: list[str] = []
    options: list[str] = []
    rest = list(words)
    has_first = False
    while rest:
        word = rest.pop(0)
        if word in VERBOSITY:
            settings.append(f"VERBOSITY={word}")
        elif word.startswith("-"):
            name, equals, value = word.partition("=")
            if not equals:
                if not rest:
                    raise UsageError(f"{name}: has no value", "every option needs a value", "see `isoparticles help`")
                value = rest.pop(0)
            if name in known:
                options += [known[name], value]
            else:
                settings.append(f"{SHORT.get(name, name.lstrip('-').replace('-', '_').upper())}={value}")
        elif "=" in word and word.partition("=")[0].replace("_", "").isupper():
            settings.append(word)
        elif has_first:
            raise UsageError(
                f"{word}: a second {first}",
                "each run meshes one case",
                "use `isoparticles batch` for several cases; put names with spaces in quotes",
            )
        else:
            has_first = True
            settings.append(f"{first}={word}")
    return settings, options


def preset_of(case_file: Path) -> list[str]:
    """Return the ``isoparticles-case`` options for the ``KEY := VALUE`` lines of a case file."""
    lines = case_file.read_text(encoding="utf-8").splitlines()
    pairs = [line.split(":=", 1) for line in lines if ":=" in line and not line.startswith("#")]
    presets = [word for key, value in pairs for word in ("--preset", f"{key.strip()}={value.strip()}")]
    return [*presets, "--case-file", case_file.stem]


def help_text() -> str:
    """Return the help text with all goals and options."""
    keys = subprocess.run([program("isoparticles-case"), "keys"], capture_output=True, text=True, check=True)
    lines = [line.split("\t", 1) for line in keys.stdout.splitlines()]
    options = "\n".join(
        f"  --{key.lower().replace('_', '-'):<22}{what}" for key, what in lines if key not in ("CASE", "INPUT")
    )
    goals = "\n".join(f"  {goal + ' VOLUME ...':<24}{what}" for goal, what in (VOLUME_GOALS | TOOLS).items())
    named = "\n".join(f"  {goal + ' NAME':<24}{what}" for goal, what in NAME_GOALS.items())
    return f"""\
Volumes in, simulation-ready meshes out.

  isoparticles mesh ct.nii.gz --labels 1 -o out

{goals}
{named}
  batch LIST.csv          mesh the case in each row of a list (--goal surface, --time-limit 2h per case)
  view CASE               look at a case in the browser and refine it there; see view --help
  index                   write an index page of all cases in --out
  demo                    mesh a phantom
  {", ".join(STAGES)}
                          run a single stage; see --help

Options of mesh and surface (also as KEY=VALUE):
{options}
"""


def command_of(arguments: Sequence[str]) -> list[str]:
    """Return the program and arguments for a command line, or raise :class:`UsageError`."""
    goal, rest = arguments[0], arguments[1:]
    if goal == "tetmesh-check":
        return [sys.executable, "-m", "tetmesh_check", *rest]
    if goal in STAGES:
        return [program(goal), *rest]
    if goal == "read":
        return [sys.executable, "-m", "isoparticles.formats.program", *rest]
    if goal in TOOLS:
        return [program("isoparticles-volume"), goal, *rest]
    if goal == "demo":
        settings, _ = settings_of(rest, "NAME", {})
        return case_arguments("mesh", settings, preset_of(HERE / "cases" / "demo.mk"))
    if goal == "batch":
        settings, options = settings_of(rest, "LIST", BATCH)
        lists = [word.partition("=")[2] for word in settings if word.startswith("LIST=")]
        others = [word for word in settings if not word.startswith("LIST=")]
        return case_arguments("batch", others, [*options, *(word for name in lists for word in ("--list", name))])
    if goal in NAME_GOALS or goal == "index":
        return case_arguments(goal, settings_of(rest, "NAME", {})[0])
    if goal in VOLUME_GOALS:
        return case_arguments(goal, settings_of(rest, "INPUT", {})[0])
    raise UsageError(
        f"{goal}: no such goal or stage",
        "the first argument must be a goal or a stage",
        f"choose one of {', '.join((*VOLUME_GOALS, *TOOLS, *NAME_GOALS, 'batch', 'index', 'view', 'demo', *STAGES))}",
    )


def main() -> NoReturn:
    """Run the command line.

    The program replaces this process, so it receives the signals and returns the exit code.
    """
    arguments = sys.argv[1:]
    if not arguments or arguments[0] in ("help", "-h", "--help") or (len(arguments) > 1 and is_help(arguments)):
        print(help_text(), end="")
        raise SystemExit(0 if arguments else 2)
    if arguments[0] == "--version":
        print(f"isoparticles {version('isoparticles')}")
        raise SystemExit(0)
    try:
        if arguments[0] == "view":
            from isoparticles.viewer import main as view

            raise SystemExit(view(arguments[1:]))
        command = command_of(arguments)
    except UsageError as error:
        print(error, file=sys.stderr)
        raise SystemExit(2) from None
    environment = {**os.environ, "ISOPARTICLES_BIN": str(BIN), "ISOPARTICLES_FRONT": "isoparticles"}
    if os.name == "posix":
        os.execve(command[0], command, environment)
    raise SystemExit(subprocess.run(command, env=environment, check=False).returncode)


def is_help(arguments: Sequence[str]) -> bool:
    """Return whether the user requests help for a goal without a help text of its own."""
    return arguments[0] not in (*STAGES, "read", "view") and any(word in ("-h", "--help") for word in arguments[1:])
