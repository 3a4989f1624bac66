//! Implicit surfaces F = 0 and the fields on them, after Kim, Chen and Hansen 2012.
//!
//! - [`spline`]: the function F, a cubic B-spline through samples of a signed distance (negative
//!   inside), with analytic derivatives. [`curvature`] is computed from these derivatives.
//! - [`sizing`]: the target edge length h. [`background`]: h for tetrahedralizers. [`energy`]: the
//!   particle energy (Eq. 1, 2 and 4).
//! - [`neighbours`]: neighbour search. [`random`]: counter-based random numbers that do not depend
//!   on the order of evaluation.
//! - [`topology`]: components, Euler characteristics and critical points of F.
//! - [`marching_cubes`]: a triangle mesh of F = 0.
//! - [`materials`]: implicit functions for many materials, one per material. [`label_lookup`]:
//!   labels at positions. [`overlap`]: means of voxels over tetrahedra.
//!
//! ```
//! use glam::DVec3;
//! use isoparticles_field::{marching_cubes::marching_cubes, spline::CubicSpline};
//! use isoparticles_volume::{Geometry, Image};
//!
//! let centre = DVec3::splat(8.0);
//! let geometry = Geometry::axis_aligned([17; 3], DVec3::ONE);
//! let distance = Image::sampled(geometry, |p| (p.distance(centre) - 5.0) as f32);
//! let f = CubicSpline::new(&distance);
//! let on_surface = f.project(DVec3::new(12.0, 9.0, 8.0), 2.0, 1e-6).expect("it is near");
//! assert!((on_surface.distance(centre) - 5.0).abs() < 0.01);
//! assert!((f.distance_estimate(DVec3::new(11.5, 8.0, 8.0)) + 1.5).abs() < 0.01);
//! assert!(!marching_cubes(&distance, 0.0).triangles.is_empty());
//! ```

pub mod background;
pub mod curvature;
pub mod enclosed;
pub mod energy;
pub mod label_lookup;
pub mod marching_cubes;
pub mod materials;
pub mod neighbours;
mod node_bits;
pub mod overlap;
pub mod particle_set;
pub mod random;
pub mod sizing;
pub mod spline;
pub mod surface_integral;
pub mod topology;
