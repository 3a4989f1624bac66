"""Write the fixtures of the format tests and the values and positions that other programs read.

    pip install numpy pydicom pynrrd SimpleITK nibabel pyvista tifffile imagecodecs scikit-image
    UNU=/usr/bin/teem-unu python make_fixtures.py [NAME ...]

NAME is nrrd, nifti, analyze, mgh, npy, tiff, vti, meta, segmentation, dicom or edited; the default
is all of them.

Every file contains 3 x 4 x 2 voxels whose values encode their index. For each file,
`expected.json` contains what another program (SimpleITK, nibabel, tifffile, VTK or unu) reads: the
type, the values, and the world positions of the first voxel and of the last voxel along each axis
(in LPS if the file specifies an anatomical space). `spacing` is what the test gives for files
without a spacing. Files that must be refused are listed with an
expected part of the error message.
"""

import gzip
import json
import os
import struct
import subprocess
import sys
from pathlib import Path

import nibabel
import nrrd
import numpy as np
import pydicom
import pyvista
import SimpleITK as sitk
import skimage.io
import tifffile
import vtk
from PIL import Image

HERE = Path(__file__).parent
STAGE = HERE.parents[2] / "stage" / "tests" / "data"
UNU = os.environ.get("UNU", "teem-unu")
SIZE = (3, 4, 2)
CORNERS = [(0, 0, 0), (2, 0, 0), (0, 3, 0), (0, 0, 1)]
NAMES = ["int8", "uint8", "int16", "uint16", "int32", "uint32", "int64", "uint64", "float32", "float64"]
expected = {"volumes": {}, "refused": {}}


def voxels(name):
    """Return an array indexed [x, y, z] whose values depend on the voxel number (x fastest)."""
    index = np.arange(24)
    values = {
        "int8": index - 12, "uint8": index + 200, "int16": (index - 12) * 1000, "uint16": index + 65000,
        "int32": (index - 12) * 10**8, "uint32": index + 4 * 10**9, "int64": (index - 12) * 2**40,
        "uint64": index.astype(np.uint64) + np.uint64(2**63), "float32": index / 4 - 3, "float64": index / 7 - 1e10,
    }[name]
    return values.astype(name).reshape(SIZE, order="F")


def expect(file, array, positions, teller):
    expected["volumes"][file] = {
        "type": str(array.dtype), "values": [str(v) for v in array.flatten(order="F").tolist()],
        "positions": [[float(x) for x in p] for p in positions], "told_by": teller,
    }


def by_itk(file, name=None, check_values=True):
    """Record what SimpleITK reads from a file."""
    image = sitk.ReadImage(str(HERE / file))
    if image.GetDimension() == 4:
        image = image[:, :, :, 0]
    array = sitk.GetArrayFromImage(image).transpose(2, 1, 0)
    if check_values:
        assert np.array_equal(array, voxels(name)), file
    expect(file, array, [image.TransformIndexToPhysicalPoint(c) for c in CORNERS], "SimpleITK")


def by_unu(file, name, positions):
    """Record what Teem reads from a file. unu prints no positions, so the caller passes them."""
    out = subprocess.run([UNU, "save", "-f", "nrrd", "-e", "raw", "-en", "little", "-i", file, "-o", "-"],
                         cwd=HERE, check=True, capture_output=True).stdout
    array = np.frombuffer(out.split(b"\n\n", 1)[1], dtype=name).reshape(SIZE, order="F")
    assert np.array_equal(array, voxels(name)), file
    expect(file, array, positions, "unu")


def affine_positions(steps, origin):
    return [np.array(origin) + np.array(steps).T @ np.array(c) for c in CORNERS]


UNIT = affine_positions(np.eye(3), [0, 0, 0])
TURN = np.array([[0.36, 0.48, -0.8], [-0.8, 0.6, 0.0], [0.48, 0.64, 0.6]])  # rows are orthonormal
OBLIQUE = TURN * np.array([[0.5], [1.25], [3.0]])


