"""Write DICOM objects with highdicom, pydicom and rt-utils, and the values that these read.

    pip install highdicom pydicom pylibjpeg-openjpeg pyjpegls rt-utils
    python make_dicom_objects.py

The same scan, an ellipsoid of 7 x 6 x 5 oblique voxels, is written as a series of slices, as
multi-frame images, as segmentations and as contours. `expected.json` contains the voxels of each
file or segment, x fastest, and the world positions of the first voxel and of the next voxel along
each axis. Files that must be refused are listed with an expected part of the error message.
"""

import copy
import json
import shutil
from pathlib import Path

import highdicom as hd
import numpy as np
import pydicom
from pydicom.sr.codedict import codes
from pydicom.uid import generate_uid
from rt_utils import RTStructBuilder

HERE = Path(__file__).parent / "dicom_objects"
SIZE = (7, 6, 5)
SPACING = np.array([0.5, 1.25, 3.0])
TURN = np.array([[0.36, 0.48, -0.8], [-0.8, 0.6, 0.0], [0.48, 0.64, 0.6]])
STEPS = TURN * SPACING[:, None]
ORIGIN = np.array([10.5, -20.25, 30.0])
expected = {"volumes": {}, "segments": {}, "refused": {}}


def uid(name):
    return generate_uid(entropy_srcs=["isoparticles", name])


def ellipsoid(shift=0.0, radius=1.0):
    """Return a mask indexed [x, y, z]."""
    centre, half = np.array([3.0 + shift, 2.5, 2.0]), radius * np.array([2.4, 2.2, 1.6])
    index = np.stack(np.meshgrid(*map(np.arange, SIZE), indexing="ij"), axis=-1)
    return (((index - centre) / half) ** 2).sum(axis=-1) <= 1


def scan():
    """Return stored numbers indexed [x, y, z]."""
    return np.where(ellipsoid(), 1500, np.arange(np.prod(SIZE)).reshape(SIZE, order="F")).astype(np.uint16)


def slices(turn=TURN, name="scan"):
    datasets = []
    for n in range(SIZE[2]):
        ds = pydicom.Dataset()
        ds.file_meta = pydicom.dataset.FileMetaDataset()
        ds.file_meta.TransferSyntaxUID = pydicom.uid.ExplicitVRLittleEndian
        ds.SOPClassUID = ds.file_meta.MediaStorageSOPClassUID = pydicom.uid.CTImageStorage
        ds.SOPInstanceUID = ds.file_meta.MediaStorageSOPInstanceUID = uid(f"{name} {n}")
        ds.StudyInstanceUID, ds.SeriesInstanceUID = uid("study"), uid(name)
        ds.FrameOfReferenceUID = uid("frame of reference")
        ds.PatientID = ds.PatientName = ds.StudyID = ds.AccessionNumber = "1"
        ds.PatientBirthDate = ds.PatientSex = ds.StudyDate = ds.StudyTime = ds.ReferringPhysicianName = None
        ds.PositionReferenceIndicator = None
        ds.ContentDate, ds.ContentTime, ds.Manufacturer = "20260101", "000000", "isoparticles"
        ds.ImageType = ["ORIGINAL", "PRIMARY", "AXIAL"]
        ds.Modality, ds.SeriesDescription, ds.SeriesNumber, ds.InstanceNumber = "CT", name, 3, n + 1
        ds.AcquisitionNumber = 1
        ds.ImageOrientationPatient = [*turn[0].tolist(), *turn[1].tolist()]
        ds.ImagePositionPatient = (ORIGIN + n * SPACING[2] * turn[2]).round(8).tolist()
        ds.PixelSpacing, ds.SliceThickness = [SPACING[1], SPACING[0]], SPACING[2]
        ds.SpacingBetweenSlices = SPACING[2]
        ds.RescaleSlope, ds.RescaleIntercept = 1, -1024
        ds.SamplesPerPixel, ds.PhotometricInterpretation, ds.PixelRepresentation = 1, "MONOCHROME2", 0
        ds.Rows, ds.Columns, ds.BitsAllocated, ds.BitsStored, ds.HighBit = SIZE[1], SIZE[0], 16, 12, 11
        ds.PixelData = np.ascontiguousarray(scan()[:, :, n].T).tobytes()
        datasets.append(ds)
    return datasets


