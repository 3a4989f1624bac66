# Human lungs and airways from a chest CT, as a label map (LIDC-IDRI-0314, CC BY 3.0). Keys: see
# demo.mk.
INPUT := $(DATA)/thorax_labels.nrrd
# Label 2 marks the lungs and airways, which have several components.
LABELS := 2
# Two cases share this volume, so each needs its own name for the results.
NAME := lungs
