//! The GPU backend: sections 4 and 5 of the paper, with wgpu and the WGSL kernels of `/shaders`.
//!
//! The particles stay on the device from the first pass to the last; the host reads a few words per
//! pass. Each kernel has the name of its file and a twin in the CPU code. The twins of the lists
//! are in `isoparticles_field::neighbours`, of the energy in `energy`, and of the fields in
//! `spline` and `sizing`. Movement and density control are beside this folder. Both backends share
//! the constants.

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

pub use adapter::{AdapterSummary, Choice, Gpu, adapters};
pub use engine::GpuEngine;
pub use report::{DeviceReport, KernelTime};

#[cfg(test)]
mod tests;
