//! The particles on the device and a pass over them.
//!
//! Between passes the state is in one of two places. In the *sorted* buffers (`place`, `normal`) particles lie bin by bin, the
//! neighbour lists and classes point into them, and movement changes them in place. Density control writes its result, when
//! anything changed, into the *listed* buffers (`listed_place`, `listed_normal`), from which the next pass sorts again.

use super::adapter::Gpu;
use super::commands::{Command, Encoded, Profile, encode, submit};
use super::constants::{
    BLOCK, CLASSES, WORD_COUNT, WORD_DEFECTS, WORD_ENERGY, WORD_KEPT, WORD_LISTED, WORD_LONGEST, WORD_MOVED,
    WORD_TRIES, WORDS,
};
use super::kernels::{Kernels, ROUND_STRIDE};
use super::levels::Levels;
use super::materials::{Carried, Ground};
use super::memory::{Memory, download, read_staging, staging, upload};
use super::parameters::{device_origin, pass_block, run_block, scan_block, scan_blocks};
use super::report::{DeviceReport, KernelTime};
use super::schedule::{Step, steps};
use crate::constants::REBUILD_MOVE;
use crate::settle::{Binning, Engine, Parameters, PassOutcome, REORDER_INTERVAL};
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

/// What a pass is made of.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Plan {
    /// Sort, and make lists and classes anew.
    sort: bool,
    /// Bring the particles from the sorted to the listed buffers beforehand.
    bring: bool,
    /// Control the density.
    density: bool,
}

/// Moves the particles on a GPU.
pub struct GpuEngine<'a> {
    gpu: &'a Gpu,
    pub(super) kernels: Arc<Kernels>,
    pub(super) memory: Memory,
    groups: HashMap<(&'static str, u32), wgpu::BindGroup>,
    words: wgpu::Buffer,
    pub(super) geometry: Geometry,
    carried: Carried,
    /// The strata of the particles as they came back last.
    strata: Vec<Stratum>,
    settling: Parameters,
    pub(super) levels: Levels,
    slab_length: u32,
    pub(super) count: u32,
    capacity: u32,
    pub(super) list_capacity: u32,
    /// Whether the state is in the listed buffers.
    pub(super) listed: bool,
    /// Whether a particle has moved too far for the lists.
    stale: bool,
    profile: Profile,
    /// The next pass, if it is of this plan and has no more than so many particles.
    ahead: Option<(Plan, u32, Encoded)>,
    started: Instant,
    /// Seconds so far; what has no place of its own stays zero until [`GpuEngine::report`].
    spent: DeviceReport,
}

impl<'a> GpuEngine<'a> {
    /// Puts fields and particles onto the device.
    pub fn new(gpu: &'a Gpu, fields: &Fields, set: &ParticleSet, settling: &Parameters) -> Result<Self> {
        let levels = Levels::new(fields, settling.binning == Binning::Graded);
        let ground = Ground::object(fields.surface);
        Self::over(gpu, &ground, (fields.sizing, levels), (set, &[]), Carried::default(), settling)
    }

    /// Puts the differences of many materials, h and particles with their strata, those that are held first, onto the device.
    pub(crate) fn of_materials(
        gpu: &'a Gpu,
        (materials, sizing): (&Materials, &SizingField),
        (set, strata): (&ParticleSet, &[Stratum]),
        settling: &Parameters,
    ) -> Result<Self> {
        let levels = Levels::everywhere(sizing, settling.binning == Binning::Graded);
        let carried = Carried::new(set, strata)?;
        let ground = Ground::materials(materials, &carried);
        Self::over(gpu, &ground, (sizing, levels), (set, strata), carried, settling)
    }

