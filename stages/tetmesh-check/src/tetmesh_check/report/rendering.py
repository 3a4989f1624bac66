"""Draws the pictures in another process, and finds an off-screen renderer for it.

``python -m tetmesh_check.report.rendering`` ends with an error if there is none.

VTK looks for its renderer (GLX, EGL, OSMesa) at run time. If it finds none, the process may end
with a segmentation fault. So all drawing is done in a separate process, with the environment
variables found here.
"""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from subprocess import DEVNULL, PIPE, Popen

from isoparticles._native import Context

from tetmesh_check.arguments import Arguments

_DRAWING_SECONDS = 300.0
"""Maximum time for the pictures after the other work, s."""
_PROBE_SECONDS = 60.0
_PROBE = """
import vtkmodules.vtkRenderingOpenGL2
from vtkmodules.vtkRenderingCore import vtkRenderWindow, vtkRenderer, vtkWindowToImageFilter
window = vtkRenderWindow()
window.SetOffScreenRendering(1)
window.SetSize(16, 16)
renderer = vtkRenderer()
renderer.SetBackground(1.0, 1.0, 1.0)
window.AddRenderer(renderer)
window.Render()
grab = vtkWindowToImageFilter()
grab.SetInput(window)
grab.Update()
assert grab.GetOutput().GetScalarRange()[1] == 255.0
"""
"""Program that draws an empty picture. With PyVista, import and drawing would take 0.9 s longer."""
_CHOICES = ({}, *({"VTK_DEFAULT_OPENGL_WINDOW": f"vtk{kind}RenderWindow"} for kind in ("OSOpenGL", "EGL")))
"""Environment variables to try without a display; VTK chooses by itself first."""


def use_renderer() -> None:
    """Set the environment variables of this process so that VTK can draw off screen.

    Raises
    ------
    SystemExit
        If this machine cannot draw.
    """
    headless = {name: value for name, value in os.environ.items() if name not in ("DISPLAY", "WAYLAND_DISPLAY")}
    for environment in (*({**headless, **choice} for choice in _CHOICES), dict(os.environ)):
        words = [sys.executable, "-c", _PROBE]
        try:
            subprocess.run(words, env=environment, capture_output=True, timeout=_PROBE_SECONDS, check=True)
        except subprocess.SubprocessError:
            continue
        os.environ.clear()
        os.environ.update(environment)
        return
    raise SystemExit(
        "no off-screen renderer on this machine (Debian, Ubuntu: apt-get install libosmesa6, "
        "or libegl1 libgl1-mesa-dri)"
    )


@contextmanager
def drawing(arguments: Arguments, context: Context, many: bool) -> Iterator[None]:
    """Draw the pictures in another process while the block runs.

    Parameters
    ----------
    arguments
        The arguments of the command line. The surface and the volume mesh exist.
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
    command = [sys.executable, "-m", "tetmesh_check.report.pictures", *map(str, words)]
    with Popen(command, stdin=DEVNULL, stdout=PIPE, stderr=PIPE, text=True, errors="replace") as process:
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


def _finish(process: Popen[str]) -> tuple[list[str], str]:
    """Wait for the process; return the kinds that it drew, and why others are missing."""
    try:
        told, errors = process.communicate(timeout=_DRAWING_SECONDS)
    except subprocess.TimeoutExpired:
        process.kill()
        return process.communicate()[0].split(), f"the drawing process was stopped after {_DRAWING_SECONDS:g} s"
    words = errors.strip().splitlines()
    raised = process.returncode == 1 and words
    return told.split(), words[-1] if raised else f"the drawing process ended with code {process.returncode}"


if __name__ == "__main__":
    use_renderer()
