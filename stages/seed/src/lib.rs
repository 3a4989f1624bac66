//! The `seed` stage: first particles on F = 0, on every component, near the target density.
//!
//! Section 3.1 of Kim, Chen and Hansen 2012 seeds at the vertices of marching cubes, so that disconnected parts get
//! particles too ([`vertices`], on request). Here the triangles of marching cubes are sampled more densely than h asks for, and a maximal
//! subset without crowding is kept (Poisson-disk sampling by sample elimination): so the count starts near the one
//! that density control would reach, also where h is smaller than a voxel.

pub mod materials;
pub mod run;
pub mod sampling;
pub mod vertices;
