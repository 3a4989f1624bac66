"""The comparison with marching cubes, without its runs: what it prints, and how it ends."""

from __future__ import annotations

import importlib.util
import json
import subprocess
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
import pyvista as pv


@pytest.fixture
def bench() -> ModuleType:
    path = Path(__file__).parents[1] / "benches" / "marching_cubes.py"
    spec = importlib.util.spec_from_file_location("marching_cubes", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


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
    solved = {"jacobi": {"iterations": 30}, "plain": None}
    quality = {name: {"min": 0.5, "mean": 0.7} for name in ("radius_ratio", "min_dihedral")}
    results = {
        "surface": {"topology": {"vertices": 1}, "quality": quality},
        "volume": {"tetrahedra": 2, "quality": quality},
        "solve": {"poisson": solved, "conduction": {**solved, "plain": {"iterations": 1234, "condition": None}}},
    }

    def run(words: list[str], **_: object) -> None:
        if "marching-cubes" in words[-2]:
            Path(words[-2]).write_text(json.dumps({"error": None, "results": results}))

    monkeypatch.setattr(subprocess, "run", run)
    assert bench.main([str(tmp_path / "a"), "--work", str(work)]) == 2
    table = capsys.readouterr().out
    assert "| a | particles | ended without a report |" in table
    assert not old.exists()
    assert "| out of time / 30 (-) | 1,234 / 30 (-) | not solved |" in table
    assert pv.read(work / "a.marching-cubes.vtp").n_cells > 0
