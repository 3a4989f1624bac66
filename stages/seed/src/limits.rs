//! Checks the number of particles before they are placed.

use crate::args::Args;
use crate::sampling::{BYTES_PER_PARTICLE, COMPONENT_MINIMUM};
use isoparticles_stage::cli::Context;
use isoparticles_stage::error::{Error, Result};

/// Returns an error if h is too large for the object, or if the particles do not fit into memory.
/// Calls `predicted` only if --count is not given.
pub(crate) fn check_prediction(args: &Args, predicted: impl FnOnce() -> f64, context: &Context) -> Result<()> {
    let sizes = args.sizefield.display();
    let count = args.count.map_or_else(predicted, |count| count as f64);
    // a missing surface has its own error message
    if count > 0.0 && count < COMPONENT_MINIMUM as f64 && args.count.is_none() {
        return Err(Error::input(
            format!("{sizes}: h is too large for the object: it gives {count:.1} particles on the whole surface"),
            format!("a closed surface needs at least {COMPONENT_MINIMUM} particles"),
            "lower SIZE or MIN_SIZE (sizefield --uniform, --min-size), or leave them out: the defaults follow the \
             object",
        ));
    }
    context.check_memory(
        BYTES_PER_PARTICLE * count,
        &format!("{sizes}: seeding {count:.0} particles"),
        "raise SIZE or MIN_SIZE (sizefield --uniform, --min-size), lower COUNT (--count), or set \
         SIZEFIELD_OPTIONS=\"--scale 2\"",
    )
}
