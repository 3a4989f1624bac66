"""Surfaces and size fields that the tests share."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import pyvista as pv
from isoparticles._native import Context

from tetmesh_check.cli import build_parser
from tetmesh_check.report.page import program
from tetmesh_check.report.page.scan import Scan


def _is_there(library: str) -> bool:
    """Return whether a library can be imported; another process tries it, this one never does."""
    return subprocess.run([sys.executable, "-c", f"import {library}"], capture_output=True, check=False).returncode == 0


NEEDS_HXT = pytest.mark.skipif(not _is_there("gmsh"), reason="Gmsh (HXT) is not installed: see setup-env.sh --help")
NEEDS_TETGEN = pytest.mark.skipif(
    not _is_there("tetgen"), reason="TetGen (AGPL) is not installed: see requirements-tetgen.lock"
)

_HANDLERS = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)}

Run = Callable[..., subprocess.CompletedProcess[str]]


@pytest.fixture(autouse=True)
def _signals() -> Iterator[None]:
    """Restore the signal handlers, which the programs set for their whole process."""
    yield
    for number, handler in _HANDLERS.items():
        signal.signal(number, handler)


def ball(radius: float = 10.0, subdivisions: int = 2) -> pv.PolyData:
    """Return an outward-oriented icosphere in double precision."""
    surface = pv.Icosphere(radius=radius, nsub=subdivisions)
    surface.points = np.asarray(surface.points, dtype=np.float64)
    surface.clear_data()
    return surface


def write_sizing(path: Path, h: Callable[[np.ndarray], np.ndarray], half_width: int = 12) -> Path:
    """Write a size field on a 1 mm grid around the origin; ``h`` maps positions to edge lengths."""
    count = 2 * half_width + 1
    grid = pv.ImageData(dimensions=(count,) * 3, origin=(-half_width,) * 3)
    grid["sizing"] = np.asarray(h(np.asarray(grid.points, dtype=float)), dtype=np.float32)
    grid.add_field_data(['{"tool": "sizefield", "version": "0"}'], "history")
    grid.save(path)
    return path


def write_nrrd(path: Path, values: np.ndarray, **fields: str) -> Path:
    """Write a volume as raw NRRD with these header fields; ``_`` in a name stands for a blank."""
    kind = {"float64": "double", "float32": "float"}.get(values.dtype.name, values.dtype.name)
    lines = ["NRRD0004", f"type: {kind}", f"dimension: {values.ndim}", f"sizes: {' '.join(map(str, values.shape))}"]
    lines += ["encoding: raw", "endian: little", *(f"{key.replace('_', ' ')}: {text}" for key, text in fields.items())]
    path.write_bytes("\n".join([*lines, "", ""]).encode() + values.astype(values.dtype.newbyteorder("<")).tobytes("F"))
    return path


def merged(*surfaces: pv.PolyData) -> pv.PolyData:
    """Merge surfaces into one."""
    points, triangles, shift = [], [], 0
    for surface in surfaces:
        points.append(np.asarray(surface.points))
        triangles.append(np.asarray(surface.faces).reshape(-1, 4)[:, 1:] + shift)
        shift += surface.n_points
    faces = np.concatenate(triangles)
    return pv.PolyData(np.concatenate(points), np.hstack([np.full((len(faces), 1), 3), faces]).ravel())


def reversed_winding(surface: pv.PolyData) -> pv.PolyData:
    """Return the surface with all triangles reversed."""
    faces = np.asarray(surface.faces).reshape(-1, 4)[:, [0, 1, 3, 2]]
    return pv.PolyData(np.asarray(surface.points), faces.ravel())


def tetrahedra(path: Path) -> tuple[np.ndarray, np.ndarray, pv.UnstructuredGrid]:
    """Read a volume mesh; return points, tetrahedra and the whole grid."""
    grid = pv.read(path)
    return np.asarray(grid.points), np.asarray(grid.cells_dict[10]).astype(np.int64), grid


def fake_library(folder: Path, monkeypatch: pytest.MonkeyPatch, name: str, code: str) -> None:
    """Make new processes import this code in place of a library."""
    (folder / "fake").mkdir(exist_ok=True)
    (folder / "fake" / f"{name}.py").write_text(code)
    monkeypatch.setenv("PYTHONPATH", str(folder / "fake"), prepend=os.pathsep)
    monkeypatch.setenv("PYTHONDONTWRITEBYTECODE", "1")


def quiet_context(*options: str) -> Context:
    """Return the context of a run with these options, which prints only warnings."""
    words = ["s.vtp", "-o", "v.vtu", "-q", *options]
    return Context(words, build_parser().parse_args(words))


@pytest.fixture
def run(tmp_path: Path) -> Run:
    """Return a function that runs the program, with all files in the test's folder."""

    def call(*words: object, timeout: float = 60) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            [sys.executable, "-m", "tetmesh_check", *map(str, words)],
            cwd=tmp_path,
            env={**os.environ, "TMPDIR": str(tmp_path)},
            capture_output=True,
            text=True,
            timeout=timeout,
            check=False,
        )

    return call


