"""Mesh a label image with Cleaver 2 (itk-cleaver), for materials_peers.py.

    python cleaver.py JOB.npz RESULT.npz    # an interpreter with the packages in cleaver.lock

JOB contains ``materials`` (numbers from 0, shape (nx, ny, nz)) and ``sampling`` (lattice nodes per
voxel along an axis). RESULT contains ``points`` (in voxels; 0 is the centre of the first voxel),
``tetrahedra``, ``regions``, ``seconds``, and ``bytes``, the peak memory of this process.
"""

from __future__ import annotations

import re
import sys
import time
from pathlib import Path

import itk
import numpy as np


def main() -> None:
    """Read the job, run Cleaver with its defaults and write the result."""
    with np.load(sys.argv[1]) as job:
        materials, sampling = job["materials"].astype(np.uint8), float(job["sampling"])
    image = itk.image_from_array(np.ascontiguousarray(materials.transpose(2, 1, 0)))
    started = time.monotonic()
    cleaver = itk.CleaverImageToMeshFilter[type(image), itk.Mesh[itk.D, 3]].New(Input=image)
    cleaver.SetSamplingRate(sampling)
    cleaver.Update()
    seconds = time.monotonic() - started
    mesh = cleaver.GetOutput(0)
    # Cleaver puts voxel boundaries at integer coordinates; here, voxel centres have integer
    # coordinates
    points = itk.array_from_vector_container(mesh.GetPoints()) - 0.5
    # each cell is stored as its type, its number of points, and its point indices
    tetrahedra = itk.array_from_vector_container(mesh.GetCellsArray()).reshape(-1, 6)[:, 2:]
    regions = itk.array_from_vector_container(mesh.GetCellData()).astype(np.int64)
    told = re.search(r"VmHWM:\s+(\d+) kB", Path("/proc/self/status").read_text())
    peak = 1024 * int(told.group(1)) if told else 0
    np.savez(sys.argv[2], points=points, tetrahedra=tetrahedra, regions=regions, seconds=seconds, bytes=peak)


if __name__ == "__main__":
    main()
