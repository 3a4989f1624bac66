//! User-facing errors of the stages in three parts: what happened (file, value), why it matters,
//! and what to do next.
//!
//! Libraries have their own errors, which do not depend on programs and options. They are converted
//! here.

use isoparticles_volume::Content;
use std::fmt::Display;
use std::path::Path;

/// How a stage fails; docs/developer/architecture.md lists the exit codes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// Bad usage or input: exit code 2.
    Input,
    /// No usable GPU although one was required: exit code 3.
    Gpu,
    /// Interrupted: exit code 130.
    Interrupted,
}

/// An error in three parts.
#[derive(Clone, Debug, thiserror::Error)]
#[error("{what}\n  why it matters: {why}\n  what to do: {next}")]
pub struct Error {
    /// How the program should exit.
    pub kind: Kind,
    /// What happened, with the file and the value.
    pub what: String,
    /// Why the stage cannot go on.
    pub why: String,
    /// What the user can do next.
    pub next: String,
}

/// Result of a fallible operation in a stage.
pub type Result<T> = std::result::Result<T, Error>;

impl Error {
    /// Bad usage or input (exit code 2).
    pub fn input(what: impl Into<String>, why: impl Into<String>, next: impl Into<String>) -> Self {
        Self { kind: Kind::Input, what: what.into(), why: why.into(), next: next.into() }
    }

    /// No usable GPU (exit code 3).
    pub fn gpu(what: impl Into<String>, why: impl Into<String>, next: impl Into<String>) -> Self {
        Self { kind: Kind::Gpu, what: what.into(), why: why.into(), next: next.into() }
    }

    /// The user interrupted the run (exit code 130).
    pub fn interrupted(what: impl Into<String>) -> Self {
        Self {
            kind: Kind::Interrupted,
            what: what.into(),
            why: "the run was stopped before its output was complete".into(),
            next: "run the same command again; a checkpoint, if one was asked for, can be resumed".into(),
        }
    }

    /// An operating-system error on a file (exit code 2).
    pub fn file(path: &Path, doing: &str, source: &std::io::Error, next: impl Into<String>) -> Self {
        Self::input(format!("{}: cannot {doing}: {source}", path.display()), "the stage needs this file", next)
    }

    /// An input error about a file (exit code 2).
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
                Self::input(error.to_string(), error.reason(), "give another name, or --force to replace it")
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
                format!("choose one with --series (its description, number or UID): {}", present.join("; "))
            }
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

/// The stage that accepts a file that is not a volume, and the file to use instead.
fn taken_by(content: Content) -> Option<&'static str> {
    const SURFACE: &str = "tetmesh-check fills a closed .vtp surface with tetrahedra, and 'reconstruct --method tight-cocone' takes the \
                           points of .vtp and .ply files; for distfield, give the volume that the surface was made from";
    const OTHER_SURFACE: &str = "save it as .vtp: tetmesh-check fills a closed surface with tetrahedra; for distfield, give the \
                                 volume that the surface was made from";
    match content {
        Content::Seeds => Some("particles takes it; for distfield, give the volume that it was made from"),
        Content::Particles => Some("reconstruct takes it; for distfield, give the volume that it was made from"),
        Content::Checkpoint => Some("'particles --resume' takes it"),
        Content::SurfaceVtk | Content::SurfacePly => Some(SURFACE),
        Content::SurfaceStl | Content::SurfaceObj => Some(OTHER_SURFACE),
        Content::TetrahedraVtk | Content::LegacyVtk | Content::DicomSlice => None,
    }
}
