//! Contracts the segments of junction curves that still limit the quality of triangles after an
//! improvement, and improves their surroundings again.

use super::contract::{Which, contract};
use super::improve::improve;
use crate::improve::{ImproveOptions, ImproveReport, Step};
use crate::interfaces::Interfaces;
use glam::DVec3;
use isoparticles_field::materials::Indicators;
use isoparticles_stage::error::Result;

/// Maximum number of rounds. `brain_parcellation` at 100,000 vertices has 80, 1 and 0 contractions
/// in three rounds.
const MOST_ROUNDS: usize = 3;

/// Contracts segments and improves the triangles near the contractions, until no segment can be
/// contracted or [`MOST_ROUNDS`] is reached. The improvements use `options`, within these
/// surroundings. `report` gets the sum of the moves and the final quality. Returns the number of
/// contractions.
///
/// # Errors
/// Those of [`improve`].
pub(super) fn simplify(
    interfaces: &mut Interfaces,
    indicators: &dyn Indicators,
    size: &(dyn Fn(DVec3) -> f64 + Sync),
    (options, report): (&ImproveOptions, &mut ImproveReport),
    step: Step,
) -> Result<usize> {
    let mut count = 0;
    for _ in 0..MOST_ROUNDS {
        let mut dimensions = interfaces.dimensions();
        let points = contract(interfaces, &mut dimensions, Which::Limiting, size);
        if points.is_empty() {
            break;
        }
        count += points.len();
        let mut around = vec![false; interfaces.mesh.vertices.len()];
        points.iter().for_each(|&v| around[v as usize] = true);
        let options = ImproveOptions { around: Some(&around), ..*options };
        let (next, _) = improve(interfaces, &dimensions, indicators, None, size, &options, step)?;
        report.moves += next.moves;
        (report.after, report.below_target) = (next.after, next.below_target);
    }
    Ok(count)
}