def make_nrrd():
    folder = HERE / "nrrd"
    folder.mkdir(exist_ok=True)
    lps = {"space": "left-posterior-superior", "space origin": [10.5, -20.25, 30.0], "kinds": ["domain"] * 3}
    for number, name in enumerate(NAMES):
        encoding = ["raw", "gzip", "bzip2"][number % 3]
        file = f"nrrd/type_{name}.nrrd"
        nrrd.write(str(HERE / file), voxels(name), {**lps, "space directions": OBLIQUE, "encoding": encoding})
        by_itk(file, name) if encoding != "bzip2" else expect(
            file, nrrd.read(str(HERE / file))[0], affine_positions(OBLIQUE, lps["space origin"]), "pynrrd")
    spaces = {"ras": "right-anterior-superior", "las": "LAS", "lps_left_handed": "LPS", "unnamed": None}
    for label, space in spaces.items():
        steps = OBLIQUE.copy()
        if label == "lps_left_handed":
            steps[2] *= -1
        header = {**lps, "space": space, "space directions": steps, "encoding": "gzip"}
        if space is None:
            del header["space"]
            header["space dimension"] = 3
        nrrd.write(str(folder / f"space_{label}.nrrd"), voxels("int16"), header)
        by_itk(f"nrrd/space_{label}.nrrd", "int16")
    image = sitk.GetImageFromArray(voxels("float32").transpose(2, 1, 0))
    image.SetSpacing([0.7, 0.7, 2.2])
    image.SetOrigin([-1.0, 2.0, 1e3])
    image.SetDirection(TURN.T.flatten())
    sitk.WriteImage(image, str(folder / "itk.nrrd"), True)
    by_itk("nrrd/itk.nrrd", "float32")

    plain = folder / "plain.nrrd"
    nrrd.write(str(plain), voxels("int16"), {"encoding": "raw"})
    for encoding, suffix in [("raw", "raw"), ("gzip", "raw.gz"), ("bzip2", "raw.bz2"), ("hex", "hex"), ("ascii", "txt")]:
        for order in ["big", "little"] if encoding in ("raw", "gzip", "hex") else ["little"]:
            name = f"unu_{encoding}_{order}.nrrd"
            subprocess.run([UNU, "save", "-f", "nrrd", "-e", encoding, "-en", order, "-i", "plain.nrrd", "-o", name],
                           cwd=folder, check=True)
            by_unu(f"nrrd/{name}", "int16", UNIT)
        name = f"unu_detached_{encoding}.nhdr"
        # Teem 1.12 swaps the bytes of ASCII values if a non-native byte order is requested, so
        # ASCII files are written as little-endian.
        order = "little" if encoding == "ascii" else "big"
        subprocess.run([UNU, "save", "-f", "nrrd", "-e", encoding, "-en", order, "-i", "plain.nrrd", "-o", name],
                       cwd=folder, check=True)
        by_unu(f"nrrd/{name}", "int16", UNIT)
    expect("nrrd/plain.nrrd", voxels("int16"), UNIT, "pynrrd")

    data = voxels("int16").astype("<i2").tobytes(order="F")
    start = "NRRD0005\n# by hand\ntype: short\ndimension: 3\nsizes: 3 4 2\nendian: little\nencoding: raw\n"
    keys = "kinds: domain domain domain\nsample:=of a key: with = signs\n"

    def by_hand(name, header, body=b"", positions=UNIT):
        (folder / name).write_bytes(header.encode() + body)
        by_unu(f"nrrd/{name}", "int16", positions)

    (folder / "slice_08.raw").write_bytes(data[:24])
    (folder / "slice_09.raw").write_bytes(data[24:])
    (folder / "lines.dat").write_bytes(b"first line\nsecond line\nXYZ" + data)
    by_hand("list.nhdr", start + keys + "data file: LIST\nslice_08.raw\nslice_09.raw\n")
    by_hand("list_slabs.nhdr", start + "data file: LIST 3\nslice_08.raw\nslice_09.raw\n")
    by_hand("pattern.nhdr", start + "data file: slice_%02d.raw 8 9 1\n")
    by_hand("skips.nhdr", start + "line skip: 2\nbyte skip: 3\ndata file: lines.dat\n")
    by_hand("from_end.nhdr", start + "byte skip: -1\ndata file: lines.dat\n")
    by_hand("attached_skip.nrrd", start + keys + "byteskip: 5\n\n", b"12345" + data)
    by_hand("crlf.nrrd", start.replace("\n", "\r\n") + "\r\n", data)
    stepped = affine_positions(np.diag([0.5, 0.5, 2.0]), [0, 0, 0])
    by_hand("spacings.nrrd", start + "spacings: 0.5 0.5 2\n\n", data, stepped)
    by_hand("spacings_nan.nrrd", start + "spacings: nan nan nan\n\n", data)
    cell = affine_positions(np.diag([0.5, 0.5, 2.0]), [1.25, -1.75, 11.0])
    by_hand("mins_cell.nrrd", start + "spacings: 0.5 0.5 2\naxis mins: 1 -2 10\ncenters: cell cell cell\n\n", data, cell)
    node = affine_positions(np.diag([0.5, 0.5, 2.0]), [1.0, -2.0, 10.0])
    by_hand("mins_node.nrrd", start + "spacings: 0.5 0.5 2\naxis mins: 1 -2 10\ncenterings: node node node\n\n", data, node)
    for name in ["spacings.nrrd", "spacings_nan.nrrd", "mins_cell.nrrd", "mins_node.nrrd"]:
        by_hand_positions = expected["volumes"][f"nrrd/{name}"]["positions"]
        by_itk(f"nrrd/{name}", "int16")
        assert np.allclose(by_hand_positions, expected["volumes"][f"nrrd/{name}"]["positions"]), name
    four = "NRRD0005\ntype: short\ndimension: 4\nsizes: {}\nendian: little\nencoding: raw\nspace: LPS\n"
    directions = "space directions: {} (0.5,0,0) (0,0.5,0) (0,0,2)\nspace origin: (0,0,0)\n"
    by_hand("none_axis.nrrd", four.format("1 3 4 2") + "kinds: list domain domain domain\n" + directions.format("none")
            + "\n", data, stepped)
    refuse(folder, "colour.nrrd", four.format("2 3 4 1") + "kinds: vector domain domain domain\n"
           + directions.format("none") + "\n", data, "more than one value")
    refuse(folder, "time.nrrd", four.format("3 2 2 2").replace("space: LPS\n", "")
           + "kinds: domain domain domain time\n\n", data, "sequence")
    refuse(folder, "flat.nrrd", start.replace("3 4 2", "6 4 1") + "\n", data, "flat")
    refuse(folder, "two_axes.nrrd", start.replace("3 4 2", "6 4").replace("dimension: 3", "dimension: 2") + "\n", data,
           "2 spatial axes")
    refuse(folder, "short.nrrd", start + "\n", data[:-1], "truncated")
    refuse(folder, "trailing.nrrd", start + "\n", data + b"x", "after the last voxel")
    refuse(folder, "zero_spacing.nrrd", start + "spacings: 0.5 0 2\n\n", data, "spacing of axis 1 is 0")
    refuse(folder, "negative_spacing.nrrd", start + "spacings: 0.5 -1 2\n\n", data, "spacing of axis 1 is -1")
    refuse(folder, "nan_spacing.nrrd", start + "spacings: 0.5 nan 2\n\n", data, "spacing of axis 1 is NaN")
    refuse(folder, "huge_spacing.nrrd", start + "spacings: 0.5 1e30 2\n\n", data, "spacing of axis 1")
    refuse(folder, "flat_directions.nrrd", start + "space: LPS\nspace directions: (1,0,0) (0,1,0) (1,1,0)\n\n", data,
           "coplanar")
    refuse(folder, "huge.nrrd", start.replace("3 4 2", "300000 300000 300000") + "\n", data, "declares")
    refuse(folder, "overflow.nrrd", start.replace("3 4 2", "9000000000 9000000000 9000000000") + "\n", data, "declares")
    refuse(folder, "zero_size.nrrd", start.replace("3 4 2", "3 0 2") + "\n", data, "zero")
    refuse(folder, "no_endian.nrrd", start.replace("endian: little\n", "") + "\n", data, "byte order")


