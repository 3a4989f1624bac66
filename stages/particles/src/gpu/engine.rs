//! The particles on the device, and their transfer to and from the host.
//!
//! Between passes the state is in either the sorted or the listed buffers. In the *sorted* buffers
//! (`place`, `normal`) the particles are in the order of the bins. Neighbour lists and classes
//! refer to these buffers, and movement overwrites them. Density control writes its result to one
//! of two sets of *listed* buffers, and the next pass sorts the particles again (`passes.rs`).

use super::adapter::Gpu;
use super::commands::{Encoded, Profile};
use super::constants::{CLASSES, FIRST_LIST_ROOM, LIST_TILE, SUM_BLOCK};
use super::kernels::{Kernels, ROUND_STRIDE};
use super::levels::{BinLevels, device_origin};
use super::materials::{Carried, DeviceSurface};
use super::memory::{Memory, download, staging, upload};
use super::parameters::{run_block, scan_block, scan_blocks};
use super::report::{DeviceReport, KernelTime};
use super::schedule::{Plan, listed};
use crate::settle::{Binning, Parameters};
use crate::state::Fields;
use isoparticles_field::materials::{Materials, Stratum};
use isoparticles_field::particle_set::ParticleSet;
use isoparticles_field::sizing::SizingField;
use isoparticles_stage::error::{Error, Result};
use isoparticles_volume::Geometry;
use rayon::prelude::*;
use std::collections::HashMap;
use std::sync::Arc;
use std::time::Instant;

/// Commands of the next pass, encoded while the device runs the current pass.
pub(super) struct EncodedPass {
    pub(super) plan: Plan,
    /// Maximum number of particles that the commands can process.
    pub(super) room: u32,
    pub(super) encoded: Encoded,
}

/// A submitted pass.
pub(super) struct SubmittedPass {
    pub(super) pass: u64,
    pub(super) plan: Plan,
    /// Maximum number of particles that the pass can process.
    pub(super) room: u32,
    pub(super) submission: wgpu::SubmissionIndex,
    /// Kernels with timestamps.
    pub(super) timed: Vec<&'static str>,
}

/// Engine that moves the particles on a GPU.
pub struct GpuEngine<'a> {
    pub(super) gpu: &'a Gpu,
    pub(super) kernels: Arc<Kernels>,
    pub(super) memory: Memory,
    /// Bind groups of the steps, by label, round and first aliased buffer.
    pub(super) groups: HashMap<(&'static str, u32, &'static str), wgpu::BindGroup>,
    /// Staging buffers for the words of a pass, indexed by the set of listed buffers that the pass
    /// reads.
    pub(super) words: [wgpu::Buffer; 2],
    pub(super) geometry: Geometry,
    pub(super) carried: Carried,
    /// Strata of the particles at the last readback.
    pub(super) strata: Vec<Stratum>,
    pub(super) settling: Parameters,
    pub(super) levels: BinLevels,
    slab_length: u32,
    pub(super) count: u32,
    /// Capacity of the buffers in particles.
    pub(super) rows: u32,
    /// Capacity of each neighbour list.
    pub(super) list_room: u32,
    /// True if the state is in the listed buffers.
    pub(super) listed: bool,
    /// Set of listed buffers that contains, or last contained, the state.
    pub(super) set: usize,
    /// True if a particle has moved so far that the lists must be rebuilt.
    pub(super) stale: bool,
    /// Number of classes that a pass dispatches. Empty classes cost a dispatch too, so this number
    /// only slightly exceeds the number of classes in use.
    pub(super) classes: u32,
    /// Absolute change in the number of particles in the last pass.
    pub(super) changed: u32,
    /// Last pass that controls the density.
    pub(super) last_control: u64,
    pub(super) profile: Profile,
    /// Commands encoded for the next pass.
    pub(super) encoded_next: Option<EncodedPass>,
    /// The next pass, if it was submitted early.
    pub(super) submitted: Option<SubmittedPass>,
    started: Instant,
    /// Times measured so far. [`GpuEngine::report`] fills in the other fields.
    pub(super) spent: DeviceReport,
}

impl<'a> GpuEngine<'a> {
    /// Creates an engine and uploads fields and particles.
    pub fn new(gpu: &'a Gpu, fields: &Fields, set: &ParticleSet, settling: &Parameters) -> Result<Self> {
        let levels = BinLevels::new(fields, settling.binning == Binning::Graded);
        let surface = DeviceSurface::object(fields.surface);
        Self::over(gpu, &surface, (fields.sizing, levels), (set, &[]), Carried::default(), settling)
    }

