"""Atomic output, by a temporary name and a rename; hashes of inputs."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

import blake3

from tetmesh_check.errors import StageError

_CHUNK_BYTES = 1 << 20


def blake3_of_file(path: Path) -> str:
    """Hash a file the way every stage does; of a folder, the names and hashes of the files in it.

    Parameters
    ----------
    path
        The file, or the folder of a DICOM series.

    Returns
    -------
    str
        BLAKE3 of the bytes of the file, 64 hexadecimal digits.
    """
    hasher = blake3.blake3()
    try:
        if path.is_dir():
            for file in sorted(file for file in path.iterdir() if file.is_file()):
                hasher.update(f"{file.name}\0{blake3_of_file(file)}\n".encode())
            return hasher.hexdigest()
        with path.open("rb") as stream:
            while chunk := stream.read(_CHUNK_BYTES):
                hasher.update(chunk)
    except OSError as error:
        raise StageError.file(path, "read", error, "check the name and the permissions") from error
    return hasher.hexdigest()


def refuse_existing(outputs: Iterable[Path], force: bool) -> None:
    """Keep what is already there unless the user said otherwise.

    Parameters
    ----------
    outputs
        The files that the run is going to write.
    force
        Whether they may be replaced.

    Raises
    ------
    StageError
        If one of them exists and ``force`` is off, or if its folder is missing or is no folder.
    """
    for path in outputs:
        if path.is_dir():
            raise StageError(f"{path}: is a folder", "a file is to be written under this name", "give a file name")
        if path.exists() and not force:
            raise StageError(
                f"{path}: exists already",
                "an output is never replaced without being asked to",
                "add --force to replace it, or choose another name",
            )
        folder = path.parent
        if not folder.is_dir():
            raise StageError(f"{folder}: no such folder", f"{path.name} is to be written there", "create it first")
        if not os.access(folder, os.W_OK):
            raise StageError(f"{folder}: not writable", f"{path.name} is to be written there", "check its permissions")


def check_report(report: Path, others: Iterable[Path]) -> None:
    """Refuse a report that would replace an input, another output, or a file that is no report.

    Parameters
    ----------
    report
        Path of the report; an existing report is replaced.
    others
        The inputs and the other outputs of the run.

    Raises
    ------
    StageError
        If the report must not be written there.
    """
    refuse_existing([report], force=True)
    try:
        with report.open("rb") as stream:
            start = stream.read(1)
    except OSError:
        start = b""
    if start not in (b"", b"{") or any(same_file(report, other) for other in others):
        raise StageError(
            f"{report}: is not the place for the report",
            "an input, an output or a file that is no report would be replaced",
            "give --report a name of its own, such as case.report.json",
        )


def same_file(first: Path, second: Path) -> bool:
    """Whether two names lead to the same place, whether or not there is a file yet.

    Parameters
    ----------
    first, second
        The names.
    """
    return first.resolve() == second.resolve()


def temporary_error(reason: str) -> StageError:
    """Build the error for the folder of temporary files.

    Parameters
    ----------
    reason
        Message of the operating system.
    """
    return StageError(
        f"{tempfile.gettempdir()}: cannot hold temporary files: {reason}",
        "meshes and volumes pass through this folder from one program to the other",
        "free space there, or set TMPDIR to another folder",
    )


@contextmanager
def temporary_folder(prefix: str) -> Iterator[Path]:
    """Make a folder for temporary files and remove it at the end; errors in it name the place.

    Parameters
    ----------
    prefix
        Beginning of its name.

    Raises
    ------
    StageError
        If the folder cannot be made or the disk is full.
    """
    try:
        with tempfile.TemporaryDirectory(prefix=prefix) as folder:
            yield Path(folder)
    except OSError as error:
        if error.filename and not Path(error.filename).is_relative_to(tempfile.gettempdir()):
            raise
        raise temporary_error(error.strerror or str(error)) from error


def write_atomically(path: Path, write: Callable[[Path], None]) -> None:
    """Write a file so that a reader, or ``make``, never sees half of it.

    Parameters
    ----------
    path
        The target.
    write
        Writes the content to the path it is handed, which keeps the target's suffix because some
        writers choose the format by it.

    Raises
    ------
    StageError
        If the folder cannot be written to or the disk is full; the temporary file is removed.
    """
    # by such a name isoparticles-case knows what a killed program has left
    temporary = path.with_name(f".isoparticles-{path.stem}.{os.getpid()}.partial{path.suffix}")
    try:
        write(temporary)
        with temporary.open("rb+") as stream:
            os.fsync(stream.fileno())
        temporary.replace(path)
    except OSError as error:
        raise StageError.file(path, "write", error, "check the permissions and the free space of the disk") from error
    finally:
        temporary.unlink(missing_ok=True)


def write_text(path: Path, text: str) -> None:
    """Write text (UTF-8) atomically.

    Parameters
    ----------
    path
        The target.
    text
        Its whole content.
    """

    def write(temporary: Path) -> None:
        temporary.write_text(text, encoding="utf-8")

    write_atomically(path, write)
