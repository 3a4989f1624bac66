"""A label volume: whole numbers on a regular grid placed in the world, from NRRD or VTK."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import nrrd
import numpy as np
import pyvista as pv
from numpy.typing import NDArray

from tetmesh_check.errors import StageError
from tetmesh_check.quality import Points
from tetmesh_check.surface import read_dataset

_TO_LPS: tuple[tuple[str, str, tuple[float, float, float]], ...] = (
    ("left-posterior-superior", "lps", (1.0, 1.0, 1.0)),
    ("right-anterior-superior", "ras", (-1.0, -1.0, 1.0)),
    ("left-anterior-superior", "las", (1.0, -1.0, 1.0)),
    ("scanner-xyz", "", (1.0, 1.0, 1.0)),
    ("3d-right-handed", "", (1.0, 1.0, 1.0)),
    ("3d-left-handed", "", (1.0, 1.0, 1.0)),
)
"""Worlds of NRRD files, and the signs that turn them into the one that meshes are written in; 1 for worlds that are not the body's."""
_ADVICE = "give the label volume that the case was made from (.nrrd, .nhdr or .vti)"


@dataclass(frozen=True)
class LabelVolume:
    """Whole numbers on a regular grid placed in the world."""

    values: NDArray[Any]
    """Labels, shape ``(nx, ny, nz)``; 0 is no tissue."""
    step: Points
    """World vectors from a voxel centre to the next along each grid axis, mm; one a column."""
    origin: Points
    """World position of the centre of voxel (0, 0, 0), mm."""

    @property
    def voxel_volume(self) -> float:
        """Volume of a voxel, mm^3."""
        return float(abs(np.linalg.det(self.step)))


def _refuse(path: Path, what: str) -> StageError:
    return StageError(f"{path}: {what}", "labels are found by their position in the world", _ADVICE)


def _world(path: Path, header: dict[str, Any]) -> Points:
    """Signs that turn the world of the file into the one that meshes are written in; refuses worlds that are not known."""
    if (dimension := header.get("space dimension")) is not None:
        if int(dimension) != 3:
            raise _refuse(path, f"its space has {dimension} dimensions")
        return np.ones(3)
    if "space" not in header:
        return np.ones(3)
    name = str(header["space"]).lower()
    for base, short, signs in _TO_LPS:
        if name in (base, f"{base}-time", short, f"{short}t" if short else None):
            return np.array(signs)
    raise _refuse(path, f"its space is '{header['space']}', which is not known")


def _vectors(header: dict[str, Any]) -> Points | None:
    """World vector of each axis without its component of time; NaN or zero for an axis that is not of space."""
    directions = header.get("space directions")
    return None if directions is None else np.asarray(directions, dtype=np.float64)[:, :3]


def _plain_grid(path: Path, header: dict[str, Any], axes: list[int]) -> tuple[Points, Points]:
    """Spacing and origin of a header without directions: from ``spacings``, ``axis mins`` and ``axis maxs``."""

    def pick(name: str) -> Points:
        return np.asarray(header.get(name, np.full(max(axes) + 1, np.nan)), dtype=np.float64)[axes]

    spacing, low, high = pick("spacings"), pick("axis mins"), pick("axis maxs")
    words = str(header.get("centers", header.get("centerings", ""))).lower().split()
    # samples are centres of cells unless the header says nodes, as Teem has it
    cell = np.array([len(words) <= axis or words[axis] != "node" for axis in axes])
    gaps = np.asarray(header["sizes"])[axes] - ~cell
    known = np.isfinite(low) & np.isfinite(high) & np.isnan(spacing) & (gaps > 0)
    spacing[known] = ((high - low) / np.maximum(gaps, 1))[known]
    if np.isnan(spacing).all():
        spacing = np.ones(3)
    if not (np.isfinite(spacing) & (spacing > 0)).all():
        raise _refuse(path, f"its spacing is {', '.join(f'{value:g}' for value in spacing)}")
    if "space origin" not in header and np.isfinite(low).all():
        return spacing, low + np.where(cell, 0.5 * spacing, 0.0)
    return spacing, np.asarray(header.get("space origin", np.zeros(3)), dtype=np.float64)[:3]


