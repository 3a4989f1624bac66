#!/bin/sh
# Prints the table in docs/user/size.md: `make surface CASE=demo` with one variable changed at a
# time. Needs `make build` first.
set -eu
work=${1:-out/tuning}
row() {
    rm -rf "$work"
    make --no-print-directory surface CASE=demo OUT="$work" NO_BUILD=yes "$@" >"$work.log" 2>&1 || true
    python3 - "$work/demo/reports" "$*" <<'P'
import json, sys
folder, variables = sys.argv[1:]
sizes = json.load(open(f"{folder}/sizefield.json"))["results"]["fields"]["size_at_surface"]
check = json.load(open(f"{folder}/reconstruct.json"))["results"]["check"]
quality, distance = check["quality"], check["centroid_distance"]["mean"]
print(f"| `{variables}` | {sizes['min']:.1f} to {sizes['max']:.1f} | {check['vertices']:,} "
      f"| {quality['radius_ratio_mean']:.3f} / {quality['radius_ratio_min']:.3f} | {distance:.3f} |")
P
}
echo "| variables | h at the surface, mm | vertices | radius ratio, mean / minimum | distance |"
echo "|---|---|---|---|---|"
row MIN_SIZE=2
row EPSILON=0.3
row EPSILON=0.7
row EPSILON=1
row DELTA=0.2
row DELTA=0.8
row MIN_SIZE=1
row MIN_SIZE=3
row MAX_SIZE=4
row SIZEFIELD_OPTIONS=--max-deviation=1
row MIN_SIZE= SIZE=3
row MIN_SIZE= SIZE=2
row PARTICLES_OPTIONS=--energy-tolerance=0
row PARTICLES_OPTIONS=--energy-tolerance=0.0015
row PARTICLES_OPTIONS=--levels=1
