"""The command line of ``tetmesh-check``."""

from __future__ import annotations

import argparse
import json
import math
import sys
import tempfile
import tomllib
from collections.abc import Callable, Sequence
from dataclasses import fields, replace
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tetmesh_check import __version__, command_line
from tetmesh_check.context import TOOL, CommonArguments, Context, Interruptible, canonical_command_line
from tetmesh_check.errors import StageError, unexpected
from tetmesh_check.files import check_report, refuse_existing, same_file
from tetmesh_check.memory import number_of_bytes
from tetmesh_check.parsing import Parser, formats, named_number, number, source_of_current, whole

if TYPE_CHECKING:
    from tetmesh_check.arguments import Arguments

_READERS: dict[str, Callable[[str], Any]] = {
    "path": Path,
    "int": int,
    "formats": formats,
    "number_of_bytes": number_of_bytes,
    "named_number": named_number,
    "source_of_current": source_of_current,
}


def _reader(kind: str, range_: dict[str, float]) -> Callable[[str], Any]:
    if kind == "whole":
        return whole(int(range_["low"]))
    if kind == "number":
        low = range_.get("above", range_.get("low", 0.0))
        return number(low, range_.get("high", math.inf), "low" in range_)
    return _READERS[kind]


def build_parser(kind: type[Parser] = Parser) -> argparse.ArgumentParser:
    """Build the parser of the command line from ``options.toml``."""
    table = tomllib.loads(files("tetmesh_check").joinpath("options.toml").read_text(encoding="utf-8"))
    parser = kind(
        prog=TOOL,
        description=table["description"],
        epilog=table["epilog"],
        formatter_class=argparse.RawDescriptionHelpFormatter,
        add_help=False,
        allow_abbrev=False,
    )
    for group in table["group"]:
        added = parser.add_argument_group(group["title"], group.get("description"))
        exclusive = None
        for option in group["option"]:
            place: argparse._ActionsContainer = added
            if option.pop("exclusive", False):
                exclusive = exclusive or added.add_mutually_exclusive_group()
                place = exclusive
            range_ = {key: option.pop(key) for key in ("low", "above", "high") if key in option}
            if "type" in option:
                option["type"] = _reader(option["type"], range_)
            if option.get("action") == "version":
                option["version"] = f"{TOOL} {__version__}"
            place.add_argument(*option.pop("names"), **option)
    return parser


def main(argv: Sequence[str] | None = None, make_context: type[Context] = Context) -> int:
    """Run the program.

    Parameters
    ----------
    argv
        The command line without the program's name; that of the process by default.
    make_context
        Shows progress and messages.

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
            named = (parsed.surface, parsed.sizefield, parsed.distfield, parsed.labels_volume, parsed.output)
            check_report(report, [path for path in named if path is not None])
        except StageError as problem:
            # not even to tell of the error may a file be replaced that is no report
            error, report = problem, None
    common = replace(_part(CommonArguments, parsed), report=report)
    context = make_context(common, canonical_command_line(words, [parsed.output]), {})
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
    from tetmesh_check.arguments import Method
    from tetmesh_check.fem.forward import check_names
    from tetmesh_check.tets import hxt, tetgen, tetwild

    workers = {Method.FTETWILD: tetwild.WORKER, Method.HXT: hxt.WORKER, Method.TETGEN: tetgen.WORKER}

    materials = json.loads(known)["materials"]
    try:
        arguments = _arguments(parsed)
        if materials:
            arguments.refuse_for_materials()
        method = Method.HXT if materials else arguments.method
        if method in workers:
            workers[method].refuse_missing()
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


def _part(kind: Any, parsed: argparse.Namespace, **known: Any) -> Any:
    """Make a dataclass of the options that have the names of its fields."""
    given = {field.name: getattr(parsed, field.name) for field in fields(kind) if hasattr(parsed, field.name)}
    return kind(**{**given, **known})


def _arguments(parsed: argparse.Namespace) -> Arguments:
    """Collect what the user asked for; refuse what does not go together."""
    # pyvista takes a second to load; --help and usage errors need not wait for it
    from tetmesh_check.arguments import Arguments, Method
    from tetmesh_check.checks import Limits
    from tetmesh_check.fem.forward import ForwardArguments
    from tetmesh_check.fem.solve import SolveMode, SolveSettings

    forward = {} if parsed.source is None else dict(zip(("source", "density"), parsed.source, strict=True))
    arguments: Arguments = _part(
        Arguments,
        parsed,
        exports=parsed.export or (),
        method=Method(parsed.method),
        limits=_part(Limits, parsed),
        solve=SolveSettings(SolveMode(parsed.solve), parsed.solve_seconds),
        forward=ForwardArguments(dict(parsed.conductivity), **forward),
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
    if arguments.pictures is not None and arguments.pictures.is_dir():
        refuse_existing(arguments.picture_paths().values(), context.common.force)
    return run(arguments, context)
