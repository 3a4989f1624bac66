# Human lungs and airways of a chest CT, label map (LIDC-IDRI-0314, CC BY 3.0). Keys: see demo.mk.
INPUT := $(DATA)/thorax_labels.nrrd
# Label 2 is the lungs and airways, in several pieces.
LABELS := 2
# Two cases share this volume, so the results need a distinct name.
NAME := lungs
