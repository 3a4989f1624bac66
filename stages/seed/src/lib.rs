//! The `seed` stage: places the initial particles on every component of F = 0 at approximately the
//! target density.
//!
//! Section 3.1 of Kim, Chen and Hansen 2012 seeds at the vertices of marching cubes, so that
//! disconnected parts also get particles; [`vertices`] does this on request. By default,
//! [`sampling`] places more candidates than h requires on the triangles of marching cubes. It then
//! keeps a maximal subset in which no two points are closer than `DISK_RADIUS` h (Poisson-disk
//! sampling by sample elimination). The initial count is thus close to the count that density
//! control would reach, even if h is smaller than a voxel.

pub mod materials;
pub mod run;
pub mod sampling;
pub mod vertices;
