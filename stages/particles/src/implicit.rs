//! What particles live on: F = 0 of one object, or the sheets between many materials.

use glam::DVec3;
use isoparticles_field::materials::{Indicators, MaterialId, Stratum};
use isoparticles_field::spline::CubicSpline;

/// The zero sets that particles live on. One object has one, and its particles are of no stratum; of many materials the stratum names it.
pub trait Implicit: Sync {
    /// The point near `start` of the zero set of a stratum, by Newton steps (Eq. 5), with the gradient there. `limit` is the longest total move (mm), `tolerance`
    /// the distance from the zero set that is allowed (mm). `None` when there is none, or when it is not of the stratum.
    fn project(&self, stratum: Option<Stratum>, start: DVec3, limit: f64, tolerance: f64) -> Option<(DVec3, DVec3)>;

    /// Whether the zero set of a stratum is real at a place on it: no other material is nearer there.
    fn is_real(&self, stratum: Option<Stratum>, place: DVec3) -> bool;

    /// Smallest edge of a voxel, mm: tolerances are shares of it.
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

/// The sheets between materials, where the indicators of two are equal and the smallest.
#[derive(Debug)]
pub struct Sheets<'a, I> {
    indicators: &'a I,
    min_spacing: f64,
}

impl<'a, I: Indicators> Sheets<'a, I> {
    /// Of the materials whose indicators these are, with the smallest edge of a voxel (mm).
    pub fn new(indicators: &'a I, min_spacing: f64) -> Self {
        Self { indicators, min_spacing }
    }
}

/// The two materials of a sheet, that on the negative side of G first: the one with the higher number, so that the gradient points to the lower.
#[inline(always)]
fn sides(stratum: Option<Stratum>) -> Option<[MaterialId; 2]> {
    match stratum?.materials() {
        &[low, high] => Some([high, low]),
        _ => None,
    }
}

impl<I: Indicators> Implicit for Sheets<'_, I> {
    #[inline(always)]
    fn project(&self, stratum: Option<Stratum>, start: DVec3, limit: f64, tolerance: f64) -> Option<(DVec3, DVec3)> {
        self.indicators.place_on_sheet(sides(stratum)?, start, limit, tolerance)
    }

    fn is_real(&self, stratum: Option<Stratum>, place: DVec3) -> bool {
        sides(stratum).is_some_and(|own| self.indicators.clearance(place, &own) > 0.0)
    }

    #[inline(always)]
    fn min_spacing(&self) -> f64 {
        self.min_spacing
    }
}
