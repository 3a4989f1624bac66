//! The implicit surface that the particles sample: F = 0 of one object, or the interfaces of many
//! materials.

use glam::DVec3;
use isoparticles_field::materials::{Indicators, MaterialId, Stratum};
use isoparticles_field::spline::CubicSpline;

/// The zero sets on which particles lie. One object has a single zero set, and its particles have
/// no stratum. With many materials the stratum selects the interface.
pub trait Implicit: Sync {
    /// Projects `start` onto the zero set of a stratum by Newton steps (Eq. 5). Returns the point
    /// and the gradient there. `limit` is the maximum total displacement in mm, and `tolerance` is
    /// the maximum distance from the zero set in mm. Returns `None` if the projection fails or if
    /// the point is not on the interface ([`Self::is_real`]).
    fn project(&self, stratum: Option<Stratum>, start: DVec3, limit: f64, tolerance: f64) -> Option<(DVec3, DVec3)>;

    /// Returns whether a point on the zero set of a stratum lies on the interface, that is, whether
    /// no third material has a smaller indicator there.
    fn is_real(&self, stratum: Option<Stratum>, point: DVec3) -> bool;

    /// Returns the minimum voxel edge in mm. Tolerances are fractions of it.
    fn min_spacing(&self) -> f64;
}

impl Implicit for CubicSpline {
    #[inline(always)]
    fn project(&self, _: Option<Stratum>, start: DVec3, limit: f64, tolerance: f64) -> Option<(DVec3, DVec3)> {
        self.project_with_gradient(start, limit, tolerance)
    }

    fn is_real(&self, _: Option<Stratum>, _: DVec3) -> bool {
        true
    }

    #[inline(always)]
    fn min_spacing(&self) -> f64 {
        self.geometry().min_spacing()
    }
}

/// The material interfaces: the points where the indicators of two materials are equal and smaller
/// than all others.
#[derive(Debug)]
pub struct Interfaces<'a, I> {
    indicators: &'a I,
    min_spacing: f64,
}

impl<'a, I: Indicators> Interfaces<'a, I> {
    /// Creates the interfaces from the indicators of all materials. `min_spacing` is the minimum
    /// voxel edge in mm.
    pub fn new(indicators: &'a I, min_spacing: f64) -> Self {
        Self { indicators, min_spacing }
    }
}

/// Returns the two materials of an interface, the one with the higher number first. The first
/// indicator minus the second is negative inside the first material, so the gradient of this
/// difference points to the second.
#[inline(always)]
fn sides(stratum: Option<Stratum>) -> Option<[MaterialId; 2]> {
    match stratum?.materials() {
        &[low, high] => Some([high, low]),
        _ => None,
    }
}

impl<I: Indicators> Implicit for Interfaces<'_, I> {
    #[inline(always)]
    fn project(&self, stratum: Option<Stratum>, start: DVec3, limit: f64, tolerance: f64) -> Option<(DVec3, DVec3)> {
        self.indicators.place_on_interface(sides(stratum)?, start, limit, tolerance)
    }

    fn is_real(&self, stratum: Option<Stratum>, point: DVec3) -> bool {
        sides(stratum).is_some_and(|own| self.indicators.clearance(point, &own) > 0.0)
    }

    #[inline(always)]
    fn min_spacing(&self) -> f64 {
        self.min_spacing
    }
}
