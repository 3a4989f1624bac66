"""Reads mutated files in this process, as ``isoparticles.formats.worker`` does.

    python mutate.py KIND FILE FIRST END DATASET

Each seed from FIRST to END changes or cuts a copy of the file, or a file of the folder. The process
prints the number of files that were read, and fails if an error is not one of the package. A crash
or a hang ends the process; the last line of stdout is then the seed.
"""

from __future__ import annotations

import shutil
import signal
import sys
import warnings
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from isoparticles._errors import Error
from isoparticles.formats import worker

HANG_SECONDS = 2
MOST_BYTES = 1 << 24
"""Larger arrays are not read: the parent process checks their size."""


def mutated(content: bytes, random: np.random.Generator) -> bytes:
    """Change a few bytes, or cut the end off."""
    changed = bytearray(content)
    for _ in range(int(random.integers(1, 4))):
        at = int(random.integers(0, len(changed)))
        changed[at] = int(random.choice([0, 1, 127, 128, 255, int(random.integers(0, 256))]))
    return bytes(changed[: int(random.integers(0, len(changed)))] if random.random() < 0.1 else changed)


def attempt(kind: str, path: Path, dataset: str) -> bool:
    """Read a file; return whether this succeeds."""
    try:
        stored = worker.find(kind, path, dataset or None)
        worker.description(stored)
        if np.prod(stored.size, dtype=float) * np.dtype(stored.dtype).itemsize + stored.working_bytes < MOST_BYTES:
            for _ in stored.slabs():
                pass
    except Exception as problem:
        error = worker.as_error(path, problem)
        assert isinstance(error, Error)
        assert all(isinstance(part, str) and part for part in (error.what, error.why, error.next))
        return False
    return True


def main() -> None:
    """Read the mutated files."""
    warnings.simplefilter("ignore")
    kind, original, first, end, dataset = sys.argv[1], Path(sys.argv[2]), *map(int, sys.argv[3:5]), sys.argv[5]
    worker.limit_memory(4 << 30)
    with TemporaryDirectory() as folder:
        copy = Path(folder, original.name)
        if original.is_dir():
            shutil.copytree(original, copy)
        else:
            shutil.copy(original, copy)
        files = sorted(file for file in [copy, *copy.rglob("*")] if file.is_file() and file.stat().st_size)
        contents = [file.read_bytes() for file in files]
        done = 0
        for seed in range(first, end):
            print(seed, flush=True)
            signal.alarm(HANG_SECONDS)
            random = np.random.default_rng(seed)
            chosen = int(random.integers(0, len(files)))
            files[chosen].write_bytes(mutated(contents[chosen], random))
            done += attempt(kind, copy, dataset)
            files[chosen].write_bytes(contents[chosen])
        signal.alarm(0)
    print("read", done)


if __name__ == "__main__":
    main()
