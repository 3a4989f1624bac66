#!/bin/sh
# Dry run of a release (RELEASING.md): builds everything that is published, tests it, and publishes
# nothing. Needs network access.
#
#   release.sh MAKE PYTHON FOLDER      called by `make release-check`; FOLDER holds the wheel
set -eu
make=$1
python=$2
folder=$3
cd "$(dirname "$0")/.."

step() { printf '\n== %s\n' "$1"; }
fail() {
    printf 'release-check: %s\n' "$1" >&2
    exit 1
}

version=$(sed -n 's/^version = "\(.*\)"/\1/p' Cargo.toml)
step "version $version: changelog, packages, citation"
"$python" -m pytest -q -p no:cacheprovider tests/test_docs.py -k same_version
if tagged=$(git rev-parse -q --verify "refs/tags/v$version^{commit}"); then
    [ "$tagged" = "$(git rev-parse HEAD)" ] || fail "the tag v$version is another commit: choose a new version"
fi

step "wheel and source distribution"
"$make" --no-print-directory wheel sdist

step "wheel in a fresh environment"
unset ISOPARTICLES_BIN WHEEL PYTHONPATH
fresh=$folder/release
"$python" -m venv --clear "$fresh"
wheel=$(ls "$folder"/isoparticles-"$version"-*.whl)
"$fresh/bin/pip" install --quiet --disable-pip-version-check "$wheel[fem,formats,hxt,view]" pytest pytest-timeout twine
"$fresh/bin/twine" check --strict "$wheel" "$folder/isoparticles-$version.tar.gz"
for program in "" distfield sizefield seed particles reconstruct tetmesh-check; do
    # Unquoted, because the command itself has no name of a stage.
    # shellcheck disable=SC2086
    printed=$("$fresh/bin/isoparticles" $program --version)
    [ "${printed##* }" = "$version" ] || fail "isoparticles $program prints $printed, expected $version"
done
"$fresh/bin/isoparticles" demo -o "$fresh/out"
tests="-q -p no:cacheprovider -c pipelines/wheel/pytest.ini pipelines/wheel/tests"
# shellcheck disable=SC2086
WHEEL=$folder "$fresh/bin/pytest" $tests/test_packaging.py
# shellcheck disable=SC2086
"$fresh/bin/pytest" $tests

step "crate"
"${CARGO:-cargo}" publish --dry-run --locked -p isoparticles-delaunay

step "release-check: passed for $version"
