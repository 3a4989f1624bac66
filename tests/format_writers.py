"""Writes one ball in every input format, with other programs.

`WRITERS` lists the functions that write a file. Their arguments are a folder, the ball, and its
kind: `scan` or `mask`. They return the path of the file, and what the stages need to read it. The
array of the ball has the axes x, y and z.
"""

from __future__ import annotations

import contextlib
import io
import warnings
from collections.abc import Callable
from dataclasses import dataclass, replace
from importlib.metadata import version
from pathlib import Path
from typing import Any

import h5py
import hdf5storage
import highdicom
import itk
import nibabel
import nrrd
import numpy as np
import ome_zarr.format
import ome_zarr.writer
import pydicom
import pyvista
import rt_utils
import scipy.io
import SimpleITK as sitk  # noqa: N813
import tifffile
import vtk
import zarr
from pydicom.dataset import Dataset
from pydicom.uid import UID, ExplicitVRLittleEndian, JPEG2000Lossless, RLELossless, generate_uid
from vtk.util.numpy_support import numpy_to_vtk

TURN = np.array([[0.36, -0.8, 0.48], [0.48, 0.6, 0.64], [-0.8, 0.0, 0.6]])
"""The unit vectors of the axes, as columns: orthonormal, with exact decimals."""
TO_RAS = np.diag([-1.0, -1.0, 1.0, 1.0])
NAME = "ball"
"""Name of the segment, region or array that contains the ball."""


@dataclass(frozen=True)
class Ball:
    """A ball as a scan (distance inward in 0.01 mm, int16) and as a mask.

    The size and the spacing of the grid differ along each axis, its axes are oblique, and the ball
    is not at its centre. Every exchange or reversal of axes therefore changes the world position.
    """

    size: tuple[int, int, int] = (40, 36, 32)
    spacing: tuple[float, float, float] = (0.9, 1.1, 1.3)
    centre: tuple[float, float, float] = (18.2, 19.1, 14.7)
    radius: float = 13.3
    origin: tuple[float, float, float] = (-31.5, 12.25, 40.75)
    noise: float = 0.0
    """Standard deviation of the noise of the scan."""

    def array(self, kind: str) -> np.ndarray:
        """Return the voxels: `scan` or `mask`."""
        axes = [
            (np.arange(n, dtype=np.float32) - c) * s
            for n, c, s in zip(self.size, self.centre, self.spacing, strict=True)
        ]
        x, y, z = np.meshgrid(*axes, indexing="ij", sparse=True)
        inward = self.radius - np.sqrt(x * x + y * y + z * z)
        if kind == "mask":
            return (inward > 0).astype(np.uint8)
        inward *= 100
        if self.noise:
            inward += self.noise * np.random.default_rng(1).standard_normal(self.size, dtype=np.float32)
        return np.clip(np.round(inward), -32000, 32000).astype(np.int16)

    @property
    def lps(self) -> np.ndarray:
        """The matrix from voxels to the world."""
        matrix = np.eye(4)
        matrix[:3, :3] = TURN * self.spacing
        matrix[:3, 3] = self.origin
        return matrix

    @property
    def unposed(self) -> np.ndarray:
        """The matrix from voxels to the world for files without a pose."""
        return np.diag([*self.spacing, 1.0])


@dataclass(frozen=True)
class Written:
    """A file or folder that contains the ball."""

    path: Path
    matrix: np.ndarray
    """The matrix from voxels to the world, according to the program that wrote the file."""
    spacing: tuple[float, float, float] | None = None
    """The spacing to give, if the file has none."""
    label: str = "1"
    """The number of the mask in the file, or its name if the file has names."""
    array: str | None = None
    """The name of the array, if the Python package reads the file."""
    drawn: Ball | None = None
    """The ball, if the file contains its contours instead of voxels."""


@dataclass(frozen=True)
class Writer:
    """A format, and the function that writes it."""

    name: str
    program: str
    kinds: tuple[str, ...]
    write: Callable[[Path, Ball, str], Written]
    is_large: bool
    """Whether reading times are measured with a large volume in this format."""


