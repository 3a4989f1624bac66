"""Run the recipes as a reader would: the code of each page, in order, in an empty folder.

    docs/recipes/run.py [torso femur ...] [--small] [--pictures] [--work out/recipes]

The code is that of the fenced blocks `sh` and `python`. A block `sh needs=ccx` is skipped, with a
note, if there is no program ccx. The figures of the page are the rows of its table

    | result | value | tolerance |

A tolerance is a share of the value (`2 %`), or `at least` or `at most` if the value is a limit. A
figure is found by its name, in the reports of the stages (:data:`REPORTED`) or in a line `name:
value` that the code prints. With --small, the volumes are small parts of those of the page, and
tetmesh-check solves no test problems unless the page says so: only limits apply, but every figure
must exist.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import resource
import shutil
import subprocess
import sys
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

HERE = Path(__file__).resolve().parent
PAGES = {page.stem: page for page in sorted(HERE.glob("*.md")) if page.stem not in ("index", "gallery")}
BLOCK = re.compile(r"^```(sh|python)(?: needs=(\S+))?\n(.*?)^```$", re.MULTILINE | re.DOTALL)
ROW = re.compile(r"^\| ([^|]+) \| ([-\d,.e]+) \| (at least|at most|[\d.]+ %) \|$", re.MULTILINE)
PRINTED = re.compile(r"^([^:\n]+): +([-+\d.e]+)$", re.MULTILINE)
REPORTED = {
    "surface vertices": ("reports/reconstruct.json", "results check vertices"),
    "minimum angle of the triangles, degrees": ("reports/reconstruct.json", "results check quality angle_min"),
    "tetrahedra": ("*.report.json", "results volume tetrahedra"),
    "volume, mm^3": ("*.report.json", "results volume volume_mm3"),
    "mass, g": ("*.report.json", "results density mass_g"),
    "minimum scaled Jacobian of the prisms": ("*.report.json", "results layers walls 0 scaled_jacobian min"),
    "area of the inlet, mm^2": ("*.report.json", "results boundary parts 1 area_mm2"),
    "mean height of the first layer, mm": ("*.report.json", "results layers walls 0 first_height_mm mean"),
    "minimum dihedral angle, degrees": ("*.report.json", "results volume quality min_dihedral min"),
}
"""File and keys of a figure, by its name."""


@dataclass
class Outcome:
    """What a recipe printed, and what is wrong."""

    printed: str = ""
    skipped: list[str] = field(default_factory=list)
    """Programs that are not installed."""
    wrong: list[str] = field(default_factory=list)


def environment(small: bool, scripts: Path | None, work: Path) -> dict[str, str]:
    """Return the environment of the code.

    Its `python` is this interpreter, and its `isoparticles` is that of the folder `scripts` or,
    without one, the package that this interpreter imports.
    """
    commands = work / ".bin"
    shutil.rmtree(commands, ignore_errors=True)
    commands.mkdir(parents=True)
    called = {"python": f"'{sys.executable}'"}
    if scripts is None:
        called["isoparticles"] = f"'{sys.executable}' -m isoparticles"
    for name, words in called.items():
        path = commands / name
        path.write_text(f'#!/bin/sh\nexec {words} "$@"\n', encoding="utf-8")
        path.chmod(0o755)
    folders = [str(commands), *([] if scripts is None else [str(scripts)]), os.environ["PATH"]]
    return {**os.environ, "PATH": os.pathsep.join(folders), "RECIPE_SMALL": "yes" if small else "no"}


def processor_seconds() -> float:
    """Return the processor time of the programs that this one ran."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def run_page(text: str, folder: Path, variables: dict[str, str], small: bool) -> Outcome:
    """Run the code of a page in a folder, up to the first block that fails."""
    outcome = Outcome()
    for language, needed, code in BLOCK.findall(text):
        if needed and shutil.which(needed) is None:
            outcome.skipped.append(needed)
            continue
        if small:
            # an option of the page comes later, and takes precedence
            code = code.replace('--tetmesh-options "', '--tetmesh-options "--solve no ')
        words = ["sh", "-eu", "-c", code] if language == "sh" else [sys.executable, "-c", code]
        done = subprocess.run(words, cwd=folder, env=variables, capture_output=True, text=True, check=False)
        outcome.printed += done.stdout
        if done.returncode != 0:
            said = (done.stdout + done.stderr)[-3000:]
            outcome.wrong.append(f"exit code {done.returncode} of\n{code}{said}")
            break
    return outcome