def refuse(folder, name, header, body, word):
    (folder / name).write_bytes(header.encode() + body)
    expected["refused"][f"{folder.name}/{name}"] = word


def make_nifti():
    folder = HERE / "nifti"
    folder.mkdir(exist_ok=True)
    affine = np.eye(4)
    affine[:3, :3] = OBLIQUE.T
    affine[:3, 3] = [10.5, -20.25, 30.0]
    left = affine.copy()
    left[:3, 2] *= -1

    def save(file, name, affine, sform, qform, change=None, **options):
        data = options.get("data", voxels(name))
        image = nibabel.Nifti1Image(data, affine, dtype=name)
        image.set_sform(affine, code=sform)
        image.set_qform(affine, code=qform)
        if change:
            change(image)
        nibabel.save(image, str(folder / file))
        loaded = nibabel.load(str(folder / file))
        values = np.asarray(loaded.dataobj).reshape(SIZE, order="F")
        unit = {1: 1000.0, 3: 0.001}.get(int(loaded.header["xyzt_units"]) & 7, 1.0)
        to_lps = np.array([-1, -1, 1]) * unit
        positions = [(loaded.affine @ np.array([*c, 1]))[:3] * to_lps for c in CORNERS]
        expect(f"nifti/{file}", values, positions, "nibabel")
        image = sitk.ReadImage(str(folder / file))
        if image.GetDimension() == 3:
            itk = [image.TransformIndexToPhysicalPoint(c) for c in CORNERS]
            assert np.allclose(itk, positions, atol=1e-4), (file, itk, positions)

    save("sform.nii", "int16", affine, 1, 0)
    save("sform_left_handed.nii.gz", "float32", left, 2, 2)
    save("qform.nii.gz", "uint8", affine, 0, 1)
    save("qform_left_handed.nii", "int32", left, 0, 1)
    save("four_axes.nii.gz", "float64", affine, 1, 1, data=voxels("float64").reshape(*SIZE, 1))
    save("micrometres.nii", "uint16", affine, 1, 0, lambda image: image.header.set_xyzt_units("micron"))
    big = nibabel.Nifti1Image(voxels("int16"), affine, nibabel.Nifti1Header(endianness=">"), dtype="int16")
    nibabel.save(big, str(folder / "big_endian.nii"))
    by_itk("nifti/big_endian.nii", "int16")
    scaled = bytearray((folder / "sform.nii").read_bytes())
    scaled[112:120] = struct.pack("<ff", 0.5, -2.0)
    (folder / "scaled.nii.gz").write_bytes(gzip.compress(bytes(scaled), mtime=0))
    by_itk("nifti/scaled.nii.gz", check_values=False)
    # SimpleITK returns 64-bit numbers; this project converts scaled 16-bit integers to 32-bit
    # floating-point numbers.
    entry = expected["volumes"]["nifti/scaled.nii.gz"]
    assert entry["values"] == [str(float(v)) for v in (voxels("int16") * 0.5 - 2.0).flatten(order="F")]
    entry["type"] = "float32"
    image = nibabel.Nifti1Image(np.zeros((3, 4, 2, 5), "int16"), affine)
    nibabel.save(image, str(folder / "time.nii.gz"))
    expected["refused"]["nifti/time.nii.gz"] = "5 samples along axis 3"
    for file, kind in [("nifti2.nii", nibabel.Nifti2Image), ("nifti2_pair.hdr", nibabel.Nifti2Pair)]:
        nibabel.save(kind(voxels("int16"), affine), str(folder / file))
        by_nibabel(f"nifti/{file}", voxels("int16"))
    two = nibabel.Nifti2Image(voxels("float64"), left, nibabel.Nifti2Header(endianness=">"), dtype="float64")
    two.set_qform(left, code=1)
    two.set_sform(None, code=0)
    nibabel.save(two, str(folder / "nifti2_big.nii.gz"))
    by_nibabel("nifti/nifti2_big.nii.gz", voxels("float64"))
    rgb = np.zeros(SIZE, dtype=[("R", "u1"), ("G", "u1"), ("B", "u1")])
    nibabel.save(nibabel.Nifti1Image(rgb, affine), str(folder / "colour.nii"))
    expected["refused"]["nifti/colour.nii"] = "colours"
    whole = (folder / "sform.nii").read_bytes()
    (folder / "short.nii").write_bytes(whole[:-1])
    expected["refused"]["nifti/short.nii"] = "ends after"


