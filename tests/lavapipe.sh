#!/bin/sh
# Installs Mesa's software Vulkan driver, lavapipe, for the tests of the GPU backend, if there is no
# adapter and the user may install packages (as root, or with sudo without a password). The script
# never fails: without an adapter, the tests of the GPU backend are reported as skipped.
#
#   lavapipe.sh PARTICLES      PARTICLES: path of the program `particles`, which lists the adapters
set -u

if [ -n "$("$1" --list-adapters --quiet 2>/dev/null)" ]; then exit 0; fi

if ! command -v apt-get >/dev/null 2>&1; then how=no
elif [ "$(id -u)" = 0 ]; then how=
elif sudo -n true 2>/dev/null; then how=sudo
else how=no; fi

if [ "$how" != no ]; then
    echo "lavapipe: installing mesa-vulkan-drivers, so that the GPU backend can be tested without a GPU" >&2
    { $how apt-get update -q && $how env DEBIAN_FRONTEND=noninteractive apt-get install -y -q --no-install-recommends \
        mesa-vulkan-drivers; } >/dev/null 2>&1
    if [ -n "$("$1" --list-adapters --quiet 2>/dev/null)" ]; then exit 0; fi
fi
echo "lavapipe: no Vulkan adapter: the tests of the GPU backend will skip (Debian: apt-get install mesa-vulkan-drivers)" >&2
