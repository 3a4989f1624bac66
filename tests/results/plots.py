#!/usr/bin/env python3
"""Draw the pictures of docs/results.md from the rows of paper.py and growth.py.

    tests/results/plots.py                                  # docs/images/results-*.png
    tests/results/plots.py --closeups out/paper-surfaces    # meshes copied by `paper.py --keep`

`make results-page` runs both. Needs matplotlib, and pyvista for the close-ups.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
import printed
from growth import SERIES
from page import Page, load
from paper import MODES, OBJECTS, SEEDS, SWEEP

mpl.use("Agg")

import matplotlib.pyplot as plt

DPI = 110
COLOURS = {"CPU": "tab:red", "GPU": "tab:blue"}
"""Colours of the paper's figures."""


def save(figure: Any, folder: Path, name: str) -> None:
    """Write a picture."""
    figure.savefig(folder / f"results-{name}.png", dpi=DPI)
    plt.close(figure)


def times(
    page: Page, folder: Path, name: str, rows: list[tuple[str, str, str]], paper: list[tuple[float, ...]]
) -> None:
    """Draw Figures 7 and 8: seconds over particles, for the paper and for this program."""
    figure, axes = plt.subplots(1, 2, figsize=(9.5, 3.6), layout="constrained")
    for axis, title in zip(axes, ("the paper, 2012", "ours"), strict=True):
        axis.set(title=title, xlabel="particles", ylabel="seconds", yscale="log")
        axis.grid(alpha=0.3, which="both")
        axis.xaxis.set_major_formatter(lambda x, _: f"{x / 1000:.0f} k")
    for label, at in (("CPU", 0), ("GPU", 2)):
        told = sorted((row[at + 1], row[at]) for row in paper)
        axes[0].plot(
            *zip(*told, strict=True), "o-", color=COLOURS[label], label=f"{label}{', one thread' if at == 0 else ''}"
        )
    for engine, key, label, style in (
        ("cpu-1", "settle", "CPU, one thread", "o-"),
        ("cpu-all", "settle", "CPU, all cores", "s--"),
        ("gpu", "device", "GPU", "o-"),
    ):
        if engine == "gpu" and not page.gpu:
            continue
        told = sorted((page.row(*row, engine)["particles"], page.row(*row, engine)[key]) for row in rows)
        axes[1].plot(*zip(*told, strict=True), style, color=COLOURS[label[:3]], label=label)
    for axis in axes:
        axis.legend(fontsize=8)
    save(figure, folder, name)


def histograms(page: Page, folder: Path) -> None:
    """Draw Figure 9: distributions of radius ratios, CPU and GPU."""
    figure, axes = plt.subplots(
        len(MODES), len(OBJECTS), figsize=(13, 4.6), sharex=True, layout="constrained", squeeze=False
    )
    for line, mode in enumerate(MODES):
        for column, name in enumerate(OBJECTS):
            axis = axes[line][column]
            for engine, label in (("cpu-all", "CPU"), ("gpu", "GPU"))[: 1 + page.gpu]:
                row = page.row("1", name, mode, engine)
                for key, style in (("raw", "-"), ("finished", ":")):
                    counts = np.asarray(row[key]["histogram"], dtype=float)
                    edges = np.linspace(0.0, 1.0, len(counts) + 1)
                    told = f"{label}, {'particles' if key == 'raw' else 'mesh'}"
                    shares = 100 * counts / counts.sum()
                    axis.stairs(shares, edges, color=COLOURS[label], ls=style, label=told)
            axis.set_xlim(0.4, 1.0)
            axis.set_title(f"{name}, {mode}", fontsize=9)
            axis.grid(alpha=0.3)
    for axis in axes[-1]:
        axis.set_xlabel("radius ratio")
    for line in axes:
        line[0].set_ylabel("% of the triangles")
    axes[0][0].legend(fontsize=7, loc="upper left")
    save(figure, folder, "fig9")


def growth(page: Page, folder: Path) -> None:
    """Draw the seconds of every stage for each series."""
    figure, axes = plt.subplots(1, len(SERIES), figsize=(14, 3.9), layout="constrained")
    headings = [heading for *_, heading in page.columns("volume")]
    titles = {"volume": "voxels", "particles": "particles", "cores": "threads", "materials": "materials"}
    for axis, series in zip(axes, SERIES, strict=True):
        for stage, engine, heading in page.columns(series):
            rows = [(size, page.grown(series, size, stage, engine)) for size in page.sizes(series)]
            points = [(size, row["seconds"]) for size, row in rows if row is not None]
            if points:
                axis.plot(*zip(*points, strict=True), "o-", ms=3, color=f"C{headings.index(heading)}", label=heading)
        axis.set(title=f"by {titles[series]}", xlabel=titles[series], xscale="log", yscale="log")
        axis.grid(alpha=0.3, which="both")
    axes[0].set_ylabel("seconds")
    axes[0].legend(fontsize=7)
    save(figure, folder, "growth")


def closeups(surfaces: Path, folder: Path) -> None:
    """Draw the close-ups of Figure 9: the same part of the heart's mesh, CPU and GPU."""
    import pyvista as pv

    files = []
    for mode in MODES:
        for engine, label in (("cpu-all", "CPU"), ("gpu", "GPU")):
            path = surfaces / f"heart-{mode.replace(' ', '-')}-{engine}.vtp"
            if path.exists():
                files.append((f"{mode}, {label}", path))
    plotter = pv.Plotter(off_screen=True, shape=(1, len(files)), window_size=[420 * len(files), 400], border=False)
    for column, (title, path) in enumerate(files):
        plotter.subplot(0, column)
        mesh = pv.read(path)
        plotter.add_mesh(mesh, color="#d9c7b8", show_edges=True, edge_color="#333333", line_width=1)
        plotter.add_text(title, font_size=9, color="black")
        low, high = np.asarray(mesh.bounds).reshape(3, 2).T
        focus = np.asarray(mesh.points)[np.argmin(np.asarray(mesh.points)[:, 1])]
        plotter.camera.focal_point = focus
        plotter.camera.position = focus + np.array([0.3, -1.0, 0.3]) * (high - low).max()
        plotter.camera.up = (0.0, 0.0, 1.0)
        plotter.camera.view_angle = 6.0
    plotter.set_background("white")
    plotter.screenshot(folder / "results-closeups.png")


def main() -> None:
    """Run the program."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--folder", type=Path, default=Path("docs/results"), help="of paper.json and growth.json")
    parser.add_argument("--images", type=Path, default=Path("docs/images"))
    parser.add_argument(
        "--closeups", type=Path, metavar="FOLDER", help="draw the surfaces of this folder, and nothing else"
    )
    arguments = parser.parse_args()
    if arguments.closeups:
        closeups(arguments.closeups, arguments.images)
        return
    page = Page(load(arguments.folder / "paper.json"), load(arguments.folder / "growth.json"))
    seeds = [("3", str(count), "as printed") for count in SEEDS]
    sweep = [("4", f"{epsilon}/{delta} level {level}", "as printed") for epsilon, delta, level in SWEEP]
    times(page, arguments.images, "fig7", seeds, list(printed.TABLE_3.values()))
    times(page, arguments.images, "fig8", sweep, printed.TABLE_4)
    histograms(page, arguments.images)
    growth(page, arguments.images)


if __name__ == "__main__":
    main()
