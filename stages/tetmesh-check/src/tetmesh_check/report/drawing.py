"""Pictures that another process draws beside the work, and what the report says of them.

VTK may end a process that draws where it finds no renderer (see :mod:`.rendering`).
"""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager

from isoparticles._native import Context

from tetmesh_check.arguments import Arguments

_DRAWING_SECONDS = 300.0
"""Time for the pictures after the other work."""


@contextmanager
def drawing(arguments: Arguments, context: Context, many: bool) -> Iterator[None]:
    """Have the pictures drawn beside the work of the block.

    Parameters
    ----------
    arguments
        What the user asked for; the surface and the volume mesh exist.
    context
        For times, warnings, and ``pictures`` in the results.
    many
        Whether the volume mesh is of many materials.
    """
    targets = arguments.picture_paths(many)
    if not targets:
        yield
        return
    words = [arguments.surface, arguments.output, *(f"{kind}={path}" for kind, path in targets.items())]
    with subprocess.Popen(
        [sys.executable, "-m", "tetmesh_check.report.pictures", *map(str, words)],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        errors="replace",
    ) as process:
        try:
            yield
            with context.step("pictures"):
                drawn, reason = _finish(process)
        finally:
            process.kill()
    missing = [kind for kind in targets if kind not in drawn]
    context.results["pictures"] = {
        "drawn": [path.name for kind, path in targets.items() if kind in drawn],
        "skipped": dict.fromkeys(missing, reason),
    }
    if missing:
        context.warn(f"pictures skipped ({', '.join(missing)}): {reason}")


def _finish(process: subprocess.Popen[str]) -> tuple[list[str], str]:
    """Wait for the process; return the kinds that it drew, and why there are no others."""
    try:
        told, errors = process.communicate(timeout=_DRAWING_SECONDS)
    except subprocess.TimeoutExpired:
        process.kill()
        return process.communicate()[0].split(), f"the drawing process was ended after {_DRAWING_SECONDS:g} s"
    words = errors.strip().splitlines()
    if process.returncode == 1 and words:  # of an exception
        return told.split(), words[-1]
    return told.split(), f"the drawing process ended with code {process.returncode}"