WRITERS: list[Writer] = []


def writes(name: str, package: str, *kinds: str, is_large: bool = False) -> Callable[[Any], Any]:
    """Add a writer to the list."""

    def add(write: Callable[[Path, Ball, str], Written]) -> Callable[[Path, Ball, str], Written]:
        program = f"{package} {version(package)}"
        WRITERS.append(Writer(name, program, kinds or ("scan", "mask"), write, is_large))
        return write

    return add


def itk_image(ball: Ball, kind: str) -> sitk.Image:
    """Return the ball as an image of SimpleITK."""
    image = sitk.GetImageFromArray(np.ascontiguousarray(ball.array(kind).T))
    image.SetSpacing(ball.spacing)
    image.SetOrigin(ball.origin)
    image.SetDirection(TURN.flatten())
    return image


def by_itk(name: str, ending: str, *, compress: bool, is_large: bool = False) -> None:
    """Add a format that SimpleITK writes with the pose."""

    @writes(name, "SimpleITK", is_large=is_large)
    def write(folder: Path, ball: Ball, kind: str) -> Written:
        path = folder / f"{kind}{ending}"
        sitk.WriteImage(itk_image(ball, kind), path, compress)
        return Written(path, ball.lps)


by_itk("NRRD, raw", ".nrrd", compress=False, is_large=True)
by_itk("NRRD, gzip", ".nrrd", compress=True, is_large=True)


@writes("NRRD, bzip2, RAS", "pynrrd")
def nrrd_in_ras(folder: Path, ball: Ball, kind: str) -> Written:
    """Write a file in RAS, the space of most neuroimaging programs."""
    matrix = TO_RAS @ ball.lps
    header = {"space": "RAS", "space directions": matrix[:3, :3].T, "space origin": matrix[:3, 3], "encoding": "bzip2"}
    nrrd.write(str(folder / f"{kind}.nrrd"), ball.array(kind), header)
    return Written(folder / f"{kind}.nrrd", ball.lps)


@writes(".seg.nrrd, keys of 3D Slicer", "pynrrd", "mask")
def slicer_segmentation(folder: Path, ball: Ball, kind: str) -> Written:
    """Write a segmentation of one segment as 3D Slicer does."""
    header = {
        "space": "left-posterior-superior", "space directions": ball.lps[:3, :3].T, "space origin": ball.origin,
        "encoding": "gzip", "Segment0_ID": "Segment_1", "Segment0_Name": NAME, "Segment0_LabelValue": "1",
        "Segment0_Layer": "0", "Segment0_Extent": "0 39 0 35 0 31", "Segmentation_MasterRepresentation": "Binary labelmap",
    }  # fmt: skip
    path = folder / f"{kind}.seg.nrrd"
    nrrd.write(str(path), ball.array(kind), header)
    return Written(path, ball.lps, label=NAME)


by_itk("NIfTI-1, .nii.gz", ".nii.gz", compress=True)


def by_nibabel(name: str, ending: str, image: Any, *, is_large: bool = False) -> None:
    """Add a format that nibabel writes. The pose is the one that nibabel reads from the file."""

    @writes(name, "nibabel", is_large=is_large)
    def write(folder: Path, ball: Ball, kind: str) -> Written:
        path = folder / f"{kind}{ending}"
        nibabel.save(image(ball.array(kind), TO_RAS @ ball.lps), path)
        return Written(path, TO_RAS @ nibabel.load(path).affine)


by_nibabel("NIfTI-1, .nii", ".nii", nibabel.Nifti1Image, is_large=True)
by_nibabel("NIfTI-1, .nii.gz", ".nii.gz", nibabel.Nifti1Image, is_large=True)
by_nibabel("NIfTI-1, .hdr and .img", ".img", nibabel.Nifti1Pair)
by_nibabel("NIfTI-2, .nii.gz", ".nii.gz", nibabel.Nifti2Image)
by_nibabel("FreeSurfer .mgh", ".mgh", nibabel.MGHImage)
by_nibabel("FreeSurfer .mgz", ".mgz", nibabel.MGHImage, is_large=True)


