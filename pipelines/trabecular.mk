# Trabecular bone, micro-CT by an iso value: rods and plates, cut by all six faces (LHDL, MIT). Keys: see demo.mk.
# The volume; spacing 0.0195 mm.
INPUT := $(DATA)/trabecular_bone.nrrd
# Bone is above 110.
ISO := 110
INSIDE := above
