"""Solve a problem with every installed finite-element program and compare with the exact result.

    tests/solvers.py out/solvers/ball out/solvers/ball-2        # or: make bench-solvers

Takes the folders of two cases of one ball, with linear and with quadratic tetrahedra, exported as
inp, msh, msh2, med and xdmf. Each program solves -lap u = 1 with u = 0 on the boundary part
`surface`, in the file format that it supports. The integral of u over a ball of radius R is
4 pi R^5 / 45. Each program selects the boundary part by its name in the file, so a wrong set, a
wrong tag or a wrong order of nodes changes the result. The table has a row for each program, also
if the program is not installed. The exit code is 1 if the error of a result exceeds the
discretization error.
"""

from __future__ import annotations

import argparse
import json
import math
import re
import shutil
import subprocess
import sys
from pathlib import Path

import meshio
import numpy as np
from skfem import Basis, ElementTetP1, LinearForm, MeshTet, condense, solve
from skfem.models.poisson import laplace
from skfem.quadrature import get_quadrature
from skfem.refdom import RefTet

OFF = {1: 0.04, 2: 0.001}
"""Maximum relative error of the integral, by order.

Edges of 2 mm in a ball of 10.85 mm give 3.4 % and 0.02 %.
"""
NOT_HERE = "not here"

GETDP = """
Group { Vol = Region[1]; Sur = Region[11]; Both = Region[{Vol, Sur}]; }
Constraint { { Name Zero; Case { { Region Sur; Value 0; } } } }
FunctionSpace { { Name H; Type Form0;
  BasisFunction { { Name s; NameOfCoef v; Function BF_Node; Support Both; Entity NodesOf[All]; } }
  Constraint { { NameOfCoef v; EntityType NodesOf; NameOfConstraint Zero; } } } }
Jacobian { { Name J; Case { { Region All; Jacobian Vol; } } } }
Integration { { Name I; Case { { Type Gauss; Case {
  { GeoElement Tetrahedron; NumberOfPoints 15; } { GeoElement Tetrahedron2; NumberOfPoints 15; } } } } } }
Formulation { { Name P; Type FemEquation; Quantity { { Name u; Type Local; NameOfSpace H; } }
  Equation { Integral { [ Dof{d u}, {d u} ]; In Vol; Jacobian J; Integration I; }
             Integral { [ -1, {u} ]; In Vol; Jacobian J; Integration I; } } } }
Resolution { { Name R; System { { Name A; NameOfFormulation P; } } Operation { Generate[A]; Solve[A]; } } }
PostProcessing { { Name Q; NameOfFormulation P;
  Quantity { { Name total; Value { Integral { [ {u} ]; In Vol; Jacobian J; Integration I; } } } } } }
PostOperation { { Name O; NameOfPostProcessing Q; Operation { Print[ total[Vol], OnGlobal, Format Table, File "total.txt"]; } } }
"""

FREEFEM = """
load "gmsh"
load "msh3"
mesh3 T = gmshload3("ball.msh");
fespace V(T, P1);
V u, v;
solve P(u, v, solver=CG, eps=1e-10) = int3d(T, 1)(dx(u)*dx(v) + dy(u)*dy(v) + dz(u)*dz(v)) - int3d(T, 1)(v) + on(11, u=0);
cout.precision(12);
cout << "total " << int3d(T, 1)(u) << endl;
"""

DOLFINX = """
import sys
import ufl
from dolfinx import fem, io
from dolfinx.fem.petsc import LinearProblem
from mpi4py import MPI
from petsc4py.PETSc import ScalarType
name, order = sys.argv[1], int(sys.argv[2])
with io.XDMFFile(MPI.COMM_WORLD, f"{name}.volume.xdmf", "r") as file:
    mesh = file.read_mesh(name="volume")
mesh.topology.create_connectivity(2, 3)
with io.XDMFFile(MPI.COMM_WORLD, f"{name}.volume.boundary.xdmf", "r") as file:
    facets = file.read_meshtags(mesh, name="boundary")
space = (getattr(fem, "functionspace", None) or fem.FunctionSpace)(mesh, ("CG", order))
zero = fem.dirichletbc(ScalarType(0), fem.locate_dofs_topological(space, 2, facets.find(1)), space)
u, v = ufl.TrialFunction(space), ufl.TestFunction(space)
solver = {"ksp_type": "cg", "pc_type": "jacobi", "ksp_rtol": 1e-12}
load = fem.Constant(mesh, ScalarType(1)) * v * ufl.dx
found = LinearProblem(ufl.inner(ufl.grad(u), ufl.grad(v)) * ufl.dx, load, bcs=[zero], petsc_options=solver).solve()
print("total", mesh.comm.allreduce(fem.assemble_scalar(fem.form(found * ufl.dx)).real))
"""

