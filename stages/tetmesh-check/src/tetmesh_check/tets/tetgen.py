"""TetGen: keeps the triangles of the surface.

Si, "TetGen, a Delaunay-based quality tetrahedral mesh generator" (2015). TetGen is
AGPL-3.0-or-later and an optional package that setup-env.sh never installs: it is chosen by hand
only, and imported in the worker's process only.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tetmesh_check.components import Components
from tetmesh_check.context import Context
from tetmesh_check.quality import Points
from tetmesh_check.surface import Surface
from tetmesh_check.tets.worker import TimeLimit, Worker, WorkerResult, run_worker

MAX_RADIUS_EDGE_RATIO = 1.414
"""Largest ratio of circumradius to shortest edge, where the surface allows it."""
MIN_DIHEDRAL = 10.0
"""Smallest dihedral angle aimed at, degrees, where the surface allows it."""
_NEAR = 1e-3
"""Distance from its triangle of the point that marks a cavity, relative to the length of this
triangle."""

WORKER = Worker(
    name="TetGen",
    module="tetmesh_check.tets.tetgen_worker",
    library="tetgen",
    shown=(),
    when_it_fails="try --method hxt or --method ftetwild",
    when_it_is_empty="try --method hxt or --method ftetwild",
    when_it_is_missing="it is AGPL-3.0-or-later, so that only you can decide to have it: python -m pip install --require-hashes -r "
    "stages/tetmesh-check/requirements-tetgen.lock; or use --method hxt",
    powers={"points": 1, "cavities": 1, "max_volume": 3},
)


@dataclass(frozen=True)
class TetgenSettings:
    """Settings of TetGen."""

    max_volume: float
    """Largest volume of a tetrahedron aimed at, mm^3; its optimization at the end may make them
    larger."""
    max_radius_edge_ratio: float = MAX_RADIUS_EDGE_RATIO
    min_dihedral: float = MIN_DIHEDRAL


def regular_volume(edge_length: float) -> float:
    """Volume of a regular tetrahedron, mm^3.

    Parameters
    ----------
    edge_length
        Its edges, mm.
    """
    return edge_length**3 / (6.0 * math.sqrt(2.0))


def cavity_points(surface: Surface, components: Components) -> Points:
    """Find a point in every cavity, near its largest triangle; shape ``(k, 3)``, mm.

    Parameters
    ----------
    surface
        A checked surface.
    components
        Its components; a cavity is one at an odd depth.
    """
    a, b, c = (surface.points[surface.triangles[:, k]] for k in range(3))
    normals = np.cross(b - a, c - a)  # away from the matter, hence into the cavity
    sizes = np.linalg.norm(normals, axis=1)
    found = []
    for cavity in np.flatnonzero(components.depths % 2 == 1):
        at = int(np.argmax(np.where(components.labels == cavity, sizes, -1.0)))
        found.append((a[at] + b[at] + c[at]) / 3.0 + _NEAR * normals[at] / np.sqrt(sizes[at]))
    points: Points = np.array(found).reshape(-1, 3)
    return points


def fill_by_tetgen(
    surface: Surface, components: Components, settings: TetgenSettings, log: Path, limit: TimeLimit, context: Context
) -> WorkerResult:
    """Fill a surface with tetrahedra.

    Parameters
    ----------
    surface
        A checked surface.
    components
        Its components, and which lies in which.
    settings
        The settings.
    log, limit, context
        See :func:`.run_worker`, also for the errors.
    """
    arrays = {
        "points": surface.points,
        "triangles": surface.triangles,
        "cavities": cavity_points(surface, components),
    }
    result = run_worker(WORKER, arrays, settings, log, limit, context)
    result.summary.update(
        max_volume=settings.max_volume,
        max_radius_edge_ratio=settings.max_radius_edge_ratio,
        min_dihedral=settings.min_dihedral,
    )
    return result
