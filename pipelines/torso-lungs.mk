# The lungs of the torso phantom at the paper's size, 268 x 129 x 177 (used by `make bench-stages`).
# Keys: see demo.mk.
PHANTOM := torso --part lungs
# Halfway between the values of the lungs and the surrounding body.
ISO := -380
INSIDE := below
NAME := torso-lungs
