"""Tests of the command line: output, refused input and exit codes."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import blake3
import numpy as np
import pytest
import pyvista as pv
from conftest import NEEDS_HXT, Run, ball, fake_library, tetrahedra, write_sizing
from isoparticles._native import Context

from tetmesh_check import cli, pipeline
from tetmesh_check.quality import signed_tetrahedron_volumes
from tetmesh_check.surface import history_of

METHODS = ["ftetwild", pytest.param("hxt", marks=NEEDS_HXT)]


def test_ball_with_graded_sizing(tmp_path: Path, run: Run) -> None:
    ball(subdivisions=3).save(tmp_path / "ball.surface.vtp")
    write_sizing(tmp_path / "ball.sizefield.vti", lambda world: np.where(world[:, 0] < 0, 1.5, 4.0))
    done = run(
        "ball.surface.vtp", "--sizefield", "ball.sizefield.vti", "-o", "ball.volume.vtu", "--report", "ball.report.json",
        "--max-passes", 10, "--progress", "lines",
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert done.stdout == ""
    assert "peak memory" in done.stderr
    points, cells, grid = tetrahedra(tmp_path / "ball.volume.vtu")
    assert points.dtype == np.float64
    volumes = signed_tetrahedron_volumes(points, cells)
    assert volumes.min() > 0
    # the tetrahedra must fill the volume enclosed by the surface to within the 1 % that the check
    # allows
    assert volumes.sum() == pytest.approx(pv.read(tmp_path / "ball.surface.vtp").volume, rel=0.01)
    left = points[cells].mean(axis=1)[:, 0] < 0
    # The volume of a tetrahedron is proportional to the cube of the edge length. The surface
    # triangles have the same size in both halves, so the ratio of the numbers of tetrahedra stays
    # far below (4 / 1.5)^3.
    assert left.sum() > 2.0 * (~left).sum()

    assert set(grid.cell_data.keys()) == {"radius_ratio", "scaled_jacobian", "min_dihedral", "region"}
    history = history_of(grid)
    assert history["tool"] == "tetmesh-check"
    assert history["inputs"][1]["history"]["tool"] == "sizefield"
    assert history["inputs"][0]["blake3"] == blake3.blake3((tmp_path / "ball.surface.vtp").read_bytes()).hexdigest()
    assert history["parameters"]["envelope"] == pytest.approx(0.05 * 1.5, rel=0.05)
    assert "ball.report.json" not in history["command_line"]

    report = json.loads((tmp_path / "ball.report.json").read_text())
    assert set(report) == {
        "tool", "version", "command_line", "parameters", "inputs", "threads", "seconds", "steps", "peak_memory_bytes",
        "warnings", "outcome", "exit_code", "failed_checks", "error", "results",
    }  # fmt: skip
    assert (report["outcome"], report["exit_code"], report["failed_checks"]) == ("passed", 0, [])
    results = report["results"]
    assert set(results) == {
        "surface", "sizing", "tetrahedralizer", "volume", "volumes", "distance_mm", "solve", "boundary", "exports", "checks",
    }  # fmt: skip
    assert results["volume"]["tetrahedra"] == len(cells)
    assert results["tetrahedralizer"]["method"] == history["parameters"]["method"] == "ftetwild"
    assert "642 vertices" in results["tetrahedralizer"]["reason"]
    assert len(results["tetrahedralizer"]["attempts"]) == 1
    assert sum(results["volume"]["quality"]["radius_ratio"]["histogram"]["counts"]) == len(cells)
    assert results["volume"]["edge_length_over_target"]["median"] == pytest.approx(1.0, abs=0.25)
    assert results["distance_mm"]["boundary_to_surface"]["max"] <= history["parameters"]["envelope"]
    assert {check["name"]: check["verdict"] for check in results["checks"]} == dict.fromkeys(
        [
            "positive_volumes", "min_dihedral", "min_scaled_jacobian", "volume_change", "bodies", "boundary_distance",
            "surface_distance", "boundary_manifold", "euler_characteristic", "solve_converged",
        ],
        "pass",
    )  # fmt: skip
    assert (tmp_path / "ball.tetrahedra.log").stat().st_size > 0
    assert not list(tmp_path.glob(".*"))


def test_existing_output_is_kept_and_failed_checks_are_told(tmp_path: Path, run: Run) -> None:
    ball().save(tmp_path / "ball.vtp")
    (tmp_path / "out.vtu").write_text("precious")
    refused = run("ball.vtp", "-o", "out.vtu")
    assert refused.returncode == 2
    assert "--force" in refused.stderr
    assert (tmp_path / "out.vtu").read_text() == "precious"
    assert not (tmp_path / "out.tetrahedra.log").exists()

    forced = run(
        "ball.vtp", "-o", "out.vtu", "--force", "--min-dihedral", 69, "--report", "r.json", "--max-passes", 5, "-q"
    )
    assert forced.returncode == 1, forced.stderr
    assert "check failed: the minimum dihedral angle" in forced.stderr
    assert "warning: no --sizefield" in forced.stderr
    report = json.loads((tmp_path / "r.json").read_text())
    assert (report["outcome"], report["exit_code"]) == ("checks_failed", 1)
    assert len(report["failed_checks"]) == 1
    # the limit was not reached, so fTetWild ran again with lower stop energies
    assert [attempt["stop_energy"] for attempt in report["results"]["tetrahedralizer"]["attempts"]] == [
        1000.0,
        30.0,
        10.0,
    ]
    assert tetrahedra(tmp_path / "out.vtu")[1].shape[1] == 4


def test_inputs_are_never_replaced(tmp_path: Path, run: Run) -> None:
    ball().save(tmp_path / "ball.vtp")
    before = (tmp_path / "ball.vtp").read_bytes()
    (tmp_path / "same.vtu").symlink_to("ball.vtp")
    for words, told in (
        (["-o", "same.vtu", "--force"], "error: ball.vtp: is both an input and an output\n"),
        (["-o", "v.vtu", "--report", "ball.vtp"], "error: ball.vtp: cannot be used for the report\n"),
        (["-o", "v.vtu", "--report", "v.vtu"], "error: v.vtu: cannot be used for the report\n"),
    ):
        done = run("ball.vtp", *words)
        assert done.returncode == 2, done.stderr
        assert done.stderr.startswith(told)
        why = "the input would be replaced" if "--force" in words else "the report would replace an output, or a file"
        assert f"why it matters: {why}" in done.stderr
        assert (tmp_path / "ball.vtp").read_bytes() == before
        assert not (tmp_path / "v.vtu").exists()


def test_pictures(tmp_path: Path, run: Run) -> None:
    ball().save(tmp_path / "ball.vtp")
    done = run("ball.vtp", "-o", "ball.volume.vtu", "--max-passes", 3, "--pictures", "pictures", "--report", "r.json")
    assert done.returncode == 0, done.stderr
    pictures = json.loads((tmp_path / "r.json").read_text())["results"]["pictures"]
    if pictures["skipped"]:
        assert "apt-get install" in done.stderr
        pytest.skip(f"no renderer here: {pictures['skipped']}")
    assert pictures["drawn"] == [f"ball.{name}.png" for name in ("surface", "closeup", "cut")]
    for name in pictures["drawn"]:
        pixels = np.asarray(pv.read(tmp_path / "pictures" / name).point_data.active_scalars)
        assert pixels.std() > 10  # no blank sheet
    again = run(
        "ball.vtp",
        "-o",
        "other.volume.vtu",
        "--pictures",
        "pictures",
        "--max-passes",
        3,
        "-q",
        "--report",
        "pictures/x.json",
    )
    assert again.returncode == 0


def test_no_renderer_is_a_warning(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, run: Run) -> None:
    from tetmesh_check.report import pictures, rendering

    monkeypatch.setattr(rendering, "_PROBE", "raise SystemExit(1)")
    with pytest.raises(SystemExit, match="libosmesa6"):
        pictures.main("b.vtp", "b.vtu", "cut=b.cut.png")
    # a process that draws nothing
    ball().save(tmp_path / "ball.vtp")
    (tmp_path / "pictures").write_text("a file")
    done = run("ball.vtp", "-o", "ball.volume.vtu", "--max-passes", 3, "--pictures", "pictures", "--report", "r.json")
    assert done.returncode == 0
    assert "pictures skipped (surface, closeup, cut): " in done.stderr
    skipped = json.loads((tmp_path / "r.json").read_text())["results"]["pictures"]["skipped"]
    assert set(skipped) == {"surface", "closeup", "cut"}


def worker_processes(folder: Path) -> list[str]:
    """Return the running tetrahedralizers with a job in the folder (Linux)."""
    found = []
    for entry in Path("/proc").glob("[0-9]*/cmdline"):
        try:
            words = entry.read_bytes().decode(errors="replace")
        except OSError:  # it ended in the meantime
            continue
        if "tetmesh_check.tets." in words and str(folder) in words:
            found.append(words)
    return found


@pytest.mark.parametrize("method", METHODS)
def test_time_limit_ends_the_tetrahedralizer(tmp_path: Path, run: Run, method: str) -> None:
    ball(subdivisions=3).save(tmp_path / "ball.vtp")
    write_sizing(tmp_path / "fine.vti", lambda world: np.full(len(world), 0.15))
    started = time.monotonic()
    done = run(
        "ball.vtp", "--sizefield", "fine.vti", "-o", "ball.vtu", "--method", method, "--max-seconds", 2, "--report", "r.json"
    )  # fmt: skip
    assert done.returncode == 2
    assert "stopped after 2 s" in done.stderr
    assert "--max-seconds" in done.stderr
    assert time.monotonic() - started < 45
    assert not (tmp_path / "ball.vtu").exists()
    assert (tmp_path / "ball.tetrahedra.log").exists()
    assert json.loads((tmp_path / "r.json").read_text())["outcome"] == "error"
    assert not worker_processes(tmp_path)


@pytest.mark.parametrize(
    ("number", "method"),
    [(signal.SIGINT, "ftetwild"), (signal.SIGTERM, "ftetwild"), pytest.param(signal.SIGINT, "hxt", marks=NEEDS_HXT)],
)
def test_interrupt_ends_everything(tmp_path: Path, number: signal.Signals, method: str) -> None:
    ball(subdivisions=3).save(tmp_path / "ball.vtp")
    write_sizing(tmp_path / "fine.vti", lambda world: np.full(len(world), 0.15))
    words = [
        "ball.vtp",
        "--method",
        method,
        "--sizefield",
        "fine.vti",
        "-o",
        "ball.vtu",
        "--report",
        "r.json",
        "--progress",
        "none",
    ]
    environment = {**os.environ, "TMPDIR": str(tmp_path)}
    process = subprocess.Popen(
        [sys.executable, "-m", "tetmesh_check", *words],
        cwd=tmp_path,
        stderr=subprocess.PIPE,
        text=True,
        env=environment,
    )
    log = tmp_path / "ball.tetrahedra.log"
    while not (log.exists() and log.stat().st_size > 0):
        assert process.poll() is None
        time.sleep(0.05)
    assert worker_processes(tmp_path) or not Path("/proc/self/cmdline").exists()
    process.send_signal(number)
    _, stderr = process.communicate(timeout=30)
    assert process.returncode == 130, stderr
    assert "interrupted" in stderr
    assert "Traceback" not in stderr
    assert json.loads((tmp_path / "r.json").read_text())["outcome"] == "interrupted"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["ball.tetrahedra.log", "ball.vtp", "fine.vti", "r.json"]
    assert not worker_processes(tmp_path)


def test_an_interrupt_during_the_solves_leaves_the_mesh(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    ball().save(tmp_path / "ball.vtp")

    def interrupted(*_: object) -> None:
        os.kill(os.getpid(), signal.SIGINT)
        time.sleep(5)

    monkeypatch.setattr(pipeline, "solve_on", interrupted)
    output, report = tmp_path / "ball.volume.vtu", tmp_path / "r.json"
    words = [tmp_path / "ball.vtp", "-o", output, "--report", report, "--export", "vtp", "--max-passes", 3, "-q"]
    assert cli.main([str(word) for word in words]) == 130
    assert json.loads(report.read_text())["outcome"] == "interrupted"
    assert len(tetrahedra(output)[1]) == json.loads(report.read_text())["results"]["volume"]["tetrahedra"]
    assert (tmp_path / "ball.boundary.vtp").exists()
    assert not list(tmp_path.glob(".*"))


@pytest.mark.parametrize("method", ["ftetwild", "hxt"])
def test_crash_of_the_tetrahedralizer_is_reported(
    tmp_path: Path, run: Run, monkeypatch: pytest.MonkeyPatch, method: str
) -> None:
    ball().save(tmp_path / "ball.vtp")
    library, function = {"ftetwild": ("pytetwild", "tetrahedralize"), "hxt": ("gmsh", "initialize")}[method]
    fake_library(tmp_path, monkeypatch, library, f"import os\ndef {function}(*a, **k): os.kill(os.getpid(), 11)\n")
    done = run("ball.vtp", "-o", "ball.vtu", "--method", method)
    assert done.returncode == 2
    assert "crashed: SIGSEGV" in done.stderr
    fake_library(tmp_path, monkeypatch, library, f"def {function}(*a, **k): raise RuntimeError('no luck')\n")
    done = run("ball.vtp", "-o", "ball.vtu", "--method", method)
    assert done.returncode == 2
    assert "no luck" in done.stderr
    assert not (tmp_path / "ball.vtu").exists()


@pytest.mark.parametrize(
    "words",
    [
        [],
        ["a.vtp"],
        ["a.vtp", "-o", "b.vtk"],
        ["a.vtp", "-o", "no/such/folder/b.vtu"],
        ["a.vtp", "-o", "b.vtu", "--envelope", "0"],
        ["a.vtp", "-o", "b.vtu", "--tet-size-factor", "nan"],
        ["a.vtp", "-o", "b.vtu", "--threads", "-1"],
        ["a.vtp", "-o", "b.vtu", "-v", "-q"],
        ["a.vtp", "-o", "b.vtu", "--forc"],
        ["a.vtp", "-o", "b.vtu", "--method", "delaunay"],
        ["a.vtp", "-o", "b.vtu", "--export", "inp,stl"],
        ["a.vtp", "-o", "b.vtu"],
    ],
)
def test_bad_usage(words: list[str], run: Run) -> None:
    done = run(*words)
    assert done.returncode == 2
    assert "what to do" in done.stderr
    assert "Traceback" not in done.stderr


def test_help_and_version(run: Run) -> None:
    shown = run("--help")
    assert shown.returncode == 0
    for option in (
        "--sizefield",
        "--force",
        "--threads",
        "--max-memory",
        "--seed",
        "--report",
        "--progress",
        "--quiet",
        "--verbose",
        "mm",
    ):
        assert option in shown.stdout
    version = run("--version")
    assert version.stdout.startswith("tetmesh-check ")


def test_the_command_line_is_told_to_the_command_that_calls_this_stage(run: Run) -> None:
    told = json.loads(run("--command-line").stdout)
    assert told["name"] == "tetmesh-check"
    options = {option["long"]: option for option in told["options"]}
    shown = run("--help").stdout
    assert all(f"--{name}" in shown for name in options)
    assert not {"help", "version"} & set(options)
    assert (options["output"]["is_path"], options["output"]["short"]) == (True, "o")
    assert options["method"]["words"] == ["auto", "ftetwild", "hxt", "tetgen"]
    assert options["force"]["value"] is None
    assert options["seed"]["value"]
    assert "%" not in options["unit"]["help"]


ONE = {"materials": [], "volume": True}
MANY = {"materials": ["outside", "heart", "lungs"], "volume": True}
UNKNOWN = {"materials": None, "volume": False}


@pytest.mark.parametrize(
    ("known", "options", "told"),
    [
        (ONE, "--export stl,feb", "'stl' is not one of inp"),
        (ONE, "--min-dihedral 90", "--min-dihedral"),
        (ONE, "--order 2 --distfield f.vti --export carp", "--export carp with --order 2"),
        (ONE, "--labels-volume nowhere.nrrd", "nowhere.nrrd: cannot read"),
        (ONE, "--density nowhere.nrrd --calibrate 1,0 --law keller", "nowhere.nrrd: cannot read"),
        (ONE, "--density ct.nrrd --calibrate 1,0 --law hooke", "nor one of vertebra"),
        (ONE, "--source heart", "that of one object"),
        (MANY, "--source haert", "'haert' is not a material of the surface: heart, lungs"),
        (MANY, "--method ftetwild", "supports one object only"),
        (UNKNOWN, "--conductivity heart=2 --no-such-option", "--no-such-option"),
        (UNKNOWN, "--source haert", None),
        pytest.param(MANY, "--source heart --conductivity lungs=0.2", None, marks=NEEDS_HXT),
        (ONE, "--export feb", None),
    ],
)
def test_options_are_checked_without_files(
    tmp_path: Path, run: Run, known: dict[str, object], options: str, told: str | None
) -> None:
    word = json.dumps(known)
    checked = run("--check-options", word, "s.surface.vtp", "-o", "s.volume.vtu", *options.split())
    if told is None:
        assert (checked.returncode, json.loads(checked.stdout)) == (0, known), checked.stderr
    else:
        assert checked.returncode == 2
        assert checked.stderr.startswith("error: ")
        assert told in checked.stderr
        assert "what to do" in checked.stderr
    assert not list(tmp_path.iterdir())


def test_command_line_of_the_history_does_not_depend_on_folders() -> None:
    def told(*words: str) -> str:
        context = Context(list(words), cli.build_parser().parse_args(words))
        assert context.parameters == {"seed": 3}
        line: str = context.history()["command_line"]
        return line

    first = told("/a/s.vtp", "-o", "/a/v.vtu", "-vv", "--threads=4", "--force", "--seed", "3", "--export", "inp")
    second = told("s.vtp", "-o", "w.vtu", "--seed", "3", "--report", "r.json", "--max-seconds=5")
    assert first == second == "tetmesh-check s.vtp -o OUTPUT --seed 3"
