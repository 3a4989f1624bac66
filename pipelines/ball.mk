# A small ball: the fastest case, for experiments. Keys: see demo.mk.
PHANTOM := ball --size 32
# Halfway between the values inside and outside the ball.
ISO := 100
# One edge length everywhere, mm.
SIZE := 2.5
# No smoothing, because the ball is a reference shape.
SCALE := 0
