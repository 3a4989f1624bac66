"""The command line of ``tetmesh-check``."""

from __future__ import annotations

import argparse
import json
import math
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from tetmesh_check import __version__, command_line
from tetmesh_check.context import TOOL, CommonArguments, Context, Interruptible, canonical_command_line
from tetmesh_check.errors import StageError, unexpected
from tetmesh_check.files import check_report, refuse_existing, same_file
from tetmesh_check.memory import number_of_bytes
from tetmesh_check.parsing import Parser, formats, named_number, number, source_of_current, whole

if TYPE_CHECKING:
    from tetmesh_check.arguments import Arguments

_DESCRIPTION = """\
Fills a closed triangle surface with tetrahedra and checks whether they are fit for simulation.

The edge length of the tetrahedra follows the size field h of sizefield, the target edge length of
the surface (section 3.3 of the paper). Inside the object, h grows away from thin places at the rate
--delta of sizefield. Lengths are in the unit of the volume (mm), angles in degrees.
"""
_METHOD = """\
  --method  surface                      time               result
  ftetwild  moves within --envelope      minutes to hours   best shape; varies from run to run
  hxt       keeps its triangles          seconds            Gmsh, GPL; reproducible
  tetgen    keeps its triangles          seconds            AGPL, installed by hand; uses only the
                                                            largest h
  auto      Many materials: hxt. One object: ftetwild up to 5,000 vertices, hxt above and with
            --order 2. If hxt is missing or fails: ftetwild. If hxt misses a limit of shape on at
            most 20,000 vertices: ftetwild as well, and the better mesh is kept.
"""
_SOLVE = """\
Test problems that are solved on the tetrahedra with linear elements (scikit-fem) and conjugate
gradients with multigrid (PyAMG): Poisson's equation with a known solution, the potential of an
excitation wave in tissue with fibres, and an elastic organ under its own weight.
"""
_MANY = """\
A surface of many materials is filled in one run by Gmsh; materials share the triangles between
them. With --source, the potential of its current is also computed, and the balance of currents is
checked for each material.
"""
_EPILOG = """\
exit codes:
  0    the mesh was written, and every check passed
  1    the mesh was written, but a check failed
  2    bad usage, bad input or an error of the program; no mesh was written
  130  interrupted
The mesh is written before the test problems are solved. It is kept if a later step fails or is
interrupted.

example:
  tetmesh-check heart.surface.vtp --sizefield heart.sizefield.vti -o heart.volume.vtu \\
      --report heart.report.json --pictures pictures
"""


