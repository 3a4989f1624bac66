"""Three test problems with linear elements.

Poisson's equation with a known solution shows whether the mesh approximates it as expected. Linear
elasticity and the conduction of currents in anisotropic tissue (the elliptic half of the bidomain
equations, Keener and Sneyd, "Mathematical Physiology", 2009, chapter 12) show whether a solver
converges fast on the mesh.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from skfem import BilinearForm, LinearForm, MeshTet, condense
from skfem.helpers import dot, grad, mul
from skfem.models.poisson import laplace, unit_load

from tetmesh_check.fem.assembly import elastic_stiffness, in_blocks, linear_elements
from tetmesh_check.fem.solver import rigid_motions, solve, solve_floating
from tetmesh_check.quality import Cells, Labels, Values

DATA_ORDER = 3
"""Quadrature order of loads."""
ERROR_ORDER = 4
"""Quadrature order of squared errors. To leading order, the error of linear elements is a quadratic
polynomial."""
YOUNG = 0.01
"""Young's modulus, N/mm^2 (10 kPa, soft tissue)."""
POISSON_RATIO = 0.4
WEIGHT = 1060.0e-9 * 9.81
"""Weight of muscle, N/mm^3."""
LINEAR_SHARE = 0.01
"""Maximum displacement for linear elasticity, relative to the diagonal of the bounding box. The
rotations that it neglects are of second order, here 1e-4."""
CLAMPED_SHARE = 0.1
"""Share of the length of each body that is clamped."""
_SIDES = tuple((axis, sign) for axis in range(3) for sign in (1.0, -1.0))
CONDUCTIVITY = {"intracellular": (0.174, 0.0193), "extracellular": (0.625, 0.236)}
"""Along and across the fibres, S/m (Roth 1997, after Clerc 1976)."""
RESTING, RISE = -80.0, 100.0
"""Transmembrane potential ahead of the wave front, and its rise behind it, mV."""


class _Wave:
    """A product of sines with one period along the longest side, and its derivatives."""

    def __init__(self, points: Values) -> None:
        low, high = points.min(axis=1), points.max(axis=1)
        self.wave_number = 2.0 * np.pi / float((high - low).max())
        self._low = low

    def _angles(self, x: Any) -> Any:
        return (self.wave_number * (x.T - self._low) + np.array([1.0, 2.0, 3.0])).T

    def value(self, x: Any) -> Any:
        return np.prod(np.sin(self._angles(x)), axis=0)

    def gradient(self, x: Any) -> Any:
        sines, cosines = np.sin(self._angles(x)), np.cos(self._angles(x))
        products = [cosines[k] * sines[(k + 1) % 3] * sines[(k + 2) % 3] for k in range(3)]
        return self.wave_number * np.stack(products)

    def source(self, x: Any) -> Any:
        return 3.0 * self.wave_number**2 * self.value(x)

    def errors(self, mesh: MeshTet, fields: list[Values]) -> Values:
        """Return the L2 norms of the errors of each field and its gradient, ``(len(fields), 2)``.

        This is short, so the time limit does not apply.
        """
        squares = np.zeros((len(fields), 2))
        for points, basis in in_blocks(mesh, ERROR_ORDER):
            x = np.asarray(basis.global_coordinates())
            value, gradient = self.value(x), self.gradient(x)
            for number, field in enumerate(fields):
                found = basis.interpolate(field[points])
                squares[number, 0] += np.sum(basis.dx * (found - value) ** 2)
                squares[number, 1] += np.sum(basis.dx * (found.grad - gradient) ** 2)
        return np.sqrt(squares)


