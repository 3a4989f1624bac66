# Blood pools and vessels of a heart: contrast-enhanced CT, meshed at an iso value
# (TotalSegmentator's test data, Apache-2.0). The border of the volume cuts many vessels. Keys: see
# demo.mk.
#
# The volume, in Hounsfield units.
INPUT := $(DATA)/heart_ct.nrrd
# Blood with contrast medium is above 250 HU.
ISO := 250
INSIDE := above
NAME := heart-ct
