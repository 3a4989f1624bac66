# Chains the stages. `make` alone says what there is; README.md tells the rest.
#
# How a rerun is decided: every stage has a stamp in OUT/NAME/.params/ that holds its parameters and the checksum of its
# program. A stamp is rewritten only when its text changes, so a changed parameter (or a program that was really
# changed) reruns that stage and those after it, and nothing else; a rebuild to the same bytes reruns nothing.

SHELL := /bin/sh
.DELETE_ON_ERROR:
.SUFFIXES:
MAKEFLAGS += --no-builtin-rules

CARGO ?= cargo
CARGO_TARGET_DIR ?= target
# Where the stage programs are, and whether to build them first (tests of this file bring their own).
BIN ?= $(CARGO_TARGET_DIR)/release
# Where tetmesh-check finds distfield, which reads every volume.
export ISOPARTICLES_BIN := $(abspath $(BIN))
NO_BUILD ?=
# The Python environment of tetmesh-check.
VENV ?= .venv
TETMESH_CHECK ?= $(VENV)/bin/tetmesh-check
# HXT=no leaves Gmsh (GPL-2.0-or-later) out of it, and fTetWild fills large surfaces, too.
HXT ?= yes
without_hxt = $(if $(filter no,$(HXT)),--without-hxt)
# Real volumes for the cases in pipelines/.
DATA ?= ../shared/data
# Results go to OUT/NAME/.
OUT ?= out
# Extra options for every stage, such as VERBOSITY=-v or -q; they change no result.
VERBOSITY ?=
THREADS ?=

# What a case may set. The command line comes before the case's file; the environment has no say, because names as
# plain as NAME or SIZE may mean something else there.
KEYS := CASE CASES NAME INPUT PHANTOM ISO LABELS INSIDE BORDER EPSILON DELTA SIZE MIN_SIZE MAX_SIZE COUNT BACKEND SEED \
        DISTFIELD_OPTIONS SIZEFIELD_OPTIONS PARTICLES_OPTIONS RECONSTRUCT_OPTIONS TETMESH_OPTIONS
$(foreach key,$(KEYS),$(if $(filter environment,$(origin $(key))),$(eval undefine $(key))))

define newline


endef
# $(call stop,WHAT,WHY,NEXT)
comma := ,
stop = $(error $(1)$(newline)  why it matters: $(2)$(newline)  what to do: $(3))