@writes("Analyze 7.5", "nibabel")
def analyze(folder: Path, ball: Ball, kind: str) -> Written:
    """Write a pair of files without a pose. nibabel puts the centre of the volume at the origin."""
    path = folder / f"{kind}.img"
    image = nibabel.AnalyzeImage(ball.array(kind), None)
    image.header.set_zooms(ball.spacing)
    nibabel.save(image, path)
    return Written(path, TO_RAS @ nibabel.load(path).affine)


by_itk("MetaImage .mha, zlib", ".mha", compress=True, is_large=True)


@writes("MetaImage .mhd and .zraw", "itk")
def metaimage_pair(folder: Path, ball: Ball, kind: str) -> Written:
    """Write a header and a voxel file with ITK."""
    image = itk.image_from_array(np.ascontiguousarray(ball.array(kind).T))
    image.SetSpacing(ball.spacing)
    image.SetOrigin(ball.origin)
    image.SetDirection(itk.matrix_from_array(TURN))
    itk.imwrite(image, str(folder / f"{kind}.mhd"), compression=True)
    return Written(folder / f"{kind}.mhd", ball.lps)


@writes("VTK image .vti, zlib", "vtk", is_large=True)
def vtk_image(folder: Path, ball: Ball, kind: str) -> Written:
    """Write a VTK image with a direction."""
    image = vtk.vtkImageData()
    image.SetDimensions(ball.size)
    image.SetSpacing(ball.spacing)
    image.SetOrigin(ball.origin)
    image.SetDirectionMatrix(TURN.flatten())
    array = numpy_to_vtk(ball.array(kind).flatten(order="F"))
    array.SetName(NAME)
    image.GetPointData().SetScalars(array)
    writer = vtk.vtkXMLImageDataWriter()
    writer.SetFileName(str(folder / f"{kind}.vti"))
    writer.SetInputData(image)
    writer.Write()
    return Written(folder / f"{kind}.vti", ball.lps)


@writes("VTK image .vti, cells", "pyvista")
def vtk_cells(folder: Path, ball: Ball, kind: str) -> Written:
    """Write the voxels as the cells of a VTK image."""
    corner = ball.lps @ [-0.5, -0.5, -0.5, 1.0]
    image = pyvista.ImageData(
        dimensions=np.array(ball.size) + 1, spacing=ball.spacing, origin=corner[:3], direction_matrix=TURN
    )
    image.cell_data[NAME] = ball.array(kind).flatten(order="F")
    image.save(folder / f"{kind}.vti")
    return Written(folder / f"{kind}.vti", ball.lps)


def dicom_slices(folder: Path, ball: Ball, kind: str) -> list[Path]:
    """Write a CT as one DICOM file per slice with SimpleITK; return the files."""
    folder.mkdir(exist_ok=True)
    image = itk_image(ball, kind)
    writer = sitk.ImageFileWriter()
    writer.KeepOriginalImageUIDOn()
    study, series, frame = generate_uid(), generate_uid(), generate_uid()
    paths = []
    for z in range(ball.size[2]):
        part = image[:, :, z]
        tags = {
            "0008|0016": "1.2.840.10008.5.1.4.1.1.2", "0008|0018": generate_uid(), "0008|0020": "20260102",
            "0008|0030": "101112", "0008|0050": "1", "0008|0060": "CT", "0008|0090": "Doe^Jane", "0008|103e": NAME,
            "0010|0010": "Ball^Anna", "0010|0020": "1", "0010|0030": "19700101", "0010|0040": "F",
            "0020|000d": study, "0020|000e": series, "0020|0010": "1", "0020|0011": "1", "0020|0013": str(z + 1),
            "0020|0032": "\\".join(map(str, image.TransformIndexToPhysicalPoint((0, 0, z)))),
            "0020|0037": "\\".join(map(str, TURN[:, :2].T.flatten())), "0020|0052": frame, "0018|0050": str(ball.spacing[2]),
        }  # fmt: skip
        for tag, value in tags.items():
            part.SetMetaData(tag, value)
        # The order of the file names differs from that of the slices.
        paths.append(folder / f"{(7 * z) % ball.size[2]:04}.dcm")
        writer.SetFileName(str(paths[-1]))
        writer.Execute(part)
    return paths