def _read_nrrd(path: Path) -> tuple[NDArray[Any], Points, Points]:
    """As the stages in Rust take it (``common/src/io/nrrd/grid.rs``)."""
    try:
        values, header = nrrd.read(str(path))
    except Exception as error:
        raise StageError.file(path, "read", error, "check that it is complete, and a NRRD file") from error
    signs = _world(path, header)
    vectors = _vectors(header)
    axes = list(range(values.ndim))
    if vectors is not None:
        axes = [axis for axis in axes if np.isfinite(vectors[axis]).all() and vectors[axis].any()]
    for axis in reversed(range(values.ndim)):
        if len(axes) > 3 and axis in axes and values.shape[axis] == 1:
            axes.remove(axis)
    if len(axes) != 3 or any(size != 1 for axis, size in enumerate(values.shape) if axis not in axes):
        raise StageError(
            f"{path}: has {values.ndim} axes ({' x '.join(map(str, values.shape))}), {len(axes)} of them of space",
            "labels are one number a voxel in 3-D",
            _ADVICE,
        )
    if vectors is None:
        spacing, origin = _plain_grid(path, header, axes)
        step = np.diag(spacing)
    else:
        step = vectors[axes].T
        origin = np.asarray(header.get("space origin", np.zeros(3)), dtype=np.float64)[:3]
    if not (np.isfinite(step).all() and np.isfinite(origin).all() and abs(np.linalg.det(step)) > 0.0):
        raise _refuse(path, "its space directions and its origin span no volume")
    others = tuple(axis for axis in range(values.ndim) if axis not in axes)
    return values.squeeze(others), signs[:, None] * step, signs * origin


def _read_image(path: Path) -> tuple[NDArray[Any], Points, Points]:
    image = read_dataset(path)
    if not isinstance(image, pv.ImageData) or image.active_scalars is None or image.active_scalars.ndim != 1:
        raise StageError(f"{path}: is no image of one number a voxel", "labels are found by their position", _ADVICE)
    step = np.asarray(image.direction_matrix, dtype=np.float64) * np.asarray(image.spacing)
    origin = np.asarray(image.origin, dtype=np.float64) + step @ np.array(image.extent[::2], dtype=np.float64)
    return np.asarray(image.active_scalars).reshape(image.dimensions, order="F"), step, origin


def read_label_volume(path: Path) -> LabelVolume:
    """Read labels.

    Parameters
    ----------
    path
        A NRRD file (``.nrrd``, ``.nhdr``) or a VTK image (``.vti``).

    Raises
    ------
    StageError
        If it is no volume of whole numbers.
    """
    if not path.is_file():
        raise StageError(f"{path}: no such file", "it says which tissue is where", _ADVICE)
    values, step, origin = (_read_nrrd if path.suffix in (".nrrd", ".nhdr") else _read_image)(path)
    if not np.issubdtype(values.dtype, np.integer):
        whole = np.isfinite(values) & (values == np.round(values))
        if not whole.all():
            raise StageError(
                f"{path}: {int((~whole).sum())} of {values.size} values are no whole numbers", "labels are", _ADVICE
            )
        if np.abs(values).max(initial=0.0) < 2.0**62:  # larger ones are refused below
            values = values.astype(np.int64)
    limits = np.iinfo(np.int32)
    if values.size and not limits.min <= values.min() <= values.max() <= limits.max:
        raise StageError(
            f"{path}: holds labels from {values.min()} to {values.max()}",
            "regions are written as whole numbers of 32 bits",
            "give the labels smaller numbers",
        )
    if not values.any():
        raise StageError(f"{path}: holds no label but 0", "there is no tissue in it", _ADVICE)
    return LabelVolume(values, step, origin)
