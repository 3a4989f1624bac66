# A hollow ball of a synthetic label volume (SCIInstitute's Cleaver, MIT). Keys: see demo.mk.
INPUT := $(DATA)/mickey_labels.nrrd
# Label 2 is the hollow ball, 3 and 4 two small balls on it, 5 a tiny cube.
LABELS := 2