def write_status(folder: Path, name: str, **changes: Any) -> Path:
    """Write the status of a case as make does, from the reports in its folder.

    Parameters
    ----------
    folder, name
        Folder and name of the case.
    changes
        Entries to replace, such as ``verdict="failed"``; ``stages`` maps stages to changed entries.
    """
    made = {
        "distfield": ["distfield.vti"], "sizefield": ["sizefield.vti"], "seed": ["seeds.bin"],
        "particles": ["particles.bin", "passes.csv"], "reconstruct": ["surface.vtp"],
        "tetmesh-check": ["volume.vtu", "report.json", "tetrahedra.log"],
    }  # fmt: skip
    entries = []
    differing = changes.pop("stages", {})
    for stage, endings in made.items():
        own = f"{name}.report.json" if stage == "tetmesh-check" else f"reports/{stage}.json"
        report = json.loads((folder / own).read_text()) if (folder / own).is_file() else None
        entry: dict[str, Any] = {
            "stage": stage, "state": "done", "made": True, "exit_code": 0, "seconds": 1.5, "command": f"{stage} --some options",
            "report": own if report else None, "outputs": [f"{name}.{ending}" for ending in endings], "kept": [],
            "warnings": report["warnings"] if report else [], "failed_checks": report["failed_checks"] if report else [], "error": None,
        }  # fmt: skip
        entries.append({**entry, **differing.get(stage, {})})
    drawn = [f"pictures/{path.name}" for path in sorted(folder.glob("pictures/*.png"))]
    entries[-1]["outputs"] = [*entries[-1]["outputs"], *drawn]
    warned = any(entry["warnings"] for entry in entries)
    status = {
        "format": "isoparticles-status", "version": 1, "name": name, "goal": "mesh", "verdict": "warning" if warned else "passed",
        "headline": "as make says it", "inputs": [{"role": "volume", "path": "/data/scan <1>.nrrd", "bytes": 1234, "hash": "c0ffee"}],
        "parameters": {"ISO": "100", "SIZE": "2.5"}, "stages": entries, "page": f"{name}.report.html", **changes,
    }  # fmt: skip
    path = folder / f"{name}.status.json"
    path.write_text(json.dumps(status))
    return path


@pytest.fixture(scope="session")
def case(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of a meshed ball as make leaves it; its name needs escaping in HTML."""
    folder = tmp_path_factory.mktemp("cases") / "a&b"
    (folder / "reports").mkdir(parents=True)
    surface = ball(subdivisions=3)
    surface.cell_data["deviation"] = 10.0 - np.linalg.norm(surface.cell_centers().points, axis=1)
    surface.add_field_data(['"Lps"'], "space")
    surface.save(folder / "a&b.surface.vtp")
    write_sizing(folder / "a&b.sizefield.vti", lambda world: np.where(world[:, 0] < 0, 1.5, 3.0))
    words = ["a&b.surface.vtp", "--sizefield", "a&b.sizefield.vti", "-o", "a&b.volume.vtu", "--max-passes", "3"]
    command = ["-m", "tetmesh_check", *words, "--report", "a&b.report.json", "--pictures", "pictures", "-q"]
    subprocess.run([sys.executable, *command], cwd=folder, check=True, timeout=120)
    report = json.loads((folder / "a&b.report.json").read_text())
    stage = {**report, "tool": "particles", "results": {}, "warnings": ["a <strange> thing"], "failed_checks": []}
    (folder / "reports" / "particles.json").write_text(json.dumps(stage))
    lines = ["pass,energy,count"] + [f"{k},{1000 / k + 500},{900 + k}" for k in range(1, 20)]
    (folder / "a&b.passes.csv").write_text("\n".join(lines) + "\n")
    write_status(folder, "a&b")
    return folder


def volume_with_ball(directions: np.ndarray | None = None, labels: bool = False) -> Scan:
    """Return a volume of 40 x 36 x 30 voxels that contains the ball of the case.

    Parameters
    ----------
    directions
        World vectors of the grid axes, mm, one per column; by default 1 mm along LPS.
    labels
        Whether the ball is label 2 in a label map, or bright in a scan with noise.
    """
    step = np.eye(3) if directions is None else np.asarray(directions, dtype=float)
    shape = (40, 36, 30)
    origin = -step @ np.array([18.0, 17.0, 14.0])
    index = np.stack(np.meshgrid(*(np.arange(n) for n in shape), indexing="ij"), axis=-1)
    inside = np.linalg.norm(index @ step.T + origin, axis=-1) < 10.0
    if labels:
        values = np.where(inside, 2, 0).astype(np.uint8)
        values[:, :, :2] = 1
        return Scan(values, step, origin, True, {2: "a <ball>"}, labels=True)
    noise = np.random.default_rng(1).normal(0.0, 5.0, shape)
    return Scan((np.where(inside, 200.0, 20.0) + noise).astype(np.int16), step, origin, True)


@pytest.fixture(scope="session")
def page(case: Path) -> Path:
    """Make the page of the case, with slices of a volume."""
    path = case / "a&b.report.html"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(program, "read_scan", lambda *_: volume_with_ball())
        assert program.main([str(case / "a&b.status.json"), "-o", str(path)]) == 0
    return path