def build_parser() -> argparse.ArgumentParser:
    """Build the parser of the command line."""
    parser = Parser(
        prog=TOOL,
        description=_DESCRIPTION,
        epilog=_EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        add_help=False,
        allow_abbrev=False,
    )
    positive = number(0.0, math.inf, low_allowed=False)

    files = parser.add_argument_group("Files")
    files.add_argument(
        "surface",
        metavar="SURFACE.vtp",
        type=Path,
        help="closed triangle surface whose normals point outward (.vtp, .ply, .stl, .obj)",
    )
    files.add_argument(
        "-o",
        "--output",
        metavar="VOLUME.vtu",
        type=Path,
        required=True,
        help="volume mesh to write. The log of the tetrahedralizer is NAME.tetrahedra.log beside it",
    )
    files.add_argument(
        "--sizefield",
        metavar="S.vti",
        type=Path,
        help="size field h, mm. Without it, all tetrahedra get the median edge length of the surface",
    )
    files.add_argument(
        "--labels-volume",
        metavar="L.nrrd",
        type=Path,
        help="label volume in any format that distfield reads. The region of each tetrahedron is the meshed label at its "
        "centroid",
    )
    files.add_argument(
        "--export",
        metavar="LIST",
        type=formats,
        default=(),
        help="also write the mesh in these formats, separated by commas: inp (Abaqus, CalculiX), msh (Gmsh 4.1), msh2 (Gmsh "
        "2.2: GetDP, FreeFEM), med (Salome, Code_Aster), xdmf (FEniCS), vtk (legacy), feb (FEBio), carp (openCARP), "
        "simvascular, vtp (the boundary). Regions and parts of the boundary become sets or groups",
    )
    files.add_argument(
        "--unit",
        choices=["mm", "m", "um"],
        default="mm",
        help="unit of the coordinates in exported files (default: %(default)s). carp files are always in micrometres",
    )
    files.add_argument(
        "--distfield",
        metavar="F.vti",
        type=Path,
        help="distance field F whose zero set is the surface, mm. --order 2 needs it",
    )
    files.add_argument(
        "--pictures",
        metavar="DIR",
        type=Path,
        help="folder for pictures (PNG): surface, close-up, cut and histograms",
    )

    method = parser.add_argument_group("Method", _METHOD)
    method.add_argument(
        "--method",
        choices=["auto", "ftetwild", "hxt", "tetgen"],
        default="auto",
        help="tetrahedralizer; see the table above (default auto)",
    )
    method.add_argument(
        "--order",
        type=int,
        choices=[1, 2],
        default=1,
        help="order of the elements (default 1). 2 also writes NAME.volume.quadratic.vtu, and --export writes this mesh. It has a "
        "node on each edge: on F = 0 for edges of the surface, otherwise at the midpoint. A node that would fold an element is "
        "moved towards the midpoint",
    )
    method.add_argument(
        "--tet-size-factor",
        metavar="X",
        type=number(0.1, 100.0),
        default=1.0,
        help="ratio of the edge length of the tetrahedra to h, 0.1 to 100 (default 1)",
    )
    method.add_argument(
        "--envelope",
        metavar="MM",
        type=positive,
        help="maximum distance by which ftetwild moves the surface, mm, above 0 (default 0.05 of the h that 95%% of the surface "
        "exceed). Twice this distance is the default of --max-distance for every method",
    )
    method.add_argument(
        "--stop-energy",
        metavar="E",
        type=number(3.0, 1e6),
        help="ftetwild: optimize until the largest AMIPS energy is below E, at least 3 (all tetrahedra regular). By default, "
        "ftetwild starts with 1000, and continues with 30 and 10 while a limit of shape is missed",
    )
    method.add_argument(
        "--max-passes",
        metavar="N",
        type=whole(1),
        default=80,
        help="ftetwild: maximum number of optimization passes (default 80)",
    )
    method.add_argument(
        "--max-seconds",
        metavar="S",
        type=positive,
        default=3600.0,
        help="time limit of the tetrahedralizer, including all attempts, s (default 3600)",
    )

    checks = parser.add_argument_group(
        "Checks", "A mesh that misses one of these limits is written, but the exit code is 1."
    )
    checks.add_argument(
        "--min-dihedral",
        metavar="DEG",
        type=number(0.0, 70.0),
        default=5.0,
        help="minimum dihedral angle, degrees, 0 to 70 (default 5)",
    )
    checks.add_argument(
        "--min-scaled-jacobian",
        metavar="X",
        type=number(0.0, 1.0),
        default=0.05,
        help="minimum scaled Jacobian, 0 to 1 (default 0.05)",
    )
    checks.add_argument(
        "--max-volume-change",
        metavar="PERCENT",
        type=number(0.0, 100.0),
        default=1.0,
        help="maximum difference between the volumes of the tetrahedra and of the surface, percent (default 1)",
    )
    checks.add_argument(
        "--max-distance",
        metavar="MM",
        type=positive,
        help="maximum distance between the boundary of the tetrahedra and the surface, in both directions, mm (default twice "
        "the envelope)",
    )

    checks.add_argument(
        "--accept-forced",
        action="store_true",
        help="many materials: accept tetrahedra below a limit of shape where the triangles of the surface allow no better ones. "
        "The verdict counts them",
    )

    solve = parser.add_argument_group(
        "Solve",
        _SOLVE,
    )
    solve.add_argument(
        "--solve",
        choices=["auto", "yes", "no"],
        default="auto",
        help="whether to solve the test problems (default auto: up to 150,000 tetrahedra). A million tetrahedra need about 3 GB",
    )
    solve.add_argument(
        "--solve-seconds",
        metavar="S",
        type=positive,
        default=600.0,
        help="time limit of the test problems, s (default 600). Unsolved problems are omitted with a warning. The set-up of "
        "multigrid is not interrupted",
    )

    many = parser.add_argument_group(
        "Many materials",
        _MANY,
    )
    many.add_argument(
        "--source",
        metavar="NAME[=X,Y,Z]",
        type=source_of_current,
        default=None,
        help="material that contains the current source, and the current density in world coordinates, uA/mm^2 (default 1,0,0)",
    )
    many.add_argument(
        "--conductivity",
        metavar="NAME=S",
        type=named_number,
        action="append",
        default=[],
        help="conductivity of a material, S/m, above 0 (default 1); may be repeated",
    )

    shared = parser.add_argument_group("Shared options")
    loudness = shared.add_mutually_exclusive_group()
    loudness.add_argument("-v", "--verbose", action="count", default=0, help="print more to stderr")
    loudness.add_argument("-q", "--quiet", action="store_true", help="print only warnings and errors, no progress")
    shared.add_argument(
        "--force",
        action="store_true",
        help="replace existing outputs; without this option they are kept and the run is refused",
    )
    shared.add_argument(
        "--threads", metavar="N", type=whole(0), default=0, help="number of CPU threads, 0 for all cores (default 0)"
    )
    shared.add_argument(
        "--max-memory",
        metavar="BYTES",
        type=number_of_bytes,
        help="maximum memory of the run, such as 8G or 500M; a run that is expected to need more is refused before it starts "
        "(default: the free memory of the machine)",
    )
    shared.add_argument(
        "--seed",
        metavar="N",
        type=whole(0),
        default=1,
        help="recorded only (default 1). The tetrahedralizers do not use it, and the output of ftetwild may differ "
        "from run to run",
    )
    shared.add_argument(
        "--report",
        metavar="FILE.json",
        type=Path,
        help="JSON file for the report: parameters, measurements and checks (always replaced)",
    )
    shared.add_argument(
        "--progress",
        choices=["auto", "bar", "lines", "none"],
        default="auto",
        help="how to show progress on stderr (default auto: a bar on a terminal, otherwise lines)",
    )
    shared.add_argument("--version", action="version", version=f"{TOOL} {__version__}", help="print the version")
    shared.add_argument("-h", "--help", action="help", help="print this help")
    return parser


