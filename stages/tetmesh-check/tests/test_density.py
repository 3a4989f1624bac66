"""Tests of density and stiffness from a scan: known mass, known stiffness, materials in files."""

from __future__ import annotations

import argparse
import json
import shutil
import subprocess
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import meshio
import numpy as np
import pytest
import pyvista as pv
from complexes import nested_balls
from conftest import NEEDS_HXT, Run, ball, quiet_context, tetrahedra, write_nrrd, write_sizing
from isoparticles._native import tetrahedron_means
from skfem import Basis, BilinearForm, ElementTetP1, ElementVector, condense, solve
from skfem.helpers import ddot, sym_grad
from test_regions import marked_block, placed
from test_solve import block, elements

from tetmesh_check.density.arguments import DensityArguments
from tetmesh_check.density.laws import LAWS, Calibration, read_calibration, read_law
from tetmesh_check.density.mapping import MIN_MODULUS, DensityScan, map_density
from tetmesh_check.export.cards import MIN_DENSITY
from tetmesh_check.export.formats import export
from tetmesh_check.export.mesh import MarkedMesh
from tetmesh_check.parsing import read_table
from tetmesh_check.quality import signed_tetrahedron_volumes
from tetmesh_check.volumes import InputVolume

VERTEBRA = LAWS["vertebra"]
PLAIN = Calibration(1.0, 0.0)


def mapped(mesh: MarkedMesh, values: np.ndarray, step: np.ndarray, bins: int = 100) -> tuple[MarkedMesh, dict]:
    """Map voxels of density, whose sizes are ``step``, onto a mesh with a corner at the origin."""
    volume = InputVolume(values.astype(np.float32), np.diag(step), 0.5 * step, False)
    context = quiet_context()
    scan = DensityScan(DensityArguments(Path("ct.nrrd"), PLAIN, VERTEBRA, None, bins), volume)
    volumes = signed_tetrahedron_volumes(mesh.points, mesh.tetrahedra)
    return map_density(scan, mesh, volumes, context), context.results["density"]


def graded_block(bins: int = 100) -> tuple[MarkedMesh, dict]:
    """Return the block of two regions with a density that grows along x in thin voxels."""
    x = (np.arange(300) + 0.5) / 100
    return mapped(
        marked_block(), np.broadcast_to((0.2 + 0.3 * x)[:, None, None], (300, 1, 1)), np.array([0.01, 2, 4]), bins
    )


# --- the phantom ----------------------------------------------------------------------------------


def femur(folder: Path) -> Path:
    """Write a bent shaft of 90 mm with a head at one end."""
    surface = ball(10.0, 3)
    x, y, z = np.asarray(surface.points).T
    width = 1.0 + 0.6 * np.exp(-(((z - 8.0) / 3.0) ** 2))
    surface.points = np.stack([width * x + 0.05 * z**2, width * y, 4.5 * z], axis=1)
    surface.add_field_data(['"Lps"'], "space")
    surface.save(folder / "s.vtp")
    return folder / "s.vtp"


def bone(points: np.ndarray) -> np.ndarray:
    """Return a known density, g/cm^3: about 0.3 near the axis of the shaft, and 1.8 outside."""
    x, y, z = points.T
    radius = np.hypot(x - 0.05 * (z / 4.5) ** 2, y)
    return 1.05 + 0.75 * np.tanh((radius - 7.0) / 2.0)


def write_scan(path: Path, density: Callable[[np.ndarray], np.ndarray], half: tuple[int, int, int]) -> Path:
    """Write grey values 1000 (density - 0.1) in voxels of 0.5 mm in RAS, on a turned grid."""
    steps = 0.5 * np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    shape = [2 * n + 1 for n in half]
    index = np.stack(np.meshgrid(*map(np.arange, shape), indexing="ij"), -1).reshape(-1, 3)
    ras = (index - half) @ steps
    values = 1000.0 * (density(ras * [-1, -1, 1]) - 0.1)
    origin = (-np.array(half) @ steps).tolist()
    return write_nrrd(path, values.reshape(shape).astype(np.float32), **placed("RAS", steps, origin))