def save(ds, file):
    path = HERE / file
    path.parent.mkdir(parents=True, exist_ok=True)
    ds.save_as(path, enforce_file_format=True)
    return path


def told(array, affine=None, teller="highdicom"):
    """Describe an array indexed [x, y, z]. `affine` converts its indices to LPS."""
    affine = np.vstack([np.hstack([STEPS.T, ORIGIN[:, None]]), [0, 0, 0, 1]]) if affine is None else affine
    points = [affine @ [*corner, 1] for corner in [(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)]]
    return {
        "size": list(array.shape), "values": array.astype(float).flatten(order="F").tolist(),
        "positions": [point[:3].tolist() for point in points], "told_by": teller,
    }


def from_highdicom(volume):
    """Convert the indices of a highdicom volume, (slice, row, column), to (column, row, slice)."""
    affine = volume.affine[:, [2, 1, 0, 3]]
    return volume.array.transpose(2, 1, 0), affine


def group(ds, keyword, **values):
    item = pydicom.Dataset()
    for key, value in values.items():
        setattr(item, key, value)
    setattr(ds, keyword, [item])


def enhanced(times=1, slopes=None, array=None):
    """Return an enhanced CT image. Frames of several times alternate, the upper slices first."""
    array = scan() if array is None else array
    first = slices()[0]
    ds = copy.deepcopy(first)
    for keyword in ["ImagePositionPatient", "ImageOrientationPatient", "PixelSpacing", "SliceThickness",
                    "SpacingBetweenSlices", "RescaleSlope", "RescaleIntercept"]:
        delattr(ds, keyword)
    ds.SOPClassUID = ds.file_meta.MediaStorageSOPClassUID = pydicom.uid.EnhancedCTImageStorage
    ds.SOPInstanceUID = ds.file_meta.MediaStorageSOPInstanceUID = uid(f"enhanced {times} {slopes}")
    ds.SeriesInstanceUID, ds.SeriesDescription, ds.SeriesNumber = uid("enhanced"), "enhanced", 4
    organization = uid("organization")
    group(ds, "DimensionOrganizationSequence", DimensionOrganizationUID=organization)
    pointers = [pydicom.tag.Tag("TemporalPositionIndex"), pydicom.tag.Tag("InStackPositionNumber")]
    ds.DimensionIndexSequence = []
    for pointer in pointers:
        item = pydicom.Dataset()
        item.DimensionOrganizationUID, item.DimensionIndexPointer = organization, pointer
        item.FunctionalGroupPointer = pydicom.tag.Tag("FrameContentSequence")
        ds.DimensionIndexSequence.append(item)
    shared = pydicom.Dataset()
    group(shared, "PlaneOrientationSequence", ImageOrientationPatient=first.ImageOrientationPatient)
    group(shared, "PixelMeasuresSequence", PixelSpacing=first.PixelSpacing, SliceThickness=SPACING[2])
    ds.SharedFunctionalGroupsSequence = [shared]
    ds.PerFrameFunctionalGroupsSequence = []
    frames = []
    for n in reversed(range(array.shape[2])):
        for time in range(times):
            frame = pydicom.Dataset()
            group(frame, "FrameContentSequence", DimensionIndexValues=[time + 1, n + 1], StackID="1",
                  InStackPositionNumber=n + 1, TemporalPositionIndex=time + 1)
            group(frame, "PlanePositionSequence", ImagePositionPatient=(ORIGIN + n * STEPS[2]).round(8).tolist())
            slope = 1 if slopes is None else slopes[n]
            group(frame, "PixelValueTransformationSequence", RescaleIntercept=-1024, RescaleSlope=slope, RescaleType="HU")
            ds.PerFrameFunctionalGroupsSequence.append(frame)
            frames.append(array[:, :, n].T + time)
    ds.NumberOfFrames = len(frames)
    ds.Columns, ds.Rows = array.shape[:2]
    if array.dtype == np.int16:
        ds.PixelRepresentation, ds.BitsStored, ds.HighBit = 1, 16, 15
    ds.PixelData = np.ascontiguousarray(np.stack(frames)).tobytes()
    return ds


