"""MATLAB files of version 5 (``save -v6`` and ``save -v7``)."""

from __future__ import annotations

from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import scipy.io  # type: ignore[import-untyped]
from numpy.typing import NDArray

from isoparticles._errors import Error
from isoparticles.formats.stored import Stored, axes_of, is_volume, refuse_name, split_name

INTEGERS = [f"{sign}int{bits}" for sign in ("", "u") for bits in (8, 16, 32, 64)]
TYPES = {"double": "float64", "single": "float32", "logical": "uint8", **dict(zip(INTEGERS, INTEGERS, strict=True))}
"""NumPy types by MATLAB class."""


class Variable:
    """A variable that is read when it is first indexed."""

    chunks = None

    def __init__(self, path: Path, name: str, shape: tuple[int, ...], kind: str) -> None:
        self.path = path
        self.name = name
        self.shape = shape
        self.dtype = np.dtype(TYPES[kind])

    @cached_property
    def values(self) -> NDArray[Any]:
        """Read the variable."""
        # SciPy keeps the type of the stored values, which may be smaller than the variable's
        values: NDArray[Any] = scipy.io.loadmat(self.path, variable_names=[self.name])[self.name]
        if np.iscomplexobj(values):
            raise Error(
                f"{self.path}: the variable {self.name} is complex",
                "a volume has one real number per voxel",
                "save its real part or its absolute value",
            )
        if values.shape != self.shape:
            raise ValueError(f"{self.name} has the shape {values.shape} instead of {self.shape}")
        return values

    def __getitem__(self, index: Any) -> NDArray[Any]:
        part: NDArray[Any] = self.values[index]
        return part


def read_matlab(path: Path, dataset: str | None) -> Stored:
    """Find a variable in a MATLAB file of version 5. MATLAB's first axis is x."""
    name, chosen = split_name(dataset)
    arrays = [Variable(path, own, shape, kind) for own, shape, kind in scipy.io.whosmat(path) if kind in TYPES]
    present = [array for array in arrays if is_volume(array)]
    wanted = name or (present[0].name if len(present) == 1 else "")
    found = [array for array in arrays if array.name == wanted]
    if not found:
        raise refuse_name(path, "variable", name, [array.name for array in present])
    axes, indices = axes_of(path, wanted, found[0], None, "xyz", chosen)
    return Stored(wanted, found[0], axes, indices, is_whole=True)
