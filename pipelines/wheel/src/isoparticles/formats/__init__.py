"""Readers of HDF5, MATLAB and Zarr files. They run in a separate process: see ``worker``.

A reader finds an array in a file, and returns it as :class:`isoparticles.formats.stored.Stored`
without reading its voxels.
"""
