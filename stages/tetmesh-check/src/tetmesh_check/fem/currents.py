"""The problem of a current source in one of many materials: options and description."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from tetmesh_check.errors import StageError
from tetmesh_check.materials import Conformity, Sides
from tetmesh_check.quality import Cells, Values


@dataclass(frozen=True)
class ForwardArguments:
    """The options of the problem of currents. Materials are given by name."""

    conductivity: Mapping[str, float] = field(default_factory=dict)
    """Conductivity by material, S/m."""
    source: str | None = None
    """The material of the current source. Without one, the problem is not solved."""
    density: tuple[float, float, float] = (1.0, 0.0, 0.0)
    """Density of the impressed current in the world frame of the output, uA/mm^2."""


@dataclass(frozen=True)
class Forward:
    """A problem of currents on conforming tetrahedra."""

    arguments: ForwardArguments
    sides: Sides
    """The materials on both sides of each triangle."""
    triangles: Cells
    """Triangles between two materials, shape ``(k, 3)``."""
    found: Conformity
    """The material of each tetrahedron, and the tetrahedra on both sides of each triangle."""
    density: Values
    """Density of the impressed current in the frame of the tetrahedra, uA/mm^2, shape ``(3,)``."""


def check_names(arguments: ForwardArguments, names: Sequence[str]) -> None:
    """Refuse unknown names of materials, and a conductivity without a source.

    Parameters
    ----------
    arguments
        The options.
    names
        The names of the materials; empty for one object.

    Raises
    ------
    StageError
        If there is no material with such a name, if there is only one object, or if a conductivity
        is given without a source.
    """
    given = [*arguments.conductivity, *([] if arguments.source is None else [arguments.source])]
    if given and not names:
        raise StageError(
            "--conductivity and --source name materials, and the surface is that of one object",
            "currents through tissues of different conductivity need a mesh of all of them",
            "give the surface of many materials, or leave them out",
        )
    for name in given:
        if name not in names:
            raise StageError(
                f"'{name}' is not a material of the surface: {', '.join(names)}",
                "--conductivity and --source take their names",
                "check the name",
            )
    if given and arguments.source is None:
        raise StageError(
            "--conductivity was given without --source",
            "without a current there is no potential to solve for",
            "add --source NAME, the material in which the current arises, such as the heart",
        )
