"""Finds the tissue of each tetrahedron, and parameters in histories."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from isoparticles import _native

from tetmesh_check.errors import StageError
from tetmesh_check.quality import Labels, Points
from tetmesh_check.volumes import InputVolume

SURFACE, CAP = 1, 2
"""Marks of the boundary: the surface of the object, and where the border of the volume cuts it."""
_ADVICE = "give the label volume that the case was made from"


def _parameters(history: Any) -> Iterator[dict[str, Any]]:
    """Yield the parameters of ``distfield`` in a history and in those of all its inputs."""
    if isinstance(history, dict):
        if history.get("tool") == "distfield":
            yield history.get("parameters", {})
        for entry in history.get("inputs", []):
            yield from _parameters(entry.get("history"))


def distfield_parameter(history: Any, name: str) -> Any:
    """Return a parameter of ``distfield`` in a history, or ``None``.

    Parameters
    ----------
    history
        The history of a file.
    name
        The parameter.
    """
    return next((parameters.get(name) for parameters in _parameters(history)), None)


def meshed_labels(history: Any) -> list[int] | None:
    """Find the labels that ``distfield`` was told to mesh, or ``None``.

    Parameters
    ----------
    history
        The history of the surface.
    """
    found = filter(None, (parameters.get("labels") for parameters in _parameters(history)))
    return next((list(map(int, labels)) for labels in found), None)


def has_scale(history: Any) -> bool:
    """Tell whether ``distfield`` smoothed the object at a scale above 0.

    Parameters
    ----------
    history
        The history of the surface.
    """
    return any(parameters.get("scale") for parameters in _parameters(history))


def share_outside(positions: Points, volume: InputVolume) -> float:
    """Return the share of positions that lie in no voxel.

    Parameters
    ----------
    positions
        World positions, mm, shape ``(n, 3)``.
    volume
        The labels.
    """
    index = np.round(np.linalg.solve(volume.step, (positions - volume.origin).T).T).astype(np.int64)
    return float(((index < 0) | (index >= np.array(volume.values.shape))).any(axis=1).mean())


def check_labels(positions: Points, volume: InputVolume, wanted: list[int] | None) -> None:
    """Refuse a label volume that cannot belong to the surface.

    Parameters
    ----------
    positions
        Vertices of the surface, mm, shape ``(n, 3)``.
    volume
        The labels.
    wanted
        The meshed labels; all but 0 by default.

    Raises
    ------
    StageError
        If the volume has none of these labels, or lies elsewhere.
    """
    if share_outside(positions, volume) > 0.5:
        raise StageError(
            "more than half of the surface lies outside the label volume",
            "it belongs to another case, or its position in the world differs",
            _ADVICE,
        )
    if wanted is not None and not np.isin(volume.values, wanted).any():
        raise StageError(f"labels {wanted} are not in the label volume", "these labels were meshed", _ADVICE)


def regions_of(centres: Points, volume: InputVolume, wanted: list[int] | None) -> Labels:
    """Return the label at each position, or that of the nearest wanted voxel.

    Parameters
    ----------
    centres
        World positions, mm, shape ``(n, 3)``.
    volume
        The labels.
    wanted
        The meshed labels, at least one of which is in the volume (:func:`check_labels`); all but 0
        by default.
    """
    labels = volume.values.astype(np.int32, copy=False)
    return _native.labels_at(labels, volume.step.T.tolist(), tuple(volume.origin), centres, wanted)
