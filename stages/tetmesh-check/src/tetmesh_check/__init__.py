"""Tetrahedra inside a closed triangle surface, and the proof that they are fit for simulation.

The last stage of isoparticles. It reads files and writes files: a closed surface (``.vtp`` and other triangle
formats) and, for grading, the size field *h* of the stage ``sizefield``; out come a ``.vtu`` volume mesh, a JSON
report with every measured number, and pictures.
"""

from importlib.metadata import PackageNotFoundError, version

try:
    __version__ = version("tetmesh-check")
except PackageNotFoundError:  # run from a source tree that was never installed
    __version__ = "0+unknown"

__all__ = ["__version__"]
