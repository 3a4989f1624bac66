"""F, the cubic B-spline through the samples of the distance field, with its gradient: what the mid-edge nodes are brought onto.

The same function as ``common/field/src/spline`` has, in world coordinates: interpolating, mirrored at the border of the grid (Unser,
Aldroubi and Eden 1993). Only the part of the grid round the object is turned into coefficients.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyvista as pv
from numpy.typing import NDArray
from scipy.ndimage import spline_filter

from tetmesh_check.errors import StageError
from tetmesh_check.quality import Points, Values
from tetmesh_check.surface import history_of, read_dataset

ARRAY_NAME = "signed_distance"
"""Point array of a distance field: F at the voxel centres, mm, negative inside."""
MARGIN = 16
"""Voxels round the object that go into the coefficients: a sample further off counts less than (2 - sqrt(3))^16 < 1e-9 of itself."""
STEPS = 25
"""Newton steps that a projection may take, as in ``common/field``."""
LEAST_SLOPE = 1e-4
"""A projection gives up where the gradient is no longer than this (F is a distance: 1 nearly everywhere), as in ``common/field``."""
TOLERANCE = 1e-6
"""Largest distance from F = 0 of a projected point over the voxel: a tenth of what the spline is off for a ball of ten voxels (1.6e-5)."""
_BLOCK = 1 << 14


@dataclass(frozen=True)
class DistanceField:
    """F on a part of a grid."""

    coefficients: NDArray[np.float64]
    """Of the B-splines, shape ``(nx, ny, nz)``."""
    step: NDArray[np.float64]
    """World vectors from a voxel centre to the next along each grid axis, mm; one a column."""
    origin: NDArray[np.float64]
    """World position of the first coefficient's voxel centre, mm."""

    @property
    def voxel(self) -> float:
        """Geometric mean spacing, mm."""
        return float(abs(np.linalg.det(self.step)) ** (1.0 / 3.0))

    def at(self, world: Points) -> tuple[Values, Points]:
        """F, mm, and its gradient at world positions, clamped to the grid.

        Parameters
        ----------
        world
            Positions, mm, shape ``(n, 3)``.
        """
        values, gradients = np.empty(len(world)), np.empty((len(world), 3))
        for start in range(0, len(world), _BLOCK):
            block = slice(start, start + _BLOCK)
            values[block], gradients[block] = self._at(world[block])
        return values, gradients

    def _at(self, world: Points) -> tuple[Values, Points]:
        shape = np.array(self.coefficients.shape)
        inverse = np.linalg.inv(self.step)
        index = np.clip((world - self.origin) @ inverse.T, 0, shape - 1)
        base = np.minimum(np.floor(index).astype(np.int64), shape - 2)
        weights, slopes = _weights(index - base)
        at = base[:, :, None] + np.arange(-1, 3)
        last = (shape - 1)[:, None]
        at = np.abs(at)
        at = np.where(at > last, 2 * last - at, at)
        picked = self.coefficients[at[:, 0, :, None, None], at[:, 1, None, :, None], at[:, 2, None, None, :]]
        along = [slopes[:, axis] for axis in range(3)]
        across = [weights[:, axis] for axis in range(3)]
        value = np.einsum("nijk,ni,nj,nk->n", picked, *across, optimize=True)
        slope = np.stack(
            [
                np.einsum(
                    "nijk,ni,nj,nk->n", picked, *(along[k] if k == axis else across[k] for k in range(3)), optimize=True
                )
                for axis in range(3)
            ],
            axis=1,
        )
        return value, slope @ inverse

    def project(self, world: Points, limits: Values) -> tuple[Points, NDArray[np.bool_]]:
        """Bring points onto F = 0 by Newton steps along the gradient.

        Parameters
        ----------
        world
            Where they start, mm, shape ``(n, 3)``.
        limits
            How far each may go, mm, shape ``(n,)``.

        Returns
        -------
        tuple
            Where they end, and which of them have arrived; the others are where they started.
        """
        reached = world.copy()
        arrived = np.zeros(len(world), dtype=bool)
        moving = np.arange(len(world))
        for _ in range(STEPS):
            value, gradient = self.at(reached[moving])
            squared = np.einsum("ij,ij->i", gradient, gradient)
            there = np.abs(value) <= TOLERANCE * self.voxel * np.minimum(np.sqrt(squared), 1.0)
            arrived[moving[there]] = True
            going = ~there & (squared > LEAST_SLOPE**2)
            moving, value, gradient, squared = moving[going], value[going], gradient[going], squared[going]
            step = -gradient * (value / squared)[:, None]
            length = np.linalg.norm(step, axis=1)
            step *= (np.minimum(length, 0.5 * self.voxel) / np.maximum(length, np.finfo(float).tiny))[:, None]
            reached[moving] += step
            moving = moving[np.linalg.norm(reached[moving] - world[moving], axis=1) <= limits[moving]]
            if not len(moving):
                break
        reached[~arrived] = world[~arrived]
        return reached, arrived


