# Two small balls with a gap of three voxels: two components. Keys: see demo.mk.
PHANTOM := two-balls --size 32
# Half-way between inside and outside.
ISO := 100
# One edge length everywhere, mm.
SIZE := 2
# The gap is what the case is about: nothing is smoothed away.
SCALE := 0
