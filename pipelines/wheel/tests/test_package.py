"""Tests of the Python package in the wheel."""

from __future__ import annotations

import contextlib
import doctest
import importlib
import importlib.util
import os
import pickle
import random
import subprocess
import sys
import textwrap
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import pytest
import pyvista

on_linux = pytest.mark.skipif(sys.platform != "linux", reason="signals, fork and /proc")
STAGES = ("distance_field", "size_field", "seed", "settle", "reconstruct")


@pytest.fixture(scope="session")
def iso(site: Path) -> ModuleType:
    sys.path.insert(0, str(site))
    return importlib.import_module("isoparticles")


@pytest.fixture(scope="session")
def field(iso: ModuleType) -> Any:
    return iso.distance_field(ball(), labels=1)


def ball(size: int = 18, radius: float = 5.5) -> np.ndarray:
    x, y, z = np.mgrid[:size, :size, :size] - (size - 1) / 2
    return (x**2 + y**2 + z**2 < radius**2).astype(np.uint8)


def halves() -> np.ndarray:
    labels = ball(20, 6.5)
    labels[10:] *= 2
    return labels


def tube() -> np.ndarray:
    """Return label 1 within 4 voxels of an axis along x, and label 2 within 7 voxels."""
    radius = np.hypot(*(np.mgrid[:20, :20] - 9.5))
    return np.tile(np.where(radius < 4, 1, np.where(radius < 7, 2, 0)).astype(np.uint8), (20, 1, 1))


def program(site: Path, folder: Path, *words: str) -> None:
    command = [str(site / "isoparticles" / "bin" / words[0]), *words[1:]]
    subprocess.run(command, cwd=folder, check=True, capture_output=True)


def script(site: Path, text: str, **more: Any) -> subprocess.CompletedProcess[str]:
    environment = {**os.environ, "PYTHONPATH": str(site)}
    command = [sys.executable, "-c", textwrap.dedent(text)]
    return subprocess.run(command, env=environment, capture_output=True, text=True, check=False, **more)


# --- The same results as those of the programs ---------------------------------------------------


def write_halves(folder: Path) -> None:
    image = pyvista.ImageData(dimensions=(20, 20, 20), spacing=(1.0, 0.8, 1.25))
    image.point_data["labels"] = halves().ravel(order="F")
    image.save(folder / "in.vti")


CASES: dict[str, tuple[dict[str, Any], list[str], dict[str, Any], list[str]]] = {
    "object": (
        {"iso": 100, "keep": "largest"},
        ["--iso", "100", "--keep", "largest"],
        {"uniform": 1.7},
        ["--uniform", "1.7"],
    ),
    "materials": (
        {"materials": {"left": 1, "right": [2]}, "size": {"left": 1.5}},
        ["--material", "left=1", "--material", "right=2", "--size", "left=1.5"],
        {"epsilon": 0.6, "min_size": 1.5, "size": {("left", "right"): 1.8}},
        ["--epsilon", "0.6", "--min-size", "1.5", "--size", "left/right=1.8"],
    ),
}


@pytest.mark.parametrize("case", CASES)
def test_files_are_those_of_the_programs(iso: ModuleType, site: Path, tmp_path: Path, case: str) -> None:
    options, words, sizes, size_words = CASES[case]
    made, told = tmp_path / "made", tmp_path / "told"
    made.mkdir()
    told.mkdir()
    if case == "object":
        program(site, told, "phantom", "ball", "--size", "20", "-o", "in.nrrd")
        source = told / "in.nrrd"
    else:
        write_halves(told)
        source = told / "in.vti"
    fields = ["--distfield", "distfield.vti", "--sizefield", "sizefield.vti"]
    program(site, told, "distfield", source.name, "-o", "distfield.vti", *words)
    program(site, told, "sizefield", "distfield.vti", "-o", "sizefield.vti", *size_words)
    program(site, told, "seed", "distfield.vti", "sizefield.vti", "-o", "seeds.bin", "--seed", "7")
    program(
        site, told, "particles", "seeds.bin", *fields, "-o", "particles.bin", "--backend", "cpu", "--max-passes", "40"
    )
    program(site, told, "reconstruct", "particles.bin", *fields, "-o", "surface.vtp", "--improve-below", "0.95")

    field = iso.distance_field(source, **options)
    size = iso.size_field(field, **sizes)
    seeds = iso.seed(field, size, seed=7)
    settled = iso.settle(seeds, field, size, backend="cpu", max_passes=40)
    surface = iso.reconstruct(settled, field, size, improve_below=0.95)
    for result in (field, size, seeds, settled, surface):
        result.save(made / result.name)
        assert (made / result.name).read_bytes() == (told / result.name).read_bytes(), result
        assert result.failed_checks == []
        assert result.report["outcome"] == "passed"
        assert iso.load(made / result.name).history == result.history
    if case == "materials":
        program(
            site,
            told,
            "reconstruct",
            "particles.bin",
            *fields,
            "-o",
            "surface.vtp",
            "--improve-below",
            "0.95",
            "--force",
            "--each",
            "each",
        )
        for whole in (surface, iso.load(made / surface.name)):
            own = whole.of("left")
            assert own.to_pyvista().is_manifold
            # the history of the program has the option --each
            written = iso.load(told / "each" / "left.vtp")
            assert own.meta == written.meta
            assert np.array_equal(own.vertices, written.vertices)
            assert np.array_equal(own.triangles, written.triangles)
            assert all(np.array_equal(own.arrays[name], array) for name, array in written.arrays.items())
            with pytest.raises(KeyError, match="middle"):
                whole.of("middle")


