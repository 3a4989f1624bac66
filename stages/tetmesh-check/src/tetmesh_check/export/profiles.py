"""Profiles: format, unit, frame and material numbers that each program of ``--for`` requires.

``simnibs`` follows ``simnibs/utils/mesh_element_properties.py`` and
``reconstruct_unique_surface`` in ``simnibs/mesh_tools/mesh_io.py`` of SimNIBS 4. ``brainstorm``
follows ``toolbox/io/in_tess.m`` and ``external/other/mesh_load_gmsh4.m`` of Brainstorm: files of
SimNIBS 4, in mm and RAS.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from operator import itemgetter

import numpy as np
from numpy.typing import NDArray

from tetmesh_check.errors import StageError
from tetmesh_check.export.mesh import SURFACE_NUMBER, MarkedMesh
from tetmesh_check.materials import NOBODY, NOTHING
from tetmesh_check.quality import Labels

_TISSUES = {
    1: ("white", "wm", "white_matter"),
    2: ("gray", "grey", "gm", "gray_matter", "grey_matter"),
    3: ("csf", "cerebrospinal_fluid"),
    4: ("bone", "skull"),
    5: ("scalp", "skin"),
    6: ("eye", "eyes", "eye_balls", "eyeballs"),
    7: ("compact_bone", "cortical_bone"),
    8: ("spongy_bone", "cancellous_bone"),
    9: ("blood",),
    10: ("muscle", "muscles"),
}
"""Tissue numbers of SimNIBS, with names of materials that have them. Numbers above 10 differ
between versions of SimNIBS, and between SimNIBS and Brainstorm."""
_PRIORITY = (1, 2, 9, 3, 4, 8, 7, 6, 10, 5)
"""Precedence in SimNIBS: an interface belongs to the surface of the tissue that comes first."""


@dataclass(frozen=True)
class Profile:
    """What a program expects of a mesh."""

    kinds: tuple[str, ...]
    """Formats to write."""
    unit: str | None = None
    """Unit of the coordinates; ``None`` if the program accepts any."""
    space: str | None = None
    """World frame; ``None`` if the program accepts any."""
    number: Callable[[Sequence[str]], list[int]] | None = None
    """Returns the numbers of named materials; ``None`` if the program accepts any numbers."""


def tissue_numbers(names: Sequence[str]) -> list[int]:
    """Return the SimNIBS numbers of materials, by their names or by names such as ``label_3``.

    Raises
    ------
    StageError
        If there are no materials, a name is unknown, or two names denote the same tissue.
    """
    option = "--for simnibs or brainstorm"
    why = "SimNIBS and Brainstorm find the conductivity of a tissue by its number"
    known = ", ".join(f"{number} {words[0]}" for number, words in _TISSUES.items())
    if not names:
        raise StageError(f"{option}: the surface is that of one object", why, f"mesh named materials: {known}")
    numbers: dict[int, str] = {}
    for name in names:
        word = re.sub(r"[^a-z0-9]+", "_", name.lower()).strip("_")
        found = [number for number, words in _TISSUES.items() if word in words or word == f"label_{number}"]
        if not found:
            raise StageError(f"{option}: '{name}' is not a tissue", why, f"rename the material to one of {known}")
        if found[0] in numbers:
            twice = f"{option}: '{numbers[found[0]]}' and '{name}' are both tissue {found[0]}"
            raise StageError(twice, why, "join their labels to one material, such as bone:4+7")
        numbers[found[0]] = name
    return list(numbers)


_TISSUE_PROFILE = Profile(("simnibs",), "mm", "ras", tissue_numbers)
PROFILES = {
    "simnibs": _TISSUE_PROFILE,
    "brainstorm": _TISSUE_PROFILE,
    "opencarp": Profile(("carp",), "um"),
    "febio": Profile(("feb",), "mm"),
    "calculix": Profile(("inp",)),
    "fenicsx": Profile(("msh",)),
    "simvascular": Profile(("simvascular",)),
}
"""The programs of ``--for``."""


def resolve(
    name: str | None, kinds: tuple[str, ...], space: str | None, unit: str | None
) -> tuple[tuple[str, ...], str | None, str]:
    """Return the formats, frame and unit of a run: those of the profile, otherwise the given ones.

    Parameters
    ----------
    name
        Of :data:`PROFILES`, or ``None`` for no profile.
    kinds, space, unit
        The values of ``--export``, ``--space`` and ``--unit``; empty or ``None`` if not given.

    Raises
    ------
    StageError
        If a given value contradicts the profile.
    """
    if name is None:
        return kinds, space, unit or "mm"
    profile = PROFILES[name]
    given = {"export": ",".join(kinds), "space": space, "unit": unit}
    due = {"export": ",".join(profile.kinds), "space": profile.space, "unit": profile.unit}
    for option, value in given.items():
        if value and due[option] and value != due[option]:
            raise StageError(
                f"--{option} {value} with --for {name}",
                f"--for {name} chooses the format" if option == "export" else f"{name} expects {due[option]}",
                f"omit --{option}, or omit --for {name} and choose --export, --space and --unit yourself",
            )
    return profile.kinds, profile.space or space, profile.unit or unit or "mm"


def renumbered(mesh: MarkedMesh, profile: str | None) -> MarkedMesh:
    """Return the mesh with the numbers of a profile, if it has any.

    Parameters
    ----------
    mesh
        Many materials whose names the profile accepts.
    profile
        Of :data:`PROFILES`, or ``None``.
    """
    number = PROFILES[profile].number if profile else None
    if number is None:
        return mesh
    numbers = number([row["material"] for row in mesh.table])
    new_of = dict(zip((row["region"] for row in mesh.table), numbers, strict=True))
    present, which = np.unique(mesh.regions, return_inverse=True)
    regions = np.array([new_of.get(region, NOTHING) for region in present.tolist()], dtype=np.int64)[which]
    marks, is_flipped = _surfaces(regions, mesh.owners, mesh.before)
    faces = mesh.faces.copy()
    faces[is_flipped] = faces[is_flipped][:, [0, 2, 1]]
    names = {new_of[row["region"]]: row["name"] for row in mesh.table}
    return replace(
        mesh,
        regions=regions,
        faces=faces,
        owners=np.where(is_flipped, mesh.before, mesh.owners),
        before=np.where(is_flipped, mesh.owners, mesh.before),
        marks=marks,
        table=sorted(({**row, "region": new_of[row["region"]]} for row in mesh.table), key=itemgetter("region")),
        caps=frozenset(),
        parts={SURFACE_NUMBER + own: f"{names[own]}_surface" for own in sorted(names)},
    )


def _surfaces(regions: Labels, owners: Labels, before: Labels) -> tuple[Labels, NDArray[np.bool_]]:
    """Return the surface number of each triangle, and whether it must be flipped.

    It must be flipped if the tissue of its surface lies in front of it.
    """
    rank = np.full(max(_TISSUES) + 1, len(_PRIORITY))
    rank[list(_PRIORITY)] = np.arange(len(_PRIORITY))
    behind, front = (np.where(at == NOBODY, NOTHING, regions[at]) for at in (owners, before))
    is_flipped = rank[front] < rank[behind]
    return np.asarray(SURFACE_NUMBER + np.where(is_flipped, front, behind)), np.asarray(is_flipped)
