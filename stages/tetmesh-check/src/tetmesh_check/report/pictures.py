"""Draws the pictures of a result.

``python -m tetmesh_check.report.pictures SURFACE VOLUME KIND=FILE...`` writes the kinds that it
drew to the standard output, one a line.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pyvista as pv
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from tetmesh_check.datasets import from_polydata
from tetmesh_check.files import write_atomically
from tetmesh_check.materials import INSIDE
from tetmesh_check.quality import Points, triangle_quality
from tetmesh_check.report.colours import materials_of
from tetmesh_check.report.rendering import use_renderer

_WIDTH, _HEIGHT = 1600, 1200
_STRIP = 170
"""Height below a mesh for the colour bar or the names of materials, pixels."""
MESH_SHARE = 1 - _STRIP / _HEIGHT
"""Share of the height of a picture above the strip."""
_INK = "#7d858e"
"""Colour of words: legible on white and on black, because what is round the mesh is transparent."""
_LETTERING = 40
"""Font size in the strip, pixels: 14 on a page that shows the picture 550 pixels wide."""
_SPREAD = 1.0
"""Percentile at the lower end of the colours: the few worst do not decide what all others look
like."""
_CLOSEUP_EDGES = 22.0
"""Height of the close-up in local edge lengths."""
_LEGEND, _LETTERS = 8, 18
"""Materials that the legend names at most, in rows of three, and letters of a name."""


@dataclass
class Scene:
    """What a picture shows. There is no perspective, so that sizes can be compared."""

    mesh: pv.PolyData
    """Triangles with cell data ``colour`` (RGB), or ``radius_ratio`` if there is a title."""
    towards_eye: Points = field(default_factory=lambda: np.array([0.55, -0.75, 0.37]))
    up: Points = field(default_factory=lambda: np.array([0.0, 0.0, 1.0]))
    title: str = ""
    """Title of the colour bar."""
    names: list[tuple[str, Any]] = field(default_factory=list)
    """Names and colours of the materials below the mesh."""
    focus: Points | None = None
    """Middle of the picture; that of the mesh by default."""
    height: float = np.inf
    """Of the part that is shown, mm; the whole mesh if that is smaller."""


def cut_of(volume: pv.UnstructuredGrid) -> tuple[pv.PolyData, Points, Points]:
    """Cut across the shortest side of the object, at the median of the tetrahedra.

    Parameters
    ----------
    volume
        A mesh as ``tetmesh-check`` writes it.

    Returns
    -------
    tuple
        The boundary of the farther half; the direction from it towards the eye, along an axis of
        the world; and the upward direction of a picture.
    """
    axis = int(np.argmin(np.ptp(volume.points, axis=0)))
    normal = np.zeros(3)
    normal[axis] = -1.0 if axis == 1 else 1.0
    up = np.array([0.0, 1.0, 0.0]) if axis == 2 else np.array([0.0, 0.0, 1.0])
    depth = volume.cell_centers().points @ normal
    kept = depth < np.median(depth)
    # none lie before the median if all lie in one plane
    return boundary_of(volume, kept if kept.any() else ~kept), normal, up


def boundary_of(volume: pv.UnstructuredGrid, kept: NDArray[Any]) -> pv.PolyData:
    """Return the boundary of some tetrahedra, outward, with their cell data.

    Parameters
    ----------
    volume
        A mesh of tetrahedra.
    kept
        Whether each tetrahedron is one of them, shape ``(m,)``.
    """
    return volume.extract_cells(kept).extract_surface(algorithm="dataset_surface")


def _surface(surface: pv.PolyData, _volume: pv.UnstructuredGrid) -> Scene:
    if INSIDE in surface.cell_data:
        surface.cell_data["colour"] = materials_of(surface)[1][surface.cell_data[INSIDE]]
    return Scene(surface)


def _closeup(surface: pv.PolyData, _volume: pv.UnstructuredGrid) -> Scene:
    """Look at the triangle nearest to the eye, which nothing hides."""
    scene = Scene(surface, title="radius ratio of the surface triangles")
    quality = triangle_quality(*from_polydata(surface))
    surface.cell_data["radius_ratio"] = quality.radius_ratio
    centres = surface.cell_centers().points
    scene.focus = centres[np.argmax(centres @ scene.towards_eye)]
    around = np.argsort(np.linalg.norm(centres - scene.focus, axis=1))[:200]
    scene.height = _CLOSEUP_EDGES * float(np.median(quality.edge_length[around]))
    return scene


def _cut(_surface: pv.PolyData, volume: pv.UnstructuredGrid) -> Scene:
    """Look slightly from the side, so that the depth of the cut shows."""
    mesh, normal, up = cut_of(volume)
    aside = normal + 0.28 * np.cross(up, normal) + 0.22 * up
    return Scene(mesh, aside, up, "radius ratio of the tetrahedra")


def _regions(surface: pv.PolyData, volume: pv.UnstructuredGrid) -> Scene:
    scene = _cut(surface, volume)
    table, colours = materials_of(surface)
    region = scene.mesh.cell_data["region"]
    scene.mesh.cell_data["colour"] = colours[region]
    # the largest on the cut first
    numbers, areas = np.unique(region, return_counts=True)
    scene.names = [(str(table[k]["name"]), colours[k]) for k in numbers[np.argsort(-areas, kind="stable")]]
    scene.title = ""
    return scene


_SCENES = {"surface": _surface, "closeup": _closeup, "cut": _cut, "regions": _regions}


def _height_of(scene: Scene, aspect: float) -> float:
    """Return the height that shows the whole mesh with a small margin, mm."""
    right = np.cross(scene.up, scene.towards_eye)
    above = np.cross(scene.towards_eye, right)
    width, height = (np.ptp(scene.mesh.points @ axis) / np.linalg.norm(axis) for axis in (right, above))
    return float(1.12 * max(height, width / aspect))


def draw(scene: Scene) -> Image.Image:
    """Draw a scene, with the bar of its colours or the names of its materials below it.

    Parameters
    ----------
    scene
        The content.
    """
    rows = [_HEIGHT - _STRIP, _STRIP] if scene.title or scene.names else [_HEIGHT]
    plotter = pv.Plotter(
        off_screen=True,
        shape=(len(rows), 1),
        row_weights=rows,
        border=False,
        window_size=[_WIDTH, _HEIGHT],
        lighting="three lights",
    )
    plotter.enable_anti_aliasing("msaa", multi_samples=8)
    height = min(scene.height, _height_of(scene, _WIDTH / rows[0]))
    # the edge length of an equilateral triangle of mean area, pixels
    edge = (4 / 3**0.5 * scene.mesh.area / scene.mesh.n_cells) ** 0.5 / height * rows[0]
    shown = plotter.add_mesh(
        scene.mesh,
        **_colouring(scene),
        show_edges=True,
        edge_color="#2b2b2b",
        line_width=float(np.clip(edge / 16.0, 0.25, 2.0)),
        edge_opacity=float(np.clip(edge / 10.0, 0.2, 1.0)),
        ambient=0.3,
        diffuse=0.7,
        show_scalar_bar=False,
    )
    plotter.view_vector(scene.towards_eye, scene.up)
    plotter.enable_parallel_projection()
    if scene.focus is not None:
        plotter.camera.position += scene.focus - np.array(plotter.camera.focal_point)
        plotter.camera.focal_point = scene.focus
    plotter.camera.parallel_scale = 0.5 * height
    plotter.reset_camera_clipping_range()
    if scene.title:
        plotter.subplot(1, 0)
        plotter.add_scalar_bar(
            scene.title,
            mapper=shown.mapper,
            n_labels=3,
            fmt="%.3g",
            color=_INK,
            bold=True,
            title_font_size=_LETTERING,
            label_font_size=_LETTERING,
            position_x=0.12,
            position_y=0.05,
            width=0.76,
            height=0.9,
        )
    image = Image.fromarray(plotter.screenshot(transparent_background=True, return_img=True))
    plotter.close()
    if scene.names:
        _write_names(image, scene.names)
    return image


def _colouring(scene: Scene) -> dict[str, Any]:
    """Return the arguments of ``add_mesh`` that colour the mesh."""
    if scene.title:
        low = min(float(np.percentile(scene.mesh["radius_ratio"], _SPREAD)), 0.99)
        return {"scalars": "radius_ratio", "clim": (low, 1.0), "cmap": "viridis", "below_color": "#440154"}
    if "colour" in scene.mesh.cell_data:
        return {"scalars": "colour", "rgb": True}
    return {"color": "#f0dfcb"}


def _write_names(image: Image.Image, names: list[tuple[str, Any]]) -> None:
    """Write the first names after squares of their colours into the strip."""
    pen, font = ImageDraw.Draw(image), ImageFont.load_default(_LETTERING)
    shown = [(name[:_LETTERS], tuple(colour)) for name, colour in names[:_LEGEND]]
    if len(names) > _LEGEND:
        shown.append((f"and {len(names) - _LEGEND} more", (0, 0, 0, 0)))
    for k, (name, colour) in enumerate(shown):
        x, y = 60 + k % 3 * _WIDTH // 3, _HEIGHT - _STRIP + 15 + k // 3 * 50
        pen.rectangle((x, y, x + 40, y + 40), colour)
        pen.text((x + 55, y + 20), name, _INK, font, anchor="lm")


def main(surface_path: str, volume_path: str, *targets: str) -> None:
    """Draw pictures; one that fails does not take the others with it.

    Parameters
    ----------
    surface_path
        The input surface.
    volume_path
        The volume mesh, with cell data ``radius_ratio``.
    targets
        Kinds of pictures and their files, ``KIND=FILE``.
    """
    use_renderer()
    surface, volume = pv.read(surface_path), pv.read(volume_path)
    failed = []
    for target in targets:
        kind, _, path = target.partition("=")
        try:
            Path(path).parent.mkdir(parents=True, exist_ok=True)
            write_atomically(Path(path), draw(_SCENES[kind](surface.copy(), volume)).save)
            print(kind, flush=True)
        except Exception as error:
            failed.append(f"{kind}: {type(error).__name__}: {error}")
    if failed:
        raise SystemExit("; ".join(failed))


if __name__ == "__main__":
    main(*sys.argv[1:])
