"""The status of a case, and the files that it lists.

``NAME.status.json`` says what the last run made or confirmed. Nothing is looked for beside it: a
file that it does not list may be of an earlier run, whatever its name.
"""

from __future__ import annotations

import csv
import json
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from tetmesh_check.checks import FIT_BUT_FOR
from tetmesh_check.errors import StageError

STAGES = ("distfield", "sizefield", "seed", "particles", "reconstruct", "tetmesh-check")
"""In the order they run; where the volume is a phantom, ``phantom`` comes before them."""
FORMAT, VERSION = "isoparticles-status", 1
ENDED = frozenset({"done", "failed", "error", "interrupted"})
"""States of a stage whose report is of the last run."""
_KINDS = {
    "passed": "pass", "warning": "warning", "failed": "fail", "error": "fail", "interrupted": "warning", "running": "neutral",
}  # fmt: skip
_PICTURES = ("surface", "closeup", "cut", "regions")


def dig(data: Any, *keys: str) -> Any:
    """Look up an entry of nested objects; ``None`` where a key is not there.

    Parameters
    ----------
    data
        The outermost object.
    keys
        From the outside in.
    """
    for key in keys:
        data = data.get(key) if isinstance(data, dict) else None
    return data


def count_of(number: int, word: str) -> str:
    """Write a number of things.

    Parameters
    ----------
    number
        The number.
    word
        The singular; the plural gets an ``s``.
    """
    return f"{number} {word}{'' if number == 1 else 's'}"


@dataclass(frozen=True)
class Stage:
    """The status of a stage, and its files."""

    name: str
    state: str
    """``done``, ``failed`` (a check did), ``error``, ``interrupted``, ``running``, ``stale`` or
    ``not reached``."""
    seconds: float | None = None
    command: str = ""
    outputs: tuple[str, ...] = ()
    """Files relative to the folder of the case."""
    kept: tuple[str, ...] = ()
    """Files of a stage whose check failed, under other names."""
    warnings: tuple[str, ...] = ()
    failed_checks: tuple[str, ...] = ()
    error: dict[str, str] | None = None
    """``what``, ``why`` and ``next``."""
    report_file: str | None = None
    report: dict[str, Any] | None = None
    """The report of the stage."""


