"""HDF5 files, and MATLAB files of version 7.3, which are HDF5 files."""

from __future__ import annotations

import json
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import h5py  # type: ignore[import-untyped]

from isoparticles._errors import Error
from isoparticles.formats.stored import Place, Stored, axes_of, is_volume, refuse_name, split_name

MOST_OBJECTS = 100_000
"""Maximum number of objects to search. h5py visits about 50,000 per second, so this takes 2 s."""
ELEMENT_SIZE = "element_size_um"
"""Attribute of Fiji's HDF5 plugin, ilastik, elf and MoBIE: voxel size along z, y and x, um."""
NUMERIC_CLASSES = frozenset(
    ("double", "single", "logical", *(f"{sign}int{bits}" for sign in ("", "u") for bits in (8, 16, 32, 64)))
)
"""MATLAB classes of arrays of numbers."""


def read_hdf5(path: Path, dataset: str | None) -> Stored:
    """Find an array in an HDF5 file. Without names of axes, the order is z, y, x."""
    name, chosen = split_name(dataset)
    file = h5py.File(path, "r")
    if "minc-2.0" in file:
        raise Error(
            f"{path}: is a MINC file",
            "its description of the grid is not supported",
            "convert it, for example with mnc2nii",
        )
    array = _array(path, file, name)
    _refuse_filters(path, array)
    axes, indices = axes_of(path, array.name, array, _labels(array), "zyx", chosen)
    return Stored(array.name, array, axes, indices, Place(_spacing(path, array, axes)), chunks=array.chunks)


def read_matlab_7_3(path: Path, dataset: str | None) -> Stored:
    """Find a variable in a MATLAB file of version 7.3. MATLAB's first axis is x.

    HDF5 stores the axes of MATLAB in reverse order.
    """
    name, chosen = split_name(dataset)
    file = h5py.File(path, "r")
    numeric = [key for key, value in file.items() if isinstance(value, h5py.Dataset) and _is_numeric(value)]
    present = [key for key in numeric if is_volume(file[key])]
    wanted = name or (present[0] if len(present) == 1 else "")
    if wanted not in numeric:
        raise refuse_name(path, "variable", name, present)
    array = file[wanted]
    _refuse_filters(path, array)
    axes, indices = axes_of(path, wanted, array, None, "zyx", chosen)
    return Stored(wanted, array, axes, indices, chunks=array.chunks)


def _array(path: Path, file: Any, name: str) -> Any:
    """Return the array with a name or, without a name, the only volume."""
    if name and isinstance(file.get(name), h5py.Dataset) and file[name].shape is not None:
        return file[name]
    found: list[str] = []
    visited = 0

    def visit(key: str, item: Any) -> bool | None:
        nonlocal visited
        visited += 1
        if isinstance(item, h5py.Dataset) and item.shape is not None and is_volume(item):
            found.append(f"/{key}")
        return True if visited == MOST_OBJECTS else None

    file.visititems(visit)
    if name or len(found) != 1:
        raise refuse_name(path, "array", name, found)
    return file[found[0]]


def _refuse_filters(path: Path, array: Any) -> None:
    """Raise an error if the compression filter of an array is not installed.

    hdf5plugin, if installed, registers the common filters.
    """
    with suppress(ImportError):
        import hdf5plugin  # type: ignore[import-not-found]  # noqa: F401
    properties = array.id.get_create_plist()
    for position in range(properties.get_nfilters()):
        code, _, _, title = properties.get_filter(position)
        if not h5py.h5z.filter_avail(code):
            raise Error(
                f"{path}: {array.name} is compressed by the filter {_text(title) or code}, which is not installed",
                "it is needed to read the voxels",
                "pip install hdf5plugin, or write the array with gzip or without compression",
            )


def _text(value: Any) -> str:
    return value.decode("utf-8", "replace") if isinstance(value, bytes) else str(value)


def _labels(array: Any) -> Sequence[str] | None:
    """Return the names of the axes: ``axistags`` (ilastik, vigra), or the labels of dimensions."""
    if "axistags" in array.attrs:
        return [str(axis["key"]).lower() for axis in json.loads(_text(array.attrs["axistags"]))["axes"]]
    labels = [dimension.label.lower() for dimension in array.dims]
    return labels if set("xyz") <= set(labels) else None


def _spacing(path: Path, array: Any, axes: Sequence[str]) -> list[float] | None:
    """Return the spacing along each axis of the array, mm."""
    if ELEMENT_SIZE not in array.attrs:
        return None
    sizes = [float(size) for size in array.attrs[ELEMENT_SIZE]]
    if len(sizes) != 3:
        raise Error(
            f"{path}: the attribute {ELEMENT_SIZE} of {array.name} has {len(sizes)} numbers",
            "it must have the voxel size along z, y and x",
            "correct or remove the attribute",
        )
    by_axis = dict(zip("zyx", sizes, strict=True))
    return [by_axis.get(axis, 1.0) * 1e-3 for axis in axes]


def _is_numeric(array: Any) -> bool:
    is_empty = bool(array.attrs.get("MATLAB_empty", 0))
    return not is_empty and _text(array.attrs.get("MATLAB_class", b"")) in NUMERIC_CLASSES
