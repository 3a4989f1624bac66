"""Tests of gaps: distances measured by VTK, shapes, volumes, contact in CalculiX, and refusals."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import pyvista as pv
from complexes import cells_of_a_block, nested_balls
from conftest import NEEDS_HXT, Run, quiet_context, write_sizing
from test_split import NAMES, Material, corners_of, joined, plates, with_muscle

from tetmesh_check.checks import Limits
from tetmesh_check.datasets import text_of, to_polydata
from tetmesh_check.errors import StageError
from tetmesh_check.export.formats import export
from tetmesh_check.export.mesh import MarkedMesh
from tetmesh_check.gap import Opened, open_gaps
from tetmesh_check.measures import _tell
from tetmesh_check.parts.splits import Split, read_gap
from tetmesh_check.quality import Points, signed_tetrahedron_volumes, tetrahedron_quality
from tetmesh_check.split import split

LIMITS = Limits()
CCX = shutil.which("ccx")


def opened(
    material: Material, *gaps: Split, warp: object = lambda at: at, limits: Limits = LIMITS
) -> tuple[MarkedMesh, Opened]:
    """Return a split block, and its gaps."""
    mesh, parts, _ = joined(material, *gaps, warp=warp)  # type: ignore[arg-type]
    apart = split(mesh, parts)
    quality = tetrahedron_quality(apart.points, apart.tetrahedra)
    return apart, open_gaps(apart, parts, quality, limits)


def distances(points: Points, one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Return the distances of the nodes and centres of a side from the other side, by VTK."""
    at = np.concatenate([points[np.unique(one)], points[one].mean(axis=1)])
    used, local = np.unique(other, return_inverse=True)
    measured = pv.PolyData(at).compute_implicit_distance(to_polydata(points[used], local.reshape(-1, 3)))
    return np.abs(np.asarray(measured["implicit_distance"]))


def both_ways(mesh: MarkedMesh, points: Points, one: str, other: str) -> np.ndarray:
    sides = [corners_of(mesh, name) for name in (one, other)]
    return np.concatenate([distances(points, *sides), distances(points, *sides[::-1])])


def test_two_plates_have_a_gap_of_a_fifth_of_a_millimetre() -> None:
    mesh, found = opened(plates, read_gap("bone/cartilage=0.2"))
    np.testing.assert_allclose(both_ways(mesh, found.points, "bone_to_cartilage", "cartilage_to_bone"), 0.2, rtol=1e-9)
    volumes = signed_tetrahedron_volumes(found.points, mesh.tetrahedra)
    assert volumes.min() > 0.0
    for region in (1, 2):
        assert volumes[mesh.regions == region].sum() == pytest.approx(72.0 - 36.0 * 0.1)
    np.testing.assert_array_equal(found.points.min(axis=0), [0.0, 0.0, 0.0])
    np.testing.assert_array_equal(found.points.max(axis=0), [6.0, 6.0, 4.0])
    (check,) = found.checks
    assert check.passed
    assert check.value == pytest.approx(0.0, abs=1e-9)


