//! Computes dense samples of the zero set of an implicit function: marching-cubes vertices and
//! triangle centres, moved onto the zero set by Newton steps along the gradient (Eq. 5 of the
//! paper, with the sign corrected). Distances are measured to these samples, and [`crate::fit`]
//! pins the zero set of F to them.

use fearless_simd::{Level, dispatch};
use glam::DVec3;
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

/// Number of samples per parallel task.
const CHUNK: usize = 256;

/// Maximum number of Newton steps per sample.
const STEPS: usize = 12;

/// A sample is on the surface if its first-order distance |f| / slope is at most this value, in
/// units of the minimum voxel spacing.
const TOLERANCE: f64 = 1e-6;

/// Maximum distance of a sample from its start on the marching-cubes mesh, in units of the minimum
/// voxel spacing. Beyond this distance, the sample has moved to another part of the surface.
const REACH: f64 = 0.75;

/// Computes samples of the zero set of `implicit` from its marching-cubes mesh at the nodes of
/// `image`.
///
/// The first samples are the mesh vertices, one sample each and in the same order. If Newton's
/// method fails for a vertex, bisection finds a zero on the grid edge of the vertex, where the sign
/// changes. The triangle centres follow; centres for which Newton's method fails are left out.
pub fn surface_samples<I: ValueGradient>(implicit: &I, image: &Image<f32>, mesh: &TriangleMesh) -> Vec<DVec3> {
    let voxel = image.geometry.min_spacing();
    let instructions = Level::new();
    // loops instead of closures per item, because closures would not be compiled for the dispatched
    // instructions
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

/// Projects `start` onto the zero set. Returns `None` if the result is more than `REACH` voxels
/// away, if the gradient vanishes, or if Newton's method does not converge. `voxel` is the minimum
/// spacing, mm.
#[inline(always)]
pub fn project<I: ValueGradient>(implicit: &I, start: DVec3, voxel: f64) -> Option<DVec3> {
    let mut p = start;
    for _ in 0..STEPS {
        let (f, g) = implicit.value_gradient(p);
        let slope = g.length();
        if slope.is_nan() || slope <= 1e-12 {
            return None;
        }
        let distance = f / slope;
        if distance.abs() <= TOLERANCE * voxel {
            return Some(p);
        }
        p -= g / slope * distance.clamp(-0.4 * voxel, 0.4 * voxel);
        if p.distance(start) > REACH * voxel {
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
        // an extra vertex within a cell, or an edge whose end is on the surface up to rounding
        return v;
    }
    for _ in 0..40 {
        let middle = 0.5 * (low + high);
        if (implicit.value_gradient(middle).0 < 0.0) == inside {
            low = middle;
        } else {
            high = middle;
        }
    }
    0.5 * (low + high)
}
