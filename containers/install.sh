#!/bin/sh
# Installs the wheel as root on a Debian or Ubuntu system whose python3 is 3.11 or later, such as
# Debian 12. Both recipes in this folder use it.
#
#   containers/install.sh FOLDER [vulkan]
#
# FOLDER holds isoparticles-*.whl (make wheel), and requirements.lock and requirements-hxt.lock of
# stages/tetmesh-check. The Python packages are those of the lock files, with verified hashes; the
# wheel itself is installed without its dependencies. `vulkan` adds the Vulkan loader and Mesa's
# drivers.
set -eu

folder=$1
drivers=${2:-}

# Python, the libraries that Gmsh links to, and an off-screen renderer for the pictures.
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
# If anything is missing, the installation fails here instead of at the first run.
isoparticles --version
