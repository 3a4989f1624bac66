#!/usr/bin/env python3
"""Compares distfield with scikit-fmm and SimpleITK: error, time and memory on the same inputs.

Prints a markdown table.

    python -m venv VENV && VENV/bin/pip install -r stages/distfield/benches/requirements.txt
    VENV/bin/python stages/distfield/benches/compare.py [--bin target/release] [--size 128]
        [--threads 2]

The objects are a ball and a torus with known distances, each as a scalar volume (with a blurred
edge, as in a scan) and as binary labels. Each method runs in its own process. Times exclude
reading and writing. Memory is the peak memory of the process.

Errors are in voxels, relative to the exact distance: the root-mean-square error of the zero set
(interpolated linearly along grid edges), the root-mean-square and maximum error of F within 2.5
voxels of the surface, and the maximum error of F anywhere. AntiAliasBinary computes distances in
only three layers, so its last error is not meaningful. SignedMaurer treats the centres of the
object's boundary voxels as the surface.
"""

import argparse
import json
import os
import re
import subprocess
import sys
import tempfile
import time

import numpy as np

EDGE = 2.0  # half-width in voxels of the blurred edge of scalar volumes
BAND = 2.5  # half-width in voxels of the band around the surface


def truth(shape, size):
    """Returns the signed distance in voxels, negative inside, as an array of shape (z, y, x)."""
    z, y, x = np.meshgrid(*[np.arange(size, dtype=np.float64)] * 3, indexing="ij")
    centre = 0.5 * (size - 1) + np.array([0.137, 0.291, -0.173])
    x, y, z = x - centre[0], y - centre[1], z - centre[2]
    if shape == "ball":
        return np.sqrt(x**2 + y**2 + z**2) - 0.3 * size
    return np.hypot(np.hypot(x, y) - 0.28 * size, z) - 0.12 * size


def values(kind, distance):
    """Returns the input volume for all methods. The object is the region above 0.5."""
    if kind == "labels":
        return (distance < 0).astype(np.uint8)
    return (0.5 * (1 - np.tanh(distance / EDGE))).astype(np.float32)


def write_nrrd(path, volume):
    kind = {"float32": "float", "uint8": "uint8"}[volume.dtype.name]
    sizes = " ".join(str(n) for n in volume.shape[::-1])
    header = f"NRRD0004\ntype: {kind}\ndimension: 3\nsizes: {sizes}\nspacings: 1 1 1\nendian: little\nencoding: raw\n\n"
    with open(path, "wb") as file:
        file.write(header.encode() + volume.tobytes())


def read_vti(path):
    """Returns the distances in a distfield file, shape (z, y, x), including the margin."""
    with open(path, "rb") as file:
        data = file.read()
    start = data.index(b"<AppendedData")
    header = data[:start].decode()
    array = re.search(r'<DataArray[^>]*Name="signed_distance"[^>]*>', header).group(0)
    at = data.index(b"_", start) + 1 + int(re.search(r'offset="(\d+)"', array).group(1))
    width = 8 if 'header_type="UInt64"' in header else 4
    count = int.from_bytes(data[at : at + width], "little") // 4
    extent = [int(n) for n in re.search(r'WholeExtent="([^"]+)"', header).group(1).split()]
    shape = (extent[5] + 1, extent[3] + 1, extent[1] + 1)
    return np.frombuffer(data, "<f4", count, at + width).reshape(shape)


def compute(method, volume, threads):
    """Returns the signed distance (voxels) computed by another library, and the time in seconds."""
    if method == "scikit-fmm":
        import skfmm

        start = time.perf_counter()
        # the surface is where the value is 0.5: in the middle of a blurred edge, or on the face
        # between two voxels of values 0 and 1
        return skfmm.distance(0.5 - volume.astype(np.float64), dx=1.0), time.perf_counter() - start
    import SimpleITK as sitk

    sitk.ProcessObject.SetGlobalDefaultNumberOfThreads(threads)
    image = sitk.GetImageFromArray((volume > 0.5).astype(np.uint8))
    start = time.perf_counter()
    if method == "SignedMaurer":
        result = sitk.SignedMaurerDistanceMap(image, insideIsPositive=False, squaredDistance=False, useImageSpacing=True)
    else:
        result = -1 * sitk.AntiAliasBinary(image, maximumRMSError=0.01, numberOfIterations=200)
    return sitk.GetArrayFromImage(result), time.perf_counter() - start


