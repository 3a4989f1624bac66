"""Draws the pictures of a result.

``python -m tetmesh_check.report.pictures SURFACE VOLUME KIND=FILE...`` prints the kinds that it
drew, one per line.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
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
from tetmesh_check.space import in_lps

_WIDTH, _HEIGHT = 1600, 1200
_STRIP = 170
"""Height of the strip below a mesh with the colour bar or the names of materials, pixels."""
MESH_SHARE = 1 - _STRIP / _HEIGHT
"""Share of the height of a picture that is above the strip."""
_INK = "#7d858e"
"""Colour of text. It is legible on white and on black, because the background is transparent."""
_LETTERING = 40
"""Font size in the strip, pixels. On a page that shows the picture 550 pixels wide, it is 14."""
_SPREAD = 1.0
"""Percentile at the lower end of the colour bar, so that a few poor cells do not set its range."""
_TOWARDS_EYE, _UP = np.array([0.55, -0.75, 0.37]), np.array([0.0, 0.0, 1.0])
_CLOSEUP_EDGES = 22.0
"""Height of the close-up, relative to the local edge length."""
_LEGEND, _LETTERS = 8, 18
"""Maximum number of materials in the legend, which has rows of three, and of letters in a name."""


def cut_of(volume: pv.UnstructuredGrid) -> tuple[pv.PolyData, Points, Points]:
    """Cut the mesh across its shortest side, at the median of the centroids.

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
    # no centroid is below the median if all are in one plane
    return boundary_of(volume, kept if kept.any() else ~kept), normal, up


def boundary_of(volume: pv.UnstructuredGrid, kept: NDArray[Any]) -> pv.PolyData:
    """Return the boundary of some elements as triangles, oriented outward, with their cell data.

    Parameters
    ----------
    volume
        A mesh of tetrahedra and prisms.
    kept
        Whether each element is one of them, shape ``(m,)``.
    """
    surface = volume.extract_cells(kept).extract_surface(algorithm="dataset_surface")
    return surface if surface.is_all_triangles else surface.triangulate()


def _surface(surface: pv.PolyData, _volume: pv.UnstructuredGrid) -> Image.Image:
    if INSIDE in surface.cell_data:
        surface.cell_data["colour"] = materials_of(surface)[1][surface.cell_data[INSIDE]]
    return draw(surface)


def _closeup(surface: pv.PolyData, _volume: pv.UnstructuredGrid) -> Image.Image:
    """Show the triangle nearest to the eye, which is always visible, and its surroundings."""
    quality = triangle_quality(*from_polydata(surface))
    surface.cell_data["radius_ratio"] = quality.radius_ratio
    centres = surface.cell_centers().points
    focus = centres[np.argmax(centres @ _TOWARDS_EYE)]
    around = np.argsort(np.linalg.norm(centres - focus, axis=1))[:200]
    height = _CLOSEUP_EDGES * float(np.median(quality.edge_length[around]))
    return draw(surface, title="radius ratio of the surface triangles", part=(focus, height))


def _cut(_surface: pv.PolyData, volume: pv.UnstructuredGrid) -> Image.Image:
    mesh, normal, up = cut_of(volume)
    return draw(mesh, _aside(normal, up), up, "radius ratio of the tetrahedra")


def _regions(surface: pv.PolyData, volume: pv.UnstructuredGrid) -> Image.Image:
    mesh, normal, up = cut_of(volume)
    table, colours = materials_of(surface)
    region = mesh.cell_data["region"]
    mesh.cell_data["colour"] = colours[region]
    # the materials with the most triangles first
    numbers, counts = np.unique(region, return_counts=True)
    names = [(str(table[k]["name"]), colours[k]) for k in numbers[np.argsort(-counts, kind="stable")]]
    return draw(mesh, _aside(normal, up), up, names=names)


def _aside(normal: Points, up: Points) -> Points:
    """Return a direction slightly beside the normal, so that the depth of a cut is visible."""
    return normal + 0.28 * np.cross(up, normal) + 0.22 * up


_PICTURES = {"surface": _surface, "closeup": _closeup, "cut": _cut, "regions": _regions}


