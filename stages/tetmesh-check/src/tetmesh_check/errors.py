"""Errors in three parts, and the exit codes."""

from __future__ import annotations

import traceback
from enum import IntEnum
from pathlib import Path


class ExitCode(IntEnum):
    """Exit codes, the same for all stages."""

    OK = 0
    """The output is written and every check passed."""
    CHECK_FAILED = 1
    """The output is written, but a check failed; the report says which."""
    BAD_INPUT = 2
    """Bad usage or input; nothing was written."""
    INTERRUPTED = 130
    """The user stopped the run; nothing half written is left."""


class StageError(Exception):
    """An error in three parts.

    Parameters
    ----------
    what
        The problem, with the file and the value.
    why
        Why the stage cannot go on.
    next_step
        What the user can do next.
    code
        The exit code.
    """

    def __init__(self, what: str, why: str, next_step: str, code: ExitCode = ExitCode.BAD_INPUT) -> None:
        super().__init__(what)
        self.what = what
        self.why = why
        self.next_step = next_step
        self.code = code

    def __str__(self) -> str:
        return f"{self.what}\n  why it matters: {self.why}\n  what to do: {self.next_step}"

    @classmethod
    def file(cls, path: Path, doing: str, source: BaseException, next_step: str) -> StageError:
        """Build the error for a file that cannot be read or written.

        Parameters
        ----------
        path
            The file.
        doing
            The failed action, as in "cannot *read*".
        source
            The exception of the operating system or of the reader.
        next_step
            What the user can do next.
        """
        reason = getattr(source, "strerror", None) or str(source) or type(source).__name__
        return cls(f"{path}: cannot {doing}: {reason}", "the stage needs this file", next_step)


def unexpected(error: Exception) -> StageError:
    """Describe an unexpected exception; its exit code is not that of a failed check.

    Parameters
    ----------
    error
        The exception.
    """
    frames = traceback.extract_tb(error.__traceback__)
    where = f" ({Path(frames[-1].filename).name}, line {frames[-1].lineno})" if frames else ""
    return StageError(
        f"{type(error).__name__}: {error}{where}",
        "this is a fault of the program, or a file of a kind that it does not know",
        "check the inputs; if they are as they should be, report this message",
    )


class InterruptedRunError(StageError):
    """The user, or the system, asked the run to stop (SIGINT, SIGTERM or SIGHUP).

    Parameters
    ----------
    during
        The program or step.
    """

    def __init__(self, during: str) -> None:
        super().__init__(
            f"{during}: interrupted",
            "the run was stopped before all was done; nothing half written is left",
            "run the same command again",
            ExitCode.INTERRUPTED,
        )
