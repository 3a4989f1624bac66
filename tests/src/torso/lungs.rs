//! The lung-like part: two large lobed solids with hollows for the heart, the diaphragm and the
//! ribs. Fissures separate the lobes but leave each lung in one piece.

use super::heart::Heart;
use super::pieces::{Ellipsoid, smooth_intersection};
use super::ribs::{self, Ribs};
use glam::DVec3;

/// Gap between a lung and the heart or a rib, in mm of the reference frame.
const PLEURA: f64 = 4.0;

pub(super) struct Lungs {
    sides: [Side; 2],
}

struct Side {
    /// +1 on the left, -1 on the right.
    sign: f64,
    hull: Ellipsoid,
    diaphragm: Ellipsoid,
    fissures: Vec<Fissure>,
}

/// A planar cut from the outer side inwards.
struct Fissure {
    normal: DVec3,
    through: DVec3,
    half_width: f64,
    /// Distance of the inner end of the cut from the median plane of the body. Between this plane
    /// and the cut, the lobes stay joined.
    ends_at: f64,
}

impl Lungs {
    pub(super) fn new() -> Self {
        let oblique = |sign: f64| Fissure {
            normal: DVec3::new(0.0, 0.62, 0.78).normalize(),
            through: DVec3::new(sign * 70.0, 0.0, 8.0),
            half_width: 2.5,
            ends_at: 52.0,
        };
        let horizontal = Fissure {
            normal: DVec3::new(0.0, -0.15, 1.0).normalize(),
            through: DVec3::new(-70.0, -30.0, 44.0),
            half_width: 2.5,
            ends_at: 62.0,
        };
        let side = |sign: f64, fissures| Side {
            sign,
            hull: Ellipsoid::aligned([sign * 72.0, -8.0, 2.0], [58.0, 54.0, 98.0]).turned(DVec3::Y, -6.0 * sign),
            diaphragm: Ellipsoid::aligned([sign * 66.0, -6.0, -112.0], [78.0, 74.0, 58.0]),
            fissures,
        };
        Self { sides: [side(1.0, vec![oblique(1.0)]), side(-1.0, vec![oblique(-1.0), horizontal])] }
    }

    pub(super) fn value(&self, q: DVec3, heart: &Heart, ribs: &Ribs) -> f64 {
        let hulls = self.sides.iter().map(|side| side.value(q)).fold(f64::INFINITY, f64::min);
        if hulls > 12.0 {
            return hulls;
        }
        let hulls = smooth_intersection(hulls, ribs::cage_interior(q), 6.0);
        let room = heart.value(q).min(ribs.value(q)) - PLEURA;
        smooth_intersection(hulls, -room, 6.0)
    }
}

impl Side {
    fn value(&self, q: DVec3) -> f64 {
        let hull = smooth_intersection(self.hull.value(q), -self.diaphragm.value(q), 8.0);
        // The two lungs must not meet in the middle.
        let hull = smooth_intersection(hull, 12.0 - self.sign * q.x, 6.0);
        self.fissures.iter().fold(hull, |value, fissure| {
            let slab = (q - fissure.through).dot(fissure.normal).abs() - fissure.half_width;
            let cut = smooth_intersection(slab, fissure.ends_at - self.sign * q.x, 2.0);
            smooth_intersection(value, -cut, 2.0)
        })
    }
}
