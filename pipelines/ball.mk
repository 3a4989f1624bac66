# A small ball: the quickest case, for trying things out. Keys: see demo.mk.
PHANTOM := ball --size 32
# Half-way between inside and outside.
ISO := 100
# One edge length everywhere, mm.
SIZE := 2.5
# It is the measure of others: nothing is smoothed away.
SCALE := 0
