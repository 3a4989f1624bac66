"""Errors in three parts, and the end of a program after an error or a signal."""

from __future__ import annotations

import signal
import sys
import tempfile
import traceback
from collections.abc import Callable
from pathlib import Path
from typing import NoReturn

from isoparticles._errors import Error

StageError = Error
"""An error in three parts: ``what``, ``why`` and ``next``."""

Close = Callable[[list[str], StageError | None, bool], int]
"""Ends a program, given the failed checks, the error, and whether a signal has ended the run.
Returns the exit code."""


def file_error(path: Path, doing: str, source: BaseException, what_next: str) -> StageError:
    """Build the error for a file that cannot be read or written.

    Parameters
    ----------
    path
        The file.
    doing
        The failed action, as in "cannot *read*".
    source
        The exception of the operating system or of the reader.
    what_next
        What the user can do next.
    """
    reason = getattr(source, "strerror", None) or str(source) or type(source).__name__
    return StageError(f"{path}: cannot {doing}: {reason}", "the stage needs this file", what_next)


def refuse_file(path: Path, what: str, why: str, remedy: str) -> NoReturn:
    """Raise an error about the content of a file."""
    raise StageError(f"{path}: {what}", why, remedy)


def described(problem: Exception) -> StageError:
    """Convert an exception to an error in three parts."""
    if isinstance(problem, StageError):
        return problem
    if isinstance(problem, OSError):
        # an error without a file name may concern any file, even one in TMPDIR
        name = Path(problem.filename or "a file that the system does not name")
        folders = f"the folder of the output and in {tempfile.gettempdir()} (TMPDIR)"
        return file_error(name, "use", problem, f"check permissions and free space in {folders}")
    if isinstance(problem, MemoryError):
        return StageError(
            "there is not enough memory",
            "the meshes do not fit into memory",
            "use a larger --tet-size-factor or a machine with more memory",
        )
    frame = traceback.extract_tb(problem.__traceback__)[-1]
    return StageError(
        f"{type(problem).__name__}: {problem} ({Path(frame.filename).name}, line {frame.lineno})",
        "this is a fault of the program, or a file of a kind that it does not know",
        "check the inputs; if they are correct, report this message",
    )


def close(failed: list[str], error: StageError | None, interrupted: bool) -> int:
    """End a program that writes no report."""
    for message in failed:
        print(f"check failed: {message}", file=sys.stderr)
    if error is None:
        return 1 if failed else 0
    print(f"error: {error}", file=sys.stderr)
    return 130 if interrupted else 2


def _handle_signals(handler: Callable[..., object] | signal.Handlers) -> None:
    for number in signal.Signals:
        if number.name in ("SIGINT", "SIGTERM", "SIGHUP"):
            signal.signal(number, handler)


def _stop(*_: object) -> None:
    # a second signal must not stop the cleanup
    _handle_signals(signal.SIG_IGN)
    raise KeyboardInterrupt


def guarded(tool: str, work: Callable[[], list[str] | None], close: Close = close) -> int:
    """Run a program. SIGINT, SIGTERM and SIGHUP raise KeyboardInterrupt in it.

    Parameters
    ----------
    tool
        Name of the program.
    work
        Does the work, and returns the messages of the failed checks, or ``None``.
    close
        Ends the program. Signals are ignored from then on.

    Returns
    -------
    int
        The exit code.
    """
    _handle_signals(_stop)
    failed, error, interrupted = None, None, False
    try:
        failed = work()
    except KeyboardInterrupt:
        interrupted = True
        error = StageError(
            f"{tool}: interrupted",
            "the run was stopped before it finished; no incomplete files remain",
            "run the same command again",
        )
    except Exception as problem:
        error = described(problem)
    _handle_signals(signal.SIG_IGN)
    return close(failed or [], error, interrupted)
