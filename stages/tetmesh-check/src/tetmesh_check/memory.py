"""An estimate of the memory that a run needs."""

from __future__ import annotations

from pathlib import Path

from isoparticles._native import Context

BYTES_AT_LEAST = 600 * 2**20
"""Memory of the packages without a mesh; see :data:`BYTES_PER_VERTEX`."""
BYTES_PER_VERTEX = 5100
"""Bytes for each vertex of the surface. Both are the line through 896 MiB for the 55,626 vertices
of `heart` and 2,050 MiB for the 292,825 of `ribs`, with 15 to 20 tetrahedra a vertex
(docs/developer/performance.md, real volumes, `make CASE=heart` and `make CASE=ribs`)."""


def check_memory(vertices: int, surface: Path, context: Context) -> None:
    """Refuse a surface whose tetrahedra are expected to need more memory than allowed, or free.

    Parameters
    ----------
    vertices
        Vertices of the surface.
    surface
        Its file, for the message.
    context
        Knows ``--max-memory``.

    Raises
    ------
    StageError
        If they are expected to need more.
    """
    context.check_memory(
        BYTES_AT_LEAST + BYTES_PER_VERTEX * vertices,
        f"{surface}: tetrahedra for {vertices:,} vertices",
        "make a coarser surface (sizefield --min-size, --quality coarse)",
    )
