"""Writes the files in this folder with other programs.

    pip install ome-zarr==0.18.0 ngff-zarr==0.50.0 hdf5storage==0.2.2
    python make_files.py

All files contain the array of ``VALUES``, whose axes are x, y and z. ``test_files.py`` contains the
expected spacings and origins.
"""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import hdf5storage
import ngff_zarr
import numpy as np
import zarr
from ome_zarr import format as versions
from ome_zarr import writer

HERE = Path(__file__).parent
VALUES = np.arange(8 * 6 * 4, dtype=np.uint16).reshape(8, 6, 4)
UNITS = {"z": "micrometer", "y": "micrometer", "x": "micrometer"}


def write_ome_zarr(name: str, version: Any) -> None:
    """Write an image of two levels with two channels, and labels with names."""
    group = zarr.open_group(str(HERE / name), mode="w", zarr_format=version.zarr_format)
    image = np.stack([VALUES.T, VALUES.T + 1000])
    scale = {"c": 1.0, "z": 3.0, "y": 2.0, "x": 1.0}
    writer.write_image(
        image,
        group,
        scale_factors=[{"c": 1, "z": 1, "y": 2, "x": 2}],
        axes="czyx",
        fmt=version,
        scale=scale,
        axes_units=UNITS,
    )
    labels = (VALUES.T % 3).astype(np.uint8)
    properties = [{"label-value": 1, "name": "liver"}, {"label-value": 2, "class": "spleen"}]
    writer.write_labels(
        labels,
        group,
        name="organs",
        scale_factors=[{"z": 1, "y": 2, "x": 2}],
        axes="zyx",
        fmt=version,
        scale={"z": 3.0, "y": 2.0, "x": 1.0},
        axes_units=UNITS,
        label_metadata={"properties": properties},
    )


def write_ngff_zarr(name: str, version: str, orientation: str | None) -> None:
    """Write an image of one level with a translation and, in 0.5, an anatomical orientation."""
    units = {"z": "millimeter", "y": "millimeter", "x": "millimeter"}
    scale, translation = {"z": 3.0, "y": 2.0, "x": 1.0}, {"z": 30.0, "y": 20.0, "x": 10.0}
    image = ngff_zarr.to_ngff_image(VALUES.T, ["z", "y", "x"], scale, translation, axes_units=units)
    levels = ngff_zarr.to_multiscales(image, scale_factors=[], orientation=orientation)
    ngff_zarr.to_ngff_zarr(str(HERE / name), levels, version=version)


def main() -> None:
    """Write all files."""
    for folder in HERE.glob("*.zarr"):
        shutil.rmtree(folder)
    write_ome_zarr("ome_zarr_04.ome.zarr", versions.FormatV04())
    write_ome_zarr("ome_zarr_05.ome.zarr", versions.FormatV05())
    write_ngff_zarr("ngff_zarr_04.ome.zarr", "0.4", None)
    write_ngff_zarr("ngff_zarr_05.ome.zarr", "0.5", "RAS")
    hdf5storage.savemat(str(HERE / "hdf5storage.mat"), {"volume": VALUES, "title": "text"}, truncate_existing=True)


if __name__ == "__main__":
    main()
