# All tissues of the torso phantom at half the resolution of the paper's volume, in one mesh with
# shared interfaces. Keys: see demo.mk.
PHANTOM := torso --kind label --size 134,65,89 --spacing 2.6
MATERIALS := heart:1,lungs:2,ribs:3,body:4
NAME := torso-tissues
# Slightly more than a voxel (2.6 mm). The ribs are two to three voxels thick.
SIZE := 3