def by_nibabel(file, values):
    """Record what nibabel reads from a file, in LPS."""
    image = nibabel.load(str(HERE / file))
    assert np.allclose(np.asarray(image.dataobj), values), file
    positions = [(image.affine @ np.array([*c, 1]))[:3] * [-1, -1, 1] for c in CORNERS]
    expect(file, values, positions, "nibabel")


def make_analyze():
    folder = HERE / "analyze"
    folder.mkdir(exist_ok=True)
    affine = np.diag([-0.5, 1.25, 3.0, 1.0])
    for file, kind, name in [("plain", nibabel.AnalyzeImage, "int16"), ("spm", nibabel.Spm99AnalyzeImage, "float32")]:
        nibabel.save(kind(voxels(name), affine), str(folder / f"{file}.img"))
        (folder / f"{file}.mat").unlink(missing_ok=True)
    # SPM counts voxels from 1
    header = bytearray((folder / "spm.hdr").read_bytes())
    header[253:259] = struct.pack("<hhh", 3, 1, 2)
    (folder / "spm.hdr").write_bytes(header)
    by_nibabel("analyze/plain.hdr", voxels("int16"))
    by_nibabel("analyze/spm.img", voxels("float32"))
    # ITK reads the same values and spacing, but assumes that y runs from anterior to posterior
    image = sitk.ReadImage(str(folder / "plain.hdr"))
    assert image.GetSpacing() == (0.5, 1.25, 3.0)
    assert np.array_equal(sitk.GetArrayFromImage(image).transpose(2, 1, 0), voxels("int16"))


def make_mgh():
    folder = HERE / "mgh"
    folder.mkdir(exist_ok=True)
    affine = np.eye(4)
    affine[:3, :3] = OBLIQUE.T
    affine[:3, 3] = [10.5, -20.25, 30.0]
    for name in ["uint8", "int16", "int32", "float32"]:
        file = f"mgh/type_{name}.{'mgz' if name in ('int16', 'float32') else 'mgh'}"
        nibabel.save(nibabel.MGHImage(voxels(name), affine), str(HERE / file))
        by_nibabel(file, voxels(name))
    nibabel.save(nibabel.MGHImage(np.zeros((3, 4, 2, 5), "float32"), affine), str(folder / "frames.mgz"))
    expected["refused"]["mgh/frames.mgz"] = "5 frames"
    (folder / "short.mgh").write_bytes((folder / "type_int32.mgh").read_bytes()[:300])
    expected["refused"]["mgh/short.mgh"] = "ends after 4 of 24 values"


def with_spacing(file, array, teller, spacing=(0.5, 1.25, 3.0), is_given=True):
    """Record an array that another program reads, with a spacing along its axes x, y, z in mm."""
    expect(file, array, affine_positions(np.diag(spacing), [0, 0, 0]), teller)
    if is_given:
        expected["volumes"][file]["spacing"] = list(spacing)


def make_npy():
    folder = HERE / "npy"
    folder.mkdir(exist_ok=True)
    for number, name in enumerate(NAMES):
        file = f"npy/type_{name}.npy"
        order = "FC"[number % 2]
        np.save(HERE / file, np.array(voxels(name), order=order))
        loaded = np.load(HERE / file)
        assert np.array_equal(loaded, voxels(name)) and loaded.flags[f"{order}_CONTIGUOUS"]
        with_spacing(file, loaded, "NumPy")
    np.save(folder / "big_endian.npy", voxels("int16").astype(">i2"))
    with_spacing("npy/big_endian.npy", np.load(folder / "big_endian.npy").astype("int16"), "NumPy")
    np.save(folder / "bool.npy", voxels("int16") > 2000)
    with_spacing("npy/bool.npy", np.load(folder / "bool.npy").astype("uint8"), "NumPy")
    with (folder / "version_2.npy").open("wb") as file:
        np.lib.format.write_array(file, voxels("uint8"), version=(2, 0))
    with_spacing("npy/version_2.npy", np.load(folder / "version_2.npy"), "NumPy")
    for file, array, word in [("complex", voxels("int16") * 1j, "<c16"), ("flat", voxels("int16")[0], "shape [4, 2]"),
                              ("half", voxels("int8").astype("float16"), "<f2"), ("spacing", voxels("int8"), "spacing")]:
        np.save(folder / f"no_{file}.npy", array)
        expected["refused"][f"npy/no_{file}.npy"] = word


