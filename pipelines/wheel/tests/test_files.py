"""Tests of HDF5, MATLAB and Zarr files."""

from __future__ import annotations

import gzip
import json
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import isoparticles as iso
from isoparticles import _files, _native
from isoparticles._files import Given, Grid, Limits, opened

h5py = pytest.importorskip("h5py")
zarr = pytest.importorskip("zarr")
scipy_io = pytest.importorskip("scipy.io")

DATA = Path(__file__).parent / "data"
VALUES = np.arange(8 * 6 * 4, dtype=np.uint16).reshape(8, 6, 4)
UM = 1e-3


def read(path: Path, dataset: str | None = None, spacing: Any = None) -> tuple[Grid, NDArray[Any]]:
    given = Given(None if spacing is None else np.array(spacing, dtype=float))
    with opened(str(path), dataset, given, Limits()) as (grid, slabs):
        return grid, np.concatenate(list(slabs), axis=2)


def spacing_of(grid: Grid) -> list[float]:
    lengths: list[float] = np.linalg.norm(grid.steps, axis=0).tolist()
    return lengths


@pytest.mark.parametrize(
    ("name", "dataset", "spacing", "origin"),
    [
        ("ome_zarr_04.ome.zarr", "s0:c=0", (UM, 2 * UM, 3 * UM), (0, 0, 0)),
        ("ome_zarr_05.ome.zarr", "s0:c=0", (UM, 2 * UM, 3 * UM), (0, 0, 0)),
        ("ome_zarr_05.ome.zarr/s0", ":c=0", (UM, 2 * UM, 3 * UM), (0, 0, 0)),
        ("ngff_zarr_04.ome.zarr", None, (1, 2, 3), (10, 20, 30)),
        ("ngff_zarr_05.ome.zarr", "scale0/image", (1, 2, 3), (-10, -20, 30)),
        ("hdf5storage.mat", None, (1, 1, 1), (0, 0, 0)),
    ],
)
def test_files_of_other_programs_are_read(name: str, dataset: str | None, spacing: Any, origin: Any) -> None:
    if name == "hdf5storage.mat":
        with pytest.warns(iso.MeshWarning, match="1 mm is assumed"):
            grid, values = read(DATA / name, dataset)
    else:
        grid, values = read(DATA / name, dataset)
    assert np.array_equal(values, VALUES)
    assert spacing_of(grid) == pytest.approx(spacing)
    assert grid.origin == pytest.approx(origin)
    # ngff-zarr has written this file as RAS
    assert grid.is_lps == (name == "ngff_zarr_05.ome.zarr")
    assert np.sign(np.diag(grid.steps)).tolist() == ([-1, -1, 1] if grid.is_lps else [1, 1, 1])


def test_a_level_has_its_own_spacing_and_origin() -> None:
    for name in ("ome_zarr_04.ome.zarr", "ome_zarr_05.ome.zarr"):
        grid, values = read(DATA / name, "s1:c=1")
        assert values.shape == (4, 3, 4)
        assert spacing_of(grid) == pytest.approx([2 * UM, 4 * UM, 3 * UM])
        assert grid.origin == pytest.approx([0.5 * UM, UM, 0])


def test_labels_of_ome_zarr_have_names() -> None:
    for name in ("ome_zarr_04.ome.zarr", "ome_zarr_05.ome.zarr"):
        grid, values = read(DATA / name, "labels/organs")
        assert np.array_equal(values, VALUES % 3)
        assert sorted(grid.names) == [("liver", 1), ("spleen", 2)]


@pytest.mark.parametrize(
    ("name", "dataset", "told"),
    [
        ("ome_zarr_05.ome.zarr", None, "has 2 values on the axis c"),
        ("ome_zarr_05.ome.zarr", "s0:c=2", "c (0 to 1); c=2 was given"),
        ("ome_zarr_05.ome.zarr", "3", "choose it as the dataset: labels/organs, s0, s1"),
        ("ome_zarr_05.ome.zarr", "../ome_zarr_04.ome.zarr/s0", "contains no array"),
        ("hdf5storage.mat", "title", "choose it as the dataset: volume"),
    ],
)
def test_names_without_a_volume_are_refused(name: str, dataset: str | None, told: str) -> None:
    with pytest.raises(iso.Error) as error:
        read(DATA / name, dataset)
    assert told in str(error.value)


def write_hdf5(path: Path, array: NDArray[Any], labels: str = "", **attributes: Any) -> Path:
    with h5py.File(path, "w") as file:
        dataset = file.create_dataset("volume", data=array, chunks=True, compression="gzip")
        dataset.attrs.update(attributes)
        for dimension, label in zip(dataset.dims, labels, strict=False):
            dimension.label = label
    return path


