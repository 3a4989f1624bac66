"""Three test problems with linear elements.

Poisson's equation with a known solution says whether the mesh approximates as it should; linear
elasticity and the conduction of currents in anisotropic tissue (the elliptic half of the bidomain
equations, Keener and Sneyd, "Mathematical Physiology", 2009, chapter 12) say whether a solver has
an easy time with it.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from skfem.helpers import dot, grad, mul

from tetmesh_check.fem.assembly import Assembler, held_at_one_side
from tetmesh_check.fem.solver import Solver, rigid_motions
from tetmesh_check.quality import Labels, Values

YOUNG = 0.01
"""Young's modulus, N/mm^2 (10 kPa, soft tissue)."""
POISSON_RATIO = 0.4
WEIGHT = 1060.0e-9 * 9.81
"""Weight of muscle, N/mm^3."""
LINEAR_SHARE = 0.01
"""Displacement over the diagonal of the bounding box up to which linear elasticity is trusted:
rotations that it leaves out are of second order, 1e-4 here."""
CLAMPED_SHARE = 0.1
"""Share of the length of each body that is held."""
_SIDES = tuple((axis, sign) for axis in range(3) for sign in (1.0, -1.0))
CONDUCTIVITY = {"intracellular": (0.174, 0.0193), "extracellular": (0.625, 0.236)}
"""Along and across the fibres, S/m (Roth 1997, after Clerc 1976)."""
RESTING, RISE = -80.0, 100.0
"""Transmembrane potential ahead of the wave front, and its rise behind it, mV."""


def _gradients(u: Any, v: Any, _w: Any) -> Any:
    return dot(grad(u), grad(v))


class _Wave:
    """A product of sines with one period along the longest side, and its derivatives."""

    def __init__(self, points: Values) -> None:
        low, high = points.min(axis=0), points.max(axis=0)
        self.wave_number = 2.0 * np.pi / float((high - low).max())
        self._low = low

    def _angles(self, x: Any) -> Any:
        shape = (3,) + (1,) * (x.ndim - 1)
        return self.wave_number * (x - self._low.reshape(shape)) + np.array([1.0, 2.0, 3.0]).reshape(shape)

    def value(self, x: Any) -> Any:
        return np.prod(np.sin(self._angles(x)), axis=0)

    def gradient(self, x: Any) -> Any:
        sines, cosines = np.sin(self._angles(x)), np.cos(self._angles(x))
        products = [cosines[k] * sines[(k + 1) % 3] * sines[(k + 2) % 3] for k in range(3)]
        return self.wave_number * np.stack(products)

    def source(self, x: Any) -> Any:
        return 3.0 * self.wave_number**2 * self.value(x)


def poisson(assembler: Assembler, boundary: NDArray[np.bool_], solver: Solver) -> tuple[dict[str, Any], bool]:
    """Solve Poisson's equation whose exact solution is known, with that solution on the boundary.

    Parameters
    ----------
    assembler
        The tetrahedra.
    boundary
        Whether each point lies on the boundary, shape ``(n,)``.
    solver
        The solver.

    Returns
    -------
    tuple
        Figures, and whether the solver converged. ``best_approximation`` is the error of the
        gradient over that of the interpolated exact solution: at most 1 on any mesh by Cea's lemma,
        but for the quadrature of the load, so that it says whether the solution is right and
        nothing about the mesh.
    """
    wave = _Wave(assembler.points)
    exact = wave.value(assembler.points.T)
    matrix = assembler.matrix(_gradients)
    load = assembler.load(lambda v, w: wave.source(w.x) * v)
    free = np.flatnonzero(~boundary)
    solution = np.where(boundary, exact, 0.0)
    right_side = (load - matrix @ solution)[free]
    inner, figures, converged = solver.solve(matrix[free][:, free], right_side)
    solution[free] = inner

    def squares(name: str) -> tuple[Any, Any]:
        """Integrands of the squared errors of a field and of its gradient."""

        def value(w: Any) -> Any:
            return (getattr(w, name) - wave.value(w.x)) ** 2

        def gradient(w: Any) -> Any:
            difference = grad(getattr(w, name)) - wave.gradient(w.x)
            return dot(difference, difference)

        return value, gradient

    integrals = assembler.integrals(
        [*squares("zero"), *squares("solution"), squares("exact")[1]],
        zero=np.zeros(len(exact)),
        solution=solution,
        exact=exact,
    )
    value_norm, gradient_norm, value_error, gradient_error, interpolation_error = np.sqrt(integrals)
    figures.update(
        wave_length_mm=2.0 * np.pi / wave.wave_number,
        relative_l2_error=float(value_error / value_norm),
        relative_h1_error=float(gradient_error / gradient_norm),
        best_approximation=float(gradient_error / interpolation_error),
    )
    return figures, converged


