//! What two or more isoparticles stages need, and nothing else.
//!
//! Lengths are in the volume's physical units (mm) and positions in the *grid frame* (index times spacing,
//! axis aligned, right-handed) unless a name says otherwise; [`geometry::Geometry`] is the one place that
//! knows the way from there to the world.

pub mod cli;
pub mod components;
pub mod energy;
pub mod error;
pub mod geometry;
pub mod history;
pub mod image;
pub mod io;
pub mod kd_tree;
pub mod marching_cubes;
pub mod mesh;
pub mod neighbours;
pub mod particle_set;
pub mod quality;
pub mod random;
pub mod sizing;
pub mod spatial;
pub mod spline;
pub mod surface_integral;
pub mod topology;
