"""The memory that a run may use, and an estimate of what it uses."""

from __future__ import annotations

import argparse
import re
from pathlib import Path

from tetmesh_check.errors import StageError

BYTES_AT_LEAST = 600 * 2**20
"""Memory of the packages without a mesh; see :data:`BYTES_PER_VERTEX`."""
BYTES_PER_VERTEX = 5100
"""Bytes for each vertex of the surface. Both are the line through 896 MiB for the 55,626 vertices
of `heart` and 2,050 MiB for the 292,825 of `ribs`, with 15 to 20 tetrahedra a vertex
(docs/developer/performance.md, real volumes, `make CASE=heart` and `make CASE=ribs`)."""

_UNITS = {"": 0, "k": 1, "m": 2, "g": 3, "t": 4}


def number_of_bytes(text: str) -> int:
    """Parse a number of bytes, such as ``8G``; K, M, G and T are powers of 1024.

    Parameters
    ----------
    text
        Text from the command line.
    """
    match = re.fullmatch(r"([0-9]+(?:\.[0-9]*)?|\.[0-9]+)\s*([kmgt]?)(?:ib|b)?", text.strip().lower())
    count = 0 if match is None else int(float(match[1]) * 1024 ** _UNITS[match[2]])
    if count < 1:
        raise argparse.ArgumentTypeError(f"'{text}' is not a number of bytes above 0, such as 8G or 500M")
    return count


def available_memory_bytes() -> int | None:
    """Free memory of the machine or control group, bytes; ``None`` if unknown."""
    found = []
    lines = _read(Path("/proc/meminfo")).splitlines()
    found += [int(line.split()[1]) * 1024 for line in lines if line.startswith("MemAvailable:")]
    most, now = (_read(Path(f"/sys/fs/cgroup/memory.{name}")).strip() for name in ("max", "current"))
    if most.isdigit() and now.isdigit():
        found.append(max(int(most) - int(now), 0))
    return min(found, default=None)


def _read(path: Path) -> str:
    try:
        return path.read_text()
    except OSError:
        return ""


def check_memory(vertices: int, surface: Path, max_memory: int | None) -> None:
    """Refuse a surface whose tetrahedra are expected to take more memory than is allowed, or free.

    Parameters
    ----------
    vertices
        Vertices of the surface.
    surface
        Its file, for the message.
    max_memory
        Bytes that the user allows; what the machine has free by default.

    Raises
    ------
    StageError
        If they are expected to take more.
    """
    needed = BYTES_AT_LEAST + BYTES_PER_VERTEX * vertices
    limit = available_memory_bytes() if max_memory is None else max_memory
    if limit is None or needed <= limit:
        return
    whose = "this machine has free" if max_memory is None else "--max-memory allows"
    raise StageError(
        f"{surface}: tetrahedra in a surface of {vertices:,} vertices take about {needed / 2**30:.1f} GiB of memory",
        f"{whose} {limit / 2**30:.1f} GiB; the run would be killed, or take hours on a swapping disk",
        f"make a coarser surface (sizefield --min-size, --quality coarse); or --max-memory {-(-needed // 2**30)}G if the memory is "
        "there all the same",
    )
