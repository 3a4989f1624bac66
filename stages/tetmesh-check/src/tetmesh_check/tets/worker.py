"""A tetrahedralizer in a separate process, with progress, a time limit and a log.

Tetrahedralizers are native code that may run for hours, crash, or use all memory. A separate
process protects this program from that. This file contains both sides: :func:`run_worker`
writes ``job.npz``, starts ``python -m MODULE job.npz result.npz`` and reads the result; that module
calls :func:`serve`.
"""

from __future__ import annotations

import ctypes
import importlib
import importlib.metadata
import importlib.util
import json
import math
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tetmesh_check.context import Context
from tetmesh_check.errors import StageError
from tetmesh_check.files import temporary_error, temporary_folder
from tetmesh_check.quality import Cells, Points

Fill = Callable[[Any, dict[str, Any], dict[str, Any]], tuple[Any, Any]]
"""Function of a worker: converts the library, the arrays and the settings of the job to points and
tetrahedra."""

_POLL_SECONDS = 0.05
_GRACE_SECONDS = 2.0
_TAIL_BYTES = 4096
_UNAVAILABLE = 3
"""Exit code of a worker whose library cannot be imported."""
_NO_ROOM = 4
"""Exit code of a worker that cannot write temporary files; its last words are the reason."""
_PR_SET_PDEATHSIG = 1
_LINE_BUFFERED = 1


class UnavailableError(StageError):
    """The library of a tetrahedralizer cannot be imported."""


class TimeLimitError(StageError):
    """A tetrahedralizer was ended because its time was over."""


@dataclass(frozen=True)
class Worker:
    """One kind of tetrahedralizer."""

    name: str
    """Name for messages."""
    module: str
    """The Python module that calls :func:`serve`."""
    library: str
    """The Python package that it needs."""
    shown: tuple[tuple[str, re.Pattern[str]], ...]
    """Values in its log that are shown as progress: names, and patterns with the value as group."""
    when_it_fails: str
    """Advice if it fails."""
    when_it_is_empty: str
    """Advice if it returns no tetrahedra."""
    when_it_is_missing: str
    """Advice if its library is missing."""
    powers: dict[str, int]
    """Arrays and settings that are lengths (1) or volumes (3), by the power of the length unit."""


@dataclass(frozen=True)
class TimeLimit:
    """The time that all attempts together may take."""

    max_seconds: float
    """The time limit of the user, s."""
    deadline: float
    """End of the limit by the monotonic clock, s."""

    @classmethod
    def start(cls, max_seconds: float) -> TimeLimit:
        """Count from now."""
        return cls(max_seconds, time.monotonic() + max_seconds)


@dataclass(frozen=True)
class WorkerResult:
    """The result of a worker."""

    points: Points
    """Positions, mm, shape ``(n, 3)``."""
    tetrahedra: Cells
    """Vertex indices, shape ``(m, 4)``."""
    said: str
    """Its output in the log."""
    summary: dict[str, Any]
    """For the report: version of the library and time in s, or the changes by mending."""


def refuse_missing(worker: Worker) -> None:
    """Refuse a tetrahedralizer whose library is not installed.

    Parameters
    ----------
    worker
        The tetrahedralizer.
    """
    if importlib.util.find_spec(worker.library) is None:
        raise UnavailableError(
            f"{worker.name} is not available: there is no Python package {worker.library}",
            "it is the tetrahedralizer that is to fill the surface",
            worker.when_it_is_missing,
        )


def scale_of(points: Points) -> float:
    """Power of 2 that brings a box to a diagonal of order 100; 1 for diagonals from 1 to 1000.

    Tetrahedralizers have absolute tolerances: fTetWild strays from a box of 1e-5.

    Parameters
    ----------
    points
        Positions in the box, shape ``(n, 3)``.
    """
    diagonal = float(np.linalg.norm(np.ptp(points, axis=0)))
    return 1.0 if 1.0 <= diagonal <= 1000.0 else float(2.0 ** round(math.log2(100.0 / diagonal)))


def last_match(pattern: re.Pattern[str], text: str) -> str | None:
    """Find the group of the last match in a text, or ``None``."""
    found = pattern.findall(text)
    return str(found[-1]) if found else None


def _end_group(process: subprocess.Popen[bytes]) -> None:
    """End the process and its children: by SIGTERM, then by SIGKILL."""
    if sys.platform == "win32":
        process.kill()
        process.wait()
        return
    for number in (signal.SIGTERM, signal.SIGKILL):
        if process.poll() is not None:
            return
        try:
            os.killpg(process.pid, number)
            process.wait(timeout=_GRACE_SECONDS)
        except (ProcessLookupError, subprocess.TimeoutExpired):
            continue


def _tail(path: Path) -> str:
    with path.open("rb") as stream:
        stream.seek(max(0, stream.seek(0, os.SEEK_END) - _TAIL_BYTES))
        return stream.read().decode("utf-8", errors="replace")


def _last_words(log: Path) -> str:
    words = [line for line in _tail(log).splitlines() if line.strip()]
    return words[-1] if words else "it said nothing"


def _how_it_ended(worker: Worker, code: int, log: Path) -> StageError:
    if code == _UNAVAILABLE:
        return UnavailableError(
            f"{worker.name} is not available: {_last_words(log)}",
            "it is the tetrahedralizer that was to fill the surface; nothing was written",
            worker.when_it_is_missing,
        )
    if code == _NO_ROOM:
        return temporary_error(_last_words(log))
    if code < 0:
        name = signal.Signals(-code).name if -code in {int(s) for s in signal.Signals} else f"signal {-code}"
        hint = " (often: out of memory)" if name == "SIGKILL" else ""
        what = f"the tetrahedralizer ({worker.name}) crashed: {name}{hint}"
    else:
        what = f"the tetrahedralizer ({worker.name}) failed with exit code {code}: {_last_words(log)}"
    return StageError(
        what,
        "without it there is no volume mesh; nothing was written",
        f"its log is {log}; {worker.when_it_fails}",
    )


