"""The rule of Bayer et al. for the directions of heart muscle (Ann Biomed Eng 40:2243-2254, 2012).

Inputs are apicobasal directions, the angles, and values and gradients of harmonic functions in each
element: ``lv``, ``rv`` and ``epi`` are each 1 at one surface (left endocardium, right endocardium,
epicardium) and 0 at the other two. Outputs are orthonormal vectors: fibre, sheet (within the sheet,
across the fibre) and sheet normal.

One formula differs from the paper. There, the angles of the endocardial frame do not depend on
``epi``, so that in a free wall the helix angle follows the square of ``epi``, and jumps if its ends
differ by more than 90 degrees. Here, they follow ``epi`` as those of the epicardial frame do. In a
free wall the angle is then linear in ``epi``, for any ends. In the septum the rule is the same.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from tetmesh_check.fibres.arguments import Angles
from tetmesh_check.quality import Points, Values

_PARALLEL = 1e-6
"""Minimum sine of the angle between two directions that define a frame. Below it, such as on the
axis of the apex, the frame is arbitrary; rounding errors of the gradients are smaller."""
_LEVEL = 1e-8
"""Minimum length of a gradient, relative to the longest one. The longest is about 1 / h, at the
apex, and the solver's error of 1e-10 gives 1e-10 / h. The ventricles of ``test_fibres.py`` have at
least 1e-3."""
_ON_EPICARDIUM = 1e-6
"""1 - ``epi`` of an element whose points are all on the epicardium. The solver's error is 1e-10."""
_FLIPS = Rotation.from_quat(np.eye(4))
"""Half turns about the three axes, and no turn. They change only the signs of the vectors."""


class Harmonic(NamedTuple):
    """A harmonic function at the centroids of the elements."""

    values: Values
    gradients: Points


def unit(vectors: Points) -> Points:
    """Return vectors of length 1 with the same directions; zero vectors remain."""
    return np.asarray(vectors / np.maximum(np.linalg.norm(vectors, axis=1, keepdims=True), 1e-300))


def is_level(gradients: Points) -> NDArray[np.bool_]:
    """Return whether each gradient is too short to define a direction."""
    lengths = np.linalg.norm(gradients, axis=1)
    return np.asarray(lengths <= _LEVEL * lengths.max())


def frames(along: Points, across: Points) -> Rotation:
    """Return frames whose columns are the circumferential, apicobasal and transmural directions.

    Parameters
    ----------
    along
        The apicobasal gradients, shape ``(m, 3)``. The frame is arbitrary where one is too short.
    across
        The transmural directions. The frame contains their part that is orthogonal to ``along``.
    """
    up, out = unit(along), unit(across)
    up[is_level(along)] = [0.0, 0.0, 1.0]
    out = out - np.einsum("ij,ij->i", out, up)[:, None] * up
    lost = np.linalg.norm(out, axis=1) < _PARALLEL
    least = np.eye(3)[np.abs(up[lost]).argmin(axis=1)]
    out[lost] = np.cross(up[lost], least)
    out = unit(out)
    return Rotation.from_matrix(np.stack([np.cross(up, out), up, out], axis=2))


def oriented(frame: Rotation, helix: Values, sheet: Values) -> Rotation:
    """Turn frames by the helix angle about the third axis, then by the sheet angle about the fibre.

    Parameters
    ----------
    frame
        The frames.
    helix, sheet
        Angles, degrees, shape ``(m,)``.
    """
    return frame * Rotation.from_euler("ZX", np.column_stack([helix, -sheet]), degrees=True)


def bislerp(first: Rotation, second: Rotation, share: Values) -> Rotation:
    """Interpolate frames along the shortest rotation, where signs of vectors do not count.

    Parameters
    ----------
    first, second
        The frames for the shares 0 and 1.
    share
        From 0 to 1, shape ``(m,)``.
    """
    angles = [((first * flip).inv() * second).magnitude() for flip in _FLIPS]
    start = first * _FLIPS[np.argmin(angles, axis=0)]
    return start * Rotation.from_rotvec(share[:, None] * (start.inv() * second).as_rotvec())


def ventricle_share(epi: Harmonic, rv: Harmonic) -> Values:
    """Return the share of the right ventricle: rv / (lv + rv), and its limit at the epicardium."""
    slope = np.einsum("ij,ij->i", epi.gradients, epi.gradients)
    limit = -np.einsum("ij,ij->i", rv.gradients, epi.gradients) / np.maximum(slope, 1e-300)
    inner = 1.0 - epi.values
    return np.clip(np.where(inner > _ON_EPICARDIUM, rv.values / np.maximum(inner, _ON_EPICARDIUM), limit), 0.0, 1.0)


def between(ends: Angles, epi: Values) -> Values:
    """Return angles that change linearly from the endocardium to the epicardium."""
    return np.asarray(ends[0] + (ends[1] - ends[0]) * epi)


def directions(
    along: Points, epi: Harmonic, rv: Harmonic | None, left: Values, right: Values
) -> tuple[Points, Points, Points]:
    """Return fibre, sheet and normal of each element, shape ``(m, 3)`` each.

    Parameters
    ----------
    along
        Apicobasal gradients, shape ``(m, 3)``.
    epi, rv
        The harmonic functions of the module's description; ``rv`` is ``None`` for one ventricle.
        The values of ``lv`` are 1 - ``epi`` - ``rv``.
    left, right
        Helix and sheet angles of each ventricle, degrees, shape ``(2, m)``.
    """
    transmural = frames(along, epi.gradients)
    if rv is None:
        found = oriented(transmural, *left)
    else:
        from_lv = epi.gradients + rv.gradients
        share = ventricle_share(epi, rv)
        # the frames of the septum point from the left to the right ventricle
        septal = (1.0 - share) * left - share * right
        first, second = (oriented(frames(along, across), *septal) for across in (from_lv, rv.gradients))
        outer = oriented(transmural, *((1.0 - share) * left + share * right))
        found = bislerp(bislerp(first, second, share), outer, np.clip(epi.values, 0.0, 1.0))
    vectors = found.as_matrix()
    return vectors[:, :, 0], vectors[:, :, 2], vectors[:, :, 1]
