"""The potential of a current in one material: the forward problem of electrocardiography.

A density J of impressed current flows in one material, as that of an excited heart, and every
material conducts with a constant sigma of its own: div(J - sigma grad u) = 0, with no current
through the boundary of the whole (Gulrajani, "Bioelectricity and Biomagnetism", 1998, chapter 5).
What leaves a material must enter its neighbours. The current through a part of the surface of a
material is taken as the finite elements have it, from the equations of the vertices there: the sum
over all of them is zero but for the error of the solver, on any mesh. The currents on both sides of
a triangle, from the gradients alone, differ by the error of the elements, which falls with h.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from skfem.helpers import dot, grad

from tetmesh_check.errors import StageError
from tetmesh_check.fem.assembly import Assembler
from tetmesh_check.fem.solver import Solver
from tetmesh_check.materials import NOTHING, Sides
from tetmesh_check.quality import OUTWARD_FACES, Cells, Labels, Points, Values
from tetmesh_check.topology import members_of

DEFAULT_CONDUCTIVITY = 1.0
"""Conductivity of a material that the user does not name, S/m."""
MAX_IMBALANCE = 1e-6
"""Largest share of the current through the surface of a material that may be lost or gained
there."""


@dataclass(frozen=True)
class ForwardArguments:
    """The options of the problem of currents, by the names of materials."""

    conductivity: Mapping[str, float] = field(default_factory=dict)
    """S/m."""
    source: str | None = None
    """The material in which the current flows; without one nothing is solved."""
    density: tuple[float, float, float] = (1.0, 0.0, 0.0)
    """Impressed current, uA/mm^2."""


@dataclass(frozen=True)
class Source:
    """The same by their numbers."""

    material: int
    density: Values
    """Shape ``(3,)``."""
    conductivity: Values
    """Conductivity of each material, S/m, shape ``(len(table),)``."""


@dataclass(frozen=True)
class RegionMesh:
    """The tetrahedra with their materials."""

    regions: Labels
    """Material of each tetrahedron, shape ``(m,)``."""
    names: list[str]
    """Names of the materials, by number."""
    triangles: Cells
    """Triangles between two materials, shape ``(k, 3)``."""
    behind: Labels
    """Tetrahedron behind each, shape ``(k,)``."""
    before: Labels
    """Tetrahedron before each, shape ``(k,)``; -1 where the outside is."""
    pair: Labels
    """Number of the pair of each, shape ``(k,)``."""
    pair_names: list[str]
    """Names of the pairs, by number."""


@dataclass(frozen=True)
class Forward:
    """A problem to be solved."""

    source: Source
    mesh: RegionMesh


def check_names(arguments: ForwardArguments, names: Sequence[str]) -> None:
    """Refuse names that no material has, and a conductivity without a source.

    Parameters
    ----------
    arguments
        The options.
    names
        The names of the materials; empty for one object.

    Raises
    ------
    StageError
        If there is no material of such a name, one object only, or a conductivity without a source.
    """
    given = [*arguments.conductivity, *([] if arguments.source is None else [arguments.source])]
    if given and not names:
        raise StageError(
            "--conductivity and --source name materials, and the surface is that of one object",
            "currents through tissues of different conductivity need a mesh of all of them",
            "give the surface of many materials, or leave them out",
        )
    for name in given:
        if name not in names:
            raise StageError(
                f"'{name}' is none of the materials of the surface: {', '.join(names)}",
                "--conductivity and --source take their names",
                "check the name",
            )
    if given and arguments.source is None:
        raise StageError(
            "--conductivity was given without --source",
            "without a current there is no potential to solve for",
            "add --source NAME, the material in which the current arises, such as the heart",
        )


def resolve_source(arguments: ForwardArguments, sides: Sides | None) -> Source | None:
    """Find the materials that the user named; ``None`` where no source was given.

    Parameters
    ----------
    arguments
        The options.
    sides
        The materials of the surface; ``None`` for one object.

    Raises
    ------
    StageError
        If there is no material of such a name, one object only, or a conductivity without a source.
    """
    numbers = {} if sides is None else {sides.names[number]: number for number in sides.present}
    check_names(arguments, list(numbers))
    if arguments.source is None or sides is None:
        return None
    conductivity = np.full(len(sides.table), DEFAULT_CONDUCTIVITY)
    for name, value in arguments.conductivity.items():
        conductivity[numbers[name]] = value
    return Source(numbers[arguments.source], np.array(arguments.density), conductivity)


def _hat_gradients(points: Points, tetrahedra: Cells) -> tuple[Values, Values]:
    """Gradients of the hat functions times the volume, mm^2, and volumes, mm^3."""
    corners = points[tetrahedra]
    gradients = np.empty((len(tetrahedra), 4, 3))
    for face in OUTWARD_FACES:
        a, b, c = (corners[:, k] for k in face)
        opposite = 6 - sum(face)
        gradients[:, opposite] = -np.cross(b - a, c - a) / 6.0
    volumes = np.einsum("ij,ij->i", gradients[:, 1], corners[:, 1] - corners[:, 0])
    return gradients, volumes


def _weighted(u: Any, v: Any, w: Any) -> Any:
    return w.weight * dot(grad(u), grad(v))


def potential_of(
    assembler: Assembler, regions: Labels, source: Source, solver: Solver
) -> tuple[Values, Values, dict[str, Any], bool]:
    """Solve for the potential.

    Parameters
    ----------
    assembler
        The tetrahedra, all positive.
    regions
        Material of each, shape ``(m,)``.
    source
        The source of the current, and the conductivities.
    solver
        The solver.

    Returns
    -------
    tuple
        Potential at the points, mV, with mean zero over the volume of every part that hangs
        together, shape ``(n,)``; current density in the tetrahedra, uA/mm^2, shape ``(m, 3)``;
        figures of the solver, and whether it converged.
    """
    points, tetrahedra = assembler.points, assembler.tetrahedra
    sigma = source.conductivity[regions]
    impressed = np.where((regions == source.material)[:, None], source.density, 0.0)
    gradients, volumes = _hat_gradients(points, tetrahedra)
    # S/m times mV/mm is uA/mm^2
    matrix = assembler.matrix(_weighted, weights=sigma)
    pushed = np.einsum("ikj,ij->ik", gradients, impressed)
    right_side: Values = np.bincount(tetrahedra.ravel(), weights=pushed.ravel(), minlength=len(points)).astype(
        np.float64
    )
    potential, part, figures, converged = solver.solve_floating(matrix, right_side)
    of_tetrahedron = part[tetrahedra[:, 0]]
    means = np.bincount(of_tetrahedron, volumes * potential[tetrahedra].mean(axis=1)) / np.bincount(
        of_tetrahedron, volumes
    )
    potential -= means[part]
    slope = np.einsum("ikj,ik->ij", gradients, potential[tetrahedra]) / volumes[:, None]
    return potential, impressed - sigma[:, None] * slope, figures, converged


def _balance(points: Points, tetrahedra: Cells, current: Values, mesh: RegionMesh) -> list[dict[str, Any]]:
    """Currents through the surface of each material, from the equations there."""
    gradients, _volumes = _hat_gradients(points, tetrahedra)
    share = np.einsum("ikj,ij->ik", gradients, current)
    count = len(mesh.names)
    sides = [np.where(owner < 0, NOTHING, mesh.regions[owner]) for owner in (mesh.behind, mesh.before)]
    behind_of, before_of = (members_of(side, count) for side in sides)
    balances = []
    for number, own in enumerate(members_of(mesh.regions, count)):
        if not len(own):
            continue
        used, local = np.unique(tetrahedra[own], return_inverse=True)
        out = np.bincount(local.ravel(), weights=share[own].ravel())
        around = np.unique(mesh.triangles[np.concatenate([behind_of[number], before_of[number]])])
        on_surface = np.isin(used, around, assume_unique=True)
        passing = float(np.abs(out[on_surface]).sum())
        net = float(out[on_surface].sum())
        balances.append({"number": number, "passing_ua": passing, "net_ua": net})
    return balances


def _interfaces(points: Points, current: Values, mesh: RegionMesh) -> list[dict[str, Any]]:
    """Currents through each interface, from the densities on both of its sides."""
    a, b, c = (points[mesh.triangles[:, k]] for k in range(3))
    areas = 0.5 * np.cross(b - a, c - a)
    from_behind = np.einsum("ij,ij->i", areas, current[mesh.behind])
    outermost = mesh.before < 0
    from_before = np.where(outermost, 0.0, np.einsum("ij,ij->i", areas, current[mesh.before]))
    listed = []
    inner, through = ~outermost, 0.5 * (from_behind + from_before)
    for name, own in zip(mesh.pair_names, members_of(mesh.pair, len(mesh.pair_names)), strict=True):
        passed = through[own[inner[own]]]
        listed.append(
            {
                "name": name,
                "net_ua": float(passed.sum()),
                "passing_ua": float(np.abs(passed).sum()),
                "jump_ua": float(np.abs(from_behind - from_before)[own].sum()),
            }
        )
    return listed


def forward(assembler: Assembler, problem: Forward, solver: Solver) -> tuple[dict[str, Any], bool]:
    """Solve for the potential, and follow the current.

    Parameters
    ----------
    assembler
        The tetrahedra.
    problem
        The materials and the source.
    solver
        The solver.

    Returns
    -------
    tuple
        Figures, and whether the solver converged. ``imbalance`` is the largest net current through
        the closed surface of a material over the current that passes there; ``interfaces`` has for
        each pair the net current from the inside to the outside, what passes either way, and
        ``jump_ua``, the difference between both sides summed over the triangles.
    """
    mesh, source = problem.mesh, problem.source
    points, tetrahedra = assembler.points, assembler.tetrahedra
    potential, current, figures, converged = potential_of(assembler, mesh.regions, source, solver)
    balances = _balance(points, tetrahedra, current, mesh)
    # a material in which nothing flows has nothing to lose: what passes the source is the scale of
    # all
    scale = max((entry["passing_ua"] for entry in balances), default=0.0)
    weight = _hat_gradients(points, tetrahedra)[1]
    middle = potential[tetrahedra].mean(axis=1)
    for entry in balances:
        own = mesh.regions == entry["number"]
        values = potential[np.unique(tetrahedra[own])]
        entry.update(
            name=mesh.names[entry["number"]],
            conductivity_s_per_m=float(source.conductivity[entry["number"]]),
            potential_mv={
                "min": float(values.min()),
                "max": float(values.max()),
                "mean": float((weight * middle)[own].sum() / weight[own].sum()),
            },
        )
    figures.update(
        source=mesh.names[source.material],
        density_ua_per_mm2=source.density.tolist(),
        imbalance=max(abs(entry["net_ua"]) for entry in balances) / scale if scale > 0.0 else 0.0,
        potential_range_mv=[float(potential.min()), float(potential.max())],
        regions=balances,
        interfaces=_interfaces(points, current, mesh),
    )
    return figures, converged
