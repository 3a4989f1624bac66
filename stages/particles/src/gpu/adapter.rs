//! Adapters of this machine: enumerates and selects them, and opens one with its own limits instead
//! of wgpu's default limits.

use super::kernels::Kernels;
use super::shaders::Variant;
use isoparticles_stage::error::{Error, Result};
use std::fmt;
use std::sync::{Arc, Mutex, PoisonError};

/// Sizes of the memory blocks that wgpu requests from the driver: from 16 to 256 MiB on the device,
/// and half as much on the host. With wgpu's default sizes, a tenth of the run time is spent on the
/// first access to host memory.
const MEMORY_BLOCKS: wgpu::MemoryHints =
    wgpu::MemoryHints::Manual { suballocated_device_memory_block_size: 16 << 20..256 << 20 };

/// Properties of an adapter that are known before it is opened.
#[derive(Clone, Debug)]
pub struct AdapterSummary {
    /// Name reported by the driver.
    pub name: String,
    /// Type: `discrete`, `integrated`, `virtual`, `software` or `other`.
    pub kind: &'static str,
    /// Graphics API: `vulkan`, `metal` or `dx12`.
    pub backend: String,
    /// Name and version of the driver.
    pub driver: String,
    /// Maximum size of a buffer in bytes.
    pub largest_buffer: u64,
    /// Maximum size of a binding in bytes.
    pub largest_binding: u64,
    /// Minimum and maximum number of lanes of a subgroup.
    pub subgroup: [u32; 2],
}

impl fmt::Display for AdapterSummary {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let mib = |bytes: u64| bytes / (1 << 20);
        write!(
            f,
            "{} ({}, {}, {}; buffers up to {} MiB, bindings up to {} MiB)",
            self.name,
            self.kind,
            self.backend,
            self.driver,
            mib(self.largest_buffer),
            mib(self.largest_binding)
        )
    }
}

/// Criteria for the selection of an adapter.
#[derive(Clone, Debug, Default)]
pub struct AdapterChoice {
    /// Part of the adapter's name, case-insensitive. Without a name, the first GPU in the order of
    /// [`adapters`] is selected, so discrete GPUs are preferred. Software renderers are selected
    /// only by name.
    pub name: Option<String>,
    /// Disables subgroup operations (to find out whether a driver implements them incorrectly).
    pub no_subgroups: bool,
    /// Number of lanes per particle if subgroup operations are used: 8, 16 or 32.
    pub team: Option<u32>,
    /// Measures each kernel with timestamp queries.
    pub profile: bool,
    /// Maximum size of a field slab in bytes, even if larger bindings are possible (for tests).
    pub largest_slab: Option<u64>,
}

/// An open adapter.
pub struct Gpu {
    pub(crate) device: wgpu::Device,
    pub(crate) queue: wgpu::Queue,
    pub(crate) limits: wgpu::Limits,
    /// Maximum size of a field slab in bytes.
    pub(crate) largest_slab: u64,
    /// Number of lanes of a team; `None` if subgroup operations are not used.
    pub(crate) subgroup_team: Option<u32>,
    /// True if timestamp queries are enabled.
    pub(crate) timestamps: bool,
    summary: AdapterSummary,
    /// Message of the first uncaptured error of the device; the loss of the device counts as an
    /// error.
    failure: Arc<Mutex<Option<String>>>,
    /// Compiled kernels of each variant: fields in one or several slabs, and one object or many
    /// materials.
    kernels: Mutex<[Option<Arc<Kernels>>; 4]>,
}

fn instance() -> wgpu::Instance {
    let mut descriptor = wgpu::InstanceDescriptor::new_without_display_handle();
    // This flag admits drivers that do not conform to their API. It replaces the default flags,
    // which validate indirect dispatches: each validation would cost an extra compute pass, and the
    // kernels already keep the dispatch sizes within the limits.
    descriptor.flags = wgpu::InstanceFlags::ALLOW_UNDERLYING_NONCOMPLIANT_ADAPTER;
    wgpu::Instance::new(descriptor)
}

