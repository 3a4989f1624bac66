"""Tests of the problems solved on the tetrahedra: known solutions, and limits."""

from __future__ import annotations

import json
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from conftest import Run, ball, quiet_context
from isoparticles._native import Context
from scipy.sparse import diags
from skfem import Basis, ElementTetP1, ElementVector, MeshTet
from skfem.models.elasticity import linear_elasticity

from tetmesh_check.cli import build_parser, main
from tetmesh_check.fem import assembly, problems, solve, solver
from tetmesh_check.fem.assembly import elastic_stiffness, in_blocks, linear_elements
from tetmesh_check.fem.problems import WEIGHT, conduction, held_at_one_side
from tetmesh_check.fem.solve import VolumeMesh, solve_on
from tetmesh_check.fem.solver import TOLERANCE, rigid_motions
from tetmesh_check.quality import signed_tetrahedron_volumes
from tetmesh_check.topology import tetrahedron_boundary

FOREVER = float("inf")


def block(counts: tuple[int, int, int], size: float = 1.0) -> tuple[np.ndarray, np.ndarray]:
    """Return a block of cubes of six tetrahedra each (Kuhn), with a corner at the origin."""
    nx, ny, nz = counts
    grid = np.stack(np.meshgrid(*(np.arange(n + 1) for n in counts), indexing="ij"), -1).reshape(-1, 3)
    number = np.arange(len(grid)).reshape(nx + 1, ny + 1, nz + 1)
    corner = np.stack(np.meshgrid(*(np.arange(n) for n in counts), indexing="ij"), -1).reshape(-1, 3)
    cells = []
    for order in ((0, 1, 2), (0, 2, 1), (1, 0, 2), (1, 2, 0), (2, 0, 1), (2, 1, 0)):
        path = [corner]
        for axis in order:
            path.append(path[-1] + np.eye(3, dtype=np.int64)[axis])
        cells.append(np.stack([number[tuple(p.T)] for p in path], 1))
    tetrahedra = np.concatenate(cells)
    points = size * grid.astype(np.float64)
    negative = signed_tetrahedron_volumes(points, tetrahedra) < 0
    tetrahedra[negative] = tetrahedra[negative][:, [0, 2, 1, 3]]
    return points, tetrahedra


def copies(part: tuple[np.ndarray, np.ndarray], count: int) -> tuple[np.ndarray, np.ndarray]:
    """Return copies of a body in a row, 1 mm apart."""
    points, cells = part
    step = np.array([0.0, float(np.ptp(points[:, 1])) + 1.0, 0.0])
    return (
        np.concatenate([points + k * step for k in range(count)]),
        np.concatenate([cells + k * len(points) for k in range(count)]),
    )


def elements(points: np.ndarray, tetrahedra: np.ndarray) -> MeshTet:
    """Return tetrahedra as scikit-fem has them."""
    return MeshTet(np.ascontiguousarray(points.T), np.ascontiguousarray(tetrahedra.T))


def poisson(points: np.ndarray, tetrahedra: np.ndarray) -> dict:
    return problems.poisson(elements(points, tetrahedra), tetrahedron_boundary(tetrahedra).triangles, FOREVER)


def elasticity(points: np.ndarray, tetrahedra: np.ndarray) -> dict:
    figures = problems.elasticity(elements(points, tetrahedra), tetrahedron_boundary(tetrahedra).bodies, FOREVER)
    assert figures["unknowns"] == 0 or figures["multigrid"]["converged"]
    return figures


def mesh_of(points: np.ndarray, tetrahedra: np.ndarray) -> VolumeMesh:
    volumes = signed_tetrahedron_volumes(points, tetrahedra)
    return VolumeMesh(points, tetrahedra, volumes, tetrahedron_boundary(tetrahedra))