    /// Creates an engine for many materials. Uploads the differences of the indicators, h, and the
    /// particles with their strata. Held particles must come first.
    pub(crate) fn of_materials(
        gpu: &'a Gpu,
        (materials, sizing): (&Materials, &SizingField),
        (set, strata): (&ParticleSet, &[Stratum]),
        settling: &Parameters,
    ) -> Result<Self> {
        let levels = BinLevels::everywhere(sizing, settling.binning == Binning::Graded);
        let carried = Carried::new(set, strata)?;
        let surface = DeviceSurface::materials(materials, &carried);
        Self::over(gpu, &surface, (sizing, levels), (set, strata), carried, settling)
    }

    fn over(
        gpu: &'a Gpu,
        surface: &DeviceSurface<'_>,
        (sizing, levels): (&SizingField, BinLevels),
        (set, strata): (&ParticleSet, &[Stratum]),
        carried: Carried,
        settling: &Parameters,
    ) -> Result<Self> {
        let compiling = Instant::now();
        let geometry = surface.geometry.clone();
        let longest = surface.coefficients.len().max(geometry.voxel_count()) as u64;
        let slab_length = slab_length(gpu, longest)?;
        let kernels = gpu.kernels(u64::from(slab_length) < longest, surface.index.is_some())?;
        let compile_seconds = compiling.elapsed().as_secs_f64();
        let started = Instant::now();
        let mut memory = Memory::default();
        make_fixed_buffers(gpu, &mut memory, levels.bin_total())?;
        upload_surface(gpu, &mut memory, surface, sizing, slab_length)?;
        let mut engine = Self {
            gpu,
            kernels,
            memory,
            groups: HashMap::new(),
            words: [staging(gpu, 64), staging(gpu, 64)],
            geometry,
            carried,
            strata: strata.to_vec(),
            settling: settling.clone(),
            levels,
            slab_length,
            count: 0,
            rows: 0,
            list_room: FIRST_LIST_ROOM,
            listed: true,
            set: 0,
            stale: true,
            classes: CLASSES,
            changed: 0,
            last_control: 0,
            profile: Profile::default(),
            encoded_next: None,
            submitted: None,
            started,
            spent: DeviceReport { compile_seconds, ..DeviceReport::default() },
        };
        engine.upload_particles(set, strata)?;
        engine.write("scan_bins", scan_block(engine.levels.bin_total()).bytes());
        gpu.check()?;
        engine.spent.upload_seconds = engine.started.elapsed().as_secs_f64();
        Ok(engine)
    }

    fn upload_particles(&mut self, set: &ParticleSet, strata: &[Stratum]) -> Result<()> {
        let count = u32::try_from(set.positions.len()).unwrap_or(u32::MAX);
        // spare capacity for the first passes; `grow` enlarges the buffers later
        self.make_room(count.saturating_add(count / 8 + 512))?;
        let origin = device_origin(&self.geometry);
        let largest = self.levels.levels[0].largest;
        let place: Vec<[f32; 4]> = set
            .positions
            .par_iter()
            .zip(&set.sizes)
            .map(|(p, &h)| (*p - origin).as_vec3().extend((h as f32).min(largest)).to_array())
            .collect();
        let normal: Vec<[f32; 4]> = set
            .normals
            .par_iter()
            .zip(&set.lambdas)
            .enumerate()
            .map(|(i, (n, &lambda))| n.as_vec3().extend(self.carried.of(i, lambda, strata)).to_array())
            .collect();
        let [places, normals] = listed(self.set);
        upload(self.gpu, self.memory.get(places), &place)?;
        upload(self.gpu, self.memory.get(normals), &normal)?;
        self.count = count;
        Ok(())
    }