def make_images():
    hounsfield = scan().astype(float) - 1024
    for n, ds in enumerate(slices()):
        save(ds, f"series/{'cadbe'[n]}.dcm")
    expected["volumes"]["series"] = told(*from_highdicom(hd.get_volume_from_series(slices())))
    assert sorted(expected["volumes"]["series"]["values"]) == sorted(hounsfield.flatten().tolist())

    save(enhanced(), "enhanced.dcm")
    image = hd.imread(HERE / "enhanced.dcm")
    expected["volumes"]["enhanced.dcm"] = told(*from_highdicom(image.get_volume()))
    save(enhanced(slopes=[1, 2, 0.5, 1, 3]), "slopes.dcm")
    image = hd.imread(HERE / "slopes.dcm")
    expected["volumes"]["slopes.dcm"] = told(*from_highdicom(image.get_volume()))
    save(enhanced(times=2), "times.dcm")
    expected["refused"]["times.dcm"] = "contains 2 series"

    legacy = hd.legacy.LegacyConvertedEnhancedCTImage(slices(), uid("legacy"), 5, uid("legacy 1"), 1)
    save(legacy, "legacy.dcm")
    expected["volumes"]["legacy.dcm"] = told(*from_highdicom(hd.imread(HERE / "legacy.dcm").get_volume()))

    # OpenJPEG cannot compress smaller frames
    large = np.repeat(np.repeat(scan(), 6, axis=0), 6, axis=1)[:, :, :2]
    signed = (large.astype(int) * 40 - 30000).astype(np.int16)
    for name, syntax, array in [
        ("rle", pydicom.uid.RLELossless, None), ("jpeg2000", pydicom.uid.JPEG2000Lossless, large),
        ("jpeg2000_signed", pydicom.uid.JPEG2000Lossless, signed), ("jpeg_ls", pydicom.uid.JPEGLSLossless, None),
    ]:
        ds = enhanced(array=array)
        ds.compress(syntax, generate_instance_uid=False)
        save(ds, f"{name}.dcm")
        if name == "jpeg_ls":
            expected["refused"][f"{name}.dcm"] = "1.2.840.10008.1.2.4.80"
        else:
            volume = hd.imread(HERE / f"{name}.dcm").get_volume()
            expected["volumes"][f"{name}.dcm"] = told(*from_highdicom(volume))
    plain = enhanced()
    del plain.PerFrameFunctionalGroupsSequence
    save(plain, "no_positions.dcm")
    expected["refused"]["no_positions.dcm"] = "positions for 0"


def segmentation(name, masks, kind, source=None, **options):
    source = slices() if source is None else source
    names = ["lung", "tumour", "vessel"]
    descriptions = [
        hd.seg.SegmentDescription(n + 1, names[n], codes.SCT.Organ, codes.SCT.Organ, hd.seg.SegmentAlgorithmTypeValues.MANUAL)
        for n in range(len(masks))
    ]
    array = np.stack([mask.transpose(2, 1, 0) for mask in masks], axis=-1)
    seg = hd.seg.Segmentation(
        source, array, kind, descriptions, uid(f"series {name}"), 300, uid(name), 1, "isoparticles", "model", "1",
        "serial", **options)
    seg.SeriesDescription = name
    path = save(seg, f"{name}.dcm")
    read = hd.seg.segread(path)
    fractional = {"rescale_fractional": True} if kind == "FRACTIONAL" else {}
    volume = read.get_volume(combine_segments=False, skip_overlap_checks=True, **fractional)
    array = volume.array if kind == "FRACTIONAL" else volume.array > 0
    expected["segments"][f"{name}.dcm"] = {
        names[n]: {"number": n + 1, **told(array[..., n].transpose(2, 1, 0) >= 0.5, volume.affine[:, [2, 1, 0, 3]])}
        for n in range(len(masks))
    }
    return seg


