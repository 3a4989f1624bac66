"""Pictures of the result, drawn by separate processes.

Drawing happens in processes of its own because VTK may end them where it finds no renderer (see
:mod:`.rendering`), and so that the rest of the work goes on beside it.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

import numpy as np

from tetmesh_check.report.rendering import rendering_environment

PICTURES = ("surface", "closeup", "cut", "regions", "quality")
"""The pictures, in the order they are drawn; ``regions`` of many materials only."""
_RENDERED = frozenset({"surface", "closeup", "cut", "regions"})
_SHARES = (("surface", "quality"), ("closeup", "cut", "regions"))
"""Pictures of each process, with about equal work."""
_DRAWING_SECONDS = 300.0
_WINDOW = (1600, 1200)
_BAR = 170
"""Height of the colour bar below a coloured mesh, pixels."""
_INK = "#7d858e"
"""Colour of words: legible on white and on black, because what is round the mesh is transparent."""
_SPREAD = 1.0
"""Percentile at the lower end of the colours: the few worst do not decide what all others look
like."""
_VIEW = np.array([0.55, -0.75, 0.37])
"""From the object towards the eye."""
_UP = (0.0, 0.0, 1.0)
_SURFACE_COLOUR = "#f0dfcb"
_EDGE_COLOUR = "#2b2b2b"
_CLOSEUP_EDGES = 22.0
"""Height of the close-up in local edge lengths."""
_COLOURS = "viridis"
_LEGEND = 8
"""Materials that the legend names at most."""
_LETTERS = 18
"""Letters of a name there."""
_LETTERING = 30.0
"""Font size below a picture, points: 14 pixels on a page that shows the picture 550 pixels wide."""
_MARK, _LETTER, _LINE = 5.0, 0.62, 1.45
"""Sizes in the legend over the font size: a column without its name, a letter, and a row."""
_POINTS = 72 / 100
"""Points per pixel of the legend, which is drawn at 100 dots per inch."""


@dataclass(frozen=True)
class PictureJob:
    """The pictures to draw."""

    surface: Path
    """The input surface."""
    volume: Path
    """The volume mesh, with cell data ``radius_ratio`` and ``min_dihedral``."""
    folder: Path
    """Folder of the pictures."""
    name: str
    """Name of the case; a picture is called ``NAME.PICTURE.png``."""
    many: bool = False
    """Whether the volume mesh is of many materials."""

    def path(self, picture: str) -> Path:
        """File of one of :data:`PICTURES`."""
        return self.folder / f"{self.name}.{picture}.png"


class Drawing:
    """Pictures that other processes draw; leaving the context ends these.

    Parameters
    ----------
    job
        The pictures to draw; the files of the job must exist.
    """

    def __init__(self, job: PictureJob) -> None:
        environment = rendering_environment()
        self._job = job
        self._skipped = {
            picture: "no off-screen renderer on this machine (Debian, Ubuntu: apt-get install libosmesa6, or libegl1 libgl1-mesa-dri)"
            for picture in PICTURES
            if environment is None and picture in _RENDERED and (job.many or picture != "regions")
        }
        self._folder = tempfile.TemporaryDirectory(prefix="tetmesh-check-")
        self._started = time.monotonic()
        self._processes: list[tuple[tuple[str, ...], subprocess.Popen[bytes]]] = []
        for number, share in enumerate(_SHARES):
            wanted = tuple(p for p in share if p not in self._skipped and (job.many or p != "regions"))
            if wanted:
                self._processes.append((wanted, self._start(number, wanted, environment)))

    def _start(
        self, number: int, wanted: tuple[str, ...], environment: dict[str, str] | None
    ) -> subprocess.Popen[bytes]:
        description = Path(self._folder.name) / f"{number}.json"
        job = {
            "surface": str(self._job.surface.absolute()),
            "volume": str(self._job.volume.absolute()),
            "folder": self._folder.name,
            "name": self._job.name,
            "pictures": wanted,
        }
        description.write_text(json.dumps(job), encoding="utf-8")
        with description.with_suffix(".err").open("wb") as words:
            return subprocess.Popen(
                [sys.executable, "-m", "tetmesh_check.report.pictures", str(description)],
                env=environment,
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=words,
            )

    def finish(self) -> tuple[list[str], dict[str, str]]:
        """Wait for the pictures and put them where they belong.

        Returns
        -------
        tuple
            The file names of the pictures that are there, and for each that is not, by its name,
            the reason.
        """
        drawn = set()
        for wanted, process in self._processes:
            reason = self._wait(process)
            for picture in wanted:
                fresh = Path(self._folder.name) / f"{self._job.name}.{picture}.png"
                if fresh.is_file():
                    target = self._job.path(picture)
                    temporary = target.with_name(f".isoparticles-{target.name}.partial")
                    temporary.write_bytes(fresh.read_bytes())
                    temporary.replace(target)
                    drawn.add(picture)
                else:
                    self._skipped[picture] = reason or "the drawing process wrote no file"
        return [self._job.path(picture).name for picture in PICTURES if picture in drawn], self._skipped

    def _wait(self, process: subprocess.Popen[bytes]) -> str:
        """Wait for a process; what became of it where it failed."""
        try:
            code = process.wait(max(0.0, self._started + _DRAWING_SECONDS - time.monotonic()))
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
            return f"the drawing process was ended after {_DRAWING_SECONDS:g} s"
        if code == 0:
            return ""
        description = Path(process.args[-1])  # type: ignore[index, arg-type]
        words = description.with_suffix(".err").read_text(encoding="utf-8", errors="replace").strip().splitlines()
        return f"the drawing process ended with code {code}: {words[-1] if words else ''}"

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        for _wanted, process in self._processes:
            if process.poll() is None:
                process.kill()
                process.wait()
        self._folder.cleanup()


def _plotter(height: int = _WINDOW[1]) -> Any:
    import pyvista as pv

    plotter = pv.Plotter(off_screen=True, window_size=[_WINDOW[0], height], lighting="three lights")
    plotter.set_background("white")
    plotter.enable_anti_aliasing("msaa", multi_samples=8)
    return plotter


def _look(plotter: Any, focus: Any, towards_eye: Any, height: float, up: Any = _UP) -> None:
    """Look at a point without perspective, so that sizes can be compared."""
    direction = np.asarray(towards_eye) / np.linalg.norm(towards_eye)
    plotter.camera.focal_point = tuple(focus)
    plotter.camera.position = tuple(np.asarray(focus) + 10.0 * height * direction)
    plotter.camera.up = up
    plotter.enable_parallel_projection()
    plotter.camera.parallel_scale = 0.5 * height
    plotter.reset_camera_clipping_range()


def _height_in_view(points: Any, towards_eye: Any, up: Any = _UP, height: int = _WINDOW[1]) -> float:
    """Height of the window of so many pixels, in mm, that shows all points with a small margin."""
    direction = np.asarray(towards_eye) / np.linalg.norm(towards_eye)
    right = np.cross(up, direction)
    right /= np.linalg.norm(right)
    above = np.cross(direction, right)
    aspect = _WINDOW[0] / height
    across, along = np.ptp(points @ right), np.ptp(points @ above)
    return float(1.12 * max(along, across / aspect))


def _centre(points: Any) -> Any:
    return 0.5 * (points.min(axis=0) + points.max(axis=0))


def _range(values: Any) -> tuple[float, float]:
    """Ends of the colours for a radius ratio: the first percentile, and 1, which is regular."""
    return min(float(np.percentile(values, _SPREAD)), 0.99), 1.0


def _save_with_bar(plotter: Any, path: Path, title: str, limits: tuple[float, float]) -> None:
    """Write what a plotter shows, with the bar of its colours below and not over it."""
    import matplotlib as mpl

    mpl.use("Agg")
    from matplotlib import pyplot

    figure = pyplot.figure(figsize=(_WINDOW[0] / 100, _BAR / 100), dpi=100)
    axis = figure.add_axes((0.12, 0.66, 0.76, 0.2))
    norm = mpl.colors.Normalize(*limits)
    bar = figure.colorbar(mpl.cm.ScalarMappable(norm, _COLOURS), cax=axis, orientation="horizontal", extend="min")
    bar.set_ticks(
        [limits[0], 0.5 * sum(limits), limits[1]],
        labels=[f"{v:.3g}" for v in (limits[0], 0.5 * sum(limits), limits[1])],
    )
    bar.outline.set_visible(False)
    axis.tick_params(labelsize=_LETTERING, colors=_INK, length=0, pad=2)
    axis.set_xlabel(title, fontsize=_LETTERING, color=_INK, labelpad=0)
    _save_above(plotter, path, figure)


def _save_above(plotter: Any, path: Path, figure: Any) -> None:
    """Write what a plotter shows, with a strip of matplotlib's below and not over it."""
    from matplotlib import pyplot
    from PIL import Image

    mesh = Image.fromarray(plotter.screenshot(None, transparent_background=True, return_img=True))
    strip_path = path.with_name(f"{path.stem}.strip.png")
    figure.savefig(strip_path, transparent=True)
    pyplot.close(figure)
    whole = Image.new("RGBA", _WINDOW)
    with Image.open(strip_path) as strip:
        whole.paste(mesh, (0, 0))
        whole.paste(strip.convert("RGBA"), (0, mesh.height))
    whole.save(path)