@writes("DICOM, a folder of slices", "SimpleITK", "scan", is_large=True)
def dicom_folder(folder: Path, ball: Ball, kind: str) -> Written:
    """Write uncompressed slices."""
    dicom_slices(folder / kind, ball, kind)
    return Written(folder / kind, ball.lps)


def by_pydicom(name: str, syntax: UID, *, is_large: bool = False) -> None:
    """Add slices that pydicom compresses."""

    @writes(f"DICOM, slices in {name}", "pydicom", "scan", is_large=is_large)
    def write(folder: Path, ball: Ball, kind: str) -> Written:
        for path in dicom_slices(folder / kind, ball, kind):
            slice_ = pydicom.dcmread(path)
            slice_.compress(syntax)
            slice_.save_as(path)
        return Written(folder / kind, ball.lps)


by_pydicom("RLE", RLELossless)
by_pydicom("JPEG 2000", JPEG2000Lossless, is_large=True)


@writes("DICOM, slices without preamble", "pydicom", "scan")
def dicom_without_preamble(folder: Path, ball: Ball, kind: str) -> Written:
    """Write slices without the 128 bytes and the file meta information, as old programs do."""
    for path in dicom_slices(folder / kind, ball, kind):
        slice_ = pydicom.dcmread(path)
        del slice_.file_meta, slice_.preamble
        pydicom.dcmwrite(path, slice_, implicit_vr=True, little_endian=True, enforce_file_format=False)
    return Written(folder / kind, ball.lps)


def sequence(**values: Any) -> pydicom.Sequence:
    """Return a sequence of one item."""
    item = Dataset()
    for name, value in values.items():
        setattr(item, name, value)
    return pydicom.Sequence([item])


def numbers(values: Any) -> list[str]:
    """Return decimal strings of at most 16 characters."""
    return [pydicom.valuerep.format_number_as_ds(float(value)) for value in np.ravel(values)]


def dicom_file(path: Path, file: Dataset) -> None:
    """Write a DICOM file with the common attributes."""
    file.SOPInstanceUID = generate_uid()
    file.PatientName, file.PatientID, file.StudyID = "Ball^Anna", "1", "1"
    file.file_meta = pydicom.dataset.FileMetaDataset()
    file.file_meta.TransferSyntaxUID = ExplicitVRLittleEndian
    file.save_as(path, enforce_file_format=True)


@writes("DICOM, enhanced CT", "pydicom", "scan", is_large=True)
def enhanced_ct(folder: Path, ball: Ball, kind: str) -> Written:
    """Write all slices as frames of one file, in descending order."""
    file = Dataset()
    file.SOPClassUID, file.Modality, file.ImageType = pydicom.uid.EnhancedCTImageStorage, "CT", ["ORIGINAL", "PRIMARY"]
    file.StudyInstanceUID, file.SeriesInstanceUID, file.FrameOfReferenceUID = (generate_uid() for _ in range(3))
    file.Columns, file.Rows, file.NumberOfFrames = ball.size
    file.SamplesPerPixel, file.PhotometricInterpretation, file.PixelRepresentation = 1, "MONOCHROME2", 1
    file.BitsAllocated, file.BitsStored, file.HighBit = 16, 16, 15
    shared = sequence(
        PixelMeasuresSequence=sequence(
            PixelSpacing=numbers([ball.spacing[1], ball.spacing[0]]), SliceThickness=ball.spacing[2]
        ),
        PlaneOrientationSequence=sequence(ImageOrientationPatient=numbers(TURN[:, :2].T)),
        PixelValueTransformationSequence=sequence(RescaleSlope="1", RescaleIntercept="-50", RescaleType="HU"),
    )
    file.SharedFunctionalGroupsSequence = shared
    order = list(reversed(range(ball.size[2])))
    frames = []
    for z in order:
        position = sequence(ImagePositionPatient=numbers((ball.lps @ [0, 0, z, 1])[:3]))
        content = sequence(StackID="1", InStackPositionNumber=z + 1, DimensionIndexValues=[1, z + 1])
        frames += sequence(PlanePositionSequence=position, FrameContentSequence=content)
    file.PerFrameFunctionalGroupsSequence = pydicom.Sequence(frames)
    file.PixelData = (ball.array(kind) + 50).astype("<i2")[:, :, order].tobytes(order="F")
    dicom_file(folder / f"{kind}.dcm", file)
    return Written(folder / f"{kind}.dcm", ball.lps)


