# A human molar: CT with integer values, meshed at an integer iso value (University of Utah, MIT).
# Keys: see demo.mk.
INPUT := $(DATA)/tooth_ct.nrrd
# The tooth is above 600; 1000 gives the enamel.
ISO := 600
INSIDE := above
