//! The stage `reconstruct`: turns particles on F = 0 into a closed, checked triangle mesh with the
//! topology of F.
//!
//! [`reconstruct()`] computes the mesh, and [`mod@reconstruct`] lists its steps. [`run`] is the
//! program: it reads the inputs, computes the surface of data in memory, and writes it.
//! [`materials`] meshes many materials.
//!
//! | step | module |
//! |---|---|
//! | projection of the particles onto F = 0, Delaunay triangulation | [`prepare`] |
//! | tetrahedra inside and outside, facets between them | [`restricted`], [`tight_cocone`] |
//! | criteria for facets, edges and vertices; topology of all facets | [`object`], [`defects`] |
//! | refinement, priority queue of violations | [`refine`], [`queue`] |
//! | mesh with materials, separation of parts that touch | [`interfaces`] |
//! | improvement of the triangles | [`improve`] |
//! | improvement and checks, in this order | `complete` |
//! | one object or many materials, as the later steps see them | [`subject`] |
//! | update where h has changed | [`update`] |
//! | checks, comparison with the topology of F | [`check`], [`verdict`] |
//! | data on vertices and triangles | [`finish`] |

pub mod args;
mod around;
pub mod check;
mod complete;
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
pub mod subject;
#[cfg(test)]
mod tests;
pub mod tight_cocone;
pub mod update;
pub mod verdict;
mod volumes;

pub use reconstruct::{Method, Options, Reconstruction, reconstruct};