def test_mesh_uses_the_settings_of_a_case(iso: ModuleType, tmp_path: Path) -> None:
    result = iso.mesh(
        halves(),
        spacing=(1, 1, 1),
        materials={"left": 1, "right": 2},
        size=2,
        backend="cpu",
        threads=1,
        seed=3,
        name="two",
    )
    assert (
        result.field.history["command_line"]
        == "distfield array -o OUTPUT --scale-for-size 2 --material left=1 --material right=2"
    )
    assert result.result.history["inputs"][0]["path"] == "two.particles.bin"
    report = result.report
    assert set(report.stages) == {"distfield", "sizefield", "seed", "particles", "reconstruct"}
    assert report.stages["seed"]["parameters"]["seed"] == 3
    assert report.stages["seed"]["threads"] == 1
    assert result.surface is result.surface
    assert result.failed_checks == report.failed_checks == []
    assert not any(report.faults.values())
    assert report.quality.triangles == result.surface.n_cells
    assert 0.3 < report.quality.radius_ratio_min < report.quality.radius_ratio_mean <= 1
    assert [volume.name for volume in report.volumes] == ["left", "right"]
    for label, volume in enumerate(report.volumes, 1):
        assert volume.voxels_mm3 == (halves() == label).sum()
        # flat triangles with edges of 2 mm cut off 5 % of a ball of 6.5 mm radius
        assert volume.mesh_mm3 == pytest.approx(volume.field_mm3, rel=0.06)
    assert report.voxels_changed == report.stages["distfield"]["results"]["voxels_changed"] > 0
    result.save(tmp_path / "new")
    names = {file.name for file in (tmp_path / "new").iterdir()}
    assert names == {
        f"two.{end}" for end in ("distfield.vti", "sizefield.vti", "seeds.bin", "particles.bin", "surface.vtp")
    }
    with pytest.raises(FileExistsError, match=r"two\.distfield\.vti"):
        result.save(tmp_path / "new")
    result.save(tmp_path / "new", overwrite=True)
    assert result.result.materials == result.field.materials == ["outside", "left", "right"]


def test_updates_are_those_of_a_case(iso: ModuleType, scripts: Path, tmp_path: Path) -> None:
    write_halves(tmp_path)
    regions = ["ball:9.5,7.6,11.9,3=0.8", "ball:9.5,7.6,5,3=2.2"]
    words = ["surface", "in.vti", "--materials", "left:1,right:2", "--size", "1.4", "--backend", "cpu", "-q"]
    words += ["--scale", "0", "--name", "two", "-o", "out", "--resize", " ".join(regions)]
    subprocess.run([scripts / "isoparticles", *words], cwd=tmp_path, check=True)
    settings = {"materials": {"left": 1, "right": 2}, "size": 1.4, "scale": 0, "backend": "cpu", "name": "two"}
    first = iso.mesh(tmp_path / "in.vti", **settings)
    assert first.update() is first
    last = first.update(*regions)
    last.save(tmp_path / "new")
    folder = tmp_path / "out" / "two"
    for name in ("two.sizefield.vti", "updates/two.sizefield.vti"):
        assert (tmp_path / "new" / name).read_bytes() == (folder / name).read_bytes(), name
    # the histories differ: a case passes a log and a checkpoint to particles
    of_case = iso.load(folder / "two.surface.vtp")
    np.testing.assert_array_equal(of_case.vertices, last.result.vertices)
    np.testing.assert_array_equal(of_case.triangles, last.result.triangles)
    again = iso.mesh(tmp_path / "in.vti", **settings, resize=" ".join(regions))
    np.testing.assert_array_equal(again.result.vertices, last.result.vertices)
    opened = iso.Mesh.open(folder)
    np.testing.assert_array_equal(opened.size.array, last.size.array)
    # the state after the first region is the start of the second update
    np.testing.assert_array_equal(opened.update(regions[0]).result.vertices, last.update(regions[0]).result.vertices)
    assert set(map(tuple, first.result.vertices)) & set(map(tuple, last.result.vertices))
    first.save(folder, overwrite=True)
    assert not (folder / "updates" / "two.sizefield.vti").exists()
    # its junction curves would be taken from the surface, with their faults
    failed = iso.reconstruct(first.particles, first.field, first.size, min_radius_ratio=0.99)
    assert failed.failed_checks
    with pytest.raises(iso.Error, match="a check has failed"):
        iso.reconstruct(failed, first.field, last.size)


# --- Images --------------------------------------------------------------------------------------


def test_every_type_and_layout_gives_the_same_field(iso: ModuleType, field: Any) -> None:
    labels = ball()
    types = [
        f"{kind}{bits}" for kind in ("int", "uint", "float") for bits in (8, 16, 32, 64) if kind + str(bits) != "float8"
    ]
    types += ["bool", ">i2", ">f8", "<u4"]
    images = [labels.astype(name) for name in types]
    images += [np.asfortranarray(labels), labels[::-1, ::-1, ::-1], np.repeat(labels, 2, axis=1)[:, ::2]]
    for image in images:
        assert np.array_equal(iso.distance_field(image, labels=1).array, field.array), image.dtype
    tall = np.zeros((18, 18, 140), np.uint8)
    tall[..., 61:79] = labels
    tall[..., 121:139] = labels
    same = iso.distance_field(np.asfortranarray(tall), labels=1).array
    assert np.array_equal(iso.distance_field(tall, labels=1).array, same)
    assert field.array.shape == field.shape
    assert field.array.dtype == np.float32


def test_nan_counts_as_in_files(iso: ModuleType, field: Any, tmp_path: Path) -> None:
    labels = np.where(ball() == 1, 1.0, np.nan)
    image = pyvista.ImageData(dimensions=labels.shape)
    image.point_data["labels"] = labels.ravel(order="F")
    image.save(tmp_path / "in.vti")
    for given in (labels, tmp_path / "in.vti"):
        with pytest.warns(iso.MeshWarning, match="NaN and are treated as background"):
            assert np.array_equal(iso.distance_field(given, labels=1).array, field.array)
        with pytest.raises(iso.Error, match="voxels are NaN or infinite") as caught, pytest.warns(iso.MeshWarning):
            iso.distance_field(given, iso=0.5)
        assert caught.value.report["outcome"] == "error"


def test_axes_are_x_y_z_in_the_world(iso: ModuleType) -> None:
    box = np.zeros((10, 14, 18), np.uint8)
    box[3:7, 3:11, 3:15] = 1
    turn = np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1.0]])
    field = iso.distance_field(box, spacing=(1, 0.5, 2), origin=(10, 20, 30), direction=turn, labels=1)
    assert field.spacing.tolist() == [1, 0.5, 2]
    assert np.array_equal(field.direction, turn)
    inside = np.argwhere(field.array < 0)
    world = field.origin + (inside * field.spacing) @ field.direction.T
    given = np.array([10, 20, 30]) + (np.argwhere(box) * [1, 0.5, 2]) @ turn.T
    assert np.allclose(world.min(axis=0), given.min(axis=0))
    assert np.allclose(world.max(axis=0), given.max(axis=0))
    image = field.to_pyvista()
    assert np.allclose(image.points[np.asarray(image.point_data["signed_distance"]) < 0].min(axis=0), given.min(axis=0))
    with pytest.raises(ValueError, match="read-only"):
        field.array[0, 0, 0] = 1
    with pytest.raises(ValueError, match="read-only"):
        field.spacing[0] = 1


