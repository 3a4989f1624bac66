#!/bin/sh
# Creates the Python environment of tetmesh-check from requirements.lock.
#
# Usage: stages/tetmesh-check/setup-env.sh [--venv DIR] [--check] [--without-hxt]
#                                          [--no-system-packages]
#   --venv DIR             folder of the environment (default: .venv at the root of the repository)
#   --check                change nothing; report what is missing; exit 0 if the environment is
#                          ready, else 2
#   --without-hxt          omit Gmsh (GPL-2.0-or-later, requirements-hxt.lock), which fills large
#                          surfaces quickly
#   --no-system-packages   never call apt-get; messages name the missing packages
# Environment: PYTHON      the interpreter to use (default: the first of python3.11, python3,
#                          python3.12, ... >= 3.11)
#
# Exit codes: 0: ready; 2: something is missing, and the message says how to install it.
#
# The script takes well under a second if nothing has changed. DIR/.tetmesh-check-stamp contains a
# checksum of the lock files, pyproject.toml, this script, the interpreter and the choice of HXT.
# Packages come from the index configured in pip and are checked against the hashes in the lock
# files. Nothing is compiled; `make build` builds the native module of the package isoparticles.
#
# Debian and Ubuntu provide `ensurepip` in a separate package (python3-venv). VTK loads its
# off-screen renderer at run time: libOSMesa (libosmesa6), or EGL with Mesa's drivers (libegl1
# libgl1-mesa-dri) on releases without libOSMesa. VTK can be imported without a renderer. In this
# case, the script prints a warning, and tetmesh-check skips only the pictures. Gmsh's library links
# to OpenGL, X11 and fontconfig. If Gmsh cannot be installed or loaded, the script prints a warning,
# and tetmesh-check uses fTetWild instead.
set -eu

here=$(CDPATH='' cd -- "$(dirname -- "$0")" && pwd)
root=$(CDPATH='' cd -- "$here/../.." && pwd)
venv=$root/.venv
check_only=no
system_packages=yes
with_hxt=yes

say() { printf 'setup-env: %s\n' "$*" >&2; }

# fail WHAT WHY NEXT
fail() {
    printf 'error: %s\n  why it matters: %s\n  what to do: %s\n' "$1" "$2" "$3" >&2
    exit 2
}

while [ $# -gt 0 ]; do
    case $1 in
        --venv)
            [ $# -ge 2 ] || fail "--venv needs a folder" "it says where the environment goes" "give one, as in --venv .venv"
            venv=$2
            shift
            ;;
        --check) check_only=yes ;;
        --without-hxt) with_hxt=no ;;
        --no-system-packages) system_packages=no ;;
        -h | --help)
            sed -n '2,/^set -eu/{/^set -eu/d;s/^# \{0,1\}//;p;}' "$0"
            exit 0
            ;;
        *) fail "unknown option $1" "it would be ignored in silence" "see $0 --help" ;;
    esac
    shift
done

lock=$here/requirements.lock
hxt_lock=$here/requirements-hxt.lock
# Libraries that Gmsh links to and that a minimal Debian or Ubuntu lacks.
hxt_packages="libgl1 libglu1-mesa libxrender1 libxcursor1 libxft2 libxinerama1 libxfixes3 libfontconfig1 libgomp1"
stamp=$venv/.tetmesh-check-stamp

# Prints the command prefix with which this user can install Debian packages: "" for root, "sudo
# -n", or "no" if it is impossible or not permitted.
privilege() {
    if ! command -v apt-get >/dev/null 2>&1 || [ "$system_packages" = no ] || [ "$check_only" = yes ]; then
        echo no
    elif [ "$(id -u)" = 0 ]; then
        echo ""
    elif command -v sudo >/dev/null 2>&1 && sudo -n true >/dev/null 2>&1; then
        echo "sudo -n"
    else
        echo no
    fi
}