    /// Creates all buffers whose size depends on the number of particles, with a capacity of `rows`
    /// particles. The `listed_*` buffers have twice this capacity: a pass adds at most one newcomer
    /// per particle, so density control cannot overflow them.
    fn make_room(&mut self, rows: u32) -> Result<()> {
        let none = wgpu::BufferUsages::empty();
        for name in ["place", "normal", "place_at_listing", "newcomer_place", "newcomer_normal"] {
            self.memory.make(self.gpu, name, 16 * u64::from(rows), none)?;
        }
        for name in [listed(0), listed(1)].as_flattened() {
            self.memory.make(self.gpu, name, 32 * u64::from(rows), none)?;
        }
        let words = [
            "bin_of",
            "order",
            "list_lengths",
            "classes",
            "proposed_classes",
            "class_members",
            "outcome",
            "energies",
            "marks",
            "touched",
            "proposals",
        ];
        for name in words {
            self.memory.make(self.gpu, name, 4 * u64::from(rows), none)?;
        }
        for name in ["keep", "destinations"] {
            self.memory.make(self.gpu, name, 8 * u64::from(rows) + 4, none)?;
        }
        self.memory.make(self.gpu, "block_totals", 28 * u64::from(rows.div_ceil(SUM_BLOCK)), none)?;
        let blocks = scan_blocks(self.levels.bin_total()).max(scan_blocks(2 * rows));
        self.memory.make(self.gpu, "scan_sums", 4 * u64::from(blocks), none)?;
        self.rows = rows;
        self.make_lists(self.list_room)
    }

    /// Creates neighbour lists, each with a capacity of at least `members` particles.
    ///
    /// # Errors
    /// If the lists exceed the limits of the adapter.
    pub(super) fn make_lists(&mut self, members: u32) -> Result<()> {
        // members are stored in groups of four
        self.list_room = members.next_multiple_of(4);
        let all = u64::from(self.list_room) * u64::from(self.rows.next_multiple_of(LIST_TILE));
        if all > u64::from(u32::MAX) || 4 * all > self.gpu.limits.max_storage_buffer_binding_size {
            return Err(no_room_for_lists(self.gpu, self.rows, self.list_room));
        }
        self.memory.make(self.gpu, "lists", 4 * all, wgpu::BufferUsages::empty())?;
        let block = run_block(&self.geometry, &self.levels, &self.settling, self.slab_length, self.list_room);
        self.write("parameters", block.bytes());
        self.groups.clear();
        self.encoded_next = None;
        Ok(())
    }

    pub(super) fn write(&self, name: &str, bytes: &[u8]) {
        self.gpu.queue.write_buffer(self.memory.get(name), 0, bytes);
    }

    /// Enlarges the buffers and copies the state. The state must be in the listed buffers.
    pub(super) fn grow(&mut self) -> Result<()> {
        let bytes = 16 * u64::from(self.count);
        let mut kept = Vec::new();
        for name in listed(self.set) {
            kept.push((name, self.memory.get(name).clone()));
        }
        self.make_room(self.count.saturating_add(self.count / 4 + 512))?;
        let mut encoder = self.gpu.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        for (name, old) in &kept {
            encoder.copy_buffer_to_buffer(old, 0, self.memory.get(name), 0, bytes);
        }
        self.gpu.queue.submit([encoder.finish()]);
        Ok(())
    }

    /// Downloads the particles.
    pub(super) fn bring_back(&mut self) -> Result<ParticleSet> {
        let begun = Instant::now();
        let names = if self.listed { listed(self.set) } else { ["place", "normal"] };
        let count = self.count as usize;
        let place: Vec<[f32; 4]> = download(self.gpu, self.memory.get(names[0]), count)?;
        let normal: Vec<[f32; 4]> = download(self.gpu, self.memory.get(names[1]), count)?;
        self.spent.readback_seconds += begun.elapsed().as_secs_f64();
        self.spent.device_seconds = self.started.elapsed().as_secs_f64();
        let origin = device_origin(&self.geometry);
        let vector = |v: &[f32; 4]| glam::Vec3::new(v[0], v[1], v[2]).as_dvec3();
        let set = ParticleSet {
            geometry: self.geometry.clone(),
            positions: place.iter().map(|p| origin + vector(p)).collect(),
            normals: normal.iter().map(vector).collect(),
            sizes: place.iter().map(|p| f64::from(p[3])).collect(),
            energies: vec![0.0; count],
            lambdas: normal.iter().map(|n| f64::from(n[3])).collect(),
        };
        let (set, strata) = self.carried.put_back(set);
        self.strata = strata;
        Ok(set)
    }

