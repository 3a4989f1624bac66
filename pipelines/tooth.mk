# Human molar, CT by an iso value that is a whole number in whole-number data (University of Utah, MIT). Keys: see demo.mk.
# The volume.
INPUT := $(DATA)/tooth_ct.nrrd
# The tooth is above 600; 1000 gives the enamel.
ISO := 600
INSIDE := above
