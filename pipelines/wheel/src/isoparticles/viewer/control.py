"""Handles buttons, pointers and keys: requests, updates, undo, save."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

import isoparticles.viewer.case as cases
from isoparticles._errors import Error
from isoparticles.viewer.run import Job
from isoparticles.viewer.session import Ball, Mask, Request, size_at
from isoparticles.viewer.views import Views

POLL = 0.15
"""Seconds between two updates of the progress of a job. They look continuous at this rate."""
FINER = 0.5
"""Default h of a new ball or region, relative to the present h at its centre."""
RADIUS = 4.0
"""Default radius of a new ball, relative to the present h. Smaller balls contain few triangles."""
CLICK = 4.0
"""Maximum distance between press and release that counts as a click, in pixels."""
KEYS = {"ArrowLeft": (0, -1), "ArrowRight": (0, 1), "ArrowUp": (1, -1), "ArrowDown": (1, 1)}
"""Axis of the slice (0 to the right, 1 down) and direction for each arrow key."""


class Control(Views):
    """The page with its handlers."""

    def __init__(self, server: Any, shown: cases.Shown, address: str) -> None:
        super().__init__(server, shown, address)
        self._then: Callable[[], None] = lambda: None
        self._pressed: tuple[float, float] | None = None
        self._connect()

    def _connect(self) -> None:
        trigger, change = self.server.trigger, self.state.change
        for name, call in (
            ("pointer", self.on_pointer), ("key", self.on_key), ("press", self.on_press), ("release", self.on_release),
            ("layer", self.on_layer), ("place_here", self.place_here), ("choose", self.choose), ("remove", self.remove),
            ("apply", self.apply), ("undo", self.undo), ("save", self.save), ("stop", self.stop), ("fly", self.fly),
            ("refine", self.refine), ("all", self.look_at_all), ("clear_paint", self.clear_paint),
            ("take_paint", self.take_paint), ("dismiss", self.dismiss), ("factor", self.factor),
        ):  # fmt: skip
            trigger(name)(self._safely(call))
        change("width", "level")(lambda **_: self.draw_slices())
        change("radius", "h")(lambda **_: self._edit_chosen())
        change("colour", "edges", "clip", "clip_axis", "clip_place", "clip_upper")(lambda **_: self.draw_surface())

    def _safely(self, call: Callable[..., object]) -> Callable[..., None]:
        """Show the errors of a handler on the page."""

        def handler(*arguments: Any) -> None:
            try:
                call(*arguments)
            except Exception as error:  # the page shows it
                self.show_error(error)

        return handler

    def dismiss(self) -> None:
        """Hide the error."""
        self.state.problem = None

    # --- Slices -------------------------------------------------------------------------------

    def on_pointer(self, name: str, kind: str, x: float, y: float, box: dict[str, float], tool: str) -> None:
        """Handle a pointer on a slice: move the cursor, place and resize a ball, or paint."""
        if self.slices is None:
            return
        plane = self.slices.planes[name]
        scale = min(box["width"] / plane.extent[0], box["height"] / plane.extent[1])
        flat = [
            (x - box["left"] - 0.5 * (box["width"] - scale * plane.extent[0])) / scale,
            (y - box["top"] - 0.5 * (box["height"] - scale * plane.extent[1])) / scale,
        ]
        if not (0.0 <= flat[0] <= plane.extent[0] and 0.0 <= flat[1] <= plane.extent[1]):
            return
        position = plane.to_world(flat, plane.layer_of(self.cursor.tolist()))
        if tool == "look":
            self.move_to(position.tolist())
        elif tool == "paint" and self.paint is not None:
            self.paint.dab(position, float(self.state.brush))
            self.state.painted = self.paint.count
            self.draw_slices()
        elif tool == "ball" and kind == "pointerdown":
            self.place_ball(position.tolist())
        elif tool == "ball" and 0 <= self.state.chosen < len(self.requests):
            ball = self.requests[self.state.chosen]
            if isinstance(ball, Ball):
                distance = float(np.linalg.norm(position - np.array(ball.centre)))
                self.state.radius = round(max(distance, 0.5 * float(self.slices.scan.spacing.min())), 3)
                self._edit_chosen()

    def on_layer(self, name: str, layer: Any) -> None:
        """Show another slice of a plane."""
        if self.slices is not None:
            plane = self.slices.planes[name]
            index = self.slices.scan.to_index(self.cursor[None])[0]
            index[plane.axis] = int(np.clip(int(layer), 0, plane.count - 1))
            self.move_to((self.slices.scan.origin + self.slices.scan.step @ index).tolist())

    def on_key(self, name: str, key: str, tool: str) -> None:
        """Handle a key on a slice."""
        if self.slices is None:
            return
        plane = self.slices.planes[name]
        if key in KEYS:
            which, step = KEYS[key]
            flat = plane.to_plane(self.slices.scan.to_index(self.cursor[None]))[0]
            spacing = self.slices.scan.spacing[[plane.right, plane.down]]
            flat[which] = np.clip(flat[which] + step * spacing[which], 0.0, plane.extent[which])
            self.move_to(plane.to_world(flat.tolist(), plane.layer_of(self.cursor.tolist())).tolist())
        elif key in ("PageUp", "PageDown"):
            self.on_layer(name, plane.layer_of(self.cursor.tolist()) + (1 if key == "PageUp" else -1))
        elif key == "Enter":
            if tool == "paint" and self.paint is not None:
                self.paint.dab(self.cursor, float(self.state.brush))
                self.state.painted = self.paint.count
                self.draw_slices()
            else:
                self.place_here()

    # --- The three-dimensional view -----------------------------------------------------------

    def on_press(self, x: float, y: float) -> None:
        """Remember where a pointer was pressed."""
        self._pressed = (x, y)

    def on_release(
        self, x: float, y: float, tool: str, size: Sequence[float] | None = None, camera: Any = None
    ) -> None:
        """Handle a click on the surface, by default with the camera of the server's pictures."""
        if size is None or camera is None:
            size, camera = self.scene.own_camera()
        pressed, self._pressed = self._pressed, None
        if pressed is None or np.hypot(x - pressed[0], y - pressed[1]) > CLICK:
            return
        position = self.scene.pick(x, y, size, camera)
        if position is None:
            return
        if tool == "ball":
            self.place_ball(position.tolist())
        elif tool == "paint" and self.paint is not None:
            self.paint.dab(position, float(self.state.brush))
            self.state.painted = self.paint.count
        self.move_to(position.tolist())

    def look_at_all(self) -> None:
        """Move the camera so that everything is visible."""
        self._move_camera(self.scene.look_at_all())
        self.move_to(self.cursor.tolist())

    def _move_camera(self, camera: dict[str, Any]) -> None:
        """Give the browsers the camera that the server already has."""
        self.server.js_call("view", "setCamera", camera)
        self.refresh_view()

    def fly(self, index: int) -> None:
        """Move the cursor and the camera to an entry of the list of places."""
        place = self.places[int(index)]
        if place.position is not None:
            self.state.clip = False
            self.move_to(place.position)
            self._move_camera(self.scene.fly(place.position, place.h or 1.0))

    # --- The list of requests -----------------------------------------------------------------

    def place_ball(self, position: Sequence[float]) -> None:
        """Add a ball to the list of requests, and select it."""
        if self.session is None:
            return
        present = size_at(self.session.mesh, position)
        x, y, z = (round(float(value), 3) for value in position)
        ball = Ball((x, y, z), round(RADIUS * present, 3), round(FINER * present, 4))
        self.session.add(ball)
        self.choose(len(self.requests) - 1)
        self.move_to(position)

    def place_here(self) -> None:
        """Place a ball at the cursor."""
        self.place_ball(self.cursor.tolist())

    def refine(self, index: int) -> None:
        """Place a ball at an entry of the list of places."""
        place = self.places[int(index)]
        if place.position is not None:
            self.place_ball(place.position)

    def choose(self, index: int) -> None:
        """Select a request of the list."""
        self.state.chosen = int(index)
        request = self.requests[int(index)]
        self.state.h = request.h
        if isinstance(request, Ball):
            self.state.radius = request.radius
        self.list_requests()
        self.draw_slices(images=False)
        self.refresh_view()

    def factor(self, value: float) -> None:
        """Set h of the selected request to a multiple of the present h there."""
        if self.session is not None and 0 <= self.state.chosen < len(self.requests):
            request = self.requests[self.state.chosen]
            centre = request.centre if isinstance(request, Ball) else self.cursor.tolist()
            self.state.h = round(float(value) * size_at(self.session.mesh, centre), 4)
            self._edit_chosen()

    def _edit_chosen(self) -> None:
        """Change the selected request to the radius and h in the input fields."""
        chosen = int(self.state.chosen)
        if self.session is None or not 0 <= chosen < len(self.requests) or (self.job and self.job.is_running):
            return
        old = self.requests[chosen]
        try:
            h, radius = float(self.state.h), float(self.state.radius)
        except (TypeError, ValueError):
            return
        new: Request = Ball(old.centre, radius, h) if isinstance(old, Ball) else Mask(old.path, h)
        if new != old and h > 0.0 and radius > 0.0:
            self.session.change(chosen, new)
            self.list_requests()
            self.draw_slices(images=False)
            self.refresh_view()

    def remove(self, index: int) -> None:
        """Remove a request from the list."""
        self._expect_idle()
        assert self.session is not None
        self.session.remove(int(index))
        self.list_requests()
        self.draw_slices(images=False)
        self.refresh_view()

    def take_paint(self) -> None:
        """Write the painted region to a file, and add it to the list."""
        if self.session is None or self.paint is None or not self.paint.count:
            raise Error("nothing is painted", "a region needs voxels", "choose Paint, and draw on a slice")
        path = self.paint.write(self.session)
        self.session.add(Mask(path, round(FINER * size_at(self.session.mesh, self.paint.centre().tolist()), 4)))
        self.clear_paint()
        self.choose(len(self.requests) - 1)

    def clear_paint(self) -> None:
        """Remove the paint."""
        if self.paint is not None:
            self.paint.clear()
            self.state.painted = 0
            self.draw_slices()

    # --- Jobs ---------------------------------------------------------------------------------

    def _expect_idle(self) -> None:
        if self.job is not None and self.job.is_running:
            raise Error("a run is in progress", "one run at a time changes the mesh", "wait for it, or stop it")

    def begin(self, job: Job, then: Callable[[], None]) -> None:
        """Watch a job. ``then`` is called if the job ends without an error and was not stopped."""
        self.job, self._then = job, then
        self.state.busy, self.state.problem = True, None

    def apply(self) -> None:
        """Apply the list of requests in the background."""
        self._expect_idle()
        session = self.session
        assert session is not None
        job = Job("update")
        self.begin(job.start(lambda: session.apply(job.progress)), self.show_mesh)

    def resume(self) -> None:
        """Apply the unsaved updates of the last session again, or prepare the first update."""
        session = self.session
        if session is not None and session.waiting:
            job = Job("update")
            self.begin(job.start(lambda: session.resume(job.progress)), self.show_mesh)
        elif session is not None:
            threading.Thread(target=session.prepare, daemon=True).start()

    def stop(self) -> None:
        """Stop the job."""
        if self.job is not None:
            self.job.stop()

    def undo(self) -> None:
        """Return to the mesh before the last update."""
        self._expect_idle()
        assert self.session is not None
        self.session.undo()
        self.show_mesh()
        self.refresh_view()

    def save(self) -> None:
        """Write the mesh, and show the command that makes it again."""
        self._expect_idle()
        assert self.session is not None
        self.session.save()
        self.list_requests()

    async def watch(self) -> None:
        """Show the progress of the jobs until the server ends."""
        while True:
            await asyncio.sleep(POLL)
            if self.job is None or not self.state.busy:
                continue
            job = self.job
            with self.state:
                self.state.job_text, self.state.job_share = job.text, job.share
                self.state.job_log, self.state.job_seconds = "\n".join(list(job.log)), f"{job.seconds:.1f} s"
                if not job.is_running:
                    self._end(job)

    def _end(self, job: Job) -> None:
        self.state.busy = False
        if job.error is not None:
            self.show_error(job.error)
            self.state.job_text = "Ended with an error."
            return
        if job.was_stopped:
            self.state.job_text = job.STOPPED
            return
        try:
            self._then()
        except Exception as error:  # the page shows it
            self.show_error(error)
        self.refresh_view()
        self.state.job_text = "Done."
