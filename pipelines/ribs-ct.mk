# Bone from a chest CT, defined by an iso value, including every noise speck above it
# (LIDC-IDRI-0314, CC BY 3.0). Keys: see demo.mk.
#
# The volume, in Hounsfield units.
INPUT := $(DATA)/thorax_ct.nrrd
# Bone is above 200 HU.
ISO := 200
INSIDE := above
NAME := ribs-ct
