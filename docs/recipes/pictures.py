"""The pictures of the recipes, drawn from the results of a run (run.py --pictures).

pictures.py peers FOLDER    draws those of scale.py, with its --work FOLDER
"""

from __future__ import annotations

import io
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
import pyvista as pv
from PIL import Image, ImageDraw, ImageFont

from tetmesh_check.quality import triangle_quality
from tetmesh_check.report.rendering import use_renderer

INK = "#30363d"
HEIGHT, STRIP = 480, 80
"""Heights of a part of a picture and of the strip below it, pixels."""
FONT = ImageFont.load_default(21)
TISSUES = {
    "fat": "#f0d6a4",
    "muscle": "#c77f6d",
    "bone": "#f7f3e6",
    "lungs": "#9fc9e3",
    "heart": "#d6322e",
    "blood": "#7a0f2b",
    "liver": "#8a5a3c",
}
HEAD = ("#f4efe6", "#b98f8f", "#7fb6d6", "#e6d9a8", "#e0b59a", "#4a6fa5")
"""Colours of the tissues of the head."""


class Part:
    """A view of meshes with a caption: a colour bar, names with their colours, or words."""

    def __init__(self, towards_eye: Sequence[float], up: Sequence[float] = (0, 0, 1), width: int = 500) -> None:
        self.scene = pv.Plotter(off_screen=True, window_size=(width, HEIGHT))
        self.scene.set_background("white")
        self.scene.enable_anti_aliasing("ssaa")
        self.view = towards_eye, up
        self.points: list[Any] = []
        self.strip = Image.new("RGB", (width, STRIP), "white")
        self.pen = ImageDraw.Draw(self.strip)

    def add(self, mesh: pv.DataSet, **options: Any) -> None:
        """Add a mesh, without a colour bar."""
        self.points.append(np.asarray(mesh.points))
        self.scene.add_mesh(mesh, show_scalar_bar=False, **options)

    def label(self, place: Any, text: str) -> None:
        """Write words at a position."""
        options = {"font_size": 24, "text_color": "black", "shape": None, "show_points": False, "always_visible": True}
        self.scene.add_point_labels(np.atleast_2d(place), [f"  {text}"], **options)

    def bar(self, title: str, colours: str, low: str, high: str) -> None:
        """Draw a colour bar and its ends."""
        width = self.strip.width
        row = mpl.colormaps[colours](np.linspace(0, 1, width // 2))[None, :, :3]
        box = Image.fromarray((255 * np.repeat(row, 20, axis=0)).astype(np.uint8))
        self.strip.paste(box, (width // 4, 46))
        self.words(title, y=22)
        self.pen.text((width // 4 - 10, 56), low, INK, FONT, "rm")
        self.pen.text((3 * width // 4 + 10, 56), high, INK, FONT, "lm")

    def names(self, colours: dict[str, str], per_row: int = 4) -> None:
        """Draw names with their colours."""
        entries = list(colours.items())
        for start in range(0, len(entries), per_row):
            row = entries[start : start + per_row]
            lengths = [FONT.getlength(name) + 62 for name, _ in row]
            x, y = (self.strip.width - sum(lengths) + 20) / 2, 22 + 38 * (start // per_row)
            for (name, colour), length in zip(row, lengths, strict=True):
                self.pen.rectangle((x, y - 12, x + 24, y + 12), colour, INK)
                self.pen.text((x + 34, y), name, INK, FONT, "lm")
                x += length

    def words(self, text: str, y: int = 42) -> None:
        """Draw a line of text."""
        self.pen.text((self.strip.width // 2, y), text, INK, FONT, "mm")

    def draw(self) -> Image.Image:
        """Return the view, as large as possible, above the caption."""
        self.scene.enable_parallel_projection()
        self.scene.view_vector(*self.view)
        camera, points = self.scene.camera, np.concatenate(self.points)
        right = np.cross(camera.up, np.subtract(camera.position, camera.focal_point))
        across, upward = (points @ (axis / np.linalg.norm(axis)) for axis in (right, camera.up))
        shift = [0.5 * (values.min() + values.max()) for values in (across, upward)]
        centre = shift[0] * right / np.linalg.norm(right) + shift[1] * np.array(camera.up)
        camera.position = centre + np.subtract(camera.position, camera.focal_point)
        camera.focal_point = centre
        camera.parallel_scale = 0.53 * max(np.ptp(upward), np.ptp(across) * HEIGHT / self.strip.width)
        self.scene.reset_camera_clipping_range()
        made = Image.new("RGB", (self.strip.width, HEIGHT + STRIP), "white")
        made.paste(Image.fromarray(self.scene.screenshot(None, return_img=True)), (0, 0))
        made.paste(self.strip, (0, HEIGHT))
        self.scene.close()
        return made


def behind(grid: pv.UnstructuredGrid, normal: Sequence[float], origin: Sequence[float]) -> pv.PolyData:
    """Return the boundary of the part behind a plane, with the data of the elements."""
    clipped = grid.clip(normal=normal, origin=origin)
    return clipped.extract_surface(algorithm="dataset_surface")


def add_materials(part: Part, mesh: pv.PolyData, colours: dict[str, str]) -> None:
    """Add the elements of each material in its colour. Regions are numbered in this order."""
    rgb = np.array([[0, 0, 0], *(mpl.colors.to_rgb(colour) for colour in colours.values())])
    mesh.cell_data["rgb"] = (255 * rgb[mesh.cell_data["region"]]).astype(np.uint8)
    part.add(
        mesh, scalars="rgb", rgb=True, show_edges=True, edge_color=INK, edge_opacity=0.4, line_width=0.5, ambient=0.4
    )


def torso(folder: Path) -> list[Part]:
    """Draw the potential on the skin, with the electrodes, and the tissues in a cut."""
    grid = pv.read(folder / "out" / "torso" / "torso.volume.vtu")
    skin = grid.extract_surface(algorithm="dataset_surface")
    eye, limits = (0.35, -1, 0.12), (-1.8, 1.8)
    left, right = Part(eye), Part(eye)
    left.add(skin, scalars="potential", cmap="RdBu_r", clim=limits, n_colors=13, ambient=0.4)
    for name, place in {"V1": (-20, -106, 0), "V2": (20, -106, 0), "V4": (75, -97, -25), "V6": (140, -50, -30)}.items():
        vertex = np.asarray(skin.points[skin.find_closest_point(place)], float)
        left.add(pv.Sphere(radius=6, center=vertex), color="black")
        left.label(vertex, name)
    left.bar("potential on the skin, mV", "RdBu_r", "-1.8", "1.8")
    add_materials(right, behind(grid, (0, -1, 0), (0, -14, 0)), TISSUES)
    right.names(TISSUES)
    return [left, right]


def heart(folder: Path) -> list[Part]:
    """Draw the fibres on both ventricles, and those behind a cut, coloured by helix angle."""
    grid = pv.read(folder / "out" / "heart" / "heart.volume.vtu")
    wall = grid.extract_cells(grid["region"] == 2)
    eye = (0.1, -1, 0.25)
    left, right = Part(eye), Part(eye)
    for part, shown, share in (
        (left, wall.extract_surface(algorithm="dataset_surface"), 0.35),
        (right, behind(wall, (0, -1, 0), (0, 0, 0)), 0.25),
    ):
        shown = shown.triangulate().compute_normals(point_normals=False, split_vertices=False)
        centres, fibres = np.array(shown.cell_centers().points), np.array(shown["fibre"])
        # fibres have no sense; the one to the left of the outward direction makes the angle unique
        fibres *= np.sign(centres[:, 0] * fibres[:, 1] - centres[:, 1] * fibres[:, 0])[:, None]
        random = np.random.default_rng(1).random(len(centres))
        chosen = (random < share * shown.compute_cell_sizes()["Area"]) & (np.abs(shown["Normals"][:, 2]) < 0.9)
        rods = pv.PolyData((centres + 0.4 * shown["Normals"])[chosen])
        rods["fibre"], rods["angle"] = fibres[chosen], np.degrees(np.arcsin(fibres[chosen, 2]))
        rod = pv.Cylinder(radius=0.35, height=4.5, resolution=6)
        part.add(shown, color="#f3ece4", ambient=0.3)
        rods = rods.glyph(orient="fibre", scale=False, geom=rod)
        part.add(rods, scalars="angle", cmap="coolwarm", clim=(-60, 60), ambient=0.3)
        part.bar("helix angle, degrees", "coolwarm", "-60", "60")
    return [left, right]


def results_of(path: Path, name: str, components: int, count: int) -> Any:
    """Return the components of a result of CalculiX at the nodes, as columns."""
    found, inside = np.full((count, components), np.nan), False
    for line in path.read_text(encoding="utf-8").splitlines():
        inside = line.startswith(f" -4  {name}") or (inside and not line.startswith(" -3"))
        if inside and line.startswith(" -1"):
            found[int(line[3:13]) - 1] = [float(line[13 + 12 * k : 25 + 12 * k]) for k in range(components)]
    return found


def stress_of(path: Path, count: int) -> Any:
    """Return the von Mises stress at the nodes, from the results of CalculiX."""
    xx, yy, zz, xy, yz, zx = results_of(path, "STRESS", 6, count).T
    squares = (xx - yy) ** 2 + (yy - zz) ** 2 + (zz - xx) ** 2 + 6.0 * (xy**2 + yz**2 + zx**2)
    return np.sqrt(0.5 * squares)


def femur(folder: Path) -> list[Part]:
    """Draw the density and the stress in a cut along the neck."""
    grid = pv.read(folder / "out" / "femur" / "femur.volume.vtu")
    grid.point_data["stress"] = stress_of(folder / "load.frd", grid.n_points)
    cut = behind(grid, (0, -1, 0), (0, 3, 0))
    eye = (0.25, -1, 0.15)
    left, right = Part(eye, width=380), Part(eye, width=380)
    edges = {"show_edges": True, "edge_color": INK, "edge_opacity": 0.4, "line_width": 0.5, "ambient": 0.4}
    left.add(cut, scalars="density", cmap="bone", clim=(0, 1.3), **edges)
    left.bar("density, g/cm^3", "bone", "0", "1.3")
    right.add(cut, scalars="stress", cmap="turbo", clim=(0, 25), n_colors=16, ambient=0.4)
    right.scene.add_mesh(pv.Arrow(start=(0, 0, 46), direction=(0, 0, -1), scale=20), color=INK)
    right.points.append(np.array([[0, 0, 46]]))
    left.points.append(np.array([[0, 0, 46]]))
    right.bar("von Mises stress, N/mm^2", "turbo", "0", "25")
    return [left, right]


def head(folder: Path) -> list[Part]:
    """Draw all tissues in a cut, and the cortex in the head."""
    grid = pv.read(folder / "out" / "head" / "head.volume.vtu")
    colours = dict(zip(("white", "gray", "csf", "bone", "scalp", "eye"), HEAD, strict=True))
    left, right = Part((1, 0.35, 0.15)), Part((0.7, 1, 0.3))
    add_materials(left, behind(grid, (1, 0, 0), (26, 0, 0)), colours)
    left.names(colours, 3)
    brain = grid.extract_cells(np.isin(grid["region"], (1, 2))).extract_surface(algorithm="dataset_surface")
    right.add(brain, color="#cfa0a0", ambient=0.35, show_edges=True, edge_color=INK, edge_opacity=0.3, line_width=0.5)
    right.add(grid.extract_surface(algorithm="dataset_surface"), color=colours["scalp"], opacity=0.18)
    right.words("grey matter in the head")
    return [left, right]


def aneurysm(folder: Path) -> list[Part]:
    """Draw the wall and the caps, and the elements behind a cut."""
    grid = pv.read(folder / "out" / "aneurysm" / "aneurysm.volume.vtu")
    left, right = Part((0.35, -1, -0.45)), Part((0.12, -1, 0.1))
    skin = grid.extract_surface(algorithm="dataset_surface").compute_normals(point_normals=False, split_vertices=False)
    flat = [
        (np.array([0.0, 0, -1]), "inlet"),
        (np.array([0.949, 0, 0.316]), "left"),
        (np.array([-0.949, 0, 0.316]), "right"),
    ]
    edges = {"show_edges": True, "edge_color": INK, "line_width": 0.5, "ambient": 0.35}
    centres, caps = skin.cell_centers().points, np.zeros(skin.n_cells, bool)
    for (normal, name), place in zip(flat, ((0, 0, -12), (9, 0, 3), (-9, 0, 3)), strict=True):
        cap = np.abs((centres - place) @ normal) < 1e-2
        caps |= cap & (np.linalg.norm(centres - place, axis=1) < 3)
        left.label(np.add(place, (1.6, 0, -0.6) if name == "inlet" else (-0.6, 0, 2.0)), name)
    left.add(skin.extract_cells(~caps), color="#d98a7e", edge_opacity=0.35, **edges)
    left.add(skin.extract_cells(caps), color="#5b9be8", edge_opacity=0.3, **edges)
    left.words("wall and named caps")
    kept = grid.extract_cells((grid.cell_centers().points[:, 1] > 0) & (grid.cell_centers().points[:, 2] > -1.5))
    kept = kept.extract_cells(np.abs(kept.cell_centers().points[:, 0]) < 5.5)
    for kind, colour in ((pv.CellType.TETRA, "#d5e3f0"), (pv.CellType.WEDGE, "#e6a04b")):
        right.add(kept.extract_cells(kept.celltypes == kind), color=colour, edge_opacity=0.7, **edges)
    right.names({"tetrahedra": "#d5e3f0", "prisms": "#e6a04b"})
    return [left, right]


def trabecular(folder: Path) -> list[Part]:
    """Draw the mesh and the stress in it."""
    grid = pv.read(folder / "out" / "trabecular" / "trabecular.volume.vtu")
    grid.point_data["stress"] = stress_of(folder / "press.frd", grid.n_points)
    eye = (0.75, -1, 0.5)
    left, right = Part(eye), Part(eye)
    skin = grid.extract_surface(algorithm="dataset_surface")
    left.add(skin, color="#eadfca", show_edges=True, edge_color=INK, edge_opacity=0.25, line_width=0.5)
    left.words("surface of the tetrahedra")
    right.add(skin, scalars="stress", cmap="turbo", clim=(0, 80), n_colors=12, ambient=0.3)
    right.bar("von Mises stress, N/mm^2", "turbo", "0", "80")
    return [left, right]


def tooth(folder: Path) -> list[Part]:
    """Draw the tissues, and the temperature after a drink, in a cut through two canals."""
    grid = pv.read(folder / "out" / "tooth" / "tooth.volume.vtu")
    grid.point_data["warming"] = results_of(folder / "drink.frd", "NDTEMP", 1, grid.n_points)[:, 0]
    cut = behind(grid, (0.334, -0.943, 0.047), (1, 0, 0))
    eye = (0.2, -1, 0.15)
    left, right = Part(eye, width=380), Part(eye, width=380)
    colours = {"pulp": "#c9463d", "dentine": "#e3c58f", "enamel": "#b9cfe3"}
    add_materials(left, cut, colours)
    left.names(colours)
    right.add(cut, scalars="warming", cmap="turbo", clim=(0, 23), n_colors=23, ambient=0.4)
    right.bar("warming after 5 s, K", "turbo", "0", "23")
    return [left, right]


def peers(folder: Path) -> list[Part]:
    """Draw the triangles of four programs near the head of the femur, coloured by radius ratio."""
    programs = {
        "marching-cubes": "marching cubes",
        "surface-nets": "surface nets",
        "cgal": "CGAL",
        "surface": "isoparticles",
    }
    made = []
    for kind, name in programs.items():
        (path,) = folder.glob(f"femur.*.{kind}.vtp")
        surface = pv.read(path)
        quality = triangle_quality(np.asarray(surface.points, float), surface.regular_faces)
        surface.cell_data["ratio"] = quality.radius_ratio
        x, y, z = surface.cell_centers().points.T
        part = Part((0.25, -1, 0.3), width=330)
        near = surface.extract_cells((np.abs(x + 4) < 12) & (y < 0) & (np.abs(z) < 17))
        edges = {"show_edges": True, "edge_color": INK, "line_width": 0.5, "ambient": 0.4}
        part.add(near, scalars="ratio", cmap="viridis", clim=(0.3, 1), n_colors=14, **edges)
        part.words(f"{name}, {surface.n_points:,} vertices", y=20)
        part.words(f"ratio {quality.radius_ratio.mean():.2f}, minimum {quality.radius_ratio.min():.2f}", y=52)
        made.append(part)
    return made


PICTURES: dict[str, Callable[[Path], list[Part]]] = {
    picture.__name__: picture for picture in (torso, heart, femur, head, aneurysm, trabecular, tooth, peers)
}


def draw(name: str, folder: Path, target: Path) -> None:
    """Draw the parts of a picture beside each other, with few enough colours for 150 kB."""
    use_renderer()
    parts = [part.draw() for part in PICTURES[name](folder)]
    picture = Image.new("RGB", (sum(part.width for part in parts), parts[0].height), "white")
    x = 0
    for part in parts:
        picture.paste(part, (x, 0))
        x += part.width
    target.parent.mkdir(exist_ok=True)
    for colours in (256, 128, 64, 32, 16):
        data = io.BytesIO()
        picture.quantize(colours, Image.Quantize.MAXCOVERAGE, dither=Image.Dither.NONE).save(data, "png", optimize=True)
        if len(data.getvalue()) <= 150_000:
            break
    target.write_bytes(data.getvalue())
    print(f"  {target.name}: {len(data.getvalue()) / 1000:.0f} kB, {colours} colours")


if __name__ == "__main__":
    draw(sys.argv[1], Path(sys.argv[2]), Path(__file__).parent / "images" / f"{sys.argv[1]}.png")
