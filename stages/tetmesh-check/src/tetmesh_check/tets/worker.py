"""A tetrahedralizer in a child process, with progress, a time limit and a log.

Tetrahedralizers are native code that may run for hours, crash, or use all memory. A child process
protects this program from that. :class:`Runner` writes ``job.npz`` into a temporary folder, starts
``python -m MODULE FOLDER`` there, and reads ``result.npz``; that module calls :func:`serve`.
"""

from __future__ import annotations

import ctypes
import importlib
import importlib.util
import math
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import closing, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from isoparticles._native import Context

from tetmesh_check.errors import StageError
from tetmesh_check.files import temporary_folder
from tetmesh_check.quality import Cells, Points, orient_positive

Job = dict[str, Any]
"""Arrays, numbers and texts for the child process, with lengths in units of 1 / ``scale`` mm."""

_JOB, _RESULT = "job.npz", "result.npz"
_POLL_SECONDS = 0.5
_TAIL = 4096
"""Number of characters at the end of the log that are searched for progress."""
_UNAVAILABLE = 3
"""Exit code of a child whose library cannot be imported."""
_NO_ROOM = 4
"""Exit code of a child that cannot write temporary files; the last line of the log is the
reason."""
_PR_SET_PDEATHSIG = 1
_LINE_BUFFERED = 1


class UnavailableError(StageError):
    """The library of a tetrahedralizer cannot be imported."""


class TimeLimitError(StageError):
    """A tetrahedralizer was stopped at its time limit."""


@dataclass(frozen=True)
class Worker:
    """One kind of tetrahedralizer."""

    name: str
    """Name for messages."""
    module: str
    """The Python module that calls :func:`serve`."""
    library: str
    """The Python package that it needs."""
    when_it_fails: str
    """Advice if it fails."""
    when_it_is_missing: str
    """Advice if its library is missing."""
    shown: dict[str, str]
    """Values in its log that are shown as progress: regular expressions with the value as group."""
    when_it_is_empty: str = ""
    """Advice if it returns no tetrahedra; by default as if it fails."""

    def unavailable(self, reason: str) -> UnavailableError:
        """Return the error for a library that is missing or incomplete."""
        why = "it fills the surface with tetrahedra; nothing was written"
        return UnavailableError(f"{self.name} is not available: {reason}", why, self.when_it_is_missing)

    def refuse_missing(self) -> None:
        """Raise an error if the library is not installed."""
        if importlib.util.find_spec(self.library) is None:
            raise self.unavailable(f"there is no Python package {self.library}")

    def shown_in(self, text: str) -> dict[str, str]:
        """Return the last of each of the shown values in a part of the log."""
        found = {name: re.findall(pattern, text) for name, pattern in self.shown.items()}
        return {name: values[-1] for name, values in found.items() if values}


@dataclass(frozen=True)
class Raw:
    """Tetrahedra as returned by a tetrahedralizer or by mending."""

    points: Points
    """Positions, mm, shape ``(n, 3)``."""
    tetrahedra: Cells
    """Vertex indices in VTK order, shape ``(m, 4)``."""
    summary: dict[str, Any]
    """For the report: version of the library and time in s, or the changes by mending."""
    turned: bool = False
    """Whether the vertex order of all tetrahedra was reversed."""


def scale_of(points: Points) -> float:
    """Return the power of 2 that scales a box to a diagonal of about 100; 1 for 1 to 1000.

    Tetrahedralizers have absolute tolerances. Without a scale, the boundary of fTetWild is 5e-6 mm
    from the surface of an object with voxels of 1e-6 mm.

    Parameters
    ----------
    points
        Positions in the box, shape ``(n, 3)``.
    """
    diagonal = float(np.linalg.norm(np.ptp(points, axis=0)))
    return 1.0 if 1.0 <= diagonal <= 1000.0 else float(2.0 ** round(math.log2(100.0 / diagonal)))


