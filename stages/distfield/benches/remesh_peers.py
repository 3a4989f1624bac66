"""Remesh a surface by another program to a number of vertices: gpytoolbox's remesh_botsch or CGAL's isotropic remeshing.

    python remesh_peers.py botsch|cgal JOB.npz RESULT.npz    # an interpreter with peers.lock; scale.py calls it

JOB: ``points, triangles, vertices``; RESULT: ``points, triangles, edge_length, seconds`` (of the last try). One edge length
everywhere, found by trying until the vertices are within 3 % of those wanted; ten iterations each, the default of both.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path

import numpy as np

ITERATIONS = 10
TRIES = 6
CLOSE = 0.03


def remeshed(program: str, points: np.ndarray, triangles: np.ndarray, length: float) -> tuple[np.ndarray, np.ndarray]:
    """Points and triangles of a mesh of an edge length."""
    if program == "botsch":
        from gpytoolbox import remesh_botsch

        return remesh_botsch(points, triangles.astype(np.int32), ITERATIONS, length, True)
    from compas_cgal.meshing import trimesh_remesh

    return trimesh_remesh((points, triangles), length, ITERATIONS)


def main() -> None:
    """Tries edge lengths; the last try is the result."""
    program = sys.argv[1]
    with np.load(sys.argv[2]) as job:
        points, triangles, wanted = job["points"].astype(np.float64), job["triangles"], int(job["vertices"])
    corners = points[triangles]
    area = 0.5 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1).sum()
    # two triangles a vertex, all equilateral
    length = float(np.sqrt(area / wanted * 2.0 / np.sqrt(3.0)))
    for _ in range(TRIES):
        started = time.monotonic()
        made, cells = remeshed(program, points, triangles, length)
        seconds = time.monotonic() - started
        result = Path(sys.argv[3]).with_name("part.npz")
        np.savez(result, points=made, triangles=cells, edge_length=length, seconds=seconds)
        result.replace(sys.argv[3])
        if abs(len(made) - wanted) <= CLOSE * wanted:
            return
        length *= float(np.sqrt(len(made) / wanted))


if __name__ == "__main__":
    main()