def _edge_width(shown_height: float, edge_length: float) -> float:
    """Line width in pixels that leaves the faces visible between the edges."""
    pixels = edge_length / shown_height * _WINDOW[1]
    return float(np.clip(pixels / 16.0, 0.25, 2.0))


def _materials_of(surface: Any, volume: Any) -> tuple[list[str], Any]:
    """Return the names and the colours of materials by number."""
    from tetmesh_check.field_data import text_of
    from tetmesh_check.materials import INSIDE, OUTSIDE
    from tetmesh_check.report.colours import material_colours

    names = [entry["name"] for entry in json.loads(text_of(volume, "materials") or "[]")]
    return names, material_colours(len(names), np.column_stack([surface.cell_data[k] for k in (INSIDE, OUTSIDE)]))


def _draw_surface(surface: Any, volume: Any, path: Path) -> None:
    from tetmesh_check.materials import INSIDE

    plotter = _plotter()
    points = np.asarray(surface.points)
    height = _height_in_view(points, _VIEW)
    edge = float(np.sqrt(2.3 * surface.area / surface.n_cells))
    colours: dict[str, Any] = {"color": _SURFACE_COLOUR}
    if INSIDE in surface.cell_data:
        surface.cell_data["colour"] = _materials_of(surface, volume)[1][surface.cell_data[INSIDE]]
        colours = {"scalars": "colour", "rgb": True}
    plotter.add_mesh(
        surface,
        **colours,
        show_edges=True,
        edge_color=_EDGE_COLOUR,
        line_width=_edge_width(height, edge),
        edge_opacity=float(np.clip(edge / height * _WINDOW[1] / 20.0, 0.25, 1.0)),
        ambient=0.22,
        diffuse=0.7,
        specular=0.05,
    )
    _look(plotter, _centre(points), _VIEW, height)
    plotter.screenshot(path, transparent_background=True)


