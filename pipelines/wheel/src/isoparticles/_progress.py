"""Shows the progress of a run."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib import import_module
from typing import Any

Callback = Callable[[str, str, int, int | None, str], object]
Progress = Callback | bool | None
"""A callback (stage, step, done, total, message), or True for a bar on stderr."""


@contextmanager
def shown(progress: Progress) -> Iterator[Callback | None]:
    """Provide a callback, and remove what it has drawn.

    Raises
    ------
    TypeError
        If ``progress`` is neither a function nor True, False or None.
    """
    if progress is None or progress is False or (progress is not True and callable(progress)):
        yield progress or None
        return
    if progress is not True:
        raise TypeError("progress must be a function, True or None")
    try:
        display: _Bar | _Line = _Bar()
    except ImportError:
        display = _Line()
    try:
        yield display
    finally:
        display.close()


class _Bar:
    """A bar of the package rich."""

    def __init__(self) -> None:
        bars: Any = import_module("rich.progress")
        console = import_module("rich.console").Console(stderr=True)
        columns = (bars.TextColumn("{task.description}"), bars.BarColumn(), bars.TaskProgressColumn())
        self._bar = bars.Progress(*columns, console=console, transient=True, auto_refresh=False)
        self._task = self._bar.add_task("")
        self._bar.start()

    def __call__(self, stage: str, step: str, done: int, total: int | None, message: str) -> None:
        text = f"{stage}: {step} {message}".rstrip()
        self._bar.update(self._task, description=text, completed=done, total=total, refresh=True)

    def close(self) -> None:
        """Remove the bar."""
        self._bar.stop()


class _Line:
    """A line of text."""

    def __init__(self) -> None:
        self._width = 0

    def __call__(self, stage: str, step: str, done: int, total: int | None, message: str) -> None:
        share = f" {100 * min(done, total) // total} %" if total else ""
        text = f"{stage}: {step}{share} {message}".rstrip()
        print(f"\r{text:<{self._width}}", end="", file=sys.stderr, flush=True)
        self._width = len(text)

    def close(self) -> None:
        """Remove the line."""
        print(f"\r{'':<{self._width}}\r", end="", file=sys.stderr, flush=True)
