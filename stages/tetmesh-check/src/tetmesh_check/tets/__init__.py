"""Drivers of fTetWild, HXT and TetGen, which fill a surface with tetrahedra."""
