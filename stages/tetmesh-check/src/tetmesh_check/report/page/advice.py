"""Advice for checks that fail or warn.

The texts are in ``advice.json``, which ``pipelines/case/src/advice.rs`` reads as well: page and
terminal give the same advice. ``advice`` lists words of messages; the first entry that applies is
used. ``terms`` replaces words in braces by the variable that applies to the case. An entry with
``set`` applies only if this variable is set, or has this value (``BORDER=open``).
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from functools import cache
from importlib.resources import files
from types import MappingProxyType

_NOTHING: Mapping[str, str] = MappingProxyType({})


@cache
def _table() -> dict[str, list[dict[str, str]]]:
    table: dict[str, list[dict[str, str]]] = json.loads(
        files("tetmesh_check.report.page").joinpath("advice.json").read_text(encoding="utf-8")
    )
    return table


def _applies(entry: dict[str, str], parameters: Mapping[str, str]) -> bool:
    name, equals, value = entry.get("set", "").partition("=")
    return not name or (parameters.get(name) == value if equals else name in parameters)


def advice_for(words: str, parameters: Mapping[str, str] = _NOTHING) -> str:
    """Say what to do about a check; empty if the message itself says it.

    Parameters
    ----------
    words
        The message of the check.
    parameters
        The variables that are set for the case.
    """
    lowered = words.lower()
    table = _table()
    entry = next(entry for entry in table["advice"] if entry["words"] in lowered and _applies(entry, parameters))
    advice = entry["do"]
    for term in table["terms"]:
        if _applies(term, parameters):
            advice = advice.replace(term["words"], term["do"])
    return advice