def _watch(process: subprocess.Popen[bytes], worker: Worker, log: Path, limit: TimeLimit, context: Context) -> None:
    """Wait for the end, showing how far it is."""
    progress = context.progress("tetrahedralize")
    current: dict[str, str] = {}
    try:
        while process.poll() is None:
            if time.monotonic() > limit.deadline:
                raise TimeLimitError(
                    f"the tetrahedralizer ({worker.name}) was ended after {limit.max_seconds:g} s, its time limit "
                    "(--max-seconds)",
                    "without it there is no volume mesh; nothing was written",
                    f"its log is {log}; raise --max-seconds, or ask for larger tetrahedra with --tet-size-factor",
                )
            text = _tail(log)
            for name, pattern in worker.shown:
                value = last_match(pattern, text)
                if value is not None:
                    current[name] = value
            progress.show(", ".join(f"{name} {value}" for name, value in current.items()) or "starting")
            time.sleep(_POLL_SECONDS)
    finally:
        progress.close()


def _version(library: str) -> str | None:
    try:
        return importlib.metadata.version(library)
    except importlib.metadata.PackageNotFoundError:
        return None


def _run_process(
    worker: Worker, words: list[str], folder: Path, log: Path, limit: TimeLimit, context: Context
) -> tuple[int, int]:
    """Run the module of a worker; return where its output starts in the log, and its exit code."""
    try:
        stream = log.open("ab")
        start = stream.tell()
    except OSError as error:
        raise StageError.file(log, "write", error, "check the permissions of its folder") from error
    with stream:
        # Some write debugging files to the current folder, which is a temporary one.
        # In a session of its own, it receives Ctrl-C through this process only.
        process = subprocess.Popen(
            [sys.executable, "-m", worker.module, *words],
            cwd=folder,
            stdin=subprocess.DEVNULL,
            stdout=stream,
            stderr=subprocess.STDOUT,
            start_new_session=True,
        )
        try:
            _watch(process, worker, log, limit, context)
        finally:
            _end_group(process)
    return start, process.returncode


def run_worker(
    worker: Worker, arrays: dict[str, Any], settings: Any, log: Path, limit: TimeLimit, context: Context
) -> WorkerResult:
    """Fill a surface with tetrahedra in another process.

    Parameters
    ----------
    worker
        The tetrahedralizer.
    arrays
        The meshes and fields of the job, by name.
    settings
        Settings, a dataclass of numbers.
    log
        File to which its output is appended.
    limit
        When it is ended.
    context
        For progress.

    Raises
    ------
    StageError
        If it crashes, fails, returns nothing, or takes longer than its limit; the process is ended
        then.
    """
    with temporary_folder("tetmesh-check-") as folder:
        job, result = folder / "job.npz", folder / "result.npz"
        scale = scale_of(arrays["points"])
        told: dict[str, Any] = {**asdict(settings), **arrays}
        told.update({name: scale**power * told[name] for name, power in worker.powers.items() if name in told})
        given = {name: told.pop(name) for name in asdict(settings)}
        np.savez(job, settings=np.array(json.dumps(given)), **told)
        started = time.monotonic()
        start, code = _run_process(worker, [str(job), str(result)], folder, log, limit, context)
        seconds = time.monotonic() - started
        if code != 0 or not result.is_file():
            raise _how_it_ended(worker, code, log)
        with np.load(result) as loaded:
            points = loaded["points"].astype(np.float64) / scale
            tetrahedra = loaded["tetrahedra"].astype(np.int64)
    if len(tetrahedra) == 0:
        raise StageError(
            f"the tetrahedralizer ({worker.name}) returned no tetrahedra",
            "without them there is no volume mesh; nothing was written",
            f"its log is {log}; {worker.when_it_is_empty}",
        )
    said = log.read_bytes()[start:].decode("utf-8", errors="replace")
    return WorkerResult(points, tetrahedra, said, {"version": _version(worker.library), "seconds": seconds})


def _prepare_process() -> None:
    """Write the log line by line, and end this process when the parent ends, even by SIGKILL."""
    # stdout and stderr are the log; Python's own buffer must not come after the C library's
    sys.stdout.reconfigure(line_buffering=True)  # type: ignore[union-attr]
    if sys.platform != "linux":
        return
    libc = ctypes.CDLL(None)
    libc.setvbuf(ctypes.c_void_p.in_dll(libc, "stdout"), None, _LINE_BUFFERED, 1 << 16)
    libc.prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)


def serve(library: str, fill: Fill) -> None:
    """Run a worker: read the job, fill the surface, and write the result atomically.

    Parameters
    ----------
    library
        The Python package to import; the process ends with a code of its own if that cannot be
        done.
    fill
        The function that fills the surface.
    """
    _prepare_process()
    job, result = (Path(word) for word in sys.argv[1:3])
    try:
        loaded = importlib.import_module(library)
    except (ImportError, OSError) as error:
        print(f"{type(error).__name__}: {error}", flush=True)
        raise SystemExit(_UNAVAILABLE) from None
    try:
        with np.load(job) as stored:
            arrays: dict[str, Any] = dict(stored)
        points, tetrahedra = fill(loaded, arrays, json.loads(str(arrays.pop("settings"))))
        temporary = result.with_name("part.npz")
        np.savez(temporary, points=points, tetrahedra=tetrahedra)
        temporary.replace(result)
    except OSError as error:
        print(error.strerror or error, flush=True)
        raise SystemExit(_NO_ROOM) from None