def _draw_closeup(surface: Any, _volume: Any, path: Path) -> None:
    from tetmesh_check.polydata import from_polydata
    from tetmesh_check.quality import triangle_quality

    plotter = _plotter(_WINDOW[1] - _BAR)
    points, triangles = from_polydata(surface)
    quality = triangle_quality(points, triangles)
    surface.cell_data["radius ratio"] = quality.radius_ratio
    limits = _range(quality.radius_ratio)
    # The triangle nearest to the eye is hidden by nothing.
    direction = _VIEW / np.linalg.norm(_VIEW)
    nearest = int(np.argmax(points[triangles].mean(axis=1) @ direction))
    corner = points[triangles[nearest]]
    normal = np.cross(corner[1] - corner[0], corner[2] - corner[0])
    normal /= np.linalg.norm(normal)
    near = np.linalg.norm(points[triangles].mean(axis=1) - corner.mean(axis=0), axis=1)
    around = np.argsort(near)[:200]
    edge = float(np.median(quality.edge_length[around]))
    height = min(_CLOSEUP_EDGES * edge, _height_in_view(points, normal))
    plotter.add_mesh(
        surface,
        scalars="radius ratio",
        clim=limits,
        ambient=0.35,
        diffuse=0.7,
        cmap=_COLOURS,
        show_edges=True,
        edge_color=_EDGE_COLOUR,
        line_width=_edge_width(height, edge),
        show_scalar_bar=False,
    )
    up = _UP if abs(normal[2]) < 0.95 else (0.0, 1.0, 0.0)
    _look(plotter, corner.mean(axis=0), normal, height, up)
    _save_with_bar(plotter, path, "radius ratio of the surface triangles", limits)


