"""Tetrahedra of a label image by Cleaver 2, of itk-cleaver: for materials_peers.py.

    python cleaver.py JOB.npz RESULT.npz    # an interpreter with cleaver.lock

JOB: ``materials`` (numbers from 0, shape (nx, ny, nz)) and ``sampling`` (of the lattice, 1: a node a voxel). RESULT: ``points`` in
voxels, 0 the centre of the first one, ``tetrahedra`` and ``regions``, and ``seconds`` and ``bytes``, the peak memory of this process.
"""

from __future__ import annotations

import re
import sys
import time
from pathlib import Path

import itk
import numpy as np


def main() -> None:
    """Reads the job, runs Cleaver with its defaults and writes the result."""
    with np.load(sys.argv[1]) as job:
        materials, sampling = job["materials"].astype(np.uint8), float(job["sampling"])
    image = itk.image_from_array(np.ascontiguousarray(materials.transpose(2, 1, 0)))
    started = time.monotonic()
    cleaver = itk.CleaverImageToMeshFilter[type(image), itk.Mesh[itk.D, 3]].New(Input=image)
    cleaver.SetSamplingRate(sampling)
    cleaver.Update()
    seconds = time.monotonic() - started
    mesh = cleaver.GetOutput(0)
    # Cleaver's voxels reach from a whole number to the next
    points = itk.array_from_vector_container(mesh.GetPoints()) - 0.5
    # kind, number of points and the points of each
    tetrahedra = itk.array_from_vector_container(mesh.GetCellsArray()).reshape(-1, 6)[:, 2:]
    regions = itk.array_from_vector_container(mesh.GetCellData()).astype(np.int64)
    told = re.search(r"VmHWM:\s+(\d+) kB", Path("/proc/self/status").read_text())
    peak = 1024 * int(told.group(1)) if told else 0
    np.savez(sys.argv[2], points=points, tetrahedra=tetrahedra, regions=regions, seconds=seconds, bytes=peak)


if __name__ == "__main__":
    main()
