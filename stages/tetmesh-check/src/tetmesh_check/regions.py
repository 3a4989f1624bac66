"""Finds the tissue of each tetrahedron, and the part of the boundary of each triangle."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from isoparticles import _native

from tetmesh_check.errors import StageError
from tetmesh_check.labels import LabelVolume
from tetmesh_check.quality import Cells, Labels, Points
from tetmesh_check.surface import Surface

SURFACE, CAP = 1, 2
"""Marks of the boundary: the surface of the object, and its cut by the border of the volume."""
_TIE = 0.01
"""Distances that differ by less than this share of the longest edge of a triangle are equal."""
_ADVICE = "give the label volume that the case was made from"


def _histories(history: Any) -> Iterator[Any]:
    """A history and those of all its inputs."""
    if isinstance(history, dict):
        yield history
        for entry in history.get("inputs", []):
            yield from _histories(entry.get("history"))


def meshed_labels(history: Any) -> list[int] | None:
    """Find the labels that ``distfield`` was told to mesh, or ``None``.

    Parameters
    ----------
    history
        The history of the surface.
    """
    for entry in _histories(history):
        labels = entry.get("parameters", {}).get("labels") if entry.get("tool") == "distfield" else None
        if labels:
            return [int(label) for label in labels]
    return None


def has_scale(history: Any) -> bool:
    """Tell whether ``distfield`` smoothed the object at a scale above 0.

    Parameters
    ----------
    history
        The history of the surface.
    """
    scales = (
        entry.get("parameters", {}).get("scale") for entry in _histories(history) if entry.get("tool") == "distfield"
    )
    return any(scales)


def _voxels(positions: Points, volume: LabelVolume) -> Labels:
    """Grid indices of the voxels of positions, shape ``(n, 3)``; may lie outside."""
    index: Labels = np.round(np.linalg.solve(volume.step, (positions - volume.origin).T).T).astype(np.int64)
    return index


def share_outside(positions: Points, volume: LabelVolume) -> float:
    """Share of positions that lie in no voxel.

    Parameters
    ----------
    positions
        World positions, mm, shape ``(n, 3)``.
    volume
        The labels.
    """
    index = _voxels(positions, volume)
    return float(((index < 0) | (index >= np.array(volume.values.shape))).any(axis=1).mean())


def check_labels(positions: Points, volume: LabelVolume, wanted: list[int] | None) -> None:
    """Refuse a label volume that cannot be that of an object.

    Parameters
    ----------
    positions
        Positions of its vertices, mm, shape ``(n, 3)``.
    volume
        The labels.
    wanted
        The meshed labels; all but 0 by default.

    Raises
    ------
    StageError
        If none of them is in the volume, or if the volume lies elsewhere.
    """
    if share_outside(positions, volume) > 0.5:
        raise StageError(
            "more than half of the surface lies outside the label volume",
            "it belongs to another case, or its position in the world differs",
            _ADVICE,
        )
    if wanted is not None and not np.isin(volume.values, wanted).any():
        raise StageError(f"labels {wanted} are not in the label volume", "they are what was meshed", _ADVICE)


def regions_of(centres: Points, volume: LabelVolume, wanted: list[int] | None) -> Labels:
    """Label of the voxel of each position, or of the nearest wanted voxel.

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


def boundary_marks(surface: Surface, points: Points, boundary: Cells) -> Labels:
    """Return :data:`SURFACE` or :data:`CAP` for each triangle of the boundary.

    Parameters
    ----------
    surface
        The input, with its own marks.
    points, boundary
        The boundary of the tetrahedra; a triangle is marked like that of the input nearest to its
        centre, and where a marked and another one are equally near, like the one whose normal is
        more like its own.
    """
    marks = np.full(len(boundary), SURFACE, dtype=np.int64)
    if surface.cap is None or not surface.cap.any():
        return marks
    if surface.cap.all():
        return np.full(len(boundary), CAP, dtype=np.int64)
    corners = points[boundary]
    centres = corners.mean(axis=1)
    parts = [surface.triangles[mark] for mark in (surface.cap, ~surface.cap)]
    (nearest_cap, to_cap), (nearest_rest, to_rest) = (_native.nearest(surface.points, part, centres) for part in parts)
    marks[to_cap < to_rest] = CAP
    longest = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
    ties = np.flatnonzero(np.abs(to_cap - to_rest) <= _TIE * longest)
    normals = _normals(points, boundary[ties])
    like_cap, like_rest = (
        np.einsum("ij,ij->i", normals, _normals(surface.points, part[nearest[ties]]))
        for part, nearest in zip(parts, (nearest_cap, nearest_rest), strict=True)
    )
    marks[ties] = np.where(like_cap > like_rest, CAP, SURFACE)
    return marks


def _normals(points: Points, triangles: Cells) -> Points:
    """Unit normals, shape ``(n, 3)``; zero for triangles without an area."""
    a, b, c = (points[triangles[:, k]] for k in range(3))
    normals: Points = np.cross(b - a, c - a)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), np.finfo(np.float64).tiny)
    return normals
