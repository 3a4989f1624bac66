# The lungs of the torso phantom at the paper's size, 268 x 129 x 177 (used by `make bench-stages`). Keys: see demo.mk.
PHANTOM := torso --part lungs
# Half-way between the tissue's value and that of the body round it.
ISO := -380
INSIDE := below
NAME := torso-lungs
