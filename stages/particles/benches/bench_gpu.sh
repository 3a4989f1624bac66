#!/bin/sh
# Times the particles stage on the GPU and on one CPU thread, starting from the same seeds
# (`make bench-gpu`). Requires the stage programs and `phantom`. On a machine without `phantom`, set
# --work to a copy of a folder that another machine created with --prepare.
#
#   bench_gpu.sh [--bin FOLDER] [--work FOLDER] [--prepare] [--adapter NAME] [--no-cpu]
#                [--sizes "H ..."] [--contrasts "C ..."] [--count N] [--passes N] [--options "..."]
#
# --bin        folder of the programs                                       [target/release]
# --work       folder for fields, seeds and results; reuses existing files  [out/bench-gpu]
# --prepare    only make fields and seeds
# --adapter    part of the GPU's name (a software renderer must be specified by name)
# --no-cpu     skip the CPU runs
# --sizes      uniform target edge lengths in mm on the ribcage of the torso phantom
#              [1.9 1.205 0.852 0.682: about 60, 150, 300 and 468 thousand particles]
# --contrasts  ratios of maximum to minimum h on a ball refined on one side      [1 3 9 27]
# --count      number of particles in each run on the ball                         [150000]
# --passes     number of passes in each run                                            [50]
# --options    additional options for the GPU runs
set -eu

bin=${BIN:-target/release}
work=out/bench-gpu
prepare= adapter= cpu=yes options=
sizes="1.9 1.205 0.852 0.682" contrasts="1 3 9 27" count=150000 passes=50
while [ $# -gt 0 ]; do
    case $1 in
        --prepare) prepare=yes; shift; continue ;;
        --no-cpu) cpu=; shift; continue ;;
        -h|--help) sed -n '2,/^set -eu/s/^# \{0,1\}//p' "$0"; exit 0 ;;
    esac
    [ $# -ge 2 ] || { echo "$1: what it should be is missing; see --help" >&2; exit 2; }
    case $1 in
        --bin) bin=$2 ;;
        --work) work=$2 ;;
        --adapter) adapter=$2 ;;
        --sizes) sizes=$2 ;;
        --contrasts) contrasts=$2 ;;
        --count) count=$2 ;;
        --passes) passes=$2 ;;
        --options) options=$2 ;;
        *) echo "$1: no such option; see --help" >&2; exit 2 ;;
    esac
    shift 2
done

mkdir -p "$work"
ribs=$work/ribs.distfield.vti ball=$work/ball.distfield.vti

# fields NAME DISTANCE OPTIONS...: makes the size field and the seeds of a run unless they exist.
fields() {
    name=$1 distance=$2
    shift 2
    [ -e "$work/$name.sizefield.vti" ] || "$bin/sizefield" "$distance" -o "$work/$name.sizefield.vti" "$@" -q
    [ -e "$work/$name.seeds.bin" ] || "$bin/seed" "$distance" "$work/$name.sizefield.vti" -o "$work/$name.seeds.bin" -q
}

# number FILE KEY: prints the first number stored under KEY in a report.
number() { sed -n "s/^ *\"$2\": *\"\{0,1\}\([-+.0-9eE]*\).*/\1/p" "$1" | head -n 1; }
# total FILE: prints the duration of the whole process in seconds (the outermost `seconds` key).
total() { sed -n 's/^  "seconds": *\([-+.0-9eE]*\).*/\1/p' "$1" | head -n 1; }
# settle FILE: prints the duration of the step `settle` in seconds.
settle() { awk '/"name": "settle"/ { found = 1 } found && /"seconds"/ { gsub(/[^0-9.eE+-]/, "", $2); print $2; exit }' "$1"; }

