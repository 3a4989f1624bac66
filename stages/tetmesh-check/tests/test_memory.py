"""Tests of the memory limit."""

from __future__ import annotations

import argparse
from pathlib import Path

import pytest
from conftest import Run, ball, quiet_context
from isoparticles._native import number_of_bytes

from tetmesh_check.errors import StageError


def test_numbers_of_bytes() -> None:
    assert [number_of_bytes(text) for text in ("8G", "500 mb", "1.5KiB", "12")] == [2**33, 500 * 2**20, 1536, 12]
    for wrong in ("", "G", "0", "-1G", "8GG", "inf", "8X"):
        with pytest.raises(argparse.ArgumentTypeError, match="must be a number of bytes"):
            number_of_bytes(wrong)


def test_more_than_allowed_is_refused_with_the_figure(tmp_path: Path, run: Run) -> None:
    ball().save(tmp_path / "s.vtp")
    refused = run("s.vtp", "-o", "s.vtu", "--max-memory", "300M")
    assert refused.returncode == 2
    assert "s.vtp: tetrahedra for 162 vertices: this needs about 601 MiB of memory" in refused.stderr
    assert "(--max-memory) allows 300 MiB" in refused.stderr
    assert "MAX_MEMORY=1G (--max-memory)" in refused.stderr
    if Path("/proc/meminfo").exists():
        with pytest.raises(StageError, match="this needs about"):
            quiet_context().check_memory(1e18, "s.vtp", "")
