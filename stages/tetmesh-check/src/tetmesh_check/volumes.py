"""Volumes of all formats, read by ``isoparticles-volume``."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyvista as pv
from numpy.typing import NDArray

from tetmesh_check.errors import StageError
from tetmesh_check.field_data import text_of
from tetmesh_check.files import temporary_folder
from tetmesh_check.quality import Points
from tetmesh_check.surface import read_dataset

_PROGRAM = "isoparticles-volume"
_FOLDER_VARIABLE = "ISOPARTICLES_BIN"
"""Environment variable with the folder that holds the programs of the stages."""


@dataclass(frozen=True)
class InputVolume:
    """One number a voxel on a regular grid placed in the world that the meshes are written in."""

    values: NDArray[Any]
    """Numbers in the file's own type, shape ``(nx, ny, nz)``; the first layer where there are
    several."""
    step: Points
    """World vectors from a voxel centre to the next along each grid axis, mm; one a column."""
    origin: Points
    """World position of the centre of voxel (0, 0, 0), mm."""
    names: dict[int, str]
    """Names of the labels of the first layer, where the file gives them."""
    layers: int
    """Number of layers; segments of different layers may overlap."""
    anatomical: bool
    """Whether the world is that of the body (left, posterior, superior)."""


def find_program(name: str) -> Path:
    """Find a program in ``ISOPARTICLES_BIN``, beside the interpreter or in ``PATH``.

    Parameters
    ----------
    name
        Name of the program.

    Raises
    ------
    StageError
        If it is in none of these places.
    """
    given = os.environ.get(_FOLDER_VARIABLE)
    folders = [folder for folder in (given, str(Path(sys.executable).parent), os.environ.get("PATH")) if folder]
    for folder in folders:
        if found := shutil.which(name, path=folder):
            return Path(found)
    raise StageError(
        f"the program {name} is not there",
        "it reads the volume, as it does for the other stages",
        f"build it (cargo build --release), and name its folder (target/release) in {_FOLDER_VARIABLE} or in PATH",
    )


def _convert(path: Path, target: Path, series: str | None) -> None:
    """Convert a volume to a VTK image by ``isoparticles-volume``, and raise its error as ours."""
    report = target.with_suffix(".json")
    words = [str(find_program(_PROGRAM)), "convert", str(path), "-o", str(target), "--report", str(report), "-q"]
    words += [] if series is None else ["--series", series]
    done = subprocess.run(words, stdin=subprocess.DEVNULL, capture_output=True, text=True, check=False)
    if done.returncode == 0:
        return
    try:
        parts = json.loads(report.read_text(encoding="utf-8"))["error"]
        error = StageError(parts["what"], parts["why"], parts["next"])
    except (OSError, ValueError, KeyError, TypeError):
        error = StageError(
            f"{path}: {_PROGRAM} ended with code {done.returncode}: {done.stderr.strip()[-400:]}",
            "it reads the volume, as it does for the other stages",
            f"run {_PROGRAM} info {path}; if it is of an older version, build it again",
        )
    raise error


def read_volume(path: Path, series: str | None = None) -> InputVolume:
    """Read a volume.

    Parameters
    ----------
    path
        NRRD, a segmentation of 3D Slicer, NIfTI, MetaImage, VTK image, or a folder of DICOM slices.
    series
        Series of a folder that holds several: its description, number or UID.

    Returns
    -------
    InputVolume
        Its numbers, where they lie in the world, and what labels are called.

    Raises
    ------
    StageError
        If it cannot be read, or is no volume.
    """
    with temporary_folder("isoparticles-") as folder:
        target = folder / "volume.vti"
        _convert(path, target, series)
        image = read_dataset(target)
    if not isinstance(image, pv.ImageData):
        raise StageError(f"{path}: was not written as an image", "this is a bug of the programs", "report it")
    segments = json.loads(text_of(image, "segments") or "[]")
    geometry = json.loads(text_of(image, "geometry") or "{}")
    # the geometry in the field data is exact, and holds for axes that are not orthogonal, too
    directions = np.reshape(geometry["directions"], (3, 3)).T
    return InputVolume(
        values=np.asarray(image.point_data["values"]).reshape(image.dimensions, order="F"),
        step=directions * np.asarray(geometry["spacing"], dtype=np.float64),
        origin=np.asarray(geometry["origin"], dtype=np.float64),
        names={int(segment["label"]): segment["name"] for segment in segments if segment["layer"] == 0},
        layers=len(image.point_data.keys()),
        anatomical=geometry["space"] == "Lps",
    )
