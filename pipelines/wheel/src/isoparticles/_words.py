"""Converts keyword arguments to the words of a command line."""

from __future__ import annotations

import difflib
import json
import math
import operator
from collections.abc import Iterable, Mapping
from functools import cache
from typing import Any

from isoparticles import _native

NOT_FOR_TETRAHEDRA = frozenset(
    (
        *("output", "sizefield", "distfield", "labels-volume", "export", "for", "unit", "order", "pictures"),
        *("density", "calibrate", "law", "density-of", "bins", "sets", "split", "gap", "layers"),
        *("verbose", "quiet", "force", "report", "progress", "version", "help"),
    )
)
"""Options of ``tetmesh-check`` that concern further files, or the terminal."""
STAGES = ("distfield", "sizefield", "particles", "reconstruct")
"""Stages whose options :func:`isoparticles.mesh` takes as text."""
KINDS = {"number": "number", "whole": "whole", "number_of_bytes": "whole", "point": "numbers", "angles": "numbers"}
"""Kinds of options by their ``type`` in ``options.toml``. Other types are texts."""
EXTRA_KEYS = frozenset(
    (
        "CASE",
        "NAME",
        "INPUT",
        "DATASET",
        "PHANTOM",
        "SPACING",
        "TET_ORDER",
        "FOR",
        "TETMESH_OPTIONS",
        "OUT",
        "VERBOSITY",
        "HXT",
    )
)
"""Keys of a case that concern files, the terminal or tetrahedra. ``mesh`` has its own argument for
some of them."""


@cache
def options(stage: str) -> dict[str, dict[str, Any]]:
    """Return the options of a stage by their Python names."""
    table = _tetmesh_options() if stage == "tetmesh-check" else json.loads(_native.options())[stage]
    return {python_name(option["name"]): option for option in table}


def _tetmesh_options() -> list[dict[str, Any]]:
    """Return the options of ``tetmesh-check`` in the form of those of the other stages."""
    from tetmesh_check.parsing import options

    return [
        {
            "name": option["name"],
            "kind": _kind_of(option),
            "words": option.get("choices", []),
            "repeated": option.get("action") == "append",
            "hyphen": False,
            "default": str(option["default"]) if option.get("default") and not option["is_switch"] else None,
            "help": option["help"].partition(" (default")[0],
        }
        for option in options()
        if option["name"] not in NOT_FOR_TETRAHEDRA
    ]


def _kind_of(option: dict[str, Any]) -> str:
    if option["is_switch"]:
        return "flag"
    return "word" if "choices" in option else KINDS.get(option.get("type", ""), "text")


@cache
def keys() -> dict[str, dict[str, Any]]:
    """Return the settings of :func:`isoparticles.mesh` by their Python names."""
    return {key["name"].lower(): key for key in json.loads(_native.case_keys()) if key["name"] not in EXTRA_KEYS}


def python_name(option: str) -> str:
    """Return the keyword argument of an option."""
    name = option.replace("-", "_")
    return "from_" if name == "from" else name


def words_of(stage: str, given: Mapping[str, Any]) -> list[str]:
    """Return the command-line words for keyword arguments, in the same order.

    Raises
    ------
    TypeError
        If there is no such option, or if a value has the wrong type.
    ValueError
        If a value cannot be written on a command line.
    """
    known = options(stage)
    words: list[str] = []
    for name, value in given.items():
        if name == "materials" and stage == "distfield":
            if given.get("material") is not None:
                raise TypeError("material and materials are the same option")
            name = "material"
        option = find(name, known, f"option of {stage}")
        if value is None:
            continue
        flag = f"--{option['name']}"
        if option["kind"] == "flag":
            if not isinstance(value, bool):
                raise TypeError(f"{name} must be True or False, not {value!r}")
            words += [flag] if value else []
            continue
        for text in _texts(name, option, value):
            if "\0" in text:
                raise ValueError(f"{name} must not contain a null character")
            # clap would read a word that starts with a dash as another option
            attached = text.startswith("-") and not option["hyphen"]
            words += [f"{flag}={text}"] if attached else [flag, text]
    return words


def settings_of(given: Mapping[str, Any]) -> list[str]:
    """Return assignments such as ``LABELS=1,2`` for keyword arguments.

    Raises
    ------
    TypeError
        If there is no such setting, or if a value has the wrong type.
    ValueError
        If a value cannot be written as a setting.
    """
    known = keys()
    assignments = []
    for name, value in given.items():
        for stage in () if name in known else STAGES:
            if name in options(stage):
                word = options(stage)[name]["name"]
                raise TypeError(f"{name!r}: no such setting of mesh; pass {stage}_options='--{word} ...'")
        key = find(name, known, "setting of mesh")
        if value is None:
            continue
        if name == "labels":
            text = labels(name, value, ",", "" if isinstance(value, str) else ",")
        elif name == "materials" and isinstance(value, Mapping):
            text = ",".join(
                f"{_material(own, '=/:,')}:{labels(own, of, '+', _inner(of) or ',')}" for own, of in value.items()
            )
        elif name == "materials" and not isinstance(value, str):
            text = labels(name, value, ",", ",")
        elif name == "downsample":
            text = _factors(name, value)
        elif set(key.get("words", ())) == {"yes", "no"} and isinstance(value, bool):
            text = "yes" if value else "no"
        else:
            text = scalar(name, value, key["kind"])
        assignments.append(f"{key['name']}={text}")
    return assignments


