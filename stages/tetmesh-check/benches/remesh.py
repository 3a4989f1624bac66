"""Remesh a surface by Botsch and Kobbelt's method (2004) as gpytoolbox has it, to a number of vertices.

    python remesh.py JOB.npz RESULT.npz    # an interpreter that has gpytoolbox; marching_cubes.py calls it

One edge length everywhere, found by trying, because this remesher takes no size field.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path

import numpy as np
from gpytoolbox import remesh_botsch

ITERATIONS = 10
"""Of the remesher; its own default."""
TRIES = 4
"""Edge lengths tried."""
CLOSE = 0.03
"""How far from the number wanted the vertices may be, as a share of it."""


def main() -> None:
    """Remesh: ``points, triangles, vertices`` in, ``points, triangles, edge_length, seconds`` (of the last try) out."""
    with np.load(sys.argv[1]) as job:
        points, triangles, wanted = job["points"], job["triangles"].astype(np.int32), int(job["vertices"])
    corners = points[triangles]
    area = 0.5 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1).sum()
    # two triangles a vertex, all equilateral
    length = float(np.sqrt(area / wanted * 2.0 / np.sqrt(3.0)))
    for _ in range(TRIES):
        started = time.monotonic()
        made, cells = remesh_botsch(points, triangles, ITERATIONS, length, True)
        seconds = time.monotonic() - started
        result = Path(sys.argv[2]).with_name("part.npz")
        np.savez(result, points=made, triangles=cells, edge_length=length, seconds=seconds)
        result.replace(sys.argv[2])
        if abs(len(made) - wanted) <= CLOSE * wanted:
            return
        length *= float(np.sqrt(len(made) / wanted))


if __name__ == "__main__":
    main()
