"""Remesh a surface by another program to a number of vertices.

    python remesh_peers.py PROGRAM JOB.npz RESULT.npz    # an interpreter with peers.lock; scale.py calls it

PROGRAM: botsch (gpytoolbox), cgal (isotropic remeshing, by compas_cgal), mmg (mmgpy), pymeshlab (isotropic explicit remeshing), instant-meshes
(pyinstantmeshes), acvd (pyacvd), each with its defaults but for what is said below, or none: the surface as it is.

JOB: ``points, triangles, vertices``; RESULT: ``points, triangles, seconds`` (of the last try) and ``bytes``, the peak memory of
this process. One edge length everywhere, found by trying until the vertices are within 3 % of those wanted.
"""

from __future__ import annotations

import re
import sys
import time
from pathlib import Path

import numpy as np

ITERATIONS = 10
TRIES = 6
CLOSE = 0.03


def botsch(points: np.ndarray, triangles: np.ndarray, length: float) -> tuple[np.ndarray, np.ndarray]:
    """Botsch and Kobbelt's remeshing; ten iterations, with projection."""
    from gpytoolbox import remesh_botsch

    return remesh_botsch(points, triangles.astype(np.int32), ITERATIONS, length, True)


def cgal(points: np.ndarray, triangles: np.ndarray, length: float) -> tuple[np.ndarray, np.ndarray]:
    """CGAL's isotropic remeshing, ten iterations."""
    from compas_cgal.meshing import trimesh_remesh

    return trimesh_remesh((points, triangles), length, ITERATIONS)


def mmg(points: np.ndarray, triangles: np.ndarray, length: float) -> tuple[np.ndarray, np.ndarray]:
    """MMGS with one size.

    It may leave the surface by an edge length, since its default refines by curvature; and there are no ridges on blurred labels.
    """
    from mmgpy import MmgMeshS

    mesh = MmgMeshS(points, triangles.astype(np.int32))
    mesh.remesh(hsiz=length, hausd=length, ar=180.0, verbose=-1)
    return mesh.get_vertices(), mesh.get_triangles()


def pymeshlab(points: np.ndarray, triangles: np.ndarray, length: float) -> tuple[np.ndarray, np.ndarray]:
    """MeshLab's isotropic explicit remeshing, ten iterations, without feature lines."""
    from pymeshlab import Mesh, MeshSet, PureValue

    meshes = MeshSet(verbose=False)
    meshes.add_mesh(Mesh(points, triangles.astype(np.int32)))
    meshes.meshing_isotropic_explicit_remeshing(iterations=ITERATIONS, targetlen=PureValue(length), featuredeg=180.0)
    made = meshes.current_mesh()
    return made.vertex_matrix(), made.face_matrix()


def instant_meshes(points: np.ndarray, triangles: np.ndarray, length: float) -> tuple[np.ndarray, np.ndarray]:
    """Instant Meshes: triangles, extrinsic, the same result every time."""
    from pyinstantmeshes import remesh

    return remesh(
        points.astype(np.float32), triangles.astype(np.int32), target_edge_length=length, rosy=6, posy=3, extrinsic=True,
        deterministic=True,
    )  # fmt: skip


def acvd(points: np.ndarray, triangles: np.ndarray, length: float) -> tuple[np.ndarray, np.ndarray]:
    """Voronoi clusters of the surface, subdivided until a cluster has a dozen vertices."""
    import pyvista as pv
    from pyacvd import Clustering

    surface = pv.PolyData.from_regular_faces(points, triangles)
    clusters = round(surface.area / length**2 * 2.0 / np.sqrt(3.0))
    clustering = Clustering(surface)
    while clustering.mesh.n_points < 12 * clusters:
        clustering.subdivide(2)
    clustering.cluster(clusters)
    made = clustering.create_mesh()
    return np.asarray(made.points), np.asarray(made.regular_faces)


PROGRAMS = {
    "botsch": botsch,
    "cgal": cgal,
    "mmg": mmg,
    "pymeshlab": pymeshlab,
    "instant-meshes": instant_meshes,
    "acvd": acvd,
}


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
        made, cells = (points, triangles) if program == "none" else PROGRAMS[program](points, triangles, length)
        seconds = time.monotonic() - started
        # not that of getrusage, which begins with what the calling process had
        told = re.search(r"VmHWM:\s+(\d+) kB", Path("/proc/self/status").read_text())
        peak = 1024 * int(told.group(1)) if told else 0
        result = Path(sys.argv[3]).with_name(f"part.{program}.npz")
        np.savez(result, points=made, triangles=cells, seconds=seconds, bytes=peak)
        result.replace(sys.argv[3])
        if program == "none" or abs(len(made) - wanted) <= CLOSE * wanted:
            return
        length *= float(np.sqrt(len(made) / wanted))


if __name__ == "__main__":
    main()
