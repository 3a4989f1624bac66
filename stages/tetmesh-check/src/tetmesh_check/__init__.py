"""Fills a closed triangle surface with tetrahedra, and checks that they are fit for simulation.

The last stage of isoparticles. Inputs are a closed surface (``.vtp`` and other triangle formats)
and, for grading, the size field *h* of the stage ``sizefield``. Outputs are a volume mesh
(``.vtu``), a JSON report with all measurements, and pictures.
"""

import os

# This must be set before NumPy is imported. BLAS only gets matrices of a few rows here, and on a
# busy machine its threads wait for each other. With other programs on all cores, the solve of a
# heart of 1,000 vertices takes 12.0 s with two threads and 1.5 s with one.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
