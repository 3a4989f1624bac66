# Five materials without smoothing: a hollow ball that touches two other balls, in a box (the label
# map from Cleaver's tutorials). Keys: see demo.mk.
INPUT := $(DATA)/mickey_labels.nrrd
MATERIALS := box:1,head:2,left ear:3,right ear:4,nose:5
NAME := mickey-materials
SIZE := 1
# No smoothing: every voxel centre keeps its material.
SCALE := 0
TETMESH_OPTIONS := --tet-size-factor 2