def elasticity(assembler: Assembler, volumes: Values, bodies: Labels, solver: Solver) -> tuple[dict[str, Any], bool]:
    """Clamp the organ at one side and pull it by a share of its own weight.

    In the body an organ is carried by what surrounds it. Held at one side alone, soft tissue would
    sag by more than its own size, of which linear theory knows nothing. The solution is
    proportional to the load, hence ``load_share`` of the weight is what moves it by
    :data:`LINEAR_SHARE` of its size (all of it, where that moves it less), and displacement,
    energy, work and reaction are those of this load.

    Parameters
    ----------
    assembler
        The tetrahedra.
    volumes
        Of each tetrahedron, mm^3, shape ``(m,)``.
    bodies
        Body of each tetrahedron, shape ``(m,)``; every body is clamped, all at the same one of the
        six sides along the axes: the one where most of the matter is held.
    solver
        The solver.
    """
    shear = YOUNG / (2.0 * (1.0 + POISSON_RATIO))
    lame = YOUNG * POISSON_RATIO / ((1.0 + POISSON_RATIO) * (1.0 - 2.0 * POISSON_RATIO))
    points, tetrahedra = assembler.points, assembler.tetrahedra
    candidates = [held_at_one_side(tetrahedra, sign * points[:, axis], bodies, CLAMPED_SHARE) for axis, sign in _SIDES]
    best = int(np.argmax([volumes[held].sum() for held in candidates]))
    axis, sign = _SIDES[best]
    fixed = np.zeros(len(points), dtype=bool)
    fixed[tetrahedra[candidates[best]]] = True

    matrix = assembler.elastic_stiffness(shear, lame)
    load = assembler.load(lambda v, _w: sign * WEIGHT * v[axis], vector=True, order=1)
    free = np.flatnonzero(np.repeat(~fixed, 3))
    figures: dict[str, Any] = {
        "young_mpa": YOUNG,
        "poisson_ratio": POISSON_RATIO,
        "weight_n": abs(float(load.sum())),
        "pulled_towards": ("+" if sign > 0 else "-") + "xyz"[axis],
        "clamped_points": int(fixed.sum()),
    }
    if len(free) == 0:
        return {**figures, "unknowns": 0}, True
    inner, solved, converged = solver.solve(matrix[free][:, free], load[free], rigid_motions(points[~fixed]))
    displacement = np.zeros(matrix.shape[0])
    displacement[free] = inner
    size = float(np.linalg.norm(np.ptp(points[tetrahedra].reshape(-1, 3), axis=0)))
    farthest = float(np.linalg.norm(displacement.reshape(-1, 3), axis=1).max())
    share = min(1.0, LINEAR_SHARE * size / farthest) if farthest > 0.0 else 1.0
    displacement, load = share * displacement, share * load
    reaction = (load - matrix @ displacement).reshape(-1, 3)[fixed].sum(axis=0)
    figures.update(
        solved,
        strain_energy_mj=0.5 * float(displacement @ (matrix @ displacement)),
        work_of_weight_mj=float(load @ displacement),
        reaction_n=float(np.linalg.norm(reaction)),
        load_share=share,
        max_displacement_mm=share * farthest,
        displacement_share=share * farthest / size,
    )
    return figures, converged


def _fibres(x: Any, centre: Values, along: Values, radius: float) -> Any:
    """Unit fibre directions: helices from +60 degrees at the axis to -60 outside."""
    out = np.moveaxis(x, 0, -1) - centre
    out -= (out @ along)[..., None] * along
    distance = np.linalg.norm(out, axis=-1, keepdims=True)
    around = np.cross(along, out) / np.maximum(distance, 1e-12 * radius)
    angle = np.radians(60.0 - 120.0 * distance / radius)
    fibre = np.cos(angle) * around + np.sin(angle) * along
    return np.moveaxis(fibre / np.maximum(np.linalg.norm(fibre, axis=-1, keepdims=True), 1e-12), -1, 0)


def conduction(assembler: Assembler, solver: Solver) -> tuple[dict[str, Any], bool]:
    """Find the extracellular potential of a wave front in tissue with fibres.

    div((sigma_i + sigma_e) grad phi) = -div(sigma_i grad V) with no current through the boundary,
    for a front across the middle of the object. The solution is unique up to a constant in each
    connected part.

    Parameters
    ----------
    assembler
        The tetrahedra.
    solver
        The solver.
    """
    points = assembler.points
    centre = points.mean(axis=0)
    along = np.linalg.svd(points - centre, full_matrices=False)[2][0]
    position = (points - centre) @ along
    radius = float(np.sqrt((((points - centre) - position[:, None] * along) ** 2).sum(axis=1).max()))
    width = 0.05 * float(np.ptp(position))

    def tensor(x: Any, which: tuple[float, float]) -> Any:
        fibre = _fibres(x, centre, along, radius)
        lengthwise, across = (1e-3 * value for value in which)  # S/mm
        identity = np.eye(3).reshape(3, 3, *(1,) * (x.ndim - 1))
        return across * identity + (lengthwise - across) * fibre[:, None] * fibre[None, :]

    inner, outer = CONDUCTIVITY["intracellular"], CONDUCTIVITY["extracellular"]
    both = (inner[0] + outer[0], inner[1] + outer[1])

    def flow(u: Any, v: Any, w: Any) -> Any:
        return dot(mul(w.coefficient, grad(u)), grad(v))

    matrix = assembler.matrix(flow, coefficient=lambda x: tensor(x, both))
    membrane = RESTING + 0.5 * RISE * (1.0 - np.tanh(position / width))
    right_side = -(assembler.matrix(flow, coefficient=lambda x: tensor(x, inner)) @ membrane)
    potential, part, figures, converged = solver.solve_floating(matrix, right_side)
    potential -= (np.bincount(part, potential) / np.bincount(part))[part]
    figures.update(
        conductivity_s_per_m={name: list(values) for name, values in CONDUCTIVITY.items()},
        front_width_mm=width,
        potential_range_mv=[float(potential.min()), float(potential.max())],
    )
    return figures, converged
