"""Reads HDF5, MATLAB and OME-Zarr files with Python packages.

The packages run in a separate process (``isoparticles.formats.worker``), which sends the voxels in
slabs. If a file crashes a package, only this process ends, and the caller gets an :class:`Error`.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from threading import Timer
from typing import Any

import numpy as np
from numpy.typing import NDArray

from isoparticles import _native
from isoparticles._errors import Error, warn
from isoparticles.formats import worker
from isoparticles.formats.stored import ZARR_FILES

STARTS = {
    b"\x89HDF\r\n\x1a\n": "hdf5",
    b"MATLAB 5.0 MAT-file": "matlab",
    b"MATLAB 7.3 MAT-file": "matlab 7.3",
}
"""Formats by the first bytes, as in ``common/volume/src/foreign.rs``."""
PACKAGES = {"hdf5": "h5py", "matlab": "scipy", "matlab 7.3": "h5py", "zarr": "zarr"}
"""The package that reads each format."""
PATIENCE_SECONDS = 300.0
"""Maximum time between two messages of the process. A slab of 64 MB takes less than 1 s."""
SLACK_BYTES = 1 << 30
"""Memory of the process in addition to its slabs. Zarr takes 0.3 GB with 32 threads."""


@dataclass(frozen=True)
class Limits:
    """Callbacks of the program that reads a file."""

    check_memory: Callable[[int], None] = lambda _: None
    """Raises an error if a number of bytes exceeds the limit that the user has set."""
    warn: Callable[[str], None] = warn


def format_of(path: str) -> str | None:
    """Return the format of a file or folder, or ``None`` if the stages read it themselves."""
    if Path(path).is_dir():
        return "zarr" if any(Path(path, name).is_file() for name in ZARR_FILES) else None
    try:
        with Path(path).open("rb") as file:
            start = file.read(max(map(len, STARTS)))
    except OSError:
        return None
    return next((kind for begin, kind in STARTS.items() if start.startswith(begin)), None)


@dataclass(frozen=True)
class Grid:
    """The grid of an array, in the order x, y, z."""

    size: list[int]
    dtype: str
    steps: NDArray[np.float64]
    """Column n is the vector from a voxel to the next one along axis n, mm."""
    origin: NDArray[np.float64]
    is_lps: bool
    names: list[tuple[str, int]]


@dataclass(frozen=True)
class Given:
    """The geometry given by the caller, in the order x, y, z."""

    spacing: NDArray[np.float64] | None = None
    origin: NDArray[np.float64] | None = None
    axes: NDArray[np.float64] | None = None
    """Unit vectors of the axes as columns."""


@contextmanager
def opened(
    path: str, dataset: str | None, given: Given, limits: Limits
) -> Iterator[tuple[Grid, Iterator[NDArray[Any]]]]:
    """Find an array. Yield its grid, and an iterator of its voxels in slabs along z.

    The slabs share one buffer: copy each of them before you request the next one.

    Raises
    ------
    Error
        If the array is not found, cannot be read, does not fit in memory, or if the given geometry
        contradicts that of the file.
    """
    kind = format_of(path) or ""
    if find_spec(PACKAGES[kind]) is None:
        raise Error(
            f"{path}: the package {PACKAGES[kind]} is not installed",
            "it reads files of this format",
            'pip install "isoparticles[formats]"',
        )
    process = _start(kind, path, dataset)
    try:
        found = _message(process, path)
        grid = _grid(path, found, given)
        _check_memory(path, found, grid, limits)
        for warning in _warnings(path, found, given):
            limits.warn(warning)
        yield grid, _slabs(process, path, grid, SLACK_BYTES + int(found["working_bytes"]))
    finally:
        _stop(process)


def _warnings(path: str, found: dict[str, Any], given: Given) -> list[str]:
    """Return the warnings about the spacing; there are none if the caller gives the spacing."""
    if given.spacing is not None:
        return []
    missing = (
        [f"{path}: contains no spacing; 1 mm is assumed (give the spacing if it differs)"]
        if found["spacing"] is None
        else []
    )
    return [*found["warnings"], *missing]


def _start(kind: str, path: str, dataset: str | None) -> subprocess.Popen[bytes]:
    words = [sys.executable, worker.__file__, kind, path, *([dataset] if dataset else [])]
    # the threads of OpenBLAS would use memory that counts towards the limit of the process
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path)), "OPENBLAS_NUM_THREADS": "1"}
    return subprocess.Popen(
        words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, env=environment
    )


def _stop(process: subprocess.Popen[bytes]) -> None:
    process.kill()
    for pipe in (process.stdin, process.stdout):
        if pipe is not None:
            pipe.close()
    process.wait()


def _died(process: subprocess.Popen[bytes], path: str, patience: Timer) -> Error:
    """Return the error for a process that has ended without a message."""
    code = process.wait()
    how = f"took more than {PATIENCE_SECONDS:g} s" if patience.finished.is_set() else f"ended with the exit code {code}"
    return Error(f"{path}: reading it {how}", "it is probably damaged", "write or copy the file again")


def _message(process: subprocess.Popen[bytes], path: str) -> dict[str, Any]:
    """Receive a message, and raise the error that it contains, if any."""
    assert process.stdout is not None
    patience = Timer(PATIENCE_SECONDS, process.kill)
    patience.start()
    try:
        line = process.stdout.readline()
        if not line.endswith(b"\n"):
            raise _died(process, path, patience)
    finally:
        patience.cancel()
    message: dict[str, Any] = json.loads(line)
    if "error" in message:
        raise Error(*message["error"])
    return message


def _slabs(process: subprocess.Popen[bytes], path: str, grid: Grid, limit: int) -> Iterator[NDArray[Any]]:
    assert process.stdin is not None
    assert process.stdout is not None
    nx, ny, nz = grid.size
    missing, announced = nz, 0
    # the consumer copies each slab before it requests the next one, so all slabs share one buffer
    layers_per_read = max(1, worker.PIPE_BYTES // (nx * ny * np.dtype(grid.dtype).itemsize))
    buffer = np.empty((min(layers_per_read, nz), ny, nx), grid.dtype)
    with suppress(BrokenPipeError):  # the process has ended; `_message` raises the error
        process.stdin.write(f"{limit}\n".encode())
        process.stdin.flush()
    while missing > 0:
        if announced == 0:
            announced = _message(process, path)["layers"]
        values = buffer[: min(layers_per_read, announced)]
        # mypy does not know that a buffered pipe has `readinto`
        if process.stdout.readinto(values.reshape(-1).view(np.uint8).data) != values.nbytes:  # type: ignore[attr-defined]
            raise Error(f"{path}: reading it ended early", "it is probably damaged", "write or copy the file again")
        announced -= len(values)
        missing -= len(values)
        yield values.T


def _check_memory(path: str, found: dict[str, Any], grid: Grid, limits: Limits) -> None:
    voxels = int(np.prod(grid.size, dtype=object)) * np.dtype(grid.dtype).itemsize
    needed = min(voxels + int(found["working_bytes"]), 2**64 - 1)
    try:
        _native.check_memory(path, needed)
        limits.check_memory(needed)
    except Error as error:
        if not found["others"]:
            raise
        raise Error(error.what, error.why, f"choose a smaller dataset: {', '.join(found['others'])}") from None


def _grid(path: str, found: dict[str, Any], given: Given) -> Grid:
    """Return the grid of the file, with the given geometry where the file has none."""
    spacing, origin, axes = given.spacing, given.origin, given.axes
    if found["spacing"] is not None and found["has_unit"] and spacing is not None:
        raise Error(
            f"{path}: contains the spacing of its voxels, and {_told(spacing)} mm was given",
            "a second spacing would contradict that of the file",
            "leave out the spacing; if that of the file is wrong, correct the file",
        )
    if found["origin"] is not None and (origin is not None or axes is not None):
        raise Error(
            f"{path}: contains the position of its voxels, and an origin or a direction was given",
            "a second position would contradict that of the file",
            "leave out the origin and the direction",
        )
    lengths = np.array(found["spacing"] or [1.0] * 3)
    place = np.array(found["origin"] or [0.0] * 3)
    if spacing is not None:
        with np.errstate(divide="ignore", invalid="ignore"):  # an invalid origin is refused later
            place, lengths = place * (spacing / lengths), spacing
    lps = np.eye(3) if found["lps"] is None else np.array(found["lps"]).T
    return Grid(
        found["size"],
        found["dtype"],
        (lps if axes is None else axes) * lengths,
        lps @ place if origin is None else origin,
        found["lps"] is not None,
        [(name, label) for name, label in found["names"]],
    )


def _told(numbers: NDArray[np.float64]) -> str:
    return " x ".join(f"{number:g}" for number in numbers)
