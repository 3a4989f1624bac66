"""Applies random updates to a mesh, one after the other, and checks the mesh after each.

    python random_updates.py VOLUME --labels 1 --vertices 20000 --count 200

Prints the time and the outcome of each update. Fails if a check fails, if a vertex outside the rim
moves, or if the same updates give a different final mesh when they are repeated on the first mesh.
"""

from __future__ import annotations

import argparse
import sys
import time

import numpy as np

import isoparticles as iso

DELTA = 0.4
"""Default slope of h around a region."""
RIM = 4
"""Width of the rim around the places with another h, in edges: one more than in `update.rs`."""


def region(mesh: iso.Mesh, random: np.random.Generator) -> tuple[str, np.ndarray, float]:
    """Return a random ball at a vertex, its centre, and how far from it the mesh may change."""
    vertices, sizes = mesh.result.vertices, mesh.result.point_arrays["h"]
    at = int(random.integers(len(vertices)))
    centre, h = vertices[at], sizes[at]
    radius, size = h * random.uniform(2, 8), h * 2 ** random.uniform(-1.3, 1.0)
    text = "ball:" + ",".join(map(str, [*centre, radius])) + f"={size}"
    # outside the ball, h changes only where it exceeds `size` + DELTA * distance
    near = np.linalg.norm(vertices - centre, axis=1) < radius + 4 * sizes.max()
    highest = sizes[near].max()
    return text, centre, radius + max(0.0, highest - size) / DELTA + RIM * max(highest, size)


def main() -> int:
    """Run the updates."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("volume")
    parser.add_argument("--labels", required=True)
    parser.add_argument("--vertices", type=int, default=20_000)
    parser.add_argument("--count", type=int, default=200)
    parser.add_argument("--seed", type=int, default=1)
    given = parser.parse_args()
    random = np.random.default_rng(given.seed)
    first = mesh = iso.mesh(given.volume, labels=given.labels, vertices=given.vertices, backend="cpu")
    print(len(mesh.result.vertices), "vertices;", mesh.failed_checks or "no failed checks")
    regions, seconds, failed = [], [], 0
    for count in range(given.count):
        text, centre, reach = region(mesh, random)
        start = time.perf_counter()
        after = mesh.update(text)
        seconds.append(time.perf_counter() - start)
        regions.append(text)
        before, now = ({tuple(p) for p in m.result.vertices} for m in (mesh, after))
        moved = np.array([*(before ^ now)]).reshape(-1, 3)
        farthest = np.linalg.norm(moved - centre, axis=1).max(initial=0.0)
        quality = after.report.quality
        faults = [*after.failed_checks, *(["moved outside the rim"] if farthest > reach else [])]
        failed += bool(faults)
        told = f"{len(now)} vertices, minimum ratio {quality.radius_ratio_min:.3f}, {seconds[-1]:.2f} s"
        print(f"{count + 1}: {text}: {told}", "; ".join(faults), flush=True)
        mesh = after
    again = first.update(*regions)
    same = np.array_equal(again.result.vertices, mesh.result.vertices)
    same &= np.array_equal(again.result.triangles, mesh.result.triangles)
    print(
        f"median {np.median(seconds):.2f} s, maximum {max(seconds):.2f} s; {failed} failed; replay is the same: {same}"
    )
    return int(bool(failed) or not same)


if __name__ == "__main__":
    sys.exit(main())
