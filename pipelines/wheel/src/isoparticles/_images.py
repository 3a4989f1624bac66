"""Converts images of other packages to volumes."""

from __future__ import annotations

import os
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from isoparticles import _native
from isoparticles._errors import Error
from isoparticles._files import Given, Limits, format_of, opened
from isoparticles.formats.stored import CONVERTED, NUMBERS, type_name

Image = Any
"""A path, a NumPy array, an image of SimpleITK, nibabel or PyVista, or a mapping from names to
masks of these types."""

UNITS_MM = {"mm": 1.0, "meter": 1e3, "micron": 1e-3}
"""Lengths of the units of nibabel in mm. An unknown unit counts as mm."""
SPACING_MM = (1e-9, 1e6)
"""Minimum and maximum spacing, as in ``common/volume/src/limit.rs``."""
ORIGIN_MM = 1e9
"""Maximum coordinate of an origin, as in ``limit.rs``, which gives the reason."""
FLAT = 1e-3
"""Minimum determinant of the axes, as in ``limit.rs``, which gives the reason."""
NO_LIMITS = Limits()
LAYERS = 64
"""Number of layers to copy together: a cache line of 64 bytes has as many voxels of 8 bits."""


@dataclass(frozen=True)
class Source:
    """The input of a stage: a path, or a volume in memory named ``array`` or ``masks``."""

    word: str
    volume: _native.Volume | None = None
    is_file: bool = False
    """Whether ``word`` is a path. ``volume`` then contains the voxels of HDF5, MATLAB or Zarr."""
    words: tuple[str, ...] = ()
    """Options of ``distfield`` for reading the file."""


def source(
    image: Image,
    spacing: ArrayLike | None = None,
    origin: ArrayLike | None = None,
    direction: ArrayLike | None = None,
    dataset: str | None = None,
) -> Source:
    """Convert an image; see :func:`isoparticles.distance_field`.

    Raises
    ------
    TypeError
        If the type of the image or of its voxels is not supported.
    ValueError
        If the array does not have three axes, or if the geometry is invalid.
    """
    if isinstance(image, Mapping):
        return _of_masks(image, spacing, origin, direction, dataset)
    package = type(image).__module__.partition(".")[0]
    given = [("spacing", spacing), ("origin", origin), ("direction", direction)]
    named = [name for name, value in given if value is not None]
    if isinstance(image, (str, os.PathLike)) and format_of(os.fsdecode(image)):
        lengths, place = (None if value is None else _three(name, value, 0.0) for name, value in given[:2])
        axes = None if direction is None else _axes(direction)
        return of_file(os.fsdecode(image), dataset, Given(lengths, place, axes))
    if dataset is not None and not _is_missing(image):
        raise TypeError("dataset: only for HDF5, MATLAB and Zarr files")
    if isinstance(image, np.ndarray):
        axes, steps = _axes(direction), _three("spacing", spacing, 1.0)
        return _volume(image, axes * steps, _three("origin", origin, 0.0))
    if isinstance(image, (str, os.PathLike)) and named == ["spacing"]:
        numbers = _told(_three("spacing", spacing, 1.0))
        return Source(os.fsdecode(image), is_file=True, words=("--spacing", ",".join(map(repr, numbers))))
    if isinstance(image, (str, os.PathLike)) and not named:
        return Source(os.fsdecode(image), is_file=True)
    if isinstance(image, (str, os.PathLike)):
        wrong = ", ".join(name for name in named if name != "spacing")
        raise TypeError(f"{wrong}: only for arrays, and for HDF5, MATLAB and Zarr files")
    if named:
        raise TypeError(f"{', '.join(named)}: only for arrays; this image has a geometry of its own")
    if package == "SimpleITK":
        return _of_simpleitk(image)
    if package == "nibabel":
        return _of_nibabel(image)
    if package == "pyvista" and hasattr(image, "dimensions") and hasattr(image, "spacing"):
        return _of_pyvista(image)
    kind = f"{type(image).__module__}.{type(image).__qualname__}"
    raise TypeError(
        f"images of type {kind} are not supported: pass a path, a NumPy array (numpy.asarray(image) with spacing, "
        "origin and direction), or an image of SimpleITK, nibabel or PyVista"
    )


def _is_missing(image: Image) -> bool:
    return isinstance(image, (str, os.PathLike)) and not Path(image).exists()


def of_file(path: str, dataset: str | None, given: Given, limits: Limits = NO_LIMITS) -> Source:
    """Read an array of an HDF5, MATLAB or Zarr file.

    Raises
    ------
    Error
        If the file cannot be read, or if its geometry is invalid.
    """
    with opened(path, dataset, given, limits) as (grid, slabs):
        try:
            spacing, axes = _checked(grid.steps, grid.origin)
        except ValueError as error:
            raise Error(f"{path}: {error}", "the volume would have no usable position", "correct the file") from None
        volume = _native.Volume(
            slabs, grid.dtype, grid.size, spacing, grid.origin.tolist(), axes, "lps" if grid.is_lps else None
        )
    volume.name_labels(grid.names)
    return Source(path, volume, is_file=True)


def _of_masks(masks: Mapping[Any, Image], *geometry: Any) -> Source:
    if not masks:
        raise ValueError("the mapping contains no masks")
    named = []
    for name, mask in masks.items():
        if not isinstance(name, str):
            raise TypeError(f"the name of a mask must be a text, not {name!r}")
        own = source(mask, *geometry)
        if own.words:
            raise TypeError("spacing: only for arrays; a mask in a file has a geometry of its own")
        named.append((name, own.word if own.volume is None else own.volume))
    return Source("masks", _native.Volume.of_masks(named))


