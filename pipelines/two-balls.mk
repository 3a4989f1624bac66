# Two small balls, separated by a gap of three voxels, which must remain two components. Keys: see
# demo.mk.
PHANTOM := two-balls --size 32
# Halfway between the values inside and outside the balls.
ISO := 100
# One edge length everywhere, mm.
SIZE := 2
# No smoothing, because the case tests the gap.
SCALE := 0
