"""Arrays in files: the choice of their axes, and the position of their voxels in the world."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from math import prod
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from isoparticles._errors import Error

SLAB_BYTES = 1 << 26
"""Size of the parts in which arrays are read. Larger parts are not faster (64 MB: 0.1 s)."""
NUMBERS = frozenset(("int8", "uint8", "int16", "uint16", "int32", "uint32", "int64", "uint64", "float32", "float64"))
"""Types that the stages read."""
CONVERTED = {"bool": "uint8", "float16": "float32"}
"""Types that the stages do not read, and the types to which they are converted."""
ZARR_FILES = ("zarr.json", ".zarray", ".zgroup")
"""Each array and each group of Zarr contains one of these files."""
MOST_LISTED = 10
"""Maximum number of names in a message."""
SUFFIX = re.compile(r"(?P<name>.*?):(?P<indices>\w+=\d+(,\w+=\d+)*)")
"""A dataset with indices at its end, such as ``0:c=1,t=0``."""


@dataclass(frozen=True)
class Place:
    """Position of an array in the world. The order of its axes is that of the array."""

    spacing: Sequence[float] | None = None
    """Distances between voxel centres in mm, or ``None`` if the file does not contain them."""
    origin: Sequence[float] | None = None
    """Coordinates of the first voxel in mm, or ``None`` if the file does not contain them."""
    lps: Mapping[str, NDArray[np.float64]] = field(default_factory=dict)
    """Unit vectors of the axes x, y and z in LPS; empty if the file does not contain them."""
    has_unit: bool = True
    """Whether the file states the unit of its lengths. Otherwise, they are read as mm."""


@dataclass(frozen=True)
class Stored:
    """An array with three axes in a file. Its voxels have not been read."""

    name: str
    array: Any
    """Has ``shape``, ``dtype`` and slices, like an array of NumPy."""
    axes: Sequence[str]
    """``x``, ``y``, ``z`` or another name for each axis."""
    indices: Mapping[str, int]
    """Index on each axis other than x, y and z."""
    place: Place = Place()
    names: Mapping[int, str] = field(default_factory=dict)
    """Names of labels."""
    chunks: Sequence[int] | None = None
    """Shape of the parts that are decoded together, if there are any."""
    is_whole: bool = False
    """Whether the first slab reads the whole array."""
    in_parallel: int = 1
    """Number of chunks that are decoded together."""
    others: Sequence[str] = ()
    """Names of smaller versions of this array."""
    warnings: Sequence[str] = ()

    @property
    def dtype(self) -> str:
        """Return the type to which the voxels are converted."""
        name = type_name(self.array)
        return CONVERTED.get(name, name)

    @property
    def spatial(self) -> list[int]:
        """Return the positions of x, y and z among the axes."""
        return [list(self.axes).index(letter) for letter in "xyz"]

    @property
    def size(self) -> list[int]:
        """Return the number of voxels along x, y and z."""
        return [int(self.array.shape[axis]) for axis in self.spatial]

    @property
    def thickness(self) -> int:
        """Return the number of layers to read together: whole chunks, if there are chunks."""
        nx, ny, nz = self.size
        chunk = int(self.chunks[self.spatial[2]]) if self.chunks else 1
        layers = SLAB_BYTES // (nx * ny * int(np.dtype(self.dtype).itemsize))
        return min(nz, max(chunk, layers // chunk * chunk))

    @property
    def working_bytes(self) -> int:
        """Return the memory for reading one slab: voxels, a copy in another order, and chunks."""
        nx, ny, _ = self.size
        whole = 2 * prod(map(int, self.array.shape)) if self.is_whole else 0
        chunks = 2 * prod(map(int, self.chunks)) * self.in_parallel if self.chunks else 0
        item = max(np.dtype(self.array.dtype).itemsize, np.dtype(self.dtype).itemsize)
        return int(item) * (2 * nx * ny * self.thickness + whole + chunks)

    def slabs(self) -> Iterator[NDArray[Any]]:
        """Yield the voxels in parts along z, with the axes x, y and z."""
        nz = self.size[2]
        kept = sorted(self.spatial)
        order = [kept.index(axis) for axis in self.spatial]
        for first in range(0, nz, self.thickness):
            index: list[Any] = [self.indices.get(name, slice(None)) for name in self.axes]
            index[self.spatial[2]] = slice(first, min(nz, first + self.thickness))
            part = np.asarray(self.array[tuple(index)]).transpose(order)
            yield np.asfortranarray(part, dtype=self.dtype)


def type_name(array: Any) -> str:
    """Return the name of the type of an array, without its byte order."""
    name: str = np.dtype(array.dtype).newbyteorder("=").name
    return name


def split_name(dataset: str | None) -> tuple[str, dict[str, int]]:
    """Split ``0:c=1,t=0`` into the name of an array and the indices on other axes."""
    found = SUFFIX.fullmatch(dataset or "")
    if found is None:
        return dataset or "", {}
    pairs = (word.split("=") for word in found["indices"].split(","))
    return found["name"], {name: int(index) for name, index in pairs}


def is_volume(array: Any) -> bool:
    """Return whether an array may be a volume: numbers, with three axes of two or more voxels."""
    return np.dtype(array.dtype).kind in "biuf" and sum(length > 1 for length in array.shape) >= 3


def axes_of(
    path: Path, name: str, array: Any, labels: Sequence[str] | None, usual: str, chosen: Mapping[str, int]
) -> tuple[list[str], dict[str, int]]:
    """Choose the three axes of a volume, and the indices on the other axes.

    Parameters
    ----------
    labels
        The names of the axes in the file, if it has them.
    usual
        The order of x, y and z in arrays without names. Other axes must have the length 1.
    chosen
        The indices that the user has chosen.
    """
    shape = tuple(array.shape)
    subject = f"{path}: the array {name or 'of the file'}, of shape {' x '.join(map(str, shape))},"
    if type_name(array) not in NUMBERS | set(CONVERTED):
        raise Error(f"{subject} has the type {array.dtype}", "a volume has one number per voxel", "use another array")
    if labels is None:
        long = [axis for axis in range(len(shape)) if len(shape) == 3 or shape[axis] > 1]
        if len(long) != 3:
            raise Error(
                f"{subject} does not have three axes",
                "a volume has the axes x, y and z, and one number per voxel",
                "use another array, or write one time or one channel as an array of its own",
            )
        letters = dict(zip(long, usual, strict=True))
        labels = [letters.get(axis, f"axis{axis}") for axis in range(len(shape))]
    elif len(labels) != len(shape) or len(set(labels)) != len(labels) or not set("xyz") <= set(labels):
        raise Error(
            f"{subject} has the axes {', '.join(labels)}",
            "each axis needs a name of its own, and a volume has the axes x, y and z",
            "use another array, or correct the names of the axes",
        )
    others = {label: length for label, length in zip(labels, shape, strict=True) if label not in "xyz"}
    for label, length in others.items():
        if label not in chosen and length != 1:
            raise Error(
                f"{subject} has {length} values on the axis {label}",
                "a volume has one number per voxel",
                f"choose one of them, numbered from 0: the dataset '{name}:{label}=0'",
            )
    for label, index in chosen.items():
        if index >= others.get(label, 0):
            given = f"{label}={index} was given"
            present = ", ".join(f"{other} (0 to {length - 1})" for other, length in others.items()) or "no other axes"
            raise Error(f"{subject} has {present}; {given}", "there are no such voxels", "correct the dataset")
    if min(shape[labels.index(letter)] for letter in "xyz") < 2:
        raise Error(f"{subject} is flat", "a volume has at least two voxels along each axis", "use another array")
    return list(labels), {label: chosen.get(label, 0) for label in others}


def refuse_name(path: Path, kind: str, name: str, present: Sequence[str]) -> Error:
    """Return the error about a name that selects no volume, or a missing name."""
    listed = ", ".join(present[:MOST_LISTED]) + (", ..." if len(present) > MOST_LISTED else "")
    if not present:
        return Error(f"{path}: contains no {kind} with three axes", "a volume is needed", "use another file")
    what = f"contains no {kind} '{name}' with three axes" if name else f"contains several {kind}s with three axes"
    return Error(f"{path}: {what}", "one of them is the volume to mesh", f"choose it as the dataset: {listed}")