def make_tiff():
    """Write stacks with tifffile, Pillow, scikit-image and ITK, all from arrays [z, y, x]."""
    folder = HERE / "tiff"
    folder.mkdir(exist_ok=True)

    def by_tifffile(file, **options):
        pages = tifffile.TiffFile(HERE / file).pages
        array = np.array([page.asarray() for page in pages]).transpose(2, 1, 0)
        array = array.astype("uint8") if array.dtype == bool else array
        with_spacing(file, array, "tifffile", **options)
        return array

    def write(file, array, given=True, spacing=(0.5, 1.25, 3.0), **options):
        options = {"photometric": "minisblack", **options}
        tifffile.imwrite(folder / file, array.transpose(2, 1, 0), **options)
        assert np.array_equal(by_tifffile(f"tiff/{file}", spacing=spacing, is_given=given), array), file

    for name in NAMES:
        write(f"type_{name}.tif", voxels(name), rowsperstrip=3)
    write("big_endian.tif", voxels("uint16"), byteorder=">")
    write("bigtiff.tif", voxels("int32"), bigtiff=True)
    write("bigtiff_big_endian.tif", voxels("float64"), bigtiff=True, byteorder=">", compression="zlib", predictor=3)
    for method in ["lzw", "zlib", "packbits"]:
        write(f"{method}.tif", voxels("uint8"), compression=method, rowsperstrip=2)
    for name in ["uint8", "int16", "uint32", "int64"]:
        write(f"differences_{name}.tif", voxels(name), compression="lzw", predictor=2)
    write("differences_big_endian.tif", voxels("uint16"), compression="zlib", predictor=2, byteorder=">")
    for name in ["float32", "float64"]:
        write(f"differences_{name}.tif", voxels(name), compression="zlib", predictor=3)
    write("tiles.tif", voxels("uint16"), tile=(16, 16), compression="zlib", predictor=2)
    write("tiles_float32.tif", voxels("float32"), tile=(16, 16), compression="lzw", predictor=3)
    write("white_is_zero.tif", voxels("uint8"), photometric="miniswhite")
    write("palette.tif", voxels("uint8"), photometric="palette", colormap=np.zeros((3, 256), "uint16"))
    bits = (voxels("uint8") > 210).astype("uint8")
    tifffile.imwrite(folder / "bits.tif", bits.transpose(2, 1, 0) == 1, photometric="minisblack")
    assert np.array_equal(by_tifffile("tiff/bits.tif"), bits)

    imagej = {"imagej": True, "resolution": (2, 0.8), "given": False}
    write("imagej.tif", voxels("uint16"), **imagej, metadata={"axes": "ZYX", "spacing": 3.0, "unit": "mm"})
    micro = {"axes": "ZYX", "spacing": 3.0, "unit": "\\u00B5m"}
    write("imagej_micro.tif", voxels("float32"), **imagej, spacing=(5e-4, 1.25e-3, 3e-3), metadata=micro)
    write("imagej_no_z.tif", voxels("uint8"), **imagej, spacing=(5e-4, 1.25e-3, 1e-3),
          metadata={"axes": "ZYX", "unit": "micron"})
    # a stack above 4 GB has one page, which is followed by the pixels of the others
    tifffile.imwrite(folder / "imagej_one_page.tif", voxels("uint16").transpose(2, 1, 0), photometric="minisblack",
                     imagej=True, truncate=True, resolution=(2, 0.8),
                     metadata={"axes": "ZYX", "spacing": 3.0, "unit": "mm"})
    series = tifffile.imread(folder / "imagej_one_page.tif").transpose(2, 1, 0)
    assert np.array_equal(series, voxels("uint16")) and len(tifffile.TiffFile(folder / "imagej_one_page.tif").pages) == 1
    with_spacing("tiff/imagej_one_page.tif", series, "tifffile", is_given=False)
    size = {f"PhysicalSize{axis}": length for axis, length in zip("XYZ", [0.5, 1.25, 3.0])}
    write("ome.ome.tif", voxels("uint8"), given=False, spacing=(5e-4, 1.25e-3, 3e-3), metadata={"axes": "ZYX", **size})
    units = {f"PhysicalSize{axis}Unit": "mm" for axis in "XYZ"}
    write("ome_mm.ome.tif", voxels("uint16"), given=False, metadata={"axes": "ZYX", **size, **units})
    write("resolution.tif", voxels("uint8"), resolution=(20, 8), resolutionunit="CENTIMETER")

    slices = [Image.fromarray(plane) for plane in voxels("uint8").transpose(2, 1, 0)]
    slices[0].save(folder / "pillow.tif", save_all=True, append_images=slices[1:], compression="tiff_lzw", dpi=(72, 72))
    assert np.array_equal(by_tifffile("tiff/pillow.tif"), voxels("uint8"))
    skimage.io.imsave(folder / "skimage.tif", voxels("float32").transpose(2, 1, 0), check_contrast=False,
                      photometric="minisblack")
    assert np.array_equal(by_tifffile("tiff/skimage.tif"), voxels("float32"))
    sitk.WriteImage(sitk.GetImageFromArray(voxels("int16").transpose(2, 1, 0)), str(folder / "itk.tif"), True)
    assert np.array_equal(by_tifffile("tiff/itk.tif"), voxels("int16"))
    natural = HERE / "tiff_slices"
    natural.mkdir(exist_ok=True)
    for number, plane in zip([2, 10], voxels("uint16").transpose(2, 1, 0)):
        tifffile.imwrite(natural / f"slice{number}.tif", plane, byteorder="<>"[number == 10])
    with_spacing("tiff_slices", voxels("uint16"), "tifffile")
    refuse_tiffs(folder)