    /// Returns the statistics of the device, from the upload to the last readback.
    pub(super) fn report(&self) -> DeviceReport {
        let mut kernels: Vec<_> = self
            .profile
            .times
            .iter()
            .map(|(&kernel, &(seconds, dispatches))| KernelTime { kernel, seconds, dispatches })
            .collect();
        kernels.sort_by(|a, b| b.seconds.total_cmp(&a.seconds));
        DeviceReport {
            adapter: self.gpu.summary().name.clone(),
            peak_device_bytes: self.memory.peak(),
            levels: self.levels.levels.len(),
            bins: self.levels.bin_total(),
            kernels,
            ..self.spent.clone()
        }
    }
}

/// Creates the buffers whose size does not depend on the number of particles. `bins` is the number
/// of bins in all levels.
fn make_fixed_buffers(gpu: &Gpu, memory: &mut Memory, bins: u32) -> Result<()> {
    let uniform = wgpu::BufferUsages::UNIFORM;
    memory.make(gpu, "parameters", 1024, uniform)?;
    memory.make(gpu, "planned", 32, uniform)?;
    for name in ["now", "scan_bins", "scan_keep"] {
        memory.make(gpu, name, 16, uniform)?;
    }
    memory.make(gpu, "round", u64::from(CLASSES) * ROUND_STRIDE, uniform)?;
    let numbers: Vec<u32> = (0..CLASSES).flat_map(|n| std::iter::once(n).chain([0; 63])).collect();
    upload(gpu, memory.get("round"), &numbers)?;
    let bins = u64::from(bins);
    memory.make(gpu, "bin_counts", 4 * bins, wgpu::BufferUsages::empty())?;
    memory.make(gpu, "bin_starts", 4 * (bins + 1), wgpu::BufferUsages::empty())?;
    memory.make(gpu, "class_counts", 4 * u64::from(CLASSES), wgpu::BufferUsages::empty())?;
    memory.make(gpu, "class_starts", 4 * u64::from(CLASSES + 1), wgpu::BufferUsages::empty())?;
    memory.make(gpu, "class_arguments", 12 * u64::from(CLASSES), wgpu::BufferUsages::INDIRECT)?;
    memory.make(gpu, "words", 64, wgpu::BufferUsages::empty())?;
    Ok(())
}

/// Uploads the coefficients of the surface, the index of the coefficients (only for many materials)
/// and the samples of h. Coefficients and samples are split into slabs of `slab_length` values.
fn upload_surface(
    gpu: &Gpu,
    memory: &mut Memory,
    surface: &DeviceSurface<'_>,
    sizing: &SizingField,
    slab_length: u32,
) -> Result<()> {
    for (name, values) in [("surface", surface.coefficients.as_ref()), ("sizing", sizing.image().data.as_slice())] {
        let mut slabs = values.chunks(slab_length as usize);
        for k in 0..4 {
            let slab = slabs.next().unwrap_or(&[0.0]);
            let name = format!("{name}_{k}");
            memory.make(gpu, &name, 4 * slab.len() as u64, wgpu::BufferUsages::empty())?;
            upload(gpu, memory.get(&name), slab)?;
        }
    }
    if let Some(index) = &surface.index {
        memory.make(gpu, "materials_index", 16 * index.len() as u64, wgpu::BufferUsages::empty())?;
        upload(gpu, memory.get("materials_index"), index)?;
    }
    Ok(())
}

/// Returns the number of values in each slab of a field with `voxels` values. If the field fits
/// into one binding, this is `voxels`.
fn slab_length(gpu: &Gpu, voxels: u64) -> Result<u32> {
    let most = gpu.largest_slab / 4;
    if voxels > 4 * most || voxels > u64::from(u32::MAX) {
        return Err(Error::gpu(
            format!(
                "{}: a field of {voxels} voxels does not fit in four bindings of {} bytes",
                gpu.summary().name,
                4 * most
            ),
            "the distance field and the size field must fit in device memory",
            "use another adapter (--list-adapters shows their limits), a coarser volume, or BACKEND=cpu (--backend \
             cpu)",
        ));
    }
    Ok(voxels.min(most) as u32)
}

fn no_room_for_lists(gpu: &Gpu, particles: u32, members: u32) -> Error {
    Error::gpu(
        format!(
            "{}: neighbour lists of {particles} particles with {members} entries each do not fit in device memory",
            gpu.summary().name
        ),
        "all lists are as long as the longest one; particles far closer together than h make it long",
        "leave out COUNT (seed --count), raise SIZE or MIN_SIZE (sizefield --uniform, --min-size), or set \
         BACKEND=cpu (--backend cpu)",
    )
}
