"""The status of a case, and the files that it lists.

``NAME.status.json`` lists the files that the last run made or confirmed. Other files are ignored:
they may be from an earlier run.
"""

from __future__ import annotations

import csv
import json
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TextIO

from tetmesh_check.checks import FIT_BUT_FOR
from tetmesh_check.errors import StageError, file_error

FORMAT, VERSION = "isoparticles-status", 1
_ENDED = frozenset({"done", "failed", "error", "interrupted"})
"""States of a stage whose files are from the last run."""
_KINDS = {
    "passed": "pass", "warning": "warning", "failed": "fail", "error": "fail",
    "interrupted": "warning", "running": "neutral",
}  # fmt: skip
_PICTURES = ("surface", "closeup", "cut", "regions")


def dig(data: Any, *keys: str) -> Any:
    """Look up an entry of nested objects; ``None`` if a key is missing.

    Parameters
    ----------
    data
        The outermost object.
    keys
        Keys, the outermost first.
    """
    for key in keys:
        data = data.get(key) if isinstance(data, dict) else None
    return data


@dataclass(frozen=True)
class Case:
    """One case; see "Status of a case" in ``docs/developer/formats.md``."""

    name: str
    goal: str
    verdict: str
    headline: str
    """The verdict as a sentence, from the program that ran the stages."""
    inputs: list[dict[str, Any]]
    parameters: dict[str, str]
    page: Path | None
    stages: list[dict[str, Any]]
    """Entries of the status, in order. ``report`` is the content of the file ``report_file``, or
    ``None`` unless the stage ended in the last run or was confirmed by it."""
    files: list[dict[str, Any]]
    """Files of these stages that exist: ``path``, ``name`` in the folder, ``stage``, and ``kept``
    if a check of the stage failed."""

    @property
    def reports(self) -> dict[str, dict[str, Any]]:
        """The reports by stage."""
        return {stage["stage"]: stage["report"] for stage in self.stages if stage["report"] is not None}

    @property
    def results(self) -> dict[str, Any]:
        """The results of ``tetmesh-check``; empty if there are none."""
        return dig(self.reports, "tetmesh-check", "results") or {}

    @property
    def checks(self) -> list[dict[str, Any]]:
        """The checks of ``tetmesh-check``; empty if it did not reach them."""
        return self.results.get("checks") or []

    @property
    def seconds(self) -> float:
        """Time of all stages together, s."""
        return float(sum(stage["seconds"] or 0.0 for stage in self.stages))

    @property
    def peak_memory(self) -> int:
        """Memory of the largest process of all stages, bytes; 0 if unknown."""
        return max((int(report.get("peak_memory_bytes") or 0) for report in self.reports.values()), default=0)

    @property
    def warnings(self) -> list[tuple[str, str]]:
        """Stage and words of every warning."""
        return [(stage["stage"], words) for stage in self.stages for words in stage["warnings"]]

    @property
    def accepted(self) -> list[str]:
        """Elements beyond a limit that the user accepts, such as ``3 accepted tetrahedra: why``."""
        return [words.removeprefix(FIT_BUT_FOR) for _, words in self.warnings if words.startswith(FIT_BUT_FOR)]

    @property
    def failures(self) -> list[tuple[str, str]]:
        """Stage and words of every check that failed."""
        return [(stage["stage"], words) for stage in self.stages for words in stage["failed_checks"]]

    @property
    def broken(self) -> dict[str, Any] | None:
        """The stage that ended with an error."""
        return next((stage for stage in self.stages if stage["error"]), None)

    @property
    def kind(self) -> str:
        """``pass``, ``warning``, ``fail`` or ``neutral``."""
        return _KINDS[self.verdict]

    def file(self, stage: str, ending: str) -> Path | None:
        """Find a file of a stage.

        Parameters
        ----------
        stage
            The stage that made it.
        ending
            Ending such as ``.surface.vtp``. A result of a failed check, such as
            ``.surface.failed.vtp``, is also found.
        """
        endings = (ending, ".failed.".join(ending.rsplit(".", 1)))
        own = (file for file in self.files if file["stage"] == stage and file["name"].endswith(endings))
        return next((file["path"] for file in own), None)

    @property
    def input(self) -> Path | None:
        """The meshed volume: that of the user, converted if needed, or the phantom of the case."""
        own = (Path(entry["path"]) for entry in self.inputs if entry["role"] == "volume")
        return self.file("read", ".input.vti") or next(own, self.file("phantom", ".nrrd"))

    @property
    def pictures(self) -> dict[str, Path]:
        """Pictures by kind, ``surface``, ``closeup``, ``cut`` and ``regions``."""
        found = {kind: self.file("tetmesh-check", f".{kind}.png") for kind in _PICTURES}
        return {kind: path for kind, path in found.items() if path is not None}

    @property
    def passes(self) -> list[dict[str, float]]:
        """Log of ``particles``, with one entry per pass; empty if there is none."""
        path = self.file("particles", ".passes.csv")
        return [] if path is None else _read(path, _passes, "give the log that particles wrote (--log)")


def _read(path: Path, parse: Callable[[TextIO], Any], advice: str) -> Any:
    try:
        with path.open(encoding="utf-8", newline="") as stream:
            return parse(stream)
    except (OSError, ValueError, TypeError) as error:
        raise file_error(path, "read", error, advice) from error


def _passes(stream: TextIO) -> list[dict[str, float]]:
    return [{name: float(value) for name, value in row.items()} for row in csv.DictReader(stream)]


def _stage(entry: dict[str, Any], folder: Path) -> dict[str, Any]:
    """Add the report to the entry of a stage."""
    name = entry["report"]
    there = name and entry["state"] in _ENDED and (folder / name).is_file()
    report = _read(folder / name, json.load, "give the report that the stage wrote (--report)") if there else None
    return {**entry, "report": report, "report_file": name}


def _files(stage: dict[str, Any], folder: Path) -> Iterator[dict[str, Any]]:
    """List the files of a stage that exist."""
    if stage["state"] in _ENDED:
        exports = dig(stage["report"], "results", "exports") or []
        for name in dict.fromkeys([*stage["outputs"], *stage["kept"], *exports, stage["report_file"] or ""]):
            if (folder / name).is_file():
                yield {"path": folder / name, "name": name, "stage": stage["stage"], "kept": name in stage["kept"]}


def read_case(status: Path) -> Case:
    """Read the status of a case, and the reports that it lists.

    Parameters
    ----------
    status
        ``NAME.status.json``, in the folder of the case.

    Raises
    ------
    StageError
        If the file is not a status, or if a report that it lists cannot be read.
    """
    advice = "give NAME.status.json, which make writes into the folder of the case"
    data = _read(status, json.load, advice)
    if dig(data, "format") != FORMAT:
        raise StageError(f"{status}: is not the status of a case", "the page shows what the status lists", advice)
    if dig(data, "version") != VERSION:
        raise StageError(
            f"{status}: is a status of version {data.get('version')}",
            f"this program reads version {VERSION}",
            "run make for this case again, with programs of one version",
        )
    folder = status.parent
    try:
        stages = [_stage(entry, folder) for entry in data["stages"]]
        return Case(
            **{key: data[key] for key in ("name", "goal", "verdict", "headline", "inputs", "parameters")},
            page=folder / data["page"] if data["page"] else None,
            stages=stages,
            files=[file for stage in stages for file in _files(stage, folder)],
        )
    except (KeyError, TypeError) as error:
        raise StageError(
            f"{status}: a field is missing or has the wrong type ({type(error).__name__} {error})",
            "the page shows what the status lists",
            advice,
        ) from error