def test_arrays_are_cropped_and_downsampled_like_numpy(iso: ModuleType) -> None:
    x, y, z = np.mgrid[:21, :20, :19]
    scan = 6.5 - np.sqrt((x - 10) ** 2 + (y - 9.5) ** 2 / 4 + (z - 9) ** 2)
    labels = np.where(scan > 0, np.where(z > 9, 2, 5), 0).astype(np.uint8)
    world = {"spacing": (1, 0.5, 2), "origin": (10, 20, 30)}
    for image, choice in ((scan, {"iso": 0}), (labels, {"labels": [2, 5]})):
        cropped = iso.distance_field(image, **world, **choice, crop="voxels:4..17,..,4..")
        plain = iso.distance_field(image[4:18, :, 4:], spacing=(1, 0.5, 2), origin=(14, 20, 38), **choice)
        assert np.array_equal(cropped.array, plain.array)
        assert np.allclose(cropped.origin, plain.origin, rtol=0, atol=1e-9)
        blocks = image[:20, :, :18].reshape(10, 2, 20, 9, 2).transpose(0, 2, 3, 1, 4).reshape(10, 20, 9, 4)
        if image is scan:
            pooled = blocks.mean(axis=-1)
        else:  # of equally frequent labels, argmax takes the smallest
            counts = np.stack([(blocks == label).sum(axis=-1) for label in range(6)])
            pooled = counts.argmax(axis=0).astype(np.uint8)
        small = iso.distance_field(image, **world, **choice, downsample=(2, 1, 2))
        plain = iso.distance_field(pooled, spacing=(2, 0.5, 4), origin=(10.5, 20, 31), **choice)
        assert np.allclose(small.array, plain.array, rtol=0, atol=1e-5)
        assert np.allclose(small.origin, plain.origin, rtol=0, atol=1e-9)
        assert small.history["parameters"]["downsample"] == [2, 1, 2]
    mesh = iso.mesh(scan, **world, iso=0, crop="mm:..,..,..48", downsample=2, size=2, backend="cpu")
    assert mesh.result.vertices[:, 2].max() <= 48 + 2
    with pytest.raises(iso.Error, match="no voxel centre lies in the region"):
        iso.distance_field(scan, iso=0, crop="mm:99..,..,..")


def test_images_of_other_packages(iso: ModuleType, monkeypatch: pytest.MonkeyPatch) -> None:
    labels = ball()
    options = {"labels": 1}
    world = {"spacing": (1, 2, 3.0), "origin": (4, 5, 6.0)}
    wanted = iso.distance_field(labels, **world, **options)

    itk = type("Image", (), {"__module__": "SimpleITK.SimpleITK"})()
    itk.GetDimension, itk.GetNumberOfComponentsPerPixel = lambda: 3, lambda: 1
    itk.GetSpacing, itk.GetOrigin = lambda: world["spacing"], lambda: world["origin"]
    itk.GetDirection = lambda: (1, 0, 0, 0, 1, 0, 0, 0, 1.0)
    monkeypatch.setitem(sys.modules, "SimpleITK", SimpleNamespace(GetArrayViewFromImage=lambda _: labels.T))

    nifti = type("Nifti1Image", (), {"__module__": "nibabel.nifti1"})()
    nifti.dataobj = labels[..., None]
    # RAS, and metres
    nifti.affine = np.array([[-0.001, 0, 0, -0.004], [0, -0.002, 0, -0.005], [0, 0, 0.003, 0.006], [0, 0, 0, 1]])
    nifti.header = SimpleNamespace(get_xyzt_units=lambda: ("meter", "sec"))

    points = pyvista.ImageData(dimensions=labels.shape, **world)
    points.point_data["other"] = np.zeros((labels.size, 3))
    points.point_data["labels"] = labels.ravel(order="F")
    points.set_active_scalars("labels")
    cells = pyvista.ImageData(dimensions=np.array(labels.shape) + 1, spacing=world["spacing"], origin=(3.5, 4, 4.5))
    cells.cell_data["labels"] = labels.ravel(order="F")
    for image in (itk, nifti, points, cells):
        made = iso.distance_field(image, **options)
        assert np.array_equal(made.array, wanted.array), image
        assert np.allclose(made.origin, wanted.origin)
        assert np.allclose(made.spacing, wanted.spacing)
        with pytest.raises(TypeError, match="geometry of its own"):
            iso.distance_field(image, spacing=(1, 1, 1), **options)


def nibabel_image(labels: np.ndarray, affine: np.ndarray) -> Any:
    nifti = type("Nifti1Image", (), {"__module__": "nibabel.nifti1"})()
    nifti.dataobj, nifti.affine = labels, affine
    return nifti


