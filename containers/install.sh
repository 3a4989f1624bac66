#!/bin/sh
# Puts the wheel into a bare Debian 12 (or Ubuntu 22.04 with Python 3.11, or later), as root: what both recipes here do.
#
#   containers/install.sh FOLDER [vulkan]
#
# FOLDER holds isoparticles-*.whl (make wheel) and the lock files requirements.lock and requirements-hxt.lock of stages/tetmesh-check. The Python packages
# are those of the locks, checked by their hashes; the wheel itself is installed without looking for others. `vulkan` adds the loader and Mesa's drivers.
set -eu

folder=$1
drivers=${2:-}

# Python; what Gmsh's library links to; an off-screen renderer for the pictures.
set -- python3 python3-venv ca-certificates \
    libgl1 libglu1-mesa libxrender1 libxcursor1 libxft2 libxinerama1 libxfixes3 libfontconfig1 libgomp1 libosmesa6
if [ "$drivers" = vulkan ]; then
    set -- "$@" libvulkan1 mesa-vulkan-drivers
fi
export DEBIAN_FRONTEND=noninteractive
apt-get update -q
apt-get install -y -q --no-install-recommends "$@"
rm -rf /var/lib/apt/lists/*

python3 -m venv /opt/isoparticles
pip() { /opt/isoparticles/bin/python -m pip "$@" --quiet --disable-pip-version-check --no-input --no-cache-dir; }
pip install --only-binary :all: --require-hashes -r "$folder/requirements.lock" -r "$folder/requirements-hxt.lock"
pip install --no-deps --no-index "$folder"/isoparticles-*.whl
ln -s /opt/isoparticles/bin/isoparticles /opt/isoparticles/bin/tetmesh-check /usr/local/bin/
# Fails here, and not at the first case, where anything is missing.
isoparticles --version
