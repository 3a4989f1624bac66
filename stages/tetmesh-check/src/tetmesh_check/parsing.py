"""The table of options, usage errors in three parts, and values within their ranges."""

from __future__ import annotations

import argparse
import math
import os
import re
import sys
import tomllib
from collections.abc import Callable
from importlib.resources import files
from pathlib import Path
from typing import Any, NoReturn

from isoparticles._native import VERSION, number_of_bytes

from tetmesh_check.density.laws import read_calibration, read_law
from tetmesh_check.errors import StageError, close
from tetmesh_check.parts.algebra import Definition, read_definition, read_expression
from tetmesh_check.parts.layers import read_layers
from tetmesh_check.parts.splits import read_gap, read_split
from tetmesh_check.parts.tags import read_tag

FORMATS = ("inp", "k", "bdf", "msh", "msh2", "med", "xdmf", "vtp", "vtk", "feb", "carp", "simvascular")
"""Formats of ``--export``."""
LINEAR_FORMATS = ("vtp", "carp", "simvascular", "simnibs")
"""Formats without quadratic tetrahedra or triangles."""
PRISMLESS_FORMATS = ("carp", "simvascular", "simnibs")
"""Formats that get no prisms. SimNIBS and svMultiPhysics read one kind of element; openCARP, whose
order of the nodes of prisms is not documented, computes no flow."""


def read_table() -> dict[str, Any]:
    """Read ``options.toml``."""
    return tomllib.loads(files("tetmesh_check").joinpath("options.toml").read_text(encoding="utf-8"))


def options() -> list[dict[str, Any]]:
    """Return the options of ``options.toml`` with two more keys: ``name`` and ``is_switch``."""
    return [
        {**option, "name": option["names"][-1][2:], "is_switch": option.get("action") in ("store_true", "count")}
        for group in read_table()["group"]
        for option in group["option"]
        if option["names"][-1].startswith("--") and option.get("action") not in ("help", "version")
    ]


class Parser(argparse.ArgumentParser):
    """Parser of a program, with usage errors in three parts.

    Parameters
    ----------
    tool
        Name of the program.
    more
        Other arguments of ``argparse.ArgumentParser``. ``--version`` is added together with
        ``--help``.
    """

    def __init__(self, tool: str, **more: Any) -> None:
        super().__init__(tool, formatter_class=argparse.RawDescriptionHelpFormatter, allow_abbrev=False, **more)
        self.version = f"{tool} {VERSION}"
        # as from Python 3.14, a value may begin with a negative number: -20:0,480:0.5
        self._negative_number_matcher = re.compile(r"-\.?\d")
        if self.add_help:
            self.add_argument("--version", action="version", help="print the version")

    def error(self, message: str) -> NoReturn:
        """Print a usage error, and end the program."""
        # show the path of the program: in a clone, it is not on the PATH
        command = self.prog if sys.argv[0].endswith(".py") else sys.argv[0]
        if front := os.environ.get("ISOPARTICLES_FRONT"):
            command = f"{front} {self.prog}"
        error = StageError(message, "the command line was not understood", f"see `{command} --help`")
        raise SystemExit(close([], error, False))


def reader(option: dict[str, Any]) -> Callable[[str], Any]:
    """Return the function that parses the value of an option of ``options.toml``.

    Parameters
    ----------
    option
        Its entry: ``type``, and for numbers ``range`` or ``low``.
    """
    kind = option["type"]
    if kind not in ("number", "whole"):
        return _READERS[kind]

    def number(text: str) -> float:
        low, high = (float(end) for end in option["range"][1:-1].split(","))
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        if not low <= value <= high or math.isinf(value) or (value == low and option["range"][0] == "("):
            raise argparse.ArgumentTypeError(f"'{text}' is not a number in {option['range']}")
        return value

    def whole(text: str) -> int:
        # the Rust code stores them in 64 bits
        if not text.isascii() or not text.isdigit() or not option["low"] <= int(text) < 2**64:
            raise argparse.ArgumentTypeError(f"'{text}' is not a whole number from {option['low']}")
        return int(text)

    return whole if kind == "whole" else number


def _formats(text: str) -> tuple[str, ...]:
    words = tuple(dict.fromkeys(text.split(",")))
    for word in words:
        if word not in FORMATS:
            raise argparse.ArgumentTypeError(f"'{word}' is not one of {', '.join(FORMATS)}")
    return words


def _named_number(text: str) -> tuple[str, float]:
    """Parse ``NAME=VALUE``; the name may contain equals signs."""
    name, equals, value = text.rpartition("=")
    if not name or not equals:
        raise argparse.ArgumentTypeError(f"'{text}' is not NAME=VALUE")
    return name, reader({"type": "number", "range": "(0, inf)"})(value)


def _source_of_current(text: str) -> tuple[str, tuple[float, float, float]]:
    """Parse ``NAME`` or ``NAME=X,Y,Z``, a vector that is not zero."""
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


def _told(read: Callable[[str], Any]) -> Callable[[str], Any]:
    """Return a reader that reports what is wrong with a value."""

    def told(text: str) -> Any:
        try:
            return read(text)
        except ValueError as error:
            raise argparse.ArgumentTypeError(str(error)) from error

    return told


def _numbers(count: int, form: str, limit: float) -> Callable[[str], tuple[float, ...]]:
    """Return a reader of numbers, separated by commas, of at most this magnitude."""

    def numbers(text: str) -> tuple[float, ...]:
        try:
            found = tuple(float(word) for word in text.split(","))
        except ValueError:
            found = ()
        if len(found) != count or not all(math.isfinite(one) and abs(one) <= limit for one in found):
            raise argparse.ArgumentTypeError(f"'{text}' is not {form}")
        return found

    return numbers


_READERS: dict[str, Callable[[str], Any]] = {
    "path": Path,
    "int": int,
    "formats": _formats,
    "number_of_bytes": number_of_bytes,
    "named_number": _named_number,
    "source_of_current": _source_of_current,
    "calibration": read_calibration,
    "law": read_law,
    "tag": _told(read_tag),
    "expression": _told(lambda text: Definition("", text.strip(), read_expression(text))),
    "point": _numbers(3, "X,Y,Z", math.inf),
    "angles": _numbers(2, "ENDO,EPI in degrees, -90 to 90", 90.0),
    "set": _told(read_definition),
    "split": _told(read_split),
    "gap": _told(read_gap),
    "layers": _told(read_layers),
}