@pytest.mark.parametrize("settings", [{"labels": "1,2"}, {"materials": ["left=1", "right=2"]}])
def test_ras_differs_from_lps_by_signs(iso: ModuleType, tmp_path: Path, settings: dict[str, Any]) -> None:
    """The image is oblique and left-handed; its world frame is RAS."""
    turn = np.array([[0.36, 0.48, -0.8], [-0.8, 0.6, 0.0], [-0.48, -0.64, -0.6]]).T
    affine = np.eye(4)
    affine[:3] = np.column_stack([turn * [1.0, 1.25, 0.75], [-40.5, 12.25, 7.0]])
    image, signs = nibabel_image(halves(), affine), np.array([-1.0, -1.0, 1.0])
    shared = {**settings, "size": 3.0, "backend": "cpu", "name": "ball"}
    made = {space: iso.mesh(image, space=space, **shared) for space in ("lps", "ras", "scanner")}
    assert [one.result.space for one in made.values()] == ["lps", "ras", "ras"]
    lps, ras, scanner = (one.result for one in made.values())
    assert np.array_equal(ras.vertices, lps.vertices * signs)
    assert np.array_equal(ras.triangles, lps.triangles)
    assert np.array_equal(scanner.vertices, ras.vertices)
    for name in set(lps.arrays) - {"vertices"}:
        expected = lps.arrays[name] * (signs if name.endswith("normal") else 1)
        assert np.array_equal(ras.arrays[name], expected), name
    assert made["ras"].report.volumes == made["lps"].report.volumes
    assert np.array_equal(made["ras"].particles.arrays["positions"], made["lps"].particles.arrays["positions"] * signs)
    assert ras.history["parameters"]["space"] == "ras"

    again = iso.reconstruct(*(getattr(made["lps"], one) for one in ("particles", "field", "size")), space="scanner")
    assert again.space == "ras"
    assert np.array_equal(again.vertices, ras.vertices)
    for ending in ("ply", "stl", "obj", "vtk"):
        for name, surface in (("lps", lps), ("ras", ras)):
            surface.save(tmp_path / f"{name}.{ending}")
        of_lps, of_ras = (pyvista.read(tmp_path / f"{name}.{ending}") for name in ("lps", "ras"))
        assert np.array_equal(of_ras.points, of_lps.points * signs), ending
        assert of_ras.volume > 0
        assert b"world frame RAS" in (tmp_path / f"ras.{ending}").read_bytes()[:512]

    pairs = [(made[name].result, made[name].size) for name in ("lps", "ras")]
    with pytest.warns(iso.MeshWarning, match="against the voxels"):
        grids = [iso.fill(*pair, method="hxt", solve="no").to_pyvista() for pair in pairs]
    assert np.array_equal(grids[1].points, grids[0].points * signs)
    # labels at the centroids, as nibabel finds them; the surface is half a voxel from the centres
    centres = np.asarray(grids[1].cell_centers().points)
    index = np.round((centres - affine[:3, 3]) @ np.linalg.inv(affine[:3, :3]).T).astype(int)
    found = halves()[tuple(index.T)]
    assert (found > 0).mean() > 0.95
    if "materials" in settings:
        assert (found == np.asarray(grids[1].cell_data["region"]))[found > 0].mean() > 0.95


def test_an_image_without_anatomical_space_has_no_ras(iso: ModuleType) -> None:
    with pytest.raises(iso.Error, match="names no anatomical space"):
        iso.distance_field(ball(), labels=1, space="ras")
    assert iso.distance_field(ball(), labels=1, space="scanner").space is None