def figures(folder: Path, printed: str) -> dict[str, float]:
    """Return all figures of a recipe by name: those in its reports and those that it printed."""
    found: dict[str, float] = {}
    for name, (pattern, keys) in REPORTED.items():
        for path in folder.glob(f"out/*/{pattern}"):
            value: Any = json.loads(path.read_text(encoding="utf-8"))
            for key in keys.split():
                value = value[int(key)] if isinstance(value, list) else (value or {}).get(key)
            if value is not None:
                found[name] = float(value)
    return found | {name: float(value) for name, value in PRINTED.findall(printed)}


def differences(text: str, found: dict[str, float], small: bool, incomplete: bool) -> list[str]:
    """Print the figures beside those of the page, and return a message for each that differs.

    Figures may be missing if the recipe is incomplete.
    """
    wrong = []
    for name, told, tolerance in ROW.findall(text):
        value = float(told.replace(",", ""))
        got = found.get(name)
        print(f"  {name}: {'missing' if got is None else f'{got:g}'} (page: {told}, {tolerance})")
        if got is None:
            good = incomplete
        elif tolerance == "at least":
            good = got >= value
        elif tolerance == "at most":
            good = got <= value
        else:
            good = small or abs(got - value) <= float(tolerance.split()[0]) / 100.0 * abs(value)
        if not good:
            wrong.append(f"{name}: {got}, but the page says {told} ({tolerance})")
    return wrong


def recipe(name: str, arguments: argparse.Namespace) -> Outcome:
    """Run a recipe, compare its figures and, if asked, draw its picture."""
    folder = arguments.work / name
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    shutil.copy(HERE / "volumes.py", folder)
    print(f"{name}:", flush=True)
    text = PAGES[name].read_text(encoding="utf-8")
    started, used = time.monotonic(), processor_seconds()
    variables = environment(arguments.small, arguments.scripts, arguments.work)
    outcome = run_page(text, folder, variables, arguments.small)
    print(f"  {time.monotonic() - started:.0f} s, {processor_seconds() - used:.0f} s of processor time")
    for program in outcome.skipped:
        print(f"  SKIPPED: the step that needs {program}, which is not installed")
    if not outcome.wrong:
        found = figures(folder, outcome.printed)
        outcome.wrong = differences(text, found, arguments.small, bool(outcome.skipped))
    if arguments.pictures and not outcome.wrong:
        import pictures

        pictures.draw(name, folder, HERE / "images" / f"{name}.png")
    return outcome


def main() -> int:
    """Run the recipes of the command line. The exit code is 1 if one failed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("recipes", nargs="*", help=f"recipes to run (default: all of {' '.join(PAGES)})")
    parser.add_argument("--small", action="store_true", help="run on small parts of the volumes, as in the tests")
    parser.add_argument("--pictures", action="store_true", help="also draw the pictures of the pages")
    parser.add_argument("--work", type=Path, default=Path("out/recipes"), help="folder for the results")
    parser.add_argument("--scripts", type=Path, help="folder of the command isoparticles (default: this package)")
    arguments = parser.parse_args()
    arguments.work = arguments.work.resolve()
    if unknown := set(arguments.recipes) - set(PAGES):
        parser.error(f"{', '.join(sorted(unknown))}: no such recipe; choose among {', '.join(PAGES)}")
    failed = False
    for name in arguments.recipes or PAGES:
        for message in recipe(name, arguments).wrong:
            print(f"  FAILED: {message}")
            failed = True
    return int(failed)


if __name__ == "__main__":
    sys.exit(main())
