"""``setup-env.sh`` makes the environment in one process at a time."""

from __future__ import annotations

import fcntl
import subprocess
from pathlib import Path

SCRIPT = Path(__file__).parents[1] / "setup-env.sh"


def test_a_second_installation_waits_for_the_first(tmp_path: Path) -> None:
    with (tmp_path / "venv.lock").open("a") as held:
        fcntl.flock(held, fcntl.LOCK_EX)
        command = [SCRIPT, "--venv", tmp_path / "venv", "--no-system-packages"]
        with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as second:
            assert second.stderr is not None
            assert "another make is installing" in second.stderr.readline()
            second.kill()
    assert not (tmp_path / "venv").exists()
