"""The input volume: values on a grid in the world, and names of its axes."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tetmesh_check.quality import Points, Values
from tetmesh_check.volumes import read_volume

_PLANES = ("sagittal", "coronal", "axial")
"""The plane across each axis of the body's world."""
_BODY = (("L", "R"), ("P", "A"), ("S", "I"))
"""Letters towards the positive and the negative end of each axis of LPS, the world that meshes are
written in."""


@dataclass(frozen=True)
class Scan:
    """A volume."""

    values: NDArray[Any]
    """One number a voxel, shape ``(nx, ny, nz)``."""
    step: Points
    """World vectors from a voxel centre to the next along each grid axis, mm; one a column."""
    origin: Points
    """World position of the centre of voxel (0, 0, 0), mm."""
    anatomical: bool
    """Whether the world is that of the body (LPS)."""
    labels: bool
    """Whether the numbers are names of tissues rather than a measure."""
    names: dict[int, str] = field(default_factory=dict)
    """Names of labels, where the file has them."""
    layers: int = 1
    """Number of layers, of which the first is shown."""

    @property
    def spacing(self) -> Values:
        """Between voxel centres along each grid axis, mm; shape ``(3,)``."""
        return np.asarray(np.linalg.norm(self.step, axis=0))

    @property
    def world_axes(self) -> tuple[int, int, int]:
        """The axis of the world that each grid axis is nearest to, each once."""
        from scipy.optimize import linear_sum_assignment

        _, columns = linear_sum_assignment(-np.abs(self.step / self.spacing).T)
        return int(columns[0]), int(columns[1]), int(columns[2])

    @property
    def tilt(self) -> float:
        """Largest angle between a grid axis and the nearest world axis, degrees."""
        cosines = [abs(self.step[world, grid]) / self.spacing[grid] for grid, world in enumerate(self.world_axes)]
        return float(np.degrees(np.arccos(np.clip(min(cosines), -1.0, 1.0))))

    def to_index(self, world: Points) -> Points:
        """Turn positions into fractional indices of voxels.

        Parameters
        ----------
        world
            Positions, mm, shape ``(n, 3)``.
        """
        return np.asarray(np.linalg.solve(self.step, (world - self.origin).T).T)

    def letters(self, grid_axis: int) -> tuple[str, str]:
        """Name the ends of a grid axis: at the first voxel, and at the last.

        Parameters
        ----------
        grid_axis
            0, 1 or 2.
        """
        world = self.world_axes[grid_axis]
        forward = self.step[world, grid_axis] > 0
        positive, negative = _BODY[world] if self.anatomical else (f"+{'xyz'[world]}", f"\u2212{'xyz'[world]}")
        return (negative, positive) if forward else (positive, negative)

    def plane(self, grid_axis: int) -> str:
        """Name the plane across a grid axis.

        Parameters
        ----------
        grid_axis
            0, 1 or 2.
        """
        world = self.world_axes[grid_axis]
        return _PLANES[world] if self.anatomical else f"across {'xyz'[world]}"


def read_scan(path: Path, labels: bool, series: str | None = None) -> Scan:
    """Read the input of a case.

    Parameters
    ----------
    path
        Any volume that the stages read.
    labels
        Whether it holds labels.
    series
        Series of a folder of DICOM slices that holds several.

    Raises
    ------
    StageError
        If it cannot be read.
    """
    volume = read_volume(path, series)
    return Scan(volume.values, volume.step, volume.origin, volume.anatomical, labels, volume.names, volume.layers)