def by_highdicom(kind_of_segmentation: str) -> None:
    """Add a DICOM segmentation object."""

    @writes(f"DICOM SEG, {kind_of_segmentation.lower()}", "highdicom", "mask")
    def write(folder: Path, ball: Ball, kind: str) -> Written:
        slices = [pydicom.dcmread(path) for path in dicom_slices(folder / "ct", ball, "scan")]
        tissue = pydicom.sr.codedict.codes.SCT.Tissue
        segment = highdicom.seg.SegmentDescription(
            segment_number=1, segment_label=NAME, segmented_property_category=tissue,
            segmented_property_type=tissue, algorithm_type="MANUAL",
        )  # fmt: skip
        mask = ball.array(kind).T
        file = highdicom.seg.Segmentation(
            source_images=slices, segmentation_type=kind_of_segmentation, segment_descriptions=[segment],
            pixel_array=np.ascontiguousarray(mask.astype(np.float32) if kind_of_segmentation == "FRACTIONAL" else mask),
            series_instance_uid=generate_uid(), series_number=2, sop_instance_uid=generate_uid(), instance_number=1,
            manufacturer="none", manufacturer_model_name="none", software_versions="1", device_serial_number="1",
        )  # fmt: skip
        file.save_as(folder / "seg.dcm")
        return Written(folder / "seg.dcm", ball.lps, label=NAME)


for kind_of_seg in ("BINARY", "FRACTIONAL", "LABELMAP"):
    by_highdicom(kind_of_seg)


@writes("DICOM RTSTRUCT, circles", "pydicom", "mask")
def rtstruct(folder: Path, ball: Ball, _: str) -> Written:
    """Write the circles in which the slices of a CT cut the ball, as a planning program does.

    The mesh differs slightly from that of the mask: centres within 0.01 voxel of a contour are
    inside.
    """
    slices = dicom_slices(folder / "ct", ball, "scan")
    first = pydicom.dcmread(slices[0])
    file = Dataset()
    file.SOPClassUID, file.Modality = pydicom.uid.RTStructureSetStorage, "RTSTRUCT"
    file.StudyInstanceUID, file.SeriesInstanceUID = first.StudyInstanceUID, generate_uid()
    images = []
    for path in slices:
        uid = pydicom.dcmread(path, stop_before_pixels=True).SOPInstanceUID
        images += sequence(ReferencedSOPClassUID=first.SOPClassUID, ReferencedSOPInstanceUID=uid)
    series = sequence(SeriesInstanceUID=first.SeriesInstanceUID, ContourImageSequence=pydicom.Sequence(images))
    study = sequence(
        ReferencedSOPClassUID=first.SOPClassUID, ReferencedSOPInstanceUID=first.StudyInstanceUID,
        RTReferencedSeriesSequence=series,
    )  # fmt: skip
    file.ReferencedFrameOfReferenceSequence = sequence(
        FrameOfReferenceUID=first.FrameOfReferenceUID, RTReferencedStudySequence=study
    )
    file.StructureSetLabel = NAME
    file.StructureSetROISequence = sequence(
        ROINumber=1, ROIName=NAME, ReferencedFrameOfReferenceUID=first.FrameOfReferenceUID,
        ROIGenerationAlgorithm="MANUAL",
    )  # fmt: skip
    contours = []
    around = np.arange(720) * 2 * np.pi / 720
    for z, image in enumerate(images):
        square = ball.radius**2 - ((z - ball.centre[2]) * ball.spacing[2]) ** 2
        if square <= 0:
            continue
        x = ball.centre[0] + np.sqrt(square) * np.cos(around) / ball.spacing[0]
        y = ball.centre[1] + np.sqrt(square) * np.sin(around) / ball.spacing[1]
        points = (ball.lps @ [x, y, np.full_like(x, z), np.ones_like(x)])[:3].T
        contours += sequence(
            ContourImageSequence=pydicom.Sequence([image]), ContourGeometricType="CLOSED_PLANAR",
            NumberOfContourPoints=len(points), ContourData=numbers(points),
        )  # fmt: skip
    file.ROIContourSequence = sequence(
        ReferencedROINumber=1, ROIDisplayColor=[255, 0, 0], ContourSequence=pydicom.Sequence(contours)
    )
    file.RTROIObservationsSequence = sequence(ObservationNumber=1, ReferencedROINumber=1, RTROIInterpretedType="ORGAN")
    dicom_file(folder / "ct" / "rtstruct.dcm", file)
    return Written(folder / "ct" / "rtstruct.dcm", ball.lps, label=NAME, drawn=ball)


