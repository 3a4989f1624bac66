//! The GPU backend: sections 4 and 5 of the paper with wgpu and the WGSL kernels of `/shaders`.
//!
//! The particles stay on the device from the first pass to the last; the host reads a few words a pass. Each kernel is named
//! as its file and has its twin in the CPU code: lists in `isoparticles_field::neighbours`, energy in `energy`,
//! fields in `spline` and `sizing` there, movement and density control beside this folder. The constants are those of the CPU code.

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