def main(argv: Sequence[str] | None = None) -> int:
    """Run the program.

    Parameters
    ----------
    argv
        The command line without the program's name; that of the process by default.

    Returns
    -------
    int
        The exit code (see :class:`.ExitCode`).
    """
    words = list(sys.argv[1:] if argv is None else argv)
    if words == [command_line.WORD]:
        print(command_line.told(build_parser()))
        return 0
    if words[:1] == [command_line.CHECK_OPTIONS]:
        return _check_options(words[1], words[2:])
    parsed = build_parser().parse_args(words)
    failed: list[str] = []
    error: StageError | None = None
    report: Path | None = parsed.report
    if report is not None:
        try:
            check_report(
                report,
                [
                    path
                    for path in (
                        parsed.surface,
                        parsed.sizefield,
                        parsed.distfield,
                        parsed.labels_volume,
                        parsed.output,
                    )
                    if path is not None
                ],
            )
        except StageError as problem:
            # not even to tell of the error may a file be replaced that is no report
            error, report = problem, None
    common = CommonArguments(
        parsed.verbose,
        parsed.quiet,
        parsed.force,
        parsed.threads,
        parsed.seed,
        report,
        parsed.progress,
        parsed.max_memory,
    )
    context = Context(common, canonical_command_line(words, [parsed.output]), {})
    with Interruptible(TOOL) as stopped:
        try:
            if error is None:
                failed = _run(parsed, context)
        except StageError as problem:
            error = problem
        except OSError as problem:
            # an error without a name may be of any file, also of one in TMPDIR
            name = Path(problem.filename or "a file that the system does not name")
            error = StageError.file(
                name,
                "use",
                problem,
                f"check permissions and free space in {parsed.output.parent} and {tempfile.gettempdir()} (TMPDIR)",
            )
        except MemoryError:
            error = StageError(
                "there is not enough memory",
                "the meshes do not fit into memory",
                "use a larger --tet-size-factor or a machine with more memory",
            )
        except Exception as problem:
            error = unexpected(problem)
        stopped.ignore()
        return int(context.close(failed, error))


