"""Tests of the 3-D view: the packed data, and the page in a browser that a script controls."""

from __future__ import annotations

import base64
import json
import re
import shutil
import subprocess
import zlib
from html import unescape
from pathlib import Path

import numpy as np
import pytest
import pyvista as pv
from conftest import ball, tetrahedra

from tetmesh_check.datasets import from_polydata
from tetmesh_check.quality import signed_tetrahedron_volumes, triangle_quality
from tetmesh_check.report.page.view3d import STEPS, ViewMesh, is_anatomical, measures_of, pack, view_meshes
from tetmesh_check.report.pictures import cut_of

BROWSER = next(
    (found for name in ("chromium", "chromium-browser", "google-chrome") if (found := shutil.which(name))), None
)
NEEDS_BROWSER = pytest.mark.skipif(BROWSER is None, reason="no Chromium here (Debian: apt-get install chromium)")


def test_the_packed_meshes_are_the_meshes() -> None:
    surface = ball(7.0, 2).translate((100.0, 50.0, -3.0))
    points, triangles = from_polydata(surface)
    quality = triangle_quality(points, triangles).radius_ratio
    surface.cell_data["radius_ratio"] = quality
    surface.point_data["edge_length"] = np.linspace(1.0, 2.0, len(points))
    about, data = pack([ViewMesh("surface", surface)])
    raw = zlib.decompress(base64.b64decode(data))
    mesh = about["meshes"][0]

    def whole(start: int, count: int) -> np.ndarray:
        planes = np.frombuffer(raw[start : start + 4 * count], np.uint8).reshape(4, count).astype(np.int64)
        zigzag = (planes << np.array([[0], [8], [16], [24]])).sum(axis=0)
        return np.cumsum((zigzag >> 1) ^ -(zigzag & 1))

    read = whole(mesh["points"], 3 * mesh["point_count"]).reshape(3, -1).T * about["step"]
    corners = whole(mesh["triangles"], 3 * mesh["triangle_count"]).reshape(-1, 3)
    half, centre = 0.5 * np.ptp(points, axis=0).max(), 0.5 * (points.min(axis=0) + points.max(axis=0))
    assert about["half"] == pytest.approx(half)
    assert about["centre"] == pytest.approx(centre)

    def as_set(p: np.ndarray, t: np.ndarray) -> set:
        return {tuple(map(tuple, np.round(p[c]).astype(int))) for c in t}

    assert as_set(read[corners] * STEPS, range(len(corners))) == as_set(
        ((points - centre) / half * STEPS)[triangles], range(len(triangles))
    )
    ratio, length = mesh["colours"]
    for colour, count, values in (
        (ratio, len(triangles), quality),
        (length, len(points), np.linspace(1.0, 2.0, len(points))),
    ):
        low, high = np.frombuffer(raw[colour["start"] : colour["start"] + 2 * count], np.uint8).reshape(2, -1) / 1.0
        shown = colour["least"] + (low + 256.0 * high) / 65535.0 * (colour["largest"] - colour["least"])
        np.testing.assert_allclose(np.sort(shown), np.sort(values), atol=1e-4)
        assert [colour["low"], colour["high"]] == pytest.approx(np.percentile(values, [1, 99]))
    assert ratio["threshold"] == pytest.approx(np.percentile(quality, 1))
    assert length["threshold"] is None
    assert about["letters"] == [["L", "R"], ["P", "A"], ["S", "I"]]
    plain = pack([ViewMesh("surface", surface)], anatomical=False)[0]
    assert plain["letters"][2] == ["+z", "\u2212z"]


