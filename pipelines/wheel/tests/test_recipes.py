"""Runs the code of the recipes in the documentation on small parts of their volumes."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

FOLDER = Path(__file__).parents[3] / "docs" / "recipes"
NAMES = sorted(path.stem for path in FOLDER.glob("*.md") if path.stem not in ("index", "gallery"))


@pytest.mark.parametrize("name", NAMES)
def test_recipes_run(site: Path, scripts: Path, target: Path | None, tmp_path: Path, name: str) -> None:
    environment = {**os.environ, "PYTHONPATH": str(site)}
    command = [sys.executable, str(FOLDER / "run.py"), name, "--small", "--work", str(tmp_path)]
    if target is not None:
        command += ["--scripts", str(scripts)]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "(page: " in done.stdout
