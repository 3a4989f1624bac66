"""Build hooks that add the programs and the native module to the wheel."""

from __future__ import annotations

import os
import platform
import subprocess
import sys
import sysconfig
import tomllib
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface
from hatchling.metadata.plugin.interface import MetadataHookInterface

ROOT = Path(__file__).resolve().parents[2]
TARGET = Path(os.environ.get("CARGO_TARGET_DIR", ROOT / "target"))
SHARE = "target/share"
"""Folder of the completions and man pages in a source distribution."""
PROGRAMS = (
    "distfield",
    "sizefield",
    "seed",
    "particles",
    "reconstruct",
    "phantom",
    "isoparticles-case",
    "isoparticles-volume",
)
LIBRARIES = {
    "win32": ("isoparticles_python.dll", "_native.pyd"),
    "darwin": ("libisoparticles_python.dylib", "_native.abi3.so"),
    "linux": ("libisoparticles_python.so", "_native.abi3.so"),
}
"""The library of the native module, and the name by which Python imports it."""
MACOS = os.environ.get("MACOSX_DEPLOYMENT_TARGET", "11.0")
"""Oldest macOS on which the programs run. 11.0 is the first version for ARM."""


class Metadata(MetadataHookInterface):
    """Copies the version and the dependencies of tetmesh-check to the wheel."""

    def update(self, metadata: dict[str, Any]) -> None:
        """Fill in the dynamic fields."""
        with (ROOT / "stages" / "tetmesh-check" / "pyproject.toml").open("rb") as file:
            stage = tomllib.load(file)["project"]
        metadata["version"] = stage["version"]
        metadata["dependencies"] = stage["dependencies"]
        extras = {name: needs for name, needs in stage["optional-dependencies"].items() if name != "dev"}
        metadata["optional-dependencies"] = extras
        metadata["scripts"] = {"isoparticles": "isoparticles.command:main", **stage["scripts"]}


class Programs(BuildHookInterface[Any]):
    """Adds the programs to the wheel and sets its platform tag. Adds the completions to both."""

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """List the files.

        ISOPARTICLES_BIN is the folder of the programs; without it, Cargo builds them. The
        completions and man pages are there after ``make completions``.
        """
        del version  # "standard" or "editable": the files are the same
        share = TARGET / "share" if (TARGET / "share").is_dir() else ROOT / SHARE
        texts = [file for file in sorted(share.rglob("*")) if file.is_file()]
        if self.target_name == "sdist":
            build_data["force_include"].update({str(file): f"{SHARE}/{file.relative_to(share)}" for file in texts})
            return
        folder = Path(os.environ["ISOPARTICLES_BIN"]) if "ISOPARTICLES_BIN" in os.environ else build()
        ending = sysconfig.get_config_var("EXE") or ""
        library, module = LIBRARIES[sys.platform]
        wanted = {f"{name}{ending}": f"isoparticles/bin/{name}{ending}" for name in PROGRAMS}
        for name, place in {**wanted, library: f"isoparticles/{module}"}.items():
            build_data["force_include"][str(folder / name)] = place
        # The wheel does not install the stages as commands of their own, so the man page of a stage
        # is named `isoparticles-STAGE`.
        for file in texts:
            of_stage = file.stem.lstrip("_") in PROGRAMS
            if not of_stage:
                build_data["shared_data"][str(file)] = f"share/{file.relative_to(share)}"
            elif file.suffix == ".1":
                build_data["shared_data"][str(file)] = f"share/man/man1/isoparticles-{file.name}"
        build_data["pure_python"] = False
        # the native module uses the stable interface of Python 3.11
        build_data["tag"] = f"cp311-abi3-{system()}"


def build() -> Path:
    """Build the programs and return their folder."""
    environment = {"CARGO_PROFILE_RELEASE_STRIP": "symbols", **os.environ, "MACOSX_DEPLOYMENT_TARGET": MACOS}
    subprocess.run(["cargo", "build", "--release", "--locked"], cwd=ROOT, env=environment, check=True)
    return TARGET / "release"


def system() -> str:
    """Return the platform tag."""
    # Python itself may be built for another macOS, and for both processors
    name = f"macosx-{MACOS}-{platform.machine()}" if sys.platform == "darwin" else sysconfig.get_platform()
    return name.replace("-", "_").replace(".", "_")
