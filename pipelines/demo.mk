# The demo: a heart-like phantom at half the resolution of the paper's volume (`make demo`). Also the list of every key
# that a case may set; whatever is left out keeps the stage's default, and the command line comes before the file: SIZE=3 there leaves
# MIN_SIZE here out.

# The volume. Either INPUT (a file: .nrrd .nhdr .nii .nii.gz .vti; $(DATA) is the folder of the real volumes, set by DATA=...)
#   INPUT := $(DATA)/heart_label.nrrd
# or PHANTOM: shape and options of the `phantom` program (`target/release/phantom --help`), which makes the volume.
PHANTOM := torso --part heart --size 134,65,89 --spacing 2.6

# Name of the results in OUT/NAME/ (the file's own name by default).
NAME := demo

# What to mesh. Either ISO, an iso value of the volume's scalars, with INSIDE = above or below ...
ISO := 170
INSIDE := above
# ... or LABELS, whole numbers with commas; their union is meshed.
#   LABELS := 1,2
# ... or MATERIALS: all labels, or some by names, each a region of one mesh with shared interfaces.
#   MATERIALS := lungs:2,heart:1,rest:3+4

# BORDER = cap closes the object where the volume cuts it, open leaves it open.
#   BORDER := cap

# Edge length h: EPSILON times the local feature size, its gradient at most DELTA, between MIN_SIZE and MAX_SIZE (mm) ...
#   EPSILON := 0.5
#   DELTA := 0.4
MIN_SIZE := 2
#   MAX_SIZE := 10
# ... or one length everywhere (mm) ...
#   SIZE := 2
# ... or a number of vertices ...
#   VERTICES := 20000
# ... or coarse, medium or fine.
#   QUALITY := medium

# SCALE = features smaller than this (mm) are left out; 0 keeps all.
#   SCALE := 0

# COUNT = number of particles to seed (by default what h asks for). SEED = seed of the random numbers.
#   COUNT := 20000
#   SEED := 1

# BACKEND = auto, gpu or cpu. MAX_MEMORY = the most memory that a stage may ask for.
#   BACKEND := auto
#   MAX_MEMORY := 8G

# ACCEPT_FORCED = yes passes elements that the surface of many materials forces below a limit;
# the verdict counts them.
#   ACCEPT_FORCED := no

# Anything else that a stage's --help offers; RECONSTRUCT_OPTIONS := --method tight-cocone joins the particles the paper's way.
#   DISTFIELD_OPTIONS :=
#   SIZEFIELD_OPTIONS :=
#   PARTICLES_OPTIONS :=
#   RECONSTRUCT_OPTIONS :=
#   TETMESH_OPTIONS :=
