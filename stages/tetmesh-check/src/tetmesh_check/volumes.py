"""Volumes of all formats that the stages read."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from isoparticles import _native
from isoparticles._errors import Error
from numpy.typing import NDArray

from tetmesh_check.errors import StageError
from tetmesh_check.quality import Points


@dataclass(frozen=True)
class InputVolume:
    """Numbers on a regular grid in the world frame of the meshes."""

    values: NDArray[Any]
    """Numbers in the file's own type, shape ``(nx, ny, nz)``; the first layer where there are
    several."""
    step: Points
    """World vectors from a voxel centre to the next along each grid axis, mm; one a column."""
    origin: Points
    """World position of the centre of voxel (0, 0, 0), mm."""
    anatomical: bool
    """Whether the world is that of the body (left, posterior, superior)."""
    names: dict[int, str] = field(default_factory=dict)
    """Names of the labels of the first layer, where the file gives them."""
    layers: int = 1
    """Number of layers; segments of different layers may overlap."""


def read_volume(path: Path, series: str | None = None) -> InputVolume:
    """Read a volume.

    Parameters
    ----------
    path
        NRRD, a segmentation of 3D Slicer, NIfTI, MetaImage, VTK image, or a folder of DICOM slices.
    series
        Series of a folder that holds several: its description, number or UID.

    Returns
    -------
    InputVolume
        Its numbers, where they lie in the world, and what labels are called.

    Raises
    ------
    StageError
        If it cannot be read, or is no volume.
    """
    try:
        found = _native.read_volume(path, series)
    except Error as error:
        raise StageError(error.what, error.why, error.next) from error
    return InputVolume(
        found["values"].T,
        np.array(found["axes"]).T * found["spacing"],
        np.array(found["origin"]),
        found["is_lps"],
        found["names"],
        found["layers"],
    )
