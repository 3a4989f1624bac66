//! Reads the surface that the particles sample (one object or many materials), and rejects seeds
//! and options that do not match it.

use isoparticles_field::spline::CubicSpline;
use isoparticles_stage::error::{Error, Result};
use isoparticles_stage::field_file::{FieldKind, read_field};
use isoparticles_stage::history::History;
use isoparticles_stage::materials_file::{MaterialsFile, read_materials};
use isoparticles_volume::Geometry;
use std::path::Path;

/// The surface on which the particles lie.
pub(crate) enum Ground {
    /// F = 0 of one object.
    Object {
        /// The implicit function F.
        surface: CubicSpline,
        /// History of the file, if it has one.
        history: Option<History>,
    },
    /// The interfaces of many materials.
    Materials(MaterialsFile),
}

impl Ground {
    /// Reads a distance field, or the indicators of many materials.
    ///
    /// # Errors
    /// If the file cannot be read.
    pub(crate) fn read(path: &Path, is_materials: bool) -> Result<Self> {
        if is_materials {
            return Ok(Self::Materials(read_materials(path)?));
        }
        let distance = read_field(path, FieldKind::Distance)?;
        Ok(Self::Object { surface: CubicSpline::new(&distance.image), history: distance.history })
    }

    /// Returns the voxel grid.
    pub(crate) fn geometry(&self) -> &Geometry {
        match self {
            Self::Object { surface, .. } => surface.geometry(),
            Self::Materials(file) => file.materials.geometry(),
        }
    }

    /// Returns the history of the file, if it has one.
    pub(crate) fn history(&self) -> Option<History> {
        match self {
            Self::Object { history, .. } => history.clone(),
            Self::Materials(file) => file.history.clone(),
        }
    }

    /// Returns the name of the surface for messages.
    pub(crate) fn name(&self) -> &'static str {
        match self {
            Self::Object { .. } => "F = 0",
            Self::Materials(_) => "their interface",
        }
    }
}

/// Rejects seeds with strata for one object and seeds without strata for many materials.
///
/// # Errors
/// If seeds and field do not match.
pub(crate) fn check_kind((ground, is_materials): (&Path, bool), (seeds, have_strata): (&Path, bool)) -> Result<()> {
    let mismatch = |found: &str, given: &str, why: &str| {
        let what =
            format!("{}: contains particles of {found}, but {} contains {given}", seeds.display(), ground.display());
        Err(Error::input(what, why, "use the file that the seeds were made from (--distfield), or run seed again"))
    };
    match (is_materials, have_strata) {
        (true, false) => {
            let why = "these particles are not assigned to interfaces";
            mismatch("one object", "the indicators of many materials", why)
        }
        (false, true) => {
            let why = "each of these particles lies on an interface or a junction";
            mismatch("many materials", "the distance field of one object", why)
        }
        _ => Ok(()),
    }
}

/// Rejects more than one level for many materials.
///
/// # Errors
/// If `levels` is greater than 1.
pub(crate) fn check_levels(levels: Option<u32>) -> Result<()> {
    match levels.filter(|&levels| levels > 1) {
        None => Ok(()),
        Some(levels) => Err(Error::input(
            format!("--levels {levels}: many materials are settled on one level"),
            "particles on junction curves have the spacing of h; those of coarser levels do not fit between them",
            "leave --levels out of PARTICLES_OPTIONS, or set it to 1",
        )),
    }
}
