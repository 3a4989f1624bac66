"""The templates of the pages (folder ``templates``), and the functions that they call."""

from __future__ import annotations

import json
from functools import cache
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from tetmesh_check.checks import percent
from tetmesh_check.numerals import plain
from tetmesh_check.report.colours import PALETTE
from tetmesh_check.report.page.case import dig
from tetmesh_check.report.page.charts import number
from tetmesh_check.report.page.html import amount, anchor, duration, memory
from tetmesh_check.volume_table import with_changes


def small(difference: float) -> str:
    """Write a difference in percent that only rounding causes."""
    return "less than 0.001" if abs(difference) < 1e-3 else number(abs(difference), 2)


def change(value: float) -> str:
    """Write a change in percent with two decimals, without a sign if it rounds to zero."""
    return "0 %" if abs(value) < 0.005 else f"{value:+.2f} %"


def known(value: float | None) -> str:
    """Write a number, or a dash if it is not known."""
    return "-" if value is None else number(value)


@cache
def _environment() -> Environment:
    made = Environment(
        loader=PackageLoader("tetmesh_check.report.page"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    made.globals.update(
        {f.__name__: f for f in (number, plain, duration, memory, amount, percent, dig, small, change, known)}
    )
    made.filters.update({f.__name__: f for f in (anchor, number, plain, with_changes, known)})
    made.globals["palette"] = len(PALETTE)
    made.filters.update(json=json.dumps, suffixed=lambda text, end: f"{text}{end}")
    made.tests["ends"] = lambda ending, name: name.endswith(ending)
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
    return Markup(_environment().get_template(f"{template}.html").render(**values).strip())
