"""fTetWild: fills any surface, within an envelope of it."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tetmesh_check.context import Context
from tetmesh_check.sizing import Background
from tetmesh_check.surface import Surface
from tetmesh_check.tets.worker import TimeLimit, Worker, WorkerResult, last_match, run_worker

_PASS = re.compile(r"/+ pass (\d+) /+")
_COUNT = re.compile(r"#t = (\d+)")
_ENERGY = re.compile(r"max_energy = ([0-9.eE+-]+)")

WORKER = Worker(
    name="fTetWild",
    module="tetmesh_check.tets.tetwild_worker",
    library="pytetwild",
    shown=(("pass", _PASS), ("tetrahedra", _COUNT), ("largest energy", _ENERGY)),
    when_it_fails="try a larger --tet-size-factor or a larger --envelope, or a machine with more memory",
    when_it_is_empty="the envelope may be larger than the object: try a smaller --envelope",
    when_it_is_missing="the environment is not whole: make it again with stages/tetmesh-check/setup-env.sh",
    powers={"points": 1, "background_points": 1, "background_values": 1, "edge_length": 1},
)


@dataclass(frozen=True)
class TetwildSettings:
    """Settings of fTetWild."""

    epsilon: float
    """Largest distance of the new boundary from the surface over the diagonal of the bounding
    box."""
    edge_length: float
    """Edge length outside the background mesh, mm. At least its largest value, because fTetWild
    only refines."""
    stop_energy: float
    """Optimization stops at this largest AMIPS energy (3 is regular, larger is worse)."""
    max_passes: int
    """Optimization stops after this many passes."""
    threads: int
    """Threads of the process."""


def fill_by_tetwild(
    surface: Surface, background: Background, settings: TetwildSettings, log: Path, limit: TimeLimit, context: Context
) -> WorkerResult:
    """Fill a surface with tetrahedra.

    Parameters
    ----------
    surface
        A checked surface.
    background
        Edge lengths over the object, already multiplied by the size factor.
    settings
        The settings.
    log, limit, context
        See :func:`.run_worker`, also for the errors.
    """
    arrays = {
        "points": surface.points,
        "triangles": surface.triangles.astype(np.int32),
        "background_points": background.points,
        "background_tetrahedra": background.tetrahedra.astype(np.int32),
        "background_values": background.values,
    }
    result = run_worker(WORKER, arrays, settings, log, limit, context)
    energy, passes = last_match(_ENERGY, result.said), last_match(_PASS, result.said)
    result.summary.update(
        passes=int(passes) + 1 if passes is not None else 0,
        last_max_energy=float(energy) if energy is not None else None,
        epsilon_relative=settings.epsilon,
        stop_energy=settings.stop_energy,
        background_nodes=len(background.points),
        background_tetrahedra=len(background.tetrahedra),
        background_stride_voxels=background.stride,
    )
    return result
