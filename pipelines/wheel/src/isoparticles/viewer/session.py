"""The meshes of a case and the updates between them, without any user interface."""

from __future__ import annotations

import contextlib
import shlex
import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import isoparticles.viewer.journal as journals
import isoparticles.viewer.lock as locks
from isoparticles._errors import Error
from isoparticles._mesh import Mesh, is_saved
from isoparticles._stages import reconstruct

Progress = Callable[[str, str, int, int | None, str], object] | None


@dataclass(frozen=True)
class Ball:
    """A request for edges of length ``h`` within ``radius`` of ``centre``; lengths in mm."""

    centre: tuple[float, float, float]
    radius: float
    h: float

    @property
    def text(self) -> str:
        """The request as an option."""
        return f"ball:{','.join(map(number, (*self.centre, self.radius)))}={number(self.h)}"


@dataclass(frozen=True)
class Mask:
    """A request for edges of length ``h`` in the nonzero voxels of a file."""

    path: str
    h: float

    @property
    def text(self) -> str:
        """The request as an option."""
        return f"mask:{self.path}={number(self.h)}"


Request = Ball | Mask


def number(value: float) -> str:
    """Write a length in mm, rounded to four decimals."""
    return f"{round(float(value), 4) + 0.0:.10g}"


def parse(text: str) -> Request:
    """Convert the text of an option to a request.

    Raises
    ------
    Error
        If the text is not a ball or a mask.
    """
    kind, _, rest = text.partition(":")
    what, _, h = rest.rpartition("=")
    try:
        if kind == "mask" and what:
            return Mask(what, float(h))
        if kind == "ball":
            x, y, z, radius = map(float, what.split(","))
            return Ball((x, y, z), radius, float(h))
    except ValueError:
        pass
    raise Error(
        f"{text}: not a ball or a mask",
        "each request names a place and an edge length",
        "write ball:X,Y,Z,RADIUS=H or mask:FILE=H, in mm",
    )