fn summary(adapter: &wgpu::Adapter) -> AdapterSummary {
    let info = adapter.get_info();
    let limits = adapter.limits();
    AdapterSummary {
        kind: match info.device_type {
            wgpu::DeviceType::DiscreteGpu => "discrete",
            wgpu::DeviceType::IntegratedGpu => "integrated",
            wgpu::DeviceType::VirtualGpu => "virtual",
            wgpu::DeviceType::Cpu => "software",
            wgpu::DeviceType::Other => "other",
        },
        backend: info.backend.to_str().to_owned(),
        driver: format!("{} {}", info.driver, info.driver_info).trim().to_owned(),
        name: info.name,
        largest_buffer: limits.max_buffer_size,
        largest_binding: limits.max_storage_buffer_binding_size,
        subgroup: [info.subgroup_min_size, info.subgroup_max_size],
    }
}

/// Returns the adapters of this machine, the preferred adapter first.
pub fn adapters() -> Vec<AdapterSummary> {
    found(&instance()).iter().map(summary).collect()
}

fn found(instance: &wgpu::Instance) -> Vec<wgpu::Adapter> {
    let mut adapters = pollster::block_on(instance.enumerate_adapters(wgpu::Backends::all()));
    adapters.sort_by_key(|adapter| match adapter.get_info().device_type {
        wgpu::DeviceType::DiscreteGpu => 0,
        wgpu::DeviceType::VirtualGpu => 1,
        wgpu::DeviceType::IntegratedGpu => 2,
        wgpu::DeviceType::Other => 3,
        wgpu::DeviceType::Cpu => 4,
    });
    adapters
}

/// Returns the adapter that matches the criteria.
///
/// # Errors
/// If no adapter has the given name, or if no name is given and there is no GPU.
fn select<'a>(all: &'a [wgpu::Adapter], choice: &AdapterChoice) -> Result<&'a wgpu::Adapter> {
    let listed = || {
        let names: Vec<String> = all.iter().map(|a| summary(a).to_string()).collect();
        if names.is_empty() { "none".to_owned() } else { names.join("; ") }
    };
    match &choice.name {
        Some(name) => {
            all.iter().find(|a| a.get_info().name.to_lowercase().contains(&name.to_lowercase())).ok_or_else(|| {
                Error::gpu(
                    format!("--adapter {name}: no adapter has this name"),
                    "the run was requested on this adapter",
                    format!(
                        "set BACKEND=cpu (--backend cpu), or select one of these adapters in \
                         PARTICLES_OPTIONS=\"--adapter NAME\": {}",
                        listed()
                    ),
                )
            })
        }
        None => all.iter().find(|a| a.get_info().device_type != wgpu::DeviceType::Cpu).ok_or_else(|| {
            Error::gpu(
                "no GPU was found",
                "BACKEND=gpu (--backend gpu) needs one",
                format!(
                    "install its Vulkan, Metal or DX12 driver, set BACKEND=cpu (--backend cpu), or select a \
                     software adapter in PARTICLES_OPTIONS=\"--adapter NAME\" (found: {})",
                    listed()
                ),
            )
        }),
    }
}

/// Opens the device of an adapter with the given features and the adapter's limits. `failure`
/// receives the message of the first uncaptured error; the loss of the device counts as an error.
fn request_device(
    adapter: &wgpu::Adapter,
    features: wgpu::Features,
    failure: &Arc<Mutex<Option<String>>>,
) -> Result<(wgpu::Device, wgpu::Queue)> {
    let (device, queue) = pollster::block_on(adapter.request_device(&wgpu::DeviceDescriptor {
        label: Some("particles"),
        required_features: features,
        required_limits: adapter.limits(),
        memory_hints: MEMORY_BLOCKS,
        ..wgpu::DeviceDescriptor::default()
    }))
    .map_err(|error| {
        Error::gpu(
            format!("{}: cannot be opened: {error}", summary(adapter).name),
            "the particles are moved on this adapter",
            "close other programs that use it, update its driver, or set BACKEND=cpu (--backend cpu)",
        )
    })?;
    let keep = |failure: &Arc<Mutex<Option<String>>>, text: String| {
        failure.lock().unwrap_or_else(PoisonError::into_inner).get_or_insert(text);
    };
    let (uncaptured, lost) = (failure.clone(), failure.clone());
    device.on_uncaptured_error(Arc::new(move |error: wgpu::Error| keep(&uncaptured, error.to_string())));
    device.set_device_lost_callback(move |reason, text| {
        if reason != wgpu::DeviceLostReason::Destroyed {
            keep(&lost, format!("the device was lost: {text}"));
        }
    });
    Ok((device, queue))
}

