//! The compute pipelines, compiled once, and their bind groups.

use super::shaders::{Access, Binding, Variant, bindings, sources};
use rayon::prelude::*;
use std::collections::HashMap;
use std::num::NonZeroU64;

/// Distance in bytes between the values in the buffer `round`: the maximum alignment of uniform
/// offsets that a WebGPU adapter may require (default of `minUniformBufferOffsetAlignment`).
pub(crate) const ROUND_STRIDE: u64 = 256;

/// A pipeline and its bindings.
pub(crate) struct Kernel {
    pub pipeline: wgpu::ComputePipeline,
    layout: wgpu::BindGroupLayout,
    bindings: Vec<Binding>,
}

/// All pipelines.
pub(crate) struct Kernels {
    kernels: HashMap<&'static str, Kernel>,
}

impl Kernels {
    /// Compiles every kernel. The device reports compilation errors separately.
    pub(crate) fn new(device: &wgpu::Device, variant: Variant) -> Self {
        let all: Vec<_> = sources().collect();
        // in parallel, because compilation in the driver is slow
        let kernels = all.par_iter().map(|s| (s.name, kernel(device, s.name, s.compose(variant)))).collect();
        Self { kernels }
    }

    /// Returns the pipeline and bindings of a kernel.
    pub(crate) fn get(&self, name: &str) -> &Kernel {
        &self.kernels[name]
    }

    /// Creates the bind group of a kernel. `aliases` maps names in the kernel to other buffers.
    /// `round` selects the value of the kernel's variable `round`.
    pub(crate) fn bind<'m>(
        &self,
        device: &wgpu::Device,
        buffer_called: impl Fn(&str) -> &'m wgpu::Buffer,
        name: &str,
        round: u32,
        aliases: &[(&str, &str)],
    ) -> wgpu::BindGroup {
        let kernel = self.get(name);
        let entries: Vec<_> = kernel
            .bindings
            .iter()
            .map(|binding| {
                let buffer = aliases.iter().find(|a| a.0 == binding.name).map_or(binding.name.as_str(), |a| a.1);
                let buffer = buffer_called(buffer);
                let resource = if binding.name == "round" {
                    wgpu::BindingResource::Buffer(wgpu::BufferBinding {
                        buffer,
                        offset: u64::from(round) * ROUND_STRIDE,
                        size: NonZeroU64::new(16),
                    })
                } else {
                    buffer.as_entire_binding()
                };
                wgpu::BindGroupEntry { binding: binding.number, resource }
            })
            .collect();
        device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some(name),
            layout: &kernel.layout,
            entries: &entries,
        })
    }
}

fn kernel(device: &wgpu::Device, name: &'static str, text: String) -> Kernel {
    let bindings = bindings(&text);
    let entries: Vec<_> = bindings
        .iter()
        .map(|binding| wgpu::BindGroupLayoutEntry {
            binding: binding.number,
            visibility: wgpu::ShaderStages::COMPUTE,
            ty: wgpu::BindingType::Buffer {
                ty: match binding.access {
                    Access::Uniform => wgpu::BufferBindingType::Uniform,
                    Access::Read => wgpu::BufferBindingType::Storage { read_only: true },
                    Access::ReadWrite => wgpu::BufferBindingType::Storage { read_only: false },
                },
                has_dynamic_offset: false,
                min_binding_size: None,
            },
            count: None,
        })
        .collect();
    let layout =
        device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor { label: Some(name), entries: &entries });
    let pipeline_layout = device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
        label: Some(name),
        bind_group_layouts: &[Some(&layout)],
        immediate_size: 0,
    });
    let module = device.create_shader_module(wgpu::ShaderModuleDescriptor {
        label: Some(name),
        source: wgpu::ShaderSource::Wgsl(text.into()),
    });
    let pipeline = device.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
        label: Some(name),
        layout: Some(&pipeline_layout),
        module: &module,
        entry_point: None,
        // every kernel writes workgroup memory before reading it
        compilation_options: wgpu::PipelineCompilationOptions {
            zero_initialize_workgroup_memory: false,
            ..wgpu::PipelineCompilationOptions::default()
        },
        cache: None,
    });
    Kernel { pipeline, layout, bindings }
}
