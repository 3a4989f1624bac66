//! Analytic phantoms: volumes with known area, volume, genus and local feature size, so that tests
//! can compare the output of each stage with exact values. A [`scene::Scene`] is an implicit
//! function in the grid frame (mm), negative inside. [`volume`] samples a scene as a scalar volume
//! whose edges are blurred as in a scan, or as a label map. [`nrrd`] writes volumes with any
//! geometry; it is independent of the reader under test.

pub mod nrrd;
pub mod readers;
pub mod scene;
pub mod shapes;
pub mod skip;
pub mod topology;
pub mod torso;
pub mod volume;