CALCULIX = """*INCLUDE, INPUT=ball.inp
*MATERIAL, NAME=ANY
*CONDUCTIVITY
1.0
*SOLID SECTION, ELSET=REGION_1, MATERIAL=ANY
*STEP
*HEAT TRANSFER, STEADY STATE
*BOUNDARY
SURFACE, 11, 11, 0.0
*DFLUX
REGION_1, BF, 1.0
*NODE PRINT, NSET=EVERY
NT
*END STEP
"""


def called(words: list[str], folder: Path, environment: dict[str, str] | None = None) -> str:
    """Return the output of a program; exit if the program fails."""
    done = subprocess.run(words, cwd=folder, capture_output=True, text=True, check=False, env=environment)
    if done.returncode != 0:
        sys.exit(f"{' '.join(words)}: exit code {done.returncode}\n{done.stdout[-2000:]}{done.stderr[-2000:]}")
    return done.stdout


def total_in(text: str) -> float:
    """Return the last number after `total`."""
    return float(re.findall(r"total\s+(\S+)", text)[-1])


def tetrahedra_of(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Return the points and tetrahedra of an exported file."""
    mesh = meshio.read(path, "gmsh" if path.suffix.startswith(".msh") else None)
    return mesh.points, mesh.cells_dict.get("tetra10", mesh.cells_dict.get("tetra"))


def by_scikit_fem(case: Path, name: str, order: int, _: Path) -> float | str:
    """Solve with scikit-fem and linear elements on the Gmsh 4.1 file, which meshio reads."""
    if order == 2:
        return "tests/test_quadratic.py"
    points, cells = tetrahedra_of(case / f"{name}.volume.msh")
    basis = Basis(MeshTet(points.T, cells.T), ElementTetP1(), intorder=2)
    load = LinearForm(lambda v, _: v).assemble(basis)
    return float(load @ solve(*condense(laplace.assemble(basis), load, D=basis.get_dofs())))


def by_getdp(case: Path, name: str, _: int, work: Path) -> float | str:
    """Solve with GetDP on the Gmsh 2.2 file, the only version that GetDP reads without Gmsh."""
    if shutil.which("getdp") is None:
        return NOT_HERE
    shutil.copy(case / f"{name}.volume.msh2", work / "ball.msh")
    (work / "ball.pro").write_text(GETDP)
    called(["getdp", "ball.pro", "-msh", "ball.msh", "-solve", "R", "-pos", "O"], work)
    return float((work / "total.txt").read_text().split()[-1])


def by_freefem(case: Path, name: str, order: int, work: Path) -> float | str:
    """Solve with FreeFEM on the Gmsh 2.2 file."""
    if shutil.which("FreeFem++-nw") is None:
        return NOT_HERE
    if order == 2:
        return "reads no quadratic elements"
    shutil.copy(case / f"{name}.volume.msh2", work / "ball.msh")
    (work / "ball.edp").write_text(FREEFEM)
    # Debian installs the plugins outside FreeFEM's search path.
    plugins = {"FF_LOADPATH": "/usr/lib/freefem++", "PATH": "/usr/bin:/bin"}
    return total_in(called(["FreeFem++-nw", "-v", "0", "ball.edp"], work, plugins))


def by_dolfinx(case: Path, name: str, order: int, work: Path) -> float | str:
    """Solve with FEniCSx (dolfinx) of the system's Python on the pair of XDMF files."""
    python = "/usr/bin/python3"
    if subprocess.run([python, "-c", "import dolfinx"], capture_output=True, check=False).returncode != 0:
        return NOT_HERE
    (work / "ball.py").write_text(DOLFINX)
    return total_in(called([python, str(work / "ball.py"), name, str(order)], case))


def by_calculix(case: Path, name: str, _: int, work: Path) -> float | str:
    """Solve steady heat conduction with CalculiX; return the integral of the nodal temperatures."""
    if shutil.which("ccx") is None:
        return NOT_HERE
    inp = case / f"{name}.volume.inp"
    points, cells = tetrahedra_of(inp)
    shutil.copy(inp, work / "ball.inp")
    every = f"*NSET, NSET=EVERY, GENERATE\n1, {len(points)}, 1\n"
    (work / "job.inp").write_text(CALCULIX.replace("*MATERIAL", f"{every}*MATERIAL", 1))
    called(["ccx", "job"], work)
    rows = [line.split() for line in (work / "job.dat").read_text().splitlines()]
    table = {int(row[0]): float(row[1]) for row in rows if len(row) == 2 and row[0].isdigit()}
    u = np.array([table[number] for number in range(1, len(points) + 1)])
    return integral(points, cells, u)


def integral(points: np.ndarray, cells: np.ndarray, u: np.ndarray) -> float:
    """Return the integral of nodal values `u` over linear or curved quadratic tetrahedra."""
    places, weights = get_quadrature(RefTet, 5)
    corner = np.vstack([1.0 - places.sum(axis=0), places])
    slope = np.vstack([-np.ones(3), np.eye(3)])
    shapes, slopes = [*corner], [np.tile(slope[i], (len(weights), 1)) for i in range(4)]
    if cells.shape[1] == 10:
        shapes = [a * (2.0 * a - 1.0) for a in corner]
        slopes = [np.outer(4.0 * a - 1.0, s) for a, s in zip(corner, slope, strict=True)]
        for i, j in ((0, 1), (1, 2), (0, 2), (0, 3), (1, 3), (2, 3)):
            shapes.append(4.0 * corner[i] * corner[j])
            slopes.append(4.0 * (np.outer(corner[i], slope[j]) + np.outer(corner[j], slope[i])))
    jacobians = np.einsum("nqd,cne->cqde", np.array(slopes), points[cells])
    values = np.einsum("nq,cn->cq", np.array(shapes), u[cells])
    return float((np.abs(np.linalg.det(jacobians)) * values * weights).sum())


PROGRAMS = {
    "scikit-fem, by meshio": ("msh", by_scikit_fem),
    "CalculiX": ("inp", by_calculix),
    "GetDP": ("msh2", by_getdp),
    "FreeFEM": ("msh2", by_freefem),
    "dolfinx": ("xdmf", by_dolfinx),
}


def main() -> int:
    """Solve the problem and print the table; return 1 if a result is wrong."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("linear", type=Path)
    parser.add_argument("quadratic", type=Path)
    arguments = parser.parse_args()
    cases = {1: arguments.linear.resolve(), 2: arguments.quadratic.resolve()}
    radius = json.loads((cases[1] / f"{cases[1].name}.truth.json").read_text())["dimensions"]["radius"]
    exact = 4.0 * math.pi * radius**5 / 45.0
    print(f"integral of u over a ball of {radius} mm: {exact:.1f} mm^5")
    print("| program | file | linear | quadratic |\n|---|---|---|---|")
    wrong = False
    for program, (kind, solved_by) in PROGRAMS.items():
        words = []
        for order, case in cases.items():
            work = case / f"by-{program.split(',')[0].lower()}"
            work.mkdir(exist_ok=True)
            found = solved_by(case, case.name, order, work)
            if isinstance(found, str):
                words.append(found)
                continue
            off = found / exact - 1.0
            wrong |= abs(off) > OFF[order]
            words.append(f"{found:.1f} ({100.0 * off:+.3f} %)")
        print(f"| {program} | {kind} | {' | '.join(words)} |", flush=True)
    return int(wrong)


if __name__ == "__main__":
    sys.exit(main())