def test_masks_by_name_are_the_folder_of_masks(iso: ModuleType, tmp_path: Path) -> None:
    left = ball().astype(bool)
    right = np.zeros_like(left)
    right[left.shape[0] // 2 :] = left[left.shape[0] // 2 :]
    for name, mask in (("left", left), ("right", right)):
        image = pyvista.ImageData(dimensions=mask.shape, spacing=(1, 2, 1.5))
        image.point_data["mask"] = mask.ravel(order="F").astype(np.uint8)
        image.save(tmp_path / f"{name}.vti")
    options = {"materials": ["right", "left"], "overlap": "listed"}
    with pytest.warns(iso.MeshWarning, match="overlap"):
        wanted = iso.distance_field(tmp_path, **options)
    with pytest.warns(iso.MeshWarning, match="overlap"):
        made = iso.distance_field({"left": left, "right": right}, spacing=(1, 2, 1.5), **options)
    assert made.materials == wanted.materials == ["outside", "right", "left"]
    assert np.array_equal(made.array, wanted.array)
    assert made.report["results"]["overlaps"] == wanted.report["results"]["overlaps"]
    with pytest.warns(iso.MeshWarning, match="overlap"):
        mixed = iso.distance_field(
            {"left": tmp_path / "left.vti", "right": pyvista.read(tmp_path / "right.vti")}, **options
        )
    assert np.array_equal(mixed.array, wanted.array)


@pytest.mark.parametrize(
    ("image", "more", "kind", "told"),
    [
        ({}, {}, ValueError, "no masks"),
        ({1: ball()}, {}, TypeError, "must be a text"),
        ({"a": np.arange(64).reshape(4, 4, 4)}, {}, Exception, "a: is not a mask"),
        (np.ma.masked_equal(ball(), 0), {}, TypeError, "filled"),
        (ball().astype(complex), {}, TypeError, "complex128"),
        (ball().astype(object), {}, TypeError, "object"),
        (ball().astype(str), {}, TypeError, "not supported"),
        (ball()[0], {}, ValueError, "three axes"),
        (ball()[None], {}, ValueError, "three axes"),
        (np.zeros((0, 5, 5)), {}, ValueError, "two voxels"),
        (ball()[:1], {}, ValueError, "two voxels"),
        (ball(), {"spacing": (1, np.nan, 1)}, ValueError, "spacing"),
        (ball(), {"spacing": (1, -1, 1)}, ValueError, "above 0"),
        (ball(), {"spacing": (1, 1)}, ValueError, "three numbers"),
        (ball(), {"spacing": "wide"}, TypeError, "numbers"),
        (ball(), {"spacing": (1, 1e7, 1)}, ValueError, "1e-09 to 1e"),
        (ball(), {"origin": (0, 0, np.inf)}, ValueError, "origin"),
        (ball(), {"direction": np.ones((3, 3)) / np.sqrt(3)}, ValueError, "singular"),
        (ball(), {"direction": np.eye(3) * 2}, ValueError, "unit vectors"),
        (ball(), {"direction": np.eye(2)}, ValueError, "3 x 3"),
        ([[[1]]], {}, TypeError, "builtins.list"),
        (None, {}, TypeError, "NoneType"),
        ("v.nrrd", {"origin": (1, 1, 1)}, TypeError, "only for arrays"),
        ("v.nrrd", {"spacing": (1, -1, 1)}, ValueError, "above 0"),
        ({"ball": "v.nrrd"}, {"spacing": (1, 1, 1)}, TypeError, "only for arrays"),
    ],
)
def test_images_that_are_refused(
    iso: ModuleType, image: Any, more: dict[str, Any], kind: type[Exception], told: str
) -> None:
    with pytest.raises(kind, match=told):
        iso.distance_field(image, labels=1, **more)


# --- Options and errors --------------------------------------------------------------------------


def test_options_become_words_in_their_order(iso: ModuleType) -> None:
    words = importlib.import_module("isoparticles._words").words_of
    assert words("distfield", {"scale": 2.0, "labels": range(1, 3), "keep_thin": True, "kind": None}) == [
        *("--scale", "2", "--labels", "1,2", "--keep-thin")
    ]
    assert words("distfield", {"materials": ["all", "lung=2"]}) == ["--material", "all", "--material", "lung=2"]
    assert words("distfield", {"material": {"a, b": np.uint8(2), "c": ["x y", 1]}}) == [
        *("--material", "a, b=2", "--material", "c=x y+1")
    ]
    assert words("distfield", {"iso": -0.1, "series": "-a"}) == ["--iso", "-0.1", "--series=-a"]
    assert words("sizefield", {"epsilon": -1, "refine": ("points:h.vtp",)}) == [
        "--epsilon=-1",
        "--refine",
        "points:h.vtp",
    ]
    assert words("sizefield", {"size": {"a": 1e-7, ("a", "b"): np.float32(0.5)}}) == [
        "--size",
        "a=1e-07",
        "--size",
        "a/b=0.5",
    ]
    assert words("seed", {"from_": "marching-cubes", "count": 5.0}) == ["--from", "marching-cubes", "--count", "5"]
    for factors in (2, "2", (2, 2, 2), np.array([2, 2, 2])):
        assert words("distfield", {"downsample": factors}) in (["--downsample", "2"], ["--downsample", "2,2,2"])
    assert words("tetmesh-check", {"helix": (-60, 60.5), "apex": np.zeros(3), "sheet": "0,0"}) == [
        *("--helix=-60,60.5", "--apex", "0,0,0", "--sheet", "0,0")
    ]
    assert words("distfield", {"crop": Path("a b.nrrd")}) == ["--crop", "a b.nrrd"]
    for given, kind in [
        ({"downsample": [2, None]}, TypeError),
        ({"materials": {"a=b": 1}}, ValueError),
        ({"materials": {"a/b": 1}}, ValueError),
        ({"materials": {"": 1}}, ValueError),
        ({"materials": {"a": ["1,2"]}}, ValueError),
        ({"materials": {"a": ["1+2"]}}, ValueError),
        ({"materials": {"a": []}}, ValueError),
        ({"materials": {1: 1}}, TypeError),
        ({"materials": {"a": 1}, "material": "all"}, TypeError),
        ({"labels": ["1,2"]}, ValueError),
        ({"labels": [True]}, TypeError),
        ({"iso": float("nan")}, ValueError),
        ({"keep_thin": 1}, TypeError),
        ({"inside": 3}, TypeError),
        ({"quiet": True}, TypeError),
        ({"report": "r.json"}, TypeError),
    ]:
        with pytest.raises(kind):
            words("distfield", given)
    with pytest.raises(ValueError, match="must not"):
        iso.mesh(ball(), materials={"a:b": 1})


def test_names_of_files_do_not_get_mixed_up(iso: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    image = pyvista.ImageData(dimensions=(18, 18, 18))
    image.point_data["labels"] = ball().ravel(order="F")
    for name in ("-q.vti", "distfield.vti"):
        image.save(tmp_path / name)
        field = iso.distance_field(name, labels=1)
        assert field.history["command_line"] == f"distfield {name} -o OUTPUT --labels 1"
        assert field.history["inputs"][0]["path"] == name
    (tmp_path / "a.b.vti").write_bytes((tmp_path / "-q.vti").read_bytes())
    assert iso.mesh(tmp_path / "a.b.vti", labels=1, size=2, backend="cpu").name == "a.b"
    error = pickle.loads(pickle.dumps(iso.Error("what", "why", "next", {"seconds": 2})))
    assert (error.what, error.why, error.next, error.report) == ("what", "why", "next", {"seconds": 2})


def test_errors_say_what_to_do(iso: ModuleType, field: Any, tmp_path: Path) -> None:
    with pytest.raises(iso.Error) as caught:
        iso.distance_field(ball(), labels=9)
    assert "array: " in caught.value.what
    assert str(caught.value) == (
        f"{caught.value.what}\n  why it matters: {caught.value.why}\n  what to do: {caught.value.next}"
    )
    report = caught.value.report
    assert report["error"] == {"what": caught.value.what, "why": caught.value.why, "next": caught.value.next}
    assert (report["tool"], report["exit_code"]) == ("distfield", 2)
    with pytest.raises(TypeError, match="did you mean 'labels'"):
        iso.distance_field(ball(), lables=1)
    with pytest.raises(TypeError, match="series: only"):
        iso.distance_field(ball(), labels=1, series="one")
    with pytest.raises(TypeError, match="did you mean 'vertices'"):
        iso.mesh(ball(), vertexes=100)
    with pytest.raises(TypeError, match="pass iso for a scan"):
        iso.mesh(ball(), vertices=100)
    with pytest.raises(iso.Error, match=r"none\.nrrd"):
        iso.distance_field(tmp_path / "none.nrrd", labels=1)
    with pytest.raises(iso.Error, match="above 0"):
        iso.size_field(field, epsilon=-1)
    with pytest.raises(iso.Error, match="cannot be used with"):
        iso.size_field(field, uniform=1, epsilon=1)
    with pytest.raises(iso.Error, match="--size left=2 for one object"):
        iso.size_field(field, size={"left": 2})
    with pytest.raises(iso.Error, match="both set"):
        iso.mesh(ball(), labels=1, iso=1)
    with pytest.raises(TypeError, match="field must be a DistanceField, not ndarray"):
        iso.size_field(ball())
    with pytest.raises(ValueError, match="also the name of an input"):
        iso.size_field(field, name=field.name)
    with pytest.raises(ValueError, match="without a folder"):
        iso.size_field(field, name="a/b")
    with pytest.raises(iso.Error, match="memory"):
        iso.distance_field(ball(), labels=1, max_memory="1K")
    with pytest.raises(TypeError):
        iso.DistanceField(3)


def test_options_module_is_up_to_date(iso: ModuleType) -> None:
    del iso
    path = Path(__file__).parents[1] / "make_options.py"
    spec = importlib.util.spec_from_file_location("make_options", path)
    assert spec is not None
    assert spec.loader is not None
    made = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(made)
    written = path.parent / "src" / "isoparticles" / "_options.py"
    assert made.module() == written.read_text(encoding="utf-8"), "run make_options.py"


def test_bad_arguments_raise_python_exceptions(iso: ModuleType, field: Any) -> None:
    generator = random.Random(1)
    values = [
        None,
        True,
        -1,
        0,
        3,
        10**30,
        0.5,
        -0.0,
        1e308,
        float("inf"),
        "",
        "a",
        "--help",
        "-q",
        "\0",
        "\ud800",
        b"x",
        [],
        [1, "a"],
    ]
    values += [
        {},
        {"a": 1},
        {1: 2},
        (1, 2, 3),
        np.float32(2),
        np.arange(3),
        np.array(1),
        object(),
        ball(),
        field,
        print,
        "all",
        "1,2",
    ]
    names = [
        "labels",
        "iso",
        "materials",
        "scale",
        "margin",
        "keep",
        "spacing",
        "crop",
        "downsample",
        "origin",
        "direction",
        "name",
        "progress",
        "threads",
        "seed",
        "max_memory",
    ]
    size = iso.size_field(field, uniform=2)
    images = [ball(6, 2), ball(6, 2).astype(float), *values]
    for _ in range(400):
        function = generator.choice([*STAGES, "mesh", "load"])
        inputs = [generator.choice([field, size, *values]) for _ in range(generator.randrange(4))]
        if function in ("distance_field", "mesh"):
            inputs = [generator.choice(images)]
        given = {name: generator.choice(values) for name in generator.sample(names, generator.randrange(4))}
        with contextlib.suppress(TypeError, ValueError, KeyError, iso.Error):
            getattr(iso, function)(*inputs, **given)


# --- Runs ----------------------------------------------------------------------------------------


LONG = """
    import isoparticles as iso, numpy as np, os, signal, threading, time
    x, y, z = np.mgrid[:40, :40, :40] - 19.5
    field = iso.distance_field(15 - np.sqrt(x**2 + y**2 + z**2), iso=0)
    size = iso.size_field(field, uniform=0.6)
    seeds = iso.seed(field, size)
    long = dict(backend="cpu", max_passes=10**6, energy_tolerance=0, levels=1)
"""


@on_linux
def test_ctrl_c_stops_a_run(site: Path) -> None:
    text = (
        LONG
        + """
    # a shell without job control lets the processes behind `&` ignore SIGINT
    signal.signal(signal.SIGINT, signal.default_int_handler)
    threading.Timer(1, os.kill, (os.getpid(), signal.SIGINT)).start()
    try:
        iso.settle(seeds, field, size, **long)
    except KeyboardInterrupt:
        print("stopped")
    print(len(iso.settle(seeds, field, size, backend="cpu")) > 1000)
    """
    )
    done = script(site, text, timeout=60)
    assert done.stdout.split() == ["stopped", "True"], done.stderr


def test_an_exception_of_the_callback_stops_a_run(iso: ModuleType) -> None:
    namespace: dict[str, Any] = {}
    exec(textwrap.dedent(LONG), namespace)
    calls: list[tuple[Any, ...]] = []

    def stop(*state: Any) -> None:
        calls.append(state)
        if len(calls) == 3:
            raise LookupError("enough")

    started = time.monotonic()
    with pytest.raises(LookupError, match="enough"):
        iso.settle(namespace["seeds"], namespace["field"], namespace["size"], progress=stop, **namespace["long"])
    assert time.monotonic() - started < 10
    assert len(calls) == 3
    stage, step, done, total, message = calls[-1]
    assert (stage, step) == ("particles", "pass")
    assert 0 <= done <= total
    assert "particles" in message


@pytest.mark.parametrize("has_rich", [True, False])
def test_progress_is_drawn_and_removed(
    iso: ModuleType, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, has_rich: bool
) -> None:
    monkeypatch.setenv("FORCE_COLOR", "1")  # rich draws no bar into a file
    if not has_rich:
        monkeypatch.setitem(sys.modules, "rich.progress", None)
    iso.mesh(ball(), labels=1, size=2, backend="cpu", progress=True)
    drawn = capsys.readouterr().err
    assert "distfield: " in drawn
    assert ("\x1b[" in drawn) == has_rich
    iso.distance_field(ball(), labels=1, progress=False)
    assert capsys.readouterr().err == ""
    with pytest.raises(TypeError, match="progress must be"):
        iso.distance_field(ball(), labels=1, progress="bar")


def test_warnings_point_to_the_caller(iso: ModuleType) -> None:
    with pytest.warns(iso.MeshWarning, match="mask of two values") as caught:
        iso.mesh(ball(), iso=0.5, size=2, backend="cpu")
    assert {warning.filename for warning in caught} == {__file__}


def test_threads_run_in_parallel(iso: ModuleType, field: Any) -> None:
    with ThreadPoolExecutor(8) as pool:
        fields = list(pool.map(lambda _: iso.distance_field(ball(), labels=1), range(24)))
    assert all(np.array_equal(one.array, field.array) for one in fields)
    sizes = [iso.size_field(field, threads=threads).array for threads in (1, 3)]
    assert np.array_equal(*sizes)


@on_linux
def test_a_child_after_a_fork_does_not_hang(site: Path) -> None:
    text = """
        import isoparticles as iso, numpy as np, os, signal
        labels = np.zeros((12, 12, 12), np.uint8)
        labels[3:9, 3:9, 3:9] = 1
        before = iso.distance_field(labels, labels=1)
        child = os.fork()
        if child == 0:
            signal.alarm(20)
            size = iso.size_field(before, uniform=2)
            size.save(os.devnull, overwrite=True)
            os._exit(0 if np.array_equal(iso.distance_field(labels, labels=1).array, before.array) else 1)
        print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), iso.size_field(before, uniform=2))
    """
    done = script(site, text, timeout=60)
    assert done.stdout.startswith("0 <SizeField 'sizefield.vti': "), done.stderr


def test_results_come_back_from_files(iso: ModuleType, field: Any, tmp_path: Path) -> None:
    size = iso.size_field(field, uniform=1.5)
    seeds = iso.seed(field, size)
    settled = iso.settle(seeds, field, size, backend="cpu", max_passes=5)
    surface = iso.reconstruct(settled, field, size)
    for result in (field, size, seeds, settled, surface):
        path = tmp_path / result.name
        result.save(path)
        with pytest.raises(FileExistsError, match="overwrite=True"):
            result.save(path)
        back = iso.load(str(path))
        assert type(back) is type(result)
        assert (back.meta, back.history, back.report) == (result.meta, result.history, None)
        assert back.arrays.keys() == result.arrays.keys()
        assert all(np.array_equal(back.arrays[name], array) for name, array in result.arrays.items())
        assert not any(array.flags.writeable for array in result.arrays.values())
        back.save(path, overwrite=True)
        assert iso.load(path).history == result.history
        assert result.name in repr(result)
    again = iso.reconstruct(
        *(iso.load(tmp_path / name) for name in ("particles.bin", "distfield.vti", "sizefield.vti"))
    )
    assert again.history == surface.history
    assert np.array_equal(again.triangles, surface.triangles)
    assert iso.load(tmp_path / "surface.vtp").to_pyvista().is_manifold
    assert len(settled) == settled.to_pyvista().n_points == len(settled.sizes)
    for name in ("surface.ply", "surface.stl"):
        surface.save(tmp_path / name)
    with pytest.raises(iso.Error, match=r"\.xyz"):
        surface.save(tmp_path / "surface.xyz")
    (tmp_path / "text.vti").write_text("no image")
    with pytest.raises(iso.Error, match=r"text\.vti"):
        iso.load(tmp_path / "text.vti")
    points = iso.reconstruct(settled, None, method="tight-cocone")
    assert len(points.vertices) > 50
    with pytest.raises(ValueError, match="tight-cocone"):
        iso.reconstruct(settled, None)


def test_surfaces_are_filled_with_tetrahedra(iso: ModuleType, tmp_path: Path) -> None:
    pytest.importorskip("gmsh")
    steps: list[str] = []
    watch = {"progress": lambda *state: steps.append(f"{state[0]} {state[1]}")}
    made = iso.mesh(ball(), labels=1, size=2.5, name="ball", **watch)
    with pytest.warns(iso.MeshWarning, match="the volume changes by"):
        filled = iso.fill(made.result, made.size, method="hxt", solve="no", **watch)
    assert {"tetmesh-check read", "tetmesh-check tetrahedralize"} <= set(steps)
    assert filled.failed_checks == []
    grid = filled.to_pyvista()
    assert grid.n_cells > 100
    assert grid["min_dihedral"].min() > 5
    filled.save(tmp_path / "volume.vtu")
    with pytest.raises(FileExistsError):
        filled.save(tmp_path / "volume.vtu")
    # the program makes the same file
    made.result.save(tmp_path / made.result.name)
    made.size.save(tmp_path / made.size.name)
    words = [made.result.name, "--sizefield", made.size.name, "-o", "volume.vtu", "--method", "hxt", "--solve", "no"]
    command = [sys.executable, "-m", "tetmesh_check", *words, "--quiet", "--force"]
    subprocess.run(command, cwd=tmp_path, check=True, capture_output=True)
    again = tmp_path / "again.vtu"
    filled.save(again)
    assert again.read_bytes() == (tmp_path / "volume.vtu").read_bytes()
    assert iso.fill(made.result, made.size, method="hxt", solve="no", min_dihedral=69).failed_checks
    steps.clear()
    assert made.tetrahedra.n_cells > 100
    assert "tetmesh-check solve" in steps
    assert filled.quadratic is None
    second = iso.fill(
        made.result, made.size, made.field, order=2, name="ball.volume.vtu", method="hxt", solve="no"
    ).quadratic
    assert second.name == "ball.volume.quadratic.vtu"
    assert set(second.to_pyvista().celltypes) == {pyvista.CellType.QUADRATIC_TETRA}
    with pytest.raises(iso.Error, match="invalid choice") as caught:
        iso.fill(made.result, method="none")
    assert caught.value.report is None
    with pytest.raises(iso.Error, match="of memory") as caught:
        iso.fill(made.result, max_memory="1K")
    assert caught.value.report["error"]["what"] == caught.value.what
    with pytest.raises(iso.Error, match="--order 2"):
        iso.fill(made.result, order=2)
    with pytest.raises(LookupError):
        iso.fill(made.result, progress=lambda *state: {}[state])
    with pytest.raises(TypeError, match="did you mean 'method'"):
        iso.fill(made.result, metod="hxt")
    with pytest.raises(TypeError, match="surface must be a Surface"):
        iso.fill(made.size)
    with pytest.raises(ValueError, match=r"ends with \.vtu"):
        iso.fill(made.result, name="volume.stl")


@pytest.mark.parametrize(
    ("chosen", "radii"),
    [
        ({"labels": [1, 2]}, {"object": (0, 7)}),
        ({"materials": {"lumen": 1, "wall": 2}}, {"lumen": (0, 4), "wall": (4, 7)}),
    ],
)
def test_planes_end_labels_and_materials(
    iso: ModuleType, chosen: dict[str, Any], radii: dict[str, tuple[int, int]]
) -> None:
    point, normal = np.array([13, 9.5, 9.5]), np.array([2, 1, 0]) / np.sqrt(5)
    cut = "plane:13,9.5,9.5,2,1,0=outlet"
    field = iso.distance_field(tube(), border="flat", cut=[cut], **chosen)
    assert field.materials == ["outside", *radii, "outlet", "x0", "x1"]
    size = iso.size_field(field, uniform=1.2)
    settled = iso.settle(iso.seed(field, size), field, size, backend="cpu")
    surface = iso.reconstruct(settled, field, size)
    assert surface.failed_checks == []
    assert surface.materials == ["outside", *radii]
    assert surface.meta["caps"] == ["outlet", "x0", "x1"]
    triangles, caps = surface.to_pyvista(), surface.cell_arrays["cap"]
    assert set(caps) == {0, 1, 2}
    corners = surface.vertices[surface.triangles]
    assert np.abs((corners[caps == 1] - point) @ normal).max() < 1e-6
    assert np.abs(corners[caps == 2][..., 0] + 0.5).max() < 1e-6
    areas = triangles.compute_cell_sizes()["Area"]
    for number, (name, (inner, outer)) in enumerate(radii.items(), 1):
        assert surface.of(name).to_pyvista().is_manifold
        across = np.pi * (outer**2 - inner**2)
        for plane, exact in ((1, across / normal[0]), (2, across)):
            own = (caps == plane) & (surface.cell_arrays["material_inside"] == number)
            assert areas[own].sum() == pytest.approx(exact, rel=0.05)
    with pytest.raises(KeyError, match="outlet"):
        surface.of("outlet")


def test_a_mesh_that_ends_at_planes_is_filled(iso: ModuleType) -> None:
    pytest.importorskip("gmsh")
    cut = "--cut plane:13,9.5,9.5,2,1,0=outlet"
    made = iso.mesh(tube(), labels=[1, 2], border="flat", size=2, distfield_options=cut, backend="cpu")
    filled = iso.fill(made.result, made.size, made.field, order=2, method="hxt", solve="no")
    assert filled.failed_checks == []
    parts = [part["name"] for part in filled.report["results"]["boundary"]["parts"]]
    assert parts == ["object_to_outside", "object_cap_outlet_1", "object_cap_x0_1"]
    assert filled.report["results"]["quadratic"]["not_on_surface"] == 0
    with pytest.raises(TypeError, match="pass distfield_options='--cut "):
        iso.mesh(tube(), labels=1, cut="plane:13,9.5,9.5,2,1,0")
    with pytest.raises(iso.Error, match="the plane meets no material") as caught:
        iso.distance_field(tube(), labels=1, cut="plane:99,0,0,1,0,0")
    assert caught.value.next


def test_a_wall_gets_fibres(iso: ModuleType) -> None:
    pytest.importorskip("gmsh")
    pytest.importorskip("pyamg")
    x, y, z = np.indices((26, 26, 22))
    radius = np.linalg.norm([x - 12.5, y - 12.5, (z - 21.5) / 1.6], axis=0)
    labels = np.where(radius < 6.0, 1, np.where(radius < 10.5, 2, 0)).astype(np.uint8)
    made = iso.mesh(labels, materials={"blood": 1, "wall": 2}, size=2.5, backend="cpu", name="heart")
    given = {"fibres": "wall", "endo": "endo", "epi": "wall/outside - caps", "base": "caps", "solve": "no"}
    options = {**given, "set": "endo = wall/blood", "helix": (60, -60)}
    filled = iso.fill(made.result, made.size, **options)
    grid = filled.to_pyvista()
    lengths = np.linalg.norm(grid.cell_data["fibre"], axis=1)
    np.testing.assert_allclose(lengths, np.asarray(grid.cell_data["region"]) == 2, atol=1e-12)
    assert filled.report["parameters"]["fibres"]["helix"] == [60, -60]
    with pytest.raises(iso.Error, match="--fibres without --base") as caught:
        iso.fill(made.result, made.size, **{**options, "base": None})
    assert "add these options" in caught.value.next


def test_surfaces_of_other_programs_are_loaded(iso: ModuleType, tmp_path: Path) -> None:
    pyvista.Sphere().save(tmp_path / "sphere.vtp")
    sphere = iso.load(tmp_path / "sphere.vtp")
    assert len(sphere.vertices) > 100
    assert sphere.failed_checks == []


def test_data_of_pyvista_are_copies(iso: ModuleType, field: Any) -> None:
    made = iso.mesh(ball(), labels=np.array([1]), size=2.5)
    made.surface["h"][:] = 0
    made.particles.to_pyvista()["sizes"][:] = 0
    field.to_pyvista()["signed_distance"][:] = 9
    assert made.result.point_arrays["h"].min() > 0
    assert made.particles.sizes.min() > 0
    assert field.array.min() < 0


def test_mesh_takes_materials_as_texts_and_refuses_files(iso: ModuleType) -> None:
    made = iso.mesh(halves(), materials=["left:1", "right:2"], size=3)
    assert made.result.materials == ["outside", "left", "right"]
    with pytest.raises(ValueError, match="--log: is not an option of particles"):
        iso.mesh(ball(), labels=1, particles_options="--log passes.csv")


def test_failed_checks_are_results(iso: ModuleType, field: Any, tmp_path: Path) -> None:
    size = iso.size_field(field, uniform=1.5)
    with pytest.warns(iso.MeshWarning, match="instead of settled particles"):
        surface = iso.reconstruct(iso.seed(field, size), field, size, min_radius_ratio=0.999)
    assert surface.failed_checks
    assert surface.report["outcome"] == "checks_failed"
    assert surface.report["failed_checks"] == surface.failed_checks
    assert "failed checks" in repr(surface)
    surface.save(tmp_path / "surface.vtp")
    assert (tmp_path / "surface.offending.vtp").is_file()


@on_linux
def test_memory_does_not_grow(iso: ModuleType) -> None:
    """Make CALLS calls; 10,000 take a minute on two cores and add less than 1 MiB."""
    labels = ball(12, 4)
    calls = int(os.environ.get("CALLS", "1000"))

    def resident() -> int:
        return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")

    def call_six() -> None:
        field = iso.distance_field(labels, labels=1)
        size = iso.size_field(field, uniform=2)
        seeds = iso.seed(field, size)
        settled = iso.settle(seeds, field, size, backend="cpu", max_passes=2, levels=1)
        surface = iso.reconstruct(settled, field, size)
        assert len(surface.vertices) >= len(settled.positions)
        with pytest.raises(iso.Error):
            iso.distance_field(labels, labels=7)

    for _ in range(20):
        call_six()
    before = resident()
    for _ in range(calls // 6):
        call_six()
    assert resident() - before < 8 << 20


def test_the_package_is_light(site: Path) -> None:
    text = """
        import sys, isoparticles
        assert not {"numpy", "pyvista", "isoparticles._native"} & set(sys.modules)
        assert set(isoparticles.__all__) <= set(dir(isoparticles))
        isoparticles.distance_field
        assert "pyvista" not in sys.modules
        try:
            isoparticles.nothing
        except AttributeError:
            print("fine")
    """
    assert script(site, text).stdout == "fine\n"


@pytest.mark.parametrize("name", ["isoparticles", "isoparticles._stages", "isoparticles._api", "isoparticles._mesh"])
def test_examples_of_the_docstrings(iso: ModuleType, name: str) -> None:
    del iso
    failed, attempted = doctest.testmod(importlib.import_module(name))
    assert attempted > 0
    assert failed == 0
