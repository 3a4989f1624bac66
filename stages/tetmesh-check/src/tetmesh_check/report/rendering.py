"""Finds an off-screen renderer: ``python -m tetmesh_check.report.rendering``.

VTK looks for its renderer (GLX, EGL, OSMesa) at run time and may end the whole process with a
segmentation fault when it finds none. Everything that draws therefore runs in a process of its own,
with the environment found here.
"""

from __future__ import annotations

import os
import subprocess
import sys

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
"""Without PyVista, whose plotter takes 0.9 s longer to import and draw."""
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


if __name__ == "__main__":
    use_renderer()
