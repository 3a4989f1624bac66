"""Writes the module ``isoparticles._options`` from the options of the stages.

Run ``python make_options.py`` with the package on the path after an option has changed. A test
compares the module with the options.
"""

from __future__ import annotations

import re
import textwrap
from pathlib import Path
from typing import Any

from isoparticles import _words

HEADER = '''"""The keyword arguments of the functions. Made by ``make_options.py``; do not edit."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from os import PathLike
from typing import Literal, TypedDict

Labels = int | str | Iterable[int | str]
Materials = str | Iterable[str] | Mapping[str, Labels]
Pair = tuple[str, str]
# mypy does not accept a table of only texts as a table of texts or pairs
Sizes = str | Iterable[str] | Mapping[str, float] | Mapping[Pair, float] | Mapping[str | Pair, float]
'''
CLASSES = {
    "distfield": ("DistfieldOptions", "distance_field"),
    "sizefield": ("SizefieldOptions", "size_field"),
    "seed": ("SeedOptions", "seed"),
    "particles": ("ParticlesOptions", "settle"),
    "reconstruct": ("ReconstructOptions", "reconstruct"),
    "tetmesh-check": ("TetmeshOptions", "fill"),
}
KINDS = {"flag": "bool", "number": "float", "whole": "int", "text": "str", "numbers": "str | Iterable[float]"}
SPECIAL = {
    "labels": "Labels",
    "material": "Materials",
    "materials": "Materials",
    "size_of_materials": "Sizes",
    "keep": "float | str",
    "crop": "str | PathLike[str]",
    "downsample": "int | str | Iterable[int]",
    "max_memory": "int | str",
    "conductivity": "Mapping[str, float] | str | Iterable[str]",
}
"""Types of options whose kind does not determine the type."""
ALIAS = {"material": "materials"}
"""Second names of options."""


def module() -> str:
    """Return the text of the module."""
    parts = [HEADER]
    for stage, (name, function) in CLASSES.items():
        parts.append(typed_dict(name, function, _words.options(stage), "options"))
    parts.append(typed_dict("MeshSettings", "mesh", _words.keys(), "settings"))
    return "\n\n".join(parts)


def typed_dict(name: str, function: str, table: dict[str, dict[str, Any]], what: str) -> str:
    """Return a class with one key per option."""
    lines = [f"class {name}(TypedDict, total=False):", f'    """The {what} of :func:`isoparticles.{function}`."""', ""]
    for key, option in table.items():
        default = option.get("default")
        told = first_sentence(option["help"]) + (f" Default: {default}." if default is not None else "")
        lines += textwrap.wrap(told, 100, initial_indent="    #: ", subsequent_indent="    #: ")
        lines.append(f"    {key}: {type_of(key, option)}")
        if key in ALIAS:
            lines += [f"    #: The same as {key}.", f"    {ALIAS[key]}: {type_of(key, option)}"]
    return "\n".join(lines) + "\n"


def type_of(key: str, option: dict[str, Any]) -> str:
    """Return the type of the value of an option."""
    if key == "size" and option.get("repeated"):
        key = "size_of_materials"
    if key in SPECIAL:
        return SPECIAL[key]
    words = option["words"]
    if set(words) == {"yes", "no"}:
        return "bool"
    if words:
        return f"Literal[{', '.join(repr(word).replace(chr(39), chr(34)) for word in words)}]"
    kind = KINDS[option["kind"]]
    return f"{kind} | Iterable[{kind}]" if option.get("repeated") else kind


def first_sentence(text: str) -> str:
    """Return the first sentence of a help text, and the default at its end.

    Names of options become literals of reStructuredText.
    """
    whole = " ".join(text.split())
    default = re.search(r" \[(default: [^\]]*)\]$", whole)
    sentence = re.split(r"\. |; | \[default: ", whole)[0].rstrip(".")
    sentence = sentence[:1].upper() + sentence[1:]
    told = f"{sentence}." + (f" {default[1].capitalize()}." if default else "")
    return re.sub(r"`[^`]*`|--[a-z-]+", lambda name: f"``{name[0].strip('`')}``", told)


if __name__ == "__main__":
    path = Path(__file__).parent / "src" / "isoparticles" / "_options.py"
    path.write_text(module(), encoding="utf-8")