@dataclass(frozen=True)
class Case:
    """One case."""

    name: str
    goal: str
    """``mesh``, or the stage that it stops at."""
    verdict: str
    """``passed``, ``warning``, ``failed``, ``error``, ``interrupted`` or ``running``."""
    said: str
    """The verdict as a sentence, by who ran the stages."""
    folder: Path
    inputs: list[dict[str, Any]] = field(default_factory=list)
    """Each with ``role``, ``path``, ``bytes`` and ``hash``."""
    parameters: dict[str, str] = field(default_factory=dict)
    """As the user or the file of the case gave them."""
    stages: list[Stage] = field(default_factory=list)
    """All of them, in order."""
    page: Path | None = None
    passes: list[dict[str, float]] = field(default_factory=list)
    """Log of ``particles``, with one entry per pass."""

    @property
    def reports(self) -> dict[str, dict[str, Any]]:
        """Reports of the stages that ended in the last run, or were confirmed by it, by stage."""
        return {stage.name: stage.report for stage in self.stages if stage.report is not None}

    @property
    def results(self) -> dict[str, Any]:
        """The results of ``tetmesh-check``; empty where there are none."""
        results: dict[str, Any] = dig(self.reports, STAGES[-1], "results") or {}
        return results

    @property
    def checks(self) -> list[dict[str, Any]]:
        """The checks of ``tetmesh-check``; empty where it did not come so far."""
        checks = self.results.get("checks", [])
        return [check for check in checks if isinstance(check, dict) and {"verdict", "words"} <= set(check)]

    def limit(self, name: str) -> float | None:
        """Return the limit of a check of ``tetmesh-check``."""
        return next((check.get("limit") for check in self.checks if check.get("name") == name), None)

    def has_ended(self, name: str) -> bool:
        """Return whether a stage ended in the last run without an error."""
        return any(s.name == name and s.state in ENDED and s.error is None for s in self.stages)

    @property
    def contents(self) -> str:
        """The result of the case, for titles."""
        if self.goal in ("mesh", STAGES[-1]):
            return "surface and tetrahedra"
        return "surface" if self.goal in ("surface", "reconstruct") else self.goal

    @property
    def seconds(self) -> float:
        """Time of all stages together, s."""
        return float(sum(stage.seconds or 0.0 for stage in self.stages))

    @property
    def peak_memory(self) -> float:
        """Memory of the largest process of all stages, bytes."""
        return float(max((report.get("peak_memory_bytes") or 0 for report in self.reports.values()), default=0))

    @property
    def warnings(self) -> list[tuple[str, str]]:
        """Stage and words of every warning."""
        return [(stage.name, words) for stage in self.stages for words in stage.warnings]

    @property
    def accepted(self) -> list[str]:
        """Elements beyond a limit that the user accepts, such as ``3 accepted tetrahedra: why``."""
        return [words.removeprefix(FIT_BUT_FOR) for _, words in self.warnings if words.startswith(FIT_BUT_FOR)]

    @property
    def failures(self) -> list[tuple[str, str]]:
        """Stage and words of every check that failed."""
        return [(stage.name, words) for stage in self.stages for words in stage.failed_checks]

    @property
    def broken(self) -> Stage | None:
        """The stage that ended with an error."""
        return next((stage for stage in self.stages if stage.error is not None), None)

    @property
    def kind(self) -> str:
        """``pass``, ``warning`` (also passed with warnings), ``fail`` or ``neutral``."""
        kind = _KINDS.get(self.verdict, "fail")
        return "warning" if kind == "pass" and self.warnings else kind

    @property
    def headline(self) -> str:
        """The verdict in a sentence, with the number of warnings."""
        warned = count_of(len(self.warnings), "warning")
        if self.verdict == "running":
            at = next((stage.name for stage in self.stages if stage.state == "running"), "")
            return f"Still running{f': {at}' if at else ''}"
        if self.verdict == "interrupted":
            at = next((stage.name for stage in self.stages if stage.state == "interrupted"), "")
            return f"Interrupted{f' during {at}' if at else ''}: run the same command again to continue"
        if self.verdict == "error":
            broken = self.broken
            return f"No mesh: {broken.name}: {dig(broken.error, 'what')}" if broken else f"No mesh: {self.said}"
        whole = self.goal in ("mesh", STAGES[-1])
        if self.verdict == "failed":
            failed = self.failures
            words = f"{count_of(len(failed), 'check')} failed" if failed else self.said
            tail = f", {warned}" if self.warnings else ""
            return f"{'Not fit for simulation' if whole else 'Not valid'}: {words}{tail}"
        fit = "Fit for simulation" if whole else f"Complete up to {self.goal}"
        if self.accepted:
            return f"{fit}, but for {' and '.join(self.accepted)}; {warned}"
        if self.warnings:
            return f"{fit}, {warned}"
        return f"{fit}: all {len(self.checks)} checks passed" if self.checks else f"{fit}: no warnings"

    def outputs(self, stage: str, ending: str) -> Iterator[Path]:
        """Find existing files of a stage, listed by the status, by the end of their names.

        Parameters
        ----------
        stage
            The stage that made them.
        ending
            As in ``.surface.vtp``; a result that was set aside because a check failed ends in
            ``.surface.failed.vtp``.
        """
        stem, dot, suffix = ending.rpartition(".")
        aside = f"{stem}.failed{dot}{suffix}"
        for entry in self.stages:
            if entry.name == stage and entry.state in ENDED:
                for name in (*entry.outputs, *entry.kept):
                    if name.endswith((ending, aside)) and (self.folder / name).is_file():
                        yield self.folder / name

    @property
    def surface(self) -> Path | None:
        """The triangles."""
        return next(self.outputs("reconstruct", ".surface.vtp"), None)

    @property
    def volume(self) -> Path | None:
        """The tetrahedra."""
        return next(self.outputs(STAGES[-1], ".volume.vtu"), None)

    @property
    def input(self) -> Path | None:
        """The volume that was meshed: the user's, or the phantom that was made for the case."""
        for entry in self.inputs:
            if entry.get("role") == "volume":
                return Path(str(entry["path"]))
        return next(self.outputs("phantom", ".nrrd"), None)

    @property
    def pictures(self) -> dict[str, Path]:
        """Pictures by kind, ``surface``, ``closeup``, ``cut`` and ``regions``."""
        found = {kind: next(self.outputs(STAGES[-1], f".{kind}.png"), None) for kind in _PICTURES}
        return {kind: path for kind, path in found.items() if path is not None}


