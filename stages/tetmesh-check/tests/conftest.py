"""Surfaces and size fields that the tests share."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import pyvista as pv

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
