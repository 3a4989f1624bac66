#!/bin/sh
# Runs every fuzz target, or those that are named, for SECONDS each (60). Corpora start from the fixtures of the tests and are kept in
# target/fuzz, finds in target/fuzz/artifacts. Needs nightly Rust and cargo-fuzz (cargo install cargo-fuzz).
#
#   tests/fuzz/run.sh [--seconds N] [TARGET...]
set -eu
cd "$(dirname "$0")/../.."

seconds=60
if [ "${1-}" = --seconds ]; then
    seconds=$2
    shift 2
fi
cargo +nightly fuzz --version >/dev/null 2>&1 || {
    echo "error: cargo-fuzz or nightly Rust is not there" >&2
    echo "  why it matters: the targets are built with it" >&2
    echo "  what to do: rustup toolchain install nightly && cargo install cargo-fuzz" >&2
    exit 2
}
if [ $# = 0 ]; then
    for file in tests/fuzz/targets/*.rs; do
        name=${file##*/}
        set -- "$@" "${name%.rs}"
    done
fi

# The fixtures that a target starts from, by the endings that its reader knows.
fixtures() {
    volume=common/volume/tests/data
    golden=common/stage/tests/data/golden
    case $1 in
    nrrd) ls $volume/nrrd/*.nrrd $volume/segmentation/*.nrrd ;;
    nifti) ls $volume/nifti/*.nii ;;
    compressed_nifti) ls $volume/nifti/*.nii.gz ;;
    meta_image) ls $volume/meta/*.mha ;;
    vtk_image) ls $volume/vti/*.vti ;;
    dicom) ls $volume/dicom/*/*.dcm ;;
    field | materials) ls $golden/*.vti ;;
    particles) ls $golden/*.bin ;;
    surface | cloud_of_polygons) ls $golden/*.vtp ;;
    cloud_of_ply) ls $golden/*.ply ;;
    any_volume) ls $volume/nrrd/*.nrrd $volume/meta/*.mha $volume/vti/*.vti $volume/nifti/* ;;
    esac
}

status=0
for name; do
    corpus=target/fuzz/corpus/$name
    artifacts=target/fuzz/artifacts/$name/
    mkdir -p "$corpus" "$artifacts"
    fixtures "$name" | while read -r file; do cp "$file" "$corpus/"; done
    echo "== $name, $seconds s"
    # A reader may take memory that its file fills, and no more: files are at most 64 KiB here.
    cargo +nightly fuzz run --fuzz-dir tests/fuzz --target-dir target/fuzz "$name" "$corpus" -- \
        -max_total_time="$seconds" -max_len=65536 -timeout=10 -rss_limit_mb=2048 -print_final_stats=1 \
        -artifact_prefix="$artifacts" 2>&1 | grep -E "stat::number_of_executed|panicked|ERROR|SUMMARY|Test unit written|error" || true
    [ -z "$(ls "$artifacts")" ] || status=1
done
exit $status