class Runner:
    """Runs tetrahedralizers one after the other, with one log and one time limit.

    Parameters
    ----------
    log
        File for their output. An existing one is removed.
    max_seconds
        The time that all of them together may take from now, s.
    context
        For progress.
    """

    def __init__(self, log: Path, max_seconds: float, context: Context) -> None:
        self.log = log
        self._max_seconds = max_seconds
        self._deadline = time.monotonic() + max_seconds
        self._context = context
        log.unlink(missing_ok=True)

    def run(self, worker: Worker, job: Job, **settings: object) -> Raw:
        """Fill a surface in a child process. The settings are added to the summary.

        Raises
        ------
        StageError
            If the child process crashes, fails, returns nothing, or reaches the time limit, at
            which it is stopped.
        """
        with temporary_folder("tetmesh-check-") as folder:
            np.savez(folder / _JOB, **job)
            started = time.monotonic()
            code = self._run_process(worker, folder)
            seconds = time.monotonic() - started
            if code != 0 or not (folder / _RESULT).is_file():
                raise self._failure(worker, code)
            with np.load(folder / _RESULT) as result:
                points, tetrahedra = result["points"], result["tetrahedra"]
                version = str(result["version"])
        if len(tetrahedra) == 0:
            raise StageError(
                f"the tetrahedralizer ({worker.name}) returned no tetrahedra",
                "without them there is no volume mesh; nothing was written",
                f"its log is {self.log}; {worker.when_it_is_empty or worker.when_it_fails}",
            )
        tetrahedra, turned = orient_positive(points, tetrahedra)
        return Raw(points, tetrahedra, {"version": version, "seconds": seconds, **settings}, turned)

    def _run_process(self, worker: Worker, folder: Path) -> int:
        """Run the module of a worker and show its progress; return its exit code."""
        progress = self._context.progress("tetrahedralize")
        current: dict[str, str] = {}
        # Some tetrahedralizers write debugging files to the current folder, so it is a temporary
        # one. The child process has its own session: Ctrl-C only reaches this process, which stops
        # it.
        with (
            closing(progress),
            self.log.open("ab") as stream,
            subprocess.Popen(
                [sys.executable, "-u", "-m", worker.module, folder],
                cwd=folder,
                stdin=subprocess.DEVNULL,
                stdout=stream,
                stderr=subprocess.STDOUT,
                start_new_session=True,
            ) as process,
        ):
            try:
                while time.monotonic() < self._deadline:
                    with suppress(subprocess.TimeoutExpired):
                        return process.wait(_POLL_SECONDS)
                    current |= worker.shown_in(self.said()[-_TAIL:])
                    progress.show(", ".join(f"{name} {value}" for name, value in current.items()) or "starting")
            finally:
                process.kill()
        raise TimeLimitError(
            f"the tetrahedralizer ({worker.name}) was stopped after {self._max_seconds:g} s, its time limit (--max-seconds)",
            "without it there is no volume mesh; nothing was written",
            f"its log is {self.log}; raise --max-seconds, or use larger tetrahedra with --tet-size-factor",
        )

    def said(self) -> str:
        """Return the log."""
        return self.log.read_text(encoding="utf-8", errors="replace")

    def _failure(self, worker: Worker, code: int) -> StageError | OSError:
        """Return the error for the exit code of a child without a result."""
        lines = [line for line in self.said().splitlines() if line.strip()] or ["it printed nothing"]
        if code == _UNAVAILABLE:
            return worker.unavailable(lines[-1])
        if code == _NO_ROOM:
            return OSError(lines[-1])
        if code < 0:
            name = signal.Signals(-code).name
            ended = f"crashed: {name}{' (often: out of memory)' if name == 'SIGKILL' else ''}"
        else:
            ended = f"failed with exit code {code}: {lines[-1]}"
        return StageError(
            f"the tetrahedralizer ({worker.name}) {ended}",
            "without it there is no volume mesh; nothing was written",
            f"its log is {self.log}; {worker.when_it_fails}",
        )


def serve(library: str, fill: Callable[[Any, Job], Any]) -> None:
    """Run a child process: read the job, fill the surface, and write the result.

    Parameters
    ----------
    library
        The Python package to import. If this fails, the exit code is :data:`_UNAVAILABLE`.
    fill
        Returns points and tetrahedra. Its arguments are the imported package and the job.
    """
    if sys.platform == "linux":
        libc = ctypes.CDLL(None)
        # each line appears in the log at once
        libc.setvbuf(ctypes.c_void_p.in_dll(libc, "stdout"), None, _LINE_BUFFERED, 1 << 16)
        # this process ends with its parent, even if SIGKILL ends the parent
        libc.prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
    try:
        loaded = importlib.import_module(library)
    except (ImportError, OSError) as error:
        print(f"{type(error).__name__}: {error}")
        raise SystemExit(_UNAVAILABLE) from None
    try:
        with np.load(_JOB) as stored:
            job = {name: values if values.ndim else values.item() for name, values in stored.items()}
        scale = job.pop("scale")
        points, tetrahedra = fill(loaded, job)
        np.savez(
            _RESULT,
            points=np.asarray(points, dtype=np.float64) / scale,
            tetrahedra=np.asarray(tetrahedra, dtype=np.int64),
            version=loaded.__version__,
        )
    except OSError as error:
        print(error.strerror or error)
        raise SystemExit(_NO_ROOM) from None
