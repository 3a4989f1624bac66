"""The results of all stages together."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

from isoparticles._fill import Tetrahedra, fill
from isoparticles._report import Report, read_report
from isoparticles._results import ENDINGS, DistanceField, Particles, SizeField, Surface, refuse_existing

if TYPE_CHECKING:
    import pyvista


class Mesh:
    """The results of all stages; see :func:`isoparticles.mesh`."""

    name: str
    """The name of the results in histories and in :meth:`save`."""
    field: DistanceField
    """The signed distance, or the indicators of the materials."""
    size: SizeField
    """The target edge length h."""
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
    ) -> None:
        self.name = name
        self.field = field
        self.size = size
        self.seeds = seeds
        self.particles = particles
        self.result = result
        self._filling = filling

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
        """The checks, the quality of the triangles, the volumes and the reports of the stages."""
        return read_report({stage: result.report or {} for stage, result in self.stages.items()})

    @property
    def failed_checks(self) -> list[str]:
        """The failed checks of all stages."""
        return [check for result in self.stages.values() for check in result.failed_checks]

    def save(self, folder: str | PathLike[str], name: str | None = None, *, overwrite: bool = False) -> None:
        """Write ``NAME.distfield.vti`` and the files of the other stages to a folder.

        Raises
        ------
        FileExistsError
            If a file exists and ``overwrite`` is false.
        """
        name = self.name if name is None else name
        paths = {Path(folder) / f"{name}.{ENDINGS[stage]}": result for stage, result in self.stages.items()}
        offending = Path(folder) / f"{name}.surface.offending.vtp"
        refuse_existing([*paths, offending], overwrite)
        Path(folder).mkdir(parents=True, exist_ok=True)
        for path, result in paths.items():
            result.save(path, overwrite=True)

    def __repr__(self) -> str:
        checks = f"; failed checks: {'; '.join(self.failed_checks)}" if self.failed_checks else ""
        return f"<Mesh {self.name!r}: {self.result._told()}{checks}>"
