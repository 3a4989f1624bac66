from collections.abc import Callable, Iterator, Sequence
from os import PathLike
from pathlib import Path
from typing import Any, Protocol, Self, TypedDict, final

import numpy as np
from numpy.typing import NDArray

from isoparticles._errors import Error

ProgressCallback = Callable[[str, str, int, int | None, str], object]

class Watch(TypedDict):
    progress: ProgressCallback | None
    warn: Callable[[str], object]

@final
class Volume:
    def __new__(
        cls,
        slabs: Iterator[NDArray[Any]],
        dtype: str,
        size: Sequence[int],
        spacing: list[float],
        origin: list[float],
        axes: list[list[float]],
        space: str | None,
    ) -> Volume: ...
    @staticmethod
    def of_masks(masks: list[tuple[str, Volume | str]]) -> Volume: ...
    def name_labels(self, names: list[tuple[str, int]]) -> None: ...
    def hash(self) -> str: ...
    def write(self, path: str | PathLike[str], history: str) -> None: ...

@final
class Data:
    @property
    def kind(self) -> str: ...
    @property
    def name(self) -> str: ...
    @property
    def meta(self) -> str: ...
    @property
    def history(self) -> str: ...
    @property
    def materials(self) -> list[str]: ...
    @property
    def space(self) -> str | None: ...
    @property
    def grid(
        self,
    ) -> tuple[list[int], list[float], list[float], list[list[float]]] | None: ...
    @property
    def array_names(self) -> tuple[list[str], list[str]]: ...
    def array(self, name: str) -> tuple[str, list[int], bytes]: ...
    def write(self, path: str | PathLike[str]) -> None: ...
    def of_material(self, name: str) -> Data: ...

VERSION: str

class Context:
    def __new__(cls, words: Sequence[str], parsed: object, tool: str = ...) -> Self: ...
    @property
    def parameters(self) -> dict[str, Any]: ...
    @property
    def results(self) -> dict[str, Any]: ...
    @property
    def closing(self) -> list[tuple[str, str]]: ...
    @property
    def threads(self) -> int: ...
    @property
    def warnings(self) -> list[str]: ...
    def info(self, message: str) -> None: ...
    def verbose(self, message: str) -> None: ...
    def warn(self, message: str) -> None: ...
    def step(self, name: str) -> Step: ...
    def progress(self, label: str) -> Progress: ...
    def check_memory(self, needed: float, what: str, what_next: str, /) -> None: ...
    def check_outputs(self, outputs: Sequence[Path]) -> None: ...
    def add_input(self, path: Path, history: object) -> None: ...
    def add_value(self, path: Path, blake3: str) -> None: ...
    def history(self) -> dict[str, Any]: ...
    def close(self, failed: list[str], error: Error | None, interrupted: bool) -> int: ...

@final
class Step:
    def __enter__(self) -> None: ...
    def __exit__(self, *error: object) -> None: ...

class Progress(Protocol):
    def show(self, message: str) -> None: ...
    def close(self) -> None: ...

def check_output(path: Path, force: bool) -> None: ...
def check_memory(path: str | PathLike[str], needed: int) -> None: ...
def number_of_bytes(text: str) -> int: ...

Finished = tuple[Data, list[str], str]

def distance_field(words: list[str], watch: Watch, volume: Volume | None = None) -> Finished: ...
def size_field(words: list[str], watch: Watch, field: Data, previous: Data | None = None) -> Finished: ...
def seed(words: list[str], watch: Watch, field: Data, size: Data) -> Finished: ...
def settle(words: list[str], watch: Watch, seeds: Data, field: Data, size: Data) -> Finished: ...
def reconstruct(
    words: list[str], watch: Watch, points: Data, field: Data | None = None, size: Data | None = None
) -> Finished: ...
def load(path: str | PathLike[str]) -> Data: ...
def options() -> str: ...
def case_keys() -> str: ...
def case_name(path: str | PathLike[str]) -> str: ...
def case_words(settings: list[str]) -> list[tuple[str, list[str]]]: ...

# Points have the shape (n, 3) and are in mm. Triangles and tetrahedra are vertex indices of the
# shapes (m, 3) and (m, 4).
Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

def set_threads(count: int) -> None: ...
def triangle_quality(points: Floats, triangles: Integers) -> list[Floats]: ...
def tetrahedron_quality(points: Floats, tetrahedra: Integers) -> list[Floats]: ...
def tetrahedron_volumes(points: Floats, tetrahedra: Integers) -> Floats: ...
def summarize(numbers: Floats, edges: Sequence[float] | Floats | None = None) -> dict[str, Any]: ...

Counts = dict[str, int]

def surface_topology(vertices: int, triangles: Integers) -> Counts: ...

class Components(TypedDict):
    labels: Integers
    volumes: Floats
    depths: Integers
    parents: Integers

