"""Tests of the page and the pictures of many materials."""

from __future__ import annotations

import base64
import io
import json
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import pyvista as pv
from complexes import nested_balls
from conftest import NEEDS_HXT, write_status
from isoparticles._native import surface_topology
from PIL import Image
from scipy.spatial import KDTree
from test_view import CLOCK, NEEDS_BROWSER, browse

from tetmesh_check.datasets import from_polydata
from tetmesh_check.report.colours import material_colours
from tetmesh_check.report.page import program
from tetmesh_check.report.page.scan import Scan
from tetmesh_check.report.page.templates import advice_for
from tetmesh_check.report.page.view3d import measures_of, view_meshes
from tetmesh_check.topology import NOT_MANIFOLD


@pytest.fixture(scope="module")
def case(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of three nested balls as make leaves it; one name needs HTML escaping."""
    folder = tmp_path_factory.mktemp("many")
    (folder / "reports").mkdir()
    nested_balls((10.0, 7.0, 4.0), (3, 3, 2), ("body <skin>", "lung", "heart")).save(folder / "c.surface.vtp")
    words = [
        "c.surface.vtp",
        "-o",
        "c.volume.vtu",
        "--report",
        "c.report.json",
        "--pictures",
        "pictures",
        "--source",
        "heart",
    ]
    subprocess.run([sys.executable, "-m", "tetmesh_check", *words, "-q"], cwd=folder, check=True, timeout=120)
    write_status(folder, "c")
    return folder


@pytest.fixture(scope="module")
def labelled(case: Path) -> Path:
    """Return the page of the case with its label map, which has a label that was not meshed."""
    radius = np.linalg.norm(np.indices((24, 24, 24)) - 11.5, axis=0)
    values = np.digitize(-radius, [-10.0, -7.0, -4.0]).astype(np.uint8)
    values[:, 0] = 9
    scan = Scan(values, np.eye(3), np.full(3, -11.5), True, {9: "a table"}, labels=True)
    path = case / "labelled.html"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(program, "read_scan", lambda *_: scan)
        assert program.main([str(case / "c.status.json"), "-o", str(path)]) == 0
    return path


@NEEDS_HXT
def test_the_page_tells_of_regions_and_interfaces(case: Path) -> None:
    assert program.main([str(case / "c.status.json"), "-o", str(case / "c.report.html")]) == 0
    text = (case / "c.report.html").read_text()
    assert "Left out: the reports lack" not in text
    assert "body &lt;skin&gt;" in text
    assert "<skin>" not in text
    text = re.sub(r'<i class="swatch"[^>]*></i>', "", text)
    for words in (
        "Interfaces",
        "lung / body &lt;skin&gt;",
        "heart / lung",
        "Potential of a current in heart",
        "Every triangle between two materials is a face of one tetrahedron of each",
    ):
        assert words in text
    results = json.loads((case / "c.report.json").read_text())["results"]
    told = {advice_for(check["words"], {"MATERIALS": "all"}) for check in results["checks"]}
    assert len(told | {advice_for("unknown")}) == len(results["checks"]) + 1, "each check has its own"
    for entry in results["volume"]["regions"]:
        assert f"{entry['tetrahedra']:,}".replace(",", "\u202f") in text
    assert "only heart" in text
    assert "only body &lt;skin&gt;" in text


@NEEDS_HXT
def test_a_material_can_be_looked_at_by_itself(case: Path) -> None:
    surface = pv.read(case / "c.surface.vtp")
    meshes = {mesh.name: mesh for mesh in view_meshes(surface, pv.read(case / "c.volume.vtu"), [])}
    assert list(meshes) == ["surface", "cut", "worst tetrahedra", "only body <skin>", "only lung", "only heart"]
    points, triangles = from_polydata(surface)
    inside, outside = (np.asarray(surface.cell_data[f"material_{side}"]) for side in ("inside", "outside"))
    for number, name in enumerate(("body <skin>", "lung", "heart"), 1):
        mesh = meshes[f"only {name}"].mesh
        faces = from_polydata(mesh)[1]
        own = np.concatenate([triangles[inside == number], triangles[outside == number][:, ::-1]])
        # the mesh is the closed surface of the material, oriented outward
        topology = surface_topology(mesh.n_points, faces)
        assert not any(topology[key] for key in NOT_MANIFOLD)
        distance, vertex = KDTree(points).query(mesh.points)
        assert distance.max() == 0.0
        np.testing.assert_array_equal(
            np.unique(np.sort(vertex[faces], axis=1), axis=0), np.unique(np.sort(own, axis=1), axis=0)
        )
    cut = meshes["cut"]
    assert measures_of(cut.mesh)[-1].name == "material"
    assert [name for name, _ in cut.names] == ["outside", "body <skin>", "lung", "heart"]
    assert set(cut.mesh["material"]) == {1, 2, 3}


@NEEDS_HXT
def test_a_cut_is_coloured_by_material(case: Path) -> None:
    if not (case / "pictures" / "c.surface.png").is_file():
        pytest.skip("no off-screen renderer on this machine")
    with Image.open(case / "pictures" / "c.regions.png") as image:
        pixels = np.asarray(image.convert("RGB")).astype(float)
    # each material's colour (compared by hue) covers more than 1 % of the picture
    shown = pixels[np.ptp(pixels, axis=2) > 40]
    shown /= np.linalg.norm(shown, axis=1, keepdims=True)
    for colour in material_colours(4)[1:].astype(float):
        near = (shown @ (colour / np.linalg.norm(colour)) > 0.995).sum()
        assert near > 0.01 * pixels.shape[0] * pixels.shape[1]
    # their names are below
    assert (pixels[-170:] == (0x7D, 0x85, 0x8E)).all(axis=2).sum() > 500


@NEEDS_HXT
def test_a_label_has_one_colour_on_the_page(labelled: Path) -> None:
    text = labelled.read_text()
    assert "labels: 4, and the background 0" in text
    part = text.partition('<section id="the-mesh-in-the-volume">')[2].partition("</section>")[0]
    swatch = r'<i class="swatch" style="background:rgb\((\d+, \d+, \d+)\)"></i>'
    legend = {name: tuple(map(int, rgb.split(", "))) for rgb, name in re.findall(f"<li>{swatch}([^<]*)</li>", part)}
    assert list(legend) == ["body &lt;skin&gt;", "lung", "heart", "a table"]
    assert [legend[name] for name in list(legend)[:3]] == [tuple(c) for c in material_colours(4).tolist()[1:]]
    # the same in tables
    for name in ("lung", "heart"):
        told = re.findall(f"<td class=text>{swatch}{name}</td>", text)
        assert len(told) >= 3
        assert {tuple(map(int, rgb.split(", "))) for rgb in told} == {legend[name]}
    # an axial slice, from the middle to the right: nearest values, so no other colours
    size = r'viewBox="(\d+) (\d+) (\d+) (\d+)" preserveAspectRatio="none"><image href="data:image/webp;base64,([^"]+)"'
    x, y, width, height, data = re.search(size, part).groups()
    x, y, width, height = map(int, (x, y, width, height))
    with Image.open(io.BytesIO(base64.b64decode(data))) as opened:
        shown = np.asarray(opened.convert("RGB"))[y : y + height, x : x + width]
    scale = width / 24.0
    for name, radius in (("heart", 0.5), ("lung", 5.5), ("body &lt;skin&gt;", 8.5)):
        np.testing.assert_array_equal(shown[height // 2, round(width / 2 + scale * radius)], legend[name])
    expected = {(0, 0, 0), *legend.values()}
    assert {tuple(colour) for colour in np.unique(shown.reshape(-1, 3), axis=0).tolist()} == expected


@NEEDS_HXT
@NEEDS_BROWSER
def test_the_page_tells_the_name_under_the_pointer(labelled: Path, tmp_path: Path) -> None:
    script = """<script>setTimeout(() => {
      const point = (element, type) => {
        const box = element.getBoundingClientRect(), [clientX, clientY] = [box.left + box.width / 2, box.top + box.height / 2];
        element.dispatchEvent(new PointerEvent(type, { clientX, clientY, pointerType: "mouse", bubbles: true }));
      };
      point(document.querySelector(".slice"), "pointermove");
      const set = (id, value) => {
        const element = document.getElementById(id); element.value = value;
        for (const kind of ["change", "input"]) element.dispatchEvent(new Event(kind));
      };
      set("view-mesh", "1");
      set("view-colour", [...document.getElementById("view-colour").options].find(o => o.text === "material").value);
      setTimeout(() => point(document.getElementById("view"), "pointermove"), 1000);
    }, 3000);</script></body>"""
    opened = tmp_path / "pointed.html"
    opened.write_text(labelled.read_text().replace("<body>", f"<body>{CLOCK}").replace("</body>", script))
    document, console = browse(opened, tmp_path / "profile", "--dump-dom")
    assert console == []
    assert re.search(r"<output>slice \d+: heart</output>", document)
    assert re.search(r'<output id="view-value">[^<]*material: heart;? ?[^<]*</output>', document)
    assert '<div id="view-key">' in document


@NEEDS_HXT
def test_the_page_tells_of_flat_tetrahedra(case: Path) -> None:
    report = json.loads((case / "c.report.json").read_text())
    assert program.main([str(case / "c.status.json"), "-o", str(case / "plain.html")]) == 0
    assert "Places" not in (case / "plain.html").read_text()
    place = {"place_mm": [1.25, 2.5, -3.75], "material": "body <skin>", "possible_degrees": 1.83}
    told = {**report, "results": dict(report["results"])}
    told["results"]["volume"] = dict(report["results"]["volume"])
    told["results"]["volume"]["forced_by_surface"] = [{**place, "min_dihedral": 1.62, "min_scaled_jacobian": 0.04}]
    needle = {
        **place,
        "place_mm": [7.5, 0.0, 1.0],
        "possible_scaled_jacobian": 0.0345,
        "min_dihedral": 5.5,
        "min_scaled_jacobian": 0.0312,
    }
    told["results"]["volume"]["forced_by_triangle"] = [needle, needle]
    told["results"]["tetrahedralizer"] = {
        **report["results"]["tetrahedralizer"],
        "mended": {
            "goal_degrees": 12.0,
            "below_before": 321,
            "below_after": 4,
            "min_dihedral_before": 2.87,
            "min_dihedral_after": 9.4,
        },
    }
    (case / "c.report.json").write_text(json.dumps(told))
    try:
        assert program.main([str(case / "c.status.json"), "-o", str(case / "flat.html")]) == 0
    finally:
        (case / "c.report.json").write_text(json.dumps(report))
    text = (case / "flat.html").read_text().replace("\u00a0", " ")
    assert "Left out: the reports lack" not in text
    for words in ("x 1.25, y 2.50, z -3.75", "1.83", "321 tetrahedra", "Dihedral angles limited by the surface: 1"):
        assert words in text
    for words in ("Scaled Jacobians limited by the surface: 2", "x 7.50, y 0.00, z 1.00", "0.0345", "0.0312"):
        assert words in text