    fn over(
        gpu: &'a Gpu,
        ground: &Ground<'_>,
        (sizing, levels): (&SizingField, Levels),
        (set, strata): (&ParticleSet, &[Stratum]),
        carried: Carried,
        settling: &Parameters,
    ) -> Result<Self> {
        let compiling = Instant::now();
        let geometry = ground.geometry.clone();
        let longest = ground.coefficients.len().max(geometry.voxel_count()) as u64;
        let slab_length = slab_length(gpu, longest)?;
        let kernels = gpu.kernels(u64::from(slab_length) < longest, ground.index.is_some())?;
        let compile_seconds = compiling.elapsed().as_secs_f64();
        let started = Instant::now();
        let mut memory = Memory::default();
        let uniform = wgpu::BufferUsages::UNIFORM;
        memory.make(gpu, "parameters", 1024, uniform)?;
        for name in ["now", "scan_bins", "scan_lists", "scan_keep"] {
            memory.make(gpu, name, 16, uniform)?;
        }
        memory.make(gpu, "round", u64::from(CLASSES) * ROUND_STRIDE, uniform)?;
        let numbers: Vec<u32> = (0..CLASSES).flat_map(|n| std::iter::once(n).chain([0; 63])).collect();
        upload(gpu, memory.get("round"), &numbers)?;
        for (name, values) in [("surface", ground.coefficients.as_ref()), ("sizing", sizing.image().data.as_slice())] {
            let mut slabs = values.chunks(slab_length as usize);
            for k in 0..4 {
                let slab = slabs.next().unwrap_or(&[0.0]);
                let name = format!("{name}_{k}");
                memory.make(gpu, &name, 4 * slab.len() as u64, wgpu::BufferUsages::empty())?;
                upload(gpu, memory.get(&name), slab)?;
            }
        }
        if let Some(index) = &ground.index {
            memory.make(gpu, "materials_index", 16 * index.len() as u64, wgpu::BufferUsages::empty())?;
            upload(gpu, memory.get("materials_index"), index)?;
        }
        let bins = u64::from(levels.bin_total());
        memory.make(gpu, "bin_counts", 4 * bins, wgpu::BufferUsages::empty())?;
        memory.make(gpu, "bin_starts", 4 * (bins + 1), wgpu::BufferUsages::empty())?;
        memory.make(gpu, "class_counts", 4 * u64::from(CLASSES), wgpu::BufferUsages::empty())?;
        memory.make(gpu, "class_starts", 4 * u64::from(CLASSES + 1), wgpu::BufferUsages::empty())?;
        memory.make(gpu, "class_arguments", 12 * u64::from(CLASSES), wgpu::BufferUsages::INDIRECT)?;
        memory.make(gpu, "words", 64, wgpu::BufferUsages::empty())?;
        let mut engine = Self {
            gpu,
            kernels,
            memory,
            groups: HashMap::new(),
            words: staging(gpu, 64),
            geometry,
            carried,
            strata: strata.to_vec(),
            settling: settling.clone(),
            levels,
            slab_length,
            count: 0,
            capacity: 0,
            list_capacity: 0,
            listed: true,
            stale: true,
            profile: Profile::default(),
            ahead: None,
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
        self.make_room(count)?;
        self.make_lists(24 * u64::from(count))?;
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
        upload(self.gpu, self.memory.get("listed_place"), &place)?;
        upload(self.gpu, self.memory.get("listed_normal"), &normal)?;
        self.count = count;
        Ok(())
    }

    /// Makes every buffer that holds something by particle, with room for twice as many: a pass adds at most one newcomer for each
    /// particle, so density control can never run over.
    fn make_room(&mut self, count: u32) -> Result<()> {
        let capacity = u32::try_from(2 * u64::from(count) + 1024).unwrap_or(u32::MAX);
        let none = wgpu::BufferUsages::empty();
        let vectors = [
            "listed_place",
            "listed_normal",
            "place",
            "normal",
            "place_at_listing",
            "newcomer_place",
            "newcomer_normal",
        ];
        for name in vectors {
            self.memory.make(self.gpu, name, 16 * u64::from(capacity), none)?;
        }
        let words = [
            "bin_of",
            "order",
            "neighbour_counts",
            "list_starts",
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
            self.memory.make(self.gpu, name, 4 * (u64::from(capacity) + 1), none)?;
        }
        for name in ["keep", "destinations"] {
            self.memory.make(self.gpu, name, 8 * u64::from(capacity) + 4, none)?;
        }
        self.memory.make(self.gpu, "block_totals", 20 * u64::from(capacity.div_ceil(BLOCK)), none)?;
        let blocks = scan_blocks(self.levels.bin_total()).max(scan_blocks(2 * capacity));
        self.memory.make(self.gpu, "scan_sums", 4 * u64::from(blocks), none)?;
        self.capacity = capacity;
        self.groups.clear();
        self.ahead = None;
        Ok(())
    }

    /// Makes the neighbour lists with room for so many members.
    pub(super) fn make_lists(&mut self, members: u64) -> Result<()> {
        let members = members.max(4096);
        self.memory.make(self.gpu, "lists", 4 * members, wgpu::BufferUsages::empty())?;
        self.list_capacity = u32::try_from(members).map_err(|_| too_many(self.gpu))?;
        let block = run_block(&self.geometry, &self.levels, &self.settling, self.slab_length, self.list_capacity);
        self.write("parameters", block.bytes());
        self.groups.clear();
        self.ahead = None;
        Ok(())
    }

    fn write(&self, name: &str, bytes: &[u8]) {
        self.gpu.queue.write_buffer(self.memory.get(name), 0, bytes);
    }

    /// Makes room for growth: the state must be in the listed buffers.
    fn grow(&mut self) -> Result<()> {
        let bytes = 16 * u64::from(self.count);
        let mut kept = Vec::new();
        for name in ["listed_place", "listed_normal"] {
            kept.push((name, self.memory.get(name).clone()));
        }
        self.make_room(self.count + self.count / 2)?;
        let mut encoder = self.gpu.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        for (name, old) in &kept {
            encoder.copy_buffer_to_buffer(old, 0, self.memory.get(name), 0, bytes);
        }
        self.gpu.queue.submit([encoder.finish()]);
        Ok(())
    }

    /// Runs the steps of a pass in one command buffer; returns the words that the host reads.
    #[cfg(test)]
    pub(super) fn run_steps(&mut self, pass: u64, steps: &[Step], sort: bool) -> Result<Vec<u32>> {
        let encoded = self.encode(steps, sort && !self.listed, sort);
        self.submit(pass, encoded)?;
        self.read_words()
    }

    /// Runs a pass once; returns the words that the host reads.
    fn run_pass(&mut self, pass: u64, plan: Plan) -> Result<Vec<u32>> {
        let begun = Instant::now();
        let ready = self.ahead.take().filter(|(planned, room, _)| *planned == plan && self.count <= *room);
        let encoded = match ready {
            Some((_, _, encoded)) => encoded,
            None => self.encode_plan(plan, self.count),
        };
        let timed = self.submit(pass, encoded)?;
        let handed_over = Instant::now();
        self.spent.encode_seconds += (handed_over - begun).as_secs_f64();
        // while the device works: the next pass, likely to be of the same kind and of about as many particles
        let sort = plan.sort || (pass + 1) % REORDER_INTERVAL == 1;
        let next = Plan { sort, bring: sort && !plan.density, ..plan };
        let room = (self.count + self.count / 32 + 64).min(self.capacity);
        self.ahead = Some((next, room, self.encode_plan(next, room)));
        self.profile.collect(self.gpu, &timed)?;
        let words = self.read_words()?;
        self.spent.wait_seconds += handed_over.elapsed().as_secs_f64();
        Ok(words)
    }

    /// Encodes a pass over up to so many particles.
    fn encode_plan(&mut self, plan: Plan, count: u32) -> Encoded {
        let steps = steps(count, &self.levels, self.settling.order, plan.sort, plan.density);
        self.encode(&steps, plan.bring, plan.sort)
    }

    /// Encodes steps, after bringing the particles back to the listed buffers if `bring` is set.
    fn encode(&mut self, steps: &[Step], bring: bool, sort: bool) -> Encoded {
        for step in steps {
            let key = (step.label, step.round);
            if !self.groups.contains_key(&key) {
                let group = self.kernels.bind(self.gpu, &self.memory, step.kernel, step.round, step.aliases);
                self.groups.insert(key, group);
            }
        }
        let memory = &self.memory;
        let mut commands = Vec::with_capacity(steps.len() + 4);
        if bring {
            for (from, to) in [("place", "listed_place"), ("normal", "listed_normal")] {
                commands.push(Command::Copy {
                    from: memory.get(from),
                    to: memory.get(to),
                    bytes: 16 * u64::from(self.capacity),
                });
            }
        }
        if sort {
            commands.push(Command::Clear { buffer: memory.get("class_counts") });
        }
        commands.extend(steps.iter().map(|step| {
            let group = &self.groups[&(step.label, step.round)];
            match step.workgroups {
                Some(workgroups) => Command::Run { kernel: step.kernel, group, workgroups },
                None => Command::RunIndirect {
                    kernel: step.kernel,
                    group,
                    arguments: memory.get("class_arguments"),
                    offset: 12 * u64::from(step.round),
                },
            }
        }));
        commands.push(Command::Copy { from: memory.get("words"), to: &self.words, bytes: 4 * WORDS as u64 });
        encode(self.gpu, &self.kernels, &commands, &mut self.profile)
    }

    /// Hands a pass to the device.
    fn submit(&self, pass: u64, encoded: Encoded) -> Result<Vec<&'static str>> {
        self.write("now", pass_block(pass, self.count, self.settling.allow_insert).bytes());
        self.write("scan_lists", scan_block(self.count).bytes());
        self.write("scan_keep", scan_block(2 * self.count).bytes());
        let timed = submit(self.gpu, encoded);
        self.gpu.check()?;
        Ok(timed)
    }

