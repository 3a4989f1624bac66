"""Tests of repeated attempts and of the choice among them, with fake tetrahedralizers."""

from __future__ import annotations

import errno
import json
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
import pyvista as pv
from conftest import Run, ball, fake_library, tetrahedra

from tetmesh_check import cli
from tetmesh_check.errors import StageError
from tetmesh_check.tets import fill, tetwild
from tetmesh_check.tets.worker import Job, Raw, Runner, Worker, scale_of


def filled(scale: float, flatness: float) -> Raw:
    """Join the triangles of a scaled ball to one inner point; ``flatness`` moves it to the top."""
    sphere = ball()
    points = np.vstack([scale * sphere.points, [0.0, 0.0, flatness * scale * sphere.points[:, 2].max()]])
    triangles = sphere.faces.reshape(-1, 4)[:, :0:-1]
    cells = np.column_stack([triangles, np.full(len(triangles), len(points) - 1)])
    return Raw(points.astype(np.float64), cells.astype(np.int64), {"version": "0", "seconds": 0.0})


def dented() -> Raw:
    """Add a vertex just inside one triangle: one flat and three narrow tetrahedra."""
    good = filled(1.0, 0.0)
    a, b, c, middle = good.tetrahedra[0]
    low = good.points[[a, b, c]].mean(axis=0)
    points = np.vstack([good.points, 0.999 * low + 0.001 * good.points[middle]])
    new = len(good.points)
    cells = np.vstack(
        [good.tetrahedra[1:], [[a, b, c, new], [a, b, new, middle], [b, c, new, middle], [c, a, new, middle]]]
    )
    return Raw(points, cells, good.summary)


Attempts = list[Raw | StageError]


class Asked(NamedTuple):
    """Settings of fTetWild in each attempt."""

    envelopes: list[float]
    """Relative to that of the first attempt."""
    stop_energies: list[float]


def attempt(attempts: Attempts) -> Raw:
    """Return the next result, or raise the next error."""
    result = attempts.pop(0)
    if isinstance(result, StageError):
        raise result
    return result


def program(
    folder: Path, monkeypatch: pytest.MonkeyPatch, hxt: Attempts, ftetwild: Attempts, *words: str
) -> tuple[dict, Asked, np.ndarray]:
    """Run the stage on a ball; return results, settings and points (none on failure)."""
    sphere = ball()
    sphere.save(folder / "ball.vtp")
    asked: list[Job] = []

    def run(runner: Runner, worker: Worker, job: Job, **_: object) -> Raw:
        runner.log.touch()
        if worker is not tetwild.WORKER:
            return attempt(hxt)
        asked.append(job)
        return attempt(ftetwild)

    monkeypatch.setattr(Runner, "run", run)
    monkeypatch.chdir(folder)
    options = ("-o", "ball.vtu", "--report", "r.json", "--solve", "no", "--max-volume-change", "20", *words)
    code = cli.main(["ball.vtp", *options])
    results = json.loads((folder / "r.json").read_text())["results"]
    points = np.empty((0, 3)) if code == 2 else tetrahedra(folder / "ball.vtu")[0]
    envelopes = [job["epsilon"] / asked[0]["epsilon"] for job in asked]
    return results["tetrahedralizer"], Asked(envelopes, [job["stop_energy"] for job in asked]), points


FLAT = 0.9999
"""Flatness at which the tetrahedra at the top of the ball are flat."""


