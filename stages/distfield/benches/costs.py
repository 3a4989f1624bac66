"""Measures the time and memory of the stages on phantoms, and fits the rates of `cost.rs`.

    python stages/distfield/benches/costs.py [--bin target/release] [--volumes VOLUME;OPTION ...]

With --volumes, it prints one table row per volume: the predictions of `isoparticles-volume info`
and, in brackets, the measured values.

Without --volumes, it prints one line per phantom and group of stages: nodes of the padded grid,
voxel faces at the surface, vertices, processor seconds (user and system), and peak memory. It then
prints the rates that minimise the squared relative errors over the phantoms: seconds per million
nodes, faces and vertices, and bytes per node, face and vertex plus a constant.

Needs numpy. Run it on an otherwise idle machine.
"""

import argparse
import json
import os
import subprocess
import tempfile
from pathlib import Path

import numpy as np

# Each entry contains the arguments of `phantom`, the option that selects the object, and the
# options of `sizefield`.
PHANTOMS = [
    ("torso --part heart", "--iso=100", ""),
    ("torso --part ribs", "--iso=370", ""),
    ("torso --part lungs --kind label", "--labels=all", ""),
    ("ball --size 192", "--iso=100", ""),
    ("ball --size 96 --kind label", "--labels=1", "--uniform=0.7"),
    ("gyroid --size 112 --kind label", "--labels=1", ""),
    ("torus --size 96 --noise 40", "--iso=100", ""),
]
# For each group of stages: whether its cost depends on the number of nodes, of faces and of
# vertices (1: yes, 0: no).
GROUPS = {"fields": (1, 1, 0), "particles": (1, 0, 1), "triangles": (1, 0, 1)}


def measured(command: list[str]) -> tuple[float, int]:
    """Returns the processor seconds and the peak memory (bytes) of a program.

    Exit code 1 (a failed check) is accepted.
    """
    with subprocess.Popen([str(word) for word in command], stdout=subprocess.DEVNULL) as process:
        _, status, usage = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode not in (0, 1):
        raise SystemExit(f"{command}: exit code {process.returncode}")
    return usage.ru_utime + usage.ru_stime, usage.ru_maxrss * 1024


def predicted(binaries: Path, volume: Path, option: str) -> dict:
    """Returns the JSON of `isoparticles-volume info` for one object of a volume."""
    told = subprocess.run(
        [binaries / "isoparticles-volume", "info", volume, "--json", "-", "-q", option], check=True, capture_output=True
    )
    return json.loads(told.stdout)


def run(binaries: Path, folder: Path, volume: Path, option: str, sizes: str) -> tuple[dict, dict[str, list[float]]]:
    """Returns the prediction and the nodes, faces, vertices, seconds and bytes of each group."""
    f, s, seeds, p, mesh = (folder / name for name in ("f.vti", "s.vti", "seeds.bin", "p.bin", "m.vtp"))
    report = folder / "r.json"
    info = predicted(binaries, volume, option)
    area = info["objects"][0]["cost"]["area"]
    spacing = np.array(info["spacing"])
    nodes = float(np.prod(np.array(info["size"]) + 10))
    faces = 1.5 * area / np.prod(spacing) ** (2 / 3)
    ends = ["--force", "-q"]
    steps = {
        "fields": [
            [binaries / "distfield", volume, "-o", f, option, *ends],
            [binaries / "sizefield", f, "-o", s, *sizes.split(), *ends],
            [binaries / "seed", f, s, "-o", seeds, *ends],
        ],
        "particles": [
            [binaries / "particles", seeds, "--distfield", f, "--sizefield", s, "-o", p, "--backend", "cpu", *ends]
        ],
        "triangles": [
            [binaries / "reconstruct", p, "--distfield", f, "--sizefield", s, "-o", mesh, "--report", report, *ends]
        ],
    }
    found = {}
    for group, commands in steps.items():
        results = [measured(command) for command in commands]
        found[group] = [sum(seconds for seconds, _ in results), max(memory for _, memory in results)]
    vertices = json.loads(report.read_text())["results"]["check"]["vertices"]
    return info, {group: [nodes, faces, vertices, *values] for group, values in found.items()}


def row(binaries: Path, volume: Path, option: str) -> str:
    """Returns a table row of predicted and measured values for one object of a volume."""
    with tempfile.TemporaryDirectory() as folder:
        info, found = run(binaries, Path(folder), volume, option, "")
    cost = info["objects"][0]["cost"]
    columns = [f"{cost['vertices']:,} ({found['fields'][2]:,.0f})"]
    for stage in cost["stages"]:
        if stage["stage"] in found:
            *_, seconds, memory = found[stage["stage"]]
            columns += [
                f"{stage['seconds']:.1f} ({seconds:.1f})",
                f"{stage['bytes'] / 2**20:,.0f} ({memory / 2**20:,.0f})",
            ]
    return f"| `{volume.name.partition('.')[0]}` | `{option}` | " + " | ".join(columns) + " |"


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--bin", type=Path, default=Path("target/release"))
    parser.add_argument("--volumes", nargs="*", default=[], metavar="VOLUME;OPTION")
    arguments = parser.parse_args()
    binaries = arguments.bin
    for volume, _, option in (text.partition(";") for text in arguments.volumes):
        print(row(binaries, Path(volume), option), flush=True)
    if arguments.volumes:
        return
    rows: dict[str, list[list[float]]] = {group: [] for group in GROUPS}
    with tempfile.TemporaryDirectory() as folder:
        for phantom, option, sizes in PHANTOMS:
            volume = Path(folder) / "v.nrrd"
            subprocess.run([binaries / "phantom", *phantom.split(), "-o", volume, "--force"], check=True)
            for group, values in run(binaries, Path(folder), volume, option, sizes)[1].items():
                rows[group].append(values)
                nodes, faces, vertices, seconds, memory = values
                print(
                    f"{phantom:34} {group:10} {nodes:11,.0f} {faces:11,.0f} {vertices:9,.0f} {seconds:8.2f} s {memory / 2**20:7.0f} MiB",
                    flush=True,
                )
    for group, used in GROUPS.items():
        table = np.array(rows[group])
        counts = table[:, :3] * np.array(used)
        seconds, memory = table[:, 3], table[:, 4]
        columns = [n for n in range(3) if used[n]]
        time = np.linalg.lstsq(counts[:, columns] / seconds[:, None], np.ones(len(seconds)), rcond=None)[0]
        with_base = np.column_stack([np.ones(len(memory)), counts[:, columns]])
        space = np.linalg.lstsq(with_base / memory[:, None], np.ones(len(memory)), rcond=None)[0]
        off = counts[:, columns] @ time / seconds, with_base @ space / memory
        print(f"{group}: seconds a million {np.round(1e6 * time, 2)}, bytes {np.round(space, 1)}")
        print(f"  predicted over measured: time {np.round(off[0], 2)}, memory {np.round(off[1], 2)}")


if __name__ == "__main__":
    main()
