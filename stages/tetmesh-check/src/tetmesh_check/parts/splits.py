"""Interfaces to split, and the widths of their gaps."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from tetmesh_check.parts.algebra import Node, read_expression


@dataclass(frozen=True)
class Split:
    """An interface whose nodes are doubled."""

    text: str
    """The option as given."""
    node: Node
    """The interface A/B."""
    width: float = 0.0
    """Width of the gap, mm; 0 if the sides coincide."""


def read_split(text: str) -> Split:
    """Parse ``A/B``; raise ``ValueError`` if it is malformed."""
    node = read_expression(text)
    if len(node.names) != 2:
        raise ValueError(f"'{text}' is not an interface A/B")
    return Split(f"--split {text}", node)


def read_gap(text: str) -> Split:
    """Parse ``A/B=WIDTH``; raise ``ValueError`` if it is malformed."""
    interface, _, number = text.rpartition("=")
    try:
        width = float(number)
    except ValueError:
        width = math.nan
    if not interface or not 0.0 < width < math.inf:
        raise ValueError(f"'{text}' is not A/B=WIDTH with a width above 0, mm")
    return replace(read_split(interface), text=f"--gap {text}", width=width)
