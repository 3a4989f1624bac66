"""The page: its template, the view of vtk.js, and the start of the server."""

from __future__ import annotations

import asyncio
from pathlib import Path
from typing import Any

from trame.app import get_server  # type: ignore[import-untyped, unused-ignore]
from trame.ui.html import DivLayout  # type: ignore[import-untyped, unused-ignore]
from trame.widgets import client, vtk  # type: ignore[import-untyped, unused-ignore]

import isoparticles.viewer.case as cases
from isoparticles.viewer.choose import Choice
from isoparticles.viewer.control import Control
from isoparticles.viewer.server import PageServer

HERE = Path(__file__).parent
CAMERA = "$event.pokedRenderer.getActiveCamera().get('position', 'focalPoint', 'viewUp', 'viewAngle')"
SIZE = "$event.pokedRenderer.getRenderWindow().getViews()[0].getSize()"
"""Expressions for the camera and the size of the view in an event of vtk.js."""
DRAWS_IN_SOFTWARE = (
    "window.drawsInSoftware ??= (gl => !gl || /swiftshader|llvmpipe|software|basic render/i.test(gl.getParameter("
    "(gl.getExtension('WEBGL_debug_renderer_info') || {}).UNMASKED_RENDERER_WEBGL || gl.RENDERER))"
    ")(window.document.createElement('canvas').getContext('webgl2'))"
)
"""JavaScript that tests whether the browser renders in software. Such a browser shows pictures from
the server. For 20,000 vertices with edges, Chromium's software renderer needs 0.86 s of processor
time for a frame, and VTK 0.15 s (Mesa)."""
STILL_QUALITY, MOVING_QUALITY = 95, 60
"""JPEG quality of these pictures, at rest and during a movement."""


class Page:
    """A page for one case. All browsers that show it share one state."""

    def __init__(self, shown: cases.Shown, port: int = 0, token: str | None = None) -> None:
        self.server: Any = get_server(f"isoparticles-{id(self)}", client_type="vue3")
        self.web = PageServer(self.server, port, token)
        try:
            self.control = Control(self.server, shown, self.address)
        except Exception:
            self.web.release()
            raise
        self.choice = Choice(self.control)
        self.task: Any = None
        self._tasks: list[asyncio.Task[None]] = []
        self._lay_out()
        self.server.controller.on_server_ready.add(self._ready)

    @property
    def address(self) -> str:
        """The address of the page, with its token."""
        return self.web.address

    @property
    def locked_folder(self) -> Path | None:
        """The absolute path of the folder that the page has locked; None for a mesh in memory."""
        folder = self.control.shown.folder
        return None if folder is None else folder.resolve()

    def _lay_out(self) -> None:
        self.server.state.trame__title = f"{self.control.shown.name} - isoparticles"
        with DivLayout(self.server) as layout:
            client.Style((HERE / "page.css").read_text(encoding="utf-8"))
            template = (HERE / "page.html").read_text(encoding="utf-8")
            template = template.replace("<!-- object -->", (HERE / "object.html").read_text(encoding="utf-8"))
            local, remote = self._views()
            for view in (local, remote):
                layout.root.children.remove(view)
            layout.root.add_child(template.replace("<!-- view -->", remote.html + local.html))

        def refresh() -> None:
            local.update()
            remote.update()

        self.control.refresh_view = refresh

    def _views(self) -> tuple[Any, Any]:
        """Return the view that the browser draws, and the view with pictures from the server."""
        window = self.control.scene.window
        events = ("['LeftButtonPress', 'LeftButtonRelease']",)
        press = "trigger('press', [$event.position.x, $event.position.y])"
        local = vtk.VtkLocalView(
            window,
            ref="view",
            v_else=True,
            interactor_events=events,
            LeftButtonPress=press,
            LeftButtonRelease=f"trigger('release', [$event.position.x, $event.position.y, tool, {SIZE}, {CAMERA}])",
        )
        remote = vtk.VtkRemoteView(
            window,
            ref="pictures",
            v_if=(DRAWS_IN_SOFTWARE,),
            interactive_ratio=1,
            interactive_quality=MOVING_QUALITY,
            still_quality=STILL_QUALITY,
            interactor_events=events,
            LeftButtonPress=press,
            LeftButtonRelease="trigger('release', [$event.position.x, $event.position.y, tool])",
        )
        return local, remote

    def _ready(self, **_: Any) -> None:
        self._tasks = [asyncio.get_running_loop().create_task(self.control.watch())]
        # if a browser reads a variable between its change and a flush, trame never sends it
        with self.control.state:
            if self.control.shown.mesh is None and self.control.shown.volume is not None:
                self.choice.changed()
            self.control.resume()

    def start(self, exec_mode: str = "main") -> Any:
        """Serve the page until the program is stopped (``main``), or in a task (``task``)."""
        self.task = self.web.start(exec_mode)
        if exec_mode == "main":
            self.web.release()
            self.control.close()
        return self.task

    def close(self) -> None:
        """End the page of a notebook: stop its run, and release its port and its folder."""
        self.web.release()
        self.control.close()
        for task in self._tasks:
            task.cancel()
        self._tasks = [asyncio.get_running_loop().create_task(self.web.stop())]
