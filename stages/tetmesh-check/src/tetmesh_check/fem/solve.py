"""Which problems are solved on the mesh, within which bounds, and what that says about it."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

import numpy as np
from isoparticles._native import Context

from tetmesh_check.checks import Check, check
from tetmesh_check.fem.assembly import Assembler
from tetmesh_check.fem.forward import MAX_IMBALANCE, Forward, forward
from tetmesh_check.fem.problems import conduction, elasticity, poisson
from tetmesh_check.fem.solver import OutOfTimeError, Solver
from tetmesh_check.quality import Cells, Points, Values
from tetmesh_check.topology import Boundary

AUTO_MAX_TETRAHEDRA = 150_000
"""Largest mesh that is solved on by default: at most about half a minute and 1 GB."""
MAX_SECONDS = 600.0
"""Default time limit for all problems together, s."""
MAX_ITERATIONS = 50_000
"""Maximum iterations of conjugate gradients with Jacobi's preconditioner."""


class SolveMode(StrEnum):
    """Whether problems are solved on the mesh."""

    AUTO = "auto"
    """On meshes of up to :data:`AUTO_MAX_TETRAHEDRA` tetrahedra."""
    YES = "yes"
    NO = "no"


@dataclass(frozen=True)
class SolveSettings:
    """The options of the solves."""

    mode: SolveMode = SolveMode.AUTO
    max_seconds: float = MAX_SECONDS
    """Time limit of all problems together, s."""


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
    """Its outside, and its bodies."""


def _why_not(mesh: VolumeMesh, settings: SolveSettings) -> str | None:
    """Why nothing is solved, or ``None``."""
    if settings.mode is SolveMode.NO:
        return "--solve no was given"
    if not (mesh.volumes > 0).all():
        return "some tetrahedra are inverted or flat"
    if settings.mode is SolveMode.AUTO and len(mesh.tetrahedra) > AUTO_MAX_TETRAHEDRA:
        return (
            f"{len(mesh.tetrahedra):,} tetrahedra are more than the default limit of {AUTO_MAX_TETRAHEDRA:,} "
            "(--solve yes ignores it)"
        )
    return None


def _checks(done: dict[str, dict[str, Any]], stuck: list[str]) -> list[Check]:
    solved = [name for name, figures in done.items() if "multigrid" in figures]
    if not solved:
        return []
    told = f"{len(solved) - len(stuck)} of {len(solved)} problems"
    stood_in = [name for name in solved if done[name]["solved_with"] == "jacobi" and name not in stuck]
    if stood_in:
        told += f"; {', '.join(stood_in)} with Jacobi's preconditioner instead of multigrid"
    if stuck:
        told += f"; not solved: {', '.join(stuck)}, because the matrix is close to singular"
    return [check("solve_converged", len(stuck), told=told)]


def _conserved(done: dict[str, dict[str, Any]]) -> list[Check]:
    if "forward" not in done:
        return []
    imbalance = done["forward"]["imbalance"]
    return [check("current_conserved", imbalance, MAX_IMBALANCE)]


def _solve_all(
    problems: dict[str, Callable[[], tuple[dict[str, Any], bool]]], seconds: float, context: Context
) -> tuple[dict[str, dict[str, Any]], list[str], dict[str, str]]:
    """Solve in turn; return figures, unconverged problems, and unfinished ones."""
    done: dict[str, dict[str, Any]] = {}
    stuck: list[str] = []
    unfinished: dict[str, str] = {}
    for name, problem in problems.items():
        started = time.monotonic()
        try:
            figures, converged = problem()
        except OutOfTimeError:
            unfinished[name] = f"not finished within {seconds:g} s (--solve-seconds)"
            continue
        except MemoryError:
            unfinished[name] = "not enough memory"
            continue
        done[name] = {**figures, "seconds": time.monotonic() - started}
        if not converged:
            stuck.append(name)
        elif figures.get("solved_with") == "jacobi":
            context.warn(f"{name}: multigrid did not converge; the solution was computed with Jacobi's preconditioner")
    return done, stuck, unfinished


def solve_on(
    mesh: VolumeMesh, settings: SolveSettings, context: Context, currents: Forward | None = None
) -> list[Check]:
    """Solve the problems of :mod:`.problems` on a mesh.

    Parameters
    ----------
    mesh
        The tetrahedra.
    settings
        The options of the solves.
    context
        For messages, times, and ``solve`` in the results.
    currents
        The problem of currents, if there is one.

    Returns
    -------
    list of Check
        Empty if nothing was solved: no check has passed then.
    """
    results: dict[str, Any] = {"done": False, "reason": _why_not(mesh, settings)}
    context.results["solve"] = results
    if results["reason"] is not None:
        context.verbose(f"no problem is solved: {results['reason']}")
        return []
    solver = Solver(MAX_ITERATIONS, time.monotonic() + settings.max_seconds)
    boundary = np.zeros(len(mesh.points), dtype=bool)
    boundary[mesh.boundary.triangles] = True
    assembler = Assembler(mesh.points, mesh.tetrahedra, solver.deadline)
    problems: dict[str, Callable[[], tuple[dict[str, Any], bool]]] = {
        "poisson": lambda: poisson(assembler, boundary, solver),
        "conduction": lambda: conduction(assembler, solver),
        "elasticity": lambda: elasticity(assembler, mesh.volumes, mesh.boundary.bodies, solver),
    }
    if currents is not None:
        problems["forward"] = lambda: forward(assembler, currents, solver)
    with context.step("solve"):
        done, stuck, unfinished = _solve_all(problems, settings.max_seconds, context)
    results.update(done=not unfinished, **done)
    if unfinished:
        reason = results["reason"] = "; ".join(f"{name}: {why}" for name, why in unfinished.items())
        told = "not every problem was solved" if done else "no problem was solved, and none was checked"
        context.warn(f"{told}: {reason}")
    runs = {name: figures["multigrid"] for name, figures in done.items() if "multigrid" in figures}
    iterations = [f"{name} {run['iterations']}" for name, run in runs.items()]
    context.closing.append(("CG iterations, multigrid", ", ".join(iterations) or "none"))
    return _checks(done, stuck) + _conserved(done)
