"""Tests of the order of convergence: on the ball, on coarse meshes, and on bad input."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import pyvista as pv
from conftest import NEEDS_HXT, Run, ball, write_sizing
from test_benches import load_bench
from test_solve import block

_BENCH = load_bench("convergence")
main, measure, orders = _BENCH.main, _BENCH.measure, _BENCH.orders


@NEEDS_HXT
def test_second_order_on_the_ball(tmp_path: Path, run: Run, capsys: pytest.CaptureFixture[str]) -> None:
    names = []
    for subdivisions, size in ((3, 2.0), (4, 1.0)):
        ball(subdivisions=subdivisions).save(tmp_path / "ball.vtp")
        write_sizing(tmp_path / "h.vti", lambda world, size=size: np.full(len(world), size))
        name = f"{subdivisions}.vtu"
        done = run("ball.vtp", "--sizefield", "h.vti", "-o", name, "--method", "hxt", "--solve", "no", "-q")
        assert done.returncode == 0, done.stderr
        names.append(str(tmp_path / name))
    assert main(names) == 0
    table = capsys.readouterr().out.splitlines()
    assert len(table) == 4
    assert float(table[3].split("|")[5]) == pytest.approx(2.0, rel=0.1)
    assert float(table[3].split("|")[7]) == pytest.approx(1.0, rel=0.1)


def save(path: Path, counts: tuple[int, int, int], size: float) -> str:
    points, cells = block(counts, size)
    pv.UnstructuredGrid({10: cells}, points).save(path)
    return str(path)


def test_meshes_too_coarse_are_not_of_second_order(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = [save(tmp_path / f"{n}.vtu", (n,) * 3, 12.0 / n) for n in (4, 3)]
    assert main(words) == 1
    assert "the order of the error is" in capsys.readouterr().err
    rows = [measure(f"{n}", *block((n,) * 3, 12.0 / n)) for n in (12, 24)]
    assert orders(rows, "relative_l2_error")[0] == pytest.approx(2.0, rel=0.1)


def test_bad_usage(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    one = save(tmp_path / "one.vtu", (3, 3, 3), 1.0)
    ball().save(tmp_path / "ball.vtp")
    flat = tmp_path / "flat.vtu"
    pv.UnstructuredGrid({10: np.array([[0, 1, 2, 3]])}, np.zeros((4, 3))).save(flat)
    for words, said in (
        ([one], "one mesh"),
        ([one, one], "too much alike"),
        ([one, str(tmp_path / "ball.vtp")], "no tetrahedra"),
        ([one, str(tmp_path / "absent.vtu")], "no such file"),
        ([one, str(flat)], "inverted or flat"),
    ):
        assert main(words) == 2
        error = capsys.readouterr().err
        assert said in error
        assert "what to do" in error