def errors(field, distance):
    """Returns errors in voxels: zero set (rms), F in the band (rms, maximum), F (maximum)."""
    squares, count = 0.0, 0
    for axis in range(3):
        low, high = [np.moveaxis(field, axis, 0)[s] for s in (slice(None, -1), slice(1, None))]
        low_d, high_d = [np.moveaxis(distance, axis, 0)[s] for s in (slice(None, -1), slice(1, None))]
        crossed = (low < 0) != (high < 0)
        # both fields are nearly linear along an edge
        share = low[crossed] / (low[crossed] - high[crossed])
        off = low_d[crossed] + share * (high_d[crossed] - low_d[crossed])
        squares, count = squares + np.sum(off**2), count + off.size
    error = np.abs(field - distance)
    band = error[np.abs(distance) < BAND]
    return [np.sqrt(squares / count), np.sqrt(np.mean(band**2)), band.max(), error.max()]


def peak_memory():
    """Returns the peak memory of this process in bytes (Linux), as distfield reports it."""
    with open("/proc/self/status") as file:
        return 1024 * int(re.search(r"VmHWM:\s+(\d+)", file.read()).group(1))


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--bin", default="target/release", help="folder of the stage programs")
    parser.add_argument("--size", type=int, default=128, help="voxels along each axis")
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--method", nargs=3, metavar=("NAME", "IN", "OUT"), help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.method:
        name, source, target = options.method
        field, seconds = compute(name, np.load(source), options.threads)
        np.savez(target, field=field, seconds=seconds, memory=peak_memory())
        return
    print(f"{options.size}^3 voxels, {options.threads} threads\n")
    print("| object | method | zero set, rms | band, rms | band, largest | anywhere, largest | time, s | memory, MiB |")
    print("|---|---|---|---|---|---|---|---|")
    with tempfile.TemporaryDirectory() as folder:
        path = lambda name: os.path.join(folder, name)  # noqa: E731
        for shape in ("ball", "torus"):
            distance = truth(shape, options.size)
            for kind in ("scalar", "labels"):
                volume = values(kind, distance)
                write_nrrd(path("in.nrrd"), volume)
                np.save(path("in.npy"), volume)
                methods = ["distfield", "scikit-fmm", "SignedMaurer"]
                for method in methods + (["AntiAliasBinary"] if kind == "labels" else []):
                    if method == "distfield":
                        object_ = ["--iso", "0.5"] if kind == "scalar" else ["--labels", "1"]
                        command = [os.path.join(options.bin, "distfield"), path("in.nrrd"), "-o", path("f.vti"), *object_]
                        command += ["--force", "-q", "--threads", str(options.threads), "--report", path("r.json")]
                        subprocess.run(command, check=True)
                        with open(path("r.json")) as file:
                            report = json.load(file)
                        memory = report["peak_memory_bytes"]
                        seconds = sum(s["seconds"] for s in report["steps"] if s["name"] not in ("read", "write"))
                        field = read_vti(path("f.vti"))
                        margin = (field.shape[0] - options.size) // 2
                        field = field[margin:-margin, margin:-margin, margin:-margin]
                    else:
                        again = [sys.executable, __file__, "--threads", str(options.threads), "--method", method]
                        subprocess.run([*again, path("in.npy"), path("out.npz")], check=True)
                        with np.load(path("out.npz")) as out:
                            field, seconds, memory = out["field"], float(out["seconds"]), int(out["memory"])
                    found = errors(field.astype(np.float64), distance)
                    row = [f"{shape}, {kind}", method, *(f"{e:.4f}" for e in found), f"{seconds:.2f}", f"{memory / 2**20:.0f}"]
                    print("| " + " | ".join(row) + " |", flush=True)


if __name__ == "__main__":
    main()
