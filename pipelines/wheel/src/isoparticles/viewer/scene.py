"""The three-dimensional view: surface, quality colours, clip, balls and cursor.

The scene is made with PyVista. The browser draws it with vtk.js, so turning the view needs neither
the network nor a graphics card in the server.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pyvista as pv
from matplotlib import colormaps
from matplotlib.colors import to_hex
from numpy.typing import NDArray
from vtkmodules.vtkInteractionStyle import vtkInteractorStyleTrackballCamera
from vtkmodules.vtkRenderingUI import vtkGenericRenderWindowInteractor

from tetmesh_check.report.colours import Entry, material_colours

BACKGROUND = "#14171b"
PLAIN = (216, 207, 192)
EDGE = "#4a4f57"
BALL = "#ff9a3c"
CHOSEN = "#3d9bff"
BALL_OPACITY = 0.5
MARK = "#ff4060"
COLOURS = {"plain": "one colour", "radius_ratio": "radius ratio", "edge": "edge length, mm", "h": "h, mm"}
"""Colourings of the surface."""
MAPS = {"radius_ratio": "RdYlGn", "edge": "viridis", "h": "viridis"}
MINIMUM_RATIO = 0.3
"""Default minimum radius ratio of the check. The scale of colours starts there."""
FLY_DISTANCE = 12.0
"""Approximate height of the picture after a flight to a place, in edge lengths."""
VIEW_ANGLE = 30.0
Camera = dict[str, Any]


class Layer:
    """An actor that stays in the scene. Only its triangles or lines change.

    The client of trame-vtk knows actors by their address in memory, and keeps cells that a data set
    no longer has. An actor that replaces another one could therefore inherit its triangles.
    """

    def __init__(self, plotter: Any, first: pv.PolyData, **style: Any) -> None:
        self.is_coloured = "scalars" in style
        if self.is_coloured:
            first.cell_data["colours"] = np.zeros((first.n_cells, 3), dtype=np.uint8)
        self.actor = plotter.add_mesh(first, render=False, reset_camera=False, **style)
        self.hide()

    def hide(self) -> None:
        """Hide the layer."""
        self.actor.SetVisibility(False)

    def show(self, mesh: pv.PolyData, colours: NDArray[np.uint8] | None = None) -> None:
        """Replace the content. An empty mesh hides the layer."""
        if mesh.n_cells == 0:
            self.hide()
            return
        if colours is not None:
            mesh.cell_data["colours"] = colours
            mesh.set_active_scalars("colours", preference="cell")
        self.actor.mapper.SetInputData(mesh)
        self.actor.SetVisibility(True)


class Scene:
    """The layers of the view: surface, preview, balls, selected ball, cursor."""

    def __init__(self) -> None:
        # mypy misreads the decorated methods of PyVista
        with pv.vtk_verbosity("off"):  # VTK reports a missing X server, and works without one
            plotter: Any = pv.Plotter(off_screen=True)
        self.plotter = plotter
        self._interactor = vtkGenericRenderWindowInteractor()
        self._interactor.SetRenderWindow(plotter.render_window)
        # otherwise, every movement of the pointer renders a picture on the server that nobody sees
        self._interactor.EnableRenderOff()
        self._interactor.SetInteractorStyle(vtkInteractorStyleTrackballCamera())
        plotter.set_background(BACKGROUND)
        triangle, line = pv.Triangle(), pv.Line()
        coloured: dict[str, Any] = {"scalars": "colours", "rgb": True}
        self._surface = Layer(
            plotter, triangle.copy(), show_edges=True, edge_color=EDGE, line_width=1, ambient=0.3, **coloured
        )
        self._preview = Layer(plotter, triangle.copy(), **coloured)
        self._balls = Layer(plotter, triangle.copy(), color=BALL, opacity=BALL_OPACITY)
        self._chosen = Layer(plotter, triangle.copy(), color=CHOSEN, opacity=BALL_OPACITY)
        self._cursor = Layer(plotter, line, color=MARK, line_width=2)
        self.surface: pv.PolyData | None = None
        self.colour = "plain"
        self.edges = True
        self.clip: tuple[int, float, bool] | None = None
        self.shades: NDArray[np.uint8] | None = None
        self.legend: dict[str, Any] = {}
        self._bounds: tuple[NDArray[Any], NDArray[Any]] | None = None

    @property
    def window(self) -> Any:
        """The render window of VTK, whose content the browser draws."""
        return self.plotter.render_window

    def show_surface(self, surface: pv.PolyData) -> None:
        """Set the surface."""
        self.surface = surface
        add_edge_lengths(surface)
        self._preview.hide()
        self.draw_surface()
        self._look_once(surface)

    def _look_once(self, surface: pv.PolyData) -> None:
        """Store the bounds of a surface, and move the camera to the first one."""
        is_first = self._bounds is None
        low, high = np.reshape(surface.bounds, (3, 2)).T
        self._bounds = low, high
        if is_first:
            self.look_at_all()

    def draw_surface(self) -> None:
        """Draw the surface with the chosen colours, edges and clip."""
        self.legend = {}
        if self.surface is None:
            return
        shown = clipped(self.surface, self.clip)
        drawn = pv.PolyData.from_regular_faces(shown.points, shown.regular_faces)
        self._surface.actor.prop.show_edges = self.edges
        self._surface.show(drawn, self._colours_of(shown))

    def _colours_of(self, shown: pv.PolyData) -> NDArray[np.uint8]:
        """Return the colours of the triangles, and set the legend."""
        assert self.surface is not None
        if self.colour in MAPS and has_values(self.surface, self.colour):
            low, high = scale_of(self.surface, self.colour)
            self.legend = {"title": COLOURS[self.colour], "low": f"{low:.3g}", "high": f"{high:.3g}"}
            self.legend["gradient"] = gradient(MAPS[self.colour])
            share = (values_of(shown, self.colour) - low) / (high - low)
            return np.asarray(colormaps[MAPS[self.colour]](share, bytes=True)[:, :3], dtype=np.uint8)
        if self.shades is not None and "material_inside" in shown.cell_data:
            return np.asarray(self.shades[np.asarray(shown.cell_data["material_inside"], dtype=int)])
        return np.full((shown.n_cells, 3), PLAIN, dtype=np.uint8)

    def colourings(self) -> list[tuple[str, str]]:
        """List the names and titles of the colourings that the surface has."""
        surface = self.surface
        return [(k, v) for k, v in COLOURS.items() if surface and (k == "plain" or has_values(surface, k))]

    def show_balls(self, balls: Sequence[tuple[Sequence[float], float]], chosen: int) -> None:
        """Draw the balls of the list. Entries with the radius 0 are not balls and are not drawn."""
        spheres = [
            pv.Sphere(radius=radius, center=tuple(centre), theta_resolution=24, phi_resolution=16)
            for centre, radius in balls
            if radius > 0.0
        ]
        numbers = [i for i, (_, radius) in enumerate(balls) if radius > 0.0]
        for layer, wanted in ((self._balls, False), (self._chosen, True)):
            own = [sphere for i, sphere in zip(numbers, spheres, strict=True) if (i == chosen) == wanted]
            layer.show(appended(own))

    def show_cursor(self, position: Sequence[float], length: float) -> None:
        """Draw the cursor as three lines of the given half length."""
        ends = []
        for axis in range(3):
            step = np.zeros(3)
            step[axis] = length
            ends += [np.asarray(position) - step, np.asarray(position) + step]
        lines = pv.PolyData(np.array(ends), lines=np.array([[2, 0, 1], [2, 2, 3], [2, 4, 5]]))
        self._cursor.show(lines)

    def show_preview(self, surfaces: Sequence[tuple[pv.PolyData, Sequence[int]]]) -> None:
        """Draw the surfaces of a volume that has no mesh yet, each in its colour."""
        parts = [(surface, colour) for surface, colour in surfaces if surface.n_cells]
        colours = [np.full((surface.n_cells, 3), colour, dtype=np.uint8) for surface, colour in parts]
        whole = appended([surface for surface, _ in parts])
        self._preview.show(whole, np.vstack(colours) if colours else None)
        if parts:
            self._look_once(whole)

    def look_at_all(self) -> Camera:
        """Move the camera back to the whole surface; in LPS, from the front, left and above."""
        low, high = (np.zeros(3), np.ones(3)) if self._bounds is None else self._bounds
        focus, size = 0.5 * (low + high), float(np.linalg.norm(high - low))
        direction = np.array([0.55, -0.75, 0.37])
        distance = 0.46 * size / np.sin(np.radians(VIEW_ANGLE / 2.0))
        return self._look(focus, focus + distance * direction / np.linalg.norm(direction))

    def fly(self, position: Sequence[float], size: float) -> Camera:
        """Move the camera to a place, to the outside of the surface if there is one."""
        focus = np.asarray(position, dtype=float)
        direction = np.asarray(self.plotter.camera.position) - np.asarray(self.plotter.camera.focal_point)
        if self.surface is not None:
            near = int(np.linalg.norm(np.asarray(self.surface.points) - focus, axis=1).argmin())
            direction = outward(self.surface, near)
        direction = direction / max(float(np.linalg.norm(direction)), 1e-12)
        return self._look(focus, focus + FLY_DISTANCE * size * direction / np.tan(np.radians(VIEW_ANGLE)))

    def _look(self, focus: NDArray[Any], place: NDArray[Any]) -> Camera:
        axis = (focus - place) / max(float(np.linalg.norm(focus - place)), 1e-12)
        up = (0.0, 0.0, 1.0) if abs(axis[2]) < 0.95 else (0.0, 1.0, 0.0)
        camera = self.plotter.camera
        camera.focal_point, camera.position, camera.up = tuple(focus), tuple(place), up
        camera.view_angle = VIEW_ANGLE
        self.plotter.renderer.ResetCameraClippingRange()
        return {
            "position": [float(x) for x in place],
            "focalPoint": [float(x) for x in focus],
            "viewUp": list(up),
            "viewAngle": VIEW_ANGLE,
            "centerOfRotation": [float(x) for x in focus],
        }

    def own_camera(self) -> tuple[list[int], Camera]:
        """Return the size of the view and the camera of the pictures from the server."""
        camera = self.plotter.camera
        position, focus, up = camera.position, camera.focal_point, camera.up
        found = {"position": position, "focalPoint": focus, "viewUp": up, "viewAngle": camera.view_angle}
        return list(self.window.GetSize()), found

    def pick(self, x: float, y: float, size: Sequence[float], camera: Camera) -> NDArray[Any] | None:
        """Return the first visible point of the surface below a pixel of the browser's view.

        Parameters
        ----------
        x, y
            The pixel, from the lower left corner.
        size
            Width and height of the view in pixels.
        camera
            The camera of the browser: ``position``, ``focalPoint``, ``viewUp`` and ``viewAngle``.
        """
        if self.surface is None:
            return None
        eye, focus, up = (np.asarray(camera[key], dtype=float) for key in ("position", "focalPoint", "viewUp"))
        forward = (focus - eye) / np.linalg.norm(focus - eye)
        right = np.cross(forward, up)
        right /= np.linalg.norm(right)
        half = np.tan(np.radians(camera["viewAngle"] / 2.0))
        across, along = (2.0 * x - size[0]) / size[1], 2.0 * y / size[1] - 1.0
        ray = forward + half * (across * right + along * np.cross(right, forward))
        shown = clipped(self.surface, self.clip)
        points, _ = shown.ray_trace(
            eye, eye + 4.0 * (np.linalg.norm(focus - eye) + shown.length) * ray, first_point=True
        )
        return np.asarray(points, dtype=float) if len(points) else None


def add_edge_lengths(surface: pv.PolyData) -> None:
    """Add the mean edge length of each triangle as the array ``edge``."""
    corners = np.asarray(surface.points)[surface.regular_faces]
    lengths = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2)
    surface.cell_data["edge"] = lengths.mean(axis=1)


def has_values(surface: pv.PolyData, name: str) -> bool:
    """Return whether a surface has an array on points or on cells."""
    return name in surface.cell_data or name in surface.point_data


def values_of(surface: pv.PolyData, name: str) -> NDArray[Any]:
    """Return an array as values of triangles. Values at points are averaged over the corners."""
    if name in surface.cell_data:
        return np.asarray(surface.cell_data[name], dtype=float)
    return np.asarray(np.asarray(surface.point_data[name], dtype=float)[surface.regular_faces].mean(axis=1))


def scale_of(surface: pv.PolyData, name: str) -> tuple[float, float]:
    """Return the values at the ends of the scale of a colouring."""
    if name == "radius_ratio":
        return MINIMUM_RATIO, 1.0
    low, high = np.percentile(values_of(surface, name), [1, 99]).tolist()
    return low, high if high > low else low + 1e-6


def appended(parts: Sequence[pv.PolyData]) -> pv.PolyData:
    """Return the triangles of several surfaces as one, without their arrays."""
    if not parts:
        return pv.PolyData()
    starts = np.cumsum([0, *(part.n_points for part in parts[:-1])])
    faces = np.vstack([part.regular_faces + start for part, start in zip(parts, starts, strict=True)])
    whole: pv.PolyData = pv.PolyData.from_regular_faces(np.vstack([part.points for part in parts]), faces)
    return whole


def clipped(surface: pv.PolyData, clip: tuple[int, float, bool] | None) -> pv.PolyData:
    """Return the whole triangles on one side of a plane perpendicular to an axis of the world.

    Parameters
    ----------
    surface
        The surface.
    clip
        Axis, position in mm, and whether the side with larger coordinates is removed.
    """
    if clip is None:
        return surface
    axis, place, is_upper = clip
    middle = np.asarray(surface.points)[surface.regular_faces][:, :, axis].mean(axis=1)
    kept = middle <= place if is_upper else middle >= place
    part: pv.PolyData = pv.PolyData.from_regular_faces(surface.points, surface.regular_faces[kept])
    for name in surface.point_data:
        part.point_data[name] = surface.point_data[name]
    for name in surface.cell_data:
        part.cell_data[name] = np.asarray(surface.cell_data[name])[kept]
    return part


def outward(surface: pv.PolyData, vertex: int) -> NDArray[Any]:
    """Return the sum of the normals of the triangles at a vertex, weighted by area."""
    corners = np.asarray(surface.points)[surface.regular_faces[(surface.regular_faces == vertex).any(axis=1)]]
    found: NDArray[Any] = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]).sum(axis=0)
    return found if np.linalg.norm(found) > 0 else np.array([0.0, 0.0, 1.0])


def gradient(name: str) -> str:
    """Return a colour map as a gradient of CSS."""
    colours = ", ".join(to_hex(colormaps[name](x)) for x in np.linspace(0.0, 1.0, 9))
    return f"linear-gradient(to right, {colours})"


def shades_of_materials(key: list[Entry], count: int) -> NDArray[np.uint8]:
    """Return the colours of materials by number, the outside first."""
    own = [entry.colour for entry in key[: count - 1]]
    return np.array([(0, 0, 0), *own], dtype=np.uint8) if len(own) == count - 1 else material_colours(count)
