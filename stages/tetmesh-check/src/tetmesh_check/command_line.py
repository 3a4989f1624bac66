"""The options as JSON, the twin of ``CommandLine`` in common/stage/src/cli/shell.rs."""

from __future__ import annotations

import argparse
import json
from pathlib import Path

CHECK_OPTIONS = "--check-options"
"""First word of a command line that is only checked; what is known of the case follows as JSON: the
twin of ``Known`` in common/stage/src/cli/check.rs."""

WORD = "--command-line"
"""Alone on the command line, it asks for this; it stands beside the options, because the stage
cannot run without its files."""


def told(parser: argparse.ArgumentParser) -> str:
    """Tell of every option that a parser knows.

    Parameters
    ----------
    parser
        The parser of the program.
    """
    # argparse has no other way to its options; help and version are every program's
    options = [it for it in parser._actions if it.option_strings and it.dest not in ("help", "version")]
    return json.dumps({"name": parser.prog, "options": [_option(it, parser.prog) for it in options]})


def _option(action: argparse.Action, program: str) -> dict[str, object]:
    long = next(name for name in action.option_strings if name.startswith("--"))
    short = next((name for name in action.option_strings if not name.startswith("--")), None)
    words = [str(word) for word in action.choices or ()]
    value = action.metavar if isinstance(action.metavar, str) else " ".join(action.metavar or ())
    return {
        "long": long[2:],
        "short": short[1:] if short else None,
        "value": None if action.nargs == 0 else value or action.dest.upper(),
        "words": words,
        "is_path": action.type is Path,
        "help": (action.help or "") % {**vars(action), "prog": program},
    }
