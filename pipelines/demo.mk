# The demo: a heart-like phantom at half the resolution of the paper's volume (`make demo`). This
# file also explains the keys of a case; pipelines/case/src/keys.rs lists all keys. If a key is not
# set, the default of the stage applies. The command line takes precedence over this file: for
# example, SIZE=3 on the command line replaces the MIN_SIZE of this file.

# The volume: either INPUT, a file (.nrrd .nhdr .nii .nii.gz .mha .mhd .vti) or a folder of DICOM
# slices. $(DATA) is the folder of the real volumes, set by DATA=...
#   INPUT := $(DATA)/heart_label.nrrd
# or PHANTOM, a shape and options for the `phantom` program (`target/release/phantom --help`), which
# makes the volume.
PHANTOM := torso --part heart --size 134,65,89 --spacing 2.6

# Name of the results, which are written to OUT/NAME/ (default: the name of this file).
NAME := demo

# The object to mesh: either ISO, an iso value of the volume's scalars, with INSIDE = above or
# below ...
ISO := 170
INSIDE := above
# ... or LABELS, integers separated by commas, whose union is meshed.
#   LABELS := 1,2
# ... or MATERIALS, either `all` or a list of named labels. Each material becomes a region of one
# mesh with shared interfaces.
#   MATERIALS := lungs:2,heart:1,rest:3+4

# BORDER = cap closes the object where the border of the volume cuts it; open leaves it open.
#   BORDER := cap

# Edge length h (mm): EPSILON times the local feature size, with a gradient of at most DELTA,
# between MIN_SIZE and MAX_SIZE ...
#   EPSILON := 0.5
#   DELTA := 0.4
MIN_SIZE := 2
#   MAX_SIZE := 10
# ... or one edge length everywhere (mm) ...
#   SIZE := 2
# ... or a number of vertices ...
#   VERTICES := 20000
# ... or coarse, medium or fine.
#   QUALITY := medium

# SCALE: size in mm below which features are smoothed away; 0 keeps all features.
#   SCALE := 0

# COUNT: number of particles to seed (default: predicted from h). SEED: seed for the random numbers.
#   COUNT := 20000
#   SEED := 1

# BACKEND = auto, gpu or cpu. MAX_MEMORY: maximum memory that a stage may use.
#   BACKEND := auto
#   MAX_MEMORY := 8G

# ACCEPT_LOSSES = yes accepts objects and materials whose volume a scale changes by more than 10 %.
# The verdict lists them.
#   ACCEPT_LOSSES := no

# ACCEPT_FORCED = yes accepts elements below a quality limit if the surface of several materials
# forces their shape. The verdict counts these elements.
#   ACCEPT_FORCED := no

# Further options of a stage, which its --help lists. RECONSTRUCT_OPTIONS := --method tight-cocone
# connects the particles by the paper's method.
#   DISTFIELD_OPTIONS :=
#   SIZEFIELD_OPTIONS :=
#   PARTICLES_OPTIONS :=
#   RECONSTRUCT_OPTIONS :=
#   TETMESH_OPTIONS :=
