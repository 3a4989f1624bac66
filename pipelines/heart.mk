# A human heart, as a label map (TotalSegmentator's test data, Apache-2.0). Keys: see demo.mk.
INPUT := $(DATA)/heart_label.nrrd
# Label 1 is the heart with a stub of the pulmonary trunk.
LABELS := 1