def test_what_the_view_shows(case: Path) -> None:
    surface = pv.read(case / "a&b.surface.vtp")
    assert is_anatomical(surface)
    assert not is_anatomical(ball())
    shown, cut, worst = view_meshes(surface, pv.read(case / "a&b.volume.vtu"), [])
    assert [mesh.name for mesh in (shown, cut, worst)] == ["surface", "cut", "worst tetrahedra"]
    names = [[measure.name for measure in measures_of(view.mesh)] for view in (shown, cut, worst)]
    assert names == [
        ["radius ratio", "edge length", "deviation from F = 0"],
        ["radius ratio", "minimum dihedral angle", "edge length"],
        ["radius ratio", "minimum dihedral angle"],
    ]
    deviation = pack([shown])[0]["meshes"][0]["colours"][2]
    assert deviation["largest"] == pytest.approx(np.abs(surface.cell_data["deviation"]).max())
    assert deviation["least"] >= 0.0
    points, cells, grid = tetrahedra(case / "a&b.volume.vtu")
    assert cut.mesh.n_points < 0.6 * len(points)
    assert cut.mesh["edge_length"].min() > 0.5

    ratio = np.asarray(grid.cell_data["radius_ratio"])
    count = max(1, round(0.01 * len(cells)))
    assert worst.mesh.n_cells == 4 * count
    assert worst.within
    assert worst.mesh["radius_ratio"].max() == pytest.approx(np.sort(ratio)[count - 1])
    # the faces are oriented outward, so the divergence theorem gives the volume of each tetrahedron
    corners = points[from_polydata(worst.mesh)[1]].reshape(-1, 4, 3, 3)
    corners = corners - corners.mean(axis=(1, 2), keepdims=True)
    volumes = np.einsum("abi,abi->a", corners[:, :, 0], np.cross(corners[:, :, 1], corners[:, :, 2])) / 6.0
    own = signed_tetrahedron_volumes(points, cells)[np.sort(np.argpartition(ratio, count - 1)[:count])]
    np.testing.assert_allclose(volumes, own, rtol=1e-9)


def test_the_cut_keeps_the_farther_half(case: Path) -> None:
    points, cells, grid = tetrahedra(case / "a&b.volume.vtu")
    boundary, normal, up = cut_of(grid)
    assert normal @ up == 0.0
    depth = points[cells].mean(axis=1) @ normal
    kept = depth < np.median(depth)
    assert set(boundary.cell_data["radius_ratio"]) <= set(grid.cell_data["radius_ratio"][kept])
    # oriented outward
    corners = np.asarray(boundary.points)[from_polydata(boundary)[1]]
    inside = np.einsum("ij,ij->i", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])).sum() / 6.0
    assert inside == pytest.approx(signed_tetrahedron_volumes(points, cells[kept]).sum())


def browse(page: Path, folder: Path, *words: str) -> tuple[str, list[str]]:
    """Open a page; return the final document and the messages on the console."""
    assert BROWSER is not None
    options = [
        "--headless=new", "--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--hide-scrollbars",
        "--window-size=1280,1400", "--virtual-time-budget=15000", "--enable-logging=stderr", f"--user-data-dir={folder}",
    ]  # fmt: skip
    done = subprocess.run(
        [BROWSER, *options, *words, page.as_uri()], capture_output=True, text=True, timeout=55, check=False
    )
    said = [line for line in done.stderr.splitlines() if "CONSOLE" in line]
    # in some runs, the graphics driver warns that reading pixels back is slow
    return done.stdout, [line for line in said if "GL Driver Message (OpenGL, Performance" not in line]


CLOCK = "<script>window.requestAnimationFrame = call => setTimeout(() => call(performance.now()), 16);</script>"
"""Replaces animation frames by timers: with `--dump-dom`, a browser draws only a few frames."""
DRIVE = f"<script>{Path(__file__).with_name('drive.js').read_text()}</script></body>"
HOST = (
    "<!doctype html><html><body><script>onmessage = e => { document.documentElement.dataset.found = e.data; };</script>"
)
FRAME = '<iframe src="driven.html" style="width:400px;height:1200px;border:0"></iframe></body></html>'
"""A narrow page: a window has at least 500 pixels, but a frame can have fewer."""


def driven(page: Path, folder: Path, *words: str, narrow: bool = False) -> dict:
    """Run `drive.js` on the page and return what it found."""
    text = page.read_text().replace("<body>", f"<body>{CLOCK}").replace("</body>", DRIVE)
    (folder / "driven.html").write_text(
        text if narrow else text.replace("<body>", f"<body>{HOST.partition('<body>')[2]}")
    )
    (folder / "host.html").write_text(HOST + FRAME)
    opened = folder / ("host.html" if narrow else "driven.html")
    document, console = browse(opened, folder / "profile", "--dump-dom", *words)
    assert console == []
    found = re.search(r'<html [^>]*data-found="([^"]*)"', document)
    assert found is not None, document[:300]
    return json.loads(unescape(found.group(1)))


