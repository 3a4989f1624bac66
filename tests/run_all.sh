#!/bin/sh
# Runs the goals of `make test` in order and stops at the first goal that fails. At the end, lists
# the skipped tests with their reasons and prints how many tests passed, failed and were skipped.
#
#   run_all.sh MAKE GOAL...      called by `make test`
set -u
make=$1
shift

folder=$(mktemp -d) || exit 2
trap 'rm -rf "$folder"' EXIT
# Rust tests record their skips in this file (tests/src/skip.rs).
export ISOPARTICLES_SKIPS="$folder/skips"
: >"$ISOPARTICLES_SKIPS"
: >"$folder/log"

code=0
for goal in "$@"; do
    # A pipe hides the exit code of its first command.
    { "$make" --no-print-directory "$goal" 2>&1; echo $? >"$folder/code"; } | tee -a "$folder/log"
    code=$(cat "$folder/code")
    [ "$code" = 0 ] || break
done

echo
# One test may record several skips.
sort -u "$ISOPARTICLES_SKIPS" | awk -F '\t' '{ print "skipped: " $1 ": " $2 }'
# pytest prints the number of skips in brackets.
sed -n 's/^SKIPPED \[\([0-9]*\)\] /skipped: \1 x /p' "$folder/log"
skips=$(cut -f 1 "$ISOPARTICLES_SKIPS" | sort -u | wc -l)
awk -v skips="$skips" '
    # Returns the number before a word in a summary, as in "12 passed".
    function count(kind) { return match($0, "[0-9]+ " kind) ? substr($0, RSTART, RLENGTH) + 0 : 0 }
    /test result:/ || /^[0-9]+ .*(passed|failed|skipped|error).* in [0-9.]+s/ || /^=+ .* in [0-9.]+s.* =+$/ {
        passed += count("passed"); failed += count("failed") + count("error"); skipped += count("ignored") + count("skipped")
    }
    # The Rust harness counts a skipped test as passed.
    END { printf "%d passed, %d failed, %d skipped\n", passed - skips, failed, skipped + skips }' "$folder/log"
if [ "$code" = 0 ]; then echo "make test: everything that ran passed"; else echo "make test: make $goal failed"; fi
exit "$code"
