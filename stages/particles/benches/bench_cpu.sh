#!/bin/sh
# The particles stage on the CPU: microseconds a particle and pass, with one h and with h of a contrast (`make bench-particles`).
# Fields and seeds are those of bench_gpu.sh.
#
#   bench_cpu.sh [--bin FOLDER] [--beside PROGRAM] [--work FOLDER] [--contrasts "C ..."] [--count N] [--passes N] [--threads "N ..."] [--rounds N]
#
# --bin        where the programs are                                                     [target/release]
# --beside     an older program `particles`, run in turn with the one in --bin
# --work       where fields, seeds and results go; what is there already is used as it is [out/bench-gpu]
# --contrasts  largest over smallest h on a ball, refined at one side                     [1 27]
# --count      particles of each run, whatever its contrast                               [60000]
# --passes     passes of each run                                                         [50]
# --threads    numbers of threads                                                         [1 2]
# --rounds     times that everything is run; the least is told, as other work only adds   [3]
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

# number FILE KEY: the first number of that key in a report.
number() { sed -n "s/^ *\"$2\": *\"\{0,1\}\([-+.0-9eE]*\).*/\1/p" "$1" | head -n 1; }
# settle FILE: seconds of the step settle.
settle() { awk '/"name": "settle"/ { found = 1 } found && /"seconds"/ { gsub(/[^0-9.eE+-]/, "", $2); print $2; exit }' "$1"; }
# processor FILE: user seconds of the last run, from what `times` said before and after it (second lines: the children's).
processor() { awk 'NR % 2 == 0 { split($1, t, /[ms]/); s[++n] = 60 * t[1] + t[2] } END { print s[2] - s[1] }' "$1"; }

# row CONTRAST PROGRAM THREADS: the best of all rounds.
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