    /// Waits for the pass to end.
    fn read_words(&self) -> Result<Vec<u32>> {
        read_staging(self.gpu, &self.words, 4 * WORDS as u64)
    }

    /// What the device did, from the upload to the last readback.
    fn report(&self) -> DeviceReport {
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

impl Engine for GpuEngine<'_> {
    fn device_report(&self) -> Option<DeviceReport> {
        Some(self.report())
    }

    fn pass(&mut self, pass: u64, density: bool) -> Result<PassOutcome> {
        let sort = self.listed || self.stale || pass % REORDER_INTERVAL == 1;
        let words = loop {
            let words = self.run_pass(pass, Plan { sort, bring: sort && !self.listed, density })?;
            // the lists need room for so many members; what the pass has done is cast away
            let needed = u64::from(words[WORD_LISTED]);
            if needed <= u64::from(self.list_capacity) {
                break words;
            }
            self.listed = true;
            self.make_lists(needed + needed / 2)?;
        };
        let before = self.count;
        let (after, kept) = (words[WORD_COUNT], words[WORD_KEPT]);
        self.listed = after != before || kept != before;
        self.stale = f64::from(f32::from_bits(words[WORD_LONGEST])) > REBUILD_MOVE;
        self.count = after;
        if u64::from(after) * 2 > u64::from(self.capacity) {
            self.grow()?;
        }
        let held = self.carried.held();
        let movable = f64::from(before.max(1)) - held as f64;
        Ok(PassOutcome {
            energy: f64::from(f32::from_bits(words[WORD_ENERGY])),
            count: after as usize - held,
            inserted: (after - kept) as usize,
            deleted: (before - kept) as usize,
            moved: words[WORD_MOVED] as usize,
            tries_per_particle: f64::from(words[WORD_TRIES]) / movable.max(1.0),
            neighbours: f64::from(words[WORD_LISTED]) / f64::from(before.max(1)),
            lattice_defects: words[WORD_DEFECTS] as usize,
        })
    }

    fn particles(&mut self) -> Result<ParticleSet> {
        let begun = Instant::now();
        let names = if self.listed { ["listed_place", "listed_normal"] } else { ["place", "normal"] };
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

    fn strata(&self) -> &[Stratum] {
        &self.strata
    }
}

/// Numbers in each slab of a field of so many: all of them where one binding holds the field.
fn slab_length(gpu: &Gpu, voxels: u64) -> Result<u32> {
    let most = gpu.largest_slab / 4;
    if voxels > 4 * most || voxels > u64::from(u32::MAX) {
        return Err(Error::gpu(
            format!(
                "{}: a field of {voxels} voxels does not fit four bindings of {} bytes",
                gpu.summary().name,
                4 * most
            ),
            "the distance field and the size field must be on the device",
            "use another adapter (--list-adapters shows their limits), a coarser volume, or --backend cpu",
        ));
    }
    Ok(voxels.min(most) as u32)
}

fn too_many(gpu: &Gpu) -> Error {
    Error::gpu(
        format!("{}: the neighbour lists have more than 2^32 members", gpu.summary().name),
        "the kernels count in 32 bits",
        "use a larger target edge length, or --backend cpu",
    )
}
