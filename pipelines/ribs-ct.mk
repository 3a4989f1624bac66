# Bone from a chest CT, meshed at an iso value, with every speck of noise above that value
# (LIDC-IDRI-0314, CC BY 3.0). Keys: see demo.mk.
#
# The volume, in Hounsfield units.
INPUT := $(DATA)/thorax_ct.nrrd
# Bone is above 200 HU.
ISO := 200
INSIDE := above
NAME := ribs-ct