def refuse_tiffs(folder):
    """Write TIFF files that are not volumes."""
    planes = voxels("uint16").transpose(2, 1, 0)

    def refused(file, word, array=planes, **options):
        tifffile.imwrite(folder / file, array, **{"photometric": "minisblack", **options})
        expected["refused"][f"tiff/{file}"] = word

    refused("no_colour.tif", "3 values per pixel", np.zeros((2, 4, 5, 3), "uint8"), photometric="rgb")
    refused("no_channels.tif", "2 channels", np.stack([planes] * 2, axis=1), imagej=True, metadata={"axes": "ZCYX"})
    refused("no_time.tif", "3 frames", np.stack([planes] * 3), imagej=True, metadata={"axes": "TZYX"})
    refused("no_ome_time.ome.tif", "3 time points", np.stack([planes] * 3), metadata={"axes": "TZYX"})
    refused("no_volumes.tif", "2 volumes", np.stack([planes] * 2))
    refused("no_pages.tif", "flat image of 3 x 4 pixels", planes[0])
    refused("no_half.tif", "floating-point numbers of 16 bits", planes.astype("float16"))
    refused("no_zstd.tif", "compressed with zstd", compression="zstd")
    refused("no_spacing.tif", "spacing")
    refused("no_z.tif", "0.5 x 1.25 mm), not along z", resolution=(20, 8), resolutionunit="CENTIMETER")
    whole = (folder / "lzw.tif").read_bytes()
    (folder / "no_end.tif").write_bytes(whole[:-20])
    expected["refused"]["tiff/no_end.tif"] = "damaged TIFF file"
    mixed = HERE / "tiff_mixed"
    mixed.mkdir(exist_ok=True)
    tifffile.imwrite(mixed / "a.tif", planes[0])
    tifffile.imwrite(mixed / "preview.tif", planes[0][:2])
    expected["refused"]["tiff_mixed"] = "3 x 2 pixels"


def make_vti():
    folder = HERE / "vti"
    folder.mkdir(exist_ok=True)

    def grid(name):
        image = pyvista.ImageData(dimensions=SIZE, spacing=(0.5, 1.25, 3.0), origin=(10.5, -20.25, 30.0))
        image.direction_matrix = TURN.T
        image.point_data[name] = voxels(name).flatten(order="F")
        image.set_active_scalars(name)
        return image

    def told(file, name):
        image = pyvista.read(str(folder / file))
        values = image.point_data[name]
        expect(f"vti/{file}", values.reshape(SIZE, order="F"), [image.points[image.FindPoint(
            image.points[c[0] + 3 * c[1] + 12 * c[2]])] for c in CORNERS], "VTK")

    grid("float32").save(str(folder / "pyvista.vti"))
    told("pyvista.vti", "float32")
    grid("int16").save(str(folder / "pyvista_ascii.vti"), binary=False)
    told("pyvista_ascii.vti", "int16")
    for mode in ["Ascii", "Binary", "Appended"]:
        for compressed in [False, True] if mode != "Ascii" else [False]:
            for order in ["Little", "Big"]:
                for raw in [False, True] if mode == "Appended" else [False]:
                    writer = vtk.vtkXMLImageDataWriter()
                    name = {"Ascii": "float64", "Binary": "uint16", "Appended": "int32"}[mode]
                    words = [mode.lower(), "zlib" if compressed else "plain", order.lower(), "raw" if raw else "text"]
                    file = "vtk_" + "_".join(words) + ".vti"
                    writer.SetFileName(str(folder / file))
                    writer.SetInputData(grid(name))
                    getattr(writer, f"SetDataModeTo{mode}")()
                    writer.SetCompressorTypeToZLib() if compressed else writer.SetCompressorTypeToNone()
                    getattr(writer, f"SetByteOrderTo{order}Endian")()
                    writer.SetEncodeAppendedData(not raw)
                    if order == "Big":
                        writer.SetHeaderTypeToUInt64()
                    else:
                        writer.SetHeaderTypeToUInt32()
                    # This block size splits the array into several blocks; the last one is shorter.
                    writer.SetBlockSize(40)
                    writer.Write()
                    told(file, name)


def make_meta():
    """Write MetaImage files with SimpleITK, and by hand the variants that it can only read."""
    folder = HERE / "meta"
    folder.mkdir(exist_ok=True)
    for name in NAMES:
        image = sitk.GetImageFromArray(voxels(name).transpose(2, 1, 0))
        image.SetSpacing([0.5, 1.25, 3.0])
        image.SetOrigin([10.5, -20.25, 30.0])
        image.SetDirection((TURN.T * ([1, 1, -1] if name == "int8" else 1)).flatten())
        file = f"meta/itk_{name}.{'mhd' if name == 'uint16' else 'mha'}"
        sitk.WriteImage(image, str(HERE / file), name in ("int16", "uint16", "float64"))
        by_itk(file, name)
    data = voxels("int16")
    little, big = (data.astype(order).tobytes(order="F") for order in ("<i2", ">i2"))
    grid = "ObjectType = Image\nNDims = 3\nDimSize = 3 4 2\nElementSpacing = 0.5 1.25 3\nOffset = 1 2 3\n"
    kind = "ElementType = MET_SHORT\n"
    (folder / "slice_08.raw").write_bytes(little[:24])
    (folder / "slice_09.raw").write_bytes(little[24:])
    (folder / "behind.raw").write_bytes(b"anything" + little)
    text = " ".join(map(str, data.flatten(order="F")))
    for name, content in {
        "list.mhd": grid + kind + "ElementDataFile = LIST\nslice_08.raw\nslice_09.raw\n",
        "pattern.mhd": grid + kind + "ElementDataFile = slice_%02d.raw 8 9 1\n",
        "from_end.mhd": grid + "HeaderSize = -1\n" + kind + "ElementDataFile = behind.raw\n",
        "big.mha": (grid + "BinaryData = True\nBinaryDataByteOrderMSB = True\n" + kind + "ElementDataFile = LOCAL\n").encode() + big,
        "text.mha": grid + "BinaryData = False\n" + kind + f"ElementDataFile = LOCAL\n{text}\n",
        "orientation.mha": (grid + "AnatomicalOrientation = LPI\nCenterOfRotation = 7 8 9\n" + kind
                            + "ElementDataFile = LOCAL\n").encode() + little,
    }.items():
        (folder / name).write_bytes(content if isinstance(content, bytes) else content.encode())
        by_itk(f"meta/{name}", "int16")
    refused = {
        "colour.mha": (grid + "ElementNumberOfChannels = 3\n" + kind, little * 3, "3 values per voxel"),
        "short.mha": (grid + kind, little[:-1], "truncated"),
        "trailing.mha": (grid + kind, little + b"x", "after the last voxel"),
        "flat.mha": ("NDims = 2\nDimSize = 3 4\n" + kind, little[:24], "2 dimensions"),
        "huge.mha": (grid.replace("3 4 2", "300000 300000 300000") + kind, little, "MiB of voxels"),
        "overflow.mha": (grid.replace("3 4 2", "9999999999 9999999999 9999999999") + kind, little, "declares"),
        "no_zlib.mha": (grid + "CompressedData = True\n" + kind, little, "does not match the header"),
        "array.mha": (grid + "ElementType = MET_SHORT_ARRAY\n", little, "MET_SHORT_ARRAY"),
        "zero_spacing.mha": (grid.replace("1.25", "0") + kind, little, "spacing"),
    }
    for name, (header, body, word) in refused.items():
        (folder / name).write_bytes((header + "ElementDataFile = LOCAL\n").encode() + body)
        expected["refused"][f"meta/{name}"] = word


