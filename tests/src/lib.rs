//! Analytic phantoms: volumes whose area, volume, genus and local feature size are known beforehand, so that
//! every stage can be compared with the truth rather than with itself.
//!
//! A [`scene::Scene`] is an implicit function in the grid frame (mm), negative inside; [`volume`] samples one
//! into a scalar volume (a smooth edge, as a scanner gives it) or a label map, and [`nrrd`] writes that with
//! any geometry, by code of its own, so that the reader under test is checked against an independent writer.

pub mod nrrd;
pub mod readers;
pub mod scene;
pub mod shapes;
pub mod skip;
pub mod topology;
pub mod torso;
pub mod volume;