def make_segmentations():
    lung, tumour, vessel = ellipsoid(), ellipsoid(1.0, 0.6), np.zeros(SIZE, bool)
    vessel[0, 0, 1] = vessel[6, 5, 3] = True
    segmentation("seg", [lung, tumour, vessel], "BINARY")
    segmentation("seg_whole", [lung], "BINARY", omit_empty_frames=False)
    # only slices 1 and 3 have frames
    segmentation("seg_sparse", [vessel], "BINARY")
    share = np.clip(1.4 - (lung.astype(float) + np.roll(lung, 1, 0)) / 2, 0, 1)
    segmentation("seg_fractional", [share, 1 - share], "FRACTIONAL", fractional_type="PROBABILITY", max_fractional_value=200)
    labels = [lung & ~vessel & ~tumour, tumour & ~vessel, vessel]
    segmentation("seg_labelmap", labels, "LABELMAP")
    twice = segmentation("seg_twice", [lung], "BINARY")
    del expected["segments"]["seg_twice.dcm"]
    positions = [item.PlanePositionSequence for item in twice.PerFrameFunctionalGroupsSequence]
    twice.PerFrameFunctionalGroupsSequence[1].PlanePositionSequence = positions[0]
    save(twice, "seg_twice.dcm")
    expected["refused"]["seg_twice.dcm"] = "two frames of segment 1"


def make_structures():
    """Write contours. rt-utils requires axis-aligned, square slices with square pixels."""
    global SIZE, SPACING
    SIZE, SPACING = (7, 7, 5), np.array([0.75, 0.75, 3.0])
    series = slices(np.eye(3), "upright")
    for n, ds in enumerate(series):
        save(ds, f"structures/{n}.dcm")
    body = ellipsoid(radius=1.2)
    hollow = body.copy()
    hollow[2:5, 2:4, 1:4] = False
    builder = RTStructBuilder.create_new(dicom_series_path=str(HERE / "structures"))
    for name, mask in [("body", body), ("hollow", hollow), ("tumour", ellipsoid(1.0, 0.7))]:
        builder.add_roi(mask=mask.transpose(1, 0, 2), name=name, color=[255, 0, 0])
    builder.ds.SOPInstanceUID = builder.ds.file_meta.MediaStorageSOPInstanceUID = uid("structures")
    builder.ds.SeriesInstanceUID, builder.ds.SeriesDescription = uid("series of structures"), "structures"
    builder.ds.InstanceCreationDate = builder.ds.StructureSetDate = "20260101"
    builder.ds.InstanceCreationTime = builder.ds.StructureSetTime = "000000"
    builder.save(str(HERE / "structures/rs.dcm"))
    reader = RTStructBuilder.create_from(str(HERE / "structures"), str(HERE / "structures/rs.dcm"))
    affine = np.diag([*SPACING, 1.0])
    affine[:3, 3] = ORIGIN
    masks = {name: reader.get_roi_mask_by_name(name) for name in ["body", "hollow", "tumour"]}
    expected["segments"]["structures/rs.dcm"] = {
        name: {"number": n + 1, **told(mask.transpose(1, 0, 2), affine, "rt-utils")}
        for n, (name, mask) in enumerate(masks.items())
    }
    # the same contours without the slices, and one that is only a point
    ds = pydicom.dcmread(HERE / "structures/rs.dcm")
    contour = copy.deepcopy(ds.ROIContourSequence[2].ContourSequence[0])
    contour.ContourGeometricType, contour.NumberOfContourPoints = "POINT", 1
    contour.ContourData = contour.ContourData[:3]
    ds.ROIContourSequence[2].ContourSequence.append(contour)
    save(ds, "contours/alone.dcm")


shutil.rmtree(HERE, ignore_errors=True)
make_images()
make_segmentations()
make_structures()
(HERE / "expected.json").write_text(json.dumps(expected) + "\n")
print(sum(f.stat().st_size for f in HERE.rglob("*") if f.is_file()), "bytes in all")
