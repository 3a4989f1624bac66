"""Runs the code of the recipes in the documentation on small parts of their volumes."""

from __future__ import annotations

import os
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

FOLDER = Path(__file__).parents[3] / "docs" / "recipes"
NAMES = sorted(path.stem for path in FOLDER.glob("*.md") if path.stem not in ("index", "gallery"))


@pytest.mark.skipif(os.name == "nt", reason="the code of the pages needs sh")
@pytest.mark.timeout(600)
def test_recipes_run(site: Path, scripts: Path, target: Path | None, tmp_path: Path) -> None:
    environment = {**os.environ, "PYTHONPATH": str(site)}

    def run(name: str) -> subprocess.CompletedProcess[str]:
        command = [sys.executable, str(FOLDER / "run.py"), name, "--small", "--work", str(tmp_path / name)]
        if target is not None:
            command += ["--scripts", str(scripts)]
        return subprocess.run(command, env=environment, capture_output=True, text=True, check=False)

    # most of the time of a small mesh is that of one thread
    with ThreadPoolExecutor(2) as pool:
        for done in pool.map(run, NAMES):
            print(done.stdout)
            assert done.returncode == 0, done.stdout + done.stderr
            assert "(page: " in done.stdout
