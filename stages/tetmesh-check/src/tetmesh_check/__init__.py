"""Tetrahedra inside a closed triangle surface, and the proof that they are fit for simulation.

The last stage of isoparticles. It reads files and writes files: a closed surface (``.vtp`` and
other triangle formats) and, for grading, the size field *h* of the stage ``sizefield``; out come a
``.vtu`` volume mesh, a JSON report with every measured number, and pictures.
"""

import os

# Before NumPy is loaded: what is left to BLAS here are matrices of a few rows, over which its
# threads wait for each other at length on a busy machine (the solve of a heart of 1,000 vertices
# with other programs on all cores: 12.0 s by two threads, 1.5 s by one).
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
