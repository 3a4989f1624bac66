"""The process that fTetWild runs in: ``python -m tetmesh_check.tetwild_worker JOB.npz RESULT.npz``."""

from __future__ import annotations

import ctypes
import json
import os
import signal
import sys
from pathlib import Path
from typing import Any

import numpy as np

_PR_SET_PDEATHSIG = 1
_LINE_BUFFERED = 1
_LOG_LEVEL = 3
"""fTetWild's warnings; below that it also writes debugging meshes into the working folder."""


def _prepare_process() -> None:
    """Write the log line by line, and end with the parent even when that is killed."""
    if sys.platform != "linux":
        return
    libc = ctypes.CDLL(None)
    libc.setvbuf(ctypes.c_void_p.in_dll(libc, "stdout"), None, _LINE_BUFFERED, 1 << 16)
    libc.prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)


def run(job: Path, result: Path) -> None:
    """Read the job, fill the surface, write the result.

    Parameters
    ----------
    job
        Arrays ``points, triangles``, ``background_*``, and ``settings`` as JSON text.
    result
        Gets the arrays ``points`` and ``tetrahedra``; written whole or not at all.
    """
    import pytetwild

    with np.load(job) as loaded:
        arrays: dict[str, Any] = dict(loaded)
    settings = json.loads(str(arrays["settings"]))
    points, tetrahedra = pytetwild.tetrahedralize(
        arrays["points"],
        arrays["triangles"],
        edge_length_abs=settings["edge_length"],
        epsilon=settings["epsilon"],
        simplify=False,
        stop_energy=settings["stop_energy"],
        num_opt_iter=settings["max_passes"],
        num_threads=settings["threads"],
        loglevel=_LOG_LEVEL,
        quiet=False,
        vtk_ordering=True,
        bg_vertices=arrays["background_points"],
        bg_tets=arrays["background_tetrahedra"],
        bg_values=arrays["background_values"],
    )
    temporary = result.with_name("part.npz")
    np.savez(temporary, points=points, tetrahedra=tetrahedra)
    temporary.replace(result)


if __name__ == "__main__":
    _prepare_process()
    # stdout and stderr are the log; Python's own buffer comes before the C library's
    os.environ.setdefault("PYTHONUNBUFFERED", "1")
    run(Path(sys.argv[1]), Path(sys.argv[2]))