def _check_options(known: str, words: list[str]) -> int:
    """Refuse what a run would refuse; print what is known of the case for the next stage."""
    parsed = build_parser().parse_args(words)
    from tetmesh_check.fem.forward import check_names
    from tetmesh_check.materials_run import refuse_arguments
    from tetmesh_check.tets import hxt, tetgen, tetwild
    from tetmesh_check.tets.fill import Method
    from tetmesh_check.tets.worker import refuse_missing

    workers = {Method.FTETWILD: tetwild.WORKER, Method.HXT: hxt.WORKER, Method.TETGEN: tetgen.WORKER}

    materials = json.loads(known)["materials"]
    try:
        arguments = _arguments(parsed)
        if materials:
            refuse_arguments(arguments)
        method = Method.HXT if materials else arguments.method
        if method in workers:
            refuse_missing(workers[method])
        if arguments.labels_volume is not None and not arguments.labels_volume.exists():
            raise StageError.file(
                arguments.labels_volume, "read", FileNotFoundError("it is not there"), "check --labels-volume"
            )
        if materials is not None:
            # the first is the outside
            check_names(arguments.forward, materials[1:])
    except StageError as error:
        print(f"error: {error}", file=sys.stderr)
        return int(error.code)
    print(known)
    return 0


def _arguments(parsed: argparse.Namespace) -> Arguments:
    """Collect what the user asked for; refuse what does not go together."""
    # pyvista takes a second to load; --help and usage errors need not wait for it
    from tetmesh_check.arguments import Arguments
    from tetmesh_check.checks import Limits
    from tetmesh_check.fem.forward import ForwardArguments
    from tetmesh_check.fem.solve import SolveMode, SolveSettings
    from tetmesh_check.tets.fill import Method

    arguments = Arguments(
        surface=parsed.surface,
        output=parsed.output,
        sizefield=parsed.sizefield,
        distfield=parsed.distfield,
        order=parsed.order,
        pictures=parsed.pictures,
        labels_volume=parsed.labels_volume,
        exports=parsed.export,
        unit=parsed.unit,
        tet_size_factor=parsed.tet_size_factor,
        method=Method(parsed.method),
        envelope=parsed.envelope,
        stop_energy=parsed.stop_energy,
        max_passes=parsed.max_passes,
        max_seconds=parsed.max_seconds,
        limits=Limits(
            parsed.min_dihedral,
            parsed.min_scaled_jacobian,
            parsed.max_volume_change,
            parsed.max_distance,
            parsed.accept_forced,
        ),
        solve=SolveSettings(SolveMode(parsed.solve), parsed.solve_seconds),
        forward=ForwardArguments(dict(parsed.conductivity))
        if parsed.source is None
        else ForwardArguments(dict(parsed.conductivity), *parsed.source),
    )
    if arguments.output.suffix != ".vtu":
        raise StageError(
            f"{arguments.output}: does not end in .vtu",
            "the volume mesh is written in the VTK format for unstructured grids",
            "name the output NAME.volume.vtu",
        )
    arguments.refuse_order()
    return arguments


def _run(parsed: argparse.Namespace, context: Context) -> list[str]:
    from tetmesh_check.pipeline import run
    from tetmesh_check.report.pictures import PICTURES

    arguments = _arguments(parsed)
    context.parameters.update(arguments.parameters())
    outputs = [arguments.output, *arguments.other_paths()]
    for source in (arguments.surface, arguments.sizefield, arguments.distfield, arguments.labels_volume):
        if source is not None and any(same_file(source, output) for output in outputs):
            raise StageError(
                f"{source}: is both an input and an output",
                "the input would be replaced",
                "choose another name for the output",
            )
    refuse_existing(outputs, context.common.force)
    if (job := arguments.picture_job) is not None and job.folder.is_dir():
        refuse_existing([job.path(picture) for picture in PICTURES], context.common.force)
    return run(arguments, context)
