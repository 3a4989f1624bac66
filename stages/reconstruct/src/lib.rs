//! Particles on the isosurface, joined into a watertight triangle mesh with its topology.
//!
//! The steps: [`prepare`] puts the particles on F = 0; [`restricted`] triangulates them (Delaunay) and takes the facets
//! between tetrahedra whose circumcentres are inside and outside; [`defects`] compares that surface with the
//! [topology of F](isoparticles_field::topology); [`refine`] adds points where it differs, until it does not; [`improve`] lifts the worst triangles;
//! [`finish`] attaches the data; [`run`] is the program. [`tight_cocone`] is the other way to find the facets, from points alone.

mod around;
pub mod check;
pub mod defects;
pub mod finish;
pub mod improve;
mod join;
pub mod pinched;
mod points_alone;
pub mod prepare;
#[cfg(test)]
mod program_tests;
pub mod refine;
pub mod restricted;
pub mod run;
#[cfg(test)]
mod scenes;
#[cfg(test)]
mod tests;
pub mod tight_cocone;
pub mod verdict;
