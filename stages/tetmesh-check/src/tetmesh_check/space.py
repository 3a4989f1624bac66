"""World frames. The stage computes in LPS (left, posterior, superior); files may be in RAS."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pyvista as pv

from tetmesh_check.datasets import text_of
from tetmesh_check.errors import StageError
from tetmesh_check.quality import Points

_SIGNS = np.array([-1.0, -1.0, 1.0])
_STATED = re.compile(rb"isoparticles [^\n]*world frame (LPS|RAS)")
"""Frame in the header of a surface without field data: PLY, STL, OBJ or legacy VTK."""
_HEADER_BYTES = 256
"""In these formats, the frame is in the first line, after at most 48 bytes."""


def turned(points: Points) -> Points:
    """Convert positions from LPS to RAS, or back. Only signs change, so the result is exact.

    Parameters
    ----------
    points
        Positions, mm, shape ``(n, 3)``.
    """
    return np.asarray(points * _SIGNS)


def space_of(dataset: pv.DataSet, path: Path) -> str | None:
    """Return the frame that a file contains: ``lps``, ``ras``, or ``None`` for another or none.

    Parameters
    ----------
    dataset
        The file as read.
    path
        The file.
    """
    text = text_of(dataset, "space") or text_of(dataset, "geometry")
    if text is None:
        with path.open("rb") as file:
            found = _STATED.search(file.read(_HEADER_BYTES))
        return found[1].decode().lower() if found else None
    try:
        stated = json.loads(text)
    except ValueError:
        return None
    name = str(stated.get("space") if isinstance(stated, dict) else stated).lower()
    return name if name in ("lps", "ras") else None


def in_lps(dataset: pv.DataSet, path: Path) -> pv.DataSet:
    """Convert a data set in RAS to LPS. Vector arrays remain in the frame of the file.

    Parameters
    ----------
    dataset
        The file as read.
    path
        The file.
    """
    if space_of(dataset, path) != "ras":
        return dataset
    if isinstance(dataset, pv.ImageData):
        dataset.origin = turned(np.array(dataset.origin))
        dataset.direction_matrix = _SIGNS[:, None] * np.asarray(dataset.direction_matrix)
    else:
        dataset.points = turned(dataset.points)
    return dataset


def output_space(choice: str | None, own: str | None, scanner: str | None) -> str | None:
    """Return the frame of the output: ``lps``, ``ras``, or ``None`` if the input has none.

    Parameters
    ----------
    choice
        The value of ``--space``.
    own
        The frame of the surface.
    scanner
        The frame of the volume's file, or ``None`` if unknown, as in files of older versions.

    Raises
    ------
    StageError
        If RAS is chosen for a surface without an anatomical frame.
    """
    if own is None and choice == "ras":
        raise StageError(
            "RAS coordinates (--space ras, --for simnibs or brainstorm): the surface names no anatomical space",
            "its coordinates do not define left and right",
            "omit that option to keep its coordinates, or use the .vtp surface of a volume with such a space",
        )
    if own is None or choice is None:
        return own
    return choice if choice != "scanner" else scanner or "lps"
