"""Remesh a surface to a number of vertices by the method of Botsch and Kobbelt (2004).

    python remesh.py JOB.npz RESULT.npz

marching_cubes.py runs this script with an interpreter that has gpytoolbox. The edge length is
constant, because gpytoolbox's remesher accepts no size field, and is found by iteration.

JOB contains the arrays ``points, triangles, vertices``. RESULT contains ``points, triangles``, the
``edge_length``, and the ``seconds`` of the last try.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path

import numpy as np
from gpytoolbox import remesh_botsch

ITERATIONS = 10
"""Number of iterations of the remesher, its default."""
TRIES = 4
"""Maximum number of edge lengths to try."""
CLOSE = 0.03
"""Relative tolerance of the number of vertices."""


def main() -> None:
    """Try edge lengths and write the result of the last try."""
    with np.load(sys.argv[1]) as job:
        points, triangles, wanted = job["points"], job["triangles"].astype(np.int32), int(job["vertices"])
    corners = points[triangles]
    area = 0.5 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1).sum()
    # edge length of equilateral triangles that tile the area, with two triangles per vertex
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