def _weights(fraction: Points) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The four cubic B-splines round a place between two nodes, and their slopes; shape ``(n, 3, 4)``."""
    t = fraction
    s = 1.0 - t
    weights = np.stack([s**3, 4.0 - 6.0 * t**2 + 3.0 * t**3, 4.0 - 6.0 * s**2 + 3.0 * s**3, t**3], axis=-1) / 6.0
    slopes = np.stack([-(s**2), t * (3.0 * t - 4.0), -s * (3.0 * s - 4.0), t**2], axis=-1) / 2.0
    return weights, slopes


def read_distance_field(path: Path, points: Points) -> tuple[DistanceField, object]:
    """Read the distance field round an object.

    Parameters
    ----------
    path
        What ``distfield`` wrote.
    points
        The object's vertices, world coordinates, mm.

    Returns
    -------
    tuple
        The field, and the history that the file carries.

    Raises
    ------
    StageError
        If it is of another kind, flat, has values that are no numbers, or does not hold the object.
    """
    advice = "give the file that distfield wrote for this surface"
    image = read_dataset(path)
    found = ", ".join(image.point_data.keys()) or "none"
    if not isinstance(image, pv.ImageData) or ARRAY_NAME not in image.point_data:
        raise StageError(
            f"{path}: is no image with a point array named '{ARRAY_NAME}' (those present: {found})",
            "mid-edge nodes are brought onto the surface where that distance is 0",
            advice,
        )
    values = np.asarray(image.point_data[ARRAY_NAME])
    if min(image.dimensions) < 2 or values.ndim != 1 or not np.isfinite(values).all():
        raise StageError(
            f"{path}: is flat, many-valued or not finite {image.dimensions}", "F is one number a voxel in 3-D", advice
        )
    values = values.reshape(image.dimensions, order="F")
    step = np.asarray(image.direction_matrix, dtype=np.float64) * np.asarray(image.spacing)
    origin = np.asarray(image.origin, dtype=np.float64) + step @ np.array(image.extent[::2], dtype=np.float64)
    index = np.linalg.solve(step, (points - origin).T).T
    low, high = index.min(axis=0), index.max(axis=0)
    # a vertex may lie half a voxel beyond the outermost centres, where the border of the volume is
    if (low < -0.5).any() or (high > np.array(values.shape) - 0.5).any():
        raise StageError(
            f"{path}: the surface reaches beyond this field (voxels {low.round(1).tolist()} to {high.round(1).tolist()} of "
            f"{list(values.shape)})",
            "F is not known there, so they do not belong together",
            advice,
        )
    first = np.maximum(np.floor(low).astype(np.int64) - MARGIN, 0)
    last = np.minimum(np.ceil(high).astype(np.int64) + MARGIN, np.array(values.shape) - 1)
    part = values[tuple(slice(a, b + 1) for a, b in zip(first, last, strict=True))]
    coefficients = spline_filter(part, order=3, output=np.float64, mode="mirror")
    return DistanceField(coefficients, step, origin + step @ first), history_of(image)
