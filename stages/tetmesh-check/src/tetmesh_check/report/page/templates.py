"""The templates of the pages (folder ``templates``), and the functions that they call."""

from __future__ import annotations

import math
import os
import re
from functools import cache
from importlib.resources import files
from json import dumps
from pathlib import Path
from typing import Any
from urllib.parse import quote

import numpy as np
from isoparticles._native import VERSION
from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from tetmesh_check.checks import percent
from tetmesh_check.numerals import plain
from tetmesh_check.report.colours import PALETTE
from tetmesh_check.report.page.advice import advice_for
from tetmesh_check.report.page.case import dig
from tetmesh_check.report.page.images import picture_data
from tetmesh_check.volume_table import with_changes

_UNITS = (("GB", 1e9), ("MB", 1e6), ("kB", 1e3))


def number(value: float | None, digits: int = 3) -> str:
    """Write a number with few digits, and without decimals from 1000 on; a dash if unknown.

    Parameters
    ----------
    value
        The number.
    digits
        Significant digits.
    """
    if value is None or not math.isfinite(value):
        return "-"
    if value == round(value) and abs(value) < 1e15:
        return f"{int(value):,}".replace(",", "\u202f")
    return plain(value, digits, spaced=True)


def duration(seconds: float) -> str:
    """Write a time with its unit.

    Parameters
    ----------
    seconds
        The time, s.
    """
    if seconds >= 90:
        return f"{seconds / 60:.1f} min"
    return f"{seconds:.1f} s" if seconds >= 1 else f"{1000 * seconds:.0f} ms"


def memory(size: float) -> str:
    """Write an amount of memory with its unit.

    Parameters
    ----------
    size
        In bytes.
    """
    return f"{size / 2**30:.1f} GiB" if size >= 2**30 else f"{size / 2**20:.0f} MiB"


def amount(size: float) -> str:
    """Write the size of a file with its unit.

    Parameters
    ----------
    size
        In bytes.
    """
    for unit, scale in _UNITS:
        if size >= scale:
            return f"{size / scale:.3g} {unit}"
    return f"{size:.0f} bytes"


def ticks(low: float, high: float, about: int = 5) -> list[float]:
    """Return round numbers between two values.

    Parameters
    ----------
    low, high
        The range; ``high`` is larger.
    about
        The approximate number.
    """
    rough = (high - low) / about
    power = 10.0 ** math.floor(math.log10(rough))
    step = min((m * power for m in (1, 2, 2.5, 5, 10)), key=lambda s: abs(s - rough))
    first = math.ceil(low / step - 1e-9)
    return [k * step for k in range(first, math.floor(high / step + 1e-9) + 1)]


def anchor(title: str) -> str:
    """Return the identifier of the section with a title."""
    return re.sub(r"[^a-z0-9]+", "-", title.lower()).strip("-")


def titles(body: str) -> list[str]:
    """Find the titles of the sections of a page."""
    return re.findall(r'<section id="[^"]+"><h2>(.*?)</h2>', body)


def link(path: Path, folder: Path) -> str:
    """Return the address of a file in a page in a folder."""
    return quote(Path(os.path.relpath(path, folder)).as_posix())


def resource(name: str) -> Markup:
    """Return the text of a file of CSS or JavaScript beside this one."""
    return Markup(files("tetmesh_check.report.page").joinpath(name).read_text(encoding="utf-8"))


_FUNCTIONS = (
    number, plain, percent, dumps, duration, memory, amount, ticks, anchor, titles, link, resource,
    picture_data, dig, advice_for, with_changes,
)  # fmt: skip


@cache
def environment() -> Environment:
    """Return the templates by name; all functions are filters as well."""
    made = Environment(
        loader=PackageLoader("tetmesh_check.report.page"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    functions = {function.__name__: function for function in _FUNCTIONS}
    made.filters |= functions
    made.globals |= {**functions, "np": np, "palette": len(PALETTE), "version": VERSION}
    return made


def render(template: str, **values: Any) -> Markup:
    """Fill in a template; texts among the values are escaped.

    Parameters
    ----------
    template
        Name of the file without ``.html``.
    values
        The names that the template uses.

    Raises
    ------
    UndefinedError
        If the report of a stage lacks something that the template shows.
    """
    return Markup(environment().get_template(f"{template}.html").render(**values).strip())
