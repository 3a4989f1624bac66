# A hollow ball from a synthetic label map (SCIInstitute's Cleaver, MIT). Keys: see demo.mk.
INPUT := $(DATA)/mickey_labels.nrrd
# Label 2 is the hollow ball, labels 3 and 4 are two small balls on it, and label 5 is a tiny cube.
LABELS := 2
