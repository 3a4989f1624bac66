"""Runs updates and stages in the background: updates in a thread, stages as a program.

Neither depends on the browser, so closing a tab does not stop them.
"""

from __future__ import annotations

import os
import re
import signal
import subprocess
import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from pathlib import Path

from isoparticles._errors import Error
from isoparticles._programs import BIN, case_arguments, program

LINES = 400
"""Lines of the log that are kept for the page."""
STAGE = re.compile(rf"'?{re.escape(str(BIN) + os.sep)}(\w+)")
"""The name of a stage in its command line, which the log quotes if the path contains a space."""
SHARE = re.compile(r"[^:]+: (\d{1,3}) % ")
"""The completed share in a line of progress, in percent. Tables contain other percentages."""
ERROR = re.compile(r"error: (.+)\n  why it matters: (.+)\n  what to do: (.+)")
"""The parts of an error in the log."""


class StoppedError(Exception):
    """The user has pressed the stop button."""


class Job:
    """Work in a thread. The page polls its state."""

    STOPPED = "Stopped. The mesh has not changed."
    """What the page says after a stop."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.text = ""
        self.share: float | None = None
        """Completed share of the present step, 0 to 1; None if unknown."""
        self.log: deque[str] = deque(maxlen=LINES)
        self.error: Exception | None = None
        self.started = time.monotonic()
        self.ended: float | None = None
        self._stop = threading.Event()
        self._thread: threading.Thread | None = None

    @property
    def is_running(self) -> bool:
        """Whether the work is not finished."""
        return self._thread is not None and self._thread.is_alive()

    @property
    def was_stopped(self) -> bool:
        """Whether the user has stopped the work."""
        return self._stop.is_set()

    @property
    def seconds(self) -> float:
        """The time since the start, or the duration of the finished work."""
        return (self.ended or time.monotonic()) - self.started

    def start(self, work: Callable[[], object]) -> Job:
        """Start the work."""

        def call() -> None:
            try:
                work()
            except StoppedError:
                self.log.append("stopped")
            except Exception as error:  # the page shows it
                self.error = error
                self.log.append(str(error))
            finally:
                self.ended = time.monotonic()

        self._thread = threading.Thread(target=call, name=self.name, daemon=True)
        self._thread.start()
        return self

    def wait(self) -> None:
        """Wait for the end of the work."""
        if self._thread is not None:
            self._thread.join()

    def stop(self) -> None:
        """Ask the work to stop."""
        self._stop.set()

    def progress(self, stage: str, step: str, done: int, total: int | None, message: str) -> None:
        """Record the progress of a stage; raise :class:`StoppedError` if the work has to stop."""
        if self._stop.is_set():
            raise StoppedError
        text = f"{stage}: {step} {message}".strip()
        if not self.log or self.log[-1] != text:
            self.log.append(text)
        self.text, self.share = text, min(done / total, 1.0) if total else None


class StagesJob(Job):
    """A run of ``isoparticles-case``. Stopping it interrupts the stage; the next run resumes it."""

    STOPPED = "Stopped. The next run with these settings resumes."

    def __init__(self, command: Sequence[str]) -> None:
        super().__init__("stages")
        self.command = list(command)
        self.code: int | None = None
        self._process: subprocess.Popen[str] | None = None

    def run(self) -> Job:
        """Start the program."""
        return self.start(self._run)

    def _run(self) -> None:
        environment = {**os.environ, "ISOPARTICLES_FRONT": "isoparticles"}
        with subprocess.Popen(
            self.command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
            text=True, encoding="utf-8", errors="replace", bufsize=1, env=environment,
        ) as process:  # fmt: skip
            self._process = process
            if self._stop.is_set():
                self.stop()
            assert process.stdout is not None
            for line in process.stdout:
                self._read(line.rstrip())
        self.code = process.returncode
        if self.code not in (0, 1) and not self.was_stopped:
            found = ERROR.findall("\n".join(self.log))
            parts = ("the stages ended with an error", "there is no surface", "see the log for the reason")
            raise Error(*(found[-1] if found else parts))

    def _read(self, line: str) -> None:
        if line:
            self.log.append(line)
        # the rows of tables are indented
        if line and not line.startswith(" "):
            stage, share = STAGE.match(line), SHARE.match(line)
            self.text = stage[1] if stage else line
            self.share = int(share[1]) / 100.0 if share else None

    def stop(self) -> None:
        """Interrupt the program as Ctrl-C does."""
        super().stop()
        if self._process is not None and self._process.poll() is None:
            if os.name == "posix":
                self._process.send_signal(signal.SIGINT)
            else:
                self._process.terminate()


def stages_command(settings: dict[str, str], out: Path) -> list[str]:
    """Return the command line that makes the surface of a volume."""
    words = [f"{key}={value}" for key, value in {**settings, "OUT": str(out)}.items() if value]
    return case_arguments("surface", words)


def info_command(settings: dict[str, str]) -> list[str]:
    """Return the command line that predicts the cost of an object, as JSON on stdout."""
    words = [program("isoparticles-volume"), "info", settings["INPUT"], "--json", "-"]
    if "ISO" in settings:
        return [*words, "--iso", settings["ISO"], "--inside", settings["INSIDE"]]
    labels = settings.get("LABELS") or ",".join(part.split(":")[1] for part in settings["MATERIALS"].split(","))
    return [*words, "--labels", labels]
