"""The process that :func:`isoparticles.fill` starts: ``tetmesh-check`` with progress on stdout.

A separate process can be stopped at any time. BLAS uses one thread in it, as in the program, so the
results are the same. Each line of stdout is a JSON list of a step and a message.
"""

from __future__ import annotations

import json

from isoparticles._native import Context, Step
from tetmesh_check.cli import main


class _Told(Context):
    def step(self, name: str) -> Step:
        _tell(name, "")
        return super().step(name)

    def progress(self, label: str) -> _ToldProgress:
        return _ToldProgress(label)


class _ToldProgress:
    def __init__(self, label: str) -> None:
        self._label = label

    def show(self, message: str) -> None:
        _tell(self._label, message)

    def close(self) -> None:
        pass


def _tell(step: str, message: str) -> None:
    print(json.dumps([step, message]), flush=True)


if __name__ == "__main__":
    raise SystemExit(main(make_context=_Told))
