//! Computes dense samples of the zero set of an implicit function: marching-cubes vertices and
//! triangle centres, moved onto the zero set by Newton steps along the gradient (Eq. 5 of the
//! paper, with the sign corrected). Distances are measured to these samples, and [`crate::fit`]
//! pins the zero set of F to them.

use crate::cap::BorderBox;
use fearless_simd::{Level, dispatch};
use glam::DVec3;
use isoparticles_field::spline::BrickSpline;
use isoparticles_mesh::TriangleMesh;
use isoparticles_mesh::buckets::joined;
use isoparticles_volume::Image;
use rayon::prelude::*;

/// An implicit function, negative inside.
pub trait ValueGradient: Sync {
    /// Returns the value and the gradient (per mm) at a position in the grid frame (mm).
    fn value_gradient(&self, grid: DVec3) -> (f64, DVec3);
}

impl<T: Fn(DVec3) -> (f64, DVec3) + Sync> ValueGradient for T {
    fn value_gradient(&self, grid: DVec3) -> (f64, DVec3) {
        self(grid)
    }
}

/// The implicit function whose zero set is the surface. It is evaluated only near the surface.
pub struct Source {
    /// The spline whose zero set is the surface before it is cut at the border.
    pub spline: BrickSpline,
    /// The box that closes the object at the border, if any.
    pub cap: Option<BorderBox>,
}

impl ValueGradient for Source {
    /// With a box, returns the first-order distance (mm) to the surface closed by the box, and the
    /// gradient of this distance. Otherwise, returns the value and gradient of the spline.
    #[inline(always)]
    fn value_gradient(&self, grid: DVec3) -> (f64, DVec3) {
        let (f, g) = self.spline.value_gradient(grid);
        self.cap
            .as_ref()
            .map_or((f, g), |cap| cap.intersect(grid, first_order_distance(f, g.length()), g.normalize_or_zero()))
    }
}

/// Maximum slope, per mm, that is treated as zero. Where the values of a scan are about 1000,
/// rounding to double precision alone gives slopes of 1e-13.
pub(crate) const VANISHING_SLOPE: f64 = 1e-12;

/// Returns the value divided by the slope. If the slope vanishes, returns 1e6 mm, which exceeds the
/// size of any volume, with the sign of the value (positive for zero).
#[inline(always)]
pub(crate) fn first_order_distance(value: f64, slope: f64) -> f64 {
    if slope > VANISHING_SLOPE {
        value / slope
    } else if value < 0.0 {
        -1e6
    } else {
        1e6
    }
}

/// Number of samples per parallel task: large enough to make the overhead of a task negligible, and
/// small enough to give every thread a task for small meshes. The samples do not depend on this
/// number.
const CHUNK: usize = 256;

/// Maximum number of Newton steps per sample. Two steps of [`LONGEST_STEP`] exceed
/// [`MAX_PROJECTION`]. The other ten steps reach [`SURFACE_TOLERANCE`] even if each of them only
/// reduces the distance to a quarter: 0.4 / 4^10 = 4e-7.
const MAX_NEWTON_STEPS: usize = 12;

/// Maximum length of a Newton step, in units of the minimum voxel spacing. A step from the surface
/// of a layer one voxel thick does not reach the middle of the layer (0.5), where the gradient
/// changes sign.
const LONGEST_STEP: f64 = 0.4;

/// Maximum first-order distance |f| / slope of a sample from the surface, in units of the minimum
/// voxel spacing. It is a thousandth of the tolerance of the pinned zero set (0.001,
/// `field::PINNED`). Newton's method converges quadratically, so this accuracy takes only one more
/// step than 0.001.
const SURFACE_TOLERANCE: f64 = 1e-6;

/// Maximum distance of a sample from its start on the marching-cubes mesh, in units of the minimum
/// voxel spacing. The two surfaces of a layer one voxel thick are about one voxel apart, so a
/// sample that moves farther has probably reached another part of the surface. With 0.5 instead of
/// 0.75, the maximum shift of the zero set of `heart_label` grows from 0.019 to 0.145 voxel; with
/// 1.5, the shift is the same as with 0.75 (`make distfield`).
const MAX_PROJECTION: f64 = 0.75;