def test_runs_end_where_they_must(monkeypatch: pytest.MonkeyPatch) -> None:
    stiff = diags(np.linspace(1.0, 1e6, 50)).tocsr()
    monkeypatch.setattr(solver, "multigrid", lambda matrix, _near_null: diags(1.0 / matrix.diagonal()))
    solution, figures = solver.solve(stiff, np.ones(50), FOREVER)
    np.testing.assert_allclose(solution, 1.0 / stiff.diagonal(), rtol=1e-9)
    assert figures["multigrid"]["converged"]
    assert figures["multigrid"]["iterations"] <= 2
    monkeypatch.setattr(solver, "multigrid", lambda *_words: None)
    monkeypatch.setattr(solver, "MAX_ITERATIONS", 5)
    few = solver.solve(stiff, np.ones(50), FOREVER)[1]["multigrid"]
    assert (few["converged"], few["iterations"]) == (False, 5)
    assert solver.solve(stiff, np.zeros(50), FOREVER)[1]["multigrid"]["converged"]
    # the time limit is reached during the iteration
    clock = iter(range(100))
    monkeypatch.setattr(time, "monotonic", lambda: float(next(clock)))
    with pytest.raises(TimeoutError):
        solver.solve(stiff, np.ones(50), 4.5)


@pytest.mark.parametrize("entry", [-1.0, float("nan"), float("inf")])
def test_a_wrong_preconditioner_is_noticed(entry: float, monkeypatch: pytest.MonkeyPatch) -> None:
    matrix = diags(np.linspace(1.0, 9.0, 50)).tocsr()
    monkeypatch.setattr(solver, "multigrid", lambda *_words: diags(np.r_[entry, np.full(49, -1.0)]))
    monkeypatch.setattr(solver, "MAX_ITERATIONS", 20)
    figures = solver.solve(matrix, np.ones(50), FOREVER)[1]["multigrid"]
    assert figures["residual"] is None or np.isfinite(figures["residual"])
    assert figures["converged"] == (figures["residual"] is not None and figures["residual"] <= TOLERANCE)


def test_flat_tetrahedra_do_not_hide_the_error() -> None:
    """A chain of springs from 1 to 0. The first one is stiff, like a flat tetrahedron."""
    count, stiff = 200, 1e7
    springs = np.ones(count + 1)
    springs[0] = stiff
    matrix = diags([-springs[1:-1], springs[:-1] + springs[1:], -springs[1:-1]], [-1, 0, 1]).tocsr()
    right_side = np.zeros(count)
    right_side[0] = stiff
    truth = np.linalg.solve(matrix.toarray(), right_side)
    energy = float(springs @ np.diff([1.0, *truth, 0.0]) ** 2)
    solution, figures = solver.solve(matrix, right_side, FOREVER)
    assert figures["multigrid"]["converged"]
    left = solution - truth
    assert np.sqrt((left @ (matrix @ left)) / energy) < 1e-2


def test_blocks_give_the_same_errors(monkeypatch: pytest.MonkeyPatch) -> None:
    mesh = block((4, 3, 3))
    whole = poisson(*mesh)
    monkeypatch.setattr(assembly, "BLOCK", 37)
    parts = poisson(*mesh)
    for name in ("relative_l2_error", "relative_h1_error", "best_approximation"):
        assert parts[name] == pytest.approx(whole[name], rel=1e-9)


def test_the_elastic_stiffness_is_that_of_vector_elements() -> None:
    points, cells = block((4, 3, 3))
    mesh = elements(points + 0.1 * np.sin(points[:, [1, 2, 0]]), cells)
    basis = Basis(mesh, ElementVector(ElementTetP1()), intorder=1)
    truth = linear_elasticity(0.3, 0.7).assemble(basis).toarray()
    made = elastic_stiffness(linear_elements(mesh), 0.7, 0.3).toarray()
    np.testing.assert_allclose(made, truth, rtol=0, atol=1e-13)


def test_squared_errors_are_integrated_exactly() -> None:
    points, cells = block((2, 2, 2), 0.5)
    # the integral of x^4 over the unit cube; the square of a quadratic error has the same degree
    integral = sum(
        (basis.dx * (basis.interpolate(points[own, 0]) * basis.global_coordinates()[0]) ** 2).sum()
        for own, basis in in_blocks(elements(points, cells), problems.ERROR_ORDER)
    )
    assert integral == pytest.approx(0.2, rel=1e-12)


