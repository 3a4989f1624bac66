//! Particles on the isosurface, joined into a watertight triangle mesh with its topology.
//!
//! [`reconstruct()`] is all of it, in ten sentences and one call; [`run`] is the program round it.
//!
//! | step | module |
//! |---|---|
//! | the particles on F = 0, triangulated | [`prepare`] |
//! | tetrahedra inside and outside, and the facets between them | [`restricted`], [`tight_cocone`] |
//! | where a facet, an edge or a vertex violates a criterion; the topology of all facets | [`object`], [`defects`] |
//! | points added there, most needed first | [`refine`], [`queue`] |
//! | the worst triangles lifted | [`improve`] |
//! | the mesh checked, beside the topology of F | [`check`], [`verdict`] |
//! | data attached, and what offends shown | [`finish`] |

pub mod args;
mod around;
pub mod check;
pub mod defects;
pub mod finish;
mod held;
pub mod improve;
mod input;
pub mod interfaces;
mod join;
pub mod labelled;
pub mod materials;
pub mod object;
mod offending;
mod options;
mod output;
mod points_alone;
pub mod prepare;
#[cfg(test)]
mod program_tests;
pub mod queue;
pub mod reconstruct;
pub mod refine;
pub mod restricted;
pub mod run;
#[cfg(test)]
mod scenes;
#[cfg(test)]
mod tests;
pub mod tight_cocone;
pub mod verdict;
mod volumes;

pub use reconstruct::{Method, Options, Reconstruction, reconstruct};
