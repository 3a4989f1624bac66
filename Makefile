# The goals of the project. `make` lists them, and README.md explains them.
#
# The program `isoparticles-case` (pipelines/case) decides which results must be made again: it
# compares the dependencies of each result with those recorded in OUT/NAME/NAME.status.json. This
# file builds the programs, reads the case files, and passes each setting and its origin to that
# program.

SHELL := /bin/sh
.DELETE_ON_ERROR:
.SUFFIXES:
MAKEFLAGS += --no-builtin-rules

CARGO ?= cargo
CARGO_TARGET_DIR ?= target
# Cargo's profile of the programs, and options of `cargo build`.
BUILD := release
BUILD_OPTIONS :=
# Folder of the programs. With NO_BUILD=yes, they are used without being built first, as in the
# tests of this file.
BIN ?= $(CARGO_TARGET_DIR)/$(BUILD:dev=debug)
# Folder of the programs for the tests and for the wheel.
export ISOPARTICLES_BIN = $(abspath $(BIN))
NO_BUILD ?=
# The Python environment of tetmesh-check.
VENV ?= .venv
TETMESH_CHECK ?= $(VENV)/bin/tetmesh-check
# HXT=no omits Gmsh (GPL-2.0-or-later). fTetWild then fills large surfaces as well.
HXT ?= yes
without_hxt = $(if $(filter no,$(HXT)),--without-hxt)
# Folder of the real volumes for the cases in pipelines/.
DATA ?= ../shared/data
# The results of a case are written to OUT/NAME/.
OUT ?= out
# An option for every stage, such as VERBOSITY=-v or -q. It does not affect the results.
VERBOSITY ?=
THREADS ?=

# Keys that a case may set (pipelines/case/src/keys.rs explains them). The command line takes
# precedence over the case file. The environment is ignored, because short names such as NAME or
# SIZE may mean something else there.
KEYS := NAME INPUT PHANTOM SERIES DATASET SPACING CROP DOWNSAMPLE ISO LABELS MATERIALS INSIDE BORDER SPACE SCALE EPSILON DELTA SIZE MIN_SIZE MAX_SIZE VERTICES QUALITY RESIZE COUNT SEED \
        BACKEND TET_ORDER FOR ACCEPT_LOSSES ACCEPT_FORCED MAX_MEMORY DISTFIELD_OPTIONS SIZEFIELD_OPTIONS PARTICLES_OPTIONS RECONSTRUCT_OPTIONS TETMESH_OPTIONS
$(foreach key,$(KEYS) CASE CASES,$(if $(filter environment,$(origin $(key))),$(eval undefine $(key))))
# Other variables of this file.
OTHERS := CASE CASES LIST TIME_LIMIT PORT BUILD PROFILE CLUSTER_OPTIONS SNAKEMAKE SNAKEMAKE_VENV BIN NO_BUILD SDIST_TEST CARGO CARGO_TARGET_DIR VENV TETMESH_CHECK HXT DATA OUT VERBOSITY THREADS PARTS GOAL SIZES \
          BENCH_OPTIONS FUZZ_SECONDS FUZZ_JOBS FUZZ_TARGETS COMPARED COMPARE_OPTIONS REMESHER BENCH_VENV SCALE_CASES SCALE_VERTICES REMESHER_CASES REMESHER_VERTICES MATERIALS_CASES PEER_CASES N KILL_SEED DOCS_VENV RECIPE
# Goals for one case.
CASE_GOALS := distfield sizefield seed particles reconstruct surface mesh page verdict info clean

define newline


endef
# $(call stop,WHAT,WHY,NEXT)
comma := ,
stop = $(error $(1)$(newline)  why it matters: $(2)$(newline)  what to do: $(3))

