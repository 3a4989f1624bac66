"""Tests of the comparison with marching cubes: its table and exit codes, with fake runs."""

from __future__ import annotations

import importlib.util
import json
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
import pyvista as pv
from conftest import ball


def load_bench(name: str) -> ModuleType:
    """Import a program from the folder of the benches."""
    path = Path(__file__).parents[1] / "benches" / f"{name}.py"
    spec = importlib.util.spec_from_file_location(name, path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module  # dataclasses look up their module there
    spec.loader.exec_module(module)
    return module


@pytest.fixture
def bench() -> ModuleType:
    return load_bench("marching_cubes")


def test_old_reports_and_missing_ones(
    bench: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "a").mkdir()
    grid = pv.ImageData(dimensions=(9,) * 3, origin=(-4,) * 3)
    grid["signed_distance"] = np.linalg.norm(grid.points, axis=1) - 2.5
    grid.save(tmp_path / "a" / "a.distfield.vti")
    work = tmp_path / "work"
    work.mkdir()
    old = work / "a.particles.report.json"
    old.write_text("{}")
    solved = {"unknowns": 77, "multigrid": {"iterations": 9, "converged": True}}
    stuck = {"multigrid": {"iterations": 1234, "converged": False}}
    quality = {name: {"min": 0.5, "mean": 0.7} for name in ("radius_ratio", "min_dihedral")}
    results = {
        "surface": {"topology": {"vertices": 1}, "quality": quality},
        "volume": {"tetrahedra": 2, "quality": quality},
        "solve": {"poisson": solved, "conduction": {**solved, **stuck}},
    }
    steps = [{"name": "tetrahedralize", "seconds": 2.0}]
    whole = {"error": None, "results": results, "exit_code": 1, "steps": steps}

    def run(words: list[str], **_: object) -> subprocess.CompletedProcess[str]:
        if words[1].endswith("remesh.py"):
            # the remesher was killed
            return subprocess.CompletedProcess(words, -11)
        if "marching-cubes" in words[-2]:
            Path(words[-2]).write_text(json.dumps(whole))
        return subprocess.CompletedProcess(words, 0)

    monkeypatch.setattr(subprocess, "run", run)
    ball(2.5).save(tmp_path / "a" / "a.surface.vtp")
    assert bench.main([str(tmp_path / "a"), "--work", str(work), "--remesher", "python"]) == 2
    table = capsys.readouterr().out
    assert "| a | particles | - | ended without a report |" in table
    assert "| a | remesh_botsch | - | the remesher failed (exit code -11) |" in table
    assert not old.exists()
    assert "| failed | 77; 9 | 77; stuck at 1,234 | not solved |" in table
    native, resampled = (pv.read(work / f"a.{kind}.vtp") for kind in bench.KINDS[1:3])
    assert abs(resampled.n_points - 162) < abs(native.n_points - 162)
    for surface in (native, resampled):
        assert surface.volume == pytest.approx(4.0 / 3.0 * np.pi * 2.5**3, rel=0.2)

    assert bench.main([str(tmp_path / "a"), "--work", str(work), "--surfaces", "marching-cubes"]) == 0
    said = capsys.readouterr()
    assert said.out.count("| a |") == 1
    assert "no remesher: skipped" in said.err
