//! Paths along junction curves: polylines with steps of at most about a fifth of a voxel (see
//! `follow.rs` in `common/field/src/materials/complex/`).

use glam::DVec3;

/// Maximum length of the path along a curve between the ends of a segment, in units of the length
/// of the segment or of a voxel, whichever is longer. It allows for hairpins.
pub(super) const LONGEST_WAY: f64 = 6.0;

/// Returns the length of a path in mm.
pub(super) fn length(way: &[DVec3]) -> f64 {
    way.windows(2).map(|step| step[0].distance(step[1])).sum()
}
