"""Which tissue a tetrahedron lies in, from a label volume, and which part of the boundary a triangle belongs to."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import nrrd
import numpy as np
import pyvista as pv
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from tetmesh_check.errors import StageError
from tetmesh_check.quality import Cells, Labels, Points
from tetmesh_check.surface import Surface, read_dataset

SURFACE, CAP = 1, 2
"""Marks of the boundary: the object's own surface, and where the border of the volume cut it."""
_TO_LPS = {
    "left-posterior-superior": (1.0, 1.0, 1.0),
    "lps": (1.0, 1.0, 1.0),
    "right-anterior-superior": (-1.0, -1.0, 1.0),
    "ras": (-1.0, -1.0, 1.0),
    "left-anterior-superior": (1.0, -1.0, 1.0),
    "las": (1.0, -1.0, 1.0),
}
"""Signs that turn the world of a NRRD file into the one that meshes are written in; all 1 for worlds that are not the body's."""
_ADVICE = "give the label volume that the case was made from (.nrrd, .nhdr or .vti)"


@dataclass(frozen=True)
class LabelVolume:
    """Whole numbers on a regular grid placed in the world."""

    values: NDArray[Any]
    """Labels, shape ``(nx, ny, nz)``; 0 is no tissue."""
    step: Points
    """World vectors from a voxel centre to the next along each grid axis, mm; one a column."""
    origin: Points
    """World position of the centre of voxel (0, 0, 0), mm."""

    @property
    def voxel_volume(self) -> float:
        """Volume of a voxel, mm^3."""
        return float(abs(np.linalg.det(self.step)))


def _read_nrrd(path: Path) -> tuple[NDArray[Any], Points, Points]:
    try:
        values, header = nrrd.read(str(path))
    except Exception as error:
        raise StageError.file(path, "read", error, "check that it is complete, and a NRRD file") from error
    if values.ndim != 3:
        raise StageError(f"{path}: has {values.ndim} axes", "labels are one number a voxel in 3-D", _ADVICE)
    signs = np.array(_TO_LPS.get(str(header.get("space", "")).lower(), (1.0, 1.0, 1.0)))
    directions = header.get("space directions")
    if directions is None:
        directions = np.diag(np.asarray(header.get("spacings", np.ones(3)), dtype=np.float64))
    origin = np.asarray(header.get("space origin", np.zeros(3)), dtype=np.float64)
    step = np.asarray(directions, dtype=np.float64).T
    if step.shape != (3, 3) or not np.isfinite(step).all() or np.linalg.det(step) == 0.0:
        raise StageError(f"{path}: its space directions span no volume", "labels are found by their position", _ADVICE)
    return values, signs[:, None] * step, signs * origin


def _read_image(path: Path) -> tuple[NDArray[Any], Points, Points]:
    image = read_dataset(path)
    if not isinstance(image, pv.ImageData) or image.active_scalars is None or image.active_scalars.ndim != 1:
        raise StageError(f"{path}: is no image of one number a voxel", "labels are found by their position", _ADVICE)
    step = np.asarray(image.direction_matrix, dtype=np.float64) * np.asarray(image.spacing)
    origin = np.asarray(image.origin, dtype=np.float64) + step @ np.array(image.extent[::2], dtype=np.float64)
    return np.asarray(image.active_scalars).reshape(image.dimensions, order="F"), step, origin


def read_label_volume(path: Path) -> LabelVolume:
    """Read labels.

    Parameters
    ----------
    path
        A NRRD file (``.nrrd``, ``.nhdr``) or a VTK image (``.vti``).

    Raises
    ------
    StageError
        If it is no volume of whole numbers.
    """
    if not path.is_file():
        raise StageError(f"{path}: no such file", "it says which tissue is where", _ADVICE)
    values, step, origin = (_read_nrrd if path.suffix in (".nrrd", ".nhdr") else _read_image)(path)
    if not np.issubdtype(values.dtype, np.integer):
        whole = np.isfinite(values) & (values == np.round(values))
        if not whole.all():
            raise StageError(
                f"{path}: {int((~whole).sum())} of {values.size} values are no whole numbers", "labels are", _ADVICE
            )
        values = values.astype(np.int64)
    if not values.any():
        raise StageError(f"{path}: holds no label but 0", "there is no tissue in it", _ADVICE)
    return LabelVolume(values, step, origin)


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
        That of the surface.
    """
    for entry in _histories(history):
        labels = entry.get("parameters", {}).get("labels") if entry.get("tool") == "distfield" else None
        if labels:
            return [int(label) for label in labels]
    return None


def _voxels(positions: Points, volume: LabelVolume) -> Labels:
    """Grid indices of the voxels that positions lie in, shape ``(n, 3)``; some may lie outside the grid."""
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
        Of its vertices, mm, shape ``(n, 3)``.
    volume
        The labels.
    wanted
        Those that were meshed; all but 0 by default.

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
    """Label of the voxel that each position lies in, or of the nearest voxel of a wanted label; shape ``(n,)``.

    Parameters
    ----------
    centres
        World positions, mm, shape ``(n, 3)``.
    volume
        The labels.
    wanted
        Those that were meshed, one of them at least in the volume (:func:`check_labels`); all but 0 by default.
    """
    inside = np.clip(_voxels(centres, volume), 0, np.array(volume.values.shape) - 1)
    found: Labels = volume.values[tuple(inside.T)].astype(np.int64)
    is_wanted = volume.values != 0 if wanted is None else np.isin(volume.values, wanted)
    missing = np.flatnonzero(~is_wanted[tuple(inside.T)])
    if len(missing):
        # the nearest voxel of a wanted label is one that has another kind of neighbour
        padded = np.pad(is_wanted, 1)
        core = np.ones_like(is_wanted)
        for axis in range(3):
            for shift in (-1, 1):
                core &= np.roll(padded, shift, axis)[1:-1, 1:-1, 1:-1]
        rim = np.argwhere(is_wanted & ~core)
        nearest = cKDTree(rim @ volume.step.T + volume.origin).query(centres[missing])[1]
        found[missing] = volume.values[tuple(rim[nearest].T)]
    return found


def boundary_marks(surface: Surface, points: Points, boundary: Cells) -> Labels:
    """Say for each triangle of the boundary whether it is :data:`SURFACE` or :data:`CAP`; shape ``(k,)``.

    Parameters
    ----------
    surface
        The input, with its own marks.
    points, boundary
        The boundary of the tetrahedra; a triangle is marked like that of the input whose centre is nearest.
    """
    marks = np.full(len(boundary), SURFACE, dtype=np.int64)
    if surface.cap is not None and surface.cap.any():
        nearest = cKDTree(surface.points[surface.triangles].mean(axis=1)).query(points[boundary].mean(axis=1))[1]
        marks[surface.cap[nearest]] = CAP
    return marks
