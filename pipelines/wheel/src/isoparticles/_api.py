"""All stages in one call."""

from __future__ import annotations

import shlex
from typing import TYPE_CHECKING, Unpack

from numpy.typing import ArrayLike

from isoparticles import _native, _stages
from isoparticles._images import Image, source
from isoparticles._mesh import Mesh
from isoparticles._progress import Progress
from isoparticles._results import ENDINGS
from isoparticles._words import refuse_unknown, settings_of, words_of

if TYPE_CHECKING:
    from isoparticles._options import MeshSettings


def mesh(
    image: Image,
    *,
    spacing: ArrayLike | None = None,
    origin: ArrayLike | None = None,
    direction: ArrayLike | None = None,
    dataset: str | None = None,
    name: str | None = None,
    progress: Progress = None,
    **settings: Unpack[MeshSettings],
) -> Mesh:
    """Mesh the surface of an object, or the interfaces of several materials.

    Parameters
    ----------
    image, spacing, origin, direction, dataset, progress
        As for :func:`distance_field`.
    name
        The name of the results in histories and in :meth:`Mesh.save`. Default: the name of the
        file without its extension, or ``mesh``.
    **settings
        The settings of ``make surface``, in lower case. ``iso``, ``labels`` or ``materials`` is
        required. The stages choose the values of the other settings; see the options of the stages.

    Examples
    --------
    >>> import numpy as np
    >>> import isoparticles as iso
    >>> x, y, z = np.mgrid[:16, :16, :16] - 7.5
    >>> result = iso.mesh(5 - np.sqrt(x**2 + y**2 + z**2), iso=0, size=1.5, backend="cpu")
    >>> result.failed_checks
    []
    >>> abs(result.result.vertices[:, 0].max() - 5 - 7.5) < 0.5
    np.True_
    """
    given = source(image, spacing, origin, direction, dataset)
    assignments = settings_of(settings)
    _stages.expect_object(settings)
    if name is None:
        name = _native.case_name(given.word) if given.is_file else "mesh"
    shared: list[str] = []
    for option, value in (("threads", settings.get("threads")), ("max_memory", settings.get("max_memory"))):
        shared += words_of("distfield", {option: value})
    words = {stage: [*own, *shared] for stage, own in _native.case_words(assignments)}
    for stage, own in words.items():
        refuse_unknown(stage, own)

    def called(stage: str) -> tuple[str, list[str], Progress]:
        return f"{name}.{ENDINGS[stage]}", words[stage], progress

    field = _stages.run_distfield(given, *called("distfield"))
    size = _stages.run_sizefield(field, None, *called("sizefield"))
    seeds = _stages.run_seed(field, size, *called("seed"))
    particles = _stages.run_particles(seeds, field, size, *called("particles"))
    surface = _stages.run_reconstruct(particles, field, size, *called("reconstruct"))
    passed = {key: value for key, value in settings.items() if key in ("accept_forced", "threads", "max_memory")}
    made = Mesh(name, field, size, seeds, particles, surface, {"progress": progress, **passed})
    return made.update(*shlex.split(settings.get("resize", "")), progress=progress)
