"""Fills the page: its state variables, slices, surface, list of places, and cursor."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

import isoparticles.viewer.case as cases
import isoparticles.viewer.lock as locks
from isoparticles._errors import Error
from isoparticles.viewer.paint import Paint
from isoparticles.viewer.places import Place, places_to_inspect
from isoparticles.viewer.run import Job
from isoparticles.viewer.scene import Scene, shades_of_materials
from isoparticles.viewer.session import Ball, Mask, Request, Session, command_line, size_at
from isoparticles.viewer.slices import PLANES, Slices


class Views:
    """The state of the page, and the objects that it shows."""

    def __init__(self, server: Any, shown: cases.Shown, address: str) -> None:
        self.server, self.state = server, server.state
        self.shown = shown
        self.address = address
        self._lock: int | None = None
        self.session: Session | None = None
        self.scene = Scene()
        self.slices: Slices | None = None
        self.paint: Paint | None = None
        self.job: Job | None = None
        self.places: list[Place] = []
        self.cursor: NDArray[Any] = np.zeros(3)
        self.refresh_view: Callable[[], None] = lambda: None
        """Sends the scene to the browser; the page sets it."""
        self._first_state()
        self.open()

    def _first_state(self) -> None:
        self.state.update({
            "title": self.shown.name, "verdict": "", "has_mesh": False, "has_volume": self.shown.is_volume,
            "is_scan": False, "counts": "", "note": "", "problem": None, "busy": False, "job_text": "",
            "job_share": None, "job_log": "", "job_seconds": "", "tool": "look", "radius": 1.0, "radius_max": 1.0,
            "h": 1.0, "h_here": "", "brush": 1.0, "chosen": -1, "requests": [], "applied": [], "can_undo": False,
            "is_fixed": False,
            "width": 1.0, "level": 0.0, "levels": [0.0, 1.0], "colour": "plain", "colours": [], "edges": True,
            "legend": {}, "clip": False, "clip_axis": 0, "clip_place": 0.0, "clip_low": 0.0, "clip_high": 1.0,
            "clip_upper": True, "places": [], "place_kind": "", "place_kinds": [], "key": [], "command": "",
            "cursor_text": "", "painted": 0, "planes": list(PLANES), "saved": True,
        })  # fmt: skip
        for name in PLANES:
            self.state[name] = {"w": 1.0, "h": 1.0, "scale": 1.0, "letters": ["", "", "", ""], "title": name}
            self.state[f"{name}_image"] = ""
            self.state[f"{name}_marks"] = {"path": "", "x": 0.0, "y": 0.0, "layer": 0, "balls": [], "text": ""}
            self.state[f"{name}_count"] = 1

    def open(self) -> None:
        """Show the case again: at the start, and after the stages have made a surface."""
        shown = self.shown
        self.state.note = " ".join(shown.notes)
        if shown.mesh is not None:
            self.lock()
            resize = "" if shown.case is None else shown.case.parameters.get("RESIZE", "")
            self.session = Session(shown.mesh, shown.folder, resize)
            self.state.note = f"{self.state.note} {self.session.note}".strip()
        if shown.scan is not None:
            self._open_scan()
        if shown.case is not None:
            self.state.verdict = shown.case.headline
        if self.session is not None:
            self.scene.shades = shades_of_materials(shown.key, len(shown.mesh.field.materials)) if shown.mesh else None
            self.show_mesh()
        self.move_to(cases.centre_of(shown))

    def lock(self) -> None:
        """Lock the folder of the case for this page.

        Raises
        ------
        Error
            If another page has locked it.
        """
        if self._lock is None and self.shown.folder is not None:
            self._lock = locks.take(self.shown.folder, self.address)

    def close(self) -> None:
        """Stop the job, and release the folder."""
        if self.job is not None:
            self.job.stop()
            self.job.wait()
        if self._lock is not None:
            os.close(self._lock)
            self._lock = None

    def _open_scan(self) -> None:
        shown = self.shown
        assert shown.scan is not None
        self.slices = Slices(shown.scan, shown.key)
        self.paint = Paint(shown.scan)
        low, high = self.slices.range
        labels = shown.scan.labels
        self.state.update({
            "levels": [low, high], "width": high - low, "level": 0.5 * (low + high), "is_scan": not labels,
            "brush": round(4.0 * float(shown.scan.spacing.mean()), 3),
            "key": [{"name": entry.name, "colour": f"#{bytes(entry.colour).hex()}"} for entry in shown.key],
        })  # fmt: skip
        for name, plane in self.slices.planes.items():
            self.state[f"{name}_count"] = plane.count
            self.state[name] = {
                "w": float(plane.extent[0]),
                "h": float(plane.extent[1]),
                "scale": self.slices.outline_scale(name),
                "letters": plane.letters,
                "title": plane.title,
            }

    def show_error(self, error: Exception) -> None:
        """Show an error on the page: what is wrong, why it matters, what to do."""
        if isinstance(error, Error):
            self.state.problem = {"what": error.what, "why": error.why, "next": error.next}
        else:
            name = type(error).__name__
            self.state.problem = {
                "what": f"{name}: {error}", "why": "the page could not finish this step",
                "next": "try again; the list of updates is kept",
            }  # fmt: skip

    # --- The mesh -----------------------------------------------------------------------------

    def show_mesh(self) -> None:
        """Show the present mesh everywhere."""
        assert self.session is not None
        mesh = self.session.mesh
        surface = mesh.surface.copy()
        self.scene.show_surface(surface)
        if self.slices is not None:
            self.slices.show_surface(surface)
        low, high = np.reshape(surface.bounds, (3, 2)).T
        axis = int(self.state.clip_axis)
        self.state.update({
            "has_mesh": True, "radius_max": round(0.25 * float(np.linalg.norm(high - low)), 3),
            "counts": f"{len(mesh.result.vertices):,} vertices, {len(mesh.result.triangles):,} triangles",
            "colours": [{"value": key, "title": title} for key, title in self.scene.colourings()],
            "clip_low": float(low[axis]), "clip_high": float(high[axis]),
        })  # fmt: skip
        if not self.state.clip:
            self.state.clip_place = float(0.5 * (low[axis] + high[axis]))
        self.state.legend = self.scene.legend
        self.list_places()
        self.list_requests()
        self.show_size()
        self.draw_slices()

    def list_places(self) -> None:
        """List the places of the mesh. The reports describe it before any update."""
        assert self.session is not None
        is_first = len(self.session.meshes) == 1 and not self.session.journal.applied
        folder = self.shown.folder if is_first else None
        self.places = places_to_inspect(self.session.mesh, self.shown.case, folder)
        kinds = list(dict.fromkeys(place.kind for place in self.places))
        self.state.places = [
            {"i": i, "kind": place.kind, "text": place.text, "there": place.position is not None}
            for i, place in enumerate(self.places)
        ]
        self.state.place_kinds = [{"kind": k, "count": sum(p.kind == k for p in self.places)} for k in kinds]
        if self.state.place_kind not in kinds:
            self.state.place_kind = kinds[0] if kinds else ""

    def draw_surface(self) -> None:
        """Draw the surface with the options of the page."""
        state, scene = self.state, self.scene
        scene.colour, scene.edges = state.colour, bool(state.edges)
        axis = int(state.clip_axis)
        if scene.surface is not None:
            low, high = np.reshape(scene.surface.bounds, (3, 2))[axis]
            state.clip_low, state.clip_high = float(low), float(high)
            state.clip_place = float(np.clip(state.clip_place, low, high))
        scene.clip = (axis, float(state.clip_place), bool(state.clip_upper)) if state.clip else None
        scene.draw_surface()
        state.legend = scene.legend
        self.refresh_view()

    # --- Slices and cursor --------------------------------------------------------------------

    def move_to(self, position: Sequence[float]) -> None:
        """Move the cursor, which all views share."""
        self.cursor = np.asarray(position, dtype=float)
        # long enough to extend beyond the surface
        self.scene.show_cursor(self.cursor.tolist(), 2.0 * float(self.state.radius_max))
        here = ", ".join(f"{x:.1f}" for x in self.cursor)
        self.state.cursor_text = f"{here} mm"
        self.show_size()
        self.draw_slices()
        self.refresh_view()

    def show_size(self) -> None:
        """Show h at the cursor."""
        if self.session is not None:
            h = size_at(self.session.mesh, self.cursor.tolist())
            self.state.h_here = f"{h:.3g}"

    def draw_slices(self, images: bool = True) -> None:
        """Draw the slices at the cursor, with new pictures if ``images``."""
        if self.slices is None:
            return
        for name, plane in self.slices.planes.items():
            layer = plane.layer_of(self.cursor.tolist())
            if images:
                mask = self.paint.flags if self.paint is not None and self.paint.count else None
                self.state[f"{name}_image"] = self.slices.picture(
                    name, layer, float(self.state.width), float(self.state.level), mask
                )
            x, y = plane.to_plane(self.slices.scan.to_index(self.cursor[None]))[0].tolist()
            self.state[f"{name}_marks"] = {
                "path": self.slices.outline(name, layer), "x": x, "y": y, "layer": layer,
                "balls": self._circles(name, layer), "text": f"{layer + 1} of {plane.count}",
            }  # fmt: skip

    def _circles(self, name: str, layer: int) -> list[dict[str, Any]]:
        """Return the circles in which the slice cuts the balls of the list."""
        assert self.slices is not None
        plane, found = self.slices.planes[name], []
        for i, request in enumerate(self.requests):
            if isinstance(request, Ball):
                index = self.slices.scan.to_index(np.array([request.centre]))
                depth = (float(index[0, plane.axis]) - layer) * float(self.slices.scan.spacing[plane.axis])
                if abs(depth) < request.radius:
                    x, y = plane.to_plane(index)[0].tolist()
                    r = float(np.sqrt(request.radius**2 - depth**2))
                    found.append({"x": x, "y": y, "r": r, "chosen": i == self.state.chosen})
        return found

    # --- The list of requests -----------------------------------------------------------------

    def _command(self) -> str:
        """Return the command that makes the saved mesh again; empty if the mesh is not saved."""
        shown, session = self.shown, self.session
        if shown.case is None or session is None or not self.state.saved or not session.journal.applied:
            return ""
        volume = {} if shown.volume is None else {"INPUT": str(shown.volume)}
        return command_line("surface", {**shown.case.parameters, **volume}, str(shown.out), session.resize())

    @property
    def requests(self) -> list[Request]:
        """The requests that are not applied yet."""
        return [] if self.session is None else self.session.pending

    def list_requests(self) -> None:
        """Show the list of requests and updates."""
        assert self.session is not None
        requests = self.requests
        self.state.chosen = min(int(self.state.chosen), len(requests) - 1)
        self.state.requests = [{"i": i, "text": told(request)} for i, request in enumerate(requests)]
        self.state.applied = ["\n".join(group) for group in self.session.journal.applied]
        self.state.can_undo = self.session.can_undo
        self.state.is_fixed = bool(self.session.journal.applied) and not self.session.can_undo
        self.state.saved = self.session.is_saved
        self.state.command = self._command()
        balls = [(r.centre, r.radius) if isinstance(r, Ball) else ((0.0, 0.0, 0.0), 0.0) for r in requests]
        self.scene.show_balls(balls, int(self.state.chosen))


def told(request: Request) -> str:
    """Describe a request for the list."""
    if isinstance(request, Mask):
        return f"region {request.path.rpartition('/')[2]}, h = {request.h:.4g} mm"
    centre = ", ".join(f"{x:.1f}" for x in request.centre)
    return f"ball at {centre}, radius {request.radius:.4g} mm, h = {request.h:.4g} mm"
