"""Reads volumes and label volumes in all formats that the stages read."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from isoparticles import _native
from numpy.typing import NDArray

from tetmesh_check.errors import StageError
from tetmesh_check.quality import Points


@dataclass(frozen=True)
class InputVolume:
    """Values on a regular grid in the world frame of the meshes."""

    values: NDArray[Any]
    """Values in the type of the file, shape ``(nx, ny, nz)``; the first layer if there are
    several."""
    step: Points
    """World vectors from a voxel centre to the next along each grid axis, mm; one per column."""
    origin: Points
    """World position of the centre of voxel (0, 0, 0), mm."""
    anatomical: bool
    """Whether the world is that of the body (left, posterior, superior)."""
    names: dict[int, str] = field(default_factory=dict)
    """Names of the labels of the first layer, if the file has them."""
    layers: int = 1
    """Number of layers; segments of different layers may overlap."""

    @property
    def voxel_volume(self) -> float:
        """Volume of a voxel, mm^3."""
        return float(abs(np.linalg.det(self.step)))


def read_volume(
    path: Path, series: str | None = None, spacing: tuple[float, float, float] | None = None
) -> InputVolume:
    """Read a volume.

    Parameters
    ----------
    path
        NRRD, a segmentation of 3D Slicer, NIfTI, MetaImage, VTK image, or a folder of DICOM slices.
    series
        Description, number or UID of the series to read, if the folder contains several.
    spacing
        Distances between voxel centres, mm, if the file does not contain them.

    Returns
    -------
    InputVolume
        The values, their position in the world, and the names of the labels.

    Raises
    ------
    StageError
        If the file cannot be read, or is not a volume.
    """
    found = _native.read_volume(path, series, spacing)
    return InputVolume(
        found["values"].T,
        np.array(found["axes"]).T * found["spacing"],
        np.array(found["origin"]),
        found["is_lps"],
        found["names"],
        found["layers"],
    )


def read_label_volume(path: Path) -> InputVolume:
    """Read a label volume: whole numbers, with 0 for no tissue.

    Parameters
    ----------
    path
        Any volume that :func:`read_volume` reads.

    Raises
    ------
    StageError
        If the volume has values that are not whole numbers, or several layers.
    """
    advice = "give the label volume that the case was made from"
    volume = read_volume(path)
    values = volume.values
    if volume.layers > 1:
        raise StageError(
            f"{path}: has {volume.layers} layers of segments, which may overlap",
            "a tetrahedron belongs to one region",
            "export the segments as one label map (3D Slicer: Segmentations, Export to labelmap)",
        )
    is_real = not np.issubdtype(values.dtype, np.integer)
    bad = int((~np.isfinite(values) | (values != np.round(values))).sum()) if is_real else 0
    if bad:
        raise StageError(
            f"{path}: {bad} of {values.size} values are not whole numbers", "labels must be whole numbers", advice
        )
    limits = np.iinfo(np.int32)
    if values.size and not limits.min <= values.min() <= values.max() <= limits.max:
        raise StageError(
            f"{path}: holds labels from {values.min():.0f} to {values.max():.0f}",
            "regions are written as whole numbers of 32 bits",
            "give the labels smaller numbers",
        )
    if not values.any():
        raise StageError(f"{path}: holds no label but 0", "there is no tissue in it", advice)
    return replace(volume, values=values.astype(np.int64)) if is_real else volume
