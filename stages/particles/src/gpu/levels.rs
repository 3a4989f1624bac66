//! Levels of bins, one for each octave of h. The levels are computed once per run from the fields
//! near the surface. They do not depend on the particles, so a resumed run has the same levels.
//!
//! A particle belongs to the last level k for which `largest / 2^k` is at least its h, where
//! `largest` is the maximum h. The bin edge of level k is the maximum reach of the neighbour lists
//! of its particles, [`BIN_REACH`] times `largest / 2^k`. A query therefore visits at most 27 bins
//! per level. A single level corresponds to the paper's global bin edge.

use super::constants::{BIN_REACH, MOST_LEVELS};
use crate::state::Fields;
use glam::{DVec3, UVec3, Vec3};
use isoparticles_field::sizing::SizingField;
use isoparticles_volume::Geometry;
use rayon::prelude::*;

/// Maximum number of bins in a level. If a level would need more, its bins are made wider, which
/// does not change the results. The count and start of a bin take 8 bytes, so a level takes at most
/// 32 MB.
const MOST_BINS: f64 = 4e6;

/// Returns the voxel whose centre is the origin of device positions. It is near the middle of the
/// grid, so that f32 positions have the best resolution. Because the origin is the centre of a
/// voxel, conversion to a grid index adds an integer and does not round the fractional position
/// within a cell.
pub(crate) fn centre_voxel(geometry: &Geometry) -> UVec3 {
    UVec3::from_array(geometry.size.map(|n| n as u32 / 2))
}

/// Returns the origin of device positions, in mm in the grid frame.
pub(crate) fn device_origin(geometry: &Geometry) -> DVec3 {
    geometry.index_to_grid(centre_voxel(geometry).as_dvec3())
}

/// One level of bins.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct BinLevel {
    /// Edge of a bin in mm.
    pub edge: f32,
    /// Maximum h in mm.
    pub largest: f32,
    /// Index of the first bin.
    pub first_bin: u32,
    /// Number of bins along each axis.
    pub bins: UVec3,
}

/// All levels, from the coarsest to the finest.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct BinLevels {
    /// Device position in mm of the lower corner of bin (0, 0, 0).
    pub origin: Vec3,
    pub levels: Vec<BinLevel>,
}

/// Ranges of h and of position near the surface.
#[derive(Clone, Copy)]
struct Range {
    smallest: f32,
    largest: f32,
    low: DVec3,
    high: DVec3,
}

impl Range {
    const NOTHING: Self =
        Self { smallest: f32::INFINITY, largest: 0.0, low: DVec3::INFINITY, high: DVec3::NEG_INFINITY };

    fn join(self, other: Self) -> Self {
        Self {
            smallest: self.smallest.min(other.smallest),
            largest: self.largest.max(other.largest),
            low: self.low.min(other.low),
            high: self.high.max(other.high),
        }
    }
}

impl BinLevels {
    /// Creates the levels from the fields near the surface. If `graded` is false, there is one
    /// level.
    pub(crate) fn new(fields: &Fields, graded: bool) -> Self {
        // the band covers the cells that F = 0 crosses and the adjacent cells
        let near = near_surface(fields, 2.0 * fields.surface.geometry().spacing.length());
        let range = if near.largest > 0.0 { near } else { near_surface(fields, f64::INFINITY) };
        Self::of_range(fields.surface.geometry(), &range, graded)
    }

    /// Creates the levels for the whole grid.
    pub(crate) fn everywhere(sizing: &SizingField, graded: bool) -> Self {
        let image = sizing.image();
        let sizes = || image.data.iter().copied();
        let range = Range {
            smallest: sizes().fold(f32::INFINITY, f32::min),
            largest: sizes().fold(0.0, f32::max),
            low: DVec3::ZERO,
            high: image.geometry.upper_corner(),
        };
        Self::of_range(&image.geometry, &range, graded)
    }

    fn of_range(geometry: &Geometry, range: &Range, graded: bool) -> Self {
        let origin = device_origin(geometry);
        let octaves = (f64::from(range.largest) / f64::from(range.smallest)).log2().floor() as usize + 1;
        Self::over(
            (range.low - origin).as_vec3(),
            (range.high - origin).as_vec3(),
            range.largest,
            if graded { octaves.min(MOST_LEVELS) } else { 1 },
        )
    }

    /// Creates `count` levels that cover a box; `largest` is the maximum h in mm.
    pub(crate) fn over(low: Vec3, high: Vec3, largest: f32, count: usize) -> Self {
        let extent = (high - low).as_dvec3().max(DVec3::splat(f64::MIN_POSITIVE));
        let mut first_bin = 0;
        let levels = (0..count)
            .map(|k| {
                let largest = largest / (1u32 << k) as f32;
                // widened because the device computes bin coordinates in f32
                let reach = 1.0001 * BIN_REACH * f64::from(largest);
                let bins_at = |edge: f64| (extent / edge).floor() + 1.0;
                let mut edge = reach;
                while bins_at(edge).element_product() > MOST_BINS {
                    edge *= 1.1;
                }
                let level = BinLevel { edge: edge as f32, largest, first_bin, bins: bins_at(edge).as_uvec3() };
                first_bin += level.bins.element_product();
                level
            })
            .collect();
        Self { origin: low, levels }
    }

    /// Returns the number of bins in all levels.
    pub(crate) fn bin_total(&self) -> u32 {
        self.levels.last().map_or(0, |l| l.first_bin + l.bins.element_product())
    }
}

/// Returns the ranges of h and of position over the voxels with |F| <= `band` mm. Uses the spline
/// coefficients in place of the values of F; they differ by a small fraction of a voxel.
fn near_surface(fields: &Fields, band: f64) -> Range {
    let geometry = fields.surface.geometry();
    let [nx, ny, _] = geometry.size;
    let sizes = &fields.sizing.image().data;
    let band = band as f32;
    fields
        .surface
        .coefficients()
        .par_chunks(nx * ny)
        .zip(sizes.par_chunks(nx * ny))
        .enumerate()
        .map(|(k, (surface, sizing))| {
            let mut range = Range::NOTHING;
            for (j, (surface, sizing)) in surface.chunks(nx).zip(sizing.chunks(nx)).enumerate() {
                let (mut first, mut last) = (usize::MAX, 0);
                for (i, (f, h)) in surface.iter().zip(sizing).enumerate() {
                    if f.abs() <= band {
                        range.smallest = range.smallest.min(*h);
                        range.largest = range.largest.max(*h);
                        first = first.min(i);
                        last = i;
                    }
                }
                if first <= last {
                    let at = |i: usize| geometry.index_to_grid(DVec3::new(i as f64, j as f64, k as f64));
                    range.low = range.low.min(at(first));
                    range.high = range.high.max(at(last));
                }
            }
            range
        })
        .reduce(|| Range::NOTHING, Range::join)
}