def _json(path: Path, advice: str) -> Any:
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise StageError.file(path, "read", error, advice) from error


def read_report(path: Path) -> dict[str, Any]:
    """Read the report of a stage.

    Parameters
    ----------
    path
        A JSON file.

    Raises
    ------
    StageError
        If it cannot be read, or is no report.
    """
    advice = "give the report that the stage wrote (--report)"
    report = _json(path, advice)
    wanted = {"tool", "seconds", "results", "command_line", "error"}
    if not isinstance(report, dict) or not wanted <= set(report) or not isinstance(report["results"], dict):
        raise StageError(f"{path}: is not the report of a stage", "the page shows its results", advice)
    return report


def read_passes(path: Path) -> list[dict[str, float]]:
    """Read the log of ``particles``.

    Parameters
    ----------
    path
        A CSV file, one line a pass.
    """
    try:
        with path.open(encoding="utf-8", newline="") as stream:
            return [{name: float(value) for name, value in row.items()} for row in csv.DictReader(stream)]
    except (OSError, ValueError, TypeError, AttributeError) as error:
        raise StageError.file(path, "read", error, "give the log that particles wrote (--log)") from error


def _stage(entry: dict[str, Any], folder: Path) -> Stage:
    name, state = str(entry["stage"]), str(entry["state"])
    report_file = entry.get("report")
    report = None
    if report_file and state in ENDED and (folder / report_file).is_file():
        report = read_report(folder / report_file)
    error = entry.get("error")
    return Stage(
        name,
        state,
        entry.get("seconds"),
        str(entry.get("command") or ""),
        tuple(entry.get("outputs") or ()),
        tuple(entry.get("kept") or ()),
        tuple(entry.get("warnings") or ()),
        tuple(entry.get("failed_checks") or ()),
        error if isinstance(error, dict) else None,
        report_file,
        report,
    )


def read_case(status: Path) -> Case:
    """Read the status of a case, and what it lists.

    Parameters
    ----------
    status
        ``NAME.status.json``, in the folder of the case.

    Raises
    ------
    StageError
        If it is no status, or a report that it lists cannot be read.
    """
    advice = "give NAME.status.json, which make writes into the folder of the case"
    data = _json(status, advice)
    if not isinstance(data, dict) or data.get("format") != FORMAT:
        raise StageError(f"{status}: is not the status of a case", "the page shows what the status lists", advice)
    if data.get("version") != VERSION:
        raise StageError(
            f"{status}: is a status of version {data.get('version')}",
            f"this program reads version {VERSION}",
            "run make for this case again, with programs of one version",
        )
    folder = status.parent
    try:
        stages = [_stage(entry, folder) for entry in data["stages"]]
        case = Case(
            str(data["name"]),
            str(data.get("goal") or "mesh"),
            str(data["verdict"]),
            str(data.get("headline") or ""),
            folder,
            [entry for entry in data.get("inputs") or [] if "path" in entry],
            {str(key): str(value) for key, value in (data.get("parameters") or {}).items()},
            stages,
            folder / data["page"] if data.get("page") else None,
        )
    except (KeyError, TypeError, AttributeError) as error:
        raise StageError(
            f"{status}: a field is missing or has the wrong type ({type(error).__name__} {error})",
            "the page shows what the status lists",
            advice,
        ) from error
    for path in case.outputs("particles", ".passes.csv"):
        case.passes.extend(read_passes(path))
    return case
