"""The files of the tetrahedra: VTK, and formats of other programs."""
