#!/bin/sh
# Measures the time of the particles stage on the CPU (`make bench-particles`) in microseconds per
# particle and pass, for constant and graded h. Uses the fields and seeds of bench_gpu.sh.
#
#   bench_cpu.sh [--bin FOLDER] [--beside PROGRAM] [--work FOLDER] [--contrasts "C ..."]
#                [--count N] [--passes N] [--threads "N ..."] [--rounds N]
#
# --bin        folder of the programs                                       [target/release]
# --beside     another `particles` program, run alternately with the program in --bin
# --work       folder for fields, seeds and results; reuses existing files  [out/bench-gpu]
# --contrasts  ratios of maximum to minimum h on a ball refined on one side          [1 27]
# --count      number of particles in each run                                      [60000]
# --passes     number of passes in each run                                            [50]
# --threads    thread counts                                                          [1 2]
# --rounds     repetitions; prints the minimum, because other load only adds time       [3]
set -eu

bin=${BIN:-target/release}
work=out/bench-gpu beside= contrasts="1 27" count=60000 passes=50 threads="1 2" rounds=3
while [ $# -gt 0 ]; do
    case $1 in
        -h|--help) sed -n '2,/^set -eu/s/^# \{0,1\}//p' "$0"; exit 0 ;;
    esac
    [ $# -ge 2 ] || { echo "$1: what it should be is missing; see --help" >&2; exit 2; }
    case $1 in
        --bin) bin=$2 ;;
        --beside) beside=$2 ;;
        --work) work=$2 ;;
        --contrasts) contrasts=$2 ;;
        --count) count=$2 ;;
        --passes) passes=$2 ;;
        --threads) threads=$2 ;;
        --rounds) rounds=$2 ;;
        *) echo "$1: no such option; see --help" >&2; exit 2 ;;
    esac
    shift 2
done
"$(dirname "$0")/bench_gpu.sh" --bin "$bin" --work "$work" --prepare --sizes "" --contrasts "$contrasts" --count "$count"

# number FILE KEY: prints the first number stored under KEY in a report.
number() { sed -n "s/^ *\"$2\": *\"\{0,1\}\([-+.0-9eE]*\).*/\1/p" "$1" | head -n 1; }
# settle FILE: prints the duration of the step `settle` in seconds.
settle() { awk '/"name": "settle"/ { found = 1 } found && /"seconds"/ { gsub(/[^0-9.eE+-]/, "", $2); print $2; exit }' "$1"; }
# processor FILE: prints the user CPU time of a run in seconds, from the output of `times` before
# and after the run (the second line of each output is the total for child processes).
processor() { awk 'NR % 2 == 0 { split($1, t, /[ms]/); s[++n] = 60 * t[1] + t[2] } END { print s[2] - s[1] }' "$1"; }

# row CONTRAST PROGRAM THREADS: runs all rounds and prints a row of the table with the minimum
# times.
row() {
    report=$work/cpu.json times=$work/cpu.times
    for round in $(seq "$rounds"); do
        times > "$times"
        "$2" "$work/contrast-$1-$count.seeds.bin" --distfield "$work/ball.distfield.vti" \
            --sizefield "$work/contrast-$1-$count.sizefield.vti" -o "$work/cpu.bin" --report "$report" --force --progress none -q \
            --max-passes "$passes" --energy-tolerance 0 --levels 1 --backend cpu --threads "$3"
        times >> "$times"
        echo "$(settle "$report") $(processor "$times")"
    done > "$work/cpu.rounds"
    awk -v c="$1" -v p="$2" -v t="$3" -v n="$(number "$report" particles)" -v e="$(number "$report" energy_ratio)" -v passes="$passes" '
        NR == 1 || $1 < wall { wall = $1 } NR == 1 || $2 < user { user = $2 }
        END { us = 1e6 / n / passes; printf "| %s | %s | %d | %d | %.4f | %.2f | %.2f |\n", c, p, t, n, e, wall * us, user * us }' "$work/cpu.rounds"
}

echo "Processor: $(sed -n 's/^model name[^:]*: //p' /proc/cpuinfo 2>/dev/null | head -n 1)"
echo "$passes passes, the least of $rounds rounds; processor time is that of the whole process, reading and writing included."
echo
echo "| contrast | program | threads | particles | energy/ideal | us a particle and pass, elapsed | processor |"
echo "|---|---|---|---|---|---|---|"
for c in $contrasts; do
    for t in $threads; do
        [ -z "$beside" ] || row "$c" "$beside" "$t"
        row "$c" "$bin/particles" "$t"
    done
done
