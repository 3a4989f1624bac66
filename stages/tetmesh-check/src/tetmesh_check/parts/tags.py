"""Tags: shapes that give the triangles inside them a name."""

from __future__ import annotations

import math
from dataclasses import dataclass

from tetmesh_check.parts.algebra import Node, check_name, read_expression

_FORMS = {"ball": "X,Y,Z,RADIUS", "plane": "X,Y,Z,NX,NY,NZ"}
"""The numbers of each shape."""
OUTER_BOUNDARY = "outside"
"""Where a tag applies by default."""


@dataclass(frozen=True)
class Tag:
    """A ball, or the half-space on the side of a plane that its normal points to."""

    name: str
    text: str
    """The shape and the expression as given."""
    shape: str
    numbers: tuple[float, ...]
    """In the world frame of the output, mm: a position, and the radius or the normal."""
    node: Node
    """The expression whose triangles the tag applies to."""


def read_tag(text: str) -> Tag:
    """Parse ``SHAPE=NAME`` or ``SHAPE & EXPRESSION=NAME``, with the shapes :data:`_FORMS`.

    Raises ``ValueError`` if it is malformed.
    """
    given, equals, name = text.partition("=")
    place, ampersand, expression = given.partition("&")
    shape, _, listed = place.strip().partition(":")
    if shape not in _FORMS or not equals:
        known = " or ".join(f"{shape}:{form}=NAME" for shape, form in _FORMS.items())
        raise ValueError(f"'{text}' is not {known}")
    try:
        numbers = tuple(float(word) for word in listed.split(","))
    except ValueError:
        numbers = ()
    if len(numbers) != len(_FORMS[shape].split(",")) or not all(map(math.isfinite, numbers)):
        raise ValueError(f"'{text}': a {shape} needs the numbers {_FORMS[shape]}")
    if shape == "ball" and numbers[3] <= 0.0:
        raise ValueError(f"'{text}': the radius must be above 0")
    if shape == "plane" and not any(numbers[3:]):
        raise ValueError(f"'{text}': the normal must not be 0,0,0")
    return Tag(
        check_name(name.strip()),
        given.strip(),
        shape,
        numbers,
        read_expression(expression if ampersand else OUTER_BOUNDARY),
    )