def integral(points: np.ndarray, cells: np.ndarray, density: Callable[[np.ndarray], np.ndarray]) -> float:
    """Integrate over tetrahedra, by the centroids of 512 parts of equal volume of each."""
    corners = np.eye(4)[None]
    for _ in range(3):
        a, b, c, d = (corners[:, k] for k in range(4))
        ab, ac, ad, bc, bd, cd = (a + b) / 2, (a + c) / 2, (a + d) / 2, (b + c) / 2, (b + d) / 2, (c + d) / 2
        parts = [(a, ab, ac, ad), (b, ab, bc, bd), (c, ac, bc, cd), (d, ad, bd, cd)]
        parts += [(ab, cd, ac, ad), (ab, cd, ad, bd), (ab, cd, bd, bc), (ab, cd, bc, ac)]
        corners = np.concatenate([np.stack(part, axis=1) for part in parts])
    weights = corners.mean(axis=1)
    volumes = signed_tetrahedron_volumes(points, cells)
    values = [density(np.einsum("k,mkx->mx", weight, points[cells])) for weight in weights]
    return float(np.mean(values, axis=0) @ volumes)


@NEEDS_HXT
def test_the_mass_of_a_femur_phantom_is_exact_within_a_thousandth(tmp_path: Path, run: Run) -> None:
    femur(tmp_path)
    write_scan(tmp_path / "ct.nrrd", bone, (40, 60, 100))
    words = ["s.vtp", "-o", "v.volume.vtu", "--method", "hxt", "--solve", "no", "-q", "--report", "r.json"]
    words += ["--density", "ct.nrrd", "--calibrate", "0.001,0.1", "--law", "keller", "--export", "feb,inp"]
    done = run(*words)
    assert done.returncode == 0, done.stderr
    points, cells, grid = tetrahedra(tmp_path / "v.volume.vtu")
    density, modulus = (np.asarray(grid.cell_data[name]) for name in ("density", "E"))
    volumes = signed_tetrahedron_volumes(points, cells)
    exact = 1e-3 * integral(points, cells, bone)
    found = json.loads((tmp_path / "r.json").read_text())["results"]["density"]
    assert found["mass_g"] == pytest.approx(exact, rel=1e-3)
    assert found["mass_g"] == pytest.approx(1e-3 * float(density @ volumes), rel=1e-12)
    np.testing.assert_allclose(modulus, 10500 * density**2.29, rtol=1e-12)
    assert found["partly_outside"] == 0
    cards = [
        card.find("density") for card in ElementTree.parse(tmp_path / "v.volume.feb").iterfind("Material/material")
    ]
    assert 50 < len(cards) == found["bins"]["cards"] <= 100


def test_a_linear_density_has_the_mean_of_the_centroids() -> None:
    # voxels of 1/8 divide the cubes, so each tetrahedron has whole voxels on both sides
    points, cells = block((3, 2, 2))
    values = np.fromfunction(lambda i, j, k: 2.0 * i - j + 3.0 * k, (24, 16, 16)).astype(np.float32)
    step, origin = (np.eye(3) / 8).tolist(), (1 / 16,) * 3
    means, shares = tetrahedron_means(values, step, origin, points, cells)
    centres = 8.0 * points[cells].mean(axis=1) - 0.5
    np.testing.assert_allclose(means, centres @ [2.0, -1.0, 3.0], atol=0.2)
    volumes = signed_tetrahedron_volumes(points, cells)
    assert float(means @ volumes) == pytest.approx(values.mean() * 12.0, rel=1e-12)
    np.testing.assert_allclose(shares, 1.0, rtol=1e-12)


# --- the stiffness --------------------------------------------------------------------------------