def test_the_rim_slides_on_an_oblique_free_surface() -> None:
    lean = np.array([[1.0, 0.0, 0.4], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
    mesh, found = opened(plates, read_gap("bone/cartilage=0.2"), warp=lambda at: at @ lean.T)
    across = found.points[np.unique(mesh.boundary)] @ np.linalg.inv(lean).T
    on_side = np.abs(mesh.points[np.unique(mesh.boundary)] @ np.linalg.inv(lean).T[:, 0]) < 1e-9
    np.testing.assert_allclose(across[on_side, 0], 0.0, atol=1e-9)
    heights = [
        np.unique(found.points[corners_of(mesh, f"{a}_to_{b}"), 2].round(9)) for a, b in (NAMES[:2], NAMES[1::-1])
    ]
    assert [height.tolist() for height in heights] == [[1.9], [2.1]]


@pytest.mark.parametrize("width", [0.05, 0.2, 0.6])
@pytest.mark.parametrize("height", [0.3, 0.5])
def test_the_distance_is_kept_on_a_wavy_interface(height: float, width: float) -> None:
    """The angles between adjacent triangles are up to 30 and 48 degrees."""

    def wavy(at: Points) -> Points:
        lift = height * np.sin(1.3 * at[:, 0]) * np.cos(1.1 * at[:, 1]) * (1.0 - np.abs(at[:, 2] - 2.0) / 2.0)
        return at + lift[:, None] * [0.0, 0.0, 1.0]

    limits = Limits(min_dihedral=1.0, min_scaled_jacobian=0.01)
    mesh, found = opened(plates, read_gap(f"bone/cartilage={width}"), warp=wavy, limits=limits)
    (check,) = found.checks
    assert check.passed
    bone, cartilage = (corners_of(mesh, name) for name in ("bone_to_cartilage", "cartilage_to_bone"))
    for one, other in ((bone, cartilage), (cartilage, bone)):
        at = mesh.points[one]
        inner = ((at[..., :2] > 0.5) & (at[..., :2] < 5.5)).all(axis=(1, 2))
        measured = distances(found.points, one, other)[len(np.unique(one)) :]
        np.testing.assert_allclose(measured[inner], width, rtol=0.01)


def test_interior_nodes_follow_a_wide_gap() -> None:
    mesh, found = opened(plates, read_gap("bone/cartilage=1"))
    # the plates have two layers of 1 mm; each loses about a quarter
    inner = (mesh.points[:, :2] > 0.5).all(axis=1) & (mesh.points[:, :2] < 5.5).all(axis=1) & (mesh.points[:, 2] == 1.0)
    assert len(found.points[inner]) == 25
    np.testing.assert_allclose(found.points[inner, 2], 0.79, atol=0.05)


def test_planes_keep_the_distance_at_a_right_angle() -> None:
    mesh, found = opened(below_and_left, read_gap("bone/cartilage=0.2"))
    bone, cartilage = (corners_of(mesh, name) for name in ("bone_to_cartilage", "cartilage_to_bone"))
    for one, other in ((bone, cartilage), (cartilage, bone)):
        measured = distances(found.points, one, other)[len(np.unique(one)) :]
        np.testing.assert_allclose(measured, 0.2, rtol=0.01)
    # the edge of the bone is a distance from the faces of the cartilage, whose edge is farther away
    assert distances(found.points, bone, cartilage).max() == pytest.approx(0.2, rel=0.01)
    assert found.results[0]["distance_at_rims_and_bends_mm"][1] == pytest.approx(0.2 * np.sqrt(2.0), rel=0.01)


def test_the_gap_closes_where_another_material_holds_both_sides() -> None:
    mesh, found = opened(with_muscle, read_gap("bone/cartilage=0.2"))
    (row,) = found.results
    assert sorted(row["shared_nodes_mm"]) == [[2.0, float(y), 2.0] for y in range(7)]
    assert row["doubled_nodes"] == 4 * 7
    assert signed_tetrahedron_volumes(found.points, mesh.tetrahedra).min() > 0.0
    muscle = np.unique(mesh.elements[mesh.regions == 3])
    np.testing.assert_array_equal(found.points[muscle], mesh.points[muscle])
    far = [corners_of(mesh, f"{a}_to_{b}") for a, b in (NAMES[:2], NAMES[1::-1])]
    far = [corners[(mesh.points[corners][..., 0] > 3.5).all(axis=1)] for corners in far]
    np.testing.assert_allclose(distances(found.points, *far), 0.2, rtol=0.01)


def test_gaps_of_different_widths_meet_at_a_curve() -> None:
    gaps = map(read_gap, ("bone/cartilage=0.2", "bone/muscle=0.1", "cartilage/muscle=0.1"))
    mesh, found = opened(with_muscle, *gaps)
    assert signed_tetrahedron_volumes(found.points, mesh.tetrahedra).min() > 0.0
    for one, other, width in (("bone", "cartilage", 0.2), ("bone", "muscle", 0.1), ("cartilage", "muscle", 0.1)):
        sides = [corners_of(mesh, f"{a}_to_{b}") for a, b in ((one, other), (other, one))]
        # a node at the curve of bone and cartilage is 0.05 mm behind the plane x = 2
        measured = distances(found.points, *sides)[len(np.unique(sides[0])) :]
        np.testing.assert_allclose(measured, width, rtol=0.01)


def below_and_left(x: np.ndarray, _y: np.ndarray, z: np.ndarray) -> np.ndarray:
    return np.where((z < 2) & (x < 3), 1, 2)


def test_corrections_end_at_their_best(monkeypatch: pytest.MonkeyPatch) -> None:
    errors = []
    for rounds in (1, 5, 40):
        monkeypatch.setattr("tetmesh_check.gap._ROUNDS", rounds)
        errors.append(opened(below_and_left, read_gap("bone/cartilage=0.6"))[1].checks[0].value)
    assert errors == sorted(errors, reverse=True)


def test_a_closed_gap_is_told_without_an_exponent(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tetmesh_check.gap._moved", lambda mesh, *_: mesh.points)
    (check,) = opened(plates, read_gap("bone/cartilage=0.2"))[1].checks
    assert not check.passed
    assert "100 % off (limit 1 %)" in check.words


def test_tetrahedra_that_missed_a_limit_before_are_not_refused() -> None:
    limits = Limits(min_dihedral=50.0)
    mesh, found = opened(plates, read_gap("bone/cartilage=0.2"), limits=limits)
    before = tetrahedron_quality(mesh.points, mesh.tetrahedra).min_dihedral
    assert before.max() < 50.0
    assert found.quality.min_dihedral.min() < before.min()


def test_tetrahedra_that_were_inverted_before_are_left_to_the_checks() -> None:
    mesh, parts, _ = joined(plates, read_gap("bone/cartilage=0.2"))
    apart = split(mesh, parts)
    elements = apart.elements.copy()
    elements[0] = elements[0][[0, 2, 1, 3]]
    regions = np.where(np.arange(len(elements)) == 0, 0, apart.regions)
    apart = replace(apart, elements=elements, regions=regions)
    before = tetrahedron_quality(apart.points, apart.tetrahedra)
    assert (open_gaps(apart, parts, before, LIMITS).quality.volume <= 0.0).sum() == 1
    # region 0 has no name
    wide = replace(parts, splits=[replace(own, split=read_gap("bone/cartilage=4.5")) for own in parts.splits])
    with pytest.raises(StageError, match="too little room"):
        open_gaps(replace(apart, regions=0 * regions), wide, before, LIMITS)


def test_inverted_tetrahedra_are_refused_in_their_own_words() -> None:
    with pytest.raises(StageError, match="tetrahedra are inverted"):
        opened(plates, read_gap("bone/cartilage=4.5"))


def test_a_strip_between_rims_has_no_checked_width(capfd: pytest.CaptureFixture[str]) -> None:
    def strip(_x: np.ndarray, y: np.ndarray, z: np.ndarray) -> np.ndarray:
        return np.where(y < 5, 3, np.where(z < 2, 1, 2))

    gaps = [read_gap(f"{pair}=0.2") for pair in ("bone/cartilage", "bone/muscle", "cartilage/muscle")]
    rows = opened(strip, *gaps)[1]
    assert rows.results[0]["distance_mm"] is None
    assert [one.name for one in rows.checks] == ["gap_width"] * 2
    _tell(rows.results[0], quiet_context())
    assert "bone/cartilage: the width of the gap is not checked" in capfd.readouterr().err


def test_a_strip_that_another_material_holds_is_reported(capfd: pytest.CaptureFixture[str]) -> None:
    def strip(x: np.ndarray, y: np.ndarray, z: np.ndarray) -> np.ndarray:
        return np.where((x < 2) | (x > 3) | (y < 1) | (y > 5), 3, np.where(z < 2, 1, 2))

    (row,) = opened(strip, read_gap("bone/cartilage=0.2"))[1].results
    assert row["doubled_nodes"] == 0
    _tell(row, quiet_context())
    assert "bone/cartilage: no node is doubled" in capfd.readouterr().err


@NEEDS_HXT
def test_a_ball_keeps_its_distance_from_its_shell(tmp_path: Path, run: Run) -> None:
    nested_balls((10.0, 6.0), (3, 3), ("shell", "core")).save(tmp_path / "b.surface.vtp")
    write_sizing(tmp_path / "h.vti", lambda world: np.full(len(world), 1.2), 14)
    words = ("b.surface.vtp", "--sizefield", "h.vti", "-o", "b.volume.vtu", "--solve", "no", "-q", "--report", "r.json")
    done = run(*words, "--gap", "core/shell=0.2", "--export", "vtp", "--unit", "m")
    assert done.returncode == 0, done.stderr
    surface = pv.read(tmp_path / "b.boundary.vtp")
    number = {name: int(mark) for mark, name in json.loads(text_of(surface, "parts") or "").items()}
    triangles, points = np.asarray(surface.faces).reshape(-1, 4)[:, 1:], 1e3 * np.asarray(surface.points)
    sides = [triangles[surface.cell_data["mark"] == number[name]] for name in ("core_to_shell", "shell_to_core")]
    for one, other in (sides, sides[::-1]):
        assert len(np.unique(one)) == 642
        np.testing.assert_allclose(distances(points, one, other), 0.2, rtol=0.01)

    results = json.loads((tmp_path / "r.json").read_text())["results"]
    volume = pv.read(tmp_path / "b.volume.vtu")
    cells = np.asarray(volume.cells_dict[10]).astype(np.int64)
    sizes = signed_tetrahedron_volumes(np.asarray(volume.points), cells)
    assert sizes.min() > 0.0
    for row in results["split"]["regions"]:
        own = np.asarray(volume.cell_data["region"]) == {"shell": 1, "core": 2}[row["name"]]
        assert sizes[own].sum() == pytest.approx(row["volume_mm3"])
        # each side moves by 0.1 mm
        assert row["joined_mm3"] - row["volume_mm3"] == pytest.approx(0.1 * 4.0 * np.pi * 36.0, rel=0.03)
    assert min(results["split"]["min_dihedral"].values()) > 12.0
    assert np.asarray(volume.cell_data["min_dihedral"]).min() == pytest.approx(
        results["split"]["min_dihedral"]["after"]
    )
    assert results["volume"]["points"] == volume.n_points
    after = results["split"]["min_dihedral"]["after"]
    assert results["volume"]["quality"]["min_dihedral"]["min"] == after
    assert min(row["quality"]["min_dihedral"]["min"] for row in results["volume"]["regions"]) == after
    assert {check["name"]: check["verdict"] for check in results["checks"]}["gap_width"] == "pass"


def test_too_little_room_is_refused_with_its_place() -> None:
    with pytest.raises(StageError) as caught:
        opened(plates, read_gap("bone/cartilage=1.9"))
    assert "--gap bone/cartilage=1.9" in caught.value.what
    place = re.search(r"has too little room at \((\S+), (\S+), (\S+)\) mm", caught.value.what)
    assert place is not None
    assert 0.0 < float(place[3]) < 4.0
    assert "narrower gap" in caught.value.next


def test_a_gap_wider_than_the_part_is_refused_before_the_tetrahedra(tmp_path: Path, run: Run) -> None:
    cells_of_a_block((6, 6, 4), plates, NAMES[:2]).save(tmp_path / "s.surface.vtp")
    words = ("s.surface.vtp", "-o", "s.volume.vtu", "--solve", "no", "-q")
    for more, told in (
        (("--gap", "bone/cartilage=4"), "each side moves by 2 mm, but bone is at most 2 mm thick there"),
        (("--gap", "bone/cartilage=0"), "is not A/B=WIDTH with a width above 0"),
        (("--gap", "bone/muscle=1"), "'muscle' is not a material"),
        (("--split", "bone/cartilage", "--for", "simnibs"), "--split or --gap with --for simnibs"),
    ):
        done = run(*words, *more)
        assert done.returncode == 2
        assert told in done.stderr
        assert "why it matters" in done.stderr
        assert "what to do" in done.stderr
        assert [path.name for path in tmp_path.iterdir()] == ["s.surface.vtp"]


@pytest.mark.skipif(CCX is None, reason="no CalculiX (Debian, Ubuntu: apt-get install calculix-ccx)")
def test_calculix_closes_the_gap_and_compresses_the_plates(tmp_path: Path) -> None:
    # 0.3 mm close the gap of 0.2 mm and compress 3.8 mm of material by 0.1 mm; without lateral
    # strain, the force is E A 0.1 / 3.8. The contact is a penalty method, so it is 4 % smaller.
    mesh, found = opened(plates, read_gap("bone/cartilage=0.2"))
    export(replace(mesh, points=found.points), tmp_path / "b.volume.vtu", "b", "inp")
    modulus = 1000.0
    ends = {
        name: ",\n".join(str(node + 1) for node in np.flatnonzero(found.points[:, 2] == z))
        for name, z in (("BOTTOM", 0.0), ("TOP", 4.0))
    }
    (tmp_path / "job.inp").write_text(
        f"""*INCLUDE, INPUT=b.volume.inp
*NSET, NSET=BOTTOM
{ends["BOTTOM"]}
*NSET, NSET=TOP
{ends["TOP"]}
*MATERIAL, NAME=TISSUE
*ELASTIC
{modulus}, 0.0
*SOLID SECTION, ELSET=VOLUME, MATERIAL=TISSUE
*STEP, NLGEOM
*STATIC
0.1, 1.0
*BOUNDARY
BOTTOM, 1, 3
TOP, 1, 2
TOP, 3, 3, -0.3
*NODE PRINT, NSET=TOP, TOTALS=ONLY
RF
*END STEP
"""
    )
    done = subprocess.run([str(CCX), "job"], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout[-2000:]
    forces = re.findall(r"total force.*\n\s*\n(.*)", (tmp_path / "job.dat").read_text())
    assert float(forces[-1].split()[2]) == pytest.approx(-modulus * 36.0 * 0.1 / 3.8, rel=0.06)