@pytest.fixture
def no_mending(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let no tetrahedron get better by mending."""
    monkeypatch.setattr(fill, "mend", lambda *_: None)


@pytest.mark.usefixtures("no_mending")
@pytest.mark.parametrize(("most", "method"), [(20_000, "ftetwild"), (10, "hxt")])
def test_ftetwild_fills_small_surfaces_that_hxt_fills_with_flat_tetrahedra(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, most: int, method: str
) -> None:
    monkeypatch.setattr(fill, "MAX_FTETWILD_VERTICES", 5)
    monkeypatch.setattr(fill, "MAX_SECOND_TRY_VERTICES", most)
    told, asked, points = program(tmp_path, monkeypatch, [filled(1.0, FLAT)], [filled(1.0, 0.0)])
    assert told["method"] == method
    assert [attempt["method"] for attempt in told["attempts"]] == ["hxt", "ftetwild"][: 1 + len(asked.envelopes)]
    assert ("miss a limit of shape" in told["reason"]) == (method == "ftetwild")
    assert (abs(points[-1, 2]) < 1e-9) == (method == "ftetwild")


def test_single_flat_tetrahedra_of_hxt_are_mended_and_ftetwild_is_left_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(fill, "MAX_FTETWILD_VERTICES", 5)
    told, asked, _ = program(tmp_path, monkeypatch, [dented()], [])
    assert told["method"] == "hxt"
    assert "miss a limit" not in told["reason"]
    assert asked.envelopes == []
    before, after = told["attempts"]
    assert before["min_scaled_jacobian"] < 0.01
    assert after["min_scaled_jacobian"] > 0.05
    assert (after["mended"]["below_before"], after["mended"]["below_after"]) == (4, 0)


@pytest.mark.usefixtures("no_mending")
@pytest.mark.parametrize("hxt", [[], [filled(1.0, FLAT)]])
def test_ftetwild_takes_more_patience_while_a_limit_of_shape_is_missed_after_hxt_too(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, hxt: Attempts
) -> None:
    if hxt:
        monkeypatch.setattr(fill, "MAX_FTETWILD_VERTICES", 5)
    told, asked, points = program(
        tmp_path, monkeypatch, list(hxt), [filled(1.0, FLAT), filled(1.0, FLAT), filled(1.0, 0.0)]
    )
    assert asked.stop_energies == list(fill.STOP_ENERGIES)
    assert asked.envelopes == [1.0] * len(fill.STOP_ENERGIES)
    assert [attempt["method"] for attempt in told["attempts"]] == ["hxt"] * len(hxt) + ["ftetwild"] * 3
    assert abs(points[-1, 2]) < 1e-9


@pytest.mark.usefixtures("no_mending")
def test_what_hxt_made_is_kept_where_ftetwild_does_no_better(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(fill, "MAX_FTETWILD_VERTICES", 5)
    told, asked, points = program(tmp_path, monkeypatch, [filled(1.0, FLAT)], [filled(1.2, 0.0)] * len(fill.ENVELOPES))
    assert told["method"] == "hxt"
    assert told["reason"].endswith("and the result of fTetWild is not better")
    assert asked.envelopes == list(fill.ENVELOPES)
    assert points[-1, 2] > 1.0


def test_a_distant_boundary_leads_to_a_smaller_envelope(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    told, asked, points = program(tmp_path, monkeypatch, [], [filled(1.05, 0.0), filled(1.0, 0.1)])
    assert asked.envelopes == [1.0, 0.5]
    assert told["method"] == "ftetwild"
    assert [attempt["max_distance"] > 0.01 for attempt in told["attempts"]] == [True, False]
    assert points[:, 0].max() == pytest.approx(pv.PolyData(ball().points).bounds[1])


NO_LUCK = StageError("no luck", "there is no mesh", "try again")


@pytest.mark.usefixtures("no_mending")
def test_what_hxt_made_is_kept_where_ftetwild_fails(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(fill, "MAX_FTETWILD_VERTICES", 5)
    told, _, points = program(tmp_path, monkeypatch, [filled(1.0, FLAT)], [NO_LUCK])
    assert told["method"] == "hxt"
    assert points[-1, 2] > 1.0


def test_the_report_tells_who_failed_last(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(fill, "MAX_FTETWILD_VERTICES", 5)
    told, _, points = program(tmp_path, monkeypatch, [NO_LUCK], [NO_LUCK])
    assert told["method"] == "ftetwild"
    assert len(points) == 0


FULL = OSError(errno.ENOSPC, "No space left on device")


def test_a_full_folder_of_temporary_files_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    ball().save(tmp_path / "ball.vtp")
    (tmp_path / "full").mkdir()
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path / "full"))

    def no_room(*_arguments: object, **_more: object) -> None:
        raise FULL

    words = [str(tmp_path / "ball.vtp"), "-o", str(tmp_path / "ball.vtu"), "--solve", "no", "-q"]
    monkeypatch.setattr("tetmesh_check.tets.worker.np.savez", no_room)
    assert cli.main(words) == 2
    said = capfd.readouterr().err
    assert f"{tmp_path / 'full'}: cannot store temporary files: No space left on device" in said
    assert "TMPDIR" in said
    assert "ball.vtu" not in said


def test_a_worker_without_room_for_its_result_blames_the_temporary_folder(
    tmp_path: Path, run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    ball().save(tmp_path / "ball.vtp")
    code = "def tetrahedralize(*_, **__): raise OSError(28, 'No space left on device')\n"
    fake_library(tmp_path, monkeypatch, "pytetwild", code)
    done = run("ball.vtp", "-o", "ball.vtu")
    assert done.returncode == 2
    assert f"{tmp_path}: cannot store temporary files: No space left on device" in done.stderr


@pytest.mark.parametrize("size", [1e-7, 1.0, 1e5])
def test_surfaces_of_any_size_are_filled_alike(tmp_path: Path, run: Run, size: float) -> None:
    ball(10.0 * size, 3).save(tmp_path / "ball.vtp")
    done = run("ball.vtp", "-o", "ball.vtu", "--solve", "no", "--method", "ftetwild", "--report", "r.json")
    assert done.returncode == 0, done.stderr
    results = json.loads((tmp_path / "r.json").read_text())["results"]
    exact = ball(10.0, 3).volume * size**3
    assert results["volume"]["volume_mm3"] == pytest.approx(exact, rel=0.01)
    assert results["distance_mm"]["boundary_to_surface"]["max"] < 0.1 * size
    assert 10_000 < results["volume"]["tetrahedra"] < 40_000


def test_the_scale_for_tetrahedralizers_is_exact_and_spares_usual_boxes() -> None:
    for diagonal in (1.0, 30.0, 1000.0):
        assert scale_of(np.array([[0.0, 0.0, 0.0], [0.0, 0.0, diagonal]])) == 1.0
    for diagonal in (1e-9, 0.99, 1001.0, 1e9):
        scale = scale_of(np.array([[0.0, 0.0, 0.0], [0.0, 0.0, diagonal]]))
        assert np.frexp(scale)[0] == 0.5
        assert 50.0 < scale * diagonal < 200.0
