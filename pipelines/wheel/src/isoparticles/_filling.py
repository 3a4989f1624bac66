"""The process that :func:`isoparticles.fill` starts: ``tetmesh-check`` with progress on stdout.

A process of its own can be stopped at any time, and BLAS uses one thread in it, as in the program,
so the results are the same. Each line of stdout is a JSON list of a step and a message.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import contextmanager

from tetmesh_check.cli import main
from tetmesh_check.context import Context, Progress


class _Told(Context):
    @contextmanager
    def step(self, name: str) -> Iterator[None]:
        _tell(name, "")
        with super().step(name):
            yield

    def progress(self, label: str) -> Progress:
        return _ToldProgress("none", label)


class _ToldProgress(Progress):
    def show(self, message: str) -> None:
        _tell(self._label, message)


def _tell(step: str, message: str) -> None:
    print(json.dumps([step, message]), flush=True)


if __name__ == "__main__":
    raise SystemExit(main(make_context=_Told))
