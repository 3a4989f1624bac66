#!/bin/sh
# Times the Delaunay triangulations of this crate and of CGAL on the same points, and prints a table
# (`make bench-delaunay`). Only this script needs g++, CGAL and TBB (Debian: apt-get install g++
# libcgal-dev libtbb-dev).
#
#   compare.sh [--bin FOLDER] [--work FOLDER] [--sizes "H ..."] [--particles "FILE ..."]
#              [--passes N] [--repeat N] [--threads N] [--no-degenerate] [--no-parallel]
#
# --bin            folder of the stage programs and of bench_delaunay   [target/release]
# --work           folder for intermediate files, which are reused      [out/bench-delaunay]
# --sizes          uniform target edge lengths in mm for particles settled on the ribcage of the
#                  torso phantom
#                  [1.482 0.663 0.332: about 100, 500 and 2,000 thousand particles]
# --particles      further files of settled particles to triangulate    [none]
# --passes         maximum number of passes of `particles`              [12]
# --repeat         number of runs of each program; the fastest is shown [3]
# --threads        number of threads of the parallel runs               [all]
# --no-degenerate  skip the cospherical points, the grid and the random cube
# --no-parallel    skip the runs on several threads
#
# Times exclude file reading. CPU time is summed over all threads. Bytes are the increase in peak
# memory. Ratios are the figures of this crate divided by the figures of CGAL for the same number of
# threads.
set -eu

bin=${BIN:-target/release}
work=out/bench-delaunay
sizes="1.482 0.663 0.332" particles="" passes=12 repeat=3 threads=$(nproc) degenerate=yes parallel=yes
while [ $# -gt 0 ]; do
    case $1 in
        --no-degenerate) degenerate=; shift; continue ;;
        --no-parallel) parallel=; shift; continue ;;
        -h|--help) sed -n '2,/^set -eu/s/^# \{0,1\}//p' "$0" | sed '$d'; exit 0 ;;
    esac
    [ $# -ge 2 ] || { echo "$1: what it should be is missing; see --help" >&2; exit 2; }
    case $1 in
        --bin) bin=$2 ;;
        --work) work=$2 ;;
        --sizes) sizes=$2 ;;
        --particles) particles=$2 ;;
        --passes) passes=$2 ;;
        --repeat) repeat=$2 ;;
        --threads) threads=$2 ;;
        *) echo "$1: no such option; see --help" >&2; exit 2 ;;
    esac
    shift 2
done

here=$(dirname "$0")
ours=$bin/examples/bench_delaunay
mkdir -p "$work"
if [ ! -e "$work/cgal" ] || [ "$here/cgal.cpp" -nt "$work/cgal" ]; then
    ${CXX:-g++} -std=c++17 -O3 -DNDEBUG -frounding-math "$here/cgal.cpp" -o "$work/cgal" -ltbb -ltbbmalloc -lgmp -lmpfr || {
        echo "cgal.cpp does not build: are g++, libcgal-dev and libtbb-dev there?" >&2
        exit 2
    }
fi

# settled H: settles particles on the ribcage with a target edge length of H mm
settled() {
    ribs=$work/ribs.distfield.vti
    if [ ! -e "$ribs" ]; then
        "$bin/phantom" torso --part ribs -o "$work/ribs.nrrd" --force
        "$bin/distfield" "$work/ribs.nrrd" --iso 370 -o "$ribs" -q
    fi
    "$bin/sizefield" "$ribs" --uniform "$1" -o "$work/ribs-$1.sizefield.vti" -q --force
    "$bin/seed" "$ribs" "$work/ribs-$1.sizefield.vti" -o "$work/ribs-$1.seeds.bin" -q --force
    "$bin/particles" "$work/ribs-$1.seeds.bin" --distfield "$ribs" --sizefield "$work/ribs-$1.sizefield.vti" --backend cpu \
        --max-passes "$passes" -o "$work/ribs-$1.particles.bin" -q --force
}

