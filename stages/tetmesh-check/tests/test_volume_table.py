"""Tests of the table of volumes (voxels, F, surface, tetrahedra) in the report and the page."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import pyvista as pv
from complexes import nested_balls
from conftest import NEEDS_HXT, Run, ball, write_status

from tetmesh_check.checks import surface_volume_checks
from tetmesh_check.report.page import program
from tetmesh_check.surface import read_surface, volume_table, with_changes


def tell(path: Path, rows: list[dict[str, object]]) -> None:
    """Add rows of volumes to the metadata of a surface, as ``reconstruct`` does."""
    surface = pv.read(path)
    noted = surface.field_data["meta"] if "meta" in surface.field_data else np.frombuffer(b"{}", dtype=np.uint8)
    meta = json.loads(np.asarray(noted).tobytes().decode())
    text = json.dumps({**meta, "volumes": rows})
    surface.field_data.set_array(np.frombuffer(text.encode(), dtype=np.uint8).copy(), "meta")
    surface.save(path)


def row(name: str, voxels: float | None, field: float | None, mesh: float) -> dict[str, object]:
    return {"name": name, "voxels_mm3": voxels, "field_mm3": field, "mesh_mm3": mesh}


def test_changes_refer_to_the_voxels_or_else_to_f() -> None:
    of_labels, of_scalar = (
        with_changes({**row("a", voxels, 110.0, 120.0), "tetrahedra_mm3": None}) for voxels in (100.0, None)
    )
    assert of_labels["change_percent"] == pytest.approx({"field_mm3": 10.0, "mesh_mm3": 20.0})
    assert of_scalar["change_percent"] == pytest.approx({"mesh_mm3": 100.0 / 11.0})
    assert with_changes(row("empty", 0.0, 1.0, 1.0))["change_percent"] == {}
    assert volume_table([], {"object": 1.0}) == []


def test_a_changed_volume_of_the_surface_names_the_material() -> None:
    rows = [with_changes(row(name, 100.0, 100.0, mesh)) for name, mesh in (("head", 97.0), ("nose", 88.0))]
    (check,) = surface_volume_checks(rows, scaled=False)
    assert check.verdict == "warning"
    assert check.words == "surface against the voxels: the volume changes by -12 % in nose (limit 5 %)"
    (check,) = surface_volume_checks(rows[:1], scaled=False)
    assert check.passed
    assert check.words == "surface against the voxels: the volume changes by -3 % (limit 5 %)"
    (check,) = surface_volume_checks([with_changes(row("object", None, 100.0, 97.0))], scaled=True)
    assert check.verdict == "warning"
    assert check.words == "surface against F: the volume changes by -3 % (limit 2 %)"
    assert surface_volume_checks([], scaled=True) == []


def test_the_report_of_one_object_has_a_row(tmp_path: Path, run: Run) -> None:
    ball(10.0).save(tmp_path / "b.vtp")
    tell(tmp_path / "b.vtp", [row("object", 4000.0, 4100.0, 4050.0)])
    done = run("b.vtp", "-o", "b.vtu", "--report", "r.json", "--solve", "no", "--max-passes", 3, "-q")
    assert done.returncode == 0, done.stderr
    results = json.loads((tmp_path / "r.json").read_text())["results"]
    (told,) = results["volumes"]
    assert told["tetrahedra_mm3"] == results["volume"]["volume_mm3"]
    assert told["change_percent"]["field_mm3"] == pytest.approx(2.5)
    # surfaces of other programs contain no volumes
    ball(10.0).save(tmp_path / "c.vtp")
    assert read_surface(tmp_path / "c.vtp").volumes == []


@NEEDS_HXT
def test_report_and_page_have_a_row_for_each_material(tmp_path: Path, run: Run) -> None:
    nested_balls((10.0, 6.0), (2, 2), ("shell", "<core>")).save(tmp_path / "c.surface.vtp")
    tell(tmp_path / "c.surface.vtp", [row("shell", 3000.0, 3010.0, 3020.0), row("<core>", 900.0, 905.0, 895.5)])
    done = run("c.surface.vtp", "-o", "c.volume.vtu", "--report", "c.report.json", "--solve", "no", "-q")
    assert done.returncode == 0, done.stderr
    results = json.loads((tmp_path / "c.report.json").read_text())["results"]
    filling = {entry["name"]: entry["volume_mm3"] for entry in results["volume"]["regions"]}
    assert {told["name"]: told["tetrahedra_mm3"] for told in results["volumes"]} == filling
    write_status(tmp_path, "c")
    assert program.main([str(tmp_path / "c.status.json"), "-o", str(tmp_path / "c.html")]) == 0
    text = (tmp_path / "c.html").read_text()
    for words in ("surface mesh, mm\u00b3", "&lt;core&gt;", "(-0.50 %)", "(+0.67 %)"):
        assert words in text
