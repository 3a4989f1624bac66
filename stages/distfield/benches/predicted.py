"""Compares the vertex counts that `isoparticles-volume info` predicts with those of real meshes.

    python stages/distfield/benches/predicted.py [--bin target/release] [--data ../shared/data]

The vertex counts of the meshes were measured with the method restricted (2026-11-22); newer counts
are in docs/developer/performance.md, "Surfaces of both methods". The last two lines give the
factors by which GRADATION_LABELS and GRADATION_SCAN in common/survey/src/cost.rs must be multiplied
to make the mean log ratio zero.
"""

import argparse
import json
import math
import subprocess
import time
from pathlib import Path

# Each entry contains the volume, the option that selects the object, and the vertex count of the
# mesh.
CASES = [
    ("mickey_labels", "--labels=2", 1206),
    ("heart_label", "--labels=1", 55317),
    ("thorax_labels", "--labels=2", 99971),
    ("thorax_labels", "--labels=1", 292405),
    ("tooth_ct", "--iso=600", 55036),
    ("tooth_ct", "--iso=1000", 32644),
    ("brain_parcellation", "--labels=5..208", 568083),
    ("frog_tissue_labels", "--labels=13", 510599),
    ("lungs_label_big", "--labels=2", 241548),
    ("lungs_label_big", "--labels=3", 237513),
    ("thorax_ct", "--iso=200", 448477),
    ("trabecular_bone", "--iso=110", 887512),
    ("heart_ct", "--iso=250", 460494),
    ("thorax_ct_native_u8", "--iso=150", 2787973),
]


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--bin", type=Path, default=Path("target/release"))
    parser.add_argument("--data", type=Path, default=Path("../shared/data"))
    arguments = parser.parse_args()
    print("| volume | option | predicted | between | made | predicted / made | seconds |")
    print("|---|---|---|---|---|---|---|")
    ratios: dict[str, list[float]] = {"labels": [], "scan": []}
    for name, option, made in CASES:
        volume = arguments.data / f"{name}.nrrd"
        started = time.monotonic()
        command = [arguments.bin / "isoparticles-volume", "info", volume, "--json", "-", "-q", option]
        info = json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout)
        seconds = time.monotonic() - started
        cost = info["objects"][0]["cost"]
        predicted = cost["vertices"]
        low, high = cost["vertices_range"]
        ratios[info["kind"]].append(math.log(made / predicted))
        print(f"| `{name}` | `{option}` | {predicted:,} | {low:,} to {high:,} | {made:,} | {predicted / made:.2f} | {seconds:.1f} |")
    # the first case has too few vertices for a meaningful ratio
    del ratios["labels"][0]
    for kind, logs in ratios.items():
        mean = sum(logs) / len(logs)
        print(f"{kind}: multiply by {math.exp(mean):.3f}, largest factor then {math.exp(max(abs(log - mean) for log in logs)):.2f}")


if __name__ == "__main__":
    main()
