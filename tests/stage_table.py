#!/usr/bin/env python3
"""Print the wall time and peak memory of every stage from the reports of cases.

Usage: stage_table.py CASE_FOLDER...

Each folder contains reports/STAGE.json files from the Makefile; see ``make bench-stages``.
"""

from __future__ import annotations

import json
import os
import platform
import sys
from pathlib import Path

STAGES = ["distfield", "sizefield", "seed", "particles", "reconstruct", "tetmesh-check"]


def machine() -> str:
    """Describe the processor, the cores, the memory and the system."""
    processor = platform.processor() or platform.machine()
    memory = ""
    cpuinfo, meminfo = Path("/proc/cpuinfo"), Path("/proc/meminfo")
    if cpuinfo.exists():
        names = [
            line.split(":", 1)[1].strip() for line in cpuinfo.read_text().splitlines() if line.startswith("model name")
        ]
        processor = names[0] if names else processor
    if meminfo.exists():
        memory = f", {int(meminfo.read_text().split()[1]) / 1024**2:.0f} GiB"
    return f"{processor}, {os.cpu_count()} cores{memory}, {platform.system()}"


def row(stage: str, report: dict) -> str:
    """Return one row of the table."""
    memory = report.get("peak_memory_bytes")
    return (
        f"| {stage} | {report['seconds']:.1f} | {'-' if memory is None else f'{memory / 1024**2:.0f}'} "
        f"| {report.get('threads', '-')} | {report.get('outcome', '-')} |"
    )


def main(folders: list[str]) -> int:
    """Print one table per case."""
    if not folders:
        print(__doc__, file=sys.stderr)
        return 2
    print(f"Machine: {machine()}")
    for folder in map(Path, folders):
        print(f"\n{folder.name}\n\n| stage | seconds | peak memory, MiB | threads | outcome |\n|---|---|---|---|---|")
        total = 0.0
        for stage in STAGES:
            path = folder / "reports" / f"{stage}.json"
            if path.exists():
                report = json.loads(path.read_text())
                total += report["seconds"]
                print(row(stage, report))
        print(f"| total | {total:.1f} | | | |")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