impl Gpu {
    /// Opens the selected adapter.
    ///
    /// # Errors
    /// If no adapter matches or if the adapter cannot be opened. The exit code is then 3.
    pub fn open(choice: &AdapterChoice) -> Result<Self> {
        let instance = instance();
        let all = found(&instance);
        let adapter = select(&all, choice)?;
        let summary = summary(adapter);
        let features = adapter.features();
        let limits = adapter.limits();
        let largest_slab = limits.max_storage_buffer_binding_size.min(limits.max_buffer_size);
        let largest_slab = largest_slab.min(choice.largest_slab.unwrap_or(u64::MAX));
        let subgroups =
            features.contains(wgpu::Features::SUBGROUP) && summary.subgroup[0] >= 32 && !choice.no_subgroups;
        let timestamps = choice.profile && features.contains(wgpu::Features::TIMESTAMP_QUERY);
        let mut wanted = wgpu::Features::empty();
        wanted.set(wgpu::Features::SUBGROUP, subgroups);
        wanted.set(wgpu::Features::TIMESTAMP_QUERY, timestamps);
        let failure = Arc::new(Mutex::new(None));
        let (device, queue) = request_device(adapter, wanted, &failure)?;
        let subgroup_team = subgroups.then_some(choice.team.unwrap_or(8));
        Ok(Self {
            device,
            queue,
            limits,
            largest_slab,
            subgroup_team,
            timestamps,
            summary,
            failure,
            kernels: Mutex::default(),
        })
    }

    /// Returns the kernels for fields in one or several slabs and for one object or many materials.
    /// Compiles them on first use.
    pub(super) fn kernels(&self, several: bool, materials: bool) -> Result<Arc<Kernels>> {
        let mut known = self.kernels.lock().unwrap_or_else(PoisonError::into_inner);
        let slot = &mut known[usize::from(several) + 2 * usize::from(materials)];
        if let Some(kernels) = slot {
            return Ok(Arc::clone(kernels));
        }
        let variant = Variant { slabs: several, subgroup_team: self.subgroup_team, materials };
        let kernels = Arc::new(Kernels::new(&self.device, variant));
        self.check()?;
        *slot = Some(Arc::clone(&kernels));
        Ok(kernels)
    }

    /// Returns the properties of the adapter.
    pub fn summary(&self) -> &AdapterSummary {
        &self.summary
    }

    /// Returns whether kernels are timed.
    pub fn has_timestamps(&self) -> bool {
        self.timestamps
    }

    /// Returns a description of the adapter's limits for verbose output.
    pub fn limits_in_words(&self) -> String {
        format!(
            "limits: {} storage buffers per kernel, {} bytes of workgroup memory, subgroups of {} to {}; sums by {}",
            self.limits.max_storage_buffers_per_shader_stage,
            self.limits.max_compute_workgroup_storage_size,
            self.summary.subgroup[0],
            self.summary.subgroup[1],
            match self.subgroup_team {
                Some(lanes) => format!("subgroup operations over {lanes} lanes"),
                None => "workgroup memory".to_owned(),
            }
        )
    }

    /// Returns an error if the device has reported an error since it was opened.
    pub(crate) fn check(&self) -> Result<()> {
        match &*self.failure.lock().unwrap_or_else(PoisonError::into_inner) {
            Some(text) => Err(self.failed(text)),
            None => Ok(()),
        }
    }

    /// Waits until the device has finished all submissions.
    pub(crate) fn wait(&self) -> Result<()> {
        self.wait_for(None)
    }

    /// Waits until the device has finished the given submission, or all submissions if none is
    /// given.
    pub(crate) fn wait_for(&self, submission: Option<&wgpu::SubmissionIndex>) -> Result<()> {
        let until = wgpu::PollType::Wait { submission_index: submission.cloned(), timeout: None };
        self.device.poll(until).map_err(|error| self.failed(&error.to_string()))?;
        self.check()
    }

    /// Returns the error for a failure of the device.
    pub(crate) fn failed(&self, what: &str) -> Error {
        Error::gpu(
            format!("{}: {what}", self.summary.name),
            "the particles are in the memory of that device",
            "run the same command again, with --resume if there is a checkpoint (make does this); if it fails again, \
             set BACKEND=cpu (--backend cpu)",
        )
    }
}
