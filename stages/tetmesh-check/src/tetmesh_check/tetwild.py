"""fTetWild in a process of its own: with progress, a time limit, its log kept, and a clean end however it ends.

fTetWild is native code that may run for hours, crash, or take all memory; none of that may take this program with it.
"""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import tempfile
import time
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tetmesh_check.context import Context
from tetmesh_check.errors import StageError
from tetmesh_check.quality import Cells, Points
from tetmesh_check.sizing import Background
from tetmesh_check.surface import Surface

_POLL_SECONDS = 0.05
_GRACE_SECONDS = 2.0
_TAIL_BYTES = 4096
_PASS = re.compile(r"/+ pass (\d+) /+")
_COUNT = re.compile(r"#t = (\d+)")
_ENERGY = re.compile(r"max_energy = ([0-9.eE+-]+)")


@dataclass(frozen=True)
class TetwildSettings:
    """What fTetWild is told."""

    envelope: float
    """Largest distance of the new boundary from the surface, mm."""
    edge_length: float
    """Edge length where the background says nothing, mm; not below any of its values (fTetWild only refines from it)."""
    stop_energy: float
    """Optimization stops at this largest AMIPS energy (3 is regular, larger is worse)."""
    max_passes: int
    """Optimization stops after this many passes."""
    seconds_left: float
    """The process is ended after this time, s."""
    max_seconds: float
    """The limit that the user set for all attempts together, s."""
    threads: int
    """Threads of the process."""


@dataclass(frozen=True)
class TetwildResult:
    """What came back."""

    points: Points
    """Positions, mm, shape ``(n, 3)``."""
    tetrahedra: Cells
    """Vertex indices in VTK order, shape ``(m, 4)``."""
    summary: dict[str, Any]
    """Seconds, passes and last energy, for the report."""


def _end_group(process: subprocess.Popen[bytes]) -> None:
    """End the process and whatever it started: first politely, then for sure."""
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


def _last(pattern: re.Pattern[str], text: str) -> str | None:
    found = pattern.findall(text)
    return str(found[-1]) if found else None


def _how_it_ended(code: int, log: Path) -> StageError:
    if code < 0:
        name = signal.Signals(-code).name if -code in {int(s) for s in signal.Signals} else f"signal {-code}"
        hint = " (often: out of memory)" if -code == signal.SIGKILL else ""
        what = f"the tetrahedralizer crashed: {name}{hint}"
    else:
        words = [line for line in _tail(log).splitlines() if line.strip()]
        what = f"the tetrahedralizer failed with exit code {code}: {words[-1] if words else 'it said nothing'}"
    return StageError(
        what,
        "without it there is no volume mesh; nothing was written",
        f"its log is {log}; try a larger --tet-size-factor or a larger --envelope, or a machine with more memory",
    )


def _watch(process: subprocess.Popen[bytes], log: Path, settings: TetwildSettings, context: Context) -> None:
    """Wait for the end, showing how far it is."""
    progress = context.progress("tetrahedralize")
    started = time.monotonic()
    current: dict[str, str] = {}
    try:
        while process.poll() is None:
            if time.monotonic() - started > settings.seconds_left:
                raise StageError(
                    f"the tetrahedralizer was ended after {settings.max_seconds:g} s, its time limit (--max-seconds)",
                    "without it there is no volume mesh; nothing was written",
                    f"its log is {log}; raise --max-seconds, or ask for larger tetrahedra with --tet-size-factor",
                )
            text = _tail(log)
            for name, pattern in (("pass", _PASS), ("tetrahedra", _COUNT), ("largest energy", _ENERGY)):
                value = _last(pattern, text)
                if value is not None:
                    current[name] = value
            progress.show(", ".join(f"{name} {value}" for name, value in current.items()) or "starting")
            time.sleep(_POLL_SECONDS)
    finally:
        progress.close()


def tetrahedralize(
    surface: Surface, background: Background, settings: TetwildSettings, log: Path, context: Context
) -> TetwildResult:
    """Fill a surface with tetrahedra.

    Parameters
    ----------
    surface
        A checked surface.
    background
        Edge lengths over the object, already multiplied by the size factor.
    settings
        What fTetWild is told.
    log
        Where its output goes, after what is there already; kept.
    context
        For progress.

    Raises
    ------
    StageError
        If it crashes, fails, returns nothing, or takes longer than its limit; the process is ended then.
    """
    epsilon = settings.envelope / surface.bounding_box_diagonal
    with tempfile.TemporaryDirectory(prefix="tetmesh-check-") as folder:
        job, result = Path(folder) / "job.npz", Path(folder) / "result.npz"
        arrays: dict[str, Any] = {
            "points": surface.points,
            "triangles": surface.triangles.astype(np.int32),
            "background_points": background.points,
            "background_tetrahedra": background.tetrahedra.astype(np.int32),
            "background_values": background.values,
            "settings": np.array(json.dumps({**asdict(settings), "epsilon": epsilon})),
        }
        np.savez(job, **arrays)
        started = time.monotonic()
        try:
            stream = log.open("ab")
            start = stream.tell()
        except OSError as error:
            raise StageError.file(log, "write", error, "check the permissions of its folder") from error
        with stream:
            # fTetWild drops debugging files where it stands at some log levels: let it stand in the temporary folder.
            # A session of its own, so that a Ctrl-C reaches it through us and in order.
            process = subprocess.Popen(
                [sys.executable, "-m", "tetmesh_check.tetwild_worker", str(job), str(result)],
                cwd=folder,
                stdin=subprocess.DEVNULL,
                stdout=stream,
                stderr=subprocess.STDOUT,
                start_new_session=True,
            )
            try:
                _watch(process, log, settings, context)
            finally:
                _end_group(process)
        seconds = time.monotonic() - started
        if process.returncode != 0 or not result.is_file():
            raise _how_it_ended(process.returncode, log)
        with np.load(result) as loaded:
            points = loaded["points"].astype(np.float64)
            tetrahedra = loaded["tetrahedra"].astype(np.int64)
    if len(tetrahedra) == 0:
        raise StageError(
            "the tetrahedralizer returned no tetrahedra",
            "without them there is no volume mesh; nothing was written",
            f"its log is {log}; the envelope may be larger than the object: try a smaller --envelope",
        )
    text = log.read_bytes()[start:].decode("utf-8", errors="replace")
    energy, passes = _last(_ENERGY, text), _last(_PASS, text)
    summary = {
        "seconds": seconds,
        "passes": int(passes) + 1 if passes is not None else 0,
        "last_max_energy": float(energy) if energy is not None else None,
        "epsilon_relative": epsilon,
    }
    return TetwildResult(points, tetrahedra, summary)
