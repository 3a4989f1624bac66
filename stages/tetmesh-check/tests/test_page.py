"""The page of a case and the index: complete, self-contained, readable without eyes, and drawn by a browser."""

from __future__ import annotations

import base64
import csv
import json
import re
import shutil
import subprocess
import sys
import zlib
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
import pyvista as pv
from conftest import ball, tetrahedra, write_sizing

from tetmesh_check import cli, convergence
from tetmesh_check.cut import cut_of, cut_through_the_middle
from tetmesh_check.page import index, measured, program
from tetmesh_check.page.case import read_case
from tetmesh_check.page.charts import curve, histogram, number, ticks
from tetmesh_check.page.payload import STEPS, ViewMesh, pack
from tetmesh_check.polydata import from_polydata
from tetmesh_check.quality import signed_tetrahedron_volumes, summarize, triangle_quality

BROWSER = next(
    (found for name in ("chromium", "chromium-browser", "google-chrome") if (found := shutil.which(name))), None
)
NEEDS_BROWSER = pytest.mark.skipif(BROWSER is None, reason="no Chromium here (Debian: apt-get install chromium)")


@pytest.fixture(scope="module")
def case(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder as make leaves it, of a ball; its name must be escaped in HTML."""
    folder = tmp_path_factory.mktemp("cases") / "a&b"
    (folder / "reports").mkdir(parents=True)
    ball(subdivisions=3).save(folder / "a&b.surface.vtp")
    write_sizing(folder / "a&b.sizefield.vti", lambda world: np.where(world[:, 0] < 0, 1.5, 3.0))
    words = ["a&b.surface.vtp", "--sizefield", "a&b.sizefield.vti", "-o", "a&b.volume.vtu", "--max-passes", "3"]
    command = ["-m", "tetmesh_check", *words, "--report", "a&b.report.json", "--pictures", "pictures", "-q"]
    subprocess.run([sys.executable, *command], cwd=folder, check=True, timeout=120)
    report = json.loads((folder / "a&b.report.json").read_text())
    stage = {**report, "tool": "particles", "results": {}, "warnings": ["a <strange> thing"], "failed_checks": []}
    (folder / "reports" / "particles.json").write_text(json.dumps(stage))
    lines = ["pass,energy,count"] + [f"{k},{1000 / k + 500},{900 + k}" for k in range(1, 20)]
    (folder / "a&b.passes.csv").write_text("\n".join(lines) + "\n")
    return folder


@pytest.fixture(scope="module")
def page(case: Path) -> Path:
    path = case / "a&b.report.html"
    assert program.main([str(case / "a&b.report.json"), "-o", str(path)]) == 0
    return path


class Elements(HTMLParser):
    """All elements with their attributes, and the words of the page."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.found: list[tuple[str, dict[str, str | None]]] = []
        self.words = ""
        self.open: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attributes: list[tuple[str, str | None]]) -> None:
        self.found.append((tag, dict(attributes)))
        if tag not in ("meta", "link", "img", "input", "br", "line", "rect", "polyline"):
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


def test_the_page_is_whole_and_needs_nothing_else(case: Path, page: Path) -> None:
    text = page.read_text()
    elements = Elements(text)
    assert elements.open == []
    for attributes in elements.of("img"):
        assert str(attributes["src"]).startswith("data:image/webp;base64,")
    assert not [a for a in elements.of("script", "iframe", "link") if a.get("src")]
    assert [a["href"] for a in elements.of("link")] == ["data:,"]
    assert not re.search(r"https?://|url\(|@import", re.sub(r'id="view-data">[^<]*', "", text))
    for title in (
        "In three dimensions",
        "Checks",
        "Quality",
        "Solve",
        "Particles",
        "Time and memory",
        "Parameters and provenance",
    ):
        assert title in elements.words
    results = json.loads((case / "a&b.report.json").read_text())["results"]
    assert ("Pictures" in elements.words) == bool(set(results["pictures"]["drawn"]) - {"a&b.quality.png"})
    for said in (
        "a&b",
        "Fit for simulation: all 10 checks passed",
        number(results["volume"]["tetrahedra"]),
        number(results["solve"]["elasticity"]["multigrid"]["iterations"]),
        number(results["solve"]["elasticity"]["jacobi"]["iterations"]),
        *(check["words"] for check in results["checks"]),
        "a <strange> thing",
    ):
        assert said in elements.words


def test_every_figure_has_words(page: Path) -> None:
    elements = Elements(page.read_text())
    assert len(elements.of("svg")) == 8
    for attributes in elements.of("svg", "canvas"):
        assert attributes["role"] == "img"
        assert len(str(attributes["aria-label"])) > 30
    for attributes in elements.of("img"):
        assert len(str(attributes["alt"])) > 20
    assert len(elements.of("figure")) == len(elements.of("figcaption"))