# number LINE KEY: prints the value of KEY
number() { printf '%s\n' "$1" | tr ' ' '\n' | sed -n "s/^$2=//p"; }
# faster A B: prints the line with the shorter time; A may be empty
faster() {
    if [ -z "$1" ] || awk -v a="$(number "$1" seconds)" -v b="$(number "$2" seconds)" 'BEGIN { exit !(b < a) }'; then
        printf '%s\n' "$2"
    else
        printf '%s\n' "$1"
    fi
}

# row CASE LINE THREADS [LINE-OF-CGAL]: prints a row of the table
row() {
    awk -v name="$1" -v program="$(number "$2" program)" -v n="$(number "$2" points)" -v c="$(number "$2" cells)" -v k="$3" \
        -v s="$(number "$2" seconds)" -v u="$(number "$2" cpu)" -v b="$(number "$2" bytes)" -v t="$(number "${4:-$2}" seconds)" \
        -v v="$(number "${4:-$2}" cpu)" -v d="$(number "${4:-$2}" bytes)" -v other="${4:-}" 'BEGIN {
        printf "| %s | %d | %.2f | %s | %d | %.3f | %.2f | %.2f | %.0f | %s |\n", name, n, c / n, program, k, s, s / n * 1e6,
            u / n * 1e6, b / n, other == "" ? "" : sprintf("%.2f, %.2f, %.2f", s / t, u / v, b / d) }'
}

# compare CASE FILE: runs both programs and prints their rows
compare() {
    ours_one='' cgal_one='' ours_all='' cgal_all=''
    for _ in $(seq "$repeat"); do
        ours_one=$(faster "$ours_one" "$("$ours" "$2" 1)")
        cgal_one=$(faster "$cgal_one" "$("$work/cgal" "$2" serial)")
        if [ -n "$parallel" ]; then
            ours_all=$(faster "$ours_all" "$("$ours" "$2" "$threads")")
            cgal_all=$(faster "$cgal_all" "$("$work/cgal" "$2" parallel "$threads")")
        fi
    done
    row "$1" "$ours_one" 1 "$cgal_one"
    row "$1" "$cgal_one" 1
    if [ -n "$parallel" ]; then
        row "$1" "$ours_all" "$threads" "$cgal_all"
        row "$1" "$cgal_all" "$threads"
    fi
}

for h in $sizes; do
    [ -e "$work/ribs-$h.particles.bin" ] || settled "$h"
    [ -e "$work/ribs-$h.points" ] || "$ours" points "$work/ribs-$h.particles.bin" "$work/ribs-$h.points" >/dev/null
done

echo "Processor: $(sed -n 's/^model name[^:]*: //p' /proc/cpuinfo 2>/dev/null | head -n 1), $(nproc) cores; load $(cut -d ' ' -f 1-3 /proc/loadavg 2>/dev/null)"
echo
echo "| points | count | cells a point | program | threads | seconds | us a point | CPU us a point | bytes a point | ratio: time, CPU, bytes |"
echo "|---|---|---|---|---|---|---|---|---|---|"
for h in $sizes; do compare "ribcage, h = $h mm" "$work/ribs-$h.points"; done
for file in $particles; do
    "$ours" points "$file" "$work/other.points" >/dev/null
    compare "$(basename "$file" .bin)" "$work/other.points"
done
if [ -n "$degenerate" ]; then
    "$ours" cospherical "$work/cospherical.points" >/dev/null
    "$ours" sphere 100000 "$work/sphere.points" >/dev/null
    "$ours" grid 46 "$work/grid.points" >/dev/null
    "$ours" cube 100000 "$work/cube.points" >/dev/null
    compare "integers on one sphere" "$work/cospherical.points"
    compare "doubles near one sphere" "$work/sphere.points"
    compare "grid" "$work/grid.points"
    compare "random in a cube" "$work/cube.points"
fi
