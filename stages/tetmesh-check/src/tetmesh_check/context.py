"""Messages, progress, steps, warnings, history and report of a run."""

from __future__ import annotations

import json
import os
import signal
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import FrameType
from typing import Any

from tetmesh_check import __version__
from tetmesh_check.errors import ExitCode, InterruptedRunError, StageError, unexpected
from tetmesh_check.files import blake3_of_file, write_text

TOOL = "tetmesh-check"
_LINE_INTERVAL_SECONDS = 5.0
_BAR_INTERVAL_SECONDS = 0.2


@dataclass(frozen=True)
class CommonArguments:
    """The options that every stage has, under the same names."""

    verbose: int = 0
    quiet: bool = False
    force: bool = False
    threads: int = 0
    seed: int = 1
    report: Path | None = None
    progress: str = "auto"
    max_memory: int | None = None
    """Most memory that the run may take, bytes; what the machine has free by default."""

    @property
    def thread_count(self) -> int:
        """Threads to use, with 0 resolved to the cores this process may run on."""
        if self.threads > 0:
            return self.threads
        if sys.platform == "linux":
            return len(os.sched_getaffinity(0))
        return os.cpu_count() or 1


class Progress:
    """Honest progress of one piece of work on stderr: what has been reached, and how long it took.

    Parameters
    ----------
    mode
        ``bar`` redraws one line in place, ``lines`` prints a plain line every few seconds, ``none``
        says nothing.
    label
        The name of the work.
    """

    def __init__(self, mode: str, label: str) -> None:
        self._mode = mode
        self._label = label
        self._started = time.monotonic()
        self._last = self._started
        self._drawn = 0

    def show(self, message: str) -> None:
        """Say where the work stands; calls that come too soon after the last are dropped.

        Parameters
        ----------
        message
            Such as "pass 3, 51,230 tetrahedra".
        """
        if self._mode == "none":
            return
        now = time.monotonic()
        if now - self._last < (_BAR_INTERVAL_SECONDS if self._mode == "bar" else _LINE_INTERVAL_SECONDS):
            return
        self._last = now
        text = f"{self._label}: {message}, {now - self._started:.0f} s"
        if self._mode == "bar":
            sys.stderr.write("\r" + text.ljust(self._drawn))
            self._drawn = len(text)
        else:
            sys.stderr.write(text + "\n")
        sys.stderr.flush()

    def close(self) -> None:
        """Remove the bar, so that what follows starts on a clean line."""
        if self._mode == "bar" and self._drawn:
            sys.stderr.write("\r" + " " * self._drawn + "\r")
            sys.stderr.flush()


def peak_memory_bytes() -> int | None:
    """Peak memory of this process or any child, bytes; ``None`` on Windows."""
    if sys.platform == "win32":
        return None
    import resource

    own = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    children = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss
    unit = 1 if sys.platform == "darwin" else 1024
    return max(own, children) * unit


class Context:
    """Messages, times and results of one run.

    Parameters
    ----------
    common
        The shared options.
    command_line
        The command line for the history (see :func:`canonical_command_line`).
    parameters
        The parameters as they apply, defaults included; the seed is added here.
    """

    def __init__(self, common: CommonArguments, command_line: str, parameters: dict[str, Any]) -> None:
        self.common = common
        self.command_line = command_line
        self.parameters: dict[str, Any] = {"seed": common.seed, **parameters}
        self.inputs: list[dict[str, Any]] = []
        self.steps: dict[str, float] = {}
        self.warnings: list[str] = []
        self.results: dict[str, Any] = {}
        self.closing: list[tuple[str, str]] = []
        self._started = time.monotonic()

    def info(self, message: str) -> None:
        """Print a line on stderr, unless ``--quiet``."""
        if not self.common.quiet:
            print(message, file=sys.stderr)

    def verbose(self, message: str) -> None:
        """Print a line on stderr with ``--verbose``."""
        if self.common.verbose > 0:
            print(message, file=sys.stderr)

    def warn(self, message: str) -> None:
        """Print a warning on stderr, also under ``--quiet``, and keep it for the report."""
        print(f"warning: {message}", file=sys.stderr)
        self.warnings.append(message)

    @contextmanager
    def step(self, name: str) -> Iterator[None]:
        """Time a piece of the work; times of one name add up."""
        started = time.monotonic()
        try:
            yield
        finally:
            seconds = time.monotonic() - started
            self.steps[name] = self.steps.get(name, 0.0) + seconds
            self.verbose(f"{name}: {seconds:.2f} s")

    def progress(self, label: str) -> Progress:
        """Show progress in the way the user asked for."""
        mode = self.common.progress
        if self.common.quiet:
            mode = "none"
        elif mode == "auto":
            mode = "bar" if sys.stderr.isatty() and os.environ.get("TERM") != "dumb" else "lines"
        return Progress(mode, label)

    def add_input(self, path: Path, history: Any) -> None:
        """Note an input file with its hash and the history it carries.

        Parameters
        ----------
        path
            The file.
        history
            The history found in it, or ``None``.
        """
        entry: dict[str, Any] = {"path": path.name, "blake3": blake3_of_file(path)}
        if history is not None:
            entry["history"] = history
        self.inputs.append(entry)

    def history(self) -> dict[str, Any]:
        """History of what this run writes; it holds nothing that varies between two equal runs."""
        return {
            "tool": TOOL,
            "version": __version__,
            "command_line": self.command_line,
            "parameters": self.parameters,
            "inputs": self.inputs,
        }

    def close(self, failed_checks: list[str], error: StageError | None) -> ExitCode:
        """Print the closing table or the error, write the report, and say how to exit.

        Parameters
        ----------
        failed_checks
            The checks that failed, in words.
        error
            The error that ended the run, if any.
        """
        if error is None:
            code = ExitCode.CHECK_FAILED if failed_checks else ExitCode.OK
            self.info(self._closing_table())
        else:
            code = error.code
        if self.common.report is not None:
            try:
                self._write_report(self.common.report, failed_checks, error, code)
            except StageError as report_error:
                error = error or report_error
                code = error.code
        for check in failed_checks:
            print(f"check failed: {check}", file=sys.stderr)
        if error is not None:
            print(f"error: {error}", file=sys.stderr)
        return code

    def _closing_table(self) -> str:
        rows = [(name, f"{seconds:.2f} s") for name, seconds in self.steps.items()]
        rows.append(("total", f"{time.monotonic() - self._started:.2f} s"))
        if (peak := peak_memory_bytes()) is not None:
            rows.append(("peak memory", f"{peak / 2**20:.0f} MiB"))
        rows.append(("threads", str(self.common.thread_count)))
        rows.extend(self.closing)
        width = max(len(name) for name, _ in rows)
        return "\n".join([f"{TOOL}:", *(f"  {name:{width}}  {value}" for name, value in rows)])

    def _write_report(self, path: Path, failed: list[str], error: StageError | None, code: ExitCode) -> None:
        outcome = {
            ExitCode.OK: "passed",
            ExitCode.CHECK_FAILED: "checks_failed",
            ExitCode.BAD_INPUT: "error",
            ExitCode.INTERRUPTED: "interrupted",
        }[code]
        parts = None if error is None else {"what": error.what, "why": error.why, "next": error.next_step}
        document = {
            "tool": TOOL,
            "version": __version__,
            "command_line": self.command_line,
            "parameters": self.parameters,
            "inputs": [{"path": entry["path"], "blake3": entry["blake3"]} for entry in self.inputs],
            "threads": self.common.thread_count,
            "seconds": time.monotonic() - self._started,
            "steps": [{"name": name, "seconds": seconds} for name, seconds in self.steps.items()],
            "peak_memory_bytes": peak_memory_bytes(),
            "warnings": self.warnings,
            "outcome": outcome,
            "exit_code": int(code),
            "failed_checks": failed,
            "error": parts,
            "results": self.results,
        }
        write_text(path, json.dumps(document, indent=2, allow_nan=False) + "\n")


