//! The ribcage-like part. Ribs 1 to 7 connect the spine to the sternum; ribs 8 to 10 are attached
//! only to the spine. The floating pairs 11 and 12, the collar bones and the shoulder blades are
//! separate components.

use super::pieces::{FAR, Tube, smooth_union};
use glam::{DMat3, DVec3};
use std::f64::consts::PI;

/// Number of components: the ribcage, four floating ribs, two collar bones and two shoulder blades.
pub(super) const COMPONENTS: usize = 9;
/// Genus: fourteen ribs connect the spine to the sternum. This graph has 14 edges, 2 nodes and
/// hence 13 independent loops.
pub(super) const GENUS: usize = 13;

/// Width of the rounded transition between a rib and the spine or the sternum, in mm of the
/// reference frame.
const BLEND: f64 = 3.0;
/// y coordinate at which the ribs leave the spine, in mm of the reference frame.
const BACK: f64 = 52.0;
/// Distance between the centre line of a rib and the interior of the cage, in mm of the reference
/// frame.
const CLEARANCE: f64 = 9.0;

pub(super) struct Ribs {
    tubes: Vec<Tube>,
    blades: Vec<Blade>,
}

/// A shoulder blade: a flat elliptic disc, dilated by a radius.
struct Blade {
    centre: DVec3,
    axes: DMat3,
}

impl Blade {
    const HALF_WIDTH: f64 = 24.0;
    const HALF_HEIGHT: f64 = 34.0;
    const RADIUS: f64 = 3.5;

    fn value(&self, q: DVec3) -> f64 {
        let p = self.axes.transpose() * (q - self.centre);
        let (u, v) = (p.x / Self::HALF_WIDTH, p.z / Self::HALF_HEIGHT);
        let level = u.hypot(v);
        let slope = (u / Self::HALF_WIDTH).hypot(v / Self::HALF_HEIGHT).max(1e-9);
        let across = if level > 1.0 { level * (level - 1.0) / slope } else { 0.0 };
        across.hypot(p.y) - Self::RADIUS
    }
}

/// Returns the semi-axes of the elliptic hoop of a rib along x and y, in mm of the reference frame.
/// Ribs are numbered from 0; a fractional number denotes a hoop between two ribs. Hoops are narrow
/// at the top and widen downwards.
fn hoop(rib: f64) -> (f64, f64) {
    let down = 1.0 - rib / 11.0;
    (142.0 * (1.0 - 0.58 * down.powi(3)), 64.0 * (1.0 - 0.45 * down.powi(3)))
}

/// Returns an approximate signed distance to the boundary of the cage interior, which is
/// [`CLEARANCE`] inside the centre lines of the ribs. It is accurate only near zero.
pub(super) fn cage_interior(q: DVec3) -> f64 {
    // Find the fractional number of the rib whose slanted hoop passes through `q`. The size of the
    // hoop depends on this number, so the search is iterative.
    let mut rib = (98.0 - q.z) / 15.5;
    for _ in 0..3 {
        let (half_width, half_depth) = hoop(rib.clamp(0.0, 11.0));
        let cos = ((q.y - BACK + half_depth) / half_depth).clamp(-1.0, 1.0);
        let across = (q.x / half_width).abs().min(1.0);
        rib = (98.0 - q.z - 17.0 * (1.0 - cos) - 14.0 * across) / 15.5;
    }
    let (half_width, half_depth) = hoop(rib.clamp(0.0, 11.0));
    let (width, depth) = (half_width - CLEARANCE, half_depth - CLEARANCE);
    let level = (q.x / width).hypot((q.y - BACK + half_depth) / depth);
    (depth * (level - 1.0)).max(-15.5 * rib)
}

/// Returns a point on a rib. `t` runs from the spine (0) to the sternum (1); `side` is +1 on the
/// left.
fn rib_point(rib: usize, side: f64, t: f64) -> DVec3 {
    let (half_width, half_depth) = hoop(rib as f64);
    let (sin, cos) = (PI * t).sin_cos();
    let back = 98.0 - 15.5 * rib as f64;
    let front = 64.0 - 13.5 * rib as f64;
    let ease = t * t * (3.0 - 2.0 * t);
    let droop = 12.0 + 0.6 * rib as f64;
    DVec3::new(
        side * half_width * sin,
        BACK - half_depth + half_depth * cos,
        back + (front - back) * ease - droop * sin,
    )
}

impl Ribs {
    pub(super) fn new() -> Self {
        let mut tubes = Vec::new();
        // The radius of the spine varies periodically, once per vertebra. Spine and sternum come
        // first, so that the ribs blend into them.
        let spine = (0..=140).map(|i| {
            let z = -106.0 + 1.5 * f64::from(i);
            (DVec3::new(0.0, 56.0, z), 13.0 + 1.6 * (2.0 * PI * z / 15.5).cos())
        });
        tubes.push(Tube::new(spine.collect()));
        let sternum = (0..=36).map(|i| {
            let rib = f64::from(i) / 6.0;
            let below = rib.floor().min(5.0);
            let (lower, upper) = (rib_point(below as usize, 1.0, 1.0), rib_point(below as usize + 1, 1.0, 1.0));
            (lower + (rib - below) * (upper - lower), 6.0)
        });
        tubes.push(Tube::new(sternum.collect()));
        for rib in 0..12 {
            let (start, end) = match rib {
                0..=6 => (0.0, 1.0),
                7 => (0.0, 0.86),
                8 => (0.0, 0.80),
                9 => (0.0, 0.72),
                // Floating ribs start away from the spine.
                10 => (0.065, 0.52),
                _ => (0.07, 0.38),
            };
            for side in [-1.0, 1.0] {
                let points = (0..=56).map(|i| {
                    let t = start + (end - start) * f64::from(i) / 56.0;
                    (rib_point(rib, side, t), 4.6 - 0.5 * (2.0 * PI * t).cos())
                });
                tubes.push(Tube::new(points.collect()));
            }
        }
        for side in [-1.0, 1.0] {
            tubes.push(Tube::smooth(
                &[
                    ([side * 19.0, -26.0, 80.0], 6.0),
                    ([side * 48.0, -32.0, 90.0], 5.0),
                    ([side * 85.0, -14.0, 98.0], 5.0),
                    ([side * 122.0, -4.0, 98.0], 6.0),
                ],
                10,
            ));
        }
        let blades = [-1.0, 1.0]
            .map(|side| Blade {
                centre: DVec3::new(side * 98.0, 50.0, 46.0),
                axes: DMat3::from_rotation_z(-side * 38.0_f64.to_radians()),
            })
            .into();
        Self { tubes, blades }
    }

    pub(super) fn value(&self, q: DVec3) -> f64 {
        let mut value = FAR;
        for tube in &self.tubes {
            value = smooth_union(value, tube.value(q, value + BLEND), BLEND);
        }
        self.blades.iter().fold(value, |value, blade| value.min(blade.value(q)))
    }
}
