//! Implicit surfaces F = 0 and the fields on them.
//!
//! [`spline`] is F itself: the cubic B-spline through samples of a signed distance, negative inside, with its analytic derivatives.
//! [`sizing`] holds the target edge length h, [`energy`] the particles' energy (Eq. 1 to 4 of Kim, Chen and Hansen 2012) and
//! [`neighbours`] who is near whom; [`marching_cubes`] makes a mesh of F = 0.

pub mod energy;
pub mod marching_cubes;
pub mod neighbours;
pub mod particle_set;
pub mod random;
pub mod sizing;
pub mod spline;
pub mod surface_integral;
