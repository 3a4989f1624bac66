"""Reads an array in a separate process, because libraries may crash or hang on damaged files.

The arguments are the format, the path and the dataset. The process writes a description of the
array to stdout as a line of JSON, and waits for a line on stdin with a memory limit in bytes. It
then writes each slab: its number of layers as a line of JSON, and its voxels with x varying
fastest. If reading fails, the last line has the key ``error``.
"""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any, BinaryIO

from isoparticles._errors import Error
from isoparticles.formats.stored import Stored

NEXT = "if another program opens it, write it with plain compression; otherwise copy the file again"
PIPE_BYTES = 1 << 20
"""Requested size of the pipe (Linux only), and size of the receiver's buffer. Reading an OME-Zarr
array of 512^3 int16 voxels takes 1.11 s with this size (``make formats``, 2 cores), and 1.4 s with
the default of 64 kB and a buffer per slab."""
DESCRIBING_BYTES = 2 << 30
"""Memory for finding an array. Importing all readers takes 0.3 GB."""


def find(kind: str, path: Path, dataset: str | None) -> Stored:
    """Find an array with the reader of its format."""
    reader: Callable[[Path, str | None], Stored]
    if kind == "zarr":
        from isoparticles.formats.ome_zarr import read_zarr as reader
    elif kind == "matlab":
        from isoparticles.formats.matlab import read_matlab as reader
    elif kind == "matlab 7.3":
        from isoparticles.formats.hdf5 import read_matlab_7_3 as reader
    else:
        from isoparticles.formats.hdf5 import read_hdf5 as reader
    return reader(path, dataset)


def description(stored: Stored) -> dict[str, Any]:
    """Describe an array. The order of all lists is x, y, z."""
    place, axes = stored.place, stored.spatial
    return {
        "name": stored.name,
        "size": stored.size,
        "dtype": stored.dtype,
        "spacing": None if place.spacing is None else [place.spacing[axis] for axis in axes],
        "origin": None if place.origin is None else [place.origin[axis] for axis in axes],
        "has_unit": place.has_unit,
        "lps": [place.lps[letter].tolist() for letter in "xyz"] if place.lps else None,
        "names": [[name, label] for label, name in stored.names.items()],
        "working_bytes": stored.working_bytes,
        "others": list(stored.others),
        "warnings": list(stored.warnings),
    }


def limit_memory(limit: int) -> None:
    """Limit the memory of this process, so that a file cannot expand without bounds."""
    try:
        import resource
    except ModuleNotFoundError:  # Windows
        return
    hard = resource.getrlimit(resource.RLIMIT_DATA)[1]
    resource.setrlimit(resource.RLIMIT_DATA, (limit if hard < 0 else min(limit, hard), hard))


def as_error(path: Path, problem: Exception) -> Error:
    """Convert an exception of a library to an error in three parts."""
    if isinstance(problem, Error):
        return problem
    if isinstance(problem, MemoryError):
        return Error(
            f"{path}: needs more memory than its description states, or than is free",
            "its voxels do not fit in memory",
            "if it is not damaged, use a machine with more memory",
        )
    if isinstance(problem, OSError) and problem.errno is not None and problem.strerror:
        return Error(f"{path}: cannot be read: {problem.strerror}", "it contains the volume", "check its permissions")
    text = " ".join(f"{type(problem).__name__}: {problem}".split())
    return Error(f"{path}: cannot be read: {text}", "it is damaged or of an unknown kind", NEXT)


def send(out: BinaryIO, message: dict[str, Any]) -> None:
    """Write a line of JSON."""
    out.write(json.dumps(message).encode() + b"\n")
    out.flush()


def serve(out: BinaryIO, kind: str, path: Path, dataset: str | None) -> None:
    """Describe an array, wait, and write its voxels."""
    try:
        limit_memory(DESCRIBING_BYTES)
        stored = find(kind, path, dataset)
        send(out, description(stored))
        limit = sys.stdin.readline()
        if not limit:
            return
        limit_memory(int(limit))
        for slab in stored.slabs():
            send(out, {"layers": slab.shape[2]})
            out.write(slab.T.data)
        out.flush()
    except Exception as problem:
        error = as_error(path, problem)
        send(out, {"error": [error.what, error.why, error.next]})


def main() -> None:
    """Run the process. Only :func:`serve` writes to the pipe; libraries print to stderr."""
    kind, path, *dataset = sys.argv[1:]
    out = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)
    with suppress(ImportError, AttributeError, OSError):
        import fcntl

        fcntl.fcntl(out, fcntl.F_SETPIPE_SZ, PIPE_BYTES)
    serve(out, kind, Path(path), dataset[0] if dataset else None)


if __name__ == "__main__":
    main()