def poisson(mesh: MeshTet, outside: Cells, deadline: float) -> dict[str, Any]:
    """Solve Poisson's equation with a known solution, which is given on the boundary.

    Parameters
    ----------
    mesh
        The tetrahedra.
    outside
        Triangles of their boundary, shape ``(k, 3)``.
    deadline
        Time limit by the monotonic clock, s.

    Returns
    -------
    dict
        Results. ``best_approximation`` is the error of the gradient over that of the interpolated
        exact solution. By Cea's lemma, it is at most 1 on any mesh, except for the quadrature of
        the load. It checks the solution, not the mesh.
    """
    wave = _Wave(mesh.p)
    exact = wave.value(mesh.p)
    form = LinearForm(lambda v, w: wave.source(w.x) * v)
    load = np.zeros_like(exact)
    for points, basis in in_blocks(mesh, DATA_ORDER):
        load[points] += form.assemble(basis)
    matrix = laplace.assemble(linear_elements(mesh))
    matrix, load, _, free = condense(matrix, load, x=exact, D=np.unique(outside))
    solution = exact.copy()
    solution[free], figures = solve(matrix, load, deadline)
    (value_norm, gradient_norm), (value_error, gradient_error), (_, interpolation_error) = wave.errors(
        mesh, [np.zeros_like(exact), solution, exact]
    )
    return {
        **figures,
        "wave_length_mm": 2.0 * np.pi / wave.wave_number,
        "relative_l2_error": float(value_error / value_norm),
        "relative_h1_error": float(gradient_error / gradient_norm),
        "best_approximation": float(gradient_error / interpolation_error),
    }


def held_at_one_side(tetrahedra: Cells, heights: Values, bodies: Labels, share: float) -> NDArray[np.bool_]:
    """Mark the tetrahedra at the lower end of each body; shape ``(m,)``.

    Parameters
    ----------
    tetrahedra
        Vertex indices, shape ``(m, 4)``.
    heights
        Height of each point, mm, shape ``(n,)``.
    bodies
        Body of each tetrahedron, shape ``(m,)``, numbered from 0.
    share
        Tetrahedra with a vertex in this share of the height of their body are marked.
    """
    lowest, every = heights[tetrahedra].min(axis=1), np.arange(bodies.max() + 1)
    low = ndimage.minimum(lowest, bodies, every)
    high = ndimage.maximum(heights[tetrahedra].max(axis=1), bodies, every)
    held: NDArray[np.bool_] = lowest <= (low + share * (high - low))[bodies]
    return held


def elasticity(mesh: MeshTet, bodies: Labels, deadline: float) -> dict[str, Any]:
    """Clamp the organ at one side and load it with a share of its own weight.

    In the body, an organ is supported by its surroundings. Clamped at one side only, soft tissue
    would sag by more than its own size, where linear elasticity does not hold. The solution is
    proportional to the load. So the load is the share ``load_share`` of the weight, at most 1, that
    moves the organ by :data:`LINEAR_SHARE` of its size. Displacement, energy, work and reaction are
    those of this load.

    Parameters
    ----------
    mesh
        The tetrahedra.
    bodies
        Body of each tetrahedron, shape ``(m,)``. All bodies are clamped at the same of the six
        sides along the axes: the one with the largest clamped volume.
    deadline
        Time limit by the monotonic clock, s.
    """
    shear = YOUNG / (2.0 * (1.0 + POISSON_RATIO))
    lame = YOUNG * POISSON_RATIO / ((1.0 + POISSON_RATIO) * (1.0 - 2.0 * POISSON_RATIO))
    points, tetrahedra, basis = mesh.p.T, mesh.t.T, linear_elements(mesh)
    sides = {
        (axis, sign): held_at_one_side(tetrahedra, sign * points[:, axis], bodies, CLAMPED_SHARE)
        for axis, sign in _SIDES
    }
    axis, sign = max(sides, key=lambda side: basis.dx[sides[side]].sum())
    fixed = np.zeros(len(points), dtype=bool)
    fixed[tetrahedra[sides[axis, sign]]] = True

    matrix = elastic_stiffness(basis, shear, lame).tocsr()
    load = np.outer(unit_load.assemble(basis), sign * WEIGHT * np.eye(3)[axis]).ravel()
    figures: dict[str, Any] = {
        "young_mpa": YOUNG,
        "poisson_ratio": POISSON_RATIO,
        "weight_n": abs(float(load.sum())),
        "pulled_towards": ("+" if sign > 0 else "-") + "xyz"[axis],
        "clamped_points": int(fixed.sum()),
    }
    if fixed.all():
        return {**figures, "unknowns": 0}
    inner, pull, displacement, free = condense(matrix, load, I=np.flatnonzero(np.repeat(~fixed, 3)))
    displacement[free], solved = solve(inner, pull, deadline, rigid_motions(points[~fixed]))
    size = float(np.linalg.norm(np.ptp(points, axis=0)))
    farthest = float(np.linalg.norm(displacement.reshape(-1, 3), axis=1).max())
    share = min(1.0, LINEAR_SHARE * size / farthest) if farthest > 0.0 else 1.0
    displacement, load = share * displacement, share * load
    inside = matrix @ displacement
    reaction = (load - inside).reshape(-1, 3)[fixed].sum(axis=0)
    return {
        **figures,
        **solved,
        "strain_energy_mj": 0.5 * float(displacement @ inside),
        "work_of_weight_mj": float(load @ displacement),
        "reaction_n": float(np.linalg.norm(reaction)),
        "load_share": share,
        "max_displacement_mm": share * farthest,
        "displacement_share": share * farthest / size,
    }