def make_segmentation():
    """Write segmentations as 3D Slicer does: with one layer, and with two overlapping layers."""
    folder = HERE / "segmentation"
    folder.mkdir(exist_ok=True)
    labels = (np.arange(24) % 3).astype(np.uint8).reshape(SIZE, order="F")
    more = np.roll(labels, 5)
    lps = {"space": "left-posterior-superior", "space origin": [10.5, -20.25, 30.0], "encoding": "gzip"}
    segments = {
        "Segment0_ID": "Segment_1", "Segment0_Name": "left lung", "Segment0_LabelValue": "1", "Segment0_Layer": "0",
        "Segment1_ID": "Segment_2", "Segment1_Name": "heart (right)", "Segment1_LabelValue": "2", "Segment1_Layer": "0",
        "Segmentation_MasterRepresentation": "Binary labelmap",
    }
    nrrd.write(str(folder / "one_layer.seg.nrrd"), labels,
               {**lps, "space directions": OBLIQUE, "kinds": ["domain"] * 3, **segments})
    by_itk("segmentation/one_layer.seg.nrrd", check_values=False)
    vessel = {"Segment2_ID": "Segment_3", "Segment2_Name": "vessel", "Segment2_LabelValue": "1", "Segment2_Layer": "1"}
    nrrd.write(str(folder / "two_layers.seg.nrrd"), np.stack([labels, more]),
               {**lps, "space directions": np.vstack([[np.nan] * 3, OBLIQUE]), "kinds": ["list"] + ["domain"] * 3, **segments, **vessel})
    both = nrrd.read(str(folder / "two_layers.seg.nrrd"))[0]
    expect("segmentation/two_layers.seg.nrrd", both[0], affine_positions(OBLIQUE, lps["space origin"]), "pynrrd")
    nrrd.write(str(folder / "no_layer.seg.nrrd"), np.stack([labels, more]),
               {**lps, "space directions": np.vstack([[np.nan] * 3, OBLIQUE]), "kinds": ["list"] + ["domain"] * 3, **segments,
                **vessel, "Segment2_Layer": "7"})
    expected["refused"]["segmentation/no_layer.seg.nrrd"] = "layer 7 of 2"


def make_dicom():
    """Write two oblique slices, raw and RLE-compressed. The name of the upper slice sorts first."""
    for folder, compressed in [("dicom/oblique", False), ("dicom/rle", True)]:
        (HERE / folder).mkdir(parents=True, exist_ok=True)
        for n in range(2):
            ds = pydicom.Dataset()
            ds.file_meta = pydicom.dataset.FileMetaDataset()
            ds.file_meta.TransferSyntaxUID = pydicom.uid.ExplicitVRLittleEndian
            ds.SOPClassUID = ds.file_meta.MediaStorageSOPClassUID = pydicom.uid.CTImageStorage
            ds.SOPInstanceUID = ds.file_meta.MediaStorageSOPInstanceUID = f"1.2.826.0.1.3680043.8.498.1.{n + 1}"
            ds.StudyInstanceUID, ds.SeriesInstanceUID = "1.2.826.0.1.3680043.8.498.2", "1.2.826.0.1.3680043.8.498.3"
            ds.Modality, ds.SeriesDescription, ds.SeriesNumber, ds.InstanceNumber = "CT", "oblique", 3, n + 1
            ds.ImageOrientationPatient = [*TURN[0].tolist(), *TURN[1].tolist()]
            ds.ImagePositionPatient = (np.array([10.5, -20.25, 30.0]) + n * OBLIQUE[2]).round(10).tolist()
            ds.PixelSpacing = [1.25, 0.5]
            ds.SliceThickness = 3.0
            ds.RescaleSlope, ds.RescaleIntercept = 1, -1024
            slices = (np.arange(24) * 7 + 900).astype(np.uint16).reshape(SIZE, order="F")
            ds.SamplesPerPixel, ds.PhotometricInterpretation, ds.PixelRepresentation = 1, "MONOCHROME2", 0
            ds.Rows, ds.Columns, ds.BitsAllocated, ds.BitsStored, ds.HighBit = SIZE[1], SIZE[0], 16, 12, 11
            ds.PixelData = np.ascontiguousarray(slices[:, :, n].T).tobytes()
            if compressed:
                ds.compress(pydicom.uid.RLELossless)
            ds.save_as(HERE / folder / f"{'ba'[n]}.dcm", enforce_file_format=True)
        if compressed:  # SimpleITK does not decode such small slices
            told = [pydicom.dcmread(HERE / folder / f"{name}.dcm").pixel_array.T.astype(np.int16) - 1024 for name in "ba"]
            expect(folder, np.stack(told, axis=-1), affine_positions(OBLIQUE, [10.5, -20.25, 30.0]), "pydicom")
            continue
        names = sitk.ImageSeriesReader.GetGDCMSeriesFileNames(str(HERE / folder))
        image = sitk.ReadImage(names)
        array = sitk.GetArrayFromImage(image).transpose(2, 1, 0).astype(np.int16)
        assert array[0, 0, 0] == 900 - 1024, array
        expect(folder, array, [image.TransformIndexToPhysicalPoint(c) for c in CORNERS], "SimpleITK")


