"""The list of updates of a case on disk: ``NAME.view.json``.

Every change replaces the file atomically, so a killed server loses nothing. The file also contains
a hash of the surface to which the updates belong, because ``isoparticles surface`` may replace it.
"""

from __future__ import annotations

import hashlib
import json
import os
from dataclasses import asdict, dataclass, field
from pathlib import Path

from isoparticles._errors import Error

FORMAT, VERSION = "isoparticles-view", 1


@dataclass
class Journal:
    """Updates as groups of texts such as ``ball:1,2,3,5=0.5``. Each group is one update."""

    applied: list[list[str]] = field(default_factory=list)
    """The groups applied to the mesh on the page, in order."""
    pending: list[str] = field(default_factory=list)
    """Texts of the requests that are not applied yet."""
    saved: list[list[str]] = field(default_factory=list)
    """The groups applied to the surface in the file, in order."""
    surface: str = ""
    """Hash of the surface file to which ``saved`` refers."""

    def write(self, path: Path) -> None:
        """Replace the file."""
        text = json.dumps({"format": FORMAT, "version": VERSION, **asdict(self)}, indent=1)
        new = path.with_name(f".{path.name}.{os.getpid()}")
        with new.open("w", encoding="utf-8") as file:
            file.write(f"{text}\n")
            file.flush()
            os.fsync(file.fileno())
        new.replace(path)

    @property
    def texts(self) -> list[str]:
        """The texts of all applied groups, in order."""
        return [text for group in self.applied for text in group]


def read(path: Path) -> Journal:
    """Read the file; return an empty journal if there is none.

    Raises
    ------
    Error
        If the file is damaged or from a later version.
    """
    if not path.exists():
        return Journal()
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
        if (found.pop("format"), found.pop("version")) != (FORMAT, VERSION):
            raise ValueError("another format or version")
        return Journal(**found)
    except (OSError, ValueError, TypeError, KeyError, AttributeError) as error:
        raise Error(
            f"{path}: cannot be read ({error})",
            "it contains the updates that were made on the page",
            "move the file away to start without updates",
        ) from None


def hash_of(path: Path) -> str:
    """Return a hash of the content of a file; empty if there is none."""
    return hashlib.blake2b(path.read_bytes(), digest_size=16).hexdigest() if path.is_file() else ""
