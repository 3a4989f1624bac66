"""Parsing of command lines: usage errors in three parts, and numbers within their ranges."""

from __future__ import annotations

import argparse
import math
import os
import sys
from collections.abc import Callable
from typing import NoReturn

from tetmesh_check import __version__
from tetmesh_check.errors import ExitCode, StageError

FORMATS = ("inp", "msh", "msh2", "med", "xdmf", "vtp", "vtk", "feb", "carp", "simvascular")
"""Formats of ``--export``."""
LINEAR_FORMATS = ("vtp", "carp", "simvascular")
"""Formats without quadratic tetrahedra or triangles."""


class Parser(argparse.ArgumentParser):
    """Usage errors in three parts, as everywhere."""

    def error(self, message: str) -> NoReturn:
        """Say what was not understood, and end the program."""
        error = StageError(message, "the command line was not understood", f"see `{self.command()} --help`")
        print(f"error: {error}", file=sys.stderr)
        raise SystemExit(int(ExitCode.BAD_INPUT))

    def command(self) -> str:
        """Return the command of this program; in a clone, its path."""
        if front := os.environ.get("ISOPARTICLES_FRONT"):
            return f"{front} {self.prog}"
        return self.prog if sys.argv[0].endswith(".py") else sys.argv[0]


def program_parser(tool: str, description: str, epilog: str) -> Parser:
    """Build the parser of a program beside ``tetmesh-check``, with ``--help`` and ``--version``.

    Parameters
    ----------
    tool
        Name of the program.
    description, epilog
        Purpose, exit codes and an example, as lines.
    """
    parser = Parser(
        prog=tool,
        description=description,
        epilog=epilog,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    parser.add_argument("--version", action="version", version=f"{tool} {__version__}", help="print the version")
    return parser


def number(low: float, high: float, low_allowed: bool = True) -> Callable[[str], float]:
    """Build a parser of numbers in a range.

    Parameters
    ----------
    low, high
        The range.
    low_allowed
        Whether its lower end belongs to it.
    """

    def parse(text: str) -> float:
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        if not (value > low or (low_allowed and value == low)) or not value <= high or math.isinf(value):
            opening = "[" if low_allowed else "("
            closing = ")" if math.isinf(high) else "]"
            raise argparse.ArgumentTypeError(f"'{text}' is not a number in {opening}{low:g}, {high:g}{closing}")
        return value

    return parse


def whole(low: int) -> Callable[[str], int]:
    """Build a parser of whole numbers.

    Parameters
    ----------
    low
        The smallest.
    """

    def parse(text: str) -> int:
        if not text.isascii() or not text.isdigit() or int(text) < low:
            raise argparse.ArgumentTypeError(f"'{text}' is not a whole number from {low}")
        return int(text)

    return parse


def formats(text: str) -> tuple[str, ...]:
    """Parse the list of formats of ``--export``.

    Parameters
    ----------
    text
        Their names, with commas.
    """
    words = tuple(dict.fromkeys(text.split(",")))
    for word in words:
        if word not in FORMATS:
            raise argparse.ArgumentTypeError(f"'{word}' is none of {', '.join(FORMATS)}")
    return words


def named_number(text: str) -> tuple[str, float]:
    """Parse ``NAME=VALUE`` with a value above 0; the name may hold equals signs.

    Parameters
    ----------
    text
        Text from the command line.
    """
    name, equals, value = text.rpartition("=")
    if not name or not equals:
        raise argparse.ArgumentTypeError(f"'{text}' is not NAME=VALUE")
    return name, number(0.0, math.inf, low_allowed=False)(value)


def source_of_current(text: str) -> tuple[str, tuple[float, float, float]]:
    """Parse ``NAME`` or ``NAME=X,Y,Z``, a vector that is not zero.

    Parameters
    ----------
    text
        Text from the command line.
    """
    name, equals, value = text.rpartition("=")
    if not equals:
        return text, (1.0, 0.0, 0.0)
    try:
        x, y, z = (float(word) for word in value.split(","))
    except ValueError:
        x = y = z = 0.0
    if not name or not math.isfinite(x + y + z) or x == y == z == 0.0:
        raise argparse.ArgumentTypeError(f"'{text}' is not NAME or NAME=X,Y,Z with three numbers that are not all 0")
    return name, (x, y, z)
