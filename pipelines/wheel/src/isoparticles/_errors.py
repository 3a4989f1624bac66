"""The exception and the warning of the package."""

from __future__ import annotations

import functools
import os
import sys
import warnings
from pathlib import Path
from typing import Any

SKIPPED = (str(Path(__file__).parent) + os.sep, functools.__file__)
"""Folders and files of the frames between the caller and a warning."""


class Error(Exception):
    """A stage cannot run with its input or its options.

    Attributes
    ----------
    what
        The problem, with the name of the input and the value.
    why
        The reason why the stage cannot continue.
    next
        What to do.
    report
        The report that the program writes with ``--report``; None if no stage has started.
    """

    def __init__(self, what: str, why: str, what_next: str, report: dict[str, Any] | None = None) -> None:
        super().__init__(what, why, what_next)
        self.what = what
        self.why = why
        self.next = what_next
        self.report = report

    def __str__(self) -> str:
        return f"{self.what}\n  why it matters: {self.why}\n  what to do: {self.next}"


class MeshWarning(UserWarning):
    """A result exists, but may not be what the user expects."""


Error.__module__ = MeshWarning.__module__ = "isoparticles"


def warn(message: str) -> None:
    """Issue a warning at the line of the caller outside this package."""
    level, frame = 1, sys._getframe()
    while frame.f_back is not None and frame.f_code.co_filename.startswith(SKIPPED):
        level, frame = level + 1, frame.f_back
    warnings.warn(message, MeshWarning, stacklevel=level)
