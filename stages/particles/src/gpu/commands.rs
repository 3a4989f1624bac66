//! Encodes the commands of a pass into one command buffer. With profiling enabled, the device
//! writes a timestamp before and after each kernel. With few particles, encoding on the host takes
//! as long as execution on the device. The host therefore encodes the next pass while the device
//! works.

use super::adapter::Gpu;
use super::constants::GROUPS_PER_ROW;
use super::kernels::Kernels;
use super::memory::{read_staging, staging};
use isoparticles_stage::error::Result;
use std::collections::BTreeMap;

/// One command of a pass.
pub(crate) enum Command<'a> {
    /// Runs a kernel with the given number of workgroups.
    Run { kernel: &'static str, group: &'a wgpu::BindGroup, workgroups: u32 },
    /// Runs a kernel with a number of workgroups that is read from a buffer on the device.
    RunIndirect { kernel: &'static str, group: &'a wgpu::BindGroup, arguments: &'a wgpu::Buffer, offset: u64 },
    /// Copies the first `bytes` bytes of one buffer to another.
    Copy { from: &'a wgpu::Buffer, to: &'a wgpu::Buffer, bytes: u64 },
    /// Sets a buffer to zero.
    Clear { buffer: &'a wgpu::Buffer },
}

impl Command<'_> {
    fn kernel(&self) -> Option<&'static str> {
        match self {
            Command::Run { kernel, .. } | Command::RunIndirect { kernel, .. } => Some(kernel),
            _ => None,
        }
    }
}

/// Time and number of dispatches of each kernel.
#[derive(Default)]
pub(crate) struct Profile {
    queries: Option<(wgpu::QuerySet, wgpu::Buffer, wgpu::Buffer)>,
    /// Seconds and number of dispatches of each kernel.
    pub times: BTreeMap<&'static str, (f64, u64)>,
}

/// Maximum number of timed dispatches per pass; additional dispatches are not timed. A pass has at
/// most 70 dispatches ([`steps`](super::schedule::steps) with density control and 32 classes).
const MOST_TIMED_DISPATCHES: u32 = 128;

/// Encoded commands that can be submitted once.
pub(crate) struct Encoded {
    buffer: wgpu::CommandBuffer,
    /// Kernels with timestamps, in the order of their dispatches.
    timed: Vec<&'static str>,
}

/// Encodes the commands in order.
pub(crate) fn encode(gpu: &Gpu, kernels: &Kernels, commands: &[Command<'_>], profile: &mut Profile) -> Encoded {
    let mut encoder = gpu.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
    profile.prepare(gpu);
    let mut pass: Option<wgpu::ComputePass<'static>> = None;
    let mut timed = Vec::new();
    for command in commands {
        match command {
            Command::Copy { from, to, bytes } => {
                pass = None;
                encoder.copy_buffer_to_buffer(from, 0, to, 0, *bytes);
            }
            Command::Clear { buffer } => {
                pass = None;
                encoder.clear_buffer(buffer, 0, None);
            }
            Command::Run { group, .. } | Command::RunIndirect { group, .. } => {
                let Some(kernel) = command.kernel() else { continue };
                let timestamp_writes =
                    profile.queries.as_ref().filter(|_| timed.len() < MOST_TIMED_DISPATCHES as usize).map(|q| {
                        // timestamps are written only at the start and end of a compute pass, so
                        // each timed kernel gets its own compute pass
                        pass = None;
                        let at = 2 * timed.len() as u32;
                        timed.push(kernel);
                        wgpu::ComputePassTimestampWrites {
                            query_set: &q.0,
                            beginning_of_pass_write_index: Some(at),
                            end_of_pass_write_index: Some(at + 1),
                        }
                    });
                let current = pass.get_or_insert_with(|| {
                    encoder
                        .begin_compute_pass(&wgpu::ComputePassDescriptor { label: None, timestamp_writes })
                        .forget_lifetime()
                });
                current.set_pipeline(&kernels.get(kernel).pipeline);
                current.set_bind_group(0, *group, &[]);
                dispatch(current, command);
            }
        }
    }
    drop(pass);
    if let Some((set, resolved, host)) = &profile.queries {
        let count = 2 * timed.len() as u32;
        encoder.resolve_query_set(set, 0..count, resolved, 0);
        encoder.copy_buffer_to_buffer(resolved, 0, host, 0, u64::from(count) * 8);
    }
    Encoded { buffer: encoder.finish(), timed }
}

/// Dispatches a kernel whose pipeline and bind group are set. Does nothing for zero workgroups.
fn dispatch(pass: &mut wgpu::ComputePass<'_>, command: &Command<'_>) {
    match command {
        Command::Run { workgroups, .. } if *workgroups > 0 => {
            pass.dispatch_workgroups((*workgroups).min(GROUPS_PER_ROW), workgroups.div_ceil(GROUPS_PER_ROW), 1);
        }
        Command::RunIndirect { arguments, offset, .. } => {
            pass.dispatch_workgroups_indirect(arguments, *offset);
        }
        _ => {}
    }
}

/// Submits encoded commands. Returns the index of the submission and the kernels whose timestamps
/// [`Profile::collect`] reads.
pub(crate) fn submit(gpu: &Gpu, encoded: Encoded) -> (wgpu::SubmissionIndex, Vec<&'static str>) {
    (gpu.queue.submit([encoded.buffer]), encoded.timed)
}

impl Profile {
    /// Creates the timestamp queries on first use if timestamps are enabled.
    fn prepare(&mut self, gpu: &Gpu) {
        if gpu.timestamps && self.queries.is_none() {
            let set = gpu.device.create_query_set(&wgpu::QuerySetDescriptor {
                label: Some("timestamps"),
                ty: wgpu::QueryType::Timestamp,
                count: 2 * MOST_TIMED_DISPATCHES,
            });
            let bytes = u64::from(2 * MOST_TIMED_DISPATCHES) * 8;
            let resolved = gpu.device.create_buffer(&wgpu::BufferDescriptor {
                label: Some("timestamps"),
                size: bytes,
                usage: wgpu::BufferUsages::QUERY_RESOLVE | wgpu::BufferUsages::COPY_SRC,
                mapped_at_creation: false,
            });
            self.queries = Some((set, resolved, staging(gpu, bytes)));
        }
    }

    /// Waits for the device and adds the kernel times of the last submission to the totals.
    pub(crate) fn collect(&mut self, gpu: &Gpu, timed: &[&'static str]) -> Result<()> {
        let Some((_, _, host)) = &self.queries else { return Ok(()) };
        let stamps: Vec<u64> = read_staging(gpu, host, 16 * timed.len() as u64, None)?;
        let tick = f64::from(gpu.queue.get_timestamp_period()) * 1e-9;
        for (&kernel, pair) in timed.iter().zip(stamps.chunks_exact(2)) {
            let entry = self.times.entry(kernel).or_default();
            entry.0 += pair[1].saturating_sub(pair[0]) as f64 * tick;
            entry.1 += 1;
        }
        Ok(())
    }
}
