"""Tests of the contents of the wheel, and of the conda recipe."""

from __future__ import annotations

import re
import tomllib
import zipfile
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[3]


def project(path: str) -> dict[str, Any]:
    table: dict[str, Any] = tomllib.loads((ROOT / path).read_text(encoding="utf-8"))
    return table


def test_the_wheel_names_its_platform_and_holds_everything(wheel: Path) -> None:
    # auditwheel gives this tag if every program runs with this version of glibc
    assert re.search(r"-cp311-abi3-manylinux_2_\d+_\w+\.whl$", wheel.name)
    with zipfile.ZipFile(wheel) as file:
        names = set(file.namelist())
    for program in (
        "distfield",
        "sizefield",
        "seed",
        "particles",
        "reconstruct",
        "phantom",
        "isoparticles-case",
        "isoparticles-volume",
    ):
        assert f"isoparticles/bin/{program}" in names
    assert {
        "tetmesh_check/cli.py",
        "tetmesh_check/options.toml",
        "tetmesh_check/py.typed",
        "isoparticles/_native.abi3.so",
        "isoparticles/_options.py",
        "isoparticles/py.typed",
        "isoparticles/cases/demo.mk",
    } <= names
    assert {"LICENSE-APACHE", "LICENSE-MIT"} <= {Path(name).name for name in names}
    assert any(name.startswith("tetmesh_check/report/page/") and name.endswith(".css") for name in names)
    assert not [name for name in names if "__pycache__" in name or "test_" in name]


def test_the_conda_recipe_has_the_same_versions() -> None:
    recipe = (ROOT / "pipelines" / "conda" / "recipe.yaml").read_text(encoding="utf-8")
    package, stage = project("pyproject.toml"), project("stages/tetmesh-check/pyproject.toml")["project"]
    assert f'version: "{stage["version"]}"' in recipe
    host, run = (recipe.partition(f"  {name}:\n")[2].partition("\n  run:")[0] for name in ("host", "run"))
    python = f"python{package['project']['requires-python']}"
    extras = stage["optional-dependencies"]
    for part, wanted in (
        (host, package["build-system"]["requires"]),
        # conda has no extras
        (run.partition("\n\n")[0], stage["dependencies"] + [*extras["fem"], *extras["formats"]]),
    ):
        listed = {line.strip("- ").replace(" ", "").replace("-base", "") for line in part.splitlines()}
        assert listed - {"pip"} == {python, *wanted}
