"""Measures the helix angles of fibres by depth, in each wall of the ventricles."""

from __future__ import annotations

from typing import Any

import numpy as np

from tetmesh_check.fibres.rule import Harmonic, frames, ventricle_share
from tetmesh_check.quality import Points, Values

LAYERS = 5
"""Number of layers of equal depth in a wall."""


def helix_by_depth(fibre: Points, along: Points, epi: Harmonic, rv: Harmonic | None) -> dict[str, list[dict[str, Any]]]:
    """Return the helix angles in layers of each wall, by depth.

    The angles are those to the circumferential direction. The depth is 1 - ``lv`` in the left free
    wall and the septum, and ``epi`` in the right free wall.

    Parameters
    ----------
    fibre
        The fibre of each element.
    along, epi, rv
        See :func:`.directions`.
    """
    if rv is None:
        return {"wall": _layers(_helix(fibre, along, epi.gradients), epi.values)}
    slopes = [np.linalg.norm(own.gradients, axis=1) for own in (epi, rv)]
    # in the septum, epi is nearly constant; in the right free wall, both slopes are equal
    is_septum, is_right = slopes[0] < 0.5 * slopes[1], ventricle_share(epi, rv) > 0.5
    from_left = Harmonic(epi.values + rv.values, epi.gradients + rv.gradients)
    walls = {
        "left free wall": (~is_septum & ~is_right, from_left),
        "septum": (is_septum, from_left),
        "right free wall": (~is_septum & is_right, epi),
    }
    return {
        name: _layers(_helix(fibre[own], along[own], depth.gradients[own]), depth.values[own])
        for name, (own, depth) in walls.items()
    }


def _helix(fibre: Points, along: Points, out: Points) -> Values:
    """Return the angles to the circumferential direction, degrees."""
    around, up = (frames(along, out).as_matrix()[:, :, column] for column in (0, 1))
    components = (np.einsum("ij,ij->i", fibre, axis) for axis in (up, around))
    return np.asarray(np.degrees(np.arctan2(*components)))


def _layers(angles: Values, depths: Values) -> list[dict[str, Any]]:
    """Return count, mean and the percentiles 5 and 95 of the angles in each layer with elements."""
    layer = np.clip((LAYERS * depths).astype(np.int64), 0, LAYERS - 1)
    return [{"depth": (k + 0.5) / LAYERS, **_summary(angles[layer == k])} for k in range(LAYERS) if (layer == k).any()]


def _summary(angles: Values) -> dict[str, Any]:
    """Return count, mean and percentiles of angles with a period of 180 degrees."""
    # twice the angle of a direction does not depend on its sign
    doubled = np.exp(2j * np.radians(angles)).mean()
    mean = float(np.degrees(np.angle(doubled))) / 2.0
    low, high = np.percentile((angles - mean + 90.0) % 180.0 - 90.0, [5, 95])
    return {"count": len(angles), "mean": mean, "p5": mean + float(low), "p95": mean + float(high)}
