//! Ways along junction curves: chains of places, no farther apart than a fifth of a voxel.

use glam::DVec3;

/// A curve is followed from one end of a segment to the other for so many of its lengths (or voxels): round a hairpin.
pub(super) const LONGEST_WAY: f64 = 6.0;

/// Curves nearer to each other than this, in voxels, are one over that length: they share points and segments, of four materials. New points keep a twentieth of h from others
/// ([`crate::queue::NEAREST_FOR_TOPOLOGY`]), and h is seldom below a voxel, so that between nearer ones there is no room for facets. Of parts of `brain_parcellation` and
/// `frog_tissue_labels` in which 345 segments were missing, 23 are with 0.02 and none with 0.05.
pub(crate) const ONE_CURVE: f64 = 0.05;

/// Length of a way, mm.
pub(super) fn length(way: &[DVec3]) -> f64 {
    way.windows(2).map(|step| step[0].distance(step[1])).sum()
}

/// How far along a way its place nearest to another place lies, and how far from that, mm.
pub(super) fn foot(way: &[DVec3], place: DVec3) -> (f64, f64) {
    let (mut passed, mut nearest) = (0.0, (f64::INFINITY, 0.0));
    for step in way.windows(2) {
        let (own, length) = (step[1] - step[0], step[0].distance(step[1]));
        let share = ((place - step[0]).dot(own) / length.powi(2).max(f64::MIN_POSITIVE)).clamp(0.0, 1.0);
        let distance = place.distance_squared(step[0] + share * own);
        if distance < nearest.0 {
            nearest = (distance, passed + share * length);
        }
        passed += length;
    }
    (nearest.1, nearest.0.sqrt())
}