def stiffness_error(count: int) -> float:
    """Return the relative error of the axial stiffness of a bar with a known density.

    Without lateral contraction, the stress is uniaxial, and 1/k is the integral of 1/(E A) over the
    length of the bar, here 1.
    """

    def density(x: np.ndarray) -> np.ndarray:
        return np.asarray(0.5 + 0.25 * np.cos(2.5 * x))

    points, cells = block((count, count // 4, count // 4), 1.0 / count)
    voxels = 2048
    values = density((np.arange(voxels) + 0.5) / voxels)[:, None, None].astype(np.float32)
    step, origin = np.diag([1 / voxels, 1.0, 1.0]).tolist(), (0.5 / voxels, 0.0, 0.0)
    modulus = VERTEBRA.a * tetrahedron_means(values, step, origin, points, cells)[0] ** VERTEBRA.b
    basis = Basis(elements(points, cells), ElementVector(ElementTetP1()), intorder=1)
    form = BilinearForm(lambda u, v, w: w.E * ddot(sym_grad(u), sym_grad(v)))
    matrix = form.assemble(basis, E=modulus[:, None])
    ends = [basis.get_dofs(lambda x, at=at: np.isclose(x[0], at)) for at in (0.0, 1.0)]
    displacement = basis.zeros()
    displacement[ends[1].all(["u^1"])] = 1.0
    fixed = np.concatenate([ends[0].all(), ends[1].all(["u^1"])])
    displacement = solve(*condense(matrix, x=displacement, D=fixed))
    x = (np.arange(200_000) + 0.5) / 200_000
    exact = (1 / 4) ** 2 / float(np.mean(1.0 / (VERTEBRA.a * density(x) ** VERTEBRA.b)))
    return abs(float(displacement @ (matrix @ displacement)) / exact - 1.0)


def test_the_stiffness_of_a_bar_converges_in_second_order() -> None:
    errors = [stiffness_error(count) for count in (4, 8, 16)]
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    np.testing.assert_allclose(orders, 2.0, atol=0.2, err_msg=str(errors))
    assert errors[-1] < 1e-3


# --- laws and calibrations ------------------------------------------------------------------------


def test_laws_and_calibrations_are_parsed() -> None:
    assert read_law("vertebra") == VERTEBRA
    assert (read_law("6850,1.49").a, read_law("6850,1.49").b) == (6850.0, 1.49)
    assert read_calibration("0.001,-0.05") == Calibration(0.001, -0.05)
    # the normal equations of the points (0, 0), (100, 0.1), (200, 0.22)
    found = read_calibration("0:0,100:0.1,200:0.22")
    assert (found.slope, found.intercept) == pytest.approx((0.0011, -1 / 300))
    assert found.residual == pytest.approx(np.sqrt(np.mean(np.square([1 / 300, 2 / 300, 1 / 300]))))
    for text in ("newton", "1", "1,2,3", "-1,2", "nan,1", "0,1"):
        with pytest.raises(argparse.ArgumentTypeError):
            read_law(text)
    for text in ("0,1", "-1,0", "1", "a,b", "0:0", "5:1,5:2", "0:1,1:0", "0:0,1", "inf,0"):
        with pytest.raises(argparse.ArgumentTypeError):
            read_calibration(text)


def test_the_help_lists_the_laws() -> None:
    lines = next(group["description"] for group in read_table()["group"] if "Density" in group["title"]).splitlines()
    table = [line for line in lines if line.startswith("  ") and "rho^" in line]
    assert len(table) == len(LAWS)
    for line, (name, law) in zip(table, LAWS.items(), strict=True):
        assert line.split()[:4] == [name, f"{law.a:.0f}", f"rho^{law.b:g}", law.kind]


def test_negative_densities_get_the_minimum_modulus() -> None:
    values = np.full((3, 2, 4), 0.5)
    values[0, 0, 0] = -0.2
    mesh, found = mapped(marked_block(), values, np.ones(3))
    clamped = mesh.fields["density"] < 0.0
    assert found["at_minimum_modulus"] == clamped.sum() == 6
    assert (mesh.fields["E"][clamped] == MIN_MODULUS).all()
    assert found["mass_g"] == pytest.approx(1e-3 * values.sum())
    # solvers refuse densities that are not positive
    assert sorted(card.density for card in mesh.cards) == pytest.approx([MIN_DENSITY, 0.5, 0.5])


# --- materials ------------------------------------------------------------------------------------


@pytest.mark.parametrize("bins", [1, 7, 1000])
def test_cards_keep_the_mass_of_each_region(bins: int) -> None:
    mesh, found = graded_block(bins)
    volumes = signed_tetrahedron_volumes(mesh.points, mesh.tetrahedra)
    members = np.concatenate([card.members for card in mesh.cards])
    np.testing.assert_array_equal(np.sort(members), np.arange(len(mesh.elements)))
    density, modulus = mesh.fields["density"], mesh.fields["E"]
    for region in (2, 5):
        own = mesh.regions == region
        mass = sum(card.density * volumes[card.members].sum() for card in mesh.cards if card.region == region)
        assert mass == pytest.approx(float((density * volumes)[own].sum()), rel=1e-12)
    for card in mesh.cards:
        assert np.ptp(modulus[card.members]) <= np.ptp(modulus) / bins * (1 + 1e-9)
        assert card.modulus == pytest.approx(float(np.average(modulus[card.members], weights=volumes[card.members])))
    assert found["bins"]["cards"] == len(mesh.cards) <= 2 * bins


UNITS = [("mm", 1.0, 1e-9), ("m", 1e6, 1e3), ("um", 1.0, 1e-15)]


@pytest.mark.parametrize(("unit", "stiffness", "mass"), UNITS)
def test_abaqus_materials_are_read_back(tmp_path: Path, unit: str, stiffness: float, mass: float) -> None:
    mesh, _ = graded_block(5)
    export(mesh, tmp_path / "b.volume.vtu", "b", "inp", unit)
    again = meshio.read(tmp_path / "b.volume.inp")
    lines = (tmp_path / "b.volume.inp").read_text().splitlines()
    starts = [n for n, line in enumerate(lines) if line.startswith("*MATERIAL")]
    assert len(starts) == len(mesh.cards) == 10
    for n, card in zip(starts, mesh.cards, strict=True):
        name = card.name.upper()
        np.testing.assert_array_equal(again.cell_sets[name][0], card.members)
        assert lines[n : n + 6 : 5] == [f"*MATERIAL, NAME={name}", f"*SOLID SECTION, ELSET={name}, MATERIAL={name}"]
        assert [lines[n + 1], lines[n + 3]] == ["*ELASTIC", "*DENSITY"]
        modulus, ratio = map(float, lines[n + 2].split(","))
        assert (modulus, ratio) == pytest.approx((stiffness * card.modulus, 0.3))
        assert float(lines[n + 4]) == pytest.approx(mass * card.density)


def test_febio_materials_are_read_back(tmp_path: Path) -> None:
    mesh, _ = graded_block(5)
    # region 2 without a density keeps a placeholder
    mesh = replace(mesh, cards=[card for card in mesh.cards if card.region == 5])
    export(mesh, tmp_path / "b.volume.vtu", "b", "feb")
    root = ElementTree.parse(tmp_path / "b.volume.feb").getroot()
    texts = {
        m.get("name"): [m.findtext(key) for key in ("density", "E", "v")] for m in root.iterfind("Material/material")
    }
    values = {name: [float(str(text)) for text in of] for name, of in texts.items()}
    domains = {own.get("name"): own.get("mat") for own in root.iterfind("MeshDomains/SolidDomain")}
    assert domains == dict(zip(values, values, strict=True))
    assert values.pop("region_2") == [1.0, 1.0, 0.3]
    assert list(values) == [card.name for card in mesh.cards]
    for card in mesh.cards:
        assert values[card.name] == pytest.approx([1e-9 * card.density, card.modulus, 0.3])
        rows = [e.text for e in root.iterfind(f"Mesh/Elements[@name='{card.name}']/elem")]
        cells = np.array([[int(node) for node in str(row).split(",")] for row in rows]) - 1
        np.testing.assert_array_equal(cells, mesh.elements[card.members])


CCX = shutil.which("ccx")


@pytest.mark.skipif(CCX is None, reason="no CalculiX (Debian, Ubuntu: apt-get install calculix-ccx)")
def test_calculix_finds_the_mass_of_the_block(tmp_path: Path) -> None:
    mesh, found = graded_block(20)
    export(mesh, tmp_path / "b.volume.vtu", "b", "inp")
    (tmp_path / "job.inp").write_text(
        "*INCLUDE, INPUT=b.volume.inp\n*BOUNDARY\nCAP, 1, 3\n*STEP\n*STATIC\n"
        "*EL PRINT, ELSET=VOLUME, TOTALS=ONLY\nEMAS\n*END STEP\n"
    )
    done = subprocess.run([str(CCX), "job"], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout[-2000:]
    mass = float((tmp_path / "job.dat").read_text().splitlines()[3])
    # in t
    assert mass == pytest.approx(1e-6 * found["mass_g"], rel=1e-5)


@NEEDS_HXT
def test_one_of_several_materials_gets_the_density(tmp_path: Path, run: Run) -> None:
    nested_balls((10.0, 6.0), (3, 2), ("soft", "bone")).save(tmp_path / "s.vtp")
    write_sizing(tmp_path / "h.vti", lambda world: np.full(len(world), 2.0))
    write_nrrd(tmp_path / "ct.nrrd", np.full((14, 14, 14), 0.6, np.float32), **placed("LPS", np.eye(3), [-6.5] * 3))
    words = [
        "s.vtp",
        "--sizefield",
        "h.vti",
        "-o",
        "v.volume.vtu",
        "--solve",
        "no",
        "-q",
        "--export",
        "inp,feb",
        "--force",
    ]
    words += ["--density", "ct.nrrd", "--calibrate", "1,0", "--law", "6850,1.49"]
    done = run(*words, "--density-of", "bone")
    assert done.returncode == 0, done.stderr
    grid = pv.read(tmp_path / "v.volume.vtu")
    is_bone = np.asarray(grid.cell_data["region"]) == 2
    np.testing.assert_allclose(grid.cell_data["density"][is_bone], 0.6, rtol=1e-6)
    assert np.isnan(grid.cell_data["E"][~is_bone]).all()
    names = [m.get("name") for m in ElementTree.parse(tmp_path / "v.volume.feb").iterfind("Material/material")]
    assert names == ["bone_E1", "soft"]
    for more, text in (([], "without --density-of"), (["--density-of", "bones"], "--density-of bones")):
        refused = run(*words, *more)
        assert refused.returncode == 2
        assert text in refused.stderr
        assert "soft, bone" in refused.stderr
        assert "what to do" in refused.stderr


@NEEDS_HXT
def test_the_only_material_gets_the_density(tmp_path: Path, run: Run) -> None:
    nested_balls((10.0,), (3,), ("object",)).save(tmp_path / "s.vtp")
    write_nrrd(tmp_path / "ct.nrrd", np.full((24, 24, 24), 0.6, np.float32), **placed("LPS", np.eye(3), [-11.5] * 3))
    words = ["s.vtp", "-o", "v.vtu", "--solve", "no", "-q", "--density", "ct.nrrd", "--calibrate", "1,0"]
    done = run(*words, "--law", "6850,1.49")
    assert done.returncode == 0, done.stderr
    np.testing.assert_allclose(pv.read(tmp_path / "v.vtu").cell_data["density"], 0.6, rtol=1e-6)


# --- errors ---------------------------------------------------------------------------------------

DENSITY, CALIBRATE, LAW = ["--density", "ct.nrrd"], ["--calibrate", "0.001,0.1"], ["--law", "keller"]
WRONG = [
    ([*DENSITY, *LAW], "--density without --calibrate"),
    (DENSITY, "--density without --calibrate and --law"),
    ([*LAW, "--bins", "5"], "--law, --bins without --density"),
    ([*DENSITY, *CALIBRATE, "--law", "hooke"], "'hooke' is neither"),
    ([*DENSITY, *CALIBRATE, *LAW, "--bins", "0"], "'0' is not a whole number from 1"),
    ([*DENSITY, "--calibrate", "0.001,-5", *LAW], "the maximum density near the surface is -"),
    ([*DENSITY, *CALIBRATE, *LAW, "--density-of", "bone"], "the surface is that of one object"),
    (["--density", "far.nrrd", *CALIBRATE, *LAW], "100 % of the surface lies outside"),
    (["--density", "unnamed.nrrd", *CALIBRATE, *LAW], "has no anatomical frame"),
    (["--density", "nan.nrrd", *CALIBRATE, *LAW], "voxels are not finite"),
    (["--density", "missing.nrrd", *CALIBRATE, *LAW], "missing.nrrd"),
]


@pytest.mark.parametrize(("words", "text"), WRONG)
def test_wrong_input_is_refused_before_anything_is_filled(
    tmp_path: Path, run: Run, words: list[str], text: str
) -> None:
    surface = ball(9.0, 3)
    surface.add_field_data(['"Lps"'], "space")
    surface.save(tmp_path / "s.vtp")
    values = np.full((25, 25, 25), 500.0, np.float32)
    for name, at in (("ct", -12.0), ("far", 100.0)):
        write_nrrd(tmp_path / f"{name}.nrrd", values, **placed("LPS", np.eye(3), [at] * 3))
    write_nrrd(
        tmp_path / "unnamed.nrrd",
        values,
        space_dimension="3",
        **dict(list(placed("", np.eye(3), [-12.0] * 3).items())[1:]),
    )
    values[3, 4, 5] = np.nan
    write_nrrd(tmp_path / "nan.nrrd", values, **placed("LPS", np.eye(3), [-12.0] * 3))
    before = sorted(tmp_path.iterdir())
    done = run("s.vtp", "-o", "v.vtu", *words)
    assert done.returncode == 2
    assert text in done.stderr
    assert "why it matters" in done.stderr
    assert "what to do" in done.stderr
    assert sorted(tmp_path.iterdir()) == before


@NEEDS_HXT
def test_a_scan_of_a_part_warns_or_is_refused(tmp_path: Path, run: Run) -> None:
    ball(9.0, 3).save(tmp_path / "s.vtp")
    words = ["s.vtp", "-o", "v.vtu", "--method", "hxt", "--solve", "no", "--force", *DENSITY, *CALIBRATE, *LAW]
    values = np.full((19, 25, 25), 500.0, np.float32)
    write_nrrd(tmp_path / "ct.nrrd", values, **placed("LPS", np.eye(3), [-8.0, -12.0, -12.0]))
    done = run(*words)
    assert done.returncode == 0
    assert "tetrahedra lie partly outside the volume of --density" in done.stderr
    write_nrrd(tmp_path / "ct.nrrd", values, **placed("LPS", np.eye(3), [-4.0, -12.0, -12.0]))
    done = run(*words)
    assert done.returncode == 2
    assert "tetrahedra lie outside this volume" in done.stderr
    assert "what to do" in done.stderr
