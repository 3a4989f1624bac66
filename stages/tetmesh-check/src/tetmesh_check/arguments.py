"""The arguments of a run, and the files that they name."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from dataclasses import field as made_by
from pathlib import Path
from typing import Any, Literal

from tetmesh_check.checks import Limits
from tetmesh_check.density.arguments import DensityArguments, check_material
from tetmesh_check.errors import StageError
from tetmesh_check.export.formats import export_paths
from tetmesh_check.export.mesh import plain_names
from tetmesh_check.export.profiles import PROFILES
from tetmesh_check.fem.currents import ForwardArguments, check_names
from tetmesh_check.fibres.arguments import FibreArguments, check_tissue
from tetmesh_check.parsing import FORMATS, LINEAR_FORMATS, PRISMLESS_FORMATS, options
from tetmesh_check.parts.algebra import Definition
from tetmesh_check.parts.layers import Layers
from tetmesh_check.parts.names import OBJECT_NAMES
from tetmesh_check.parts.splits import Split
from tetmesh_check.parts.tags import Tag

_PARAMETERS = ("tet_size_factor", "method", "envelope", "stop_energy", "max_passes")


Method = Literal["auto", "ftetwild", "hxt", "tetgen"]
"""The tetrahedralizer. ``auto`` selects HXT for many materials, for quadratic tetrahedra and above
:data:`.MAX_FTETWILD_VERTICES`, and fTetWild otherwise. For one object, fTetWild is also used if HXT
is missing or fails, and may be used if the tetrahedra of HXT miss a limit of shape."""


@dataclass(frozen=True)
class Arguments:
    """The arguments of the command line."""

    surface: Path
    output: Path
    sizefield: Path | None = None
    distfield: Path | None = None
    """The field F whose zero set is the surface. Required for quadratic tetrahedra only."""
    order: int = 1
    """Order of the tetrahedra: with 2, tetrahedra with a node on each edge are written as well."""
    pictures: Path | None = None
    labels_volume: Path | None = None
    profile: str | None = None
    """Program of :data:`.PROFILES` that the tetrahedra are written for."""
    exports: tuple[str, ...] = ()
    """Further formats to write, of :data:`.FORMATS` or of the profile."""
    space: str | None = None
    """World frame of the output: lps, ras or scanner; by default that of the surface."""
    unit: str = "mm"
    """Unit of the coordinates in these formats."""
    tet_size_factor: float = 1.0
    """Tetrahedron edge length over h."""
    method: Method = "auto"
    """See :data:`Method`."""
    envelope: float | None = None
    """Maximum distance by which fTetWild moves the surface, mm; by default derived from h."""
    stop_energy: float | None = None
    """Maximum AMIPS energy at which fTetWild stops; by default each of :data:`.STOP_ENERGIES` in
    turn."""
    max_passes: int = 80
    max_seconds: float = 3600.0
    limits: Limits = made_by(default_factory=Limits)
    solve: str = "auto"
    """Whether problems are solved on the tetrahedra: auto, yes or no."""
    solve_seconds: float = 600.0
    forward: ForwardArguments = made_by(default_factory=ForwardArguments)
    """For many materials: conductivities and the source of a current."""
    density: DensityArguments | None = None
    """Density and stiffness of the elements from a scan."""
    fibres: FibreArguments | None = None
    """Directions of heart muscle."""
    tags: tuple[Tag, ...] = ()
    sets: tuple[Definition, ...] = ()
    splits: tuple[Split, ...] = ()
    """The interfaces to split, with the widths of their gaps."""
    layers: tuple[Layers, ...] = ()
    """The prism layers on walls."""

    @property
    def name(self) -> str:
        """Name of the case: the output without ``.volume.vtu`` or ``.vtu``."""
        return self.output.name.removesuffix(".vtu").removesuffix(".volume")

    @property
    def log(self) -> Path:
        """Path of the log of the tetrahedralizer."""
        return self.output.with_name(f"{self.name}.tetrahedra.log")

    @property
    def quadratic(self) -> Path:
        """Path of the quadratic tetrahedra."""
        return self.output.with_name(f"{self.name}.volume.quadratic.vtu")

    def export_paths(self, many: bool = False, parts: Iterable[str] = ()) -> list[Path]:
        """Return the files of the exports. For many materials, some have other names."""
        return export_paths(self.output, self.name, self.exports, many, parts)

    def output_paths(self) -> list[Path]:
        """Return the files to be written. Pictures are included only if their folder exists."""
        quadratic = [self.quadratic] if self.order == 2 else []
        pictures = [path for path in self.picture_paths().values() if path.parent.is_dir()]
        return [self.output, *quadratic, *self.export_paths(), *pictures]

    def refuse(self) -> None:
        """Refuse outputs other than ``.vtu``, and invalid combinations of options."""
        if self.output.suffix != ".vtu":
            raise StageError(
                f"{self.output}: does not end in .vtu",
                "the volume mesh is written in the VTK format for unstructured grids",
                "name the output NAME.volume.vtu",
            )
        if (self.tags or self.sets or self.splits) and self.profile and PROFILES[self.profile].number:
            raise StageError(
                f"--tag, --set, --sets, --split or --gap with --for {self.profile}",
                f"{self.profile} expects exactly one surface per tissue, and no other groups",
                "omit these options, or use --export",
            )
        self._refuse_with_layers()
        if self.order == 1:
            return
        if self.distfield is None:
            raise StageError(
                "--order 2 without --distfield",
                "the midpoints of surface edges are moved onto the zero set of the distance field",
                "add --distfield CASE.distfield.vti",
            )
        self._refuse_formats(LINEAR_FORMATS, "quadratic elements", "--order 2", "--order 2")

    def _refuse_with_layers(self) -> None:
        """Refuse what prism layers do not support."""
        if not self.layers:
            return
        for option, is_given, why in (
            ("--order 2", self.order == 2, "there are no quadratic prisms"),
            ("--split or --gap", self.splits, "both options duplicate the nodes of interfaces"),
            ("--density", self.density, "only tetrahedra get a density"),
            ("--fibres", self.fibres, "only tetrahedra get fibres"),
            ("--for fenicsx", self.profile == "fenicsx", "dolfinx reads only meshes with one kind of element"),
        ):
            if is_given:
                raise StageError(f"{self.layers[0].told} with {option}", why, "omit one of the two options")
        self._refuse_formats(PRISMLESS_FORMATS, "prisms", self.layers[0].told, "--layers")

    def _refuse_formats(self, lacking: tuple[str, ...], elements: str, given: str, option: str) -> None:
        """Refuse exports in formats that lack the elements that ``option`` adds."""
        if found := [kind for kind in self.exports if kind in lacking]:
            export = f"--for {self.profile}" if self.profile else f"--export {','.join(found)}"
            raise StageError(
                f"{export} with {given}",
                f"{', '.join(found)} files are not written with {elements}",
                f"omit {export if self.profile else ', '.join(found)}, or omit {option}; {elements} are supported by "
                f"{', '.join(kind for kind in FORMATS if kind not in lacking)}",
            )

    def check_material_names(self, names: Sequence[str]) -> None:
        """Refuse materials that options do not allow. An empty list means one object."""
        check_names(self.forward, names)
        check_material(self.density, names)
        check_tissue(self.fibres, names)
        known = names or OBJECT_NAMES[1:]
        for layers in self.layers:
            if layers.material and layers.material not in (*known, *plain_names(list(known))):
                raise StageError(
                    f"{layers.told}: there is no material '{layers.material}'",
                    "the layers are made from its elements",
                    f"use one of {', '.join(known)}",
                )
        number = PROFILES[self.profile].number if self.profile else None
        if number is not None:
            number(names)

    def refuse_for_materials(self) -> None:
        """Refuse values of options that ``options.toml`` allows for one object only."""
        for option in options():
            rule, value = option.get("one_object"), getattr(self, option["name"].replace("-", "_"), None)
            if rule and value not in (option.get("default"), *rule.get("allowed", ())):
                raise StageError(
                    f"--{option['name']} {value} supports one object only, and the surface has several materials",
                    rule["why"],
                    rule["next"],
                )

    def picture_paths(self, many: bool = True) -> dict[str, Path]:
        """Return the pictures by kind, in order. Only many materials have the kind ``regions``."""
        if self.pictures is None:
            return {}
        kinds = ("surface", "closeup", "cut", *(["regions"] if many else []))
        return {kind: self.pictures / f"{self.name}.{kind}.png" for kind in kinds}

    def parameters(self) -> dict[str, Any]:
        """Return the parameters for the history. Defaults that depend on inputs are set later."""
        limits = asdict(self.limits)
        return {
            **{name: getattr(self, name) for name in _PARAMETERS},
            **{name: value for name, value in limits.items() if name != "accept_forced" or value},
            "solve": self.solve,
            **({} if self.order == 1 else {"order": self.order}),
            **({} if self.density is None else {"density": self.density.parameters()}),
            **({} if self.fibres is None else {"fibres": self.fibres.parameters()}),
            **({} if self.forward.source is None else {"forward": asdict(self.forward)}),
            **({} if not self.tags else {"tags": {tag.name: tag.text for tag in self.tags}}),
            **({} if not self.sets else {"sets": {one.name: one.text for one in self.sets}}),
            **({} if not self.splits else {"splits": [split.text for split in self.splits]}),
            **({} if not self.layers else {"layers": [layers.wall.text for layers in self.layers]}),
        }