def _of_simpleitk(image: Image) -> Source:
    if image.GetDimension() != 3 or image.GetNumberOfComponentsPerPixel() != 1:
        raise ValueError("the image must have three dimensions and one value per voxel")
    array = sys.modules["SimpleITK"].GetArrayViewFromImage(image)
    axes = np.array(image.GetDirection(), dtype=float).reshape(3, 3)
    return _volume(np.asarray(array).T, axes * np.array(image.GetSpacing()), np.array(image.GetOrigin()), "lps")


def _of_nibabel(image: Image) -> Source:
    array = np.asanyarray(image.dataobj)
    while array.ndim > 3 and array.shape[-1] == 1:
        array = array[..., 0]
    header: Any = getattr(image, "header", None)
    unit = header.get_xyzt_units()[0] if hasattr(header, "get_xyzt_units") else "mm"
    affine = np.asarray(image.affine, dtype=float)[:3] * UNITS_MM.get(unit, 1.0)
    return _volume(array, affine[:, :3], affine[:, 3], "ras")


def _of_pyvista(image: Image) -> Source:
    size = np.array(image.dimensions)
    first = np.array(getattr(image, "offset", (0, 0, 0)), dtype=float)
    values = _scalars(image.point_data)
    if values is None:
        values = _scalars(image.cell_data)
        size, first = size - 1, first + 0.5
    if values is None:
        raise ValueError("the image has no single scalar array on its points or cells: make one of them active")
    axes = np.asarray(image.direction_matrix, dtype=float) * np.array(image.spacing)
    return _volume(values.reshape(size, order="F"), axes, np.array(image.origin) + axes @ first)


def _scalars(arrays: Any) -> NDArray[Any] | None:
    """Return the active array, or the only array, with one value per point or cell."""
    single = [name for name in arrays if np.asarray(arrays[name]).ndim == 1]
    active = arrays.active_scalars_name
    if active is not None and active not in single:
        return None
    name = active if active is not None else single[0] if len(single) == 1 else None
    return None if name is None else np.asarray(arrays[name])


def _volume(
    array: NDArray[Any], steps: NDArray[Any], origin: NDArray[Any], space: Literal["lps", "ras"] | None = None
) -> Source:
    """Copy an array. Column n of ``steps`` is the vector from a voxel to the next along axis n, mm.

    ``space`` is the frame of ``steps`` and ``origin``.
    """
    if isinstance(array, np.ma.MaskedArray):
        raise TypeError("masked arrays are not supported: use array.filled(value)")
    name = CONVERTED.get(type_name(array), type_name(array))
    if name not in NUMBERS:
        raise TypeError(f"arrays of {array.dtype} are not supported: use numbers of at most 64 bits, or booleans")
    if array.ndim != 3:
        raise ValueError(f"the array must have three axes (x, y, z), but its shape is {array.shape}")
    if min(array.shape) < 2:
        raise ValueError(f"the array must have at least two voxels along each axis, but its shape is {array.shape}")
    spacing, axes = _checked(steps, origin)
    # slabs are converted one at a time, so that a new type or order needs no second array
    slabs = (np.asfortranarray(array[..., z : z + LAYERS], dtype=name) for z in range(0, array.shape[2], LAYERS))
    return Source("array", _native.Volume(slabs, name, array.shape, spacing, origin.tolist(), axes, space))


def _checked(steps: NDArray[Any], origin: NDArray[Any]) -> tuple[list[float], list[list[float]]]:
    """Check a geometry, and return the spacing and the unit vectors of the axes."""
    spacing = np.linalg.norm(steps, axis=0)
    low, high = SPACING_MM
    if not np.all((spacing >= low) & (spacing <= high)):
        raise ValueError(f"the spacing must be from {low:g} to {high:g} mm, but it is {_told(spacing)}")
    if not np.all(np.abs(origin) <= ORIGIN_MM):
        raise ValueError(f"the origin must be finite and within {ORIGIN_MM:g} mm, but it is {_told(origin)}")
    axes = steps / spacing
    if not abs(np.linalg.det(axes)) >= FLAT:
        raise ValueError(f"the direction is singular: its axes {axes.T.tolist()} are (nearly) coplanar")
    return spacing.tolist(), axes.T.tolist()


def _axes(direction: ArrayLike | None) -> NDArray[Any]:
    """Return the unit vectors of the axes as columns."""
    if direction is None:
        return np.eye(3)
    axes = _numbers("direction", direction)
    if axes.size != 9:
        raise ValueError("direction must be a 3 x 3 matrix whose columns are the axes")
    axes = axes.reshape(3, 3)
    if not np.allclose(np.linalg.norm(axes, axis=0), 1.0, atol=1e-3):
        raise ValueError("the columns of direction must be unit vectors; spacing contains the lengths")
    return axes


def _three(name: str, given: ArrayLike | None, default: float) -> NDArray[Any]:
    if given is None:
        return np.full(3, default)
    numbers = _numbers(name, given)
    if name == "spacing" and numbers.shape in ((), (1,)):
        numbers = np.full(3, numbers)
    if numbers.shape != (3,):
        raise ValueError(f"{name} must have three numbers (mm), but its shape is {numbers.shape}")
    if name == "spacing" and not np.all(numbers > 0):
        raise ValueError(f"the spacing must be above 0 mm, but it is {_told(numbers)}")
    return numbers


def _numbers(name: str, given: ArrayLike) -> NDArray[Any]:
    try:
        return np.array(given, dtype=np.float64)
    except (TypeError, ValueError, OverflowError) as error:
        raise TypeError(f"{name} must contain numbers: {error}") from None


def _told(numbers: NDArray[Any]) -> Sequence[float]:
    told: list[float] = numbers.tolist()
    return told