const _: () = assert!(LONGEST_STEP < 0.5 && 2.0 * LONGEST_STEP > MAX_PROJECTION, "see MAX_NEWTON_STEPS");

/// Number of bisections of a grid edge. The final interval is 2^-40 = 1e-12 of the edge.
const BISECTIONS: usize = 40;

/// Computes samples of the zero set of `implicit` from its marching-cubes mesh at the nodes of
/// `image`.
///
/// The first samples are the projections of the mesh vertices, in the same order. If Newton's
/// method fails for a vertex, bisection finds a zero on the grid edge of the vertex, where the sign
/// changes. The projections of the triangle centres follow, without those for which Newton's method
/// fails.
pub fn surface_samples<I: ValueGradient>(implicit: &I, image: &Image<f32>, mesh: &TriangleMesh) -> Vec<DVec3> {
    let voxel = image.geometry.min_spacing();
    let instructions = Level::new();
    // plain loops, because a closure per item would not be compiled for the dispatched instruction
    // set
    let vertices = mesh.vertices.par_chunks(CHUNK).map(|chunk| {
        let mut found = Vec::with_capacity(chunk.len());
        dispatch!(instructions, _simd => {
            for &v in chunk {
                found.push(project(implicit, v, voxel).unwrap_or_else(|| bisect_edge(implicit, image, v)));
            }
        });
        found
    });
    let centres = mesh.triangles.par_chunks(CHUNK).map(|chunk| {
        let mut found = Vec::with_capacity(chunk.len());
        dispatch!(instructions, _simd => {
            for [a, b, c] in chunk {
                let [a, b, c] = [a, b, c].map(|v| mesh.vertices[*v as usize]);
                found.extend(project(implicit, (a + b + c) / 3.0, voxel));
            }
        });
        found
    });
    joined(vertices.chain(centres).collect())
}

/// Projects `start` onto the zero set. Returns `None` if the result is more than `MAX_PROJECTION`
/// voxels away, if the gradient vanishes, or if Newton's method does not converge. `voxel` is the
/// minimum spacing, mm.
#[inline(always)]
pub fn project<I: ValueGradient>(implicit: &I, start: DVec3, voxel: f64) -> Option<DVec3> {
    let mut p = start;
    for _ in 0..MAX_NEWTON_STEPS {
        let (f, g) = implicit.value_gradient(p);
        let slope = g.length();
        if slope.is_nan() || slope <= VANISHING_SLOPE {
            return None;
        }
        let distance = f / slope;
        if distance.abs() <= SURFACE_TOLERANCE * voxel {
            return Some(p);
        }
        p -= g / slope * distance.clamp(-LONGEST_STEP * voxel, LONGEST_STEP * voxel);
        if p.distance(start) > MAX_PROJECTION * voxel {
            return None;
        }
    }
    None
}

/// Finds a zero of the implicit function on the grid edge that contains the marching-cubes vertex
/// `v`. Returns `v` if the function has the same sign at both ends.
fn bisect_edge<I: ValueGradient>(implicit: &I, image: &Image<f32>, v: DVec3) -> DVec3 {
    let geometry = &image.geometry;
    let index = geometry.grid_to_index(v);
    let off = (index - index.round()).abs();
    let axis = (0..3).max_by(|&a, &b| off[a].total_cmp(&off[b])).unwrap_or(0);
    let mut low = index.round();
    low[axis] = index[axis].floor();
    let high = low + DVec3::AXES[axis];
    let (mut low, mut high) = (geometry.index_to_grid(low), geometry.index_to_grid(high));
    let inside = implicit.value_gradient(low).0 < 0.0;
    if inside == (implicit.value_gradient(high).0 < 0.0) {
        // the vertex lies within a cell, or an end of the edge lies on the surface up to rounding
        return v;
    }
    for _ in 0..BISECTIONS {
        let middle = 0.5 * (low + high);
        if (implicit.value_gradient(middle).0 < 0.0) == inside {
            low = middle;
        } else {
            high = middle;
        }
    }
    0.5 * (low + high)
}
