//! The GPU backend: sections 4 and 5 of the paper, implemented with wgpu and the WGSL kernels in
//! `/shaders`.
//!
//! The particles stay on the device from the first pass to the last, and the host reads a few words
//! per pass. Each kernel is named after its file. A twin is the CPU code that performs the same
//! computation. The twins of the lists are in `isoparticles_field::neighbours`, those of the energy
//! in `energy`, and those of the fields in `spline` and `sizing`. The twins of movement and density
//! control are in the parent folder. Both backends share the constants.

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