@NEEDS_BROWSER
def test_a_script_uses_the_page(page: Path, tmp_path: Path) -> None:
    found = driven(page, tmp_path)
    assert found.get("error") is None
    assert found["state"] == "drawn"
    # without Ctrl, the wheel must scroll the page and not zoom
    assert found["plainWheel"] == [False, 1.0]
    assert found["ctrlWheel"][0]
    assert found["ctrlWheel"][1] > 1.1
    assert found["wheelInside"][0]
    assert found["wheelInside"][1] > 1.1
    assert found["wheelAfterEscape"] == [False, False]
    assert found["touchAction"] == "pan-x pan-y"
    assert found["touched"] == found["dragged"]
    assert found["oneFinger"] == [False, False, *found["start"]]
    assert found["twoFingers"][0]
    assert found["twoFingers"][3] == pytest.approx(2.0)
    # keys, buttons, mouse
    assert found["left"][0] > found["start"][0]
    assert found["shifted"][4] > found["left"][4]
    assert found["plus"] == pytest.approx(1.2)
    assert found["reset"] == found["start"]
    assert found["dragged"][0] < found["start"][0]
    # The ball fills the height of the view except for a margin, and the view is about twice as wide
    # as high. The ball therefore covers somewhat less than pi / 8 = 0.39 of the view.
    assert 0.2 < found["covered"] < 0.6
    assert found["clipped"] < 0.85 * found["covered"]
    assert found["clippedAway"] < 0.1
    assert found["unclipped"] == pytest.approx(found["covered"])
    # the middle of the picture shows a point on the surface of the ball, 10 mm from its centre
    values = re.match(
        r"radius ratio: ([\d.]+), edge length: ([\d.]+) mm, deviation from F = 0: ([\d.]+) mm; "
        r"at ([RL]) ([\d.]+), ([AP]) ([\d.]+), ([IS]) ([\d.]+) mm$", found["value"],
    )  # fmt: skip
    assert values is not None, found["value"]
    assert "".join(values.group(4, 6, 8)) == "LAS"
    assert np.linalg.norm([float(v) for v in values.group(5, 7, 9)]) == pytest.approx(10.0, abs=0.2)
    assert 0.8 < float(values.group(1)) <= 1.0
    assert found["nothing"].startswith("Point at")
    assert found["bar"][0] is False
    assert "deviation from F = 0" in found["bar"][1]
    assert "worst 1 % by deviation from F = 0, from" in found["worst"]
    assert found["within"][0] > 0.01
    assert found["within"][1] == "radius ratio"
    length, pixels, height = found["ruler"]
    # the ball, 20 mm in diameter, fills the height except for a margin of 8 %
    assert float(length.split()[0]) / pixels * height == pytest.approx(20.0 * 1.08, rel=0.02)
    assert found["letters"] == ["L", "A", "S"]
    assert found["lookedFromLeft"][0] == ["L"]
    assert found["slices"][:2] == [True, True]
    assert found["hidden"] == "none"
    assert found["wide"][0] <= found["wide"][1]


@NEEDS_BROWSER
def test_the_page_is_dark_and_narrow(page: Path, tmp_path: Path) -> None:
    """On a phone in dark mode, the page has no horizontal scrolling.

    Apart from its pictures and slices, it has no white areas either.
    """
    words = ["--blink-settings=preferredColorScheme=0"]
    found = driven(page, tmp_path, *words, narrow=True)
    assert found.get("error") is None
    assert found["wide"] == [400, 400]
    assert found["paper"] == "rgb(20, 23, 27)"
    bare, hidden = tmp_path / "bare.html", "<style>img, canvas, .slice { visibility: hidden }</style>"
    bare.write_text(page.read_text().replace("</head>", f"{hidden}</head>"))
    browse(bare, tmp_path / "profile", f"--screenshot={tmp_path / 'page.png'}", "--window-size=400,8000", *words)
    from PIL import Image

    with Image.open(tmp_path / "page.png") as image:
        pixels = np.asarray(image.convert("L"))
    # letters are bright, but none fills a square of 8 pixels
    squares = pixels[:8000, :400].reshape(1000, 8, 50, 8)
    assert (squares > 200).mean(axis=(1, 3)).max() < 1.0


@NEEDS_BROWSER
def test_a_broken_view_is_noticed(page: Path, tmp_path: Path) -> None:
    text = page.read_text()
    start = text.index('id="view-data">') + len('id="view-data">') + 40
    (tmp_path / "broken.html").write_text(text[:start] + "AAAA" + text[start + 4 :])
    document, console = browse(tmp_path / "broken.html", tmp_path / "profile", "--dump-dom")
    assert 'data-state="failed"' in document
    assert "cannot be drawn" in document
    assert "Drag to turn" not in document
    assert console
