//! Rejects seeds and options that do not match the surface that the particles sample.

use isoparticles_stage::error::{Error, Result};
use std::path::Path;

/// Rejects seeds with strata for one object and seeds without strata for many materials.
///
/// # Errors
/// If seeds and field do not match.
pub(crate) fn check_kind((distance, is_materials): (&Path, bool), (seeds, have_strata): (&Path, bool)) -> Result<()> {
    let mismatch = |found: &str, given: &str, why: &str| {
        let what =
            format!("{}: contains particles of {found}, but {} contains {given}", seeds.display(), distance.display());
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
