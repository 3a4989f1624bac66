//! Analytic phantoms: volumes of objects with known surface area, enclosed volume, genus and local
//! feature size. Tests compare the output of each stage with these exact values. A [`scene::Scene`]
//! is an implicit function in the grid frame (mm), negative inside. [`volume`] samples a scene as a
//! label map, or as a scalar volume with blurred edges like those of a scan. [`nrrd`] writes
//! volumes with any geometry; it is independent of the reader under test.

pub mod nrrd;
pub mod readers;
pub mod scene;
pub mod shapes;
pub mod skip;
pub mod topology;
pub mod torso;
pub mod volume;