ifneq ($(CASE),)
  ifeq ($(wildcard pipelines/$(CASE).mk),)
    $(call stop,pipelines/$(CASE).mk: not found,CASE names a file there,choose one of: $(basename $(notdir $(wildcard pipelines/*.mk))))
  endif
  include pipelines/$(CASE).mk
  NAME ?= $(CASE)
endif

.DEFAULT_GOAL := $(if $(CASE),mesh,help)

# --- What a case is made of -------------------------------------------------------------------------------------------

# A phantom's volume is made here; any other volume must exist.
ifneq ($(PHANTOM),)
  NAME ?= phantom
  INPUT = $(D)/$(NAME).nrrd
endif
NAME ?= $(firstword $(subst ., ,$(notdir $(INPUT))))

ifneq ($(filter mesh surface,$(or $(MAKECMDGOALS),$(.DEFAULT_GOAL))),)
  ifeq ($(INPUT),)
    $(call stop,INPUT is not set,it is the volume to mesh,make mesh INPUT=v.nrrd ISO=300 or make CASE=name)
  endif
  ifneq ($(words $(INPUT) $(OUT) $(NAME)),3)
    $(call stop,a space in INPUT=$(INPUT) or OUT=$(OUT) or NAME=$(NAME),make cannot handle file names with spaces,use names without)
  endif
  ifeq ($(PHANTOM)$(wildcard $(INPUT)),)
    $(call stop,$(INPUT): not found,it is the volume to mesh,check INPUT$(if $(CASE), or DATA=$(DATA) (the folder of the real volumes)))
  endif
  ifeq ($(ISO)$(LABELS),)
    $(call stop,neither ISO nor LABELS is set,one of them says what in $(INPUT) is to be meshed,add ISO=value or LABELS=1$(comma)2)
  endif
  ifneq ($(and $(ISO),$(LABELS)),)
    $(call stop,ISO=$(ISO) and LABELS=$(LABELS) are both set,a volume is meshed as a scalar or as labels,keep one of them)
  endif
  ifneq ($(and $(SIZE),$(EPSILON)$(DELTA)$(MIN_SIZE)$(MAX_SIZE)),)
    $(call stop,SIZE=$(SIZE) is set with EPSILON or DELTA or MIN_SIZE or MAX_SIZE,SIZE is one edge length everywhere and leaves nothing to grade or bound,keep SIZE or the others)
  endif
endif

D = $(OUT)/$(NAME)
P = $(D)/.params
F = $(D)/$(NAME)

DISTFIELD = $(F).distfield.vti
SIZEFIELD = $(F).sizefield.vti
SEEDS     = $(F).seeds.bin
PARTICLES = $(F).particles.bin
SURFACE   = $(F).surface.vtp
VOLUME    = $(F).volume.vtu
REPORT    = $(F).report.json
PAGE      = $(F).report.html

# Options by stage: exactly what its stamp holds. An empty variable leaves the stage's own default.
option = $(if $(2),$(1) $(2))
distfield_options   = $(call option,--iso,$(ISO)) $(call option,--labels,$(LABELS)) $(call option,--inside,$(INSIDE)) \
                      $(call option,--border,$(BORDER)) $(DISTFIELD_OPTIONS)
sizefield_options   = $(call option,--epsilon,$(EPSILON)) $(call option,--delta,$(DELTA)) $(call option,--uniform,$(SIZE)) \
                      $(call option,--min-size,$(MIN_SIZE)) $(call option,--max-size,$(MAX_SIZE)) \
                      $(SIZEFIELD_OPTIONS)
seed_options        = $(call option,--count,$(COUNT)) $(call option,--seed,$(SEED))
particles_options   = $(call option,--backend,$(BACKEND)) $(call option,--seed,$(SEED)) $(PARTICLES_OPTIONS)
reconstruct_options = $(RECONSTRUCT_OPTIONS)
tetmesh_options     = $(TETMESH_OPTIONS)

shared_options = --force $(VERBOSITY) $(call option,--threads,$(THREADS)) --report $(D)/reports/$(1).json

# $(call failed,FILE): where an output goes whose stage said that a check failed.
failed = $(basename $(1)).failed$(suffix $(1))

# $(call run,STAGE,COMMAND): runs a stage that makes $@. On exit code 1 (made, but a check failed) the output is kept
# under another name, so that it can be looked at but nothing goes on with it.
define run
@mkdir -p $(D)/reports && rm -f $(call failed,$@)
@printf '%s\n' '$(strip $(2) $(call shared_options,$(1)))'
@$(2) $(call shared_options,$(1)) || { code=$$?; rm -f $(PAGE); \
  if [ $$code = 1 ] && [ -e $@ ]; then mv -f $@ $(call failed,$@); \
    printf '%s\n' '$(1): a check failed; its output is kept as $(call failed,$@), what failed is in $(D)/reports/$(1).json' >&2; \
  fi; exit $$code; }
endef

# $(call stamp,STAGE,OPTIONS,FILES THAT ARE THE PROGRAM)
define stamp
@mkdir -p $(P)
@{ printf '%s\n' '$(strip $(1) $(2))' && cat $(3) | cksum; } > $@.new
@if cmp -s $@.new $@; then rm -f $@.new; else mv -f $@.new $@; fi
endef

# --- Goals ------------------------------------------------------------------------------------------------------------

.PHONY: help mesh surface demo cases index build env doctor test format lint documentation test-rust test-python bench-stages \
        bench-gpu bench-delaunay bench-convergence bench-marching-cubes \
        FORCE
FORCE:

define HELP
Volumes in, simulation-ready meshes out.

  make demo                                    build everything, mesh a phantom, fill it with tetrahedra
  make doctor                                  what is missing on this machine, and how to get it
  make mesh INPUT=v.nrrd ISO=300               mesh where the scalar is above 300 (INSIDE=below: below)
  make mesh INPUT=v.nrrd LABELS=1,2            mesh the union of labels 1 and 2
  make CASE=heart                              mesh the case of pipelines/heart.mk
  make -j2 CASES="heart mickey" cases          several cases at once
  make surface ...                             stop at the triangles
  make index                                   a page over all cases in OUT (make cases does it at its end)
  make test                                    format, lints, documentation, tests
  make bench-stages                            time and memory of every stage on the torso phantom
  make bench-gpu                               the particles stage on the GPU against one CPU thread (BENCH_OPTIONS=...)
  make bench-delaunay                          the Delaunay triangulation against CGAL's (BENCH_OPTIONS=...; needs libcgal-dev)
  make bench-convergence                       error of a known solution on the ball, from coarse to fine tetrahedra
  make bench-marching-cubes                    tetrahedra in our surfaces against marching cubes and a remesher (COMPARED=...)

Parameters of mesh, surface and CASE, with the stages' defaults where left out:
  NAME=...      name of the results [the volume's]       OUT=...       folder of the results [out]
  EPSILON=...   h = epsilon x local feature size         DELTA=...     largest gradient of h
  SIZE=...      one edge length everywhere, mm           MIN_SIZE=...  MAX_SIZE=...  bounds of h, mm
  BORDER=...    cap or open                              BACKEND=...   auto, gpu or cpu
  SEED=...      of the random numbers                    THREADS=...   CPU threads [all]
  HXT=no        without Gmsh: large surfaces take hours
Results: OUT/NAME/NAME.{distfield.vti,sizefield.vti,seeds.bin,particles.bin,surface.vtp,volume.vtu,report.json,report.html}
and, for several cases, OUT/index.html and OUT/index.csv
endef
export HELP

help:
	@printf '%s\n' "$$HELP"

mesh: $(VOLUME) $(REPORT) $(PAGE)
	@printf '%s\n' '' 'surface     $(SURFACE)' 'tetrahedra  $(VOLUME)' 'report      $(REPORT)' 'page        $(PAGE)' 'pictures    $(D)/pictures/'

surface: $(SURFACE)
	@printf '%s\n' '' 'surface     $(SURFACE)'

demo:
	@$(MAKE) --no-print-directory CASE=demo mesh

# Every case, whether or not another one fails, then the index over those that came far enough.
cases: build env
	@status=0; $(MAKE) --no-print-directory -k NO_BUILD=yes $(addprefix case-,$(CASES)) || status=$$?; \
	  ( $(write_index) ) || { code=$$?; if [ $$status = 0 ]; then status=$$code; fi; }; exit $$status

# Over all cases in OUT, also those that failed.
index: env
	@$(write_index)

write_index = set -- $$(ls $(OUT)/*/*.report.json $(OUT)/*/*.report.failed.json 2>/dev/null); \
  if [ $$\# = 0 ]; then \
    printf '%s\n' 'error: $(OUT): no reports of cases' '  why it matters: the index is made from OUT/NAME/NAME.report.json' \
      '  what to do: make a case first (make CASE=demo), or say where they are (OUT=...)' >&2; exit 2; \
  fi; \
  $(TETMESH_CHECK)-index "$$@" -o $(OUT)/index.html --force && printf '%s\n' 'index       $(OUT)/index.html'

case-%: build env
	@$(MAKE) --no-print-directory CASE=$* CASES= NO_BUILD=yes mesh

ifneq ($(filter cases,$(MAKECMDGOALS)),)
  ifeq ($(strip $(CASES)),)
    $(error CASES is empty: name one or more files of pipelines/, as in make -j2 CASES="heart mickey" cases)
  endif
  ifneq ($(filter command line,$(origin NAME)),)
    $(error NAME is one name for several cases, whose results would replace each other: leave it out)
  endif
endif

# --- Programs ---------------------------------------------------------------------------------------------------------

build:
ifeq ($(NO_BUILD),)
	@$(CARGO) build --release --locked
endif

env:
ifeq ($(NO_BUILD),)
	@stages/tetmesh-check/setup-env.sh --venv $(VENV) $(without_hxt)
endif

# --- The chain --------------------------------------------------------------------------------------------------------

$(P)/phantom: FORCE | build
	$(call stamp,phantom,$(PHANTOM),$(BIN)/phantom)

$(P)/distfield: FORCE | build
	$(call stamp,distfield,$(INPUT) $(distfield_options),$(BIN)/distfield)

$(P)/sizefield: FORCE | build
	$(call stamp,sizefield,$(sizefield_options),$(BIN)/sizefield)

$(P)/seed: FORCE | build
	$(call stamp,seed,$(seed_options),$(BIN)/seed)

$(P)/particles: FORCE | build
	$(call stamp,particles,$(particles_options),$(BIN)/particles)

$(P)/reconstruct: FORCE | build
	$(call stamp,reconstruct,$(reconstruct_options),$(BIN)/reconstruct)

$(P)/tetmesh: FORCE | env
	$(call stamp,tetmesh-check,$(without_hxt) $(tetmesh_options),stages/tetmesh-check/requirements*.lock \
	  $(filter-out $(other_programs),$(sort $(wildcard stages/tetmesh-check/src/tetmesh_check/*.py))))

# They lie beside tetmesh-check and use its parts, but make no tetrahedra.
other_programs = %/convergence.py

$(P)/page: FORCE | env
	$(call stamp,tetmesh-check-page,,stages/tetmesh-check/src/tetmesh_check/page/*.*)

ifneq ($(PHANTOM),)
$(INPUT): $(P)/phantom
	$(BIN)/phantom $(PHANTOM) -o $@ --truth $(F).truth.json --force
endif

$(DISTFIELD): $(INPUT) $(P)/distfield
	$(call run,distfield,$(BIN)/distfield $(INPUT) -o $@ $(distfield_options))

$(SIZEFIELD): $(DISTFIELD) $(P)/sizefield
	$(call run,sizefield,$(BIN)/sizefield $(DISTFIELD) -o $@ $(sizefield_options))

$(SEEDS): $(DISTFIELD) $(SIZEFIELD) $(P)/seed
	$(call run,seed,$(BIN)/seed $(DISTFIELD) $(SIZEFIELD) -o $@ $(seed_options))

# A run that was stopped goes on from its checkpoint, unless something it depends on is newer.
CHECKPOINT = $(F).checkpoint.bin
$(PARTICLES): $(SEEDS) $(DISTFIELD) $(SIZEFIELD) $(P)/particles
	@for file in $^; do if [ $$file -nt $(CHECKPOINT) ]; then rm -f $(CHECKPOINT); fi; done
	$(call run,particles,$(BIN)/particles $(SEEDS) --distfield $(DISTFIELD) --sizefield $(SIZEFIELD) -o $@ \
	  --log $(F).passes.csv --checkpoint $(CHECKPOINT) --resume $(particles_options))
	@rm -f $(CHECKPOINT)

$(SURFACE): $(PARTICLES) $(DISTFIELD) $(SIZEFIELD) $(P)/reconstruct
	$(call run,reconstruct,$(BIN)/reconstruct $(PARTICLES) --distfield $(DISTFIELD) --sizefield $(SIZEFIELD) -o $@ \
	  $(reconstruct_options))

$(VOLUME) $(REPORT) &: $(SURFACE) $(SIZEFIELD) $(P)/tetmesh
	@mkdir -p $(D)/reports && rm -f $(VOLUME) $(REPORT) $(PAGE) $(call failed,$(VOLUME)) $(call failed,$(REPORT))
	@printf '%s\n' '$(strip $(tetmesh_command))'
	@$(tetmesh_command) || { code=$$?; \
	  if [ -e $(REPORT) ]; then mv -f $(REPORT) $(call failed,$(REPORT)); \
	    if [ $$code = 1 ] && [ -e $(VOLUME) ]; then mv -f $(VOLUME) $(call failed,$(VOLUME)); \
	      printf '%s\n' 'tetmesh-check: a check failed; the mesh is kept as $(call failed,$(VOLUME)), the report as $(call failed,$(REPORT))' >&2; \
	    fi; \
	    $(call page_command,$(call failed,$(REPORT))); \
	  fi; exit $$code; }
	@cp -f $(REPORT) $(D)/reports/tetmesh-check.json

tetmesh_command = $(TETMESH_CHECK) $(SURFACE) --sizefield $(SIZEFIELD) -o $(VOLUME) --report $(REPORT) --pictures $(D)/pictures \
                  --force $(VERBOSITY) $(call option,--threads,$(THREADS)) $(tetmesh_options)

# Also written where a check failed (above).
$(PAGE): $(REPORT) $(P)/page
	@printf '%s\n' '$(call page_command,$(REPORT))'
	@$(call page_command,$(REPORT))

page_command = $(TETMESH_CHECK)-page $(1) --name $(NAME) -o $(PAGE) --force

# --- Checks of the project itself -------------------------------------------------------------------------------------

test: format lint documentation test-rust test-python
	@printf '%s\n' '' 'make test: everything passed'

format:
	$(CARGO) fmt --check

lint:
	$(CARGO) clippy --locked --workspace --all-targets -- -D warnings

documentation:
	RUSTDOCFLAGS='-D warnings' $(CARGO) doc --locked --workspace --no-deps --quiet

test-rust: build env
	@tests/lavapipe.sh $(BIN)/particles
	$(CARGO) test --locked --workspace

# From the stage's own folder: its pyproject.toml holds the settings of all four.
test-python: build env
	cd stages/tetmesh-check && $(abspath $(VENV))/bin/ruff check . && $(abspath $(VENV))/bin/ruff format --check . \
	  && $(abspath $(VENV))/bin/mypy && $(abspath $(VENV))/bin/pytest -q

doctor:
	@sh tests/doctor.sh

# Every stage on the torso phantom of the paper's size, from nothing; GOAL=surface leaves out the tetrahedra.
PARTS ?= heart lungs ribs
GOAL ?= mesh
bench-stages: build env
	@status=0; for part in $(PARTS); do \
	  rm -rf $(OUT)/bench/torso-$$part; \
	  $(MAKE) --no-print-directory CASE=torso-$$part NAME=torso-$$part OUT=$(OUT)/bench NO_BUILD=yes $(GOAL) || status=$$?; \
	done; \
	python3 tests/stage_table.py $(addprefix $(OUT)/bench/torso-,$(PARTS)) && exit $$status

# The particles stage on the GPU against one CPU thread; BENCH_OPTIONS="--adapter NAME --sizes '2 1'" and the like.
BENCH_OPTIONS ?=
bench-gpu: build
	@stages/particles/benches/bench_gpu.sh --bin $(BIN) --work $(OUT)/bench-gpu $(BENCH_OPTIONS)

# The Delaunay triangulation against CGAL's, on the same particles; needs g++, libcgal-dev and libtbb-dev.
bench-delaunay: build
	@$(CARGO) build --release --locked -p isoparticles-delaunay --example bench_delaunay
	@common/delaunay/benches/compare.sh --bin $(BIN) --work $(OUT)/bench-delaunay $(BENCH_OPTIONS)

# The error of Poisson's equation on the ball at several edge lengths, mm.
SIZES ?= 4 2 1
bench-convergence: build env
	@for size in $(SIZES); do \
	  $(MAKE) --no-print-directory CASE=ball NAME=ball-$$size SIZE=$$size OUT=$(OUT)/bench NO_BUILD=yes VERBOSITY=-q mesh || exit $$?; \
	done
	$(TETMESH_CHECK)-convergence $(foreach size,$(SIZES),$(OUT)/bench/ball-$(size)/ball-$(size).volume.vtu)

# Our surfaces against marching cubes and a remesher on the same distance field, through the same tetrahedralizer.
# COMPARE_OPTIONS="--surfaces particles remesh_botsch --fill-seconds 600" and the like.
COMPARED ?= ball mickey
COMPARE_OPTIONS ?=
# The remesher has an environment of its own, for this alone; REMESHER=no does without.
REMESHER ?= yes
BENCH_VENV ?= .venv-bench
BENCH_LOCK = stages/tetmesh-check/benches/requirements.lock
with_remesher = $(if $(filter no,$(REMESHER)),,$(BENCH_VENV)/.made)
bench-marching-cubes: build env $(with_remesher)
	@for part in $(COMPARED); do \
	  $(MAKE) --no-print-directory CASE=$$part NAME=$$part OUT=$(OUT)/bench NO_BUILD=yes surface || exit $$?; \
	done
	$(VENV)/bin/python stages/tetmesh-check/benches/marching_cubes.py $(addprefix $(OUT)/bench/,$(COMPARED)) \
	  --work $(OUT)/bench/marching-cubes $(if $(with_remesher),--remesher $(BENCH_VENV)/bin/python) $(COMPARE_OPTIONS)

$(BENCH_VENV)/.made: $(BENCH_LOCK) | env
	$(VENV)/bin/python -m venv --clear $(BENCH_VENV)
	$(BENCH_VENV)/bin/python -m pip install --quiet --disable-pip-version-check --no-input --only-binary :all: --require-hashes -r $(BENCH_LOCK)
	@touch $@
