"""Applies random updates to a mesh, one after the other, and checks the mesh after each.

    python random_updates.py VOLUME --labels 1 --vertices 20000 --count 200
    python random_updates.py VOLUME --materials all --vertices 20000 --count 200

Prints the time and the outcome of each update. At the end, the same updates are repeated on the
first mesh, and a mesh is made from scratch with all of them in the size field. Fails if a check
fails, if a vertex outside the rim moves, or if the repetition gives another mesh.
"""

from __future__ import annotations

import argparse
import sys
import time

import numpy as np

import isoparticles as iso

DELTA = 0.4
"""Default slope of h around a region."""
RIM = 3
"""Number of rings of vertices around the places with another h that may move (`part.rs`)."""


def region(mesh: iso.Mesh, random: np.random.Generator) -> tuple[str, np.ndarray, float]:
    """Return a random ball at a vertex, its centre, and how far from it the mesh may change."""
    vertices, sizes = mesh.result.vertices, mesh.result.point_arrays["h"]
    at = int(random.integers(len(vertices)))
    centre, h = vertices[at], sizes[at]
    radius, size = h * random.uniform(2, 8), h * 2 ** random.uniform(-1.3, 1.0)
    text = "ball:" + ",".join(map(str, [*centre, radius])) + f"={size}"
    # outside the ball, h changes only where it exceeds `size` + DELTA * distance
    near = np.linalg.norm(vertices - centre, axis=1) < radius + 4 * sizes.max()
    corners = vertices[mesh.result.triangles[near[mesh.result.triangles].any(axis=1)]]
    longest = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max()
    # a vertex of the last ring may move towards the next ring
    return text, centre, radius + max(0.0, sizes[near].max() - size) / DELTA + (RIM + 1) * longest


def from_scratch(first: iso.Mesh, vertices: int, regions: list[str]) -> iso.Surface:
    """Return the surface of a run with all regions in the size field."""
    size = iso.size_field(first.field, vertices=vertices, resize=regions)
    seeds = iso.seed(first.field, size)
    particles = iso.settle(seeds, first.field, size, backend="cpu")
    return iso.reconstruct(particles, first.field, size, accept_forced=True)


def main() -> int:
    """Run the updates."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("volume")
    kind = parser.add_mutually_exclusive_group(required=True)
    kind.add_argument("--labels")
    kind.add_argument("--materials")
    parser.add_argument("--vertices", type=int, default=20_000)
    parser.add_argument("--count", type=int, default=200)
    parser.add_argument("--seed", type=int, default=1)
    given = parser.parse_args()
    random = np.random.default_rng(given.seed)
    options = {"labels": given.labels, "materials": given.materials, "vertices": given.vertices}
    first = mesh = iso.mesh(given.volume, **options, backend="cpu", accept_losses=True, accept_forced=True)
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
    scratch = from_scratch(first, given.vertices, regions)
    print(
        f"median {np.median(seconds):.2f} s, maximum {max(seconds):.2f} s; {failed} failed; replay is the same: {same}; "
        f"from scratch: {len(scratch.vertices)} vertices, {scratch.failed_checks or 'no failed checks'}"
    )
    return int(bool(failed) or not same or bool(scratch.failed_checks))


if __name__ == "__main__":
    sys.exit(main())
