# A small ball: the fastest case, for trying things out. Keys: see demo.mk.
PHANTOM := ball --size 32
# Halfway between the values inside and outside.
ISO := 100
# One edge length everywhere, mm.
SIZE := 2.5
# A reference shape: no smoothing.
SCALE := 0
