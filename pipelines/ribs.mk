# Human ribcage, spine and shoulder blades from a chest CT, as a label map (LIDC-IDRI-0314, CC BY
# 3.0). Keys: see demo.mk.
INPUT := $(DATA)/thorax_labels.nrrd
# Label 1 is bone.
LABELS := 1
# Two cases share this volume, so each needs its own name for the results.
NAME := ribs
