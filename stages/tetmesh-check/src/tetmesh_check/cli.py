"""The command line of ``tetmesh-check``."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from dataclasses import fields
from typing import TYPE_CHECKING, Any

from isoparticles._native import Context

from tetmesh_check.errors import StageError, close, file_error, guarded
from tetmesh_check.parsing import Parser, options, read_table, reader

if TYPE_CHECKING:
    from tetmesh_check.arguments import Arguments

TOOL = "tetmesh-check"
COMMAND_LINE = "--command-line"
"""If this is the only word, the program prints its options as JSON, like ``CommandLine`` in
common/stage/src/cli/shell.rs."""
CHECK_OPTIONS = "--check-options"
"""First word of a command line that is checked, but not run. The second word is what is known about
the case, as JSON, like ``Known`` in common/stage/src/cli/check.rs."""
_FOR_ARGPARSE = ("action", "choices", "default", "dest", "metavar", "required")


def build_parser(kind: type[Parser] = Parser) -> argparse.ArgumentParser:
    """Build the parser of the command line from ``options.toml``."""
    table = read_table()
    parser = kind(TOOL, description=table["description"], epilog=table["epilog"], add_help=False)
    for group in table["group"]:
        added = parser.add_argument_group(group["title"], group.get("description"))
        exclusive = None
        for option in group["option"]:
            known = {key: option[key] for key in _FOR_ARGPARSE if key in option}
            if "type" in option:
                known["type"] = reader(option)
            place: argparse._ActionsContainer = added
            if option.get("exclusive"):
                place = exclusive = exclusive or added.add_mutually_exclusive_group()
            place.add_argument(*option["names"], help=option["help"].replace("%", "%%"), **known)
    return parser


def _described(option: dict[str, Any]) -> dict[str, Any]:
    return {
        "long": option["name"],
        "short": option["names"][0][1:] if len(option["names"]) > 1 else None,
        "value": None if option["is_switch"] else option.get("metavar", option["name"].upper()),
        "words": [str(word) for word in option.get("choices", ())],
        "is_path": option.get("type") == "path",
        "help": option["help"],
    }


def main(argv: Sequence[str] | None = None, make_context: type[Context] = Context) -> int:
    """Run the program.

    Parameters
    ----------
    argv
        The command line without the program's name; that of the process by default.
    make_context
        Creates the context of the run, which shows progress and messages.

    Returns
    -------
    int
        The exit code.
    """
    words = list(sys.argv[1:] if argv is None else argv)
    if words == [COMMAND_LINE]:
        print(json.dumps({"name": TOOL, "options": [_described(option) for option in options()]}))
        return 0
    if words[:1] == [CHECK_OPTIONS]:
        return guarded(TOOL, lambda: _check_options(words[1], words[2:]))
    parsed = build_parser().parse_args(words)
    try:
        context = make_context(words, parsed)
    except StageError as error:
        # no report is written: its path may be that of another file
        return close([], error, False)
    return guarded(TOOL, lambda: _run(parsed, context), context.close)


def _check_options(known: str, words: list[str]) -> None:
    """Refuse what a run would refuse; print what is known about the case for the next stage."""
    parsed = build_parser().parse_args(words)
    from tetmesh_check.parts.names import check_early
    from tetmesh_check.tets import hxt, tetgen, tetwild

    workers = {"ftetwild": tetwild.WORKER, "hxt": hxt.WORKER, "tetgen": tetgen.WORKER}

    materials = json.loads(known)["materials"]
    arguments = _arguments(parsed)
    if materials:
        arguments.refuse_for_materials()
    method = "hxt" if materials and arguments.method == "auto" else arguments.method
    if method in workers:
        workers[method].refuse_missing()
    for option, path in (("--labels-volume", parsed.labels_volume), ("--density", parsed.density)):
        if path is not None and not path.exists():
            raise file_error(path, "read", FileNotFoundError("it is not there"), f"check {option}")
    fibres = arguments.fibres.sets if arguments.fibres else ()
    walls = tuple(layers.wall for layers in arguments.layers)
    check_early(arguments.tags, arguments.sets, materials, fibres + walls, arguments.splits)
    if materials is not None:
        # the first is the outside
        arguments.check_material_names(materials[1:])
    print(known)


def _arguments(parsed: argparse.Namespace) -> Arguments:
    """Convert the parsed command line; refuse options that cannot be combined."""
    # pyvista takes a second to load; --help and usage errors need not wait for it
    from tetmesh_check.arguments import Arguments
    from tetmesh_check.checks import Limits
    from tetmesh_check.density.arguments import density_arguments
    from tetmesh_check.export.profiles import resolve
    from tetmesh_check.fem.currents import ForwardArguments
    from tetmesh_check.fem.solve import refuse_missing
    from tetmesh_check.fibres.arguments import fibre_arguments
    from tetmesh_check.parts.algebra import read_definitions

    exports, space, unit = resolve(parsed.profile, parsed.exports, parsed.space, parsed.unit)
    given = {
        **vars(parsed),
        "exports": exports,
        "space": space,
        "unit": unit,
        "limits": Limits(**{field.name: getattr(parsed, field.name) for field in fields(Limits)}),
        "density": density_arguments(vars(parsed)),
        "fibres": fibre_arguments(vars(parsed)),
        "forward": ForwardArguments(dict(parsed.conductivity), *(parsed.source or ())),
        "tags": tuple(parsed.tags),
        "sets": (*(read_definitions(parsed.sets_file) if parsed.sets_file else ()), *parsed.sets),
        "splits": (*parsed.splits, *parsed.gaps),
        "layers": tuple(parsed.layers),
    }
    arguments = Arguments(**{field.name: given[field.name] for field in fields(Arguments)})
    arguments.refuse()
    refuse_missing(arguments.solve, arguments.forward.source, arguments.fibres is not None)
    return arguments


def _run(parsed: argparse.Namespace, context: Context) -> list[str]:
    from tetmesh_check.pipeline import run

    arguments = _arguments(parsed)
    context.parameters.update(arguments.parameters())
    context.check_outputs(arguments.output_paths())
    return run(arguments, context)