def test_axes_of_hdf5_are_z_y_x_unless_they_have_names(tmp_path: Path) -> None:
    path = write_hdf5(tmp_path / "a.h5", VALUES.T, element_size_um=[3.0, 2.0, 1.0])
    grid, values = read(path)
    assert np.array_equal(values, VALUES)
    assert spacing_of(grid) == pytest.approx([UM, 2 * UM, 3 * UM])
    path = write_hdf5(tmp_path / "b.h5", VALUES, "xyz", element_size_um=[3.0, 2.0, 1.0])
    grid, values = read(path)
    assert np.array_equal(values, VALUES)
    assert spacing_of(grid) == pytest.approx([UM, 2 * UM, 3 * UM])
    tags = json.dumps({"axes": [{"key": key, "typeFlags": 2, "resolution": 0} for key in "tzyxc"]})
    path = write_hdf5(tmp_path / "c.h5", VALUES.T[np.newaxis, ..., np.newaxis], axistags=tags)
    assert np.array_equal(read(path, spacing=[1, 1, 1])[1], VALUES)
    path = write_hdf5(tmp_path / "d.h5", VALUES.T[..., np.newaxis])
    assert np.array_equal(read(path, "/volume", [1, 1, 1])[1], VALUES)


def test_an_array_of_hdf5_is_chosen_by_its_path(tmp_path: Path) -> None:
    path = tmp_path / "many.h5"
    with h5py.File(path, "w") as file:
        file["raw/a"] = VALUES.T
        file["raw/b"] = VALUES.T + 1
        file["table"] = np.zeros((4, 4))
        file["colour"] = np.zeros((4, 4, 4, 3))
        file["complex"] = np.zeros((4, 4, 4), complex)
        file["text"] = "scan"
    assert np.array_equal(read(path, "/raw/b", [1, 1, 1])[1], VALUES + 1)
    for name, told in (
        (None, "several arrays with three axes"),
        ("raw", "choose it as the dataset: /colour, /raw/a, /raw/b"),
        ("colour", "does not have three axes"),
        ("complex", "has the type complex128"),
        ("table", "does not have three axes"),
        ("text", "has the type object"),
    ):
        with pytest.raises(iso.Error) as error:
            read(path, name)
        assert told in str(error.value)


@pytest.mark.parametrize("kind", ["bool", "int8", ">u2", "uint32", "int64", "float16", ">f4", "float64"])
def test_all_types_keep_their_values(kind: str, tmp_path: Path) -> None:
    values = (VALUES % 100).astype(kind)
    _, own = read(write_hdf5(tmp_path / "a.h5", values.T), spacing=[1, 1, 1])
    assert np.array_equal(own, values)
    if kind not in ("bool", "float16"):
        scipy_io.savemat(tmp_path / "a.mat", {"v": values})
        assert np.array_equal(read(tmp_path / "a.mat", spacing=[1, 1, 1])[1], values)
    for version in (2, 3):
        zarr.save_array(str(tmp_path / f"a{version}.zarr"), values.T, zarr_format=version)
        assert np.array_equal(read(tmp_path / f"a{version}.zarr", spacing=[1, 1, 1])[1], values)


@pytest.mark.parametrize("compressed", [False, True])
def test_variables_of_matlab_5_are_x_y_z(compressed: bool, tmp_path: Path) -> None:
    path = tmp_path / "a.mat"
    variables = {
        "scan": VALUES.astype(float),
        "mask": VALUES > 7,
        "slices": VALUES[:, :, np.newaxis, :],
        "complex": VALUES * 1j,
        "name": "x",
        "cells": {"v": VALUES},
    }
    scipy_io.savemat(path, variables, do_compression=compressed)
    grid, values = read(path, "scan", [1, 2, 3])
    assert np.array_equal(values, VALUES)
    assert grid.dtype == "float64"
    assert spacing_of(grid) == [1, 2, 3]
    assert np.array_equal(read(path, "mask", [1, 1, 1])[1], VALUES > 7)
    assert np.array_equal(read(path, "slices", [1, 1, 1])[1], VALUES)
    for name, told in ((None, "several variables"), ("cells", "no variable 'cells'"), ("complex", "is complex")):
        with pytest.raises(iso.Error) as error:
            read(path, name, [1, 1, 1])
        assert told in str(error.value)