def test_what_is_not_there_is_left_out(case: Path, tmp_path: Path) -> None:
    shutil.copy(case / "a&b.report.json", tmp_path / "x.report.json")
    assert program.main([str(tmp_path / "x.report.json"), "-o", str(tmp_path / "x.html"), "--name", "only <this>"]) == 0
    words = Elements((tmp_path / "x.html").read_text()).words
    assert "only <this>" in words
    for title in ("In three dimensions", "Pictures", "Particles"):
        assert title not in words

    report = json.loads((tmp_path / "x.report.json").read_text())
    report["results"]["checks"][1].update(verdict="fail", passed=False)
    (tmp_path / "x.report.json").write_text(json.dumps(report))
    assert read_case(tmp_path / "x.report.json").verdict() == ("fail", "Not fit for simulation: 1 of 10 checks failed")
    report.update(error={"what": "x.vtp: is open", "why": "", "next": ""}, results={}, outcome="error")
    (tmp_path / "x.report.json").write_text(json.dumps(report))
    assert program.main([str(tmp_path / "x.report.json"), "-o", str(tmp_path / "x.html"), "--force"]) == 0
    assert "No mesh: x.vtp: is open" in Elements((tmp_path / "x.html").read_text()).words


def test_bad_usage(case: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    report = str(case / "a&b.report.json")
    (tmp_path / "there.html").write_text("precious")
    (tmp_path / "other.json").write_text('{"tool": 1}')
    (tmp_path / "broken.json").write_text("{")
    stage = str(case / "reports" / "particles.json")
    for main in (program.main, index.main):
        for words, said in (
            ([report, "-o", str(tmp_path / "x.txt")], "does not end in .html"),
            ([report, "-o", str(tmp_path / "there.html")], "exists already"),
            ([str(tmp_path / "absent.json"), "-o", str(tmp_path / "x.html")], "cannot read"),
            ([str(tmp_path / "broken.json"), "-o", str(tmp_path / "x.html")], "cannot read"),
            ([str(tmp_path / "other.json"), "-o", str(tmp_path / "x.html")], "is no report"),
            ([stage, "-o", str(tmp_path / "x.html")], "is of particles"),
        ):
            assert main(words) == 2
            error = capsys.readouterr().err
            assert said in error
            assert "what to do" in error
    assert (tmp_path / "there.html").read_text() == "precious"
    assert not list(tmp_path.glob("x.*"))


def test_index_and_its_numbers(case: Path, page: Path, tmp_path: Path) -> None:
    shutil.copy(case / "a&b.report.json", tmp_path / "second.report.json")
    output = case.parent / "index.html"
    reports = [str(case / "a&b.report.json"), str(tmp_path / "second.report.json")]
    assert index.main([*reports, "-o", str(output)]) == 0
    elements = Elements(output.read_text())
    assert "All 2 cases are fit for simulation" in elements.words
    links = [a["href"] for a in elements.of("a")]
    assert links == ["a%26b/a%26b.report.html", "index.csv"]
    assert (output.parent / "a&b" / "a&b.report.html") == page
    lines = list(csv.DictReader((case.parent / "index.csv").open()))
    results = json.loads((case / "a&b.report.json").read_text())["results"]
    assert [line["name"] for line in lines] == ["a&b", "second"]
    assert int(lines[0]["tetrahedra"]) == results["volume"]["tetrahedra"]
    assert float(lines[0]["min_dihedral"]) == results["volume"]["quality"]["min_dihedral"]["min"]
    assert lines[0]["particles_seconds"] != ""
    assert lines[1]["particles_seconds"] == ""

    report = json.loads((tmp_path / "second.report.json").read_text())
    report["results"]["checks"][0]["verdict"] = "fail"
    (tmp_path / "second.report.failed.json").write_text(json.dumps(report))
    reports[1] = str(tmp_path / "second.report.failed.json")
    assert index.main([*reports, "-o", str(output), "--force"]) == 0
    assert "Not fit for simulation: 1 of 2 cases" in output.read_text()


def test_a_foreign_report_does_not_refuse_the_index(
    case: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "foreign.report.json").write_text('{"a": 1}')
    reports = [str(tmp_path / "foreign.report.json"), str(case / "a&b.report.json")]
    assert index.main([*reports, "-o", str(tmp_path / "index.html")]) == 0
    assert "left out of the index" in capsys.readouterr().err
    assert "All 1 cases are fit" in (tmp_path / "index.html").read_text()


def test_reports_that_lack_keys_are_read(case: Path, tmp_path: Path) -> None:
    whole = json.loads((case / "a&b.report.json").read_text())
    path = tmp_path / "x.report.json"

    def made() -> str:
        path.write_text(json.dumps(whole))
        assert program.main([str(path), "-o", str(tmp_path / "x.html"), "--force"]) == 0
        assert index.main([str(path), "-o", str(tmp_path / "index.html"), "--force"]) == 0
        return Elements((tmp_path / "x.html").read_text()).words

    del whole["results"]["volume"]["quality"]["radius_ratio"], whole["results"]["surface"]["topology"], whole["outcome"]
    assert "Left out: the reports lack what it is made from (KeyError 'radius_ratio')" in made()
    for name in list(whole["results"]):
        del whole["results"][name]
        made()
    assert "holds no checks" in made()


def test_a_stage_that_failed_makes_the_case_unfit(case: Path, tmp_path: Path) -> None:
    shutil.copy(case / "a&b.report.json", tmp_path / "x.report.json")
    (tmp_path / "reports").mkdir()
    stage = json.loads((case / "reports" / "particles.json").read_text())
    for change, words in (
        ({"error": {"what": "v.nrrd: is empty", "why": "", "next": ""}}, "particles failed: v.nrrd: is empty"),
        ({"failed_checks": ["too few"]}, "a check of particles failed: too few"),
    ):
        (tmp_path / "reports" / "particles.json").write_text(json.dumps({**stage, **change}))
        kind, said = read_case(tmp_path / "x.report.json").verdict()
        assert kind == "fail"
        assert words in said


def test_what_nobody_foresaw_does_not_look_like_a_failed_check(
    case: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def broken(*_: object) -> None:
        raise ZeroDivisionError("nobody foresaw")

    monkeypatch.setattr(program, "page", broken)
    monkeypatch.setattr(index, "index", broken)
    monkeypatch.setattr(convergence, "_run", broken)
    monkeypatch.setattr(cli, "_run", broken)
    report = str(case / "a&b.report.json")
    for main, words in (
        (program.main, [report, "-o", str(tmp_path / "x.html")]),
        (index.main, [report, "-o", str(tmp_path / "x.html")]),
        (convergence.main, ["a.vtu", "b.vtu"]),
        (cli.main, ["a.vtp", "-o", "b.vtu"]),
    ):
        assert main(words) == 2
        error = capsys.readouterr().err
        assert "error: ZeroDivisionError: nobody foresaw (test_page.py, line" in error
        assert "what to do" in error
    assert list(tmp_path.iterdir()) == []


def test_the_packed_meshes_are_the_meshes() -> None:
    points, triangles = from_polydata(ball(7.0, 2).translate((100.0, 50.0, -3.0)))
    sizes = np.linspace(1.0, 2.0, len(points))
    quality = triangle_quality(points, triangles).radius_ratio
    about, data = pack([ViewMesh("surface", points, triangles, quality, sizes)], 0.5, 0.3)
    raw = zlib.decompress(base64.b64decode(data))
    mesh = about["meshes"][0]

    def whole(start: int, count: int) -> np.ndarray:
        planes = np.frombuffer(raw[start : start + 4 * count], np.uint8).reshape(4, count).astype(np.int64)
        zigzag = (planes << np.array([[0], [8], [16], [24]])).sum(axis=0)
        return np.cumsum((zigzag >> 1) ^ -(zigzag & 1))

    read = whole(mesh["points"], 3 * mesh["point_count"]).reshape(3, -1).T * about["step"]
    corners = whole(mesh["triangles"], 3 * mesh["triangle_count"]).reshape(-1, 3)
    half, centre = 0.5 * np.ptp(points, axis=0).max(), 0.5 * (points.min(axis=0) + points.max(axis=0))

    def as_set(p: np.ndarray, t: np.ndarray) -> set:
        return {tuple(map(tuple, np.round(p[c]).astype(int))) for c in t}

    assert as_set(read[corners] * STEPS, range(len(corners))) == as_set(
        ((points - centre) / half * STEPS)[triangles], range(len(triangles))
    )
    shown = np.frombuffer(raw[mesh["quality"] : mesh["quality"] + len(triangles)], np.uint8) / 255.0
    np.testing.assert_allclose(np.sort(shown), np.sort(quality), atol=0.003)


def test_the_colours_of_edge_length_are_those_of_the_cut(case: Path) -> None:
    meshes = program.view_meshes(None, case / "a&b.volume.vtu")
    cut = meshes[0]
    used = np.unique(cut.triangles)
    assert len(used) < 0.6 * len(cut.points)
    low, high = np.percentile(cut.size[used], [1, 99])
    assert low > 0.5
    assert pack(meshes, 0.5, 0.3)[0]["scales"][2] == f"edge length, {low:.3g} to {high:.3g} mm"


def test_the_cut_keeps_the_farther_half(case: Path) -> None:
    points, cells, grid = tetrahedra(case / "a&b.volume.vtu")
    cut = cut_of(grid)
    # as by looking at all faces
    everywhere = cut_through_the_middle(points, cells, np.ones(len(points), dtype=bool))
    np.testing.assert_array_equal(cut.triangles, everywhere.triangles)
    np.testing.assert_array_equal(cut.owners, everywhere.owners)
    depth = points[cells].mean(axis=1) @ cut.normal
    assert depth[cut.owners].max() < np.median(depth)
    corners = points[cut.triangles]
    inside = np.einsum("ij,ij->i", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])).sum() / 6.0
    assert inside == pytest.approx(signed_tetrahedron_volumes(points, cells[depth < np.median(depth)]).sum())


