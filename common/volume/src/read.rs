//! Reads volumes in all supported formats. The format is detected from the first bytes of a file.
//! The file name matters only if these bytes are inconclusive.

use crate::error::bad;
use crate::error::{Content, Error, Result};
use crate::foreign::foreign_content;
use crate::limit::without_spacing;
use crate::volume::Volume;
use crate::{dicom, masks, meta_image, mgh, nifti, npy, nrrd, tiff, voxel_data, vti};
use glam::DVec3;
use isoparticles_file::history::file_name;
use std::io::Read;
use std::path::{Path, PathBuf};

/// Number of bytes used to detect the format. DICOM needs the first 132 bytes. The XML declaration
/// and the `VTKFile` tag that VTK writes have up to 151 bytes in total; a comment may precede the
/// tag.
const START_BYTES: u64 = 512;

/// Options for reading a volume.
#[derive(Clone, Copy, Debug, Default)]
pub struct ReadOptions<'a> {
    /// Description, number or UID of the series to read from a folder of DICOM files. Required only
    /// if the folder contains several series, or a multi-frame file several volumes.
    pub series: Option<&'a str>,
    /// Distance in mm between neighbouring voxel centres along each axis, always positive. Only for
    /// files that do not contain it, and for contours without their slices.
    pub spacing: Option<DVec3>,
}

/// The supported formats of volume files.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Format {
    Nrrd,
    MetaImage,
    Nifti,
    Mgh,
    Tiff,
    NumPy,
    VtkImage,
}

/// Reads a volume from an NRRD file, a 3D Slicer segmentation, a MetaImage, a file in NIfTI or
/// Analyze 7.5, a volume of FreeSurfer, a TIFF stack, a NumPy array, a VTK image, DICOM (a folder
/// of slices, or a multi-frame image, segmentation or structure set), or a folder of TIFF slices or
/// of masks, one file per object.
///
/// # Errors
/// If the file cannot be read, is not a volume with one number per voxel, is damaged or truncated,
/// or does not fit in memory.
pub fn read_volume(path: &Path) -> Result<Volume> {
    read_volume_with(path, &ReadOptions::default())
}

/// Reads a volume like [`read_volume`], with options.
///
/// # Errors
/// If [`read_volume`] would fail, if the requested series does not exist, if a series is requested
/// from anything but DICOM, or if a spacing is given for a file that contains one.
pub fn read_volume_with(path: &Path, options: &ReadOptions<'_>) -> Result<Volume> {
    if let Some(content) = foreign_content(path) {
        return Err(Error::NotAVolume { path: path.to_path_buf(), content });
    }
    if path.is_dir() {
        return read_folder(path, options);
    }
    // if this is the voxel file of a pair, start from its header
    let header = nifti::partner(path).filter(|other| other.to_string_lossy().trim_end_matches(".gz").ends_with(".hdr"));
    let path = header.as_deref().unwrap_or(path);
    let start = start(path)?;
    if dicom::is_dicom(&start) {
        return dicom::read_file(path, options.series, options.spacing);
    }
    let format = format(path, &start)?;
    without_series(path, options)?;
    let read = match format {
        Format::Tiff => return tiff::read_tiff(path, options.spacing),
        Format::NumPy => return npy::read_npy(path, options.spacing),
        Format::Nrrd => nrrd::read_nrrd,
        Format::MetaImage => meta_image::read_meta_image,
        Format::Nifti => nifti::read_nifti,
        Format::Mgh => mgh::read_mgh,
        Format::VtkImage => vti::read_vti,
    };
    without_spacing(path, options.spacing)?;
    read(path)
}

/// Fails if a series is requested from anything but DICOM.
fn without_series(path: &Path, options: &ReadOptions<'_>) -> Result<()> {
    match options.series {
        Some(series) => Err(bad(
            path,
            format!("has no series, and '{series}' was requested"),
            "only DICOM has series",
            "leave out the series, or use the folder of DICOM files",
        )),
        None => Ok(()),
    }
}

/// Reads a folder: the slices of a DICOM series or, if it contains no DICOM files, masks or TIFF
/// slices.
fn read_folder(folder: &Path, options: &ReadOptions<'_>) -> Result<Volume> {
    let cannot = |error: std::io::Error| Error::file(folder, "read", error, "check the name of the folder");
    let entries = std::fs::read_dir(folder).map_err(cannot)?.map(|entry| entry.map(|entry| entry.path()));
    let mut entries: Vec<PathBuf> = entries.collect::<std::io::Result<_>>().map_err(cannot)?;
    entries.sort();
    let (folders, files): (Vec<PathBuf>, Vec<PathBuf>) = entries.into_iter().partition(|path| path.is_dir());
    let slices: Vec<PathBuf> = files.iter().filter(|path| dicom::is_dicom_file(path)).cloned().collect();
    if !slices.is_empty() {
        return dicom::read_series(folder, &slices, options.series, options.spacing);
    }
    let tiffs: Vec<PathBuf> = files.iter().filter(|path| tiff::has_tiff_name(path)).cloned().collect();
    let (masks, others): (Vec<PathBuf>, Vec<PathBuf>) =
        files.into_iter().partition(|path| masks::mask_name(path).is_some());
    if let (Some(mask), Some(slice)) = (masks.first(), tiffs.first()) {
        return Err(bad(
            folder,
            format!("contains {} and {}", file_name(mask), file_name(slice)),
            "TIFF files in a folder are read as slices, and other volumes as masks",
            "move one kind of file to another folder",
        ));
    }
    if !tiffs.is_empty() {
        without_series(folder, options)?;
        return tiff::read_tiff_folder(folder, tiffs, options.spacing);
    }
    if !masks.is_empty() {
        without_series(folder, options)?;
        without_spacing(folder, options.spacing)?;
        let mut volume = masks::read_masks(folder, &masks, read_volume)?;
        let ignored = others.iter().filter(|path| masks::is_other_volume(path)).take(10);
        let ignored: Vec<String> = ignored.map(|path| file_name(path)).collect();
        if !ignored.is_empty() {
            let remark = "ignored, because masks of these formats are not supported";
            volume.remarks.push(format!("{remark}: {}", ignored.join(", ")));
        }
        return Ok(volume);
    }
    let names: Vec<String> = folders.iter().take(10).map(|folder| folder.display().to_string()).collect();
    let hint = if names.is_empty() { String::new() } else { format!("; its subfolders are {}", names.join(", ")) };
    Err(bad(
        folder,
        "is a folder without DICOM files, TIFF files or masks",
        "a folder is read as the slices of one DICOM series or TIFF stack, or as masks: one volume file per object, \
         such as heart.nii.gz",
        format!("use the volume's file, or the folder that contains the slices or masks{hint}"),
    ))
}

