"""Solves the test problems on the mesh within a time limit, and checks the results."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from importlib.util import find_spec
from typing import Any

import numpy as np
from isoparticles._native import Context

from tetmesh_check.checks import Check, check
from tetmesh_check.errors import StageError
from tetmesh_check.fem.currents import Forward
from tetmesh_check.quality import Cells, Points, Values
from tetmesh_check.topology import Boundary

AUTO_MAX_TETRAHEDRA = 150_000
"""Maximum number of tetrahedra on which problems are solved by default. This takes at most about
half a minute and 1 GB."""
MAX_IMBALANCE = 1e-6
"""Maximum net current through the surface of a material, relative to the maximum current that
passes such a surface."""
_PACKAGES = {"skfem": "scikit-fem", "pyamg": "PyAMG"}
"""The packages of the extra ``fem``, by their modules."""
_INSTALL = "python -m pip install scikit-fem pyamg"


@dataclass(frozen=True)
class VolumeMesh:
    """The mesh of the problems."""

    points: Points
    """Positions, mm, shape ``(n, 3)``."""
    tetrahedra: Cells
    """Vertex indices, shape ``(m, 4)``."""
    volumes: Values
    """Volume of each tetrahedron, mm^3, shape ``(m,)``."""
    boundary: Boundary
    """Its boundary, and its bodies."""


def _missing() -> str:
    """Name the packages of the extra ``fem`` that are not installed, if any."""
    return " and ".join(name for module, name in _PACKAGES.items() if find_spec(module) is None)


def refuse_missing(mode: str, source: str | None, fibres: bool) -> None:
    """Refuse an explicit request for a solution without the packages that compute it.

    Parameters
    ----------
    mode, source
        The values of ``--solve``, and of ``--source`` if given.
    fibres
        Whether ``--fibres`` is given.
    """
    asked = fibres or mode == "yes" or (mode == "auto" and source is not None)
    if asked and (missing := _missing()):
        raise StageError(
            f"{missing}: not installed",
            "--solve yes, --source and --fibres solve problems on the tetrahedra with these packages",
            f"{_INSTALL}, or leave out these options",
        )


def _why_not(mesh: VolumeMesh, mode: str) -> str | None:
    """Return the reason why no problem is solved, or ``None``."""
    if mode == "no":
        return "--solve no was given"
    if not (mesh.volumes > 0).all():
        return "some tetrahedra are inverted or flat"
    if mode == "auto" and len(mesh.tetrahedra) > AUTO_MAX_TETRAHEDRA:
        return (
            f"{len(mesh.tetrahedra):,} tetrahedra are more than the default limit of {AUTO_MAX_TETRAHEDRA:,} "
            "(--solve yes ignores it)"
        )
    return None


def _problems(mesh: VolumeMesh, currents: Forward | None, deadline: float) -> dict[str, Callable[[], dict[str, Any]]]:
    """Return the problems, in the order in which they are solved."""
    from skfem import MeshTet

    from tetmesh_check.fem import forward, problems

    elements = MeshTet(np.ascontiguousarray(mesh.points.T), np.ascontiguousarray(mesh.tetrahedra.T))
    listed: dict[str, Callable[[], dict[str, Any]]] = {
        "poisson": lambda: problems.poisson(elements, mesh.boundary.triangles, deadline),
        "conduction": lambda: problems.conduction(elements, deadline),
        "elasticity": lambda: problems.elasticity(elements, mesh.boundary.bodies, deadline),
    }
    if currents is not None:
        listed["forward"] = lambda: forward.forward(elements, currents, deadline)
    return listed


def solve_on(
    mesh: VolumeMesh, mode: str, max_seconds: float, context: Context, currents: Forward | None = None
) -> tuple[list[Check], Values | None]:
    """Solve the problems of :mod:`.problems` on a mesh.

    Parameters
    ----------
    mesh
        The tetrahedra.
    mode
        Whether to solve: ``yes``, ``no``, or ``auto`` for meshes of up to
        :data:`AUTO_MAX_TETRAHEDRA` tetrahedra.
    max_seconds
        Time limit of all problems together, s.
    context
        For messages, times, and ``solve`` in the results.
    currents
        The problem of currents, if there is one.

    Returns
    -------
    tuple
        The checks of the solved problems, and the potential of the currents at the points, mV, if
        it was computed.
    """
    results: dict[str, Any] = {"done": False, "reason": _why_not(mesh, mode)}
    context.results["solve"] = results
    if results["reason"] is not None:
        say = context.verbose if currents is None else context.warn
        say(f"no problem is solved: {results['reason']}")
        return [], None
    if missing := _missing():
        results["reason"] = f"{missing}: not installed ({_INSTALL})"
        say = context.info if currents is None else context.warn
        say(f"no problem is solved: {results['reason']}")
        return [], None
    done: dict[str, dict[str, Any]] = {}
    unfinished: dict[str, str] = {}
    with context.step("solve"):
        for name, problem in _problems(mesh, currents, time.monotonic() + max_seconds).items():
            started = time.monotonic()
            try:
                done[name] = {**problem(), "seconds": time.monotonic() - started}
            except TimeoutError:
                unfinished[name] = f"not finished within {max_seconds:g} s (--solve-seconds)"
            except MemoryError:
                unfinished[name] = "not enough memory"
    potential = done.get("forward", {}).pop("potential", None)
    results.update(done=not unfinished, **done)
    if unfinished:
        reason = results["reason"] = "; ".join(f"{name}: {why}" for name, why in unfinished.items())
        told = "not every problem was solved" if done else "no problem was solved, and none was checked"
        context.warn(f"{told}: {reason}")
    runs = {name: figures["multigrid"] for name, figures in done.items() if "multigrid" in figures}
    iterations = ", ".join(f"{name} {run['iterations']}" for name, run in runs.items())
    context.closing.append(("CG iterations, multigrid", iterations or "none"))
    stuck = [name for name, run in runs.items() if not run["converged"]]
    told = f"{len(runs) - len(stuck)} of {len(runs)} problems"
    if stuck:
        told += f"; not solved: {', '.join(stuck)}, because the matrix is close to singular"
    checks = [check("solve_converged", len(stuck), told=told)] if runs else []
    if "forward" in done:
        checks.append(check("current_conserved", done["forward"]["imbalance"], MAX_IMBALANCE))
    return checks, potential
