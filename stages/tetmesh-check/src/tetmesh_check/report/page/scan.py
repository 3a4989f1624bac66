"""The input volume: values on a grid in the world, and names of its axes."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import permutations
from pathlib import Path
from typing import Any

import numpy as np

from tetmesh_check.quality import Points, Values
from tetmesh_check.volumes import InputVolume, read_volume


def world_letters(anatomical: bool) -> list[list[str]]:
    """Name the directions of the axes of the world, the positive one first.

    Parameters
    ----------
    anatomical
        Whether the world is that of the body (LPS).
    """
    return [["L", "R"], ["P", "A"], ["S", "I"]] if anatomical else [[f"+{a}", f"\u2212{a}"] for a in "xyz"]


@dataclass(frozen=True)
class Scan(InputVolume):
    """A volume to be shown."""

    labels: bool = False
    """Whether the values are labels of tissues, not measurements."""
    crop: str | None = None
    """The region that was meshed; ``None`` for the whole volume."""
    downsample: list[int] | None = None
    """The number of voxels that were joined along each axis before meshing."""

    @property
    def spacing(self) -> Values:
        """Distance between voxel centres along each grid axis, mm; shape ``(3,)``."""
        return np.asarray(np.linalg.norm(self.step, axis=0))

    @property
    def world_axes(self) -> list[int]:
        """The world axis nearest to each grid axis; each world axis occurs once."""
        cosines = np.abs(self.step / self.spacing)
        return list(max(permutations(range(3)), key=lambda axes: cosines[np.array(axes), range(3)].sum()))

    @property
    def tilt(self) -> float:
        """Largest angle between a grid axis and the nearest world axis, degrees."""
        cosines = np.abs(self.step / self.spacing)[self.world_axes, range(3)]
        return float(np.degrees(np.arccos(min(cosines.min(), 1.0))))

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
        last, first = world_letters(self.anatomical)[world][:: 1 if self.step[world, grid_axis] > 0 else -1]
        return first, last

    def upright(self) -> Scan:
        """Return the same volume with grid axes in the order and direction of the world's."""
        order = np.argsort(self.world_axes)
        step = self.step[:, order]
        backward = np.diag(step) < 0
        values = np.flip(self.values.transpose(order), tuple(np.flatnonzero(backward)))
        origin = self.origin + step @ (backward * (np.array(values.shape) - 1))
        return replace(self, values=values, step=np.where(backward, -step, step), origin=origin)

    def around(self, index: Points, margin: float) -> Scan:
        """Return the part around some positions.

        Parameters
        ----------
        index
            The positions, fractional indices of voxels, shape ``(n, 3)``.
        margin
            Relative to their longest side.
        """
        low, high = index.min(axis=0), index.max(axis=0)
        wide = margin * float(((high - low) * self.spacing).max()) / self.spacing
        last = np.array(self.values.shape) - 1
        first = np.clip(np.floor(low - wide), 0, last).astype(int)
        end = np.clip(np.ceil(high + wide), first, last).astype(int) + 1
        values = self.values[tuple(map(slice, first, end))]
        return replace(self, values=values, origin=self.origin + self.step @ first)


def read_scan(path: Path, labels: bool, reading: dict[str, Any]) -> Scan:
    """Read the input of a case, without cropping it.

    Parameters
    ----------
    path
        Any volume that the stages read.
    labels
        Whether it holds labels.
    reading
        The parameters of ``distfield``. Only those about reading the volume are used.

    Raises
    ------
    StageError
        If it cannot be read.
    """
    volume = read_volume(path, reading.get("series"), reading.get("spacing"))
    return Scan(**vars(volume), labels=labels, crop=reading.get("crop"), downsample=reading.get("downsample"))