# install_packages PACKAGE... : installs Debian packages. Returns 1 if the installation fails or is
# not permitted.
install_packages() {
    how=$(privilege)
    [ "$how" != no ] || return 1
    say "installing Debian packages: $*"
    packages_log=$(mktemp)
    # A fresh container has no package lists, so they are updated before the second attempt.
    if $how env DEBIAN_FRONTEND=noninteractive apt-get install -y -q --no-install-recommends "$@" >"$packages_log" 2>&1 ||
        { $how apt-get update -q >>"$packages_log" 2>&1 &&
            $how env DEBIAN_FRONTEND=noninteractive apt-get install -y -q --no-install-recommends "$@" >>"$packages_log" 2>&1; }; then
        rm -f "$packages_log"
        return 0
    fi
    say "apt-get failed; its last words:"
    tail -n 3 "$packages_log" >&2
    rm -f "$packages_log"
    return 1
}

python_is_new_enough() {
    "$1" -c 'import sys; raise SystemExit(sys.version_info < (3, 11))' >/dev/null 2>&1
}

find_python() {
    for candidate in ${PYTHON:-} python3.11 python3 python3.12 python3.13 python3.14 /usr/bin/python3; do
        if python_is_new_enough "$candidate"; then
            command -v "$candidate"
            return 0
        fi
    done
    return 1
}

# has_modules PYTHON MODULE... : tests whether Python finds the modules, without importing them
has_modules() {
    interpreter=$1
    shift
    "$interpreter" -c 'import sys, importlib.util as u; raise SystemExit(not all(u.find_spec(m) for m in sys.argv[1:]))' "$@" \
        >/dev/null 2>&1
}

can_render() {
    "$venv/bin/python" -m tetmesh_check.report.rendering >/dev/null 2>&1
}

warn_no_renderer() {
    say "WARNING: no off-screen renderer was found, so tetmesh-check will skip its 3-D pictures (nothing else)."
    say "         To get them on Debian or Ubuntu: apt-get install libosmesa6   (or: libegl1 libgl1-mesa-dri)"
}

last_line() {
    printf '%s\n' "$1" | tail -n 1
}

# Fails if Gmsh cannot be used, and prints the reason.
can_hxt() {
    "$venv/bin/python" -c 'import gmsh' 2>&1
}

warn_no_hxt() {
    say "WARNING: HXT (Gmsh) cannot be used ($1), so fTetWild fills large surfaces, too, which may take hours."
    say "         To get it on Debian or Ubuntu: apt-get install $hxt_packages"
    say "         and, if its Python package is missing: $venv/bin/python -m pip install --require-hashes -r $hxt_lock"
    say "         To do without it: $0 --without-hxt (make: HXT=no)"
}

for file in "$lock" "$hxt_lock"; do
    [ -f "$file" ] || fail "$file: not found" "it names the packages to install" "restore it from version control"
done

python=$(find_python) || python=""
if [ -z "$python" ]; then
    if install_packages python3 python3-venv; then python=$(find_python) || python=""; fi
    [ -n "$python" ] || fail "no Python 3.11 or later was found" "tetmesh-check is written in Python" \
        "install it (Debian 12, Ubuntu 24.04 or later: apt-get install python3 python3-venv), or set PYTHON=/path/to/python3.11"
fi

fingerprint=$({
    cat "$lock" "$hxt_lock" "$here/pyproject.toml" "$0"
    "$python" -c 'import sys; print(sys.version, sys.executable)'
    echo "$here, HXT: $with_hxt"
} | "$python" -c 'import hashlib, sys; print(hashlib.sha256(sys.stdin.buffer.read()).hexdigest())')

is_ready() {
    [ -x "$venv/bin/tetmesh-check" ] && [ "$(cat "$stamp" 2>/dev/null || true)" = "$fingerprint" ]
}

# lock HOW : locks file descriptor 9 until this shell exits. Returns 1 if another process holds the
# lock and HOW is "try". On file systems that do not support locks, it succeeds without a lock.
lock() {
    "$python" -c 'import fcntl, sys
try:
    fcntl.flock(9, fcntl.LOCK_EX | (fcntl.LOCK_NB if sys.argv[1] == "try" else 0))
except BlockingIOError:
    sys.exit(1)
except OSError:
    pass' "$1"
}