def test_charts() -> None:
    assert ticks(0.0, 1.0) == pytest.approx([0.0, 0.2, 0.4, 0.6, 0.8, 1.0])
    assert ticks(34480.0, 36400.0, 4) == pytest.approx([34500, 35000, 35500, 36000])
    assert [number(v) for v in (0.123456, 12345, 1234567.8, 2.0, 999.7, -999.7, 999.4, float("nan"))] == [
        "0.123", "12\u202f345", "1\u202f234\u202f568", "2", "1\u202f000", "-1\u202f000", "999", "-",
    ]  # fmt: skip
    drawn = histogram([0.0, 0.5, 1.0], [1, 3], "Things", "size", {"mean": 0.7, "smallest": 0.1})
    heights = [float(h) for h in re.findall(r'<rect [^>]*height="([0-9.]+)"', drawn)]
    assert heights[1] == pytest.approx(3.0 * heights[0], rel=1e-3)
    assert "mean 0.7, smallest 0.1; 4 counted" in drawn
    assert "4 beyond; 8 counted" in histogram([0.0, 0.5, 1.0], [1, 3], "Things", "size", {"largest": 3.0}, beyond=4)
    summary = summarize(np.array([0.5, 1.5, 2.5, 9.0, np.inf]), np.linspace(0.0, 3.0, 4))
    assert "1 beyond; 4 counted" in measured._histogram(summary, "Things", "size", "largest")
    flat = curve([1.0, 2.0], [5.0, 5.0], "Flat", "x", "y")
    assert "nan" not in flat
    assert "from 5 to 5 after 2" in flat