class Session:
    """A mesh, its updates, and the folder that they are written to.

    Parameters
    ----------
    mesh
        The mesh in the folder, or in memory.
    folder
        The folder of the case; None for a mesh in memory.
    resize
        The setting RESIZE of the last run of the case.
    """

    def __init__(self, mesh: Mesh, folder: Path | None = None, resize: str = "") -> None:
        self.meshes: list[Mesh] = [mesh]
        self.folder = folder
        self.waiting: list[list[str]] = []
        """Groups of an earlier session that :meth:`resume` applies again."""
        self.note = ""
        """What happened to the updates of an earlier session, in words."""
        self.journal = journals.Journal()
        self._lock = threading.Lock()
        self._is_in_file = True
        """Whether the surface file contains a mesh of this session; true without a folder."""
        if folder is not None:
            self._restore(resize)

    @property
    def mesh(self) -> Mesh:
        """The present mesh."""
        return self.meshes[-1]

    @property
    def path(self) -> Path | None:
        """The file of the updates."""
        return None if self.folder is None else self.folder / f"{self.mesh.name}.view.json"

    @property
    def surface_file(self) -> Path | None:
        """The surface file of the case, or that of a surface with a failed check."""
        if self.folder is None:
            return None
        path = self.folder / f"{self.mesh.name}.surface.vtp"
        failed = path.with_suffix(".failed.vtp")
        return failed if failed.exists() and not path.exists() else path

    @property
    def pending(self) -> list[Request]:
        """The requests that are not applied yet."""
        return [parse(text) for text in self.journal.pending]

    def _restore(self, resize: str) -> None:
        """Read the updates of an earlier session."""
        assert self.path is not None
        assert self.surface_file is not None
        found = journals.read(self.path)
        now = journals.hash_of(self.surface_file)
        self._is_in_file = is_saved(self.surface_file, self.mesh.result)
        if now and not self._is_in_file:
            # a mesh in memory, and the folder contains another one
            saved = found.saved if found.surface == now else []
            self.journal = journals.Journal([], [*found.texts, *found.pending], saved, now)
            if found.texts:
                self.note = "The folder contains another mesh. The updates of that mesh are listed, not applied."
            return
        if found.surface == now:
            count = len(found.saved)
            is_undone = found.applied[:count] != found.saved
            self.waiting = [] if is_undone else found.applied[count:]
            self.journal = journals.Journal(list(found.saved), found.pending, found.saved, now)
            if is_undone:
                self.note = "Updates that were undone after the last save are still part of the surface."
            elif self.waiting:
                self.note = f"Unsaved updates of the last session are applied again: {len(self.waiting)}."
            return
        # the stages have made the surface anew, with the updates in RESIZE
        made = shlex.split(resize)
        groups = [made] if made else []
        left = [text for text in found.texts if self._located(text) not in made]
        self.journal = journals.Journal(groups, [*left, *found.pending], list(groups), now)
        if left:
            self.note = "The surface was made anew since the last session. Its updates are listed, not applied."

    def resume(self, progress: Progress = None) -> None:
        """Apply the updates of an earlier session again."""
        while self.waiting:
            self._update(self.waiting[0], progress)
            self.waiting.pop(0)

    def prepare(self) -> None:
        """Derive the data that all updates of the field share, so that the first one is faster."""
        mesh = self.mesh
        # without a change of h, nothing else happens; an error would appear in the update as well
        with contextlib.suppress(Error):
            reconstruct(mesh.result, mesh.field, mesh.size)

    def add(self, request: Request) -> None:
        """Add a request to the list."""
        parse(request.text)
        if not (np.isfinite(request.h) and request.h > 0) or (isinstance(request, Ball) and not request.radius > 0):
            raise Error(f"{request.text}: not positive", "lengths are positive", "choose a radius and an edge length")
        self.journal.pending.append(request.text)
        self._write()

    def change(self, index: int, request: Request) -> None:
        """Replace a request of the list."""
        self.journal.pending[index] = request.text
        self._write()

    def remove(self, index: int) -> None:
        """Remove a request from the list."""
        del self.journal.pending[index]
        self._write()

    def apply(self, progress: Progress = None) -> None:
        """Apply the list of requests to make a new mesh. If this fails, nothing changes."""
        if not self.journal.pending:
            raise Error("the list is empty", "an update needs a ball or a region", "place a ball or paint a region")
        group = list(self.journal.pending)
        self._update(group, progress, len(group))

    def _update(self, group: Sequence[str], progress: Progress, taken: int = 0) -> None:
        """Apply a group. The first ``taken`` requests of the list are then no longer pending."""
        mesh: Any = self.mesh
        made: Mesh = mesh.update(*(self._located(text) for text in group), progress=progress)
        self.meshes.append(made)
        self.journal.applied.append(list(group))
        # requests that were added during the update stay in the list
        del self.journal.pending[:taken]
        self._write()

    def _located(self, text: str) -> str:
        """Return the text, with the path of a mask in the folder of the case."""
        if not text.startswith("mask:") or self.folder is None:
            return text
        request: Any = parse(text)
        return Mask(str(self.folder / request.path), request.h).text

    @property
    def is_saved(self) -> bool:
        """Whether the files contain the present mesh; without a folder, whether it is the first."""
        return self._is_in_file and self.journal.applied == self.journal.saved

    @property
    def can_undo(self) -> bool:
        """Whether there is an update to undo."""
        return len(self.meshes) > 1

    def undo(self) -> None:
        """Return to the mesh before the last update. Its requests return to the list."""
        if not self.can_undo:
            raise Error("no update to undo", "undo returns to an earlier mesh", "apply an update first")
        self.meshes.pop()
        self.journal.pending[:0] = self.journal.applied.pop()
        self._write()

    def resize(self) -> str:
        """Return the updates as the case setting RESIZE."""
        return shlex.join(self._located(text) for text in self.journal.texts)

    def save(self) -> None:
        """Write the files of the mesh to the folder of the case.

        Raises
        ------
        Error
            If the mesh has no folder, or if a run of the stages writes to it.
        """
        if self.folder is None or self.surface_file is None:
            raise Error(
                "the mesh has no folder",
                "files are written to the folder of a case",
                "pass folder=... to isoparticles.view, or call Mesh.save",
            )
        with locks.held(self.folder):
            self.mesh.save(self.folder, overwrite=True)
        self._is_in_file = True
        self.journal.saved = [list(group) for group in self.journal.applied]
        self.journal.surface = journals.hash_of(self.surface_file)
        self._write()

    def _write(self) -> None:
        # an update in a thread and the page may write at the same time
        with self._lock:
            if self.path is not None:
                self.journal.write(self.path)


def command_line(goal: str, settings: dict[str, str], out: str, resize: str) -> str:
    """Return the command that makes the case with its updates.

    Parameters
    ----------
    goal
        ``surface`` or ``mesh``.
    settings
        The settings of the case.
    out
        The folder of the results.
    resize
        The setting RESIZE; empty without updates.
    """
    words = ["isoparticles", goal, *([settings["INPUT"]] if "INPUT" in settings else [])]
    given = {key: value for key, value in settings.items() if key not in ("INPUT", "OUT", "RESIZE", "CASE")}
    for key, value in {**given, "OUT": out, **({"RESIZE": resize} if resize else {})}.items():
        words += [f"--{key.lower().replace('_', '-')}", value]
    return shlex.join(words)


def size_at(mesh: Mesh, position: Sequence[float]) -> float:
    """Return h of the mesh at a position in mm: that of the nearest node of the size field."""
    size = mesh.size
    index = np.linalg.solve(size.direction * size.spacing, np.asarray(position, dtype=float) - size.origin)
    nearest: NDArray[np.int64] = np.clip(np.rint(index), 0, np.array(size.shape) - 1).astype(np.int64)
    return float(size.array[tuple(nearest)])
