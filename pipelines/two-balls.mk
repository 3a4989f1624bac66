# Two small balls with a gap of three voxels, which are two components. Keys: see demo.mk.
PHANTOM := two-balls --size 32
# Halfway between the values inside and outside.
ISO := 100
# One edge length everywhere, mm.
SIZE := 2
# No smoothing, because the case tests the gap.
SCALE := 0