def _edge_length(points: Any, cells: Any) -> float:
    """Edge length of the regular tetrahedron of mean volume, mm."""
    from tetmesh_check.quality import signed_tetrahedron_volumes

    return float((2.0**0.5 * 6.0 * signed_tetrahedron_volumes(points, cells).mean()) ** (1.0 / 3.0))


def _cut_of(volume: Any) -> tuple[Any, Any, Any]:
    """The farther half, the cut, and the edge length of the tetrahedra, mm."""
    import pyvista as pv

    from tetmesh_check.polydata import to_polydata
    from tetmesh_check.report.cut import cut_of

    points = np.asarray(volume.points, dtype=np.float64)
    cells = np.asarray(volume.cells_dict[pv.CellType.TETRA], dtype=np.int64)
    cut = cut_of(volume)
    used, local = np.unique(cut.triangles, return_inverse=True)
    return to_polydata(points[used], local.reshape(-1, 3)), cut, _edge_length(points, cells)


def _show_cut(plotter: Any, kept: Any, cut: Any, edge: float, **colours: Any) -> None:
    """Show the farther half slightly from the side, so that the depth of the cut shows."""
    towards_eye = cut.normal + 0.28 * np.cross(cut.up, cut.normal) + 0.22 * cut.up
    shown = np.asarray(kept.points)
    height = _height_in_view(shown, towards_eye, cut.up, _WINDOW[1] - _BAR)
    plotter.add_mesh(
        kept,
        ambient=0.35,
        diffuse=0.7,
        show_edges=True,
        edge_color=_EDGE_COLOUR,
        line_width=_edge_width(height, edge),
        edge_opacity=float(np.clip(edge / height * _WINDOW[1] / 6.0, 0.15, 1.0)),
        show_scalar_bar=False,
        **colours,
    )
    _look(plotter, _centre(shown), towards_eye, height, cut.up)


def _draw_cut(_surface: Any, volume: Any, path: Path) -> None:
    plotter = _plotter(_WINDOW[1] - _BAR)
    kept, cut, edge = _cut_of(volume)
    ratio = np.asarray(volume.cell_data["radius_ratio"])
    kept.cell_data["radius ratio"] = ratio[cut.owners]
    limits = _range(ratio)
    _show_cut(plotter, kept, cut, edge, scalars="radius ratio", clim=limits, cmap=_COLOURS)
    _save_with_bar(plotter, path, "radius ratio of the tetrahedra", limits)


def _draw_regions(surface: Any, volume: Any, path: Path) -> None:
    plotter = _plotter(_WINDOW[1] - _BAR)
    kept, cut, edge = _cut_of(volume)
    region = np.asarray(volume.cell_data["region"])[cut.owners]
    names, colours = _materials_of(surface, volume)
    kept.cell_data["colour"] = colours[region]
    _show_cut(plotter, kept, cut, edge, scalars="colour", rgb=True)
    # the largest on the cut first, as many as there is room for
    numbers, areas = np.unique(region, return_counts=True)
    shown = numbers[np.argsort(-areas, kind="stable")]
    _save_with_legend(plotter, path, [(names[k], colours[k]) for k in shown])


