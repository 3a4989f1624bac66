"""Remeshes a surface with another program to a given number of vertices.

    python remesh_peers.py PROGRAM JOB.npz RESULT.npz

scale.py runs this script with an interpreter that has the packages in peers.lock.

PROGRAM is botsch (gpytoolbox), cgal (isotropic remeshing, by compas_cgal), mmg (mmgpy), pymeshlab
(isotropic explicit remeshing), instant-meshes (pyinstantmeshes), acvd (pyacvd), or none, which
returns the surface unchanged. Programs use their defaults except as noted in the functions below.

JOB contains the arrays ``points, triangles, vertices``. RESULT contains ``points, triangles``, the
``seconds`` of the last try, and ``bytes``, the peak memory of this process. The edge length is
uniform. It is adjusted in at most six tries until the number of vertices is within 3 % of the
target.
"""

from __future__ import annotations

import re
import sys
import time
from pathlib import Path

import numpy as np

# Number of iterations of the programs that have this option.
ITERATIONS = 10
# Maximum number of edge lengths to try. If none meets the tolerance, the last result is kept.
TRIES = 6
# Relative tolerance of the number of vertices. It corresponds to 1.5 % of the edge length.
CLOSE = 0.03


def botsch(points: np.ndarray, triangles: np.ndarray, length: float) -> tuple[np.ndarray, np.ndarray]:
    """Remeshes by the method of Botsch and Kobbelt, with ten iterations and with projection."""
    from gpytoolbox import remesh_botsch

    return remesh_botsch(points, triangles.astype(np.int32), ITERATIONS, length, True)


def cgal(points: np.ndarray, triangles: np.ndarray, length: float) -> tuple[np.ndarray, np.ndarray]:
    """Remeshes with ten iterations of CGAL's isotropic remeshing."""
    from compas_cgal.meshing import trimesh_remesh

    return trimesh_remesh((points, triangles), length, ITERATIONS)


def mmg(points: np.ndarray, triangles: np.ndarray, length: float) -> tuple[np.ndarray, np.ndarray]:
    """Remeshes with MMGS at a uniform edge length.

    The tolerance ``hausd`` is one edge length, because the default refines by curvature. The ridge
    angle is 180 degrees, because blurred labels have no ridges.
    """
    from mmgpy import MmgMeshS

    mesh = MmgMeshS(points, triangles.astype(np.int32))
    mesh.remesh(hsiz=length, hausd=length, ar=180.0, verbose=-1)
    return mesh.get_vertices(), mesh.get_triangles()


def pymeshlab(points: np.ndarray, triangles: np.ndarray, length: float) -> tuple[np.ndarray, np.ndarray]:
    """Remeshes with MeshLab's isotropic explicit remeshing: ten iterations, no feature lines."""
    from pymeshlab import Mesh, MeshSet, PureValue

    meshes = MeshSet(verbose=False)
    meshes.add_mesh(Mesh(points, triangles.astype(np.int32)))
    meshes.meshing_isotropic_explicit_remeshing(iterations=ITERATIONS, targetlen=PureValue(length), featuredeg=180.0)
    made = meshes.current_mesh()
    return made.vertex_matrix(), made.face_matrix()


def instant_meshes(points: np.ndarray, triangles: np.ndarray, length: float) -> tuple[np.ndarray, np.ndarray]:
    """Remeshes with Instant Meshes: triangles, extrinsic, deterministic."""
    from pyinstantmeshes import remesh

    return remesh(
        points.astype(np.float32), triangles.astype(np.int32), target_edge_length=length, rosy=6, posy=3, extrinsic=True,
        deterministic=True,
    )  # fmt: skip


def acvd(points: np.ndarray, triangles: np.ndarray, length: float) -> tuple[np.ndarray, np.ndarray]:
    """Remeshes by Voronoi clustering, after subdividing to at least twelve vertices per cluster."""
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
    """Tries edge lengths and writes the result of the last try."""
    program = sys.argv[1]
    with np.load(sys.argv[2]) as job:
        points, triangles, wanted = job["points"].astype(np.float64), job["triangles"], int(job["vertices"])
    corners = points[triangles]
    area = 0.5 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1).sum()
    # edge length of equilateral triangles that fill the area with two triangles per vertex
    length = float(np.sqrt(area / wanted * 2.0 / np.sqrt(3.0)))
    for _ in range(TRIES):
        started = time.monotonic()
        made, cells = (points, triangles) if program == "none" else PROGRAMS[program](points, triangles, length)
        seconds = time.monotonic() - started
        # ru_maxrss of getrusage would include the memory of the parent process
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
