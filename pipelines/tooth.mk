# Human molar: CT with an integer iso value in integer data (University of Utah, MIT). Keys: see
# demo.mk.
INPUT := $(DATA)/tooth_ct.nrrd
# The tooth is above 600; 1000 gives the enamel.
ISO := 600
INSIDE := above
