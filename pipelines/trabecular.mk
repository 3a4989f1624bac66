# Trabecular bone: micro-CT, meshed at an iso value. All six faces of the volume cut the rods and
# plates (LHDL, MIT). Keys: see demo.mk.
#
# The volume; its spacing is 0.0195 mm.
INPUT := $(DATA)/trabecular_bone.nrrd
# Bone is above 110.
ISO := 110
INSIDE := above
