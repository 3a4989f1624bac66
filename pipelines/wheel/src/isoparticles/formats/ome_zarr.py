"""OME-Zarr 0.4 (Zarr 2) and 0.5 (Zarr 3), and Zarr arrays without metadata of OME, in folders."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import zarr
from numpy.typing import NDArray

from isoparticles._errors import Error
from isoparticles.formats.stored import ZARR_FILES, Place, Stored, axes_of, is_volume, refuse_name, split_name

UNITS_MM = {
    **dict.fromkeys(("angstrom", "angstroms"), 1e-7),
    **dict.fromkeys(("nanometer", "nanometers", "nm"), 1e-6),
    **dict.fromkeys(("micrometer", "micrometers", "micron", "microns", "um", "\u00b5m", "\u03bcm"), 1e-3),
    **dict.fromkeys(("millimeter", "millimeters", "mm"), 1.0),
    **dict.fromkeys(("centimeter", "centimeters", "cm"), 10.0),
    **dict.fromkeys(("meter", "meters", "m"), 1e3),
    **dict.fromkeys(("inch", "inches"), 25.4),
}
"""Lengths of units in mm. OME-Zarr uses the names of UDUNITS-2."""
NO_UNITS = (None, "", "pixel", "pixels", "voxel", "voxels")
"""Values of ``unit`` that do not define a length."""
LPS = {
    "right-to-left": (1, 0, 0),
    "left-to-right": (-1, 0, 0),
    "anterior-to-posterior": (0, 1, 0),
    "posterior-to-anterior": (0, -1, 0),
    "inferior-to-superior": (0, 0, 1),
    "superior-to-inferior": (0, 0, -1),
}
"""Directions of the anatomical orientations of OME-Zarr (RFC 4)."""
NAME_KEYS = ("name", "class")
"""Keys of the properties of a label that contain its name."""


def read_zarr(path: Path, dataset: str | None) -> Stored:
    """Find an array of a Zarr store: a level of an image, or an array without metadata of OME."""
    name, chosen = split_name(dataset)
    if ".." in Path(name).parts or Path(name).is_absolute():
        raise refuse_name(path, "array", name, _present(path))
    node = path / name
    if not _is_node(node):
        raise refuse_name(path, "array", name, _present(path))
    found = _level(node)
    if found is None and not _is_array(node):
        inside = _present(node)
        if len(inside) != 1:
            raise refuse_name(path, "array", name, [(Path(name) / one).as_posix() for one in inside])
        node = node / inside[0]
        found = _level(node)
    if found is None:
        array = zarr.open_array(str(node), mode="r")
        return _stored(path, (Path(name) / node.relative_to(path / name)).as_posix(), array, _labels(array), chosen)
    group, image, level = found
    array = zarr.open_array(str(group / level), mode="r")
    return _of_image(path, group, image, level, array, chosen)


def _is_node(folder: Path) -> bool:
    return any((folder / name).is_file() for name in ZARR_FILES)


def _is_array(folder: Path) -> bool:
    return _is_node(folder) and isinstance(zarr.open(str(folder), mode="r"), zarr.Array)


def _attributes(folder: Path) -> Mapping[str, Any]:
    """Return the attributes of a group. In Zarr 3, those of OME are in the entry ``ome``."""
    node = zarr.open(str(folder), mode="r")
    attributes = node.attrs.asdict()
    own = attributes.get("ome", attributes)
    return own if isinstance(own, dict) and isinstance(node, zarr.Group) else {}


def _level(node: Path) -> tuple[Path, Mapping[str, Any], str] | None:
    """Return the image of a level: its group, its metadata, and the path of the level in the group.

    If ``node`` is the group, the level is its first one. Otherwise, the group is a parent of
    ``node``.
    """
    for group in (node, *node.parents):
        if not _is_node(group):
            break
        images = _attributes(group).get("multiscales") or []
        for image in images[:1] if group == node else images:
            levels = [str(level["path"]) for level in image["datasets"]]
            level = levels[0] if group == node else node.relative_to(group).as_posix()
            if level in levels and ".." not in Path(level).parts:
                return group, image, level
    return None


def _present(folder: Path) -> list[str]:
    """Return the names of the images and arrays in a group, and of the labels of an image."""
    found = []
    for child in sorted(folder.iterdir()) if _is_node(folder) else []:
        if not _is_node(child):
            continue
        if _is_array(child):
            if is_volume(zarr.open_array(str(child), mode="r")):
                found.append(child.name)
        elif _attributes(child).get("multiscales"):
            found.append(child.name)
        else:
            found += [f"{child.name}/{name}" for name in _present(child)]
    return found


def _labels(array: Any) -> Sequence[str] | None:
    """Return the names of the axes of an array: those of Zarr 3, or those of xarray in Zarr 2."""
    names = getattr(array.metadata, "dimension_names", None) or array.attrs.get("_ARRAY_DIMENSIONS")
    labels = [str(name).lower() for name in names or ()]
    return labels if set("xyz") <= set(labels) else None


def _stored(
    path: Path, name: str, array: Any, labels: Sequence[str] | None, chosen: Mapping[str, int], **more: Any
) -> Stored:
    axes, indices = axes_of(path, name, array, labels, "zyx", chosen)
    # Zarr reads parts of shards, so the chunks in a shard determine the memory
    workers = int(zarr.config.get("async.concurrency"))
    return Stored(name, array, axes, indices, chunks=array.chunks, in_parallel=workers, **more)


def _of_image(
    path: Path, group: Path, image: Mapping[str, Any], level: str, array: Any, chosen: Mapping[str, int]
) -> Stored:
    """Return a level of an image."""
    axes = image.get("axes")
    if not isinstance(axes, list) or not all(isinstance(axis, dict) for axis in axes):
        raise Error(
            f"{group}: is OME-Zarr of the version {image.get('version', 'unknown')}",
            "only the versions 0.4 and 0.5 are supported",
            "convert it, for example with ngff-zarr",
        )
    labels = _axis_names(axes)
    datasets = {str(dataset["path"]): dataset for dataset in image["datasets"]}
    transforms = [*datasets[level].get("coordinateTransformations", []), *image.get("coordinateTransformations", [])]
    place, warnings = _place(path, level, axes, labels, transforms)
    prefix = group.relative_to(path).as_posix() if group.is_relative_to(path) else "."
    shown = {other: level_name(prefix, other) for other in datasets}
    suffix = ":" + ",".join(f"{name}={index}" for name, index in chosen.items()) if chosen else ""
    smaller = list(shown.values())[list(datasets).index(level) + 1 :] if group.is_relative_to(path) else []
    more = {
        "place": place,
        "names": _names(group),
        "others": [other + suffix for other in smaller],
        "warnings": warnings,
    }
    return _stored(path, shown[level], array, labels, chosen, **more)


def level_name(prefix: str, level: str) -> str:
    """Return the name of a level in the store."""
    return level if prefix == "." else f"{prefix}/{level}"


def _axis_names(axes: Sequence[Mapping[str, Any]]) -> list[str]:
    """Return the names of axes. Three axes of space with other names are z, y and x."""
    names = [str(axis.get("name", "")).lower() for axis in axes]
    space = [i for i, axis in enumerate(axes) if axis.get("type") == "space"]
    if not set("xyz") <= set(names) and len(space) == 3:
        for letter, i in zip("zyx", space, strict=True):
            names[i] = letter
    return names


def _place(
    path: Path,
    level: str,
    axes: Sequence[Mapping[str, Any]],
    labels: Sequence[str],
    transforms: Sequence[Mapping[str, Any]],
) -> tuple[Place, list[str]]:
    """Combine the transformations of a level and of its image."""
    scale, shift = np.ones(len(axes)), np.zeros(len(axes))
    for transform in transforms:
        kind = transform.get("type")
        numbers = np.array(transform.get(str(kind), []), dtype=float)
        if kind == "identity":
            continue
        if kind not in ("scale", "translation") or numbers.shape != scale.shape:
            raise Error(
                f"{path}: the level {level} has a coordinate transformation of the type {kind} with {numbers.size} "
                f"numbers for {len(axes)} axes",
                "only scales and translations with a number per axis are read",
                "correct the metadata of the image",
            )
        factor = numbers if kind == "scale" else 1.0
        scale, shift = scale * factor, shift * factor + (numbers if kind == "translation" else 0.0)
    units, warnings = _units(path, axes, labels)
    if not any(transform.get("type") == "scale" for transform in transforms):
        return Place(), []
    spacing = [float(length) for length in scale * (units if units is not None else 1.0)]
    origin = [float(length) for length in shift * (units if units is not None else 1.0)]
    return Place(spacing, origin, _orientation(axes, labels), has_unit=units is not None), warnings


def _units(
    path: Path, axes: Sequence[Mapping[str, Any]], labels: Sequence[str]
) -> tuple[NDArray[np.float64] | None, list[str]]:
    """Return the lengths of the units in mm, or ``None`` and a warning if the file has no units."""
    spatial = {label: axis.get("unit") for label, axis in zip(labels, axes, strict=True) if label in "xyz"}
    if all(unit in NO_UNITS for unit in spatial.values()):
        return None, [f"{path}: has no unit of length; its lengths are read as mm"]
    for label, unit in spatial.items():
        if unit not in UNITS_MM:
            raise Error(
                f"{path}: the unit of the axis {label} is {unit}",
                "lengths must be known in mm",
                "correct the metadata of the image; units are, for example, micrometer and millimeter",
            )
    return np.array([UNITS_MM[str(spatial[label])] if label in spatial else 1.0 for label in labels]), []


def _orientation(axes: Sequence[Mapping[str, Any]], labels: Sequence[str]) -> dict[str, NDArray[np.float64]]:
    """Return the directions of x, y and z in LPS, or an empty table if one of them is unknown."""
    found = {}
    for label, axis in zip(labels, axes, strict=True):
        orientation = axis.get("orientation")
        if label in "xyz" and isinstance(orientation, dict) and orientation.get("value") in LPS:
            found[label] = np.array(LPS[orientation["value"]], dtype=float)
    is_basis = len(found) == 3 and abs(np.linalg.det(np.stack(list(found.values())))) > 0.5
    return found if is_basis else {}


def _names(group: Path) -> dict[int, str]:
    """Return the names of labels, except names that several labels share."""
    label = _attributes(group).get("image-label") or {}
    pairs = list(_named(label.get("properties") or []))
    texts = [name for _, name in pairs]
    return {value: name for value, name in pairs if texts.count(name) == 1}


def _named(properties: Sequence[Mapping[str, Any]]) -> Iterator[tuple[int, str]]:
    for one in properties:
        name = next((str(one[key]) for key in NAME_KEYS if one.get(key)), None)
        value = one.get("label-value")
        if name is not None and isinstance(value, (int, float)) and value == int(value):
            yield int(value), name
