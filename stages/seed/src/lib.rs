//! The `seed` stage: places the initial particles on every component of F = 0 at approximately the
//! target density.
//!
//! Kim, Chen and Hansen 2012 (section 3.1) place seeds at the vertices of marching cubes, so that
//! disconnected parts also get particles; [`vertices`] does this on request. By default,
//! [`sampling`] oversamples the marching-cubes triangles with random candidates. It then keeps a
//! maximal subset in which no two points are closer than `DISK_RADIUS` times h (Poisson-disk
//! sampling by sample elimination). The initial particle count is then close to the count after
//! density control, even if h is smaller than a voxel.

pub mod args;
mod limits;
pub mod materials;
pub mod run;
pub mod sampling;
pub mod vertices;
