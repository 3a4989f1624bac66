"""Tests of the benchmarks of docs/results.md: a tiny run, and the page made from rows."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

sys.path.insert(0, str(Path(__file__).parent))

import growth
import measured
import page
import paper

ROOT = Path(__file__).parents[2]
PROGRAMS = Path(os.environ.get("ISOPARTICLES_BIN", ROOT / "target" / "release"))


def call(program: str, *words: object) -> subprocess.CompletedProcess[str]:
    """Run one of the programs in the root of the project."""
    command = [sys.executable, f"tests/results/{program}.py", *map(str, words)]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)


def rows_of_paper() -> dict[str, Any]:
    """Return a row for each run, with the figures that the page needs."""
    rows: dict[str, Any] = {}
    triangles = {"mean": 0.96, "smallest": 0.3, "angles": [20, 110], "histogram": [1] * measured.BINS}
    for case in paper.cases(["1", "2", "3", "4"], False):
        for engine in ("cpu-1", "cpu-all", "gpu"):
            rows[f"{case.stem} {engine}"] = {
                "seeds": 100, "particles": 90, "h": [1.0, 1.1, 1.2], "passes": 20, "energy_ratio": 0.8,
                "settle": 4.0, "device": 0.5, "wall": 1.0,
            }  # fmt: skip
            rows[f"1 {case.stem}.{engine}"] = {"exit_code": 0, "raw": triangles, "finished": triangles}
    return rows


def rows_of_growth() -> dict[str, Any]:
    """Return rows with seconds proportional to the squared size, without the last reconstruct."""
    sizes = {
        "volume": [n**3 for n in growth.VOLUMES],
        "particles": growth.COUNTS,
        "cores": [1, 2, 4],
        "materials": growth.MATERIALS,
    }
    rows: dict[str, Any] = {}
    for series, values in sizes.items():
        for size in values:
            for stage in growth.STAGES:
                for engine in ("cpu", "gpu") if stage == "particles" else ("",):
                    name = f"{series} {size:09.0f} {stage}{engine and ' ' + engine}"
                    rows[name] = {
                        "series": series,
                        "size": size,
                        "stage": stage,
                        "engine": engine,
                        "seconds": size**2,
                        "bytes": size,
                    }
    rows[f"particles {growth.COUNTS[-1]:09.0f} reconstruct"]["left_out"] = "more than 60 s expected"
    return rows


def write(folder: Path, paper_rows: dict[str, Any], growth_rows: dict[str, Any], adapter: str | None = "a (b)") -> None:
    """Write the template and the rows with the layout of docs/results."""
    head = {"date": "2012-03-03", "commit": "c", "processor": "p", "cores": 4, "adapter": adapter, "beside": 1}
    folder.mkdir(exist_ok=True)
    (folder / "template.md").write_bytes((ROOT / "docs/results/template.md").read_bytes())
    (folder / "paper.json").write_text(json.dumps({"head": head, "rows": paper_rows}))
    (folder / "growth.json").write_text(json.dumps({"head": head, "rows": growth_rows}))


def test_page_of_all_rows(tmp_path: Path) -> None:
    write(tmp_path, rows_of_paper(), rows_of_growth())
    output = tmp_path / "results.md"
    assert call("page", "--folder", tmp_path, "-o", output).returncode == 0
    text = output.read_text()
    assert "{{" not in text
    assert "| torso ribcage (ribcage) | 9,460 | 269 | 35.2 | 90, 90 | 4.00 | 4.00 | 0.500 | 1.00 | 8.0 |" in text
    assert "| 60,000 | 4.2, 5.3 | 6.1 | 90, 90 | 10.0, 10.0 |" in text
    assert "| exponent of time | 2.00 | 2.00 |" in text
    assert call("page", "--folder", tmp_path, "-o", output, "--check").returncode == 0
    output.write_text(text.replace("0.500", "0.400"))
    assert call("page", "--folder", tmp_path, "-o", output, "--check").returncode == 1


def test_page_of_a_machine_without_a_gpu(tmp_path: Path) -> None:
    rows = [
        {name: row for name, row in every.items() if not name.endswith("gpu")}
        for every in (rows_of_paper(), rows_of_growth())
    ]
    write(tmp_path, *rows, adapter=None)
    assert call("page", "--folder", tmp_path, "-o", tmp_path / "results.md").returncode == 0
    text = (tmp_path / "results.md").read_text()
    assert "No GPU was available" in text
    assert "{{" not in text
    assert "| torso ribcage (ribcage) | 9,460 | 269 | 35.2 | 90 | 4.00 | 4.00 | 20 |" in text


@pytest.mark.parametrize("adapter", [None, "a (b)"])
def test_pictures(tmp_path: Path, adapter: str | None) -> None:
    pytest.importorskip("matplotlib")
    write(tmp_path, rows_of_paper(), rows_of_growth(), adapter)
    done = call("plots", "--folder", tmp_path, "--images", tmp_path)
    assert done.returncode == 0, done.stderr
    assert sorted(path.stem for path in tmp_path.glob("*.png")) == [
        "results-fig7",
        "results-fig8",
        "results-fig9",
        "results-growth",
    ]


def test_no_page_without_a_row(tmp_path: Path) -> None:
    for place in ("paper", "growth"):
        rows = {"paper": rows_of_paper(), "growth": rows_of_growth()}
        name = {"paper": "3-180000-as-printed gpu", "growth": "materials 000000030 seed"}[place]
        del rows[place][name]
        write(tmp_path, rows["paper"], rows["growth"])
        done = call("page", "--folder", tmp_path, "-o", tmp_path / "results.md")
        assert done.returncode == 1
        assert f"no row '{name}'" in done.stderr
        assert not (tmp_path / "results.md").exists()


def test_the_page_in_docs_is_of_its_rows() -> None:
    if not (ROOT / "docs/results/paper.json").exists():
        pytest.skip("docs/results/paper.json is not there: make bench-paper, on a machine with a GPU, writes it")
    done = call("page", "--check")
    assert done.returncode == 0, done.stderr


def test_exponents() -> None:
    assert page.exponent([(1, 3), (2, 6), (4, 12)]) == pytest.approx(1.0)
    assert page.exponent([(1, 3), (2, 6)]) is None


def test_cells_of_materials() -> None:
    edge, count = 24, 7
    file = growth.cells(count, edge)
    header, _, voxels = file.partition(b"\n\n")
    assert b"sizes: 24 24 24" in header
    assert len(voxels) == edge**3
    assert set(voxels) == set(range(count + 1))
    inside = sum(label > 0 for label in voxels)
    ball = 4 / 3 * 3.14159 * (0.42 * edge) ** 3
    assert abs(inside / ball - 1) < 0.03


def test_what_fails_is_told_and_left_out(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    bench = measured.Bench(tmp_path, tmp_path, 1, float("inf"))

    def fail() -> None:
        raise measured.StageError("no such thing")

    bench.each([("a row", fail)], 1)
    assert bench.left == 1
    assert "a row: left out: no such thing" in capsys.readouterr().err


def test_rows_of_another_build_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "rows.json"
    measured.Rows.open(path, {"commit": "one"}).add("row", {"x": 1})
    assert measured.Rows.open(path, {"commit": "one"}).rows == {"row": {"x": 1}}
    with pytest.raises(SystemExit, match="commit is 'one' there and 'two' here"):
        measured.Rows.open(path, {"commit": "two"})


@pytest.mark.skipif(not (PROGRAMS / "reconstruct").exists(), reason="the programs are not built: make build")
def test_a_tiny_case_runs_and_is_not_run_again(tmp_path: Path) -> None:
    words = (
        "--quick",
        "--no-gpu",
        "--bin",
        PROGRAMS,
        "--work",
        tmp_path / "work",
        "--json",
        tmp_path / "rows.json",
        "--jobs",
        "2",
    )
    done = call("paper", *words, "--tables", "1", "2")
    assert done.returncode == 0, done.stderr
    rows = json.loads((tmp_path / "rows.json").read_text())["rows"]
    assert len(rows) == 6
    # A quick run must not reuse the files of a full run, so the name of its folder ends in -quick.
    assert [folder.name.endswith("-quick") for folder in (tmp_path / "work").iterdir()] == [True]
    one, every = (rows[f"2-torso-heart-as-printed {engine}"] for engine in ("cpu-1", "cpu-all"))
    assert one["particles"] == every["particles"] == pytest.approx(4000, rel=0.25)
    meshed = rows["1 2-torso-heart-defaults.cpu-all"]
    assert meshed["exit_code"] == 0
    assert meshed["finished"]["mean"] > meshed["raw"]["mean"] > 0.9
    again = call("paper", *words, "--tables", "2")
    assert again.stderr.splitlines() == [
        "no GPU: its rows are left out",
        f"{tmp_path / 'rows.json'}: 6 rows, 0 left out",
    ]
