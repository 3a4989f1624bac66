"""Build hooks that add the programs, the native module, tetmesh-check and the demo to the wheel."""

from __future__ import annotations

import os
import sysconfig
import tomllib
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface
from hatchling.metadata.plugin.interface import MetadataHookInterface

ROOT = Path(__file__).resolve().parents[2]
TETMESH_CHECK = ROOT / "stages" / "tetmesh-check"
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
LIBRARY = "libisoparticles_python.so"


class Metadata(MetadataHookInterface):
    """Copies the version and the dependencies of tetmesh-check to the wheel."""

    def update(self, metadata: dict[str, Any]) -> None:
        """Fill in the dynamic fields."""
        with (TETMESH_CHECK / "pyproject.toml").open("rb") as file:
            stage = tomllib.load(file)["project"]
        metadata["version"] = stage["version"]
        metadata["dependencies"] = stage["dependencies"]
        extras = {name: needs for name, needs in stage["optional-dependencies"].items() if name != "dev"}
        metadata["optional-dependencies"] = extras
        metadata["scripts"] = {"isoparticles": "isoparticles.command:main", **stage["scripts"]}


class Programs(BuildHookInterface[Any]):
    """Adds the programs and tetmesh-check to the wheel, and sets its platform tag."""

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """List the files of the wheel.

        ISOPARTICLES_BIN is the folder of the programs; ISOPARTICLES_NATIVE is the library of the
        native module; ISOPARTICLES_SHARE is the folder of the completions and man pages.
        """
        del version  # "standard" or "editable": the files are the same
        folder = Path(os.environ.get("ISOPARTICLES_BIN", ROOT / "target" / "release"))
        ending = sysconfig.get_config_var("EXE") or ""
        included: dict[str, str] = build_data["force_include"]
        for name in PROGRAMS:
            program = folder / f"{name}{ending}"
            if not program.is_file():
                raise FileNotFoundError(f"{program}: not built (cargo build --release)")
            included[str(program)] = f"isoparticles/bin/{program.name}"
        native = Path(os.environ.get("ISOPARTICLES_NATIVE", ROOT / "target" / "release" / LIBRARY))
        if not native.is_file():
            raise FileNotFoundError(f"{native}: not built (cargo build --release)")
        included[str(native)] = "isoparticles/_native.abi3.so"
        source = TETMESH_CHECK / "src"
        for file in sorted(source.rglob("*")):
            if file.is_file() and "__pycache__" not in file.parts and not file.parts[-2].endswith(".egg-info"):
                included[str(file)] = str(file.relative_to(source))
        included[str(ROOT / "pipelines" / "demo.mk")] = "isoparticles/cases/demo.mk"
        for licence in ("LICENSE-MIT", "LICENSE-APACHE"):
            included[str(ROOT / licence)] = f"isoparticles/{licence}"
        share = Path(os.environ.get("ISOPARTICLES_SHARE", ROOT / "target" / "share"))
        # The wheel does not install the stages as commands of their own, so the man page of a stage
        # is named `isoparticles-STAGE`.
        own = [file for file in sorted(share.rglob("*")) if file.is_file()]
        if not own:
            raise FileNotFoundError(f"{share}: no completions and man pages there (make completions)")
        for file in own:
            of_stage = file.stem.lstrip("_") in PROGRAMS
            if not of_stage:
                build_data["shared_data"][str(file)] = f"share/{file.relative_to(share)}"
            elif file.suffix == ".1":
                build_data["shared_data"][str(file)] = f"share/man/man1/isoparticles-{file.name}"
        build_data["pure_python"] = False
        # the native module uses the stable interface of Python 3.11
        build_data["tag"] = f"cp311-abi3-{sysconfig.get_platform().replace('-', '_').replace('.', '_')}"