fn start(path: &Path) -> Result<Vec<u8>> {
    let mut start = Vec::new();
    std::fs::File::open(path)
        .and_then(|file| file.take(START_BYTES).read_to_end(&mut start))
        .map_err(|error| Error::file(path, "read", error, "check the name of the volume"))?;
    if start.is_empty() {
        return Err(bad(path, "is empty", "it contains no volume", "write or copy the file again"));
    }
    Ok(start)
}

/// Returns the first bytes of a gzip-compressed file, or fewer if they cannot be decompressed.
fn decompressed_start(path: &Path) -> Vec<u8> {
    let mut start = Vec::new();
    // the bytes before an error are kept
    voxel_data::open(path).and_then(|stream| stream.take(START_BYTES).read_to_end(&mut start)).ok();
    start
}

/// Detects the format of a file. Fails if the file is not a volume.
fn format(path: &Path, start: &[u8]) -> Result<Format> {
    let name = path.to_string_lossy().to_lowercase();
    let ends = |endings: &[&str]| endings.iter().any(|ending| name.ends_with(ending));
    let has = |word: &[u8]| start.windows(word.len()).any(|window| window == word);
    if start.starts_with(b"NRRD") {
        return Ok(Format::Nrrd);
    }
    let plain = if start.starts_with(&[0x1f, 0x8b]) { decompressed_start(path) } else { start.to_vec() };
    if nifti::is_nifti(&plain) {
        return Ok(Format::Nifti);
    }
    if mgh::is_mgh(&plain) {
        return Ok(Format::Mgh);
    }
    if tiff::byte_order(start).is_some() {
        return Ok(Format::Tiff);
    }
    if npy::is_npy(start) {
        return Ok(Format::NumPy);
    }
    if let Some(content) = no_volume(start, &ends) {
        return Err(Error::NotAVolume { path: path.to_path_buf(), content });
    }
    if meta_image::is_meta_image(start) || ends(&[".mha", ".mhd"]) {
        return Ok(Format::MetaImage);
    }
    if has(b"<VTKFile") || ends(&[".vti"]) {
        return Ok(Format::VtkImage);
    }
    if ends(&[".nii", ".nii.gz"]) {
        return Ok(Format::Nifti);
    }
    if ends(&[".nrrd", ".nhdr", ".mgh", ".mgz", ".tif", ".tiff", ".npy"]) {
        return Err(bad(
            path,
            "does not start like a file with this ending",
            "it is damaged, or its format is another one, despite its name",
            "write or download the file again",
        ));
    }
    Err(bad(
        path,
        "has an unknown format",
        "volumes can be read from NRRD (.nrrd, .nhdr, .seg.nrrd), NIfTI (.nii, .nii.gz), Analyze (.hdr and .img), \
         FreeSurfer (.mgh, .mgz), MetaImage (.mha, .mhd), TIFF (.tif), NumPy (.npy), VTK image files (.vti), DICOM and \
         folders of TIFF slices or masks",
        "convert it, for example with 3D Slicer, ITK-SNAP or SimpleITK",
    ))
}

/// Detects the contents of a file that has a known format but does not contain a volume.
fn no_volume(start: &[u8], ends: &impl Fn(&[&str]) -> bool) -> Option<Content> {
    let has = |word: &[u8]| start.windows(word.len()).any(|window| window == word);
    if has(b"<VTKFile") {
        return match () {
            () if has(b"\"PolyData\"") => Some(Content::SurfaceVtk),
            () if has(b"\"UnstructuredGrid\"") => Some(Content::TetrahedraVtk),
            () => None,
        };
    }
    if let Some(rest) = start.strip_prefix(b"ISOPART\n") {
        return Some(match rest.first() {
            Some(1) => Content::Seeds,
            Some(3) => Content::Checkpoint,
            _ => Content::Particles,
        });
    }
    if start.starts_with(b"# vtk DataFile") {
        return Some(Content::LegacyVtk);
    }
    if start.starts_with(b"ply\n") || start.starts_with(b"ply\r\n") {
        return Some(Content::SurfacePly);
    }
    if start.starts_with(b"solid ") || ends(&[".stl"]) {
        return Some(Content::SurfaceStl);
    }
    ends(&[".obj"]).then_some(Content::SurfaceObj)
}