def surface_components(points: Floats, triangles: Integers) -> Components: ...
def self_intersections(points: Floats, triangles: Integers) -> Integers: ...
def changed_triangles(
    points: Floats, triangles: Integers, other_points: Floats, other_triangles: Integers
) -> list[int]: ...
def distances_both_ways(
    points: Floats, triangles: Integers, other_points: Floats, other_triangles: Integers
) -> tuple[Floats, Floats]: ...
def distances_to(positions: Floats, points: Floats, triangles: Integers) -> Floats: ...
def nearest_flags(
    points: Floats, triangles: Integers, other_points: Floats, other_triangles: Integers, flags: NDArray[np.uint8]
) -> NDArray[np.bool_]: ...
def tetrahedron_boundary(vertices: int, tetrahedra: Integers) -> tuple[Integers, Integers, Integers]: ...

class Shells(TypedDict):
    materials: Integers
    sizes: Floats
    of_inside: Integers
    of_outside: Integers
    mixed: int
    narrowest: Floats
    inside_out: int

class ComplexCheck(TypedDict):
    flat: Integers
    duplicates: Integers
    open_edges: dict[int, int]
    crossing: Integers
    shells: Shells | None

def check_complex(
    points: Floats, triangles: Integers, inside: Integers, outside: Integers, materials: int
) -> ComplexCheck: ...

class Description(TypedDict):
    junction_edges: int
    junction_vertices: int
    edges_by_triangles: dict[int, int]
    vertices_by_materials: dict[int, int]
    rms_turn_degrees: float | None
    topologies: dict[int, Counts]
    interfaces: list[tuple[int, float | None]]

def describe_complex(
    points: Floats, triangles: Integers, inside: Integers, outside: Integers, materials: int
) -> Description: ...

class Fit(TypedDict):
    regions: Integers
    parts: Integers
    behind: Integers
    before: Integers
    missing: int
    added: int
    crowded: int
    undecided: int

def conform(vertices: int, tetrahedra: Integers, triangles: Integers, inside: Integers, outside: Integers) -> Fit: ...
def forced_sides(points: Floats, triangles: Integers, angle: float) -> tuple[Integers, Integers, Floats]: ...
def largest_jacobians(points: Floats, triangles: Integers, angle: float) -> Floats: ...

class MendedMesh(TypedDict):
    points: Floats
    tetrahedra: Integers
    fit: Fit
    goal_degrees: float
    below: list[int]
    moves: int
    changed_tetrahedra: list[int]
    changed_vertices: list[int]

def mend(
    points: Floats,
    tetrahedra: Integers,
    interfaces: tuple[Integers, Integers, Integers],
    min_dihedral: float,
    min_scaled_jacobian: float,
) -> MendedMesh | None: ...

class Curved(TypedDict):
    nodes: Floats
    of_cells: Integers
    of_triangles: Integers
    surface_nodes: int
    curve_nodes: int
    drawn_back: int
    not_reached: int
    jacobian: Floats
    folded: int
    volumes: Floats
    straight_volumes: Floats
    vertex_distances: Floats
    midpoint_distances: Floats
    node_distances: Floats

@final
class GridField:
    def __new__(
        cls,
        array: NDArray[np.float32],
        spacing: tuple[float, float, float],
        origin: tuple[float, float, float],
        axes: list[list[float]],
    ) -> GridField: ...
    @property
    def voxel(self) -> float: ...
    def trilinear(self, positions: Floats) -> Floats: ...
    def world_grid(self, positions: Floats, max_nodes: int) -> tuple[Floats, list[float], float]: ...
    def background(
        self, points: Floats, triangles: Integers, max_nodes: int
    ) -> tuple[Floats, Integers, Floats, int]: ...

@final
class DistanceField:
    def __new__(cls, path: str | PathLike[str], positions: Floats) -> DistanceField: ...
    @property
    def materials(self) -> list[str]: ...
    @property
    def history(self) -> str: ...
    def difference(self, pair: tuple[int, int], positions: Floats) -> tuple[Floats, Floats]: ...
    def project(self, materials: list[int], positions: Floats, limits: Floats) -> tuple[Floats, NDArray[np.bool_]]: ...
    def quadratic(
        self, points: Floats, tetrahedra: Integers, triangles: Integers, inside: Integers, outside: Integers
    ) -> Curved: ...

def jacobian_coefficients(nodes: Floats) -> Floats: ...

class VolumeFile(TypedDict):
    values: NDArray[Any]
    spacing: list[float]
    origin: list[float]
    axes: list[list[float]]
    names: dict[int, str]
    layers: int
    is_lps: bool

def read_volume(
    path: str | PathLike[str], series: str | None = None, spacing: tuple[float, float, float] | None = None
) -> VolumeFile: ...
def labels_at(
    labels: NDArray[np.int32],
    step: list[list[float]],
    origin: tuple[float, float, float],
    positions: Floats,
    wanted: list[int] | None,
) -> Integers: ...
def tetrahedron_means(
    image: NDArray[np.float32],
    step: list[list[float]],
    origin: tuple[float, float, float],
    points: Floats,
    tetrahedra: Integers,
) -> tuple[Floats, Floats]: ...
