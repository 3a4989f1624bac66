"""Tests of the memory limit."""

from __future__ import annotations

import argparse
from pathlib import Path

import pytest

from tetmesh_check.errors import StageError
from tetmesh_check.memory import available_memory_bytes, check_memory, number_of_bytes


def test_numbers_of_bytes() -> None:
    assert [number_of_bytes(text) for text in ("8G", "500 mb", "1.5KiB", "12")] == [2**33, 500 * 2**20, 1536, 12]
    for wrong in ("", "G", "0", "-1G", "8GG", "inf", "8X"):
        with pytest.raises(argparse.ArgumentTypeError):
            number_of_bytes(wrong)


def test_more_than_allowed_is_refused_with_the_figure() -> None:
    check_memory(100_000, Path("s.vtp"), 2**31)
    with pytest.raises(StageError) as refused:
        check_memory(1_000_000, Path("s.vtp"), 2**31)
    assert "1,000,000 vertices take about 5.3 GiB" in refused.value.what
    assert "--max-memory allows 2.0 GiB" in refused.value.why
    assert "--max-memory 6G" in refused.value.next_step
    free = available_memory_bytes()
    if free is not None:
        with pytest.raises(StageError, match="vertices"):
            check_memory(free, Path("s.vtp"), None)
