//! The GPU backend: sections 4 and 5 of the paper, implemented with wgpu and the WGSL kernels in
//! `/shaders`.
//!
//! The particles stay on the device from the first pass to the last, and the host reads only a few
//! words per pass. Each kernel is named after its file. The twin of a kernel is the CPU code that
//! performs the same computation. Twins are in the crate `isoparticles_field` (lists in
//! `neighbours`, energy in `energy`, fields in `spline` and `sizing`) and in the parent folder
//! (movement and density control). Both backends share the constants in `constants.rs` of the
//! parent folder.

mod adapter;
mod commands;
mod constants;
mod differences;
pub mod display;
mod engine;
mod kernels;
mod levels;
mod materials;
mod memory;
mod parameters;
mod passes;
mod report;
mod schedule;
mod shaders;

pub use adapter::{AdapterChoice, AdapterSummary, Gpu, adapters};
pub use engine::GpuEngine;
pub use report::{DeviceReport, KernelTime};

#[cfg(test)]
mod tests;