def browse(page: Path, folder: Path, *words: str) -> tuple[str, list[str]]:
    """Open a page; the document as it stands in the end, and what was said on the console."""
    assert BROWSER is not None
    options = [
        "--headless=new", "--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--hide-scrollbars",
        "--window-size=1280,1400", "--virtual-time-budget=15000", "--enable-logging=stderr", f"--user-data-dir={folder}",
    ]  # fmt: skip
    done = subprocess.run(
        [BROWSER, *options, *words, page.as_uri()], capture_output=True, text=True, timeout=55, check=False
    )
    said = [line for line in done.stderr.splitlines() if "CONSOLE" in line]
    # what the driver thinks of reading pixels back, which some runs say and others do not
    return done.stdout, [line for line in said if "GL Driver Message (OpenGL, Performance" not in line]


@NEEDS_BROWSER
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_a_browser_draws_the_page(page: Path, tmp_path: Path, scheme: str) -> None:
    dark = ["--force-dark-mode"] if scheme == "dark" else []
    document, console = browse(page, tmp_path / "profile", "--dump-dom", *dark)
    assert console == []
    canvas = re.search(r"<canvas [^>]*>", document)
    assert canvas is not None
    assert 'data-state="drawn"' in canvas.group()
    covered = re.search(r'data-covered="([0-9.]+)"', canvas.group())
    assert covered is not None
    # the ball fills the height of the view but for a margin: pi / 4 of a square, which is about half as wide as the view
    assert 0.2 < float(covered.group(1)) < 0.6
    browse(page, tmp_path / "profile", f"--screenshot={tmp_path / 'page.png'}", *dark)
    image = pv.read(tmp_path / "page.png")
    pixels = (
        np.asarray(image.point_data.active_scalars).reshape(*image.dimensions[1::-1], -1)[::-1, :, :3].astype(float)
    )
    assert pixels[5, 5].mean() > 240 if scheme == "light" else pixels[5, 5].mean() < 40
    assert pixels[400:1000, 300:1000].std() > 20


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