def test_chunks_may_be_cut_sharded_or_missing(tmp_path: Path) -> None:
    codecs = zarr.codecs
    for name, options in (
        ("blosc", {"chunks": (3, 4, 5), "compressors": codecs.BloscCodec()}),
        ("gzip", {"chunks": (3, 4, 5), "compressors": codecs.GzipCodec()}),
        ("sharded", {"chunks": (2, 3, 4), "shards": (4, 6, 8)}),
    ):
        array = zarr.create_array(str(tmp_path / name), shape=VALUES.T.shape, dtype="u2", fill_value=9, **options)
        array[:2] = VALUES.T[:2]
        expected = np.where(np.arange(4) < 2, VALUES, 9)
        assert np.array_equal(read(tmp_path / name, spacing=[1, 1, 1])[1], expected)


def image(path: Path, axes: Any, transforms: Any, shared: Any = ()) -> Path:
    group = zarr.open_group(str(path), mode="w", zarr_format=3)
    group.create_array("0", data=VALUES.T)
    level = {"path": "0", "coordinateTransformations": transforms}
    levels = {"axes": axes, "datasets": [level], "coordinateTransformations": list(shared)}
    group.attrs["ome"] = {"version": "0.5", "multiscales": [levels]}
    return path


def axes_with(unit: str | None) -> list[dict[str, str]]:
    return [{"name": name, "type": "space", **({"unit": unit} if unit else {})} for name in "zyx"]


def test_transformations_are_applied_in_their_order(tmp_path: Path) -> None:
    own = [{"type": "scale", "scale": [3, 2, 1]}, {"type": "translation", "translation": [30, 20, 10]}]
    shared = [{"type": "scale", "scale": [2, 2, 2]}]
    grid, _ = read(image(tmp_path / "a.zarr", axes_with("centimeter"), own, shared))
    assert spacing_of(grid) == pytest.approx([20, 40, 60])
    assert grid.origin == pytest.approx([200, 400, 600])


def test_lengths_without_units_are_mm_or_replaced(tmp_path: Path) -> None:
    own = [{"type": "scale", "scale": [3, 2, 1]}, {"type": "translation", "translation": [30, 20, 10]}]
    path = image(tmp_path / "a.zarr", axes_with(None), own)
    with pytest.warns(iso.MeshWarning, match="no unit of length"):
        grid, _ = read(path)
    assert (spacing_of(grid), grid.origin.tolist()) == ([1, 2, 3], [10, 20, 30])
    grid, _ = read(path, spacing=[0.5, 1, 1.5])
    assert (spacing_of(grid), grid.origin.tolist()) == ([0.5, 1, 1.5], [5, 10, 15])


@pytest.mark.parametrize(
    ("axes", "transforms", "told"),
    [
        (axes_with("furlong"), [{"type": "scale", "scale": [1, 1, 1]}], "the unit of the axis z is furlong"),
        (axes_with("meter"), [{"type": "scale", "scale": [1, 1]}], "2 numbers for 3 axes"),
        (axes_with("meter"), [{"type": "affine", "affine": []}], "type affine"),
        (axes_with("meter"), [{"type": "scale", "scale": [0, 1, 1]}], "spacing must be from"),
        (axes_with("meter"), [{"type": "scale", "scale": [float("nan"), 1, 1]}], "spacing must be from"),
        (["z", "y", "x"], [], "only the versions 0.4 and 0.5"),
    ],
)
def test_metadata_that_is_not_understood_is_refused(axes: Any, transforms: Any, told: str, tmp_path: Path) -> None:
    path = image(tmp_path / "a.zarr", axes, transforms)
    with pytest.raises(iso.Error) as error:
        iso.distance_field(path, iso=50)
    assert told in str(error.value)


def test_a_second_geometry_is_refused(tmp_path: Path) -> None:
    path = write_hdf5(tmp_path / "a.h5", VALUES.T, element_size_um=[1.0, 1.0, 1.0])
    with pytest.raises(iso.Error, match="contains the spacing of its voxels, and 1 x 1 x 2 mm was given"):
        iso.distance_field(path, spacing=(1, 1, 2), iso=50)
    with pytest.raises(iso.Error, match="contains the position of its voxels"):
        iso.distance_field(DATA / "ngff_zarr_04.ome.zarr", origin=(1, 1, 2), iso=50)
    with pytest.raises(TypeError, match="dataset: only for"):
        iso.distance_field(VALUES, dataset="0", iso=50)