def _legend_layout(names: list[str]) -> tuple[int, float]:
    """Find the number of columns with the largest letters that fit, and the font size in points."""
    longest = _MARK + _LETTER * max(map(len, names))

    def fitting(columns: int) -> float:
        rows = -(-len(names) // columns)
        return min(_LETTERING, _POINTS * min(_WINDOW[0] / (columns * longest), _BAR / ((rows + 0.6) * _LINE)))

    columns = max(range(1, len(names) + 1), key=fitting)
    return columns, fitting(columns)


def _save_with_legend(plotter: Any, path: Path, entries: list[tuple[str, Any]]) -> None:
    """Write what a plotter shows, with names and their colours below it."""
    import matplotlib as mpl

    mpl.use("Agg")
    from matplotlib import pyplot
    from matplotlib.patches import Patch

    figure = pyplot.figure(figsize=(_WINDOW[0] / 100, _BAR / 100), dpi=100)
    shown = entries[:_LEGEND]
    patches = [Patch(color=np.asarray(colour) / 255.0, label=name[:_LETTERS]) for name, colour in shown]
    if len(entries) > len(shown):
        patches.append(Patch(color="none", label=f"and {len(entries) - len(shown)} more"))
    columns, size = _legend_layout([str(patch.get_label()) for patch in patches])
    figure.legend(handles=patches, loc="center", ncols=columns, fontsize=size, labelcolor=_INK, frameon=False)
    _save_above(plotter, path, figure)


def _draw_quality(surface: Any, volume: Any, path: Path) -> None:
    import matplotlib as mpl

    mpl.use("Agg")
    from matplotlib import pyplot

    from tetmesh_check.polydata import from_polydata
    from tetmesh_check.quality import triangle_quality

    shape = triangle_quality(*from_polydata(surface))
    panels = [
        ("surface triangles", "radius ratio", shape.radius_ratio, (0.0, 1.0), "#4878a8"),
        ("surface triangles", "smallest angle (degrees)", shape.min_angle, (0.0, 60.0), "#4878a8"),
        ("tetrahedra", "radius ratio", np.asarray(volume.cell_data["radius_ratio"]), (0.0, 1.0), "#4f9d69"),
        (
            "tetrahedra",
            "smallest dihedral angle (degrees)",
            np.asarray(volume.cell_data["min_dihedral"]),
            (0.0, 70.6),
            "#4f9d69",
        ),
    ]
    figure, axes = pyplot.subplots(2, 2, figsize=(12, 8), layout="constrained")
    for axis, (what, measure, values, limits, colour) in zip(axes.flat, panels, strict=True):
        axis.hist(
            values, bins=np.linspace(*limits, 61), weights=np.full(len(values), 100.0 / len(values)), color=colour
        )
        axis.set_title(f"{len(values):,} {what}")
        axis.set_xlabel(measure)
        axis.set_ylabel("share (%)")
        axis.set_xlim(limits)
        axis.axvline(float(values.mean()), color="black", linewidth=1.0)
        axis.axvline(float(values.min()), color="#b03030", linewidth=1.0, linestyle="--")
        axis.text(
            0.03,
            0.95,
            f"mean {values.mean():.3g}\nminimum {values.min():.3g}",
            transform=axis.transAxes,
            verticalalignment="top",
        )
        axis.spines[["top", "right"]].set_visible(False)
    figure.savefig(path, dpi=120)
    pyplot.close(figure)


_DRAW: dict[str, Callable[[Any, Any, Path], None]] = {
    "surface": _draw_surface,
    "closeup": _draw_closeup,
    "cut": _draw_cut,
    "regions": _draw_regions,
    "quality": _draw_quality,
}


def _main(description: Path) -> None:
    """Draw what the job asks for; a picture that fails does not take the others with it."""
    import pyvista as pv

    job = json.loads(description.read_text(encoding="utf-8"))
    surface, volume = pv.read(job["surface"]), pv.read(job["volume"])
    folder = Path(job["folder"])
    failed = []
    # the histogram first: it needs no renderer and is kept if one of the others brings the process
    # down
    for picture in sorted(job["pictures"], key=lambda name: name in _RENDERED):
        target = folder / f"{job['name']}.{picture}.png"
        part = folder / f"part.{picture}.png"
        try:
            _DRAW[picture](surface, volume, part)
            part.replace(target)
        except Exception as error:
            failed.append(f"{picture}: {type(error).__name__}: {error}")
    if failed:
        raise SystemExit("; ".join(failed))


if __name__ == "__main__":
    _main(Path(sys.argv[1]))