def draw(
    mesh: pv.PolyData,
    towards_eye: Points = _TOWARDS_EYE,
    up: Points = _UP,
    title: str = "",
    names: Sequence[tuple[str, Any]] = (),
    part: tuple[Points, float] | None = None,
) -> Image.Image:
    """Draw a mesh, with a colour bar or the names of its materials below it.

    The projection is parallel, so that sizes can be compared.

    Parameters
    ----------
    mesh
        Triangles with cell data ``colour`` (RGB), or ``radius_ratio`` if there is a title.
    towards_eye, up
        Directions in the world.
    title
        Title of the colour bar.
    names
        Names and colours of the materials below the mesh.
    part
        Centre and height, mm, of the part that is shown; by default the whole mesh.
    """
    rows = [_HEIGHT - _STRIP, _STRIP] if title or names else [_HEIGHT]
    plotter = _plotter(rows)
    # the whole mesh fits, with a small margin
    axes = np.cross(up, towards_eye), np.cross(towards_eye, np.cross(up, towards_eye))
    wide, high = (np.ptp(mesh.points @ axis) / np.linalg.norm(axis) for axis in axes)
    height = float(1.12 * max(high, wide / (_WIDTH / rows[0])))
    focus, shown_height = part or (mesh.center, height)
    height = min(height, shown_height)
    # the edge length of an equilateral triangle of mean area, pixels
    edge = (4 / 3**0.5 * mesh.area / mesh.n_cells) ** 0.5 / height * rows[0]
    shown = plotter.add_mesh(
        mesh,
        **_colouring(mesh, title),
        show_edges=True,
        edge_color="#2b2b2b",
        line_width=float(np.clip(edge / 16.0, 0.25, 2.0)),
        edge_opacity=float(np.clip(edge / 10.0, 0.2, 1.0)),
        ambient=0.3,
        diffuse=0.7,
        show_scalar_bar=False,
    )
    plotter.view_vector(towards_eye, up)
    plotter.enable_parallel_projection()
    plotter.camera.position += focus - np.array(plotter.camera.focal_point)
    plotter.camera.focal_point = focus
    plotter.camera.parallel_scale = 0.5 * height
    plotter.reset_camera_clipping_range()
    if title:
        _add_bar(plotter, title, shown.mapper)
    image = Image.fromarray(plotter.screenshot(transparent_background=True, return_img=True))
    plotter.close()
    if names:
        _write_names(image, names)
    return image


def _plotter(rows: list[int]) -> pv.Plotter:
    """Return an empty picture; ``rows`` are the heights of its parts, pixels."""
    plotter = pv.Plotter(
        off_screen=True,
        shape=(len(rows), 1),
        row_weights=rows,
        border=False,
        window_size=[_WIDTH, _HEIGHT],
        lighting="three lights",
    )
    plotter.enable_anti_aliasing("msaa", multi_samples=8)
    return plotter


def _add_bar(plotter: pv.Plotter, title: str, mapper: Any) -> None:
    """Draw the colour bar into the strip."""
    plotter.subplot(1, 0)
    plotter.add_scalar_bar(
        title,
        mapper=mapper,
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


def _colouring(mesh: pv.PolyData, title: str) -> dict[str, Any]:
    """Return the arguments of ``add_mesh`` that colour the mesh."""
    if title:
        # prisms have no radius ratio
        low = min(float(np.nanpercentile(mesh["radius_ratio"], _SPREAD)), 0.99)
        return {"scalars": "radius_ratio", "clim": (low, 1.0), "cmap": "viridis", "below_color": "#440154"}
    if "colour" in mesh.cell_data:
        return {"scalars": "colour", "rgb": True}
    return {"color": "#f0dfcb"}


def _write_names(image: Image.Image, names: Sequence[tuple[str, Any]]) -> None:
    """Write the first names into the strip, each after a square of its colour."""
    pen, font = ImageDraw.Draw(image), ImageFont.load_default(_LETTERING)
    shown = [(name[:_LETTERS], tuple(colour)) for name, colour in names[:_LEGEND]]
    if len(names) > _LEGEND:
        shown.append((f"and {len(names) - _LEGEND} more", (0, 0, 0, 0)))
    for k, (name, colour) in enumerate(shown):
        x, y = 60 + k % 3 * _WIDTH // 3, _HEIGHT - _STRIP + 15 + k // 3 * 50
        pen.rectangle((x, y, x + 40, y + 40), colour)
        pen.text((x + 55, y + 20), name, _INK, font, anchor="lm")


def main(surface_path: str, volume_path: str, *targets: str) -> None:
    """Draw pictures. If one fails, the others are still drawn.

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
    surface, volume = (in_lps(pv.read(path), Path(path)) for path in (surface_path, volume_path))
    failed = []
    for target in targets:
        kind, _, path = target.partition("=")
        try:
            Path(path).parent.mkdir(parents=True, exist_ok=True)
            write_atomically(Path(path), _PICTURES[kind](surface.copy(), volume).save)
            print(kind, flush=True)
        except Exception as error:
            failed.append(f"{kind}: {type(error).__name__}: {error}")
    if failed:
        raise SystemExit("; ".join(failed))


if __name__ == "__main__":
    main(*sys.argv[1:])
