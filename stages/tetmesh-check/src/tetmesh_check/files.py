"""Atomic output, by a temporary name and a rename; temporary folders."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from tetmesh_check.errors import StageError, file_error


@contextmanager
def temporary_folder(prefix: str) -> Iterator[Path]:
    """Create a temporary folder, and remove it at the end. Errors name its location.

    Parameters
    ----------
    prefix
        Beginning of its name.

    Raises
    ------
    StageError
        If the folder cannot be created or the disk is full.
    """
    try:
        with tempfile.TemporaryDirectory(prefix=prefix) as folder:
            yield Path(folder)
    except OSError as error:
        if error.filename and not Path(error.filename).is_relative_to(tempfile.gettempdir()):
            raise
        raise StageError(
            f"{tempfile.gettempdir()}: cannot store temporary files: {error.strerror or error}",
            "meshes and volumes pass through this folder from one program to the other",
            "free space there, or set TMPDIR to another folder",
        ) from error


def write_atomically(path: Path, write: Callable[[Path], object]) -> None:
    """Write a file such that no reader sees it incomplete.

    Parameters
    ----------
    path
        The target.
    write
        Writes the content to a temporary path. Its suffix is that of the target, because some
        writers choose the format by the suffix.

    Raises
    ------
    StageError
        If the folder cannot be written to or the disk is full; the temporary file is removed.
    """
    # isoparticles-case recognizes the files of killed programs by such names
    temporary = path.with_name(f".isoparticles-{path.stem}.{os.getpid()}.partial{path.suffix}")
    try:
        write(temporary)
        with temporary.open("rb+") as stream:
            os.fsync(stream.fileno())
        temporary.replace(path)
    except OSError as error:
        raise file_error(path, "write", error, "check the permissions and the free space of the disk") from error
    finally:
        temporary.unlink(missing_ok=True)


def write_text(path: Path, text: str) -> None:
    """Write text (UTF-8) atomically.

    Parameters
    ----------
    path
        The target.
    text
        The content.
    """
    write_atomically(path, lambda temporary: temporary.write_text(text, encoding="utf-8"))