def nrrd(path: Path, ball: NDArray[Any], origin: tuple[int, int, int]) -> Path:
    steps = "(1,0,0) (0,2,0) (0,0,1.5)"
    header = f"NRRD0004\ntype: uint8\ndimension: 3\nspace dimension: 3\nsizes: {' '.join(map(str, ball.shape))}\n"
    header += f"space directions: {steps}\nspace origin: ({','.join(map(str, origin))})\nencoding: raw\n\n"
    path.write_bytes(header.encode() + ball.tobytes(order="F"))
    return path


def test_a_ball_has_the_same_mesh_in_every_format(tmp_path: Path) -> None:
    x, y, z = np.meshgrid(np.arange(26), 2 * np.arange(13), 1.5 * np.arange(17), indexing="ij")
    ball = ((x - 12) ** 2 + (y - 12) ** 2 + (z - 12) ** 2 < 9**2).astype(np.uint8)
    origin, spacing = (5, 6, 7), (1, 2, 1.5)
    settings: dict[str, Any] = {"labels": [1], "size": 3.0, "backend": "cpu"}
    expected = iso.mesh(nrrd(tmp_path / "ball.nrrd", ball, origin), **settings).result.vertices
    scipy_io.savemat(tmp_path / "ball.mat", {"ball": ball}, do_compression=True)
    write_hdf5(tmp_path / "ball.h5", ball.T)
    for name in ("ball.mat", "ball.h5"):
        made = iso.mesh(tmp_path / name, spacing=spacing, origin=origin, **settings)
        assert np.abs(made.result.vertices - expected).max() < 1e-4
        assert made.name == "ball"
    for version, key in ((2, None), (3, "ome")):
        group = zarr.open_group(str(tmp_path / "ball.zarr"), mode="w", zarr_format=version)
        group.create_array("0", data=ball.T, chunks=(8, 8, 8))
        scale = {"type": "scale", "scale": [1500, 2000, 1000]}
        shift = {"type": "translation", "translation": [7000, 6000, 5000]}
        levels = [{"path": "0", "coordinateTransformations": [scale, shift]}]
        content = {"multiscales": [{"axes": axes_with("micrometer"), "datasets": levels}]}
        group.attrs.update({key: content} if key else content)
        made = iso.mesh(tmp_path / "ball.zarr", dataset="0", **settings)
        assert np.abs(made.result.vertices - expected).max() < 1e-4