_SILENT_FLAGS = frozenset({"--verbose", "--quiet", "--force"})
_SILENT_VALUES = frozenset(
    {
        "--threads",
        "--max-memory",
        "--report",
        "--progress",
        "--pictures",
        "--export",
        "--max-seconds",
        "--solve-seconds",
    }
)


def canonical_command_line(arguments: list[str], outputs: list[Path]) -> str:
    """Write the command line as the history keeps it.

    Parameters
    ----------
    arguments
        The words after the name of the program.
    outputs
        The files that the run writes; they appear as ``OUTPUT``.

    Returns
    -------
    str
        Other paths without their folders, and without the options that do not change the result.
    """

    def shorten(word: str) -> str:
        if Path(word) in outputs:
            return "OUTPUT"
        return Path(word).name if "/" in word else word

    words = [TOOL]
    rest = iter(arguments)
    for argument in rest:
        name, equals, value = argument.partition("=") if argument.startswith("--") else (argument, "", "")
        if name in _SILENT_FLAGS or (len(name) > 1 and name[0] == "-" and set(name[1:]) <= {"v", "q"}):
            continue
        if name in _SILENT_VALUES:
            if not equals:
                next(rest, None)
            continue
        words.append(f"{name}={shorten(value)}" if equals else shorten(argument))
    return " ".join(words)


class Interruptible:
    """Turns signals into :class:`InterruptedRunError` inside a ``with`` block.

    Parameters
    ----------
    during
        What the run was doing, for the message.
    """

    _SIGNALS = tuple(one for one in signal.Signals if one.name in ("SIGINT", "SIGTERM", "SIGHUP"))

    def __init__(self, during: str) -> None:
        self._during = during
        self._before: dict[int, Any] = {}

    def _stop(self, _number: int, _frame: FrameType | None) -> None:
        # once is enough: a second signal must not break the cleaning up
        self.ignore()
        raise InterruptedRunError(self._during)

    def ignore(self) -> None:
        """Take no more signals: what remains to be done is short."""
        for number in self._SIGNALS:
            signal.signal(number, signal.SIG_IGN)

    def __enter__(self) -> Interruptible:
        """Start to listen."""
        self._before = {number: signal.signal(number, self._stop) for number in self._SIGNALS}
        return self

    def __exit__(self, *_error: object) -> None:
        """Restore what listened before."""
        for number, handler in self._before.items():
            signal.signal(number, handler)


def guarded(tool: str, work: Callable[[], int]) -> int:
    """Run a program that writes no report; errors go to stderr in three parts.

    Parameters
    ----------
    tool
        Name of the program.
    work
        What it does; returns the exit code.

    Returns
    -------
    int
        The exit code, of the error if there was one.
    """
    try:
        with Interruptible(tool):
            return int(work())
    except Exception as problem:
        error = problem if isinstance(problem, StageError) else unexpected(problem)
        print(f"error: {error}", file=sys.stderr)
        return int(error.code)