# graded CONTRAST: makes the size field and seeds of a run on the ball. CONTRAST is the ratio of
# maximum to minimum h. Adjusts the minimum h in five iterations to bring the predicted count close
# to --count.
graded() {
    least=0.3
    [ ! -e "$work/contrast-$1-$count.seeds.bin" ] || return 0
    for _ in 1 2 3 4 5; do
        rm -f "$work/contrast-$1-$count.sizefield.vti"
        if [ "$1" = 1 ]; then sizing="--uniform $least"; else
            most=$(awk -v a="$least" -v c="$1" 'BEGIN { print a * c }')
            sizing="--epsilon 1000 --max-deviation 0 --min-size $most --max-size $most --refine ball:$pole,25=$least"
        fi
        # shellcheck disable=SC2086 # word splitting is intended
        "$bin/sizefield" "$ball" -o "$work/contrast-$1-$count.sizefield.vti" $sizing -q --report "$work/contrast-$1-$count.json"
        predicted=$(number "$work/contrast-$1-$count.json" predicted_count)
        least=$(awk -v a="$least" -v p="$predicted" -v n="$count" 'BEGIN { print a * sqrt(p / n) }')
    done
    fields "contrast-$1-$count" "$ball"
}

# row NAME DISTANCE: runs both backends and prints a row of the table.
row() {
    name=$1 distance=$2
    common="$work/$name.seeds.bin --distfield $distance --sizefield $work/$name.sizefield.vti --force --progress none -q"
    common="$common --max-passes $passes --energy-tolerance 0 --levels 1"
    # shellcheck disable=SC2086 # word splitting is intended
    "$bin/particles" $common -o "$work/$name.gpu.bin" --backend gpu ${adapter:+--adapter "$adapter"} $options \
        --report "$work/$name.gpu.json"
    report=$work/$name.gpu.json
    particles=$(number "$report" particles)
    device=$(number "$report" device_seconds)
    memory=$(number "$report" peak_device_bytes)
    alone=-
    if [ -n "$cpu" ]; then
        # shellcheck disable=SC2086
        "$bin/particles" $common -o "$work/$name.cpu.bin" --backend cpu --threads 1 --report "$work/$name.cpu.json"
        alone=$(settle "$work/$name.cpu.json")
        other=$(number "$work/$name.cpu.json" energy_ratio)
        others=$(number "$work/$name.cpu.json" particles)
    fi
    awk -v name="$name" -v n="$particles" -v d="$device" -v t="$(total "$report")" -v p="$passes" -v c="$alone" \
        -v e="$(number "$report" energy_ratio)" -v f="${other:--}" -v m="$memory" -v o="${others:--}" 'BEGIN {
        printf "| %s | %d | %s | %.3f | %.2f | %.3f | %s | %s | %s | %.4f | %s | %.0f |\n", name, n, o, d, t, d / n / p * 1e6,
            c == "-" ? "-" : sprintf("%.2f", c), c == "-" ? "-" : sprintf("%.2f", c / o / p * 1e6),
            c == "-" ? "-" : sprintf("%.1f", c / d), e, f == "-" ? "-" : sprintf("%.4f", f), m / n }'
}

if [ ! -e "$ribs" ] && [ -n "$sizes" ]; then
    "$bin/phantom" torso --part ribs -o "$work/ribs.nrrd" --force
    "$bin/distfield" "$work/ribs.nrrd" --iso 370 -o "$ribs" -q
fi
if [ ! -e "$ball" ] && [ -n "$contrasts" ]; then
    "$bin/phantom" ball --size 128 -o "$work/ball.nrrd" --force
    "$bin/distfield" "$work/ball.nrrd" --iso 100 -o "$ball" -q
fi
# centre of the refined region in mm, on the surface of the ball (`phantom ball --size 128 --truth`:
# centre 63.6, 63.8, 63.3, radius 44.45)
pole=108.1,63.8,63.3
for h in $sizes; do fields "uniform-$h" "$ribs" --uniform "$h"; done
for c in $contrasts; do graded "$c"; done
[ -z "$prepare" ] || exit 0

echo "Adapter: $("$bin/particles" --list-adapters 2>/dev/null | grep -i -m 1 "${adapter:-}" || echo none)"
echo "Processor: $(sed -n 's/^model name[^:]*: //p' /proc/cpuinfo 2>/dev/null | head -n 1)"
echo "$passes passes; device time is from upload to the last readback, CPU time that of the settling on one thread."
echo
echo "| run | particles | CPU's | device s | process s | us a particle and pass | CPU s | CPU us | speed-up | energy/ideal | CPU's | device B a particle |"
echo "|---|---|---|---|---|---|---|---|---|---|---|---|"
for h in $sizes; do row "uniform-$h" "$ribs"; done
for c in $contrasts; do row "contrast-$c-$count" "$ball"; done
