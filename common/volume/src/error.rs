//! Errors of reading and writing volumes.

use std::fmt;
use std::path::{Path, PathBuf};

/// An error related to a volume. The message identifies the file or the invalid value.
/// [`Error::reason`] explains why the problem matters; [`Error::remedy`] explains how to solve it.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// The file cannot be read or written, is damaged, or violates its format.
    #[error(transparent)]
    File(#[from] isoparticles_file::error::Error),
    /// The file has a known format but does not contain a volume.
    #[error("{}: is {content}", path.display())]
    NotAVolume {
        /// The file.
        path: PathBuf,
        /// The contents of the file.
        content: Content,
    },
    /// The folder contains no matching series, or more than one.
    #[error("{}: {}", path.display(), match wanted {
        None => format!("contains {matching} series"),
        Some(wanted) if *matching == 0 => format!("contains no series '{wanted}'"),
        Some(wanted) => format!("contains {matching} series '{wanted}'"),
    })]
    Series {
        /// The folder.
        path: PathBuf,
        /// The requested series, if any.
        wanted: Option<String>,
        /// Number of matching series.
        matching: usize,
        /// Descriptions of all series in the folder.
        present: Vec<String>,
    },
    /// A value is not an integer and therefore not a label.
    #[error("the volume contains the value {value}, which is not a label")]
    NotALabel {
        /// The value.
        value: String,
    },
    /// No segment has the requested name.
    #[error("no segment is called '{name}'")]
    SegmentMissing {
        /// The requested name.
        name: String,
        /// A list of the segments in the file, or an empty string if the file contains no names.
        present: String,
    },
    /// Several segments have the requested name.
    #[error("{count} segments are called '{name}'")]
    SegmentAmbiguous {
        /// The requested name.
        name: String,
        /// Number of segments with this name.
        count: usize,
        /// The segments with this name, as a string.
        present: String,
    },
    /// Several layers contain the label.
    #[error("{found} of the {layers} layers contain the label {label}")]
    LabelAmbiguous {
        /// The label.
        label: i64,
        /// Number of layers that contain the label.
        found: usize,
        /// Total number of layers.
        layers: usize,
        /// The segments with this label, as a string.
        present: String,
    },
}

/// The contents of a file that is not a volume.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Content {
    /// Initial particles written by `seed`.
    Seeds,
    /// Final particles written by `particles`.
    Particles,
    /// A checkpoint written by `particles`.
    Checkpoint,
    /// Polygons in VTK's XML format.
    SurfaceVtk,
    /// An unstructured grid in VTK's XML format.
    TetrahedraVtk,
    /// VTK's legacy format.
    LegacyVtk,
    /// A surface or point cloud in the PLY format.
    SurfacePly,
    /// A surface in the STL format.
    SurfaceStl,
    /// A surface in the OBJ format.
    SurfaceObj,
    /// A single file of a DICOM series.
    DicomSlice,
    /// An HDF5 file.
    Hdf5,
    /// A MATLAB file.
    Matlab,
    /// A Zarr store.
    Zarr,
}

impl fmt::Display for Content {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str(match self {
            Self::Seeds => "a file of seeds",
            Self::Particles => "a file of particles",
            Self::Checkpoint => "a checkpoint of particles",
            Self::SurfaceVtk => "a surface (VTK polygons)",
            Self::TetrahedraVtk => "a mesh of tetrahedra (VTK unstructured grid)",
            Self::LegacyVtk => "a legacy VTK file",
            Self::SurfacePly => "a surface or point cloud (PLY)",
            Self::SurfaceStl => "a surface (STL)",
            Self::SurfaceObj => "a surface (OBJ)",
            Self::DicomSlice => "one DICOM file",
            Self::Hdf5 => "an HDF5 file",
            Self::Matlab => "a MATLAB file",
            Self::Zarr => "a Zarr store",
        })
    }
}

/// The result of an operation on a volume.
pub type Result<T> = std::result::Result<T, Error>;

impl Error {
    /// Returns an explanation of why the error matters.
    pub fn reason(&self) -> String {
        let reason = match self {
            Self::File(error) => return error.reason(),
            Self::NotAVolume { content: Content::DicomSlice, .. } => {
                "a volume consists of the whole series, with one slice in each file"
            }
            Self::NotAVolume { content: Content::Hdf5 | Content::Matlab | Content::Zarr, .. } => {
                "it may contain several arrays, and the stages do not read this format"
            }
            Self::NotAVolume { .. } => "a volume is needed: a scan or a label map",
            Self::Series { .. } => "a volume is made from the slices of one series",
            Self::NotALabel { .. } => "labels must be whole numbers",
            Self::SegmentMissing { .. } => "there is nothing to extract",
            Self::SegmentAmbiguous { .. } => "the choice is ambiguous",
            Self::LabelAmbiguous { .. } => "segments of different layers may overlap, so the number is ambiguous",
        };
        reason.to_owned()
    }

    /// Returns instructions for solving the problem.
    pub fn remedy(&self) -> String {
        match self {
            Self::File(error) => error.remedy(),
            Self::NotAVolume { content, .. } => match content {
                Content::DicomSlice => "use the folder that contains the files of the series",
                Content::Hdf5 | Content::Matlab | Content::Zarr => {
                    "convert it with `isoparticles-read FILE --dataset NAME -o V.vti`; `make mesh` and `isoparticles \
                     mesh` do this with the volume to mesh, but not with masks"
                }
                Content::LegacyVtk => "open it in ParaView or pyvista and save the image as .vti",
                _ => "use the volume that it was made from",
            }
            .to_owned(),
            Self::Series { present, .. } => {
                format!("choose one by its description, number or UID: {}", present.join("; "))
            }
            Self::NotALabel { .. } => "use a label map, or extract an isosurface instead of labels".to_owned(),
            Self::SegmentMissing { present, .. } if present.is_empty() => {
                "choose labels by number; the file has no names for them".to_owned()
            }
            Self::SegmentMissing { present, .. } => format!("choose among the segments: {present}"),
            Self::SegmentAmbiguous { present, .. } => {
                format!("rename the segments, or choose by number: {present}")
            }
            Self::LabelAmbiguous { present, .. } => format!("choose by name: {present}"),
        }
    }

    /// Converts an error reported by the operating system. `doing` is the operation that failed,
    /// such as "read".
    pub(crate) fn file(path: &Path, doing: &str, source: std::io::Error, remedy: impl Into<String>) -> Self {
        isoparticles_file::error::Error::system(path, doing, source, remedy).into()
    }
}

/// Creates an error about the contents of a file.
pub(crate) fn bad(
    path: &Path,
    problem: impl fmt::Display,
    reason: impl Into<String>,
    remedy: impl Into<String>,
) -> Error {
    isoparticles_file::error::Error::contents(path, problem, reason, remedy).into()
}
