"""A label volume: whole numbers on a regular grid placed in the world."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tetmesh_check.errors import StageError
from tetmesh_check.volumes import InputVolume, read_volume

_ADVICE = "give the label volume that the case was made from"


@dataclass(frozen=True)
class LabelVolume(InputVolume):
    """Whole numbers, of which 0 is no tissue."""

    @property
    def voxel_volume(self) -> float:
        """Volume of a voxel, mm^3."""
        return float(abs(np.linalg.det(self.step)))


def read_label_volume(path: Path) -> LabelVolume:
    """Read labels.

    Parameters
    ----------
    path
        Any volume that :func:`.read_volume` reads.

    Raises
    ------
    StageError
        If it is no volume of whole numbers, or has several layers.
    """
    volume = read_volume(path)
    values = volume.values
    if volume.layers > 1:
        raise StageError(
            f"{path}: has {volume.layers} layers of segments, which may overlap",
            "a tetrahedron belongs to one region",
            "export the segments as one label map (3D Slicer: Segmentations, Export to labelmap)",
        )
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
    return LabelVolume(**{**vars(volume), "values": values})
