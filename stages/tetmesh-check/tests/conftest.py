"""Surfaces and size fields that the tests share."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import pyvista as pv


def _is_there(library: str) -> bool:
    """Whether a library can be imported, tried in another process because it is never imported into this one."""
    return subprocess.run([sys.executable, "-c", f"import {library}"], capture_output=True, check=False).returncode == 0


NEEDS_HXT = pytest.mark.skipif(not _is_there("gmsh"), reason="Gmsh (HXT) is not installed: see setup-env.sh --help")
NEEDS_TETGEN = pytest.mark.skipif(
    not _is_there("tetgen"), reason="TetGen (AGPL) is not installed: see requirements-tetgen.lock"
)

_BUILT = Path(__file__).parents[3] / "target" / "release"
# volumes are read by distfield; `make test-python` builds it first
os.environ.setdefault("ISOPARTICLES_BIN", str(_BUILT))
NEEDS_DISTFIELD = pytest.mark.skipif(
    shutil.which("distfield", path=os.environ["ISOPARTICLES_BIN"]) is None,
    reason="distfield is not built: cargo build --release, or name its folder in ISOPARTICLES_BIN",
)

Run = Callable[..., subprocess.CompletedProcess[str]]


def ball(radius: float = 10.0, subdivisions: int = 2) -> pv.PolyData:
    """Icosphere in double precision, outward."""
    surface = pv.Icosphere(radius=radius, nsub=subdivisions)
    surface.points = np.asarray(surface.points, dtype=np.float64)
    surface.clear_data()
    return surface


def write_sizing(path: Path, h: Callable[[np.ndarray], np.ndarray], half_width: int = 12) -> Path:
    """Size field on a grid of 1 mm round the origin; ``h`` maps world positions (n, 3) to edge lengths."""
    count = 2 * half_width + 1
    grid = pv.ImageData(dimensions=(count,) * 3, origin=(-half_width,) * 3)
    grid["sizing"] = np.asarray(h(np.asarray(grid.points, dtype=float)), dtype=np.float32)
    grid.add_field_data(['{"tool": "sizefield", "version": "0"}'], "history")
    grid.save(path)
    return path


def write_nrrd(path: Path, values: np.ndarray, **fields: str) -> Path:
    """Write a volume as raw NRRD with these header fields; ``_`` in their names stands for a blank."""
    kind = {"float64": "double", "float32": "float"}.get(values.dtype.name, values.dtype.name)
    lines = ["NRRD0004", f"type: {kind}", f"dimension: {values.ndim}", f"sizes: {' '.join(map(str, values.shape))}"]
    lines += ["encoding: raw", "endian: little", *(f"{key.replace('_', ' ')}: {text}" for key, text in fields.items())]
    path.write_bytes("\n".join([*lines, "", ""]).encode() + values.astype(values.dtype.newbyteorder("<")).tobytes("F"))
    return path


def merged(*surfaces: pv.PolyData) -> pv.PolyData:
    """Several surfaces as one."""
    points, triangles, shift = [], [], 0
    for surface in surfaces:
        points.append(np.asarray(surface.points))
        triangles.append(np.asarray(surface.faces).reshape(-1, 4)[:, 1:] + shift)
        shift += surface.n_points
    faces = np.concatenate(triangles)
    return pv.PolyData(np.concatenate(points), np.hstack([np.full((len(faces), 1), 3), faces]).ravel())


def reversed_winding(surface: pv.PolyData) -> pv.PolyData:
    """The surface inside out."""
    faces = np.asarray(surface.faces).reshape(-1, 4)[:, [0, 1, 3, 2]]
    return pv.PolyData(np.asarray(surface.points), faces.ravel())


def tetrahedra(path: Path) -> tuple[np.ndarray, np.ndarray, pv.UnstructuredGrid]:
    """Points, tetrahedra and all of a volume mesh."""
    grid = pv.read(path)
    return np.asarray(grid.points), np.asarray(grid.cells_dict[10]).astype(np.int64), grid


def fake_library(folder: Path, monkeypatch: pytest.MonkeyPatch, name: str, code: str) -> None:
    """Let processes started from now on import this code under the name of a library."""
    (folder / "fake").mkdir(exist_ok=True)
    (folder / "fake" / f"{name}.py").write_text(code)
    monkeypatch.setenv("PYTHONPATH", str(folder / "fake"))
    monkeypatch.setenv("PYTHONDONTWRITEBYTECODE", "1")


@pytest.fixture
def run(tmp_path: Path) -> Run:
    """Run the program in the test's folder, temporary files included, and return the finished process."""

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
