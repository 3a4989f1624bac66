# Blood pools and vessels round a heart, contrast CT by an iso value (TotalSegmentator's test data, Apache-2.0).
# Keys: see demo.mk. The volume's box cuts many vessels.
# The volume, Hounsfield units.
INPUT := $(DATA)/heart_ct.nrrd
# Blood with contrast medium is above 250 HU.
ISO := 250
INSIDE := above
NAME := heart-ct
