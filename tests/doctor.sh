#!/bin/sh
# Reports which requirements for building and running the pipeline are missing on this machine, and
# how to install them (`make doctor`). The exit code is 0 if all requirements are met, and 1 if
# something is missing. The script changes nothing.
set -u
cd "$(dirname "$0")/.." || exit 2
missing=0

good() { printf '  ok       %s\n' "$1"; }
note() { printf '  note     %s\n' "$1"; }
# bad WHAT NEXT
bad() {
    printf '  MISSING  %s\n           %s\n' "$1" "$2"
    missing=$((missing + 1))
}

# at_least HAVE WANT: succeeds if version HAVE is WANT or newer. Compares up to three components.
at_least() {
    printf '%s %s\n' "$1" "$2" | awk '{
        split($1, have, "."); split($2, want, ".");
        for (i = 1; i <= 3; i++) { if (have[i] + 0 > want[i] + 0) exit 0; if (have[i] + 0 < want[i] + 0) exit 1 }
        exit 0 }'
}

echo "Programs"
want_rust=$(sed -n 's/^rust-version = "\(.*\)"/\1/p' Cargo.toml)
if command -v "${CARGO:-cargo}" >/dev/null 2>&1 && command -v rustc >/dev/null 2>&1; then
    have=$(rustc --version | awk '{print $2}' | sed 's/-.*//')
    if at_least "$have" "$want_rust"; then good "rustc $have (at least $want_rust)"; else
        bad "rustc $have is older than $want_rust" "rustup update stable   (https://rustup.rs)"
    fi
else
    bad "Rust (cargo and rustc, at least $want_rust)" "install it from https://rustup.rs, then open a new shell"
fi
if command -v cc >/dev/null 2>&1; then good "a linker: $(command -v cc)"; else
    bad "a C linker (cc)" "Debian and Ubuntu: apt-get install build-essential;  macOS: xcode-select --install"
fi
have=$(${MAKE:-make} --version 2>/dev/null | sed -n '1s/.*GNU Make //p')
if [ -n "$have" ] && at_least "$have" 4.3; then good "GNU make $have (at least 4.3)"; else
    bad "GNU make 4.3 or later (found: ${have:-none})" "Debian and Ubuntu: apt-get install make;  macOS: brew install make, then use gmake"
fi

echo "Python, for the tetrahedra"
python=""
for candidate in ${PYTHON:-} python3.11 python3 python3.12 python3.13 python3.14; do
    if "$candidate" -c 'import sys; raise SystemExit(sys.version_info < (3, 11))' >/dev/null 2>&1; then
        python=$candidate
        break
    fi
done
if [ -z "$python" ]; then
    bad "Python 3.11 or later" "Debian 12 and Ubuntu 24.04 or later: apt-get install python3 python3-venv"
else
    good "$("$python" --version)"
    if "$python" -c 'import venv, ensurepip' >/dev/null 2>&1; then good "its venv and ensurepip modules"; else
        bad "Python's venv or ensurepip module" "Debian and Ubuntu: apt-get install python3-venv"
    fi
    setup=stages/tetmesh-check/setup-env.sh
    if $setup --check >/dev/null 2>&1 || $setup --check --without-hxt >/dev/null 2>&1; then
        good "the environment .venv is up to date"
        if .venv/bin/python -m tetmesh_check.report.rendering >/dev/null 2>&1; then good "off-screen pictures"; else
            note "no off-screen renderer: pictures are skipped (Debian: apt-get install libosmesa6)"
        fi
        if .venv/bin/python -c 'import gmsh' >/dev/null 2>&1; then good "HXT (Gmsh) for large surfaces"; else
            note "no HXT (Gmsh): large surfaces take hours; $setup --check says what it lacks"
        fi
    else
        note "the environment .venv is not there or not up to date: make env makes it (about 260 MB to download)"
    fi
fi

echo "Machine"
cores=$(getconf _NPROCESSORS_ONLN 2>/dev/null || echo "?")
note "$cores cores"
if [ -r /proc/meminfo ]; then
    memory=$(awk '/^MemAvailable/ { print int($2 / 1024) }' /proc/meminfo)
    if [ "$memory" -ge 4000 ]; then good "$memory MiB of memory available (4000 build everything and mesh a 268 x 129 x 177 volume)"; else
        bad "$memory MiB of memory available; building and meshing a 268 x 129 x 177 volume want 4000" "close other programs, or use another machine"
    fi
fi
disk=$(df -Pk . | awk 'NR == 2 { print int($4 / 1024) }')
if [ "$disk" -ge 6000 ]; then good "$disk MiB of disk free here (6000 hold the builds and the Python environment)"; else
    bad "$disk MiB of disk free here; the builds and the Python environment want 6000" "make room, or set CARGO_TARGET_DIR and VENV to another disk"
fi
note "no GPU is needed; particles uses one where it finds one (Vulkan, Metal or DX12 driver)"
particles=${CARGO_TARGET_DIR:-target}/release/particles
if [ -x "$particles" ]; then
    adapters=$("$particles" --list-adapters --quiet 2>/dev/null)
    if [ -n "$adapters" ]; then printf '%s\n' "$adapters" | while IFS= read -r line; do note "adapter: $line"; done; fi
else
    note "the adapters are listed here once particles is built (make build)"
fi

if [ "$missing" = 0 ]; then
    echo "Everything needed is here."
else
    echo "$missing missing: see above."
    exit 1
fi