@writes("DICOM RTSTRUCT, pixel outlines", "rt-utils", "mask")
def rtstruct_of_mask(folder: Path, ball: Ball, kind: str) -> Written:
    """Write outlines of a mask, which pass through the centres of its outermost pixels.

    The slices are square, because rt-utils exchanges rows and columns of other slices.
    """
    ball = replace(ball, size=(40, 40, 32), spacing=(1.0, 1.0, 1.3))
    dicom_slices(folder / "ct", ball, "scan")
    file = rt_utils.RTStructBuilder.create_new(dicom_series_path=str(folder / "ct"))
    file.add_roi(mask=ball.array(kind).transpose(1, 0, 2).astype(bool), name=NAME)
    file.save(str(folder / "ct" / "rtstruct"))
    return Written(folder / "ct" / "rtstruct.dcm", ball.lps, label=NAME, drawn=ball)


@writes("TIFF, ImageJ hyperstack", "tifffile")
def tiff_of_imagej(folder: Path, ball: Ball, kind: str) -> Written:
    """Write a stack with a spacing; ImageJ has no signed integers."""
    array = ball.array(kind).T
    tifffile.imwrite(
        folder / f"{kind}.tif", array if kind == "mask" else array.astype(np.float32), imagej=True,
        resolution=(1 / ball.spacing[0], 1 / ball.spacing[1]),
        metadata={"axes": "ZYX", "spacing": ball.spacing[2], "unit": "mm"},
    )  # fmt: skip
    return Written(folder / f"{kind}.tif", ball.unposed)


@writes("TIFF, OME", "tifffile")
def tiff_of_ome(folder: Path, ball: Ball, kind: str) -> Written:
    """Write an OME-TIFF in um with the deflate compression."""
    sizes = {f"PhysicalSize{axis}": 1000 * size for axis, size in zip("XYZ", ball.spacing, strict=True)}
    units = {f"PhysicalSize{axis}Unit": "µm" for axis in "XYZ"}
    tifffile.imwrite(
        folder / f"{kind}.ome.tif", ball.array(kind).T, compression="zlib", metadata={"axes": "ZYX", **sizes, **units}
    )
    return Written(folder / f"{kind}.ome.tif", ball.unposed)


@writes("TIFF, pages", "SimpleITK", is_large=True)
def tiff_pages(folder: Path, ball: Ball, kind: str) -> Written:
    """Write one file of many pages without a spacing between them."""
    image = itk_image(ball, kind)
    image.SetDirection(np.eye(3).flatten())
    if kind == "scan":  # ITK writes no signed TIFF
        image = sitk.Cast(image, sitk.sitkFloat32)
    sitk.WriteImage(image, folder / f"{kind}.tif", useCompression=False)
    return Written(folder / f"{kind}.tif", ball.unposed, ball.spacing)