if is_ready; then
    if [ "$check_only" = yes ]; then
        say "ready: $venv ($("$venv/bin/python" --version))"
        can_render || warn_no_renderer
        [ "$with_hxt" = no ] || reason=$(can_hxt) || warn_no_hxt "$(last_line "$reason")"
    fi
    exit 0
fi
if [ "$check_only" = yes ]; then
    has_modules "$python" venv ensurepip ||
        say "Python's venv or ensurepip is missing; Debian and Ubuntu: apt-get install python3-venv"
    fail "$venv: not there, or not up to date" "tetmesh-check runs in it" "run $0"
fi

# Only one process at a time may create the environment.
lock_file=${venv%/}.lock
if (: >>"$lock_file") 2>/dev/null; then
    exec 9>>"$lock_file"
    if ! lock try; then
        say "another make is installing into $venv; waiting"
        lock wait
        if is_ready; then
            say "ready: $venv/bin/tetmesh-check"
            exit 0
        fi
    fi
fi

if ! has_modules "$python" venv ensurepip; then
    version=$("$python" -c 'import sys; print("%d.%d" % sys.version_info[:2])')
    packages=python3-venv
    case $(readlink -f "$python") in
        /usr/bin/python3.*) packages="python$version-venv" ;;
        *) python=/usr/bin/python3 ;;
    esac
    install_packages "$packages" || true
    has_modules "$python" venv ensurepip && python_is_new_enough "$python" ||
        fail "$python has no venv or no ensurepip module" "they make the environment that the packages go into" \
            "run this as root, then try again: apt-get update && apt-get install -y $packages"
fi

if [ -e "$venv" ] && [ ! -f "$venv/pyvenv.cfg" ] && [ -n "$(ls -A "$venv" 2>/dev/null)" ]; then
    fail "$venv: exists and is no Python environment" "it would be emptied" "move it away, or give another folder with --venv"
fi

say "making $venv with $("$python" --version)"
rm -f "$stamp"
"$python" -m venv --clear "$venv" ||
    fail "$venv: could not be made" "the packages go into it" "see the message above; is the disk full or the folder read-only?"

say "installing the packages of requirements.lock (about 260 MB to download the first time)"
"$venv/bin/python" -m pip install --quiet --disable-pip-version-check --no-input --only-binary :all: --require-hashes -r "$lock" ||
    fail "pip could not install the packages of requirements.lock" "tetmesh-check needs them" \
        "see the message above; common causes are a full disk, a network that cannot be reached, and a proxy (configure pip: pip config)"
"$venv/bin/python" -m pip install --quiet --disable-pip-version-check --no-input --no-deps --no-index --no-build-isolation \
    --editable "$here" ||
    fail "pip could not install $here" "it is the stage itself" "see the message above"
# tetmesh-check imports isoparticles._native, which `make build` links into this folder.
site=$("$venv/bin/python" -c 'import sysconfig; print(sysconfig.get_path("purelib"))')
printf '%s\n' "$root/pipelines/wheel/src" >"$site/isoparticles.pth"

if ! can_render; then
    # libosmesa6 is the smallest renderer, but newer releases provide only EGL.
    if install_packages libosmesa6 || install_packages libegl1 libgl1-mesa-dri; then :; fi
    can_render || warn_no_renderer
fi

if [ "$with_hxt" = yes ]; then
    say "installing HXT: Gmsh, GPL-2.0-or-later (40 MB; --without-hxt leaves it out)"
    "$venv/bin/python" -m pip install --quiet --disable-pip-version-check --no-input --no-deps --only-binary :all: --require-hashes \
        -r "$hxt_lock" || say "pip could not install Gmsh; see the message above"
    # the system libraries help only if Gmsh's Python package is installed
    if ! reason=$(can_hxt) && has_modules "$venv/bin/python" gmsh; then
        # shellcheck disable=SC2086 # a list of names
        install_packages $hxt_packages || true
    fi
    reason=$(can_hxt) || warn_no_hxt "$(last_line "$reason")"
fi

printf '%s\n' "$fingerprint" >"$stamp"
say "ready: $venv/bin/tetmesh-check"
