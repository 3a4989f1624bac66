"""Tests of the command ``isoparticles``."""

from __future__ import annotations

import os
import subprocess
import sysconfig
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

EXE = sysconfig.get_config_var("EXE") or ""
Run = Callable[..., subprocess.CompletedProcess[str]]


@pytest.fixture
def run(site: Path, scripts: Path, tmp_path: Path) -> Run:
    environment = {name: value for name, value in os.environ.items() if not name.startswith("ISOPARTICLES")}
    environment["PYTHONPATH"] = str(site)

    def run(*words: str) -> subprocess.CompletedProcess[str]:
        command = [str(scripts / f"isoparticles{EXE}"), *words]
        return subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False)

    return run


def test_shells_and_man_know_every_goal(share: Path, run: Run) -> None:
    # Python defines the goals, and Rust defines the completions; the two lists must agree.
    told = run("no-such-goal").stderr
    goals = told.partition("choose one of ")[2].strip().split(", ")
    assert len(goals) > 12
    bash = (share / "bash-completion" / "completions" / "isoparticles").read_text()
    assert f'opts="-h -V --help --version {" ".join(sorted_as(goals, bash))} help"' in bash
    for folder, name in (("zsh/site-functions", "_isoparticles"), ("fish/vendor_completions.d", "isoparticles.fish")):
        text = (share / folder / name).read_text()
        assert not [goal for goal in goals if goal not in text]
        assert "min-size" in text
    pages = {page.stem for page in (share / "man" / "man1").glob("isoparticles*")}
    assert pages == {"isoparticles", *(f"isoparticles-{goal}" for goal in goals)}
    assert "min\\-size" in (share / "man" / "man1" / "isoparticles-mesh.1").read_text()
    assert "max\\-memory" in (share / "man" / "man1" / "isoparticles-distfield.1").read_text()
    for goal, word, whole in (
        ("mesh", "--bord", "--border"),
        ("distfield", "--max-m", "--max-memory"),
        ("tetmesh-check", "--tet-s", "--tet-size-factor"),
    ):
        words = f"COMP_WORDS=(isoparticles {goal} {word}); COMP_CWORD=2; _isoparticles isoparticles {word} {goal}"
        script = f'{bash}\n{words}; echo "${{COMPREPLY[@]}}"'
        done = subprocess.run(["bash", "-c", script], capture_output=True, text=True, check=True)
        assert done.stdout.strip() == whole


def sorted_as(words: list[str], text: str) -> list[str]:
    """Sort words by their first occurrence as separate words in a text."""
    return sorted(words, key=lambda word: text.index(f" {word} "))


def test_stages_run_by_themselves(run: Run, tmp_path: Path) -> None:
    assert (
        run("surface", "--phantom", "ball --size 24", "--iso", "0", "--name", "ball", "-o", "here", "-q").returncode
        == 0
    )
    done = run("reconstruct", "--help")
    assert done.returncode == 0
    assert "Usage: reconstruct" in done.stdout
    field = tmp_path / "here" / "ball" / "ball.distfield.vti"
    assert run("sizefield", str(field), "-o", "coarse.vti", "--uniform", "3", "-q").returncode == 0
    assert (tmp_path / "coarse.vti").is_file()
    assert run("tetmesh-check", "--version").stdout.startswith("tetmesh-check ")


def test_an_array_of_a_file_is_converted_once(run: Run, tmp_path: Path) -> None:
    h5py = pytest.importorskip("h5py")
    x, y, z = np.mgrid[:20, :20, :20] - 9.5
    with h5py.File(tmp_path / "scan.h5", "w") as file:
        file["volume"] = (10 * (8 - np.sqrt(x**2 + y**2 + z**2))).astype("f4").T
        file["other"] = np.zeros((4, 4, 4))
    words = ["distfield", "scan.h5", "--iso", "0"]
    assert "isoparticles-read" in run(*words, "-o", "f.vti").stderr
    words = ["surface", "scan.h5", "--iso", "0", "--size", "3", "--backend", "cpu", "-q"]
    assert "choose it as the dataset: /other, /volume" in run(*words).stderr
    words += ["--dataset", "/volume"]
    done = run(*words)
    assert done.returncode == 0, done.stderr
    assert "up to date: read, distfield" in run(*words).stdout
    assert "20 x 20 x 20" in run("info", "scan.h5", "--dataset", "/volume").stdout
    assert run("read", "scan.h5", "--dataset", "volume", "-o", "v.vti", "-q").returncode == 0
    assert "isoparticles read" in run("read", "scan.h5").stderr


def test_the_demo_runs_without_the_project(run: Run, tmp_path: Path) -> None:
    done = run("demo", "--min-size", "6", "NAME=small", "-o", "here", "-q")
    assert done.returncode == 0, done.stderr
    made = {file.name for file in (tmp_path / "here" / "small").iterdir()}
    assert {"small.surface.vtp", "small.volume.vtu", "small.report.html", "small.status.json"} <= made
    told = run("verdict", "small", "--out", "here")
    assert "small: passed" in told.stdout
    again = run("demo", "--min-size=6", "--name", "small", "OUT=here", "-q")
    assert again.returncode == 0
    assert (
        "up to date: phantom, distfield, sizefield, seed, particles, reconstruct, tetmesh-check"
        in again.stdout + again.stderr
    )
    assert run("clean", "small", "-o", "here").returncode == 0
    assert not (tmp_path / "here" / "small").exists()


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (("mesh",), "isoparticles mesh INPUT="),
        (("mesh", "none.nrrd", "--iso", "1"), "none.nrrd: not found"),
        (("mesh", "a.nrrd", "b.nrrd"), "a second INPUT"),
        (("mesh", "a.nrrd", "--lables", "1"), "did you mean LABELS? `isoparticles help` lists them"),
        (("mesh", "a.nrrd", "--labels"), "--labels: has no value"),
        (("mesh", __file__, "--iso", "1", "--dataset", "0"), "DATASET=0 is set, but the volume has no named arrays"),
        (("mehs", "a.nrrd"), "mehs: no such goal or stage"),
        (("batch",), "LIST is not set"),
    ],
)
def test_what_cannot_be_meant_is_said(run: Run, words: tuple[str, ...], told: str) -> None:
    done = run(*words)
    assert done.returncode == 2
    assert told in done.stderr
    assert "what to do: " in done.stderr


def test_help_names_every_option(run: Run) -> None:
    done = run("help")
    assert done.returncode == 0
    assert done.stdout == run("mesh", "--help").stdout == run("mesh", "a.nrrd", "--help").stdout
    for option in ("--labels", "--vertices", "--max-memory", "batch LIST.csv", "sizefield"):
        assert option in done.stdout
