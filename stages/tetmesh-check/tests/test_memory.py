"""Tests of the memory limit."""

from __future__ import annotations

import argparse
from pathlib import Path

import pytest
from conftest import quiet_context
from isoparticles._native import number_of_bytes

from tetmesh_check.errors import StageError
from tetmesh_check.memory import check_memory


def test_numbers_of_bytes() -> None:
    assert [number_of_bytes(text) for text in ("8G", "500 mb", "1.5KiB", "12")] == [2**33, 500 * 2**20, 1536, 12]
    for wrong in ("", "G", "0", "-1G", "8GG", "inf", "8X"):
        with pytest.raises(argparse.ArgumentTypeError, match="must be a number of bytes"):
            number_of_bytes(wrong)


def test_more_than_allowed_is_refused_with_the_figure() -> None:
    context = quiet_context("--max-memory", "2G")
    check_memory(100_000, Path("s.vtp"), context)
    with pytest.raises(StageError) as refused:
        check_memory(1_000_000, Path("s.vtp"), context)
    assert "1,000,000 vertices: this needs about 5.3 GiB" in refused.value.what
    assert "--max-memory) allows 2.0 GiB" in refused.value.why
    assert "MAX_MEMORY=6G (--max-memory)" in refused.value.next
    if Path("/proc/meminfo").exists():
        with pytest.raises(StageError, match="vertices"):
            check_memory(10**12, Path("s.vtp"), quiet_context())