def _fibres(x: Any, centre: Values, along: Values, radius: float) -> Any:
    """Return unit fibre directions: helices from +60 degrees at the axis to -60 outside."""
    out = np.moveaxis(x, 0, -1) - centre
    out -= (out @ along)[..., None] * along
    distance = np.linalg.norm(out, axis=-1, keepdims=True)
    around = np.cross(along, out) / np.maximum(distance, 1e-12 * radius)
    angle = np.radians(60.0 - 120.0 * distance / radius)
    fibre = np.cos(angle) * around + np.sin(angle) * along
    return np.moveaxis(fibre / np.maximum(np.linalg.norm(fibre, axis=-1, keepdims=True), 1e-12), -1, 0)


def conduction(mesh: MeshTet, deadline: float) -> dict[str, Any]:
    """Find the extracellular potential of a wave front in tissue with fibres.

    div((sigma_i + sigma_e) grad phi) = -div(sigma_i grad V) with no current through the boundary,
    for a front across the middle of the object. The solution is unique up to a constant in each
    connected part.

    Parameters
    ----------
    mesh
        The tetrahedra.
    deadline
        Time limit by the monotonic clock, s.
    """
    points, basis = mesh.p.T, linear_elements(mesh)
    centre = points.mean(axis=0)
    along = np.linalg.svd(points - centre, full_matrices=False)[2][0]
    position = (points - centre) @ along
    radius = float(np.sqrt((((points - centre) - position[:, None] * along) ** 2).sum(axis=1).max()))
    width = 0.05 * float(np.ptp(position))

    fibre = _fibres(np.asarray(basis.global_coordinates()), centre, along, radius)
    lengthwise = fibre[:, None] * fibre[None, :]
    across = np.eye(3)[:, :, None, None] - lengthwise
    # S/mm
    inner, outer = (1e-3 * (sigma[0] * lengthwise + sigma[1] * across) for sigma in CONDUCTIVITY.values())
    membrane = RESTING + 0.5 * RISE * (1.0 - np.tanh(position / width))
    flow = BilinearForm(lambda u, v, w: dot(mul(w.sigma, grad(u)), grad(v)))
    driven = LinearForm(lambda v, w: -dot(mul(w.sigma, grad(w.membrane)), grad(v)))
    matrix = flow.assemble(basis, sigma=inner + outer)
    right_side = driven.assemble(basis, sigma=inner, membrane=membrane)
    potential, part, figures = solve_floating(matrix, right_side, deadline)
    potential -= (np.bincount(part, potential) / np.bincount(part))[part]
    return {
        **figures,
        "conductivity_s_per_m": {name: list(values) for name, values in CONDUCTIVITY.items()},
        "front_width_mm": width,
        "potential_range_mv": [float(potential.min()), float(potential.max())],
    }
