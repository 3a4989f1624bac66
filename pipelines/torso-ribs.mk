# The ribs of the torso phantom at the paper's size, 268 x 129 x 177 (used by `make bench-stages`).
# Keys: see demo.mk.
PHANTOM := torso --part ribs
# Halfway between the values of the ribs and the surrounding body.
ISO := 370
INSIDE := above
NAME := torso-ribs