def test_poisson_is_second_order_and_the_best_there_is() -> None:
    errors = []
    for count in (12, 24):
        points, cells = block((count,) * 3, 24.0 / count)
        figures = poisson(points, cells)
        assert figures["multigrid"]["converged"]
        # by Cea's lemma, the gradient error of the solution is at most that of the interpolated
        # exact solution, except for quadrature errors
        assert 0.5 < figures["best_approximation"] < 1.02
        errors.append((figures["relative_l2_error"], figures["relative_h1_error"]))
    orders = np.log2(np.array(errors[0]) / np.array(errors[1]))
    assert orders == pytest.approx([2.0, 1.0], rel=0.1)


def test_a_hanging_column_stretches_as_it_must(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(problems, "_SIDES", ((2, 1.0),))
    monkeypatch.setattr(problems, "POISSON_RATIO", 0.0)
    figures = elasticity(*block((2, 2, 20)))
    assert figures["pulled_towards"] == "+z"
    assert figures["weight_n"] == pytest.approx(WEIGHT * 80.0)
    assert figures["reaction_n"] == pytest.approx(figures["weight_n"], rel=1e-6)
    assert figures["strain_energy_mj"] == pytest.approx(0.5 * figures["work_of_weight_mj"], rel=1e-6)
    # Tetrahedra with a vertex in the lower tenth (2 mm) are clamped. They extend to z = 3 mm, so
    # the free length is 17 mm.
    exact = WEIGHT**2 * 4.0 * 17.0**3 / (3.0 * problems.YOUNG)
    assert 0.97 * exact < figures["work_of_weight_mj"] < exact
    assert figures["max_displacement_mm"] == pytest.approx(WEIGHT * 17.0**2 / (2.0 * problems.YOUNG), rel=0.05)
    assert figures["load_share"] == 1.0
    assert figures["displacement_share"] == pytest.approx(figures["max_displacement_mm"] / np.sqrt(4.0 + 4.0 + 400.0))


def test_soft_tissue_hangs_by_as_much_of_its_weight_as_linear_theory_bears(monkeypatch: pytest.MonkeyPatch) -> None:
    column = block((2, 2, 20))
    stiff = elasticity(*column)
    monkeypatch.setattr(problems, "YOUNG", 1e-4 * problems.YOUNG)
    soft = elasticity(*column)
    assert stiff["load_share"] == 1.0
    assert soft["displacement_share"] == pytest.approx(problems.LINEAR_SHARE)
    # the displacement is proportional to the load divided by the stiffness
    assert soft["load_share"] * 1e4 * stiff["displacement_share"] == pytest.approx(problems.LINEAR_SHARE, rel=1e-5)
    assert soft["weight_n"] == pytest.approx(stiff["weight_n"])
    assert soft["reaction_n"] == pytest.approx(soft["load_share"] * soft["weight_n"], rel=1e-6)
    assert soft["strain_energy_mj"] == pytest.approx(0.5 * soft["work_of_weight_mj"], rel=1e-6)


def test_the_side_with_most_matter_is_clamped() -> None:
    assert elasticity(*block((20, 2, 3)))["pulled_towards"][1] == "y"


def test_a_column_held_at_its_end() -> None:
    points, cells = block((1, 1, 20))
    held = held_at_one_side(cells, points[:, 2], np.zeros(len(cells), dtype=np.int64), 0.1)
    assert set(points[cells[held]][..., 2].ravel()) == {0.0, 1.0, 2.0, 3.0}
    # each of several bodies is clamped
    two = np.concatenate([cells, cells + len(points)])
    both = np.concatenate([points, points + np.array([5.0, 0.0, 100.0])])
    bodies = np.repeat([0, 1], len(cells))
    assert held_at_one_side(two, both[:, 2], bodies, 0.1).sum() == 2 * held.sum()
    assert elasticity(both, two)["weight_n"] == pytest.approx(WEIGHT * 40.0)


def test_conduction_follows_the_membrane_where_the_fibres_are_equal(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(
        "tetmesh_check.fem.problems.CONDUCTIVITY", {"intracellular": (0.2, 0.2), "extracellular": (0.6, 0.6)}
    )
    tensors: list[int] = []
    fibres = problems._fibres
    monkeypatch.setattr(problems, "_fibres", lambda *words: (tensors.append(1), fibres(*words))[1])
    points, cells = block((16, 3, 3))
    apart = np.concatenate([points, points + np.array([0.0, 6.0, 0.0])])
    figures = conduction(elements(apart, np.concatenate([cells, cells + len(points)])), FOREVER)
    assert figures["multigrid"]["converged"]
    assert figures["parts"] == 2
    # tensors are computed once, not once per pair of basis functions
    assert len(tensors) == 1
    low, high = figures["potential_range_mv"]
    # the potential is -sigma_i / (sigma_i + sigma_e) times the membrane potential plus a constant,
    # so its range is a quarter of 100 mV
    assert high - low == pytest.approx(25.0, rel=0.02)


@pytest.mark.parametrize(("size", "count"), [((2, 2, 2), 200), ((1, 1, 1), 250)])
def test_conduction_in_many_bodies(size: tuple[int, int, int], count: int) -> None:
    figures = conduction(elements(*copies(block(size), count)), FOREVER)
    assert figures["multigrid"]["converged"]
    assert figures["parts"] == count
    # if a part is not grounded, the iteration stagnates: measured after 4 steps for blocks of the
    # first size, and after 2 steps for the second size
    assert figures["multigrid"]["iterations"] <= 20


@pytest.mark.parametrize(
    ("mode", "reason"),
    [("no", "--solve no"), ("auto", "more than the default limit of 100"), ("yes", "not finished within")],
)
def test_bounds(mode: str, reason: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(solve, "AUTO_MAX_TETRAHEDRA", 100)
    context = quiet_context()
    checks, _ = solve_on(mesh_of(*block((3, 3, 3))), mode, 1e-9, context)
    assert context.results["solve"]["done"] is False
    assert reason in context.results["solve"]["reason"]
    assert checks == []
    assert bool(context.warnings) == (mode == "yes")
    if mode == "yes":
        assert "no problem was solved, and none was checked" in context.warnings[0]


def test_multigrid_is_not_set_up_when_time_is_over(monkeypatch: pytest.MonkeyPatch) -> None:
    set_up: list[int] = []
    monkeypatch.setattr(solver, "multigrid", lambda *_words: set_up.append(1))
    matrix = diags(np.linspace(1.0, 9.0, 50)).tocsr()
    with pytest.raises(TimeoutError):
        solver.solve(matrix, np.ones(50), time.monotonic() - 1.0)
    assert not set_up
    solver.solve(matrix, np.ones(50), time.monotonic() + 1000.0)
    assert set_up


def test_rigid_motions_cost_no_energy() -> None:
    points, cells = block((4, 3, 3))
    points = points + 0.1 * np.sin(points[:, [1, 2, 0]])
    matrix = elastic_stiffness(linear_elements(elements(points, cells)), 0.7, 0.3)
    motions = rigid_motions(points)
    assert np.abs(matrix @ motions).max() < 1e-13
    assert np.linalg.matrix_rank(motions) == 6


def test_multigrid_hardly_minds_the_number_of_unknowns() -> None:
    iterations: list[int] = []
    drawn = np.random.get_state()[1].copy()  # noqa: NPY002
    for count in (8, 16):
        iterations.append(elasticity(*block((count,) * 3, 16.0 / count))["multigrid"]["iterations"])
    assert max(iterations) <= 20
    assert iterations[1] < 1.5 * iterations[0]
    np.testing.assert_array_equal(np.random.get_state()[1], drawn)  # noqa: NPY002


def test_a_mesh_without_points_inside() -> None:
    context = quiet_context()
    assert [check.passed for check in solve_on(mesh_of(*block((1, 1, 1))), "auto", 600.0, context)[0]] == [True]
    assert context.results["solve"]["poisson"]["unknowns"] == 0


def test_a_mesh_that_does_not_converge_is_not_fit(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(solver, "MAX_ITERATIONS", 1)
    monkeypatch.setattr(solver, "COARSEST", 2)
    checks, _ = solve_on(mesh_of(*block((4, 4, 4))), "auto", 600.0, quiet_context())
    verdicts = {check.name: check for check in checks}
    assert not verdicts["solve_converged"].passed
    assert verdicts["solve_converged"].required
    words = verdicts["solve_converged"].words
    assert "solved 0 of 3 problems; not solved: poisson, conduction, elasticity, because" in words


def test_what_cannot_be_solved_does_not_take_the_rest_with_it(monkeypatch: pytest.MonkeyPatch) -> None:
    def too_large(*_: object) -> None:
        raise MemoryError

    monkeypatch.setattr(problems, "elasticity", too_large)
    context = quiet_context()
    checks, _ = solve_on(mesh_of(*block((4, 4, 4))), "auto", 600.0, context)
    assert [check.passed for check in checks] == [True]
    assert context.results["solve"]["reason"] == "elasticity: not enough memory"
    assert "elasticity: not enough memory" in context.warnings[0]
    assert {"poisson", "conduction"} <= set(context.results["solve"])


def test_a_wrong_solution_is_not_the_best_there_is(monkeypatch: pytest.MonkeyPatch) -> None:
    # a source that does not match the exact solution
    wave = problems._Wave
    monkeypatch.setattr(wave, "source", lambda self, x: 0.5 * self.wave_number**2 * self.value(x))
    assert poisson(*block((8, 8, 8)))["best_approximation"] > 1.1


def test_nothing_is_solved_on_inverted_tetrahedra() -> None:
    points, cells = block((3, 3, 3))
    cells[5] = cells[5][[0, 2, 1, 3]]
    context = quiet_context()
    assert solve_on(mesh_of(points, cells), "auto", 600.0, context)[0] == []
    assert "inverted" in context.results["solve"]["reason"]


def test_solve_from_the_command_line(tmp_path: Path, run: Run) -> None:
    ball(subdivisions=3).save(tmp_path / "ball.vtp")
    done = run("ball.vtp", "-o", "ball.vtu", "--max-passes", 3, "--solve", "yes", "--report", "r.json")
    assert done.returncode == 0, done.stderr
    assert "CG iterations" in done.stderr
    solved = json.loads((tmp_path / "r.json").read_text())["results"]["solve"]
    assert solved["done"] is True
    for name in ("poisson", "conduction", "elasticity"):
        assert solved[name]["multigrid"]["converged"]
        assert solved[name]["multigrid"]["iterations"] <= 40
        assert solved[name]["multigrid"]["residual"] < 1e-9
    skipped = run("ball.vtp", "-o", "b.vtu", "--max-passes", 3, "--solve", "no", "--report", "n.json", "-q")
    assert skipped.returncode == 0
    assert json.loads((tmp_path / "n.json").read_text())["results"]["solve"]["done"] is False


@pytest.mark.parametrize(("module", "package"), [("skfem", "scikit-fem"), ("pyamg", "PyAMG")])
def test_without_the_extra_fem(
    module: str, package: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, module, None)
    words = ["s.vtp", "-o", str(tmp_path / "v.vtu")]
    context = Context(words, build_parser().parse_args(words))
    assert solve_on(mesh_of(*block((1, 1, 1))), "auto", 600.0, context)[0] == []
    reason = f"{package}: not installed (python -m pip install scikit-fem pyamg)"
    assert capfd.readouterr().err == f"no problem is solved: {reason}\n"
    assert context.results["solve"] == {"done": False, "reason": reason}
    for more in (("--solve", "yes"), ("--source", "heart=1,0,0")):
        assert main([*words, *more]) == 2
        told = capfd.readouterr().err
        assert f"error: {package}: not installed" in told
        assert "what to do: python -m pip install scikit-fem pyamg" in told
