"""The stages as functions."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from os import PathLike, fsdecode
from typing import TYPE_CHECKING, TypeVar, Unpack

from numpy.typing import ArrayLike

from isoparticles import _native
from isoparticles._errors import warn
from isoparticles._images import Image, Source, source
from isoparticles._progress import Progress, shown
from isoparticles._results import ENDINGS, DistanceField, Particles, Result, SizeField, Surface, expect
from isoparticles._words import words_of

if TYPE_CHECKING:
    from isoparticles._options import (
        DistfieldOptions,
        ParticlesOptions,
        ReconstructOptions,
        SeedOptions,
        SizefieldOptions,
    )

R = TypeVar("R", bound=Result)


def distance_field(
    image: Image,
    *,
    spacing: ArrayLike | None = None,
    origin: ArrayLike | None = None,
    direction: ArrayLike | None = None,
    dataset: str | None = None,
    name: str = ENDINGS["distfield"],
    progress: Progress = None,
    **options: Unpack[DistfieldOptions],
) -> DistanceField:
    """Compute the signed distance of an object, or the indicators of several materials.

    Parameters
    ----------
    image
        The path of a volume or of a folder of DICOM slices or masks; an array with the axes x, y
        and z; an image of SimpleITK, nibabel or PyVista; or a mapping from names to masks, each one
        of these. HDF5, MATLAB and Zarr files need the extra ``formats``.
    spacing
        The distances between voxel centres along x, y and z, in mm, or one number for all. Only for
        arrays (default: 1) and for files that do not contain it.
    origin
        The world position of the centre of the first voxel, in mm. Only for arrays, and for HDF5,
        MATLAB and Zarr files that do not contain it. Default: 0.
    direction
        A 3 x 3 matrix whose columns are the unit vectors of the axes. As for ``origin``.
    dataset
        The array of an HDF5, MATLAB or Zarr file: a path in the file, the name of a variable, or a
        level of an OME-Zarr image. ``0:c=1`` selects channel 1 of level 0. Default: the only
        volume, or the first level.
    name
        The file name of the result in the histories of later results.
    progress
        A function that is called with the stage, the step, the completed work, the total work or
        None, and a message; or True for a bar on stderr, drawn by the package rich if there is one.
    **options
        The options of the program ``distfield``. ``iso``, ``labels`` or ``materials`` is required.

    Raises
    ------
    Error
        If the image does not contain the object, or if an option is invalid.

    Examples
    --------
    >>> import numpy as np
    >>> import isoparticles as iso
    >>> x, y, z = np.mgrid[:16, :16, :16] - 7.5
    >>> ball = (x**2 + y**2 + z**2 < 5**2).astype(np.uint8)
    >>> field = iso.distance_field(ball, spacing=(1, 1, 1), labels=[1])
    >>> field.array.min() < -4
    np.True_
    >>> halves = np.where(x < 0, ball, 2 * ball)
    >>> iso.distance_field(halves, materials={"left": 1, "right": [2]}).materials
    ['outside', 'left', 'right']
    """
    given = source(image, spacing, origin, direction, dataset)
    words = words_of("distfield", options)
    expect_object(options)
    return run_distfield(given, name, words, progress)


def run_distfield(given: Source, name: str, words: list[str], progress: Progress) -> DistanceField:
    # a path that is equal to the name of the result would count as the result in the history
    is_unclear = given.is_file and (given.word == name or given.word.startswith("-"))
    word = f"./{given.word}" if is_unclear else given.word
    if given.volume is not None and "--series" in words:
        raise TypeError("series: only for a folder of DICOM files")
    inputs = () if given.volume is None else (given.volume,)
    return _run(DistanceField, _native.distance_field, [word], inputs, name, [*words, *given.words], progress)


def size_field(
    field: DistanceField,
    *,
    update: SizeField | None = None,
    name: str = ENDINGS["sizefield"],
    progress: Progress = None,
    **options: Unpack[SizefieldOptions],
) -> SizeField:
    """Compute the target edge length h of the mesh, or change it in some regions.

    Parameters
    ----------
    field
        The distance field.
    update
        A size field. If given, the result is this field with the changes of ``resize``.
    name, progress
        As for :func:`distance_field`.
    **options
        The options of the program ``sizefield``.

    Examples
    --------
    >>> import numpy as np
    >>> import isoparticles as iso
    >>> x, y, z = np.mgrid[:16, :16, :16] - 7.5
    >>> field = iso.distance_field(5 - np.sqrt(x**2 + y**2 + z**2), iso=0)
    >>> size = iso.size_field(field, uniform=1.5)
    >>> size.array.shape == field.array.shape
    True
    """
    return run_sizefield(field, update, name, words_of("sizefield", options), progress)


def run_sizefield(
    field: DistanceField, update: SizeField | None, name: str, words: list[str], progress: Progress
) -> SizeField:
    expect(DistanceField, field=field)
    files, inputs = [field.name], [field._data]
    if update is not None:
        expect(SizeField, update=update)
        files += ["--update", update_input_path(update)]
        inputs.append(update._data)
    return _run(SizeField, _native.size_field, files, tuple(inputs), name, words, progress)


def update_input_path(result: SizeField | Surface) -> str:
    """Return a path for an input of an update, which may have the same name as the new result."""
    return f"previous/{result.name}"


def seed(
    field: DistanceField,
    size: SizeField,
    *,
    name: str = ENDINGS["seed"],
    progress: Progress = None,
    **options: Unpack[SeedOptions],
) -> Particles:
    """Place particles on the surface, at about the density that h requires.

    Parameters
    ----------
    field, size
        The distance field and the size field.
    name, progress
        As for :func:`distance_field`.
    **options
        The options of the program ``seed``. ``from_`` is its option ``--from``.
    """
    return run_seed(field, size, name, words_of("seed", options), progress)


def run_seed(field: DistanceField, size: SizeField, name: str, words: list[str], progress: Progress) -> Particles:
    expect(DistanceField, field=field)
    expect(SizeField, size=size)
    inputs = (field._data, size._data)
    return _run(Particles, _native.seed, [field.name, size.name], inputs, name, words, progress)


def settle(
    seeds: Particles,
    field: DistanceField,
    size: SizeField,
    *,
    name: str = ENDINGS["particles"],
    progress: Progress = None,
    **options: Unpack[ParticlesOptions],
) -> Particles:
    """Move particles over the surface until they form a nearly hexagonal lattice.

    Parameters
    ----------
    seeds, field, size
        The seeds, and the fields from which they were made.
    name, progress
        As for :func:`distance_field`.
    **options
        The options of the program ``particles``.
    """
    return run_particles(seeds, field, size, name, words_of("particles", options), progress)


def run_particles(
    seeds: Particles, field: DistanceField, size: SizeField, name: str, words: list[str], progress: Progress
) -> Particles:
    expect(Particles, seeds=seeds)
    expect(DistanceField, field=field)
    expect(SizeField, size=size)
    files = [seeds.name, "--distfield", field.name, "--sizefield", size.name]
    inputs = (seeds._data, field._data, size._data)
    return _run(Particles, _native.settle, files, inputs, name, words, progress)


def reconstruct(
    particles: Particles | Surface,
    field: DistanceField | None,
    size: SizeField | None = None,
    *,
    name: str = ENDINGS["reconstruct"],
    progress: Progress = None,
    **options: Unpack[ReconstructOptions],
) -> Surface:
    """Connect particles to a surface, or change a surface; improve its triangles, and check it.

    A surface that fails a check is a result: see ``failed_checks``.

    Parameters
    ----------
    particles
        Settled particles; or a surface made from ``field``. The surface is then changed where
        ``size`` differs from h at its vertices.
    field
        The distance field. It may be None with ``method="tight-cocone"``.
    size
        The size field; required for a surface. Default: the h of each particle.
    name, progress
        As for :func:`distance_field`.
    **options
        The options of the program ``reconstruct``.
    """
    return run_reconstruct(particles, field, size, name, words_of("reconstruct", options), progress)


def run_reconstruct(
    particles: Particles | Surface,
    field: DistanceField | None,
    size: SizeField | None,
    name: str,
    words: list[str],
    progress: Progress,
) -> Surface:
    if isinstance(particles, Surface):
        expect(SizeField, size=size)
        files = ["--update", update_input_path(particles)]
    else:
        expect(Particles, particles=particles)
        files = [particles.name]
    inputs = [particles._data]
    if field is not None:
        expect(DistanceField, field=field)
        files += ["--distfield", field.name]
        inputs.append(field._data)
    elif size is not None or "tight-cocone" not in words:
        raise ValueError("field=None requires method='tight-cocone', without a size field")
    if size is not None:
        expect(SizeField, size=size)
        files += ["--sizefield", size.name]
        inputs.append(size._data)
    return _run(Surface, _native.reconstruct, files, tuple(inputs), name, words, progress)


def load(path: str | PathLike[str]) -> DistanceField | SizeField | Particles | Surface:
    """Read a file that a stage has written.

    Raises
    ------
    Error
        If the file cannot be read or has another kind. Triangle surfaces (``.vtp``) of other
        programs are accepted.
    """
    data = _native.load(fsdecode(path))
    classes: tuple[type[DistanceField | SizeField | Particles | Surface], ...] = (
        DistanceField,
        SizeField,
        Particles,
        Surface,
    )
    (of_kind,) = (one for one in classes if data.kind in one.KINDS)
    return of_kind(data)


def expect_object(given: Mapping[str, object]) -> None:
    if all(given.get(name) is None for name in ("iso", "labels", "material", "materials")):
        raise TypeError("pass iso for a scan, labels for one object of a label map, or materials for several")


def _run(
    made: type[R],
    stage: Callable[..., _native.Finished],
    files: list[str],
    inputs: tuple[_native.Data | _native.Volume, ...],
    name: str,
    words: list[str],
    progress: Progress,
) -> R:
    """Run a stage with the arguments of its program; ``inputs`` are the data of ``files``."""
    if not isinstance(name, str) or not name or name.startswith("-") or set(name) & set("/\\\0"):
        raise ValueError(f"name={name!r}: must be a file name without a folder")
    if name in files:
        raise ValueError(f"name={name!r}: is also the name of an input")
    # clap would read a name that starts with a dash as an option
    given = [f"./{file}" if file.startswith("-") and not file.startswith("--") else file for file in files]
    with shown(progress) as callback:
        return made(*stage([*given, "-o", name, *words], {"progress": callback, "warn": warn}, *inputs))