def test_absurd_sizes_are_refused_before_memory_is_allocated(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file.create_dataset("v", (10**6, 10**6, 10**6), "f4", chunks=(64, 64, 64))
    zarr.create_array(str(tmp_path / "a.zarr"), shape=(10**6, 10**6, 10**6), chunks=(64, 64, 64), dtype="f4")
    zarr.create_array(str(tmp_path / "b.zarr"), shape=(4, 4, 4), chunks=(10**6, 10**6, 10**6), dtype="f4")
    scipy_io.savemat(tmp_path / "a.mat", {"v": VALUES})
    content = bytearray((tmp_path / "a.mat").read_bytes())
    at = content.index(np.array(VALUES.shape, "<i4").tobytes())
    content[at : at + 12] = np.array([2**30, 2**30, 2**30], "<i4").tobytes()
    (tmp_path / "a.mat").write_bytes(content)
    for name in ("a.h5", "a.zarr", "b.zarr", "a.mat"):
        with pytest.raises(iso.Error) as error:
            read(tmp_path / name)
        assert "memory" in str(error.value)


def test_a_bomb_is_refused_within_its_memory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    array = zarr.create_array(
        str(tmp_path / "a.zarr"), shape=(8, 8, 8), chunks=(8, 8, 8), dtype="u1", compressors=zarr.codecs.GzipCodec()
    )
    array[:] = 1
    # 4 GiB of zeros
    (tmp_path / "a.zarr" / "c" / "0" / "0" / "0").write_bytes(64 * gzip.compress(bytes(1 << 26), 1))
    monkeypatch.setattr(_files, "SLACK_BYTES", 600 << 20)
    with pytest.raises(iso.Error, match="needs more memory than its description states"):
        read(tmp_path / "a.zarr", spacing=[1, 1, 1])


@pytest.mark.parametrize("cut", [0.02, 0.3, 0.9])
def test_truncated_files_are_refused(cut: float, tmp_path: Path) -> None:
    array = np.random.default_rng(1).integers(0, 255, (40, 40, 40), np.uint8)
    scipy_io.savemat(tmp_path / "a.mat", {"v": array})
    write_hdf5(tmp_path / "a.h5", array)
    for name in ("a.mat", "a.h5"):
        path = tmp_path / name
        path.write_bytes(path.read_bytes()[: int(cut * path.stat().st_size)])
        with pytest.raises(iso.Error, match="damaged"):
            read(path, spacing=[1, 1, 1])


@pytest.mark.parametrize(
    ("script", "told"),
    [
        ("import os; os.abort()", "ended with the exit code"),
        ("import time; time.sleep(60)", "took more than 1 s"),
    ],
)
def test_a_crash_or_a_hang_of_a_library_is_an_error(
    script: str, told: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = write_hdf5(tmp_path / "a.h5", VALUES)
    (tmp_path / "script.py").write_text(script)
    monkeypatch.setattr(_files.worker, "__file__", str(tmp_path / "script.py"))
    monkeypatch.setattr(_files, "PATIENCE_SECONDS", 1.0)
    with pytest.raises(iso.Error, match=told):
        read(path)


def test_a_missing_package_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(_files, "find_spec", lambda _: None)
    with pytest.raises(iso.Error, match=r'pip install "isoparticles\[formats\]"'):
        iso.distance_field(DATA / "ome_zarr_05.ome.zarr", iso=3)


def test_a_missing_compression_is_named(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "a.h5", "w") as file:
        # no filter has this number
        file.create_dataset("v", (8, 8, 8), "u1", chunks=(4, 4, 4), compression=32999, allow_unknown_filter=True)
    with pytest.raises(iso.Error, match="is compressed by the filter 32999, which is not installed"):
        read(tmp_path / "a.h5")


def test_minc_is_not_read_as_a_bare_array(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "a.mnc", "w") as file:
        file["minc-2.0/image/0/image"] = VALUES
    with pytest.raises(iso.Error, match="is a MINC file"):
        read(tmp_path / "a.mnc")


@pytest.mark.skipif(sys.platform == "win32", reason="needs signal.alarm")
@pytest.mark.parametrize("kind", ["hdf5", "matlab", "matlab 7.3", "zarr 2", "zarr 3"])
def test_mutated_files_raise_no_other_errors(kind: str, tmp_path: Path) -> None:
    path, count, dataset = tmp_path / "file", 2000, ""
    if kind == "matlab":
        scipy_io.savemat(path, {"v": VALUES}, appendmat=False)
    elif kind.startswith("zarr"):
        name = {"zarr 2": "ome_zarr_04.ome.zarr", "zarr 3": "ome_zarr_05.ome.zarr"}[kind]
        path, count, dataset = DATA / name, 1000, "labels/organs"
    elif kind == "hdf5":
        # about 1 % of these files crash HDF5, and a new process takes 0.3 s
        write_hdf5(path, VALUES, "zyx", element_size_um=[1.0, 2.0, 3.0])
    else:
        path = DATA / "hdf5storage.mat"
    script = [sys.executable, str(Path(__file__).parent / "mutate.py"), kind.removesuffix(" 2").removesuffix(" 3")]
    first, until = 0, time.monotonic() + 20
    while first < count and time.monotonic() < until:
        words = [*script, str(path), str(first), str(count), dataset]
        done = subprocess.run(words, capture_output=True, text=True, check=False)
        if done.returncode == 0:
            break
        # a library crashed or hung; for this reason, the package reads in a separate process
        assert done.returncode < 0, done.stderr
        first = int(done.stdout.split()[-1]) + 1


def test_the_program_writes_a_volume_for_all_stages(tmp_path: Path) -> None:
    def program(*words: str) -> subprocess.CompletedProcess[str]:
        command = [sys.executable, "-m", "isoparticles.formats.program", *words]
        return subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)

    source = str(DATA / "ome_zarr_05.ome.zarr")
    words = [source, "--dataset", "labels/organs", "-o", "v.vti", "--report", "r.json"]
    assert program(*words).returncode == 0
    volume = _native.read_volume(tmp_path / "v.vti")
    assert np.array_equal(volume["values"].T, VALUES % 3)
    assert volume["spacing"] == pytest.approx([UM, 2 * UM, 3 * UM])
    assert volume["names"] == {1: "liver", 2: "spleen"}
    report = json.loads((tmp_path / "r.json").read_text())
    assert report["outcome"] == "passed"
    assert report["inputs"][0]["path"] == "ome_zarr_05.ome.zarr"
    for more, told in (
        ([], "already exists"),
        (["--force", "--spacing", "1,2"], "is not one or three numbers"),
        (["--force", "--spacing", "1"], "contains the spacing"),
        (["--force", "--max-memory", "1K"], "memory"),
    ):
        done = program(*words, *more)
        assert done.returncode == 2
        assert told in done.stderr
        assert "what to do: " in done.stderr
