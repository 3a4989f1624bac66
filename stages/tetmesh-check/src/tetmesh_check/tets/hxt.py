"""HXT, the parallel Delaunay tetrahedralizer of Gmsh.

Marot, Pellerin and Remacle, "One machine, one minute, three billion tetrahedra" (2019), and the
optimization of Marot and Remacle, "Quality tetrahedral mesh generation with HXT" (2020). Gmsh is
GPL-2.0-or-later and an optional package: it is imported in the worker's process only.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from tetmesh_check.components import Components
from tetmesh_check.context import Context
from tetmesh_check.shells import Shells
from tetmesh_check.sizing import WorldGrid
from tetmesh_check.surface import Surface
from tetmesh_check.tets.worker import TimeLimit, Worker, WorkerResult, run_worker

OPTIMIZE_THRESHOLD = 0.4
"""HXT improves the tetrahedra whose quality (1 is regular) is below this. A heart of 54,859
vertices: 0.35 takes 1.5 s for a smallest dihedral angle of 15.4 degrees, 0.4 takes 2.2 s for 17.0,
0.45 takes 7 s and 0.5 43 s for no larger angle (before :data:`LENGTH_FACTOR`)."""

LENGTH_FACTOR = 0.66
"""Factor of the edge lengths for HXT, which drops new vertices closer than this length to another.
Without the factor, edges are 1.36 to 1.41 times as long as the target; with it, 1.00 to 1.02 times
(medians of four surfaces)."""

WORKER = Worker(
    name="HXT",
    module="tetmesh_check.tets.hxt_worker",
    library="gmsh",
    shown=(
        ("vertices", re.compile(r"mesh\.nvert: (\d+)")),
        ("tetrahedra to improve", re.compile(r"Improving +(\d+) tet")),
    ),
    when_it_fails="try --method ftetwild, a larger --tet-size-factor, or a machine with more memory",
    when_it_is_empty="try --method ftetwild",
    when_it_is_missing="install it with stages/tetmesh-check/setup-env.sh (make env), which also says which system "
    "libraries it lacks, or use --method ftetwild",
    powers={"points": 1, "sizing": 1, "sizing_origin": 1, "sizing_spacing": 1},
)

_NAMES = {"hxt": "HXT", "delaunay": "Gmsh's Delaunay"}
_COMPLEX_FAILS = "try a larger or smaller --tet-size-factor, or mesh fewer materials"


@dataclass(frozen=True)
class HxtSettings:
    """Settings of HXT."""

    optimize_threshold: float = OPTIMIZE_THRESHOLD
    """See :data:`OPTIMIZE_THRESHOLD`."""
    algorithm: str = "hxt"
    """Or ``delaunay``, Gmsh's older one, for complexes: slower, and it takes some that HXT does
    not."""


def fill_by_hxt(
    surface: Surface,
    components: Components,
    grid: WorldGrid,
    settings: HxtSettings,
    log: Path,
    limit: TimeLimit,
    context: Context,
) -> WorkerResult:
    """Fill a surface with tetrahedra.

    Parameters
    ----------
    surface
        A checked surface.
    components
        Its components, and which lies in which.
    grid
        Edge lengths over the bounding box of the surface, already multiplied by the size factor.
    settings
        The settings.
    log, limit, context
        See :func:`.run_worker`, also for the errors.
    """
    arrays = {"labels": components.labels, "bodies": components.bodies()}
    return _fill(WORKER, arrays, surface, grid, settings, log, limit, context)


def fill_complex_by_gmsh(
    surface: Surface,
    shells: Shells,
    grid: WorldGrid,
    settings: HxtSettings,
    log: Path,
    limit: TimeLimit,
    context: Context,
) -> WorkerResult:
    """Fill all volumes of a surface of many materials with tetrahedra that share its triangles.

    Parameters
    ----------
    surface
        A checked complex.
    shells
        Its volumes.
    grid, settings, log, limit, context
        As for :func:`fill_by_hxt`.
    """
    bounds, sheet = shells.sheets()
    worker = replace(
        WORKER, name=_NAMES[settings.algorithm], when_it_fails=_COMPLEX_FAILS, when_it_is_empty=_COMPLEX_FAILS
    )
    return _fill(worker, {"sheet": sheet, "bounds": bounds}, surface, grid, settings, log, limit, context)


def _fill(
    worker: Worker,
    about: dict[str, Any],
    surface: Surface,
    grid: WorldGrid,
    settings: HxtSettings,
    log: Path,
    limit: TimeLimit,
    context: Context,
) -> WorkerResult:
    arrays = {
        "points": surface.points,
        "triangles": surface.triangles,
        **about,
        "sizing": LENGTH_FACTOR * grid.values,
        "sizing_origin": grid.origin,
        "sizing_spacing": np.array(grid.spacing),
    }
    result = run_worker(worker, arrays, settings, log, limit, context)
    result.summary.update(
        optimize_threshold=settings.optimize_threshold, length_factor=LENGTH_FACTOR, sizing_nodes=grid.values.size
    )
    return result
