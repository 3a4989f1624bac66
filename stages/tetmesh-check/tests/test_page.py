"""Tests of the page and the index: complete, self-contained, accessible, made from the status."""

from __future__ import annotations

import csv
import json
import re
import shutil
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from conftest import volume_with_ball, write_nrrd, write_status
from PIL import Image

from tetmesh_check import cli
from tetmesh_check.errors import StageError
from tetmesh_check.quality import summarize
from tetmesh_check.report.page import index, program
from tetmesh_check.report.page.case import read_case
from tetmesh_check.report.page.templates import advice_for, environment, filled, number, render, ticks

ERROR = {"what": "v.nrrd: is <empty>", "why": "there is nothing to mesh", "next": "give another volume"}
NOTHING = {
    "state": "not reached", "exit_code": None, "seconds": None, "command": None, "report": None, "outputs": [], "warnings": [],
}  # fmt: skip


class Elements(HTMLParser):
    """The elements of a page with their attributes, and its text."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.found: list[tuple[str, dict[str, str | None]]] = []
        self.words = ""
        self.open: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attributes: list[tuple[str, str | None]]) -> None:
        self.found.append((tag, dict(attributes)))
        if tag not in ("meta", "link", "img", "input", "br", "line", "polyline", "image", "path"):
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attributes: list[tuple[str, str | None]]) -> None:
        self.found.append((tag, dict(attributes)))

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        if self.open and self.open[-1] not in ("script", "style"):
            self.words += data

    def of(self, *tags: str) -> list[dict[str, str | None]]:
        return [attributes for tag, attributes in self.found if tag in tags]


def made(status: Path, output: Path) -> Elements:
    """Make the page of a status and parse it."""
    assert program.main([str(status), "-o", str(output), "--force"]) == 0
    return Elements(output.read_text())


def copied(case: Path, folder: Path) -> Path:
    """Copy the folder of the case, so that a test can change it."""
    shutil.copytree(case, folder / "a&b", ignore=shutil.ignore_patterns("*.html", "pictures"))
    return folder / "a&b"


def test_the_page_is_whole_and_needs_nothing_else(case: Path, page: Path) -> None:
    text = page.read_text()
    elements = Elements(text)
    assert elements.open == []
    for attributes in elements.of("img"):
        assert str(attributes["src"]).startswith("data:image/webp;base64,")
    assert not [a for a in elements.of("script", "iframe", "link") if a.get("src")]
    assert [a["href"] for a in elements.of("link")] == ["data:,"]
    assert all(str(a["href"]).startswith("data:image/webp;base64,") for a in elements.of("image"))
    assert not re.search(r"https?://(?!www\.w3\.org/2000/svg)|url\(|@import", re.sub(r'id="view-data">[^<]*', "", text))
    titles = [
        "Checks", "Input", "The mesh in the volume", "In three dimensions", "Parts and sets", "Quality", "Solve", "Particles",
        "Stages", "Files", "How this was made",
    ]  # fmt: skip
    results = json.loads((case / "a&b.report.json").read_text())["results"]
    if results["pictures"]["drawn"]:
        titles.insert(4, "Pictures")
    # the table of contents links to every section, in order
    anchors = [str(a["href"]) for a in elements.of("a") if str(a["href"]).startswith("#")]
    assert anchors == [f"#{a['id']}" for a in elements.of("section")]
    assert [a["id"] for a in elements.of("section")] == [title.lower().replace(" ", "-") for title in titles]
    for said in (
        *titles,
        "a&b",
        "Fit for simulation, 1 warning",
        number(results["volume"]["tetrahedra"]),
        number(results["solve"]["elasticity"]["multigrid"]["iterations"]),
        *(check["words"] for check in results["checks"]),
        "a <strange> thing",
        "/data/scan <1>.nrrd",
        "c0ffee",
        "tetmesh-check --some options",
    ):
        assert said in elements.words
    verdict = next(a for a in elements.of("p") if str(a.get("class", "")).startswith("verdict"))
    assert verdict["class"] == "verdict warning"


def test_every_figure_has_words(page: Path) -> None:
    elements = Elements(page.read_text())
    assert len(elements.of("canvas")) == 1
    # seven histograms, two curves, three slices
    pictures = [a for a in elements.of("svg", "canvas") if a.get("class") != "window" and a.get("id") != "view-cube"]
    assert len(pictures) == 1 + 7 + 2 + 3
    for attributes in pictures:
        assert attributes["role"] == "img"
        assert len(str(attributes["aria-label"])) > 30
    for attributes in elements.of("img"):
        assert len(str(attributes["alt"])) > 20
    for attributes in elements.of("input"):
        assert attributes.get("aria-label") or attributes["type"] == "checkbox"


def test_files_are_linked_with_their_sizes(case: Path, page: Path) -> None:
    elements = Elements(page.read_text())
    links = [str(a["href"]) for a in elements.of("a") if not str(a["href"]).startswith("#")]
    assert "a%26b.volume.vtu" in links
    assert "reports/particles.json" in links
    assert "a%26b.distfield.vti" not in links  # listed, but not there
    elsewhere = made(case / "a&b.status.json", case.parent / "elsewhere.html")
    assert "a%26b/a%26b.surface.vtp" in [a["href"] for a in elsewhere.of("a")]
    size = (case / "a&b.passes.csv").stat().st_size
    assert f"particles{size} bytes" in elements.words


def test_exports_are_listed_although_the_status_lacks_them(case: Path, tmp_path: Path) -> None:
    folder = copied(case, tmp_path)
    report = json.loads((folder / "a&b.report.json").read_text())
    report["results"]["exports"] = ["a&b.boundary.vtp", "a&b.volume.msh"]
    (folder / "a&b.report.json").write_text(json.dumps(report))
    (folder / "a&b.boundary.vtp").write_text("twelve bytes")
    elements = made(write_status(folder, "a&b"), folder / "x.html")
    links = [a["href"] for a in elements.of("a")]
    assert "a%26b.boundary.vtp" in links
    assert "a%26b.volume.msh" not in links  # not there
    assert "export: boundary of the tetrahedratetmesh-check12 bytes" in elements.words


def test_places_of_the_reports_are_listed(case: Path, tmp_path: Path) -> None:
    folder = copied(case, tmp_path)
    report = json.loads((folder / "a&b.report.json").read_text())
    poor = {"place_mm": [1.25, -2.5, 3.75], "min_dihedral": 1.83, "min_scaled_jacobian": 0.0123}
    report["results"]["volume"]["poor_tetrahedra"] = [poor] * 300
    (folder / "a&b.report.json").write_text(json.dumps(report))
    other = {**report, "tool": "reconstruct", "warnings": [], "failed_checks": []}
    curves = [{"place": [-7.0, 8.0, -9.0], "radius_ratio": 0.0456}]
    (folder / "reports" / "reconstruct.json").write_text(
        json.dumps({**other, "results": {"check": {"poor_between_curves": curves}}})
    )
    event = {"kind": "gone", "place": [1.0, 2.0, 3.0], "volume": 546.75, "pieces": 1}
    changes = {"materials": [{"name": "a <rib>", "scale_changes": {"events": [event]}}, {"name": "b"}]}
    parameters = {"labels": [1]}
    (folder / "reports" / "distfield.json").write_text(
        json.dumps({**other, "tool": "distfield", "results": changes, "parameters": parameters})
    )
    elements = made(write_status(folder, "a&b"), folder / "x.html")
    words = elements.words.replace("\u00a0", " ")
    for said in (
        "Tetrahedra below a limit of shape: 300", "L 1.25, A 2.50, S 3.751.830.0123", "190 more", "lists all 300",
        "Triangles limited by junction curves: 1", "R 7.00, P 8.00, I 9.000.0456",
        "Changes made by the scale: 1", "L 1.00, P 2.00, S 3.00a <rib>part removed547",
    ):  # fmt: skip
        assert said in words
    assert [a["href"] for a in elements.of("a")].count("#places") == 2  # from the contents, and from the checks


def test_density_and_stiffness_are_listed(case: Path, tmp_path: Path) -> None:
    folder = copied(case, tmp_path)
    report = json.loads((folder / "a&b.report.json").read_text())
    report["results"]["density"] = {
        "file": "c<t>.nrrd", "mass_g": 17.85, "mean_density": 0.7055, "partly_outside": 0, "at_minimum_modulus": 12,
        "calibration": {"slope": 0.001, "intercept": -0.02, "rods": [[0, 0], [1, 1]], "rms_residual": 0.0118},
        "law": {"a": 10500.0, "b": 2.29, "kind": "ash", "reference": "Keller"},
        "density_g_per_cm3": summarize(np.array([0.3, 1.2])), "modulus_mpa": summarize(np.array([815.7, 14670.0])),
    }  # fmt: skip
    (folder / "a&b.report.json").write_text(json.dumps(report))
    words = made(write_status(folder, "a&b"), folder / "x.html").words.replace("\u202f", " ")
    for said in (
        "mass17.9 g", "density0.3 to 1.2 g/cm³, mean 0.706", "E816 to 14 670 N/mm²", "value -0.02 g/cm³, residual of 2 rods 0.012 g/cm³",
        "^2.29, ash density (Keller)", "at the minimum E12 of 2 tetrahedra", "partly outside c<t>.nrrd0 of 2",
    ):  # fmt: skip
        assert said in words


def test_helix_angles_of_fibres_are_drawn(case: Path, tmp_path: Path) -> None:
    folder = copied(case, tmp_path)
    report = json.loads((folder / "a&b.report.json").read_text())
    layers = [{"depth": 0.1 + 0.2 * k, "count": 7, "mean": 50.0 - k, "p5": 40.0, "p95": 60.25} for k in range(5)]
    report["results"]["fibres"] = {
        "material": "w<all>", "tetrahedra": 12345, "apex_mm": [1.0, -2.0, 3.0], "sets": {"endo": "a/b", "base": "caps"},
        "helix_by_depth": {"left free wall": layers, "septum": layers[:1], "right free wall": []},
    }  # fmt: skip
    (folder / "a&b.report.json").write_text(json.dumps(report))
    elements = made(write_status(folder, "a&b"), folder / "x.html")
    words = elements.words.replace("\u202f", " ")
    for said in (
        "Fibres",
        "musclew<all>, 12 345 tetrahedra",
        "endoa/b",
        "basecaps",
        "left free wall: depth",
        "0.174050",
        "60.2",
    ):
        assert said in words
    charts = [svg["aria-label"] for svg in elements.of("svg") if "Helix angle" in (svg.get("aria-label") or "")]
    assert len(charts) == 2
    assert "mean from 50 to 46 degrees" in str(charts[0])


def test_a_closeup_is_enlarged_where_the_mesh_is() -> None:
    pixels = np.zeros((1200, 1600, 4), dtype=np.uint8)
    pixels[:1030, :800] = (200, 100, 50, 255)
    pixels[1030:] = (1, 2, 3, 255)
    before, after = pixels.copy(), np.asarray(filled(Image.fromarray(pixels)))
    assert after.shape == before.shape
    assert (after[:1030, :, 3] > 0).mean() > 0.9
    np.testing.assert_array_equal(after[1030:], before[1030:])
    pixels[:1030] = (200, 100, 50, 255)
    np.testing.assert_array_equal(np.asarray(filled(Image.fromarray(pixels))), pixels)


def test_a_case_that_failed_at_the_first_stage_has_a_page(tmp_path: Path) -> None:
    stages = dict.fromkeys(("sizefield", "seed", "particles", "reconstruct", "tetmesh-check"), NOTHING)
    first = {"state": "error", "exit_code": 2, "error": ERROR, "outputs": [], "command": "distfield v.nrrd --iso 5"}
    status = write_status(tmp_path, "x", verdict="error", stages={"distfield": first, **stages})
    elements = made(status, tmp_path / "x.report.html")
    for said in (
        "No mesh: distfield: v.nrrd: is <empty>", "What happened", *ERROR.values(), "not reached", "SIZE", "2.5",
        "distfield v.nrrd --iso 5", "The volume is not shown",
    ):  # fmt: skip
        assert said in elements.words
    for title in ("In three dimensions", "Checks", "Quality", "Methods, to cite"):
        assert title not in elements.words
    assert index.main([str(status), "-o", str(tmp_path / "index.html")]) == 0
    listed = Elements((tmp_path / "index.html").read_text())
    assert "no mesh: distfield" in listed.words
    assert "Not fit: 1 of 1 case" in listed.words
    assert [a["href"] for a in listed.of("a")] == ["x.report.html", "index.csv"]
    line = next(csv.DictReader((tmp_path / "index.csv").open()))
    assert (line["verdict"], line["stage"], line["tetrahedra"], line["distfield_seconds"]) == (
        "error", "distfield", "", "1.5",
    )  # fmt: skip


def test_nothing_of_an_earlier_run_is_shown(case: Path, tmp_path: Path) -> None:
    folder = copied(case, tmp_path)
    stale = {**NOTHING, "state": "stale"}
    failed = {"state": "error", "error": ERROR, "outputs": [], "report": None}
    status = write_status(folder, "a&b", verdict="error", stages={"reconstruct": failed, "tetmesh-check": stale})
    # the files of the previous run are still in the folder under their usual names, but must not be
    # shown
    assert (folder / "a&b.volume.vtu").is_file()
    elements = made(status, folder / "x.html")
    assert "No mesh: reconstruct" in elements.words
    for title in ("In three dimensions", "Quality", "Solve", "Checks0"):
        assert title not in elements.words
    assert not [a for a in elements.of("a") if "volume" in str(a["href"]) or "surface" in str(a["href"])]
    line = index.summary(read_case(status))
    assert line["tetrahedra"] is None
    assert line["surface_triangles"] is None


def verdict(folder: Path, **changes: object) -> tuple[str, str]:
    case = read_case(write_status(folder, "x", **changes))
    return case.kind, render("headline", case=case).unescape()


def test_headlines(tmp_path: Path) -> None:
    assert verdict(tmp_path) == ("pass", "Fit for simulation: no warnings")
    assert verdict(tmp_path, goal="surface") == ("pass", "Complete up to surface: no warnings")
    two = {"seed": {"warnings": ["a"]}, "distfield": {"warnings": ["b"]}}
    assert verdict(tmp_path, stages=two) == ("warning", "Fit for simulation, 2 warnings")
    failed = {**two, "reconstruct": {"state": "failed", "failed_checks": ["one", "two"]}}
    assert verdict(tmp_path, stages=failed, verdict="failed") == (
        "fail", "Not fit for simulation: 2 checks failed, 2 warnings",
    )  # fmt: skip
    stopped = {"particles": {"state": "interrupted"}}
    assert verdict(tmp_path, stages=stopped, verdict="interrupted")[1].startswith("Interrupted during particles")
    assert verdict(tmp_path, stages={"seed": {"state": "running"}}, verdict="running") == (
        "neutral", "Still running: seed",
    )  # fmt: skip
    assert verdict(tmp_path, verdict="error") == ("fail", "No mesh: as make says it")


@pytest.mark.parametrize(("goal", "title"), [("surface", "surface"), ("mesh", "surface and tetrahedra")])
def test_the_title_says_what_was_made(tmp_path: Path, goal: str, title: str) -> None:
    elements = made(write_status(tmp_path, "x", goal=goal, stages={}), tmp_path / "x.html")
    assert elements.words.lstrip().startswith(f"x: {title}\n")


def test_what_to_do_stands_beside_a_failed_check(case: Path, tmp_path: Path) -> None:
    folder = copied(case, tmp_path)
    report = json.loads((folder / "a&b.report.json").read_text())
    parameters = read_case(folder / "a&b.status.json").parameters
    told = [advice_for(check["words"], parameters) for check in report["results"]["checks"]]
    assert len({*told, advice_for("unknown")}) == len(told) + 1, "each check has its own"
    report["results"]["checks"][1].update(verdict="fail", passed=False)
    report.update(failed_checks=["min_dihedral"])
    (folder / "a&b.report.json").write_text(json.dumps(report))
    (folder / "a&b.volume.vtu").rename(folder / "a&b.volume.failed.vtu")
    own = {"state": "failed", "outputs": [], "kept": ["a&b.volume.failed.vtu"]}
    surface = {"state": "failed", "failed_checks": ["3 pairs of intersecting triangles"]}
    status = write_status(folder, "a&b", verdict="failed", stages={"tetmesh-check": own, "reconstruct": surface})
    elements = made(status, folder / "x.html")
    assert told[1] in elements.words
    assert told[2] not in elements.words
    advice = advice_for("intersecting triangles", parameters)
    assert f"reconstruct: 3 pairs of intersecting triangles{advice}" in elements.words
    assert "Not fit for simulation: 2 checks failed, 1 warning" in elements.words
    assert "kept, although a check failed" in elements.words
    assert "In three dimensions" in elements.words  # the failed mesh is shown
    assert elements.words.index("3 pairs") < elements.words.index("minimum dihedral angle is")


def test_a_volume_that_cannot_be_read_does_not_stop_the_page(
    case: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: object) -> None:
        raise StageError("v.nrrd: is cut short", "it is shown", "copy it again")

    monkeypatch.setattr(program, "read_scan", refuse)
    words = made(case / "a&b.status.json", tmp_path / "x.html").words
    assert "The volume is not shown: v.nrrd: is cut short. copy it again." in words
    assert "In three dimensions" in words


@pytest.mark.parametrize("kind", ["scan", "labels", "materials"])
def test_the_input_is_read_as_the_stages_read_it(case: Path, tmp_path: Path, kind: str) -> None:
    labels = kind != "scan"
    scan = volume_with_ball(labels=labels)
    path = write_nrrd(
        tmp_path / "v.nrrd", scan.values, space="right-anterior-superior",
        space_directions="(-1,0,0) (0,-1,0) (0,0,1)", space_origin="(18,17,-14)",
    )  # fmt: skip
    folder = copied(case, tmp_path)
    report = {
        "tool": "distfield",
        "seconds": 1.0,
        "command_line": "",
        "error": None,
        "warnings": [],
        "failed_checks": [],
    }
    report["results"] = {"meta": {"source": "labels" if labels else "scalar"}}
    report["parameters"] = {"labels": [2]} if labels else {"iso": 110.0}
    if kind == "materials":
        entries = [{"name": name, "labels": [{"layer": 0, "label": k}]} for name, k in (("outside", 0), ("ball", 2))]
        report |= {"results": {"materials": []}, "parameters": {"materials": entries}}
    (folder / "reports" / "distfield.json").write_text(json.dumps(report))
    inputs = [{"role": "volume", "path": str(path), "bytes": 1, "hash": "c0ffee"}]
    elements = made(write_status(folder, "a&b", inputs=inputs), tmp_path / "x.html")
    assert "The mesh in the volume" in elements.words
    assert "towards L, P, S" in elements.words
    assert ("labels: 2, and the background 0" in elements.words) == labels
    assert ("Colours are labels" in elements.words) == labels
    rows = re.findall(r"<tr>.*?</tr>", (tmp_path / "x.html").read_text())
    assert sum(row.endswith("<td>yes</td></tr>") for row in rows) == labels
    outlines = [str(a["d"]) for a in elements.of("path") if a.get("class") == "over"]
    assert len(outlines) == 3
    assert all(len(line) > 200 for line in outlines)


def test_pictures_are_transparent_round_the_mesh(case: Path) -> None:
    """Transparent pictures also suit a dark page. The colour bar is below the mesh."""
    drawn = read_case(case / "a&b.status.json").pictures
    if not drawn:
        pytest.skip("nothing draws here: see the reason in the report")
    for kind, path in drawn.items():
        with Image.open(path) as image:
            assert image.size == (1600, 1200)
            alpha = np.asarray(image.convert("RGBA"))[:, :, 3]
        assert alpha.max() == 255
        assert alpha[-4:, :4].max() == 0
        if kind != "surface":
            assert 0.01 < alpha[-170:].mean() / 255.0 < 0.3


def test_the_facts_of_a_label_volume(case: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    turned = np.array([[0.0, 0.0, 2.0], [-1.5, 0.0, 0.0], [0.0, 1.0, 0.0]])
    scan = replace(volume_with_ball(turned, labels=True), crop="mm:..20,..,..", downsample=[2, 2, 1])
    monkeypatch.setattr(program, "read_scan", lambda *_: scan)
    words = made(case / "a&b.status.json", tmp_path / "x.html").words
    for said in (
        "40 \u00d7 36 \u00d7 30", "1.5 \u00d7 1 \u00d7 2 mm", "60 \u00d7 36 \u00d7 60 mm", "towards A, S, L",
        "uint8", "labels: 2, and the background 0", "a <ball>", "Colours are labels",
        "the region mm:..20,..,..", "before meshing, by 2 \u00d7 2 \u00d7 1 voxels",
    ):  # fmt: skip
        assert said in words


def test_bad_usage(case: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    status = str(case / "a&b.status.json")
    (tmp_path / "there.html").write_text("precious")
    (tmp_path / "other.json").write_text('{"tool": 1}')
    (tmp_path / "broken.json").write_text("{")
    (tmp_path / "new.json").write_text('{"format": "isoparticles-status", "version": 2}')
    (tmp_path / "lacks.json").write_text('{"format": "isoparticles-status", "version": 1, "name": "x"}')
    for main in (program.main, index.main):
        for words, said in (
            ([status, "-o", str(tmp_path / "x.txt")], "does not end in .html"),
            ([status, "-o", str(tmp_path / "there.html")], "already exists"),
            ([str(tmp_path / "absent.json"), "-o", str(tmp_path / "x.html")], "cannot read"),
            ([str(tmp_path / "broken.json"), "-o", str(tmp_path / "x.html")], "cannot read"),
            ([str(tmp_path / "other.json"), "-o", str(tmp_path / "x.html")], "is not the status"),
            ([str(tmp_path / "new.json"), "-o", str(tmp_path / "x.html")], "is a status of version 2"),
            ([str(tmp_path / "lacks.json"), "-o", str(tmp_path / "x.html")], "a field is missing"),
            ([str(case / "a&b.report.json"), "-o", str(tmp_path / "x.html")], "is not the status"),
        ):
            assert main(words) == 2
            error = capfd.readouterr().err
            assert said in error
            assert "what to do" in error
    assert (tmp_path / "there.html").read_text() == "precious"
    assert not list(tmp_path.glob("x.*"))


def test_index_and_its_numbers(case: Path, page: Path, tmp_path: Path) -> None:
    good = write_status(tmp_path, "good")
    output = case.parent / "index.html"
    statuses = [str(case / "a&b.status.json"), str(good)]
    assert index.main([*statuses, "-o", str(output)]) == 0
    elements = Elements(output.read_text())
    assert "2 cases, none failed, 1 warning" in elements.words
    assert "fit, 1 warning" in elements.words
    assert [a["href"] for a in elements.of("a")] == ["a%26b/a%26b.report.html", "index.csv"]
    assert (output.parent / "a&b" / "a&b.report.html") == page
    lines = list(csv.DictReader((case.parent / "index.csv").open()))
    results = json.loads((case / "a&b.report.json").read_text())["results"]
    assert [(line["name"], line["verdict"], line["warnings"]) for line in lines] == [
        ("a&b", "warning", "1"), ("good", "passed", "0"),
    ]  # fmt: skip
    assert int(lines[0]["tetrahedra"]) == results["volume"]["tetrahedra"]
    assert float(lines[0]["min_dihedral"]) == results["volume"]["quality"]["min_dihedral"]["min"]
    assert lines[0]["particles_seconds"] == "1.5"
    assert lines[1]["tetrahedra"] == ""

    bad = write_status(tmp_path, "bad", verdict="failed", stages={"seed": {"state": "failed", "failed_checks": ["x"]}})
    assert index.main([*statuses, str(bad), "-o", str(output), "--force"]) == 0
    assert "Not fit: 1 of 3 cases" in output.read_text()


def test_a_foreign_file_does_not_refuse_the_index(
    case: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "foreign.status.json").write_text('{"a": 1}')
    statuses = [str(tmp_path / "foreign.status.json"), str(case / "a&b.status.json")]
    assert index.main([*statuses, "-o", str(tmp_path / "index.html")]) == 0
    assert "left out of the index" in capfd.readouterr().err
    assert "1 case, none failed" in (tmp_path / "index.html").read_text()


def test_reports_that_lack_keys_are_read(case: Path, tmp_path: Path) -> None:
    folder = copied(case, tmp_path)
    path = folder / "a&b.report.json"
    whole = json.loads(path.read_text())

    def said() -> str:
        path.write_text(json.dumps(whole))
        status = write_status(folder, "a&b")
        words = made(status, folder / "x.html").words
        assert index.main([str(status), "-o", str(tmp_path / "index.html"), "--force"]) == 0
        return words

    del whole["results"]["volume"]["quality"]["radius_ratio"], whole["results"]["surface"]["topology"], whole["outcome"]
    assert (
        "Left out: the reports lack the data for this section (UndefinedError 'dict object' has no attribute 'radius_ratio')"
        in said()
    )
    for name in list(whole["results"]):
        del whole["results"][name]
        said()


def test_what_nobody_foresaw_does_not_look_like_a_failed_check(
    case: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    def broken(*_: object) -> None:
        raise ZeroDivisionError("nobody foresaw")

    monkeypatch.setattr(program, "page", broken)
    monkeypatch.setattr(index, "summary", broken)
    monkeypatch.setattr(cli, "_run", broken)
    status = str(case / "a&b.status.json")
    for main, words in (
        (program.main, [status, "-o", str(tmp_path / "x.html")]),
        (index.main, [status, "-o", str(tmp_path / "x.html")]),
        (cli.main, ["a.vtp", "-o", "b.vtu"]),
    ):
        assert main(words) == 2
        error = capfd.readouterr().err
        assert "error: ZeroDivisionError: nobody foresaw (test_page.py, line" in error
        assert "what to do" in error
    assert list(tmp_path.iterdir()) == []


def test_charts() -> None:
    assert ticks(0.0, 1.0) == pytest.approx([0.0, 0.2, 0.4, 0.6, 0.8, 1.0])
    assert ticks(34480.0, 36400.0, 4) == pytest.approx([34500, 35000, 35500, 36000])
    assert [number(v) for v in (0.123456, 12345, 1234567.8, 2.0, 999.7, -999.7, 999.4, float("nan"))] == [
        "0.123", "12\u202f345", "1\u202f234\u202f568", "2", "1\u202f000", "-1\u202f000", "999", "-",
    ]  # fmt: skip
    charts = environment().get_template("charts.html").module
    words = ("Things", "size, mm", "things")
    summary = {
        "histogram": {"edges": [0.0, 0.5, 1.0], "counts": [1, 100]},
        "count": 101, "infinite": 0, "mean": 0.7, "min": 0.1,
    }  # fmt: skip
    drawn = charts.histogram(summary, *words, "minimum", 0.25)
    bars = re.search(r'<g class="bars">(.*?)</g>', drawn)
    assert bars is not None
    heights = [float(h) for h in re.findall(r'height="([0-9.]+)"', bars.group(1))]
    # the logarithmic axis starts at 0.5, so that a count of 1 is visible next to a count of 100
    assert heights[0] / heights[1] == pytest.approx(np.log10(2.0) / np.log10(200.0), rel=1e-3)
    assert "mean 0.7, minimum 0.1, limit 0.25: below it the check fails; 101 counted" in drawn
    for said in ("mean 0.7", "minimum 0.1", "limit 0.25: below it the check fails", "size, mm", "things, in powers"):
        assert f">{said}" in drawn
    fails = re.search(r'<rect class="fails" x="([0-9.]+)" y="[0-9.]+" width="([0-9.]+)"', drawn)
    line = re.search(r'<line class="limit" x1="([0-9.]+)"', drawn)
    assert fails is not None
    assert line is not None
    assert float(fails.group(1)) + float(fails.group(2)) == pytest.approx(float(line.group(1)), abs=0.2)
    summary = summarize(np.array([0.5, 1.5, 2.5, 9.0, np.inf]), np.linspace(0.0, 3.0, 4))
    assert "maximum 9; 1 beyond; 4 counted" in charts.histogram(summary, *words, "maximum")
    jacobian = summarize(np.array([0.5, 0.7]), np.linspace(-1.0, 1.0, 21))
    assert ">-0.5<" not in charts.histogram(jacobian, *words, "minimum")
    flat = charts.curve([5.0, 5.0], "Flat", "y")
    assert "nan" not in flat
    assert "from 5 to 5 after 2" in flat


def test_histograms_have_the_limits_of_the_checks(case: Path) -> None:
    whole = read_case(case / "a&b.status.json")
    drawn = render("quality", case=whole)
    limits = {check["name"]: check["limit"] for check in whole.checks}
    for name in ("min_dihedral", "min_scaled_jacobian"):
        assert f"limit {number(limits[name])}: below it the check fails" in drawn
    report = {"results": {"check": {"min_radius_ratio_allowed": 0.3}}}
    stages = [
        {**stage, "report": report if stage["stage"] == "reconstruct" else stage["report"]} for stage in whole.stages
    ]
    again = replace(whole, stages=stages)
    assert "limit 0.3: below it the check fails" in render("quality", case=again)


def test_places_have_the_letters_of_their_frame(case: Path) -> None:
    report = json.loads((case / "a&b.report.json").read_text())
    poor = {"place_mm": [7.5, -2.0, 1.0], "min_dihedral": 3.0, "min_scaled_jacobian": 0.05}
    try:
        for space, words in (("lps", "L 7.50, A 2.00, S 1.00"), ("ras", "R 7.50, P 2.00, S 1.00")):
            changed = json.loads(json.dumps(report))
            changed["parameters"]["space"] = space
            changed["results"]["volume"]["poor_tetrahedra"] = [poor]
            (case / "a&b.report.json").write_text(json.dumps(changed))
            assert program.main([str(case / "a&b.status.json"), "-o", str(case / "f.html"), "--force"]) == 0
            text = (case / "f.html").read_text().replace("\u00a0", " ")
            assert words in text
            assert f"World coordinates are in {space.upper()}, mm." in text
    finally:
        (case / "a&b.report.json").write_text(json.dumps(report))


def test_parts_and_sets_are_listed(case: Path, tmp_path: Path) -> None:
    folder = copied(case, tmp_path)
    report = json.loads((folder / "a&b.report.json").read_text())
    found = report["results"]["boundary"]
    assert [row["name"] for row in found["parts"]] == ["surface"]
    shown = {"area_mm2": 12.5, "triangles": 7, "centre_mm": [1.0, 2.0, 3.25], "normal": [0.0, 0.0, -1.0]}
    cap = {"number": 2, "name": "cap_z0_1", "kind": "cap", "between": ["object", "outside"], **shown}
    found["parts"].append(cap)
    found["sets"] = [{"name": "inlet", "expression": "'<ear>' & caps", "parts": ["cap_z0_1"], **shown}]
    (folder / "a&b.report.json").write_text(json.dumps(report))
    words = made(write_status(folder, "a&b"), folder / "x.html").words.replace("\u00a0", " ")
    assert "cap_z0_1capobject / outside12.57L 1.00, P 2.00, S 3.250.00, 0.00, -1.00" in words
    assert "inlet'<ear>' & caps112.57" in words
