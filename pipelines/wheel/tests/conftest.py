"""Fixtures: the wheel, and the folders in which it is installed.

WHEEL is the folder of a wheel to install without its dependencies; the test environment provides
them. Without WHEEL, the tests use the installed package.
"""

from __future__ import annotations

import importlib.util
import os
import subprocess
import sys
from pathlib import Path

import pytest


@pytest.fixture(scope="session")
def wheel() -> Path:
    if "WHEEL" not in os.environ:
        pytest.skip("WHEEL is not set")
    (made,) = Path(os.environ["WHEEL"]).glob("*.whl")
    return made


@pytest.fixture(scope="session")
def target(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path | None:
    """Return the folder in which the wheel is installed, or None without WHEEL."""
    if "WHEEL" not in os.environ:
        return None
    folder = tmp_path_factory.mktemp("site")
    pip = [sys.executable, "-m", "pip", "install", "--quiet", "--disable-pip-version-check", "--no-deps", "--no-index"]
    subprocess.run([*pip, "--target", str(folder), str(request.getfixturevalue("wheel"))], check=True)
    return folder


@pytest.fixture(scope="session")
def site(target: Path | None) -> Path:
    """Return the folder of the package."""
    spec = importlib.util.find_spec("isoparticles") if target is None else None
    return target or Path(spec.origin).parents[1]


@pytest.fixture(scope="session")
def scripts(target: Path | None) -> Path:
    """Return the folder of the commands."""
    return Path(sys.executable).parent if target is None else target / "bin"


@pytest.fixture(scope="session")
def share(target: Path | None) -> Path:
    """Return the folder of the completions and man pages."""
    return Path(sys.prefix if target is None else target) / "share"
