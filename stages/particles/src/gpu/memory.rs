//! Named buffers on the device, their total size, and transfers to and from the host.

use super::adapter::Gpu;
use isoparticles_stage::error::{Error, Result};
use rayon::prelude::*;
use std::collections::BTreeMap;

/// The buffers on the device.
#[derive(Default)]
pub(crate) struct Memory {
    buffers: BTreeMap<String, wgpu::Buffer>,
    bytes: u64,
    peak: u64,
}

const STORAGE_USAGES: wgpu::BufferUsages =
    wgpu::BufferUsages::STORAGE.union(wgpu::BufferUsages::COPY_SRC).union(wgpu::BufferUsages::COPY_DST);

impl Memory {
    /// Creates or replaces a storage buffer of at least `bytes` bytes. `extra` specifies additional
    /// usages.
    pub(crate) fn make(&mut self, gpu: &Gpu, name: &str, bytes: u64, extra: wgpu::BufferUsages) -> Result<()> {
        let size = bytes.max(16).next_multiple_of(16);
        if size > gpu.limits.max_buffer_size.min(gpu.limits.max_storage_buffer_binding_size) {
            return Err(Error::gpu(
                format!(
                    "{}: the buffer `{name}` needs {size} bytes, the adapter's limit is {}",
                    gpu.summary().name,
                    gpu.limits.max_storage_buffer_binding_size
                ),
                "the particles and their neighbours must fit in device memory",
                "raise SIZE or MIN_SIZE (sizefield --uniform, --min-size), use another adapter, or set BACKEND=cpu \
                 (--backend cpu)",
            ));
        }
        self.remove(name);
        let guard = gpu.device.push_error_scope(wgpu::ErrorFilter::OutOfMemory);
        let usage = STORAGE_USAGES | extra;
        let buffer = gpu.device.create_buffer(&wgpu::BufferDescriptor {
            label: Some(name),
            size,
            usage,
            mapped_at_creation: false,
        });
        if let Some(error) = pollster::block_on(guard.pop()) {
            return Err(Error::gpu(
                format!(
                    "{}: out of memory: the buffer `{name}` needs {size} bytes, and {} bytes are in use: {error}",
                    gpu.summary().name,
                    self.bytes
                ),
                "fields, particles and neighbours must fit in device memory",
                "close other programs that use the device, raise SIZE or MIN_SIZE (sizefield --uniform, --min-size), \
                 or set BACKEND=cpu (--backend cpu)",
            ));
        }
        self.bytes += size;
        self.peak = self.peak.max(self.bytes);
        self.buffers.insert(name.to_owned(), buffer);
        Ok(())
    }

    /// Releases a buffer.
    pub(crate) fn remove(&mut self, name: &str) {
        if let Some(old) = self.buffers.remove(name) {
            self.bytes -= old.size();
        }
    }

    /// Returns the buffer called `name`.
    ///
    /// # Panics
    /// Panics if no buffer has this name.
    pub(crate) fn get(&self, name: &str) -> &wgpu::Buffer {
        self.buffers.get(name).unwrap_or_else(|| panic!("no kernel may name a buffer that was not made: {name}"))
    }

    /// Returns the maximum number of bytes allocated at one time.
    pub(crate) fn peak(&self) -> u64 {
        self.peak
    }
}

/// Copies values into a buffer in batches of 12 pieces of 512 KiB. All threads copy the pieces of a
/// batch in parallel, because the first access to staging memory takes most of the time. After each
/// batch the function waits for the device, so that wgpu can reuse the staging memory. The copy
/// therefore needs at most 6 MiB of staging memory, regardless of the number of values.
///
/// Measured on an H200 with labels 2 and 3 of `lungs_label_big` (360,000 particles): the step
/// `settle` takes 0.32, 0.29, 0.26, 0.26 and 0.28 s with pieces of 128, 256, 512, 1024 and 4096
/// KiB, and 0.41, 0.28, 0.26 and 0.26 s with batches of 1, 4, 12 and 48 pieces.
pub(crate) fn upload<T: bytemuck::NoUninit + Sync>(gpu: &Gpu, buffer: &wgpu::Buffer, values: &[T]) -> Result<()> {
    const PIECE_BYTES: usize = 1 << 19;
    const BATCH: usize = 12;
    let piece = PIECE_BYTES / size_of::<T>();
    for (k, batch) in values.chunks(BATCH * piece).enumerate() {
        batch.par_chunks(piece).enumerate().for_each(|(i, values)| {
            let offset = (k * BATCH + i) * piece * size_of::<T>();
            gpu.queue.write_buffer(buffer, offset as u64, bytemuck::cast_slice(values));
        });
        gpu.queue.submit([]);
        if batch.len() == BATCH * piece {
            gpu.wait()?;
        }
    }
    Ok(())
}

/// Reads the first `count` values of a buffer.
pub(crate) fn download<T: bytemuck::AnyBitPattern>(gpu: &Gpu, buffer: &wgpu::Buffer, count: usize) -> Result<Vec<T>> {
    let bytes = (count * size_of::<T>()) as u64;
    if bytes == 0 {
        return Ok(Vec::new());
    }
    let staging = staging(gpu, bytes);
    let mut encoder = gpu.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
    encoder.copy_buffer_to_buffer(buffer, 0, &staging, 0, bytes);
    gpu.queue.submit([encoder.finish()]);
    read_staging(gpu, &staging, bytes, None)
}

/// Creates a buffer that the host can map for reading.
pub(crate) fn staging(gpu: &Gpu, bytes: u64) -> wgpu::Buffer {
    gpu.device.create_buffer(&wgpu::BufferDescriptor {
        label: Some("staging"),
        size: bytes,
        usage: wgpu::BufferUsages::MAP_READ | wgpu::BufferUsages::COPY_DST,
        mapped_at_creation: false,
    })
}

/// Waits for the given submission, or for all submissions if none is given. Then reads the first
/// `bytes` bytes of a staging buffer.
pub(crate) fn read_staging<T: bytemuck::AnyBitPattern>(
    gpu: &Gpu,
    staging: &wgpu::Buffer,
    bytes: u64,
    submission: Option<&wgpu::SubmissionIndex>,
) -> Result<Vec<T>> {
    let (sender, receiver) = std::sync::mpsc::channel();
    staging.slice(..bytes).map_async(wgpu::MapMode::Read, move |result| {
        let _ = sender.send(result);
    });
    gpu.wait_for(submission)?;
    match receiver.recv() {
        Ok(Ok(())) => {}
        Ok(Err(error)) => return Err(gpu.failed(&format!("cannot read its memory: {error}"))),
        Err(error) => return Err(gpu.failed(&format!("did not respond: {error}"))),
    }
    let view = staging.slice(..bytes).get_mapped_range().map_err(|error| gpu.failed(&error.to_string()))?;
    let mut values = Vec::with_capacity(bytes as usize / size_of::<T>());
    values.extend(view.chunks_exact(size_of::<T>()).map(bytemuck::pod_read_unaligned::<T>));
    drop(view);
    staging.unmap();
    Ok(values)
}
