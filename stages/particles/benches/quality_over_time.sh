#!/bin/sh
# Quality of the triangles against passes and time, one level and coarse to fine: CSV on stdout, for quality_plot.py.
# The triangles are those of the particles as they are: reconstruct improves nothing here.
#
#   quality_over_time.sh [--bin FOLDER] [--work FOLDER] [--backend gpu|cpu] [--passes "N ..."] CASE=VOLUME,OPTIONS[,SIZING] ...
#
# CASE    name of a row
# VOLUME  a volume, or the words for `phantom` that make one
# OPTIONS of distfield, SIZING of sizefield
# Example: quality_over_time.sh torus="bumpy-torus --size 128,--iso 100,--uniform 1.2" heart="heart.nrrd,--labels 1"
set -eu

bin=${BIN:-target/release}
work=out/quality backend=auto passes="5 10 20 40 80"
while [ $# -gt 0 ]; do
    case $1 in
        --bin) bin=$2 ;;
        --work) work=$2 ;;
        --backend) backend=$2 ;;
        --passes) passes=$2 ;;
        -h|--help) sed -n '2,/^set -eu/s/^# \{0,1\}//p' "$0"; exit 0 ;;
        *) break ;;
    esac
    shift 2
done
[ $# -gt 0 ] || { echo "no case is given; see --help" >&2; exit 2; }
mkdir -p "$work"

# row NAME LEVELS PARTICLES.json SURFACE.json: a line of the table; time is the device's where there is one, else of the settling.
row() {
    python3 -c 'import json, sys
name, backend, levels = sys.argv[1:4]
particles, surface = (json.load(open(file)) for file in sys.argv[4:6])
settle = next(step["seconds"] for step in particles["steps"] if step["name"] == "settle")
results, ratio = particles["results"], surface["results"]["check"]["quality"]
seconds = results.get("device", {}).get("device_seconds", settle)
numbers = (len(results["passes"]), results["particles"], seconds, ratio["radius_ratio_mean"], ratio["radius_ratio_min"])
print(name, backend, levels, *numbers, sep=",")' "$@"
}

echo "case,backend,levels,passes,particles,seconds,mean,smallest"
for case in "$@"; do
    name=${case%%=*} rest=${case#*=}
    volume=${rest%%,--*} options=--${rest#*,--}
    sizing=
    case $options in *,*) sizing=${options#*,} options=${options%%,*} ;; esac
    base=$work/$name
    if [ ! -e "$base.seeds.bin" ]; then
        # shellcheck disable=SC2086 # words and options are split on purpose
        if [ ! -e "$volume" ]; then "$bin/phantom" $volume -o "$base.nrrd" --force; volume=$base.nrrd; fi
        # shellcheck disable=SC2086
        "$bin/distfield" "$volume" $options -o "$base.distfield.vti" --force -q
        # shellcheck disable=SC2086
        "$bin/sizefield" "$base.distfield.vti" $sizing -o "$base.sizefield.vti" --force -q
        "$bin/seed" "$base.distfield.vti" "$base.sizefield.vti" -o "$base.seeds.bin" --force -q
    fi
    for levels in 1 3; do
        for n in $passes; do
            "$bin/particles" "$base.seeds.bin" --distfield "$base.distfield.vti" --sizefield "$base.sizefield.vti" \
                -o "$base.bin" --force -q --backend "$backend" --levels "$levels" --max-passes "$n" --coarse-passes "$n" \
                --energy-tolerance 0 --report "$base.particles.json" 2>>"$base.log"
            "$bin/reconstruct" "$base.bin" --distfield "$base.distfield.vti" --sizefield "$base.sizefield.vti" -o "$base.vtp" \
                --force -q --relaxation-sweeps 0 --improve-rounds 0 --report "$base.surface.json" 2>>"$base.log" || [ $? = 1 ]
            row "$name" "$backend" "$levels" "$base.particles.json" "$base.surface.json"
        done
    done
done