@writes("TIFF, a folder of slices", "tifffile", is_large=True)
def tiff_folder(folder: Path, ball: Ball, kind: str) -> Written:
    """Write one compressed file per slice, numbered without leading zeros."""
    (folder / kind).mkdir()
    for z, page in enumerate(ball.array(kind).T):
        tifffile.imwrite(folder / kind / f"slice{z + 1}.tif", page, compression="lzw")
    return Written(folder / kind, ball.unposed, ball.spacing)


@writes("NumPy .npy", "numpy", is_large=True)
def npy(folder: Path, ball: Ball, kind: str) -> Written:
    """Write an array with the axes x, y and z."""
    np.save(folder / f"{kind}.npy", ball.array(kind))
    return Written(folder / f"{kind}.npy", ball.unposed, ball.spacing)


@writes("HDF5", "h5py", is_large=True)
def hdf5(folder: Path, ball: Ball, kind: str) -> Written:
    """Write a compressed data set with the axes z, y and x into a group."""
    with h5py.File(folder / f"{kind}.h5", "w") as file:
        file.create_dataset(f"group/{NAME}", data=ball.array(kind).T, compression="gzip")
    return Written(folder / f"{kind}.h5", ball.unposed, ball.spacing, array=f"group/{NAME}")


@writes("MATLAB .mat 5", "scipy", is_large=True)
def mat_5(folder: Path, ball: Ball, kind: str) -> Written:
    """Write one variable into a file of version 5."""
    scipy.io.savemat(folder / f"{kind}.mat", {NAME: ball.array(kind)}, do_compression=True)
    return Written(folder / f"{kind}.mat", ball.unposed, ball.spacing, array=NAME)


@writes("MATLAB .mat 7.3", "hdf5storage")
def mat_73(folder: Path, ball: Ball, kind: str) -> Written:
    """Write one variable into a file of version 7.3, which is HDF5."""
    hdf5storage.savemat(
        str(folder / f"{kind}.mat"), {NAME: ball.array(kind)}, store_python_metadata=False, matlab_compatible=True
    )
    return Written(folder / f"{kind}.mat", ball.unposed, ball.spacing, array=NAME)


def by_ome_zarr(name: str, layout: Any, *, is_large: bool = False) -> None:
    """Add a version of OME-Zarr, with two levels in um."""

    @writes(f"OME-Zarr {name}", "ome-zarr", is_large=is_large)
    def write(folder: Path, ball: Ball, kind: str) -> Written:
        path = folder / f"{kind}.ome.zarr"
        group = zarr.open_group(path, mode="w", zarr_format=layout.zarr_format)
        axes = [{"name": axis, "type": "space", "unit": "micrometer"} for axis in "zyx"]
        steps = [1000.0 * step for step in reversed(ball.spacing)]
        levels = [ball.array(kind).T, ball.array(kind).T[::2, ::2, ::2]]
        transforms = [[{"type": "scale", "scale": [step * 2**n for step in steps]}] for n in range(2)]
        ome_zarr.writer.write_multiscale(levels, group, fmt=layout, axes=axes, coordinate_transformations=transforms)
        return Written(path, ball.unposed, array="s0")


by_ome_zarr("0.4", ome_zarr.format.FormatV04())
by_ome_zarr("0.5", ome_zarr.format.FormatV05(), is_large=True)


def chosen(only: list[str]) -> list[Writer]:
    """Return the writers whose format or program contains one of the words, or all."""
    return [
        writer
        for writer in WRITERS
        if not only or any(word.lower() in f"{writer.name} {writer.program}".lower() for word in only)
    ]


def written(writer: Writer, folder: Path, ball: Ball, kind: str) -> Written | str:
    """Write a file into a new folder. If the program raises any error, return its text."""
    folder.mkdir(parents=True)
    try:
        with warnings.catch_warnings(), contextlib.redirect_stdout(io.StringIO()):
            warnings.simplefilter("ignore")
            return writer.write(folder, ball, kind)
    except Exception as error:
        return f"not written: {type(error).__name__}: {error}"
