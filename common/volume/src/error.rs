//! What can go wrong with a volume.

use std::fmt;
use std::path::{Path, PathBuf};

/// What is wrong with a volume. The text says which file, value and place; [`Error::reason`] why that matters and [`Error::remedy`] what can
/// be done.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// Its file cannot be read or written, is damaged, or is not what its format demands.
    #[error(transparent)]
    File(#[from] isoparticles_file::error::Error),
    /// The file is known, but holds no volume.
    #[error("{}: is {content}", path.display())]
    NotAVolume {
        /// The file.
        path: PathBuf,
        /// What it holds.
        content: Content,
    },
    /// The folder does not hold one series that is meant, but none or several.
    #[error("{}: {}", path.display(), match wanted {
        None => format!("holds {matching} series"),
        Some(wanted) if *matching == 0 => format!("holds no series '{wanted}'"),
        Some(wanted) => format!("holds {matching} series '{wanted}'"),
    })]
    Series {
        /// The folder.
        path: PathBuf,
        /// What was asked for, if anything.
        wanted: Option<String>,
        /// How many series are meant by that.
        matching: usize,
        /// All series of the folder, in words.
        present: Vec<String>,
    },
    /// A value is no whole number, so it is no label.
    #[error("the volume holds the value {value}, which is no label")]
    NotALabel {
        /// The value.
        value: String,
    },
    /// No segment has this name.
    #[error("no segment is called '{name}'")]
    SegmentMissing {
        /// The name.
        name: String,
        /// The segments that there are, in words; empty where the file names none.
        present: String,
    },
    /// Several segments have this name.
    #[error("{count} segments are called '{name}'")]
    SegmentAmbiguous {
        /// The name.
        name: String,
        /// How many have it.
        count: usize,
        /// Those, in words.
        present: String,
    },
    /// Several layers hold the label.
    #[error("{found} of the {layers} layers hold the label {label}")]
    LabelAmbiguous {
        /// The label.
        label: i64,
        /// Layers that hold it.
        found: usize,
        /// All layers.
        layers: usize,
        /// The segments with this number, in words.
        present: String,
    },
}

/// What a file holds that is no volume.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Content {
    /// First particles, as the program `seed` writes them.
    Seeds,
    /// Settled particles, as the program `particles` writes them.
    Particles,
    /// A checkpoint of the program `particles`.
    Checkpoint,
    /// Polygons in VTK's XML format.
    SurfaceVtk,
    /// An unstructured grid in VTK's XML format.
    TetrahedraVtk,
    /// VTK's older text format.
    LegacyVtk,
    /// A surface or points in PLY.
    SurfacePly,
    /// A surface in STL.
    SurfaceStl,
    /// A surface in OBJ.
    SurfaceObj,
    /// One file of a DICOM series.
    DicomSlice,
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
        })
    }
}

/// Result of work on a volume.
pub type Result<T> = std::result::Result<T, Error>;

impl Error {
    /// Why it matters.
    pub fn reason(&self) -> String {
        let reason = match self {
            Self::File(error) => return error.reason(),
            Self::NotAVolume { content: Content::DicomSlice, .. } => {
                "a volume is the whole series, with one slice in each file"
            }
            Self::NotAVolume { .. } => "a volume is needed: a scan or a label map",
            Self::Series { .. } => "a volume is made from the slices of one series",
            Self::NotALabel { .. } => "labels are whole numbers",
            Self::SegmentMissing { .. } => "there would be nothing to extract for it",
            Self::SegmentAmbiguous { .. } => "it is not clear which one is meant",
            Self::LabelAmbiguous { .. } => {
                "segments of different layers may overlap, so that the number does not say which one is meant"
            }
        };
        reason.to_owned()
    }

    /// What can be done.
    pub fn remedy(&self) -> String {
        match self {
            Self::File(error) => error.remedy(),
            Self::NotAVolume { content, .. } => match content {
                Content::DicomSlice => "give the folder that the files of the series lie in",
                Content::LegacyVtk => "open it in ParaView or pyvista and save the image as .vti",
                _ => "give the volume that it was made from",
            }
            .to_owned(),
            Self::Series { present, .. } => {
                format!("choose one by its description, number or UID: {}", present.join("; "))
            }
            Self::NotALabel { .. } => "give a label volume, or extract an iso value instead of labels".to_owned(),
            Self::SegmentMissing { present, .. } if present.is_empty() => {
                "the file gives its labels no names: choose them by number".to_owned()
            }
            Self::SegmentMissing { present, .. } => format!("choose among the segments: {present}"),
            Self::SegmentAmbiguous { present, .. } => {
                format!("give them names of their own, or choose by number: {present}")
            }
            Self::LabelAmbiguous { present, .. } => format!("choose by name: {present}"),
        }
    }

    /// The operating system's error on a file.
    pub(crate) fn file(path: &Path, doing: &str, source: std::io::Error, remedy: impl Into<String>) -> Self {
        isoparticles_file::error::Error::system(path, doing, source, remedy).into()
    }
}

/// What a file holds is not usable.
pub(crate) fn bad(
    path: &Path,
    problem: impl fmt::Display,
    reason: impl Into<String>,
    remedy: impl Into<String>,
) -> Error {
    isoparticles_file::error::Error::contents(path, problem, reason, remedy).into()
}