def refuse_unknown(stage: str, words: Iterable[str]) -> None:
    """Reject options of a program that the package does not have, such as ``--log``.

    Raises
    ------
    ValueError
        If there is such an option.
    """
    known = {option["name"] for option in options(stage).values()}
    for word in words:
        if word.startswith("--") and word[2:].partition("=")[0] not in known:
            raise ValueError(f"{word}: is not an option of {stage} in this package")


def find(name: str, known: Mapping[str, dict[str, Any]], what: str) -> dict[str, Any]:
    """Return an option by its name, or raise an error that suggests the nearest one."""
    if name in known:
        return known[name]
    near = difflib.get_close_matches(name, known, n=1)
    advice = f"did you mean {near[0]!r}?" if near else f"choose among {', '.join(known)}"
    raise TypeError(f"{name!r}: no such {what}; {advice}")


def _texts(name: str, option: Mapping[str, Any], value: Any) -> list[str]:
    if option["name"] == "labels":
        return [labels(name, value, ",", "" if isinstance(value, str) else ",")]
    if option["name"] == "material" and isinstance(value, Mapping):
        return [f"{_material(own, '=/')}={labels(own, of, '+', _inner(of))}" for own, of in value.items()]
    if option["name"] in ("size", "conductivity") and isinstance(value, Mapping):
        return [f"{_pair(own)}={scalar(name, size, 'number')}" for own, size in value.items()]
    if option["name"] == "downsample":
        return [_factors(name, value)]
    if option["kind"] == "numbers" and not isinstance(value, str):
        return [",".join(scalar(name, one, "number") for one in _all(name, value))]
    if not option["repeated"]:
        return [scalar(name, value, option["kind"])]
    return [scalar(name, one, option["kind"]) for one in ([value] if isinstance(value, str) else _all(name, value))]


def _factors(name: str, value: Any) -> str:
    """Return one whole number, or one for each axis, as a word."""
    # arrays have `__index__`, but it fails unless the array is a single number
    single = isinstance(value, str) or (hasattr(value, "__index__") and not getattr(value, "ndim", 0))
    return ",".join(scalar(name, one, "whole") for one in ([value] if single else _all(name, value)))


def _inner(value: Any) -> str:
    """Return the characters that separate labels. A text outside a list may contain them."""
    return "" if isinstance(value, str) else ",+"


def labels(name: str, value: Any, joint: str, forbidden: str) -> str:
    """Join labels to one word, unless a label contains one of the ``forbidden`` characters."""
    # arrays have `__index__`, but it fails unless the array is a single number
    whole = isinstance(value, str) or (hasattr(value, "__index__") and not getattr(value, "ndim", 0))
    parts = [scalar(name, one, "text") for one in ([value] if whole else _all(name, value))]
    if not parts:
        raise ValueError(f"{name} names no label")
    for part in parts:
        if any(mark in part for mark in forbidden):
            raise ValueError(f"{name}: {part!r} contains one of {forbidden!r}, so it cannot be in a list of labels")
    return joint.join(parts)


def _material(name: Any, forbidden: str) -> str:
    """Check the name of a material that is followed by its labels."""
    if not isinstance(name, str):
        raise TypeError(f"the name of a material must be a text, not {name!r}")
    if any(mark in name for mark in forbidden) or not name or name != name.strip():
        raise ValueError(
            f"{name!r}: a name must not be empty, begin or end with a blank, or contain one of {forbidden!r}"
        )
    return name


def _pair(name: Any) -> str:
    """Return the name of a material, or of two materials as ``a/b``."""
    names = name if isinstance(name, tuple) and len(name) == 2 else (name,)
    if not all(isinstance(own, str) for own in names):
        raise TypeError(f"the name of a material must be a text, not {name!r}")
    return "/".join(names)


def _all(name: str, value: Any) -> list[Any]:
    if isinstance(value, (bytes, Mapping)) or not isinstance(value, Iterable):
        raise TypeError(f"{name} cannot be {value!r}")
    return list(value)


def scalar(name: str, value: Any, kind: str) -> str:
    """Return a number or a text as a word that parses to the same value."""
    if isinstance(value, str):
        return value
    if hasattr(value, "__fspath__") and kind == "text":
        return str(value)
    if isinstance(value, bool) or type(value).__name__ in ("bool_", "bool") or kind == "word":
        raise TypeError(f"{name} cannot be {value!r}")
    try:
        return str(operator.index(value))
    except TypeError:
        pass
    try:
        number = float(value)
    except (TypeError, ValueError):
        raise TypeError(f"{name} cannot be {value!r}") from None
    if not math.isfinite(number):
        raise ValueError(f"{name} must be finite, not {number}")
    # Rust reads the shortest text that Python writes as the same number
    return str(int(number)) if number.is_integer() and abs(number) < 2**53 else repr(number)
