#!/bin/sh
# Times the particles stage on many materials and, for comparison, on one object (the union of the
# same labels) with about as many particles.
#
#   bench_materials.sh VOLUME H [OPTIONS OF particles...]
#
# H is the edge length on the interfaces in mm. The environment variables BIN (default
# target/release) and WORK (default out/bench-materials) select the folders of the programs and of
# the files. Prints the time and memory reported by `particles`, and the GPU time per particle and
# pass in microseconds.
set -eu
volume=$1 size=$2
shift 2
bin=${BIN:-target/release} work=${WORK:-out/bench-materials}
mkdir -p "$work"
case=$work/$(basename "$volume" .nrrd)

# settle NAME [OPTIONS...]: makes the seeds and particles for a field, and prints the measurements.
settle() {
    name=$1
    shift
    "$bin/seed" "$case.$name.distfield.vti" "$case.$name.sizefield.vti" -o "$case.$name.seeds.bin" --force -q
    "$bin/particles" "$case.$name.seeds.bin" --distfield "$case.$name.distfield.vti" --sizefield "$case.$name.sizefield.vti" \
        -o "$case.$name.particles.bin" --levels 1 --log "$case.$name.csv" --report "$case.$name.json" --force "$@" 2>&1 |
        grep -E '^  (particles|  of junctions|passes|settle|device time|device memory|peak memory|energy over ideal|adapter|backend)'
    # if a GPU was used, prints the device time per pass and particle; the counts in the log exclude
    # held particles
    seconds=$(sed -n 's/.*"device_seconds": *\([0-9.eE+-]*\).*/\1/p' "$case.$name.json" | head -n 1)
    [ -z "$seconds" ] || awk -F, -v s="$seconds" 'NR > 1 { n = $3; passes++ }
        END { printf "  us a particle and pass   %.5f\n", 1e6 * s / n / passes }' "$case.$name.csv"
}

"$bin/distfield" "$volume" -o "$case.many.distfield.vti" --material all --force -q
"$bin/sizefield" "$case.many.distfield.vti" -o "$case.many.sizefield.vti" --uniform "$size" --force -q
echo "many materials of $volume, h $size mm"
settle many "$@"
count=$(sed -n 's/.*"particles": *"\([0-9]*\)".*/\1/p' "$case.many.json" | head -1)
: "${count:?no count in the report}"
"$bin/distfield" "$volume" -o "$case.one.distfield.vti" --labels all --force -q
"$bin/sizefield" "$case.one.distfield.vti" -o "$case.one.sizefield.vti" --vertices "$count" --force -q
echo "one object of all labels, about $count particles"
settle one "$@"