def make_edited():
    """Double the golden size field and save it with pyvista; open the golden surfaces with VTK."""
    folder = STAGE / "edited"
    folder.mkdir(exist_ok=True)
    steps = np.array([[0.36, 0.48, -0.8], [-0.8, 0.6, 0.0], [-0.48, -0.64, -0.6]]) * np.array([[0.5], [1.25], [3.0]])
    origin = [10.5, -20.25, 1 / 3]

    def opened():
        image = pyvista.read(str(STAGE / "golden" / "field_v1.sizefield.vti"))
        assert image.dimensions == SIZE and image.point_data["sizing"].dtype == np.float32
        values = (0.25 + np.arange(24, dtype=np.float32) / np.float32(7)).astype(np.float32)
        assert np.array_equal(image.point_data["sizing"], values)
        places = [image.points[c[0] + 3 * c[1] + 12 * c[2]] for c in CORNERS]
        assert np.allclose(places, affine_positions(steps, origin), atol=1e-6), places
        assert json.loads(image.field_data["geometry"][0])["space"] == "Lps"
        assert json.loads(image.field_data["history"][0])["parameters"]["note"] == "größer"
        image.point_data["sizing"] = image.point_data["sizing"] * np.float32(2)
        return image

    opened().save(str(folder / "edited.vti"))
    opened().save(str(folder / "edited_ascii.vti"), binary=False)
    # version 2 stores bytes instead of strings
    image = pyvista.read(str(STAGE / "golden" / "field_v2.sizefield.vti"))
    image.point_data["sizing"] = image.point_data["sizing"] * np.float32(2)
    image.save(str(folder / "edited_v2.vti"))
    image.save(str(folder / "edited_v2_ascii.vti"), binary=False)
    bare = opened()
    bare.field_data.clear()
    bare.save(str(folder / "edited_without_field_data.vti"))
    opened().extract_subset((0, 1, 0, 1, 0, 1)).save(str(folder / "resampled.vti"))
    for suffix, tolerance in [("vtp", 0), ("ply", 1e-6), ("stl", 1e-6), ("obj", 1e-6)]:
        mesh = pyvista.read(str(STAGE / "golden" / f"surface_v1.{suffix}"))
        corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1 / 3]])
        world = np.array(origin) + corners @ np.array([s / np.linalg.norm(s) for s in steps])
        assert mesh.n_cells == 4 and mesh.is_all_triangles, suffix
        for point in world:
            assert np.abs(mesh.points - point).max(axis=1).min() <= max(tolerance, 1e-14) * 30, (suffix, point)
        # The normals point outward, although the grid is left-handed.
        assert np.isclose(mesh.volume, 1 / 18, atol=1e-6), (suffix, mesh.volume)
        normals = mesh.compute_normals(consistent_normals=False, auto_orient_normals=False, point_normals=False)
        out = normals.cell_centers().points - mesh.points.mean(axis=0)
        assert (np.einsum("ij,ij->i", normals.cell_data["Normals"], out) > 0).all(), suffix
    mesh = pyvista.read(str(STAGE / "golden" / "surface_v1.vtp"))
    assert mesh.points.dtype == np.float64 and mesh.cell_data["component"].tolist() == [0, 0, 1, 1]
    assert json.loads(mesh.field_data["history"][0])["tool"] == "sizefield"


MAKERS = {"nrrd": make_nrrd, "nifti": make_nifti, "analyze": make_analyze, "mgh": make_mgh, "npy": make_npy,
          "tiff": make_tiff, "vti": make_vti, "meta": make_meta, "segmentation": make_segmentation,
          "dicom": make_dicom, "edited": make_edited}
wanted = sys.argv[1:] or list(MAKERS)
order = []
if sys.argv[1:]:
    expected = json.loads((HERE / "expected.json").read_text())
    order = [file for told in expected.values() for file in told]
    for told in expected.values():
        for file in [file for file in told if file.split("/")[0] in wanted]:
            del told[file]
for name in wanted:
    MAKERS[name]()
for kind, told in expected.items():
    # the order of existing entries is kept
    files = sorted(told, key=lambda file: order.index(file) if file in order else len(order))
    expected[kind] = {file: told[file] for file in files}
(HERE / "expected.json").write_text(json.dumps(expected, indent=1) + "\n")
print(len(expected["volumes"]), "volumes,", len(expected["refused"]), "to be refused,",
      sum(f.stat().st_size for f in HERE.rglob("*") if f.is_file()), "bytes in all")
