"""The potential of a current in one material: the forward problem of electrocardiography.

One material, such as the excited heart, has an impressed current with the density J. Each material
has a constant conductivity sigma. The potential u satisfies div(J - sigma grad u) = 0, with no
current through the outer boundary (Gulrajani, "Bioelectricity and Biomagnetism", 1998, chapter 5).

The current that leaves a material must enter its neighbours. The currents through the surface of a
material are computed from the finite-element equations of the vertices there. On any mesh, their
sum is zero except for the error of the solver. The current densities on both sides of a triangle,
computed from the gradients, differ by the discretization error, which decreases with h.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.sparse import csr_array
from skfem import Basis, BilinearForm, LinearForm, MeshTet
from skfem.helpers import dot, grad

from tetmesh_check.fem.assembly import linear_elements
from tetmesh_check.fem.currents import Forward
from tetmesh_check.fem.solver import solve_floating
from tetmesh_check.materials import NOTHING
from tetmesh_check.quality import Values

DEFAULT_CONDUCTIVITY = 1.0
"""Conductivity of a material that the user does not name, S/m."""


_CONDUCTION = BilinearForm(lambda u, v, w: w.sigma * dot(grad(u), grad(v)))
FLOW = LinearForm(lambda v, w: dot(w.current, grad(v)))
"""Flow of a vector field, given at the centroids, into each point."""


def potential_of(
    basis: Basis, sigma: Values, impressed: Values, deadline: float
) -> tuple[Values, Values, dict[str, Any]]:
    """Solve for the potential.

    Parameters
    ----------
    basis
        See :func:`.linear_elements`.
    sigma
        Conductivity of each tetrahedron, S/m, shape ``(m,)``.
    impressed
        Density of the impressed current at the centroids, uA/mm^2, shape ``(3, m, 1)``.
    deadline
        Time limit by the monotonic clock, s.

    Returns
    -------
    tuple
        Potential at the points, mV, shape ``(n,)``, with mean zero over each connected part of the
        mesh; current density in the tetrahedra, uA/mm^2, shape ``(3, m, 1)``; and results of the
        solver.
    """
    # S/m times mV/mm is uA/mm^2
    matrix = _CONDUCTION.assemble(basis, sigma=sigma[:, None])
    right_side = FLOW.assemble(basis, current=impressed)
    potential, part, figures = solve_floating(matrix, right_side, deadline)
    volumes, of_tetrahedron = basis.dx[:, 0], part[basis.mesh.t[0]]
    integrals = np.bincount(of_tetrahedron, volumes * potential[basis.mesh.t].mean(axis=0))
    potential -= (integrals / np.bincount(of_tetrahedron, volumes))[part]
    return potential, impressed - sigma[:, None] * basis.interpolate(potential).grad, figures


def _crossing(basis: Basis, current: Values, problem: Forward) -> Any:
    """Return currents, uA, from each material (row) into the vertices of its surface (column)."""
    sides, regions, triangles = problem.sides, problem.found.regions, problem.triangles
    shape = (len(sides.table), basis.N)
    shares = FLOW.elemental(basis, current=current).tolocal()
    corners = (np.repeat(regions, 4), basis.mesh.t.T.ravel())
    around = (np.repeat(np.concatenate([sides.inside, sides.outside]), 3), np.tile(triangles.ravel(), 2))
    touched = csr_array((np.ones(len(around[0])), around), shape=shape) > 0
    return csr_array((shares.ravel(), corners), shape=shape).multiply(touched)


def _regions(
    basis: Basis, conductivity: Values, potential: Values, current: Values, problem: Forward
) -> list[dict[str, Any]]:
    """Return the currents through the surface of each material, and the potential in it."""
    tetrahedra, regions = basis.mesh.t.T, problem.found.regions
    crossing = _crossing(basis, current, problem)
    passing, net = abs(crossing).sum(axis=1), crossing.sum(axis=1)
    listed = []
    for number in np.unique(regions).tolist():
        corners = potential[tetrahedra[regions == number]]
        mean = np.average(corners.mean(axis=1), weights=basis.dx[regions == number, 0])
        listed.append(
            {
                "number": number,
                "name": problem.sides.names[number],
                "passing_ua": float(passing[number]),
                "net_ua": float(net[number]),
                "conductivity_s_per_m": float(conductivity[number]),
                "potential_mv": {"min": float(corners.min()), "max": float(corners.max()), "mean": float(mean)},
            }
        )
    return listed


def _interfaces(basis: Basis, current: Values, problem: Forward) -> list[dict[str, Any]]:
    """Return the current through each interface, from the densities on both of its sides."""
    sides, found = problem.sides, problem.found
    a, b, c = (basis.mesh.p[:, problem.triangles[:, k]] for k in range(3))
    areas = 0.5 * np.cross(b - a, c - a, axis=0)
    behind, before = ((areas * current[:, owner, 0]).sum(axis=0) for owner in (found.behind, found.before))
    inner = sides.outside != NOTHING
    before = np.where(inner, before, 0.0)
    through = np.where(inner, 0.5 * (behind + before), 0.0)
    pairs, which = sides.pairs()
    measured = {"net_ua": through, "passing_ua": np.abs(through), "jump_ua": np.abs(behind - before)}
    sums = {key: np.bincount(which, values) for key, values in measured.items()}
    return [
        {"name": sides.pair_name(pair), **{key: float(values[number]) for key, values in sums.items()}}
        for number, pair in enumerate(pairs.tolist())
    ]


def forward(mesh: MeshTet, problem: Forward, deadline: float) -> dict[str, Any]:
    """Solve for the potential, and measure the currents between materials.

    Parameters
    ----------
    mesh
        The tetrahedra.
    problem
        The materials and the source.
    deadline
        Time limit by the monotonic clock, s.

    Returns
    -------
    dict
        Results. ``imbalance`` is the maximum net current through the closed surface of a material,
        relative to the maximum current that passes such a surface. ``interfaces`` has, for each
        interface, the net current from inside to outside, the sum of the currents in both
        directions, and ``jump_ua``: the difference between both sides, summed over the triangles.
        ``potential`` is that of the points, mV, shape ``(n,)``.
    """
    arguments, regions, names = problem.arguments, problem.found.regions, problem.sides.names
    basis = linear_elements(mesh)
    conductivity = np.array([arguments.conductivity.get(name, DEFAULT_CONDUCTIVITY) for name in names])
    in_source = regions == names.index(str(arguments.source))
    impressed = np.multiply.outer(problem.density, in_source[:, None])
    potential, current, figures = potential_of(basis, conductivity[regions], impressed, deadline)
    listed = _regions(basis, conductivity, potential, current, problem)
    # in some materials, hardly any current flows; the maximum is the scale for all of them
    scale = max(entry["passing_ua"] for entry in listed)
    return {
        **figures,
        "potential": potential,
        "source": arguments.source,
        "density_ua_per_mm2": list(arguments.density),
        "imbalance": max(abs(entry["net_ua"]) for entry in listed) / scale if scale > 0.0 else 0.0,
        "potential_range_mv": [float(potential.min()), float(potential.max())],
        "regions": listed,
        "interfaces": _interfaces(basis, current, problem),
    }
