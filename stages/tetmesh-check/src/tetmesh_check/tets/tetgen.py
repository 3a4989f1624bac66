"""TetGen: keeps the triangles of the surface.

Si, "TetGen, a Delaunay-based quality tetrahedral mesh generator" (2015). TetGen is
AGPL-3.0-or-later and an optional package that setup-env.sh never installs. It is used only with
``--method tetgen``, and only the child process imports it: ``python -m tetmesh_check.tets.tetgen
FOLDER``.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from tetmesh_check.quality import Points
from tetmesh_check.tets.worker import Job, Raw, Runner, Worker, scale_of, serve

if TYPE_CHECKING:
    from tetmesh_check.surface import Surface
    from tetmesh_check.topology import Components, Shells

_SHAPE = {"max_radius_edge_ratio": 1.414, "min_dihedral": 10.0}
"""Maximum ratio of circumradius to shortest edge, and minimum dihedral angle (degrees), if the
surface allows them."""
_OPTIMIZATION = 4
"""Level of the optimization at the end."""
_NEAR = 1e-3
"""Distance between the point that marks a cavity and its triangle, relative to the size of the
triangle."""

WORKER = Worker(
    name="TetGen",
    module="tetmesh_check.tets.tetgen",
    library="tetgen",
    when_it_fails="try --method hxt or --method ftetwild",
    when_it_is_missing="it is AGPL-3.0-or-later, so it is not installed by default: python -m pip install "
    "--require-hashes -r stages/tetmesh-check/requirements-tetgen.lock; or use --method hxt",
    shown={},
)


def regular_volume(edge_length: float) -> float:
    """Return the volume of a regular tetrahedron, mm^3.

    Parameters
    ----------
    edge_length
        Length of its edges, mm.
    """
    return edge_length**3 / (6.0 * math.sqrt(2.0))


def cavity_points(surface: Surface, parts: Components | Shells) -> Points:
    """Find a point in every cavity, near its largest triangle; shape ``(k, 3)``, mm.

    For many materials, the space around each shell also gets a point.

    Parameters
    ----------
    surface
        A checked surface.
    parts
        Its components, or the volumes of many materials.
    """
    a, b, c = (surface.points[surface.triangles[:, k]] for k in range(3))
    normals = np.cross(b - a, c - a)  # out of the object, into the cavity
    sizes = np.linalg.norm(normals, axis=1)
    labels, cavities = parts.cavities()
    at = [int(np.argmax(np.where(labels == cavity, sizes, -1.0))) for cavity in cavities]
    points: Points = (a[at] + b[at] + c[at]) / 3.0 + _NEAR * normals[at] / np.sqrt(sizes[at])[:, None]
    return points


def fill_by_tetgen(surface: Surface, parts: Components | Shells, max_volume: float, runner: Runner) -> Raw:
    """Fill a surface with tetrahedra.

    Parameters
    ----------
    surface
        A checked surface.
    parts
        Its components and their nesting, or the volumes of many materials.
    max_volume
        Target for the maximum volume of a tetrahedron, mm^3. The final optimization may exceed it.
    runner
        Runs TetGen, and raises the errors.
    """
    scale = scale_of(surface.points)
    job = {
        "scale": scale,
        "points": scale * surface.points,
        "triangles": surface.triangles.astype(np.int32),
        "cavities": scale * cavity_points(surface, parts),
        "max_volume": scale**3 * max_volume,
        **_SHAPE,
    }
    return runner.run(WORKER, job, max_volume=max_volume, **_SHAPE)


def _fill(tetgen: Any, job: Job) -> Any:
    filling = tetgen.TetGen(job["points"], job["triangles"])
    for point in job["cavities"]:
        filling.add_hole(point.tolist())
    # p: fill a surface; Y: leave its triangles as they are; q: shape; a: volume; O: optimize
    shape = f"q{job['max_radius_edge_ratio']:g}/{job['min_dihedral']:g}"
    switches = f"pY{shape}a{job['max_volume']:.15f}O{_OPTIMIZATION}"
    print(f"switches {switches}")
    return filling.tetrahedralize(switches=switches)[:2]


if __name__ == "__main__":
    serve("tetgen", _fill)
