#!/bin/sh
# Fuzzes all file readers, or only the named readers. --seconds sets the time per reader (default
# 60), and --jobs the number of readers that run in parallel (default 1). The initial corpus
# consists of the test fixtures and the files in seeds/. The corpus is stored in target/fuzz/corpus,
# and failing inputs in target/fuzz/finds. Needs nightly Rust and cargo-fuzz (cargo install
# cargo-fuzz).
#
#   tests/fuzz/run.sh [--seconds N] [--jobs N] [--pack FOLDER] [READER...]
#
# With --pack, the script fuzzes nothing. It builds the program and copies it to FOLDER, together
# with this script, the dictionary and the initial corpus. A machine without Rust can then run
# FOLDER/run.sh --seconds 300 --jobs 16.
set -eu
here=$(cd "$(dirname "$0")" && pwd)

seconds=60
jobs=1
pack=
while [ $# -gt 0 ]; do
    case $1 in
    --seconds) seconds=$2 ;;
    --jobs) jobs=$2 ;;
    --pack) pack=$2 ;;
    *) break ;;
    esac
    shift 2
done

# Lists the files of a reader's initial corpus.
fixtures() {
    volume=common/volume/tests/data
    stage=common/stage/tests/data
    case $1 in
    nrrd) ls $volume/nrrd/*.nrrd $volume/nrrd/*.nhdr $volume/segmentation/*.nrrd ;;
    nifti) ls $volume/nifti/*.nii ;;
    compressed_nifti) ls $volume/nifti/*.nii.gz ;;
    mgh) ls $volume/mgh/*.mgh ;;
    compressed_mgh) ls $volume/mgh/*.mgz ;;
    tiff) ls $volume/tiff/*.tif ;;
    numpy) ls $volume/npy/*.npy ;;
    meta_image) ls $volume/meta/*.mha $volume/meta/*.mhd ;;
    vtk_image) ls $volume/vti/*.vti ;;
    dicom_object) ls $volume/dicom_objects/*.dcm $volume/dicom_objects/*/alone.dcm ;;
    field) ls $stage/golden/field_*.vti $stage/edited/*.vti ;;
    materials) ls $stage/golden/materials_*.vti ;;
    particles) ls $stage/golden/*.bin ;;
    surface | cloud_of_polygons) ls $stage/golden/*.vtp ;;
    cloud_of_ply) ls $stage/golden/*.ply ;;
    any_volume) ls $volume/nrrd/*.nrrd $volume/meta/*.mha $volume/vti/*.vti $volume/nifti/* $volume/mgh/* $volume/npy/* $volume/tiff/* ;;
    esac
    ls tests/fuzz/seeds/"$1"/* 2>/dev/null || true
}

# Builds the fuzz program and copies it, with the initial corpus of each reader, to a folder.
pack() {
    cargo +nightly fuzz --version >/dev/null 2>&1 || {
        echo "error: cargo-fuzz or nightly Rust is not there" >&2
        echo "  why it matters: the program that is fuzzed is built with it" >&2
        echo "  what to do: rustup toolchain install nightly && cargo install cargo-fuzz" >&2
        exit 2
    }
    # The project has no unsafe code for a sanitizer to check, and a sanitizer would halve the
    # speed. Overflow checks and debug assertions are on.
    cargo +nightly fuzz build --fuzz-dir tests/fuzz --target-dir target/fuzz -s none readers
    mkdir -p "$1"
    strip -o "$1/readers" target/fuzz/*/release/readers
    cp tests/fuzz/run.sh tests/fuzz/words.dict "$1/"
    for reader in $(sed -n 's/^    reader("\([a-z_]*\)".*/\1/p' tests/src/readers.rs); do
        mkdir -p "$1/seeds/$reader"
        # An input of the DICOM reader is one file: the concatenated slices of a series.
        if [ "$reader" = dicom ]; then
            for series in common/volume/tests/data/dicom/*; do cat "$series"/*.dcm >"$1/seeds/dicom/${series##*/}.dcm"; done
        fi
        fixtures "$reader" | while read -r file; do cp "$file" "$1/seeds/$reader/"; done
    done
}

# Fuzzes one reader for the given time, and restarts after every failing input.
fuzz() {
    mkdir -p "$work/corpus/$1" "$work/finds" "$work/logs" "$scratch/$1"
    most=8192
    # The default maximum length is too small for this reader: its smallest valid file has 41 kB.
    if [ "$1" = materials ]; then most=65536; fi
    end=$(($(date +%s) + seconds))
    : >"$work/logs/$1"
    while left=$((end - $(date +%s))) && [ "$left" -gt 0 ]; do
        # The reader gets each input as a temporary file, which is in memory (/dev/shm) if possible.
        # It runs on one thread.
        status=0
        READER=$1 TMPDIR=$scratch/$1 RAYON_NUM_THREADS=1 "$program/readers" "$work/corpus/$1" "$program/seeds/$1" -dict="$program/words.dict" \
            -max_total_time="$left" -max_len=$most -timeout=10 -rss_limit_mb=2048 -print_final_stats=1 \
            -artifact_prefix="$work/finds/$1-" >>"$work/logs/$1" 2>&1 || status=$?
        # libFuzzer exits with 70 after a timeout, 71 if memory runs out, and 77 after a crash.
        case $status in 70 | 71 | 77) ;; *) break ;; esac
    done
    runs=$(awk '/stat::number_of_executed_units/ { sum += $2 } END { print sum + 0 }' "$work/logs/$1")
    finds=$(find "$work/finds" -name "$1-*" | wc -l)
    printf '%-20s %10d executions %7d a second %6d files kept %4d finds\n' "$1" "$runs" $((runs / seconds)) "$(find "$work/corpus/$1" -type f | wc -l)" "$finds"
}

# In a packed folder, the program is next to this script. In the repository, it is built first.
if [ -x "$here/readers" ]; then
    program=$here
    work=${OUT:-$here/work}
else
    cd "$here/../.."
    program=target/fuzz/packed
    work=target/fuzz
    pack "${pack:-$program}"
    if [ -n "$pack" ]; then exit 0; fi
fi
if [ $# = 0 ]; then set -- $(ls "$program/seeds"); fi
scratch=$(mktemp -d "$(if [ -w /dev/shm ]; then echo /dev/shm; else echo "${TMPDIR:-/tmp}"; fi)/fuzz.XXXXXX")
trap 'rm -rf "$scratch"' EXIT
trap 'exit 130' INT TERM

mkdir -p "$work/finds"
running=0
for reader; do
    if [ "$running" -ge "$jobs" ]; then
        wait
        running=0
    fi
    fuzz "$reader" &
    running=$((running + 1))
done
wait
cat "$work"/logs/* | awk '/stat::number_of_executed_units/ { sum += $2 } END { printf "%d executions in all\n", sum }'
if [ -z "$(ls "$work/finds")" ]; then exit 0; fi
grep -hE "panicked at|ERROR: libFuzzer" "$work"/logs/* | sort | uniq -c
exit 1