ifneq ($(CASE),)
  ifeq ($(wildcard pipelines/$(CASE).mk),)
    $(call stop,pipelines/$(CASE).mk: not found,CASE names a file there,choose one of: $(basename $(notdir $(wildcard pipelines/*.mk))))
  endif
  before := before $(.VARIABLES)
  include pipelines/$(CASE).mk
  # A misspelled key in the case file is also passed on, so that isoparticles-case can suggest the
  # nearest key.
  KEYS += $(filter-out $(before) $(KEYS),$(.VARIABLES))
endif

.DEFAULT_GOAL := $(if $(CASE),mesh,help)

# Unknown variables on the command line. isoparticles-case suggests the nearest key. Goals that do
# not run it fail here.
by_user = $(filter command,$(firstword $(origin $(1))))
unknown := $(strip $(foreach name,$(.VARIABLES),$(if $(call by_user,$(name)),$(filter-out $(KEYS) $(OTHERS),$(name)))))
ifneq ($(unknown),)
  ifeq ($(filter $(CASE_GOALS) demo cases batch cluster index view,$(or $(MAKECMDGOALS),$(.DEFAULT_GOAL))),)
    $(call stop,$(unknown): no such variable,it would be ignored,choose among $(KEYS) $(OTHERS))
  endif
endif

# --- A case ---------------------------------------------------------------------------------------

# $(call quote,TEXT): TEXT quoted as a single shell word.
quote = '$(subst ','\'',$(1))'
# $(call set,KEY): the user's value of KEY or, if there is none, the case file's value as a
# --preset.
set = $(if $(call by_user,$(1)),$(call quote,$(1)=$($(1))),$(if $($(1)),--preset $(call quote,$(1)=$($(1)))))
# If one of these files changes, the tetrahedra or the page must be made again.
TETMESH = stages/tetmesh-check/src/tetmesh_check
TETMESH_FILES = $(wildcard $(BIN)/libisoparticles_python.so stages/tetmesh-check/requirements*.lock) \
                $(sort $(wildcard $(TETMESH)/*.* $(TETMESH)/*/*.py $(TETMESH)/export/templates/*))
PAGE_FILES = $(sort $(wildcard $(TETMESH)/report/page/*.* $(TETMESH)/report/page/*/*.html))

# $(call case,GOAL)
case = $(call quote,$(BIN)/isoparticles-case) $(1) $(foreach key,$(KEYS) OUT VERBOSITY THREADS $(if $(without_hxt),HXT) $(unknown),$(call set,$(key))) \
  $(if $(CASE),--case-file $(call quote,$(CASE))) --known $(OTHERS) --bin $(call quote,$(BIN)) \
  --tetmesh-check $(call quote,$(TETMESH_CHECK)) --tetmesh-files $(TETMESH_FILES) --page-files $(PAGE_FILES)

# --- Goals ----------------------------------------------------------------------------------------

.PHONY: help $(CASE_GOALS) demo cases batch cluster index view build env snakemake-env wheel sdist release-check completions doctor test format lint documentation docs test-rust test-python fuzz deny bench-stages \
        bench-particles bench-gpu bench-delaunay bench-convergence bench-marching-cubes bench-scale bench-remeshers bench-materials-peers bench-peers bench-scaling bench-kills bench-batch bench-solvers formats bench-paper bench-growth results-page notebooks recipes gallery

define HELP
Volumes in, simulation-ready meshes out.

  make demo                                    build everything and mesh a phantom, up to the tetrahedra
  make doctor                                  list the missing requirements and how to install them
  make info INPUT=v.nrrd                       describe a volume and suggest options
  make mesh INPUT=v.nrrd ISO=300               mesh the region above 300 (INSIDE=below: the region below)
  make mesh INPUT=v.nrrd LABELS=1,2            mesh the union of labels 1 and 2
  make mesh INPUT=v.nrrd MATERIALS=all         mesh all labels together, with shared interfaces
                                               (MATERIALS=lungs:2,rest:1+3 selects and names them)
  make CASE=heart                              mesh the case of pipelines/heart.mk
  make -j2 CASES="heart mickey" cases          mesh several cases in parallel
  make batch LIST=cases.csv                    mesh the cases of a list: one column per parameter, one row per case;
                                               continues after failures and resumes where it was stopped
                                               (TIME_LIMIT=2h per case; GOAL=surface)
  make cluster LIST=cases.csv PROFILE=slurm    the same list, each stage as a Slurm job;
                                               PROFILE=local: several cases in parallel on this machine
  make surface ...                             stop at the triangles; distfield, sizefield, seed, particles stop earlier
  make verdict CASE=heart                      print the outcome: verdict, warnings, path of the page
  make page CASE=heart                         regenerate its page
  make view CASE=heart                         look at the case in the browser and refine it there (PORT=8765; NAME=...,
                                               INPUT=v.nrrd)
  make index                                   make a page about all cases in OUT (also part of make cases)
  make clean CASE=heart                        remove its results folder (or give NAME=...)
  make wheel                                   build target/wheel/isoparticles-*.whl; pip install it, then run
                                               `isoparticles help`
  make sdist                                   build target/wheel/isoparticles-*.tar.gz, which needs Rust
  make release-check                           dry run of a release (RELEASING.md): versions, packages, their tests
  make completions                             write completions for bash, zsh and fish, and man pages, to target/share
  make test                                    check format, lints and documentation, and run all tests
  make docs                                    build the documentation site, target/docs/index.html (Sphinx)
  make fuzz                                    fuzz every file reader for FUZZ_SECONDS=60 each, FUZZ_JOBS=1 in parallel
                                               (nightly Rust, cargo-fuzz)
  make deny                                    check licences and advisories of the linked crates (cargo-deny, cargo-audit)
  make bench-stages                            measure time and memory of every stage on the torso phantom
  make bench-particles                         time the particles stage on the CPU for several size contrasts and
                                               thread counts (BENCH_OPTIONS=...)
  make bench-gpu                               compare the particles stage on the GPU with one CPU thread (BENCH_OPTIONS=...)
  make bench-delaunay                          compare the Delaunay triangulation with CGAL's
                                               (BENCH_OPTIONS=...; needs libcgal-dev)
  make bench-convergence                       measure the error for a known solution on the ball at several edge lengths
  make bench-marching-cubes                    compare tetrahedra in our surfaces with those in surfaces of marching cubes
                                               and of a remesher (COMPARED=...)
  make bench-kills N=100                       kill runs of a small case at random moments; the next run must give the
                                               same files
  make bench-batch                             run, interrupt and resume a batch of 50 phantoms, real volumes and
                                               invalid rows
  make bench-solvers                           solve a known problem with every installed finite-element program,
                                               from its own file format
  make formats                                 write a ball in every input format with other programs, and compare the
                                               meshes (BENCH_OPTIONS="--only dicom", --large: times to read 512^3)
  make bench-paper                             measure the paper's Tables 1 to 4, as rows of docs/results/paper.json
                                               (BENCH_OPTIONS=--quick, for example)
  make bench-growth                            measure time and memory of every stage by voxels, particles, cores and
                                               materials, as rows of docs/results/growth.json
  make results-page                            make docs/results.md and its pictures from these rows
  make notebooks                               run the notebooks in docs/notebooks, with results in OUT/notebooks
  make recipes                                 run the recipes of docs/recipes and compare their figures (RECIPE=torso;
                                               results in OUT/recipes)
  make gallery                                 draw all pictures of docs/recipes, with triangles of other programs
  make bench-remeshers                         compare every packaged remesher with ours at several vertex counts
                                               (REMESHER_CASES=... REMESHER_VERTICES=...)
  make bench-materials-peers                   compare meshes of many materials with those of CGAL's Mesh_3, Cleaver and
                                               surface nets (MATERIALS_CASES=...; g++, libcgal-dev)
  make bench-scale                             compare coarse meshes of real volumes with those of two remeshers
                                               (SCALE_CASES=... SCALE_VERTICES=...)

Parameters of a case. They take precedence over the case file; unset parameters have the default of the stage:
  NAME=...      name of the results [the volume's]       OUT=...       folder of the results [out]
  EPSILON=...   ratio of h to local feature size         DELTA=...     maximum gradient of h
  SIZE=...      constant edge length, mm                 MIN_SIZE=...  MAX_SIZE=...  bounds of h, mm
  VERTICES=...  number of vertices, instead of a size    QUALITY=...   coarse, medium or fine
  SCALE=...     smooth away features below this, mm      BORDER=...    cap, flat or open
  SEED=...      seed for random numbers                  BACKEND=...   auto, gpu or cpu
  RESIZE="ball:X,Y,Z,RADIUS=H mask:FILE=H"  change h in regions of the finished surface, one after the other
  COUNT=...     number of particles to seed              PHANTOM=...   shape to mesh instead of INPUT: "ball --size 32"
  SPACE=...     world frame of the results: lps, ras, or scanner, that of INPUT [lps]
  SERIES=...    series to mesh, if a folder of DICOM files contains several
  DATASET=...   array of an HDF5, MATLAB or Zarr file: a path, a variable or a level
  SPACING=...   voxel spacing, mm, of a file that does not contain it (0.01 or 1,1,2)
  CROP=...      region to keep: mm:0..50,..,10.. or voxels:0..99,..,.. or a mask file
  DOWNSAMPLE=.. join this many voxels along each axis (2 or 2,2,1)
  THREADS=...   CPU threads [all]                        MAX_MEMORY=.. maximum memory of a stage
  TET_ORDER=2   also write quadratic tetrahedra; mid-edge nodes of surface edges lie on F = 0 or on the interfaces
  FOR=...       also write the tetrahedra for this program: simnibs, brainstorm, opencarp, febio,
                calculix or fenicsx
  ACCEPT_LOSSES=yes  accept materials whose volume a scale changes by more than 10 %; the verdict lists them
  ACCEPT_FORCED=yes  accept elements below a limit where the surface of many materials allows no better ones;
                the verdict counts them
  HXT=no        do not use Gmsh; large surfaces then take hours
  VERBOSITY=... -q, -v or -vv                            DATA=...      folder of the volumes for pipelines/ [../shared/data]
  DISTFIELD_OPTIONS="..."  SIZEFIELD_OPTIONS="..."  PARTICLES_OPTIONS="..."  RECONSTRUCT_OPTIONS="..."  TETMESH_OPTIONS="..."
                more options of a stage, such as DISTFIELD_OPTIONS="--keep largest"; docs/commands.md lists them
Results: OUT/NAME/NAME.{distfield.vti,sizefield.vti,seeds.bin,particles.bin,surface.vtp,volume.vtu,report.json},
the page in NAME.report.html, the state in NAME.status.json; for several cases OUT/index.html and OUT/index.csv
endef
export HELP

help:
	@printf '%s\n' "$$HELP"

# These goals need the Python environment. Other goals make a page only if the environment exists.
mesh page: build env
distfield sizefield seed particles reconstruct surface verdict info clean: build
$(CASE_GOALS):
	@$(call case,$@)

demo:
	@$(MAKE) --no-print-directory CASE=demo mesh

# Makes every case, even if another one fails. Then makes the index and prints the verdicts.
cases: build env
	@status=0; $(MAKE) --no-print-directory -k NO_BUILD=yes $(addprefix case-,$(CASES)) || status=$$?; \
	  $(call case,index) || { code=$$?; if [ $$status = 0 ]; then status=$$code; fi; }; \
	  for name in $(CASES); do $(MAKE) --no-print-directory CASE=$$name CASES= NO_BUILD=yes verdict || true; done; exit $$status

# Makes the case of every row of a list, then a summary and the index.
LIST ?=
TIME_LIMIT ?=
batch: build env
	@$(call case,batch) $(if $(LIST),--list $(call quote,$(LIST))) $(if $(TIME_LIMIT),--time-limit $(call quote,$(TIME_LIMIT))) --as-far-as $(GOAL)

# Makes the cases of a list with Snakemake. PROFILE is local, slurm or a folder that contains a
# config.yaml. CLUSTER_OPTIONS are passed to Snakemake. An invalid list is rejected before any job
# starts. The summary and the index are made even if jobs fail.
PROFILE ?= local
CLUSTER_OPTIONS ?=
SNAKEMAKE_VENV ?= .venv-snakemake
SNAKEMAKE ?= $(SNAKEMAKE_VENV)/bin/snakemake
CLUSTER_DIR = $(OUT)/.cluster
over_list = $(call case,$(1)) $(if $(LIST),--list $(call quote,$(LIST))) --as-far-as $(GOAL)
# 90 % of the memory of this machine, in MiB.
all_memory = $(shell awk '/MemTotal/ { print int($$2 / 1024 * 0.9) }' /proc/meminfo)
cluster: build env $(if $(NO_BUILD),,snakemake-env)
	@mkdir -p $(call quote,$(CLUSTER_DIR)) && $(call over_list,rows) > $(call quote,$(CLUSTER_DIR)/rows.new) \
	  && mv $(call quote,$(CLUSTER_DIR)/rows.new) $(call quote,$(CLUSTER_DIR)/rows.jsonl)
	@rm -rf $(call quote,$(CLUSTER_DIR)/logs)
	@made=0; $(SNAKEMAKE) --snakefile pipelines/Snakefile --directory $(call quote,$(OUT)) \
	  --profile $(call quote,$(if $(wildcard pipelines/profiles/$(PROFILE)/config.yaml),pipelines/profiles/)$(PROFILE)) \
	  $(if $(filter local,$(PROFILE)),--resources gpu=1 mem_mb=$(all_memory)) $(CLUSTER_OPTIONS) || made=$$?; \
	  $(call over_list,summary) || made=$$?; exit $$made

snakemake-env: $(SNAKEMAKE_VENV)/.made

# The package connection-pool is available only as source.
$(SNAKEMAKE_VENV)/.made: pipelines/snakemake.lock | env
	@$(VENV)/bin/python -m venv --clear $(SNAKEMAKE_VENV)
	@$(SNAKEMAKE_VENV)/bin/python -m pip install --quiet --disable-pip-version-check --no-input --only-binary :all: --no-binary connection-pool \
	  --require-hashes -r pipelines/snakemake.lock
	@touch $@

# Makes the index of all cases in OUT, including failed cases.
index: build env
	@$(call case,index)

# Shows the results of a case or, if there are none, its volume.
PORT ?= 0
results_name = $(or $(NAME),$(CASE))
viewed = $(or $(and $(results_name),$(patsubst %/,%,$(dir $(firstword $(wildcard $(OUT)/$(results_name)/*.status.json))))),$(INPUT))
view: build env
	$(if $(viewed),,$(call stop,no case,the page shows the results of a case or a volume,give CASE=... or NAME=... or INPUT=...))
	@$(VENV)/bin/python -m isoparticles view $(call quote,$(viewed)) --out $(call quote,$(OUT)) $(if $(results_name),--name $(call quote,$(results_name))) --port $(PORT)

case-%: build env
	@$(MAKE) --no-print-directory CASE=$* CASES= NO_BUILD=yes mesh

ifneq ($(filter cases,$(MAKECMDGOALS)),)
  ifeq ($(strip $(CASES)),)
    $(call stop,CASES is empty,it names the cases to make,name one or more files of pipelines/$(comma) as in make -j2 CASES="heart mickey" cases)
  endif
  ifneq ($(call by_user,NAME),)
    $(call stop,NAME=$(NAME) is one name for several cases,their results would replace each other,leave it out)
  endif
endif

# --- Programs -------------------------------------------------------------------------------------

# setup-env.sh makes the package isoparticles importable in VENV, and this link its native module.
build:
ifeq ($(NO_BUILD),)
	@$(CARGO) build --profile $(BUILD) --locked $(BUILD_OPTIONS)
	@ln -sf $(call quote,$(abspath $(BIN))/libisoparticles_python.so) pipelines/wheel/src/isoparticles/_native.abi3.so
endif

env:
ifeq ($(NO_BUILD),)
	@stages/tetmesh-check/setup-env.sh --venv $(VENV) $(without_hxt)
endif

# Builds a wheel of all programs for `pip install`: target/wheel/isoparticles-*.whl. hatch_build.py
# takes stripped copies of the programs and of the native module from ISOPARTICLES_BIN. auditwheel
# checks the versions of their symbols, and tags the wheel with the oldest glibc that has them.
WHEEL = $(CARGO_TARGET_DIR)/wheel
WHEEL_VENV = $(CARGO_TARGET_DIR)/wheel-venv
WHEEL_PROGRAMS = distfield sizefield seed particles reconstruct phantom isoparticles-case isoparticles-volume
wheel: build env $(WHEEL_VENV)/.made completions
	@rm -rf $(WHEEL)/bin $(WHEEL)/raw $(WHEEL)/*.whl && mkdir -p $(WHEEL)/bin
	@for name in $(WHEEL_PROGRAMS) libisoparticles_python.so; do strip -o $(WHEEL)/bin/$$name $(BIN)/$$name || exit $$?; done
	@ISOPARTICLES_BIN=$(abspath $(WHEEL)/bin) $(WHEEL_VENV)/bin/python -m pip wheel --quiet --no-deps --no-build-isolation -w $(WHEEL)/raw .
	@PATH=$(abspath $(WHEEL_VENV)/bin):$$PATH auditwheel repair -w $(WHEEL) $(WHEEL)/raw/*.whl
	@ls $(WHEEL)/*.whl

# Builds the source distribution, target/wheel/isoparticles-*.tar.gz; to install it, pip needs Rust.
# SDIST_TEST=yes also installs it in a fresh environment, and runs the tests of the wheel there.
sdist: $(WHEEL_VENV)/.made completions
	@rm -rf $(WHEEL)/*.tar.gz $(WHEEL)/fresh
	@$(WHEEL_VENV)/bin/python -m hatchling build -t sdist -d $(WHEEL)
ifneq ($(SDIST_TEST),)
	@$(VENV)/bin/python -m venv $(WHEEL)/fresh
	@env -u ISOPARTICLES_BIN -u CARGO_TARGET_DIR $(WHEEL)/fresh/bin/pip install --quiet "$$(ls $(WHEEL)/*.tar.gz)[fem,formats,hxt,view]" pytest pytest-timeout
	@env -u WHEEL -u ISOPARTICLES_BIN $(WHEEL)/fresh/bin/pytest -q -c pipelines/wheel/pytest.ini pipelines/wheel/tests
endif

# Dry run of a release: builds and tests all packages, and publishes nothing (RELEASING.md).
release-check: env
	@tests/release.sh '$(MAKE)' $(call quote,$(abspath $(VENV))/bin/python) $(call quote,$(abspath $(WHEEL)))

$(WHEEL_VENV)/.made: pipelines/wheel/requirements.lock | env
	@$(VENV)/bin/python -m venv --clear $(WHEEL_VENV)
	@$(WHEEL_VENV)/bin/python -m pip install --quiet --disable-pip-version-check --no-input --require-hashes -r pipelines/wheel/requirements.lock
	@touch $@

# Generates shell completions and man pages from the command lines of the programs, in the folder
# layout of /usr/share. The wheel contains those for its own commands.
SHARE = $(CARGO_TARGET_DIR)/share
SHARE_STAGES = distfield sizefield seed particles reconstruct
SHARE_GOALS = info convert read mesh surface verdict page clean demo index view batch tetmesh-check
completions: build env
	@rm -rf $(SHARE) && mkdir -p $(addprefix $(SHARE)/,bash-completion/completions zsh/site-functions fish/vendor_completions.d man/man1)
	@lines=$$(mktemp -d) && trap 'rm -rf "$$lines"' EXIT && bin=$(call quote,$(BIN)) && shells() { command=$$1 name=$$2 && shift 2 \
	  && "$$command" --completions bash "$$@" > $(SHARE)/bash-completion/completions/$$name \
	  && "$$command" --completions zsh "$$@" > $(SHARE)/zsh/site-functions/_$$name \
	  && "$$command" --completions fish "$$@" > $(SHARE)/fish/vendor_completions.d/$$name.fish; }; \
	  for stage in $(SHARE_STAGES); do shells "$$bin/$$stage" $$stage && "$$bin/$$stage" --man-page > $(SHARE)/man/man1/$$stage.1 \
	    && "$$bin/$$stage" --command-line > "$$lines/$$stage" || exit $$?; done; \
	  $(call quote,$(TETMESH_CHECK)) --command-line > "$$lines/tetmesh-check" || exit $$?; \
	  set -- --command-lines "$$lines"/*; front="$$bin/isoparticles-case"; \
	  shells "$$front" isoparticles "$$@" && shells "$$front" tetmesh-check tetmesh-check "$$@" \
	    && "$$front" --man-page "$$@" > $(SHARE)/man/man1/isoparticles.1 || exit $$?; \
	  for goal in $(SHARE_GOALS); do "$$front" --man-page $$goal "$$@" > $(SHARE)/man/man1/isoparticles-$$goal.1 || exit $$?; done
	@echo $(SHARE)

# --- Checks of the project itself -----------------------------------------------------------------

# The Python environment of Sphinx.
DOCS_VENV ?= .venv-docs

# Tests use programs of the profile `dev`, which checks overflow and assertions. Programs and Rust
# tests are built together: built apart, their features differ, and most crates compile twice. The
# wheel of the tests has its own folder.
test-rust test-python: BUILD = dev
test-rust test-python: BUILD_OPTIONS = --lib --bins --tests
test-python: WHEEL = $(BIN)/wheel

test:
	@tests/run_all.sh '$(MAKE)' format lint documentation docs test-rust test-python

format:
	$(CARGO) fmt --check

lint:
	$(CARGO) clippy --locked --workspace --all-targets -- -D warnings

documentation:
	RUSTDOCFLAGS='-D warnings' $(CARGO) doc --locked --workspace --no-deps --quiet

test-rust: build env
	@tests/lavapipe.sh $(BIN)/particles
	$(CARGO) test --locked --workspace --no-fail-fast

# Runs in the folder of tetmesh-check, whose pyproject.toml configures all four tools.
test-python: build env wheel
	cd stages/tetmesh-check && $(abspath $(VENV))/bin/ruff check . && $(abspath $(VENV))/bin/ruff format --check . \
	  && $(abspath $(VENV))/bin/mypy && $(abspath $(VENV))/bin/pytest -q
	for verb in check 'format --check'; do $(VENV)/bin/ruff $$verb --config stages/tetmesh-check/pyproject.toml pipelines/call.py docs/conf.py docs/recipes tests stages/reconstruct/benches stages/distfield/benches/scale.py stages/distfield/benches/remesh_peers.py || exit $$?; done
	$(VENV)/bin/pytest -q -p no:cacheprovider tests/test_docs.py tests/test_style.py tests/results
	cd pipelines/wheel && settings=../../stages/tetmesh-check/pyproject.toml && $(abspath $(VENV))/bin/ruff check --config $$settings . \
	  && $(abspath $(VENV))/bin/ruff format --config $$settings --check . \
	  && $(abspath $(VENV))/bin/mypy --strict --python-version 3.11 src/isoparticles \
	  && WHEEL=$(abspath $(WHEEL)) $(abspath $(VENV))/bin/pytest -q -c pytest.ini

# Builds the documentation site, target/docs/index.html. Warnings are errors.
docs: $(DOCS_VENV)/.made
	$(DOCS_VENV)/bin/sphinx-build -W --keep-going --quiet docs $(CARGO_TARGET_DIR)/docs
	@echo $(CARGO_TARGET_DIR)/docs/index.html

$(DOCS_VENV)/.made: docs/requirements.lock | env
	@$(VENV)/bin/python -m venv --clear $(DOCS_VENV)
	@$(DOCS_VENV)/bin/python -m pip install --quiet --disable-pip-version-check --no-input --only-binary :all: \
	  --require-hashes -r docs/requirements.lock
	@touch $@

doctor:
	@sh tests/doctor.sh

# Fuzzes every reader, or only FUZZ_TARGETS, for FUZZ_SECONDS each, with FUZZ_JOBS in parallel.
# Needs nightly Rust and cargo-fuzz.
FUZZ_SECONDS ?= 60
FUZZ_JOBS ?= 1
fuzz:
	@tests/fuzz/run.sh --seconds $(FUZZ_SECONDS) --jobs $(FUZZ_JOBS) $(FUZZ_TARGETS)

# Checks licences, advisories and sources of the linked crates (deny.toml), and runs cargo-audit,
# RustSec's own check. Needs cargo-deny, cargo-audit and network access.
deny:
	$(CARGO) deny --locked check
	$(CARGO) audit

# Runs every stage from scratch on parts of the torso phantom at the paper's size. GOAL=surface
# omits the tetrahedra.
PARTS ?= heart lungs ribs
GOAL ?= mesh
bench-stages: build env
	@status=0; for part in $(PARTS); do \
	  rm -rf $(OUT)/bench/torso-$$part; \
	  $(MAKE) --no-print-directory CASE=torso-$$part NAME=torso-$$part OUT=$(OUT)/bench NO_BUILD=yes $(GOAL) || status=$$?; \
	done; \
	python3 tests/stage_table.py $(addprefix $(OUT)/bench/torso-,$(PARTS)) && exit $$status

# Compares the particles stage on the GPU with the same stage on one CPU thread. Example:
# BENCH_OPTIONS="--adapter NAME --sizes '2 1'".
BENCH_OPTIONS ?=
bench-gpu: build
	@stages/particles/benches/bench_gpu.sh --bin $(BIN) --work $(OUT)/bench-gpu $(BENCH_OPTIONS)

# Times the particles stage on the CPU. BENCH_OPTIONS="--beside OLDER/particles" alternates with
# runs of another build.
bench-particles: build
	@stages/particles/benches/bench_cpu.sh --bin $(BIN) --work $(OUT)/bench-gpu $(BENCH_OPTIONS)

# Compares our Delaunay triangulation with CGAL's for the same particles. Needs g++, libcgal-dev and
# libtbb-dev.
bench-delaunay: build
	@$(CARGO) build --release --locked -p isoparticles-delaunay --example bench_delaunay
	@common/delaunay/benches/compare.sh --bin $(BIN) --work $(OUT)/bench-delaunay $(BENCH_OPTIONS)

# Measures the error of the solution of Poisson's equation on the ball at several edge lengths (mm),
# and compares preconditioners.
SIZES ?= 4 2 1
bench-convergence: build env
	@for size in $(SIZES); do \
	  $(MAKE) --no-print-directory CASE=ball NAME=ball-$$size SIZE=$$size SCALE=0 OUT=$(OUT)/bench NO_BUILD=yes VERBOSITY=-q mesh || exit $$?; \
	done
	$(VENV)/bin/python stages/tetmesh-check/benches/convergence.py $(foreach size,$(SIZES),$(OUT)/bench/ball-$(size)/ball-$(size).volume.vtu)

# Compares our surfaces with those of marching cubes and of a remesher, from the same distance field
# and with the same tetrahedralizer. Example: COMPARE_OPTIONS="--surfaces particles remesh_botsch
# --fill-seconds 600".
COMPARED ?= ball mickey
COMPARE_OPTIONS ?=
# The remesher is installed in a separate environment. REMESHER=no omits it.
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

# Kills runs of a small case N times at random moments, and compares the results of the next run
# with those of an uninterrupted run. KILL_SEED is the seed of the random moments.
N ?= 100
KILL_SEED ?= 1
bench-kills: build env
	@$(VENV)/bin/python tests/kills.py --count $(N) --seed $(KILL_SEED) --bin $(abspath $(BIN)) --tetmesh-check $(abspath $(TETMESH_CHECK))

# Runs fifty phantoms, the small volumes in DATA and five invalid rows as one batch. Interrupts the
# batch, runs it again and checks the results. GOAL=mesh continues up to the tetrahedra.
bench-batch: build env
	@$(VENV)/bin/python tests/batch.py --bin $(abspath $(BIN)) --tetmesh-check $(abspath $(TETMESH_CHECK)) --goal $(if $(call by_user,GOAL),$(GOAL),surface) \
	  $(if $(wildcard $(DATA)/mickey_labels.nrrd),--data $(DATA))

# Solves a known problem with CalculiX, GetDP, FreeFEM and dolfinx, as far as they are installed
# (Debian: calculix-ccx getdp freefem++ libfreefem++ python3-dolfinx).
bench-solvers: build env
	@for order in 1 2; do \
	  $(MAKE) --no-print-directory mesh PHANTOM="ball --size 32" NAME=order-$$order ISO=100 SIZE=2 BACKEND=cpu TET_ORDER=$$order OUT=$(OUT)/bench/solvers NO_BUILD=yes VERBOSITY=-q \
	    TETMESH_OPTIONS="--export inp,msh,msh2,med,xdmf --method hxt" || exit $$?; \
	done
	@$(VENV)/bin/python tests/solvers.py $(OUT)/bench/solvers/order-1 $(OUT)/bench/solvers/order-2

# Writes one ball in every input format with other programs, and compares the meshes of the files.
# BENCH_OPTIONS="--large" measures the times to read 512^3 voxels instead.
formats: build env $(BENCH_VENV)-formats/.made
	@PYTHONPATH=pipelines/wheel/src $(BENCH_VENV)-formats/bin/python tests/formats.py --bin $(BIN) --work $(OUT)/formats \
	  $(if $(wildcard $(DATA)/thorax_labels.nrrd),--data $(DATA)) $(BENCH_OPTIONS)

$(BENCH_VENV)-formats/.made: tests/formats-requirements.txt | env
	@$(VENV)/bin/python -m venv --clear $(BENCH_VENV)-formats
	@$(BENCH_VENV)-formats/bin/python -m pip install --quiet --disable-pip-version-check --no-input -r tests/formats-requirements.txt
	@touch $@

# Runs the notebooks with nbclient, which is installed in a folder outside the environment.
NOTEBOOK_ENV = $(CARGO_TARGET_DIR)/notebook
notebooks: build env $(NOTEBOOK_ENV)/.made
	@rm -rf $(call quote,$(OUT)/notebooks) && mkdir -p $(call quote,$(OUT)/notebooks) && cp docs/notebooks/*.ipynb $(call quote,$(OUT)/notebooks)
	@cd $(call quote,$(OUT)/notebooks) && PYTHONPATH=$(abspath $(NOTEBOOK_ENV))$${PYTHONPATH:+:$$PYTHONPATH} \
	  $(abspath $(VENV))/bin/python -c "from nbclient.cli import main; main()" *.ipynb --inplace --timeout 300
	@ls $(call quote,$(OUT)/notebooks)/*.ipynb

# Runs the code of the recipes in docs/recipes, or only of RECIPE, and compares the figures of the
# pages.
RECIPE ?=
RECIPES = $(VENV)/bin/python docs/recipes/run.py --work $(call quote,$(OUT)/recipes)
recipes: build env
	@$(RECIPES) $(RECIPE)

# Draws all pictures of docs/recipes: those of the recipes, and triangles of other programs. All
# programs mesh the femur of its recipe, with about as many vertices as its voxels give marching
# cubes.
gallery: build env $(BENCH_VENV)-scale/.made
	@$(RECIPES) --pictures
	@rm -rf $(call quote,$(OUT)/recipes/peers)
	@$(VENV)/bin/python $(SCALE_BENCH)/scale.py 'femur=$(OUT)/recipes/femur/femur-label.nrrd;--labels 1' --vertices 15000 --no-distances \
	  --bin $(BIN) --work $(call quote,$(OUT)/recipes/peers) --peers $(BENCH_VENV)-scale/bin/python --programs marching-cubes surface-nets cgal
	@$(VENV)/bin/python docs/recipes/pictures.py peers $(call quote,$(OUT)/recipes/peers)

$(NOTEBOOK_ENV)/.made: docs/notebooks/requirements.lock | env
	@rm -rf $(NOTEBOOK_ENV)
	@$(VENV)/bin/python -m pip install --quiet --disable-pip-version-check --no-input --only-binary :all: --require-hashes --target $(NOTEBOOK_ENV) -r docs/notebooks/requirements.lock
	@touch $@

# Compares coarse meshes of the real volumes in DATA with those that gpytoolbox and CGAL make from
# the same smoothed fields. REMESHER=no makes only our meshes; with BENCH_OPTIONS=--no-distances,
# this needs no Python packages. Another example: BENCH_OPTIONS="--tetrahedra
# .venv/bin/tetmesh-check --backend gpu".
SCALE_BENCH = stages/distfield/benches
SCALE_CASES ?= @$(SCALE_BENCH)/solid.txt @$(SCALE_BENCH)/thin.txt
SCALE_VERTICES ?= 1000 5000 20000 75000
SCALE_PEERS = $(if $(filter no,$(REMESHER)),,$(BENCH_VENV)-scale/.made)
SCALE_PYTHON = $(or $(wildcard $(VENV)/bin/python),python3)
bench-scale: build $(SCALE_PEERS)
	DATA=$(DATA) $(SCALE_PYTHON) $(SCALE_BENCH)/scale.py $(SCALE_CASES) --vertices $(SCALE_VERTICES) --bin $(BIN) --work $(OUT)/bench-scale \
	  $(if $(SCALE_PEERS),--peers $(BENCH_VENV)-scale/bin/python) $(BENCH_OPTIONS)

# Remeshes blurred label maps with every packaged remesher at several vertex counts. Also makes
# meshes with marching cubes and surface nets.
REMESHER_CASES ?= @$(SCALE_BENCH)/remeshers.txt
REMESHER_VERTICES ?= 5000 20000 75000 400000
bench-remeshers: build env $(BENCH_VENV)-scale/.made
	DATA=$(DATA) $(VENV)/bin/python $(SCALE_BENCH)/scale.py $(REMESHER_CASES) --vertices $(REMESHER_VERTICES) --bin $(BIN) --work $(OUT)/bench-remeshers \
	  --peers $(BENCH_VENV)-scale/bin/python --programs marching-cubes surface-nets botsch cgal mmg pymeshlab instant-meshes acvd $(BENCH_OPTIONS)

# Compares our meshes of many materials with those of CGAL's Mesh_3, Cleaver and surface nets. Needs
# g++ and libcgal-dev.
MATERIALS_CASES ?= 'mickey=$$DATA/mickey_labels.nrrd;--material all' 'torso=torso --kind label --size 134,65,89 --spacing 2.6;--material all --scale-for-size 3;--uniform 3'
MATERIALS_BENCH = stages/reconstruct/benches
bench-materials-peers: build env $(BENCH_VENV)-cleaver/.made
	@mkdir -p $(OUT)/materials-peers
	g++ -O2 -std=c++17 $(MATERIALS_BENCH)/mesh_3.cpp -o $(OUT)/materials-peers/mesh_3 -lz -lgmp -lmpfr
	DATA=$(DATA) $(VENV)/bin/python $(MATERIALS_BENCH)/materials_peers.py $(MATERIALS_CASES) --bin $(BIN) --tetmesh-check $(TETMESH_CHECK) --work $(OUT)/materials-peers \
	  --cleaver $(BENCH_VENV)-cleaver/bin/python --mesh-3 $(OUT)/materials-peers/mesh_3 $(BENCH_OPTIONS)

$(BENCH_VENV)-cleaver/.made: $(MATERIALS_BENCH)/cleaver.lock | env
	$(VENV)/bin/python -m venv --clear $(BENCH_VENV)-cleaver
	$(BENCH_VENV)-cleaver/bin/python -m pip install --quiet --disable-pip-version-check --no-input --only-binary :all: --require-hashes -r $(MATERIALS_BENCH)/cleaver.lock
	@touch $@

# Meshes label maps at a constant edge length, and compares the triangles with those that gpytoolbox
# and CGAL make from the same labels after blurring.
PEER_CASES ?= @$(SCALE_BENCH)/peers.txt
bench-peers: build env $(SCALE_PEERS)
	DATA=$(DATA) $(VENV)/bin/python $(SCALE_BENCH)/scale.py $(PEER_CASES) --as-given --no-distances --bin $(BIN) --work $(OUT)/bench-peers \
	  $(if $(SCALE_PEERS),--peers $(BENCH_VENV)-scale/bin/python) $(BENCH_OPTIONS)

# Times each step of all stages on 1, 2, 4 ... threads, for the volumes of bench-peers. Example:
# BENCH_OPTIONS="--threads 2 4 8 16 --rounds 3".
bench-scaling: build
	DATA=$(DATA) python3 tests/scaling.py $(PEER_CASES) --bin $(BIN) --work $(OUT)/bench-scaling $(BENCH_OPTIONS)

# bench-paper measures the values in the tables and figures of the paper. bench-growth measures how
# the time and memory of every stage grow. Complete tables require a GPU. An interrupted benchmark
# resumes on the next run. Examples: BENCH_OPTIONS="--tables 2 1", "--series cores", "--time-limit
# 540", "--quick --no-gpu --json FILE".
bench-paper: build
	@python3 tests/results/paper.py --data $(DATA) --bin $(BIN) --work $(OUT)/paper --keep $(OUT)/paper-surfaces $(BENCH_OPTIONS)

bench-growth: build
	@python3 tests/results/growth.py --bin $(BIN) --work $(OUT)/growth $(BENCH_OPTIONS)

# Makes the results page and its pictures from these two benchmarks.
results-page: env
	@$(VENV)/bin/python tests/results/page.py && $(VENV)/bin/python tests/results/plots.py \
	  && { [ ! -d $(OUT)/paper-surfaces ] || $(VENV)/bin/python tests/results/plots.py --closeups $(OUT)/paper-surfaces; }

$(BENCH_VENV)-scale/.made: $(SCALE_BENCH)/peers.lock | env
	$(VENV)/bin/python -m venv --clear $(BENCH_VENV)-scale
	$(BENCH_VENV)-scale/bin/python -m pip install --quiet --disable-pip-version-check --no-input --only-binary :all: --require-hashes -r $(SCALE_BENCH)/peers.lock
	@touch $@
