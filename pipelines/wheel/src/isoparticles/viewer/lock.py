"""Locks the folder of a case: one page writes its list of updates, and none saves during a run.

The operating system releases a lock when the process ends, even if it is killed. The file stays.
The file of a page contains its process and its address with the token, so only its owner may read
it.
"""

from __future__ import annotations

import contextlib
import os
import socket
import sys
from collections.abc import Iterator
from pathlib import Path

from isoparticles._errors import Error

NAME = ".view.lock"
"""Name of the file of a page."""
OF_RUNS = ".lock"
"""Name of the file that the stages lock (pipelines/case/src/folder.rs)."""
LOCKED_BYTE = 1 << 30
"""Position of the locked byte on Windows, behind the content: locked bytes cannot be read there."""


def take(folder: Path, address: str) -> int | None:
    """Lock a folder for the page at an address.

    Returns
    -------
    int or None
        The descriptor of the locked file; closing it releases the lock. None if nothing can be
        written to the folder.

    Raises
    ------
    Error
        If another page has locked the folder.
    """
    folder.mkdir(parents=True, exist_ok=True)
    if not os.access(folder, os.W_OK):
        return None
    try:
        file = os.open(folder / NAME, os.O_RDWR | os.O_CREAT, 0o600)
    except PermissionError:
        what_next = f"wait until it ends; if there is none, remove {folder / NAME}"
        raise _refusal(folder, "a process of another user", what_next) from None
    if not _lock(file):
        owner, _, shown = os.read(file, 1000).decode().partition("\n")
        os.close(file)
        raise _refusal(folder, owner, f"open {shown.strip()} or end that process")
    os.ftruncate(file, 0)
    os.write(file, f"process {os.getpid()} on {socket.gethostname()}\n{address}\n".encode())
    return file


@contextlib.contextmanager
def held(folder: Path) -> Iterator[None]:
    """Lock a folder as a run of the stages does.

    Raises
    ------
    Error
        If a run has locked the folder.
    """
    folder.mkdir(parents=True, exist_ok=True)
    file = os.open(folder / OF_RUNS, os.O_RDWR | os.O_CREAT, 0o666)
    try:
        if not _lock(file):
            raise Error(f"{folder}: a run of the stages writes its files", "they would mix", "save when it has ended")
        yield
    finally:
        os.close(file)


def _refusal(folder: Path, owner: str, what_next: str) -> Error:
    return Error(f"{folder}: {owner} shows this case", "two pages would replace each other's updates", what_next)


def _lock(file: int) -> bool:
    """Lock a file; return false if another process has locked it."""
    try:
        if sys.platform == "win32":
            import msvcrt

            os.lseek(file, LOCKED_BYTE, os.SEEK_SET)
            msvcrt.locking(file, msvcrt.LK_NBLCK, 1)
            os.lseek(file, 0, os.SEEK_SET)
        else:
            import fcntl

            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except (BlockingIOError, PermissionError):
        os.lseek(file, 0, os.SEEK_SET)
        return False
    except OSError:  # on a file system without locks, other pages cannot be detected
        pass
    return True
