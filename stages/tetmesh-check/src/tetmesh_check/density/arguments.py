"""The options of the density, and their combinations."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from tetmesh_check.density.laws import Calibration, Law
from tetmesh_check.errors import StageError

DEFAULT_BINS = 100
"""Each element differs from its bin by at most the width of the bin: 1 % of the range of E."""


@dataclass(frozen=True)
class DensityArguments:
    """The options of the density."""

    path: Path
    calibration: Calibration
    law: Law
    material: str | None
    """Name of the material that gets the density; ``None`` for one object."""
    bins: int
    """Number of material cards."""

    def parameters(self) -> dict[str, Any]:
        """Return the parameters for the history."""
        return {**asdict(self), "path": self.path.name}


def density_arguments(given: Mapping[str, Any]) -> DensityArguments | None:
    """Return the options of the density, or ``None`` without ``--density``.

    Parameters
    ----------
    given
        The values of all options by name.

    Raises
    ------
    StageError
        If options are given that need each other.
    """
    names = {"calibrate": "--calibrate", "law": "--law", "density_of": "--density-of", "bins": "--bins"}
    if given["density"] is None:
        alone = [option for name, option in names.items() if given[name] is not None]
        if alone:
            raise StageError(
                f"{', '.join(alone)} without --density",
                "there are no grey values to map onto the tetrahedra",
                "add --density with the scan, or omit the other options",
            )
        return None
    missing = [names[name] for name in ("calibrate", "law") if given[name] is None]
    if missing:
        raise StageError(
            f"--density without {' and '.join(missing)}",
            "grey values become densities by a calibration, and densities become stiffness by a law",
            "add --calibrate SLOPE,INTERCEPT (1,0 if the volume holds g/cm^3) and --law NAME",
        )
    return DensityArguments(
        given["density"], given["calibrate"], given["law"], given["density_of"], given["bins"] or DEFAULT_BINS
    )


def check_material(arguments: DensityArguments | None, names: Sequence[str]) -> None:
    """Refuse a density for an unknown material, or for several materials at once.

    Parameters
    ----------
    arguments
        The options, if a density is given.
    names
        The names of the materials; empty for one object.
    """
    if arguments is None or arguments.material in names or (arguments.material is None and len(names) < 2):
        return
    chosen = "without --density-of" if arguments.material is None else f"--density-of {arguments.material}"
    raise StageError(
        f"--density {chosen}: the surface is that of {', '.join(names) or 'one object'}",
        "a law is for one material",
        "name one of these materials" if names else "omit --density-of",
    )
