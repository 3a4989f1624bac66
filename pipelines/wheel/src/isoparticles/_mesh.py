"""The results of all stages together."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

from isoparticles._errors import Error
from isoparticles._fill import Tetrahedra, fill
from isoparticles._progress import Progress
from isoparticles._report import Report, read_report
from isoparticles._results import ENDINGS, DistanceField, Particles, SizeField, Surface, refuse_existing
from isoparticles._stages import load, reconstruct, size_field

if TYPE_CHECKING:
    import pyvista


def updated_size(folder: Path, name: str) -> Path:
    """Return the path of the size field after updates. The case runner uses the same path."""
    return folder / "updates" / f"{name}.{ENDINGS['sizefield']}"


def is_saved(path: Path, result: DistanceField | SizeField | Particles | Surface) -> bool:
    """Return whether a file contains a result, judged by its history."""
    try:
        return path.exists() and load(path).history == result.history
    except Error:
        return False


class Mesh:
    """The results of all stages; see :func:`isoparticles.mesh`."""

    name: str
    """The name of the results in histories and in :meth:`save`."""
    field: DistanceField
    """The signed distance, or the indicators of the materials."""
    size: SizeField
    """The target edge length h, after all updates."""
    seeds: Particles
    """The initial particles."""
    particles: Particles
    """The settled particles."""
    result: Surface
    """The surface as NumPy arrays; see :attr:`surface` for PyVista data."""

    def __init__(
        self,
        name: str,
        field: DistanceField,
        size: SizeField,
        seeds: Particles,
        particles: Particles,
        result: Surface,
        filling: Mapping[str, Any],
        first_size: SizeField | None = None,
    ) -> None:
        self.name = name
        self.field = field
        self.size = size
        self.seeds = seeds
        self.particles = particles
        self.result = result
        self._filling = filling
        # the size field before the updates; None without updates
        self._first_size = first_size

    @classmethod
    def open(cls, folder: str | PathLike[str], name: str | None = None) -> Mesh:
        """Read the files of a finished case.

        Parameters
        ----------
        folder
            The folder with ``NAME.distfield.vti`` and the files of the other stages. Instead of
            ``NAME.surface.vtp``, it may contain ``NAME.surface.failed.vtp``.
        name
            The name of the case. Default: the name of the folder.

        Raises
        ------
        Error
            If a file is missing or has another kind.
        """
        folder = Path(folder)
        name = folder.resolve().name if name is None else name
        results: list[Any] = []
        for stage, made in zip(ENDINGS, (DistanceField, SizeField, Particles, Particles, Surface), strict=True):
            path = folder / f"{name}.{ENDINGS[stage]}"
            failed = path.with_suffix(f".failed{path.suffix}")
            result = load(failed if failed.exists() and not path.exists() else path)
            if not isinstance(result, made):
                raise Error(f"{path}: {result.kind}", f"{stage} writes another kind", "run the case again")
            results.append(result)
        field, size, seeds, particles, surface = results
        updated = updated_size(folder, name)
        last: Any = load(updated) if updated.exists() else size
        # the folder may contain the size field of another mesh
        if last.history not in [used.get("history") for used in surface.history["inputs"]]:
            last = size
        return cls(name, field, last, seeds, particles, surface, {}, None if last is size else size)

    @property
    def stages(self) -> dict[str, DistanceField | SizeField | Particles | Surface]:
        """The results by the names of the programs."""
        results: tuple[DistanceField | SizeField | Particles | Surface, ...]
        results = (self.field, self.size, self.seeds, self.particles, self.result)
        return dict(zip(("distfield", "sizefield", "seed", "particles", "reconstruct"), results, strict=True))

    @cached_property
    def surface(self) -> pyvista.PolyData:
        """The surface as PyVista data."""
        return self.result.to_pyvista()

    @cached_property
    def filled(self) -> Tetrahedra:
        """The tetrahedra by :func:`isoparticles.fill`, made on first use: seconds to minutes."""
        options: Any = self._filling
        return fill(self.result, self.size, name=f"{self.name}.volume.vtu", **options)

    @cached_property
    def tetrahedra(self) -> pyvista.UnstructuredGrid:
        """The tetrahedra as PyVista data; see :attr:`filled`."""
        return self.filled.to_pyvista()

    @cached_property
    def report(self) -> Report:
        """The checks, the quality of the triangles, the volumes and the reports of the stages.

        Raises
        ------
        Error
            If the mesh was read from files, which contain no reports.
        """
        reports = {stage: result.report for stage, result in self.stages.items() if result.report is not None}
        if len(reports) < len(self.stages):
            raise Error(
                f"{self.name}: the mesh was read from files, without the reports of the stages",
                "they contain the checks and the quality",
                "see failed_checks for the checks, or make the mesh with isoparticles.mesh",
            )
        return read_report(reports)

    @property
    def failed_checks(self) -> list[str]:
        """The failed checks of all stages."""
        return [check for result in self.stages.values() for check in result.failed_checks]

    def update(self, *resize: str, progress: Progress = None) -> Mesh:
        """Return a mesh with another edge length in some regions; this mesh does not change.

        Only the surface in the regions and in a rim around them changes. The positions of all other
        vertices stay the same, bit for bit.

        Parameters
        ----------
        resize
            The regions with their edge lengths, as for the option ``--resize`` of ``sizefield``:
            ``ball:X,Y,Z,RADIUS=H`` or ``mask:FILE=H``, in world coordinates and mm. They are
            applied one after the other.
        progress
            As for :func:`isoparticles.distance_field`.

        Examples
        --------
        >>> import numpy as np
        >>> import isoparticles as iso
        >>> x, y, z = np.mgrid[:16, :16, :16] - 7.5
        >>> mesh = iso.mesh(5 - np.sqrt(x**2 + y**2 + z**2), iso=0, size=1.5, backend="cpu")
        >>> finer = mesh.update("ball:12.5,7.5,7.5,2=0.6")
        >>> len(finer.result.vertices) > len(mesh.result.vertices)
        True
        """
        shared = {key: self._filling[key] for key in ("threads", "max_memory") if key in self._filling}
        accepted = {key: self._filling[key] for key in ("accept_forced",) if key in self._filling}
        size, result = self.size, self.result
        if not resize:
            return self
        for region in resize:
            size = size_field(self.field, update=size, resize=region, name=size.name, progress=progress, **shared)
            result = reconstruct(result, self.field, size, name=result.name, progress=progress, **shared, **accepted)
        first = self._first_size or self.size
        return Mesh(self.name, self.field, size, self.seeds, self.particles, result, self._filling, first)

    def save(self, folder: str | PathLike[str], name: str | None = None, *, overwrite: bool = False) -> None:
        """Write ``NAME.distfield.vti`` and the files of the other stages to a folder.

        The size field of an updated mesh is written to the subfolder ``updates``, and that before
        the updates to ``NAME.sizefield.vti``. A file that already contains the same result is left
        as it is, so that the next run of the case does not repeat its stage.

        Raises
        ------
        FileExistsError
            If a file exists and ``overwrite`` is false.
        """
        name = self.name if name is None else name
        paths: dict[Path, DistanceField | SizeField | Particles | Surface]
        paths = {Path(folder) / f"{name}.{ENDINGS[stage]}": result for stage, result in self.stages.items()}
        updated = updated_size(Path(folder), name)
        if self._first_size is not None:
            paths |= {Path(folder) / f"{name}.{ENDINGS['sizefield']}": self._first_size, updated: self.size}
        offending = Path(folder) / f"{name}.surface.offending.vtp"
        refuse_existing([*paths, offending], overwrite)
        for path, result in paths.items():
            if not is_saved(path, result):
                path.parent.mkdir(parents=True, exist_ok=True)
                result.save(path, overwrite=True)
        if self._first_size is None:
            updated.unlink(missing_ok=True)

    def __repr__(self) -> str:
        checks = f"; failed checks: {'; '.join(self.failed_checks)}" if self.failed_checks else ""
        return f"<Mesh {self.name!r}: {self.result._told()}{checks}>"
