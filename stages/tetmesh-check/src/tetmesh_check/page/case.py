"""What is known about a case: the reports of its stages, the passes of its particles, its meshes and pictures."""

from __future__ import annotations

import base64
import csv
import io
import json
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from tetmesh_check.errors import StageError

STAGES = ("distfield", "sizefield", "seed", "particles", "reconstruct", "tetmesh-check")
"""In the order they run."""
_PICTURE_WIDTH = 1400


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


@dataclass(frozen=True)
class Case:
    """One case."""

    name: str
    report: dict[str, Any]
    """What ``tetmesh-check`` wrote."""
    stages: dict[str, dict[str, Any]] = field(default_factory=dict)
    """Reports of all stages that are there, in order, by name."""
    passes: list[dict[str, float]] = field(default_factory=list)
    """What ``particles`` logged, one entry a pass."""
    surface: Path | None = None
    volume: Path | None = None
    pictures: dict[str, Path] = field(default_factory=dict)
    """By kind: ``surface``, ``closeup``, ``cut``."""

    @property
    def results(self) -> dict[str, Any]:
        """The results of ``tetmesh-check``."""
        results: dict[str, Any] = self.report["results"]
        return results

    @property
    def checks(self) -> list[dict[str, Any]]:
        """The checks of ``tetmesh-check``; empty where it did not come so far."""
        checks = self.results.get("checks", [])
        return [check for check in checks if isinstance(check, dict) and {"verdict", "words"} <= set(check)]

    @property
    def seconds(self) -> float:
        """Time of all stages together, s."""
        return float(sum(report["seconds"] or 0.0 for report in self.stages.values()))

    @property
    def peak_memory(self) -> float:
        """Memory of the largest process of all stages, bytes."""
        return float(max((report.get("peak_memory_bytes") or 0 for report in self.stages.values()), default=0))

    def verdict(self) -> tuple[str, str]:
        """``pass``, ``warning`` or ``fail``, and the same in a sentence."""
        if self.report["error"] is not None:
            return "fail", f"No mesh: {dig(self.report, 'error', 'what')}"
        for stage, report in self.stages.items():
            if report["error"] is not None:
                return "fail", f"Not up to date: {stage} failed: {dig(report, 'error', 'what')}"
            if stage != STAGES[-1] and report.get("failed_checks"):
                return "fail", f"Not fit for simulation: a check of {stage} failed: {report['failed_checks'][0]}"
        failed = [check for check in self.checks if check["verdict"] == "fail"]
        warned = [check for check in self.checks if check["verdict"] == "warning"]
        if failed:
            return "fail", f"Not fit for simulation: {len(failed)} of {len(self.checks)} checks failed"
        if not self.checks:
            return "fail", "Not known to be fit for simulation: the report holds no checks"
        if warned:
            passed = len(self.checks) - len(warned)
            return (
                "warning",
                f"Fit for simulation: {passed} of {len(self.checks)} checks passed, the others are warnings",
            )
        return "pass", f"Fit for simulation: all {len(self.checks)} checks passed"


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
    try:
        report = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise StageError.file(path, "read", error, advice) from error
    wanted = {"tool", "seconds", "results", "command_line", "error"}
    if not isinstance(report, dict) or not wanted <= set(report) or not isinstance(report["results"], dict):
        raise StageError(f"{path}: is no report of a stage", "the page is made from it", advice)
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


def case_name(report: Path) -> str:
    """Name of a case by that of its report.

    Parameters
    ----------
    report
        ``NAME.report.json``, or ``NAME.report.failed.json`` where a check failed.
    """
    return report.name.removesuffix(".json").removesuffix(".failed").removesuffix(".report")


def read_case(report: Path, name: str | None = None) -> Case:
    """Gather a case from the folder of its report, as the Makefile leaves it.

    Parameters
    ----------
    report
        ``NAME.report.json`` of ``tetmesh-check``; beside it may lie ``reports/STAGE.json``, ``NAME.passes.csv``,
        ``NAME.surface.vtp``, ``NAME.volume.vtu`` (or ``NAME.volume.failed.vtu``) and ``pictures/``.
    name
        Name of the case; that of the file by default.
    """
    own = read_report(report)
    if own["tool"] != "tetmesh-check":
        raise StageError(
            f"{report}: is of {own['tool']}", "the page is about the tetrahedra", "give that of tetmesh-check"
        )
    folder = report.parent
    stem = case_name(report)
    stages = {
        stage: read_report(path) for stage in STAGES[:-1] if (path := folder / "reports" / f"{stage}.json").is_file()
    }
    stages[STAGES[-1]] = own

    def first(paths: Iterable[Path]) -> Path | None:
        return next((path for path in paths if path.is_file()), None)

    passes = folder / f"{stem}.passes.csv"
    drawn = dig(own, "results", "pictures", "drawn") or []
    pictures = {
        kind: path for kind in ("surface", "closeup", "cut") for word in drawn
        if word.endswith(f".{kind}.png") and (path := folder / "pictures" / word).is_file()
    }  # fmt: skip
    made = own["error"] is None
    return Case(
        name or stem,
        own,
        stages,
        read_passes(passes) if passes.is_file() else [],
        first([folder / f"{stem}.surface.vtp"]) if made else None,
        first(folder / f"{stem}.volume.{kind}" for kind in ("vtu", "failed.vtu")) if made else None,
        pictures,
    )


def picture_data(path: Path, width: int = _PICTURE_WIDTH) -> tuple[str, int, int]:
    """Turn a picture into a data address for the page (WebP); with its width and height, pixels.

    Parameters
    ----------
    path
        A picture.
    width
        Wider ones are made smaller.
    """
    from PIL import Image

    try:
        with Image.open(path) as opened:
            image = opened.convert("RGB")
    except OSError as error:
        raise StageError.file(path, "read", error, "draw the pictures again (tetmesh-check --pictures)") from error
    if image.width > width:
        image = image.resize((width, round(image.height * width / image.width)), Image.Resampling.LANCZOS)
    stream = io.BytesIO()
    image.save(stream, "WEBP", quality=82, method=4)
    text = base64.b64encode(stream.getvalue()).decode("ascii")
    return f"data:image/webp;base64,{text}", image.width, image.height
