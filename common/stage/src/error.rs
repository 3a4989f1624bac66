//! User-facing errors of the stages in three parts: what happened (with file and value), why it
//! matters, and what to do next.
//!
//! Libraries define their own errors, which do not depend on programs or options. This module
//! converts them.

use isoparticles_volume::Content;
use std::fmt::Display;
use std::path::Path;

/// Kinds of stage failure. docs/developer/architecture.md lists the exit codes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// Invalid usage or input: exit code 2.
    Input,
    /// A GPU is required, but none is usable: exit code 3.
    Gpu,
    /// Interrupted: exit code 130.
    Interrupted,
}

/// An error in three parts.
#[derive(Clone, Debug, thiserror::Error)]
#[error("{what}\n  why it matters: {why}\n  what to do: {next}")]
pub struct Error {
    /// Kind of failure, which determines the exit code.
    pub kind: Kind,
    /// The problem, with the file and the value.
    pub what: String,
    /// The reason why the stage cannot continue.
    pub why: String,
    /// Instructions for the user.
    pub next: String,
}

/// Result of a fallible operation in a stage.
pub type Result<T> = std::result::Result<T, Error>;

impl Error {
    /// Creates an error about invalid usage or input (exit code 2).
    pub fn input(what: impl Into<String>, why: impl Into<String>, next: impl Into<String>) -> Self {
        Self { kind: Kind::Input, what: what.into(), why: why.into(), next: next.into() }
    }

    /// Creates an error for a missing or unusable GPU (exit code 3).
    pub fn gpu(what: impl Into<String>, why: impl Into<String>, next: impl Into<String>) -> Self {
        Self { kind: Kind::Gpu, what: what.into(), why: why.into(), next: next.into() }
    }

    /// Creates an error for a run that the user interrupted (exit code 130).
    pub fn interrupted(what: impl Into<String>) -> Self {
        Self {
            kind: Kind::Interrupted,
            what: what.into(),
            why: "the run was stopped before its output was complete".into(),
            next: "run the same command again; make and 'particles --resume' continue from the checkpoint".into(),
        }
    }

    /// Creates an error from an operating-system error on a file (exit code 2).
    pub fn file(path: &Path, doing: &str, source: &std::io::Error, next: impl Into<String>) -> Self {
        Self::input(format!("{}: cannot {doing}: {source}", path.display()), "the stage needs this file", next)
    }

    /// Creates an input error about a file (exit code 2).
    pub fn of_file(path: &Path, what: impl Display, why: impl Into<String>, next: impl Into<String>) -> Self {
        Self::input(format!("{}: {what}", path.display()), why, next)
    }
}

impl From<isoparticles_file::monitor::Interrupted> for Error {
    fn from(interrupted: isoparticles_file::monitor::Interrupted) -> Self {
        Self::interrupted(interrupted.to_string())
    }
}

impl From<isoparticles_file::error::Error> for Error {
    fn from(error: isoparticles_file::error::Error) -> Self {
        use isoparticles_file::error::Error as File;
        match &error {
            File::Interrupted { .. } => Self::interrupted(error.to_string()),
            File::Exists { .. } => {
                Self::input(error.to_string(), error.reason(), "use another name, or --force to replace the file")
            }
            File::System { remedy, .. } => Self::input(error.to_string(), "the stage needs this file", remedy),
            _ => Self::input(error.to_string(), error.reason(), error.remedy()),
        }
    }
}

impl From<isoparticles_volume::Error> for Error {
    fn from(error: isoparticles_volume::Error) -> Self {
        use isoparticles_volume::Error as Volume;
        let next = match error {
            Volume::File(error) => return error.into(),
            Volume::NotAVolume { content, .. } => taken_by(content).map_or_else(|| error.remedy(), str::to_owned),
            Volume::Series { ref present, .. } => {
                format!("choose one in SERIES (--series) by its description, number or UID: {}", present.join("; "))
            }
            Volume::NotALabel { .. } => "use a label map, or set ISO (--iso) instead of LABELS or MATERIALS".to_owned(),
            _ => error.remedy(),
        };
        Self::input(error.to_string(), error.reason(), next)
    }
}

impl From<isoparticles_mesh::Error> for Error {
    fn from(error: isoparticles_mesh::Error) -> Self {
        match error {
            isoparticles_mesh::Error::File(error) => error.into(),
            isoparticles_mesh::Error::Vtk(error) => error.into(),
            _ => Self::input(error.to_string(), error.reason(), error.remedy()),
        }
    }
}

/// Returns advice for a file that is not a volume: the stage that accepts it, and what to use
/// instead.
fn taken_by(content: Content) -> Option<&'static str> {
    const SURFACE: &str = "distfield needs the volume that the surface was made from; tetmesh-check fills a closed \
                           .vtp surface with tetrahedra, and 'reconstruct --method tight-cocone' reads the points of \
                           .vtp and .ply files";
    const OTHER_SURFACE: &str = "distfield needs the volume that the surface was made from; tetmesh-check fills a \
                                 closed surface with tetrahedra if it is saved as .vtp";
    match content {
        Content::Seeds => Some("distfield needs the volume that the seeds were made from; the seeds are for particles"),
        Content::Particles => {
            Some("distfield needs the volume that the particles were made from; the particles are for reconstruct")
        }
        Content::Checkpoint => Some("the checkpoint is for 'particles --resume'; distfield needs a volume"),
        Content::SurfaceVtk | Content::SurfacePly => Some(SURFACE),
        Content::SurfaceStl | Content::SurfaceObj => Some(OTHER_SURFACE),
        Content::TetrahedraVtk
        | Content::LegacyVtk
        | Content::DicomSlice
        | Content::Hdf5
        | Content::Matlab
        | Content::Zarr => None,
    }
}
