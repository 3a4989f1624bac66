# The heart of the torso phantom at the paper's size, 268 x 129 x 177 (used by `make bench-stages`).
# Keys: see demo.mk.
PHANTOM := torso --part heart
# Halfway between the values of the heart and the surrounding body.
ISO := 170
INSIDE := above
NAME := torso-heart
