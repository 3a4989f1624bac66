//! The `particles` program: reads the input files, settles the particles, and writes the log,
//! checkpoints and results. [`compute()`] accesses only the log and the checkpoint, so it can be
//! called as a library. The options are in `args.rs`.

use crate::args::{Args, Backend};
use crate::checkpoint::{Progress, cpu_engine, keep, resume};
use crate::coarse::{MakeEngine, settle_levels};
use crate::cpu::{CpuEngine, OnCpu, OnStrata, settle_interfaces_with};
use crate::gpu::{self, AdapterChoice, DeviceReport, Gpu, GpuEngine};
use crate::implicit::Interfaces;
use crate::log::Log;
use crate::matching::{check_kind, check_levels};
use crate::settle::{Engine, Order, Parameters, PassRecord, Summary};
use crate::state::Fields;
use isoparticles_field::materials::{Materials, Stratum};
use isoparticles_field::particle_set::{ParticleSet, Strata};
use isoparticles_field::sizing::SizingField;
use isoparticles_field::spline::CubicSpline;
use isoparticles_stage::cli::{Context, Outcome};
use isoparticles_stage::distance_field::DistanceField;
use isoparticles_stage::error::{Error, Result};
use isoparticles_stage::field_file::{Field, FieldKind, check_same_grid, read_field};
use isoparticles_stage::materials_file::{MaterialsFile, is_materials};
use isoparticles_stage::particle_file::{ParticleFile, ParticleKind, read_particles};
use serde_json::json;
use std::cell::Cell;
use std::path::Path;
use std::sync::Arc;

/// Maximum memory in bytes per particle on the CPU, excluding the fields. Measured: 190 to 510
/// bytes per particle for the phantoms of `stages/distfield/benches/costs.py`.
const BYTES_PER_PARTICLE: f64 = 510.0;

/// Opens the GPU that the options select. Returns `None` if the CPU is to be used.
fn open_gpu(args: &Args, context: &Context) -> Result<Option<Gpu>> {
    let choice = AdapterChoice {
        name: args.adapter.clone(),
        no_subgroups: args.no_subgroups,
        team: args.team.as_ref().and_then(|t| t.parse().ok()),
        profile: args.profile,
        ..AdapterChoice::default()
    };
    let gpu = match args.backend {
        Backend::Cpu => return Ok(None),
        Backend::Gpu => Gpu::open(&choice)?,
        Backend::Auto => match Gpu::open(&choice) {
            Ok(gpu) => gpu,
            // no fallback to the CPU if the user names an adapter
            Err(error) if args.adapter.is_some() => return Err(error),
            Err(error) => {
                context.verbose(format!("the CPU is used: {}", error.what));
                return Ok(None);
            }
        },
    };
    context.verbose(format!("adapter: {}", gpu.summary()));
    context.verbose(gpu.limits_in_words());
    if args.profile && !gpu.has_timestamps() {
        context.info(format!("--profile: {} has no timestamp queries; kernels are not timed", gpu.summary().name));
    }
    Ok(Some(gpu))
}

/// Creates the engines that the options select.
struct Engines<'a> {
    gpu: Option<&'a Gpu>,
    parameters: &'a Parameters,
    /// True if the CPU is used when the engine cannot be created on the GPU.
    may_fall_back: bool,
    fell_back: Cell<bool>,
    context: &'a Context,
}

impl<'a> Engines<'a> {
    /// Creates the engine on the GPU. Returns `None` if the CPU is to be used.
    fn on_gpu<'f>(&self, make: impl FnOnce(&'a Gpu) -> Result<GpuEngine<'f>>) -> Result<Option<GpuEngine<'f>>> {
        let Some(gpu) = self.gpu.filter(|_| !self.fell_back.get()) else { return Ok(None) };
        match make(gpu) {
            Ok(engine) => Ok(Some(engine)),
            Err(error) if self.may_fall_back => {
                self.context.warn(format!("the CPU is used instead of the GPU: {}", error.what));
                self.fell_back.set(true);
                Ok(None)
            }
            Err(error) => Err(error),
        }
    }

    /// Creates an engine for multi-material particles.
    fn make_for_materials<'f>(
        &self,
        materials: &Materials,
        fields: &'f Fields<'f, Interfaces<'f, Materials>>,
        (set, strata): (ParticleSet, Vec<Stratum>),
    ) -> Result<Box<dyn Engine + 'f>>
    where
        'a: 'f,
    {
        let particles = (&set, strata.as_slice());
        let make = |gpu| GpuEngine::of_materials(gpu, (materials, fields.sizing), particles, self.parameters);
        Ok(match self.on_gpu(make)? {
            Some(engine) => Box::new(engine),
            None => Box::new(CpuEngine::new(set, strata, fields, self.parameters)),
        })
    }
}

impl MakeEngine for Engines<'_> {
    fn make<'f>(&self, set: ParticleSet, fields: &'f Fields<'f>) -> Result<Box<dyn Engine + 'f>>
    where
        Self: 'f,
    {
        match self.on_gpu(|gpu| GpuEngine::new(gpu, fields, &set, self.parameters))? {
            Some(engine) => Ok(Box::new(engine)),
            None => OnCpu(self.parameters).make(set, fields),
        }
    }
}

/// Prints the adapters, one per line.
fn list_adapters() {
    let adapters = gpu::adapters();
    for adapter in &adapters {
        println!("{adapter}");
    }
    if adapters.is_empty() {
        eprintln!("no adapter found: no Vulkan, Metal or DX12 driver is installed");
    }
}

/// Writes the device statistics to the closing table and to the report.
fn tell(report: &DeviceReport, context: &Context) {
    context.summary("adapter", &report.adapter);
    context.summary("device time", format!("{:.3} s", report.device_seconds));
    context.summary(
        "  breakdown",
        format!(
            "{:.3} s upload, {:.3} s encoding, {:.3} s waiting for passes, {:.3} s readback",
            report.upload_seconds, report.encode_seconds, report.wait_seconds, report.readback_seconds
        ),
    );
    context.summary("device memory", format!("{} MiB", report.peak_device_bytes.div_ceil(1 << 20)));
    let all: f64 = report.kernels.iter().map(|k| k.seconds).sum();
    for kernel in &report.kernels {
        context.summary(
            format!("  {}", kernel.kernel),
            format!(
                "{:.3} ms, {:.1} %, {} dispatches",
                1e3 * kernel.seconds,
                100.0 * kernel.seconds / all.max(f64::MIN_POSITIVE),
                kernel.dispatches
            ),
        );
    }
    context.report("device", json!(report));
}

/// Paths of the input and output files.
#[derive(Clone, Copy)]
struct Files<'a> {
    seeds: &'a Path,
    distance: &'a Path,
    sizing: &'a Path,
    output: &'a Path,
}

impl<'a> Files<'a> {
    /// Returns the paths on the command line, or `None` if one is missing. The parser allows this
    /// only with --list-adapters.
    fn of(args: &'a Args) -> Option<Self> {
        Some(Self {
            seeds: args.seeds.as_deref()?,
            distance: args.distfield.as_deref()?,
            sizing: args.sizefield.as_deref()?,
            output: args.output.as_deref()?,
        })
    }
}

/// The data that the stage works on.
#[derive(Clone, Debug)]
pub struct Inputs {
    /// The seeds.
    pub seeds: ParticleFile,
    /// The surface that they sample.
    pub distance: DistanceField,
    /// The size field.
    pub sizing: Field,
    /// Hashes of the files of the seeds, the surface and the size field. A checkpoint stores them.
    pub hashes: [String; 3],
}

impl Inputs {
    /// Reads the input files.
    fn read(files: Files<'_>, context: &Context) -> Result<Self> {
        let (seeds, (distance, sizing)) = rayon::join(
            || read_particles(files.seeds, &[ParticleKind::Seeds, ParticleKind::Particles]),
            || rayon::join(|| DistanceField::read(files.distance), || read_field(files.sizing, FieldKind::Sizing)),
        );
        let (seeds, distance, sizing) = (seeds?, distance?, sizing?);
        let hashes = context.add_inputs([
            (files.seeds, Some(seeds.history.clone())),
            (files.distance, distance.history().cloned()),
            (files.sizing, sizing.history.clone()),
        ])?;
        Ok(Self { seeds, distance, sizing, hashes })
    }

    /// Rejects inputs that do not match or that need too much memory.
    fn check(&self, files: Files<'_>, context: &Context) -> Result<()> {
        let (seeds, distance) = (&self.seeds, &self.distance);
        check_kind((files.distance, distance.is_materials()), (files.seeds, seeds.strata.is_some()))?;
        check_same_grid((files.distance, distance.geometry()), (files.sizing, &self.sizing.image.geometry))?;
        check_same_grid((files.distance, distance.geometry()), (files.seeds, &seeds.particles.geometry))?;
        let count = seeds.particles.positions.len();
        context.check_memory(
            BYTES_PER_PARTICLE * count as f64,
            &format!("{}: settling {count} particles", files.seeds.display()),
            "raise SIZE or MIN_SIZE (sizefield --uniform, --min-size), or set QUALITY=coarse (sizefield --quality)",
        )?;
        if count == 0 {
            return Err(Error::input(
                format!("{}: contains no particles", files.seeds.display()),
                "there is nothing to settle",
                "run seed again",
            ));
        }
        Ok(())
    }
}

/// The inputs as the engines use them.
struct Prepared {
    /// Seeds with their strata, which are empty for one object.
    seeds: OnStrata,
    surface: Surface,
    sizing: SizingField,
    hashes: [String; 3],
}

/// The surface on which the particles lie.
enum Surface {
    /// F of one object.
    Object(CubicSpline),
    /// The interfaces of many materials.
    Materials(Arc<MaterialsFile>),
}

impl From<Inputs> for Prepared {
    fn from(inputs: Inputs) -> Self {
        let Inputs { seeds, distance, sizing, hashes } = inputs;
        let surface = match distance {
            DistanceField::Object(field) => Surface::Object(CubicSpline::new(&field.image)),
            DistanceField::Materials(file) => Surface::Materials(file),
        };
        let seeds = (seeds.particles, seeds.strata.unwrap_or_default());
        Self { seeds, surface, sizing: SizingField::new(sizing.image), hashes }
    }
}

/// Contents of a checkpoint: the particles, their strata, and the records of the passes already
/// run.
type Resumed = (ParticleSet, Option<Strata>, Vec<PassRecord>);

/// Result of settling.
struct Settled {
    particles: ParticleSet,
    strata: Strata,
    summary: Summary,
    device: Option<DeviceReport>,
    /// Records of all passes, including those before a resume.
    records: Vec<PassRecord>,
}

/// Options and device of a run.
struct Run<'a> {
    args: &'a Args,
    context: &'a Context,
    gpu: Option<Gpu>,
    parameters: Parameters,
}

impl<'a> Run<'a> {
    /// Opens the device and checks the options. `many` states whether there are many materials.
    fn new(args: &'a Args, many: bool, context: &'a Context) -> Result<Self> {
        if many {
            check_levels(args.levels)?;
        }
        let gpu = open_gpu(args, context)?;
        let parameters = args.settling(gpu.is_some(), many);
        args.check(&parameters, gpu.is_some())?;
        Ok(Self { args, context, gpu, parameters })
    }

    /// Settles the particles and fills in the report.
    fn compute(&self, files: Files<'_>, inputs: Inputs) -> Result<ParticleFile> {
        let (context, parameters) = (self.context, &self.parameters);
        inputs.check(files, context)?;
        let step = context.step("spline");
        let inputs = Prepared::from(inputs);
        drop(step);
        context.set_parameter("levels", parameters.levels);
        context.set_parameter("order", json!(parameters.order));
        let resumed = self.resume(&inputs)?;
        let step = context.step("settle");
        let settled = self.settle(&inputs, resumed)?;
        context.set_parameter("backend", settled.backend());
        if let Some(device) = &settled.device {
            context.set_parameter("adapter", device.adapter.clone());
        }
        drop(step);
        if settled.particles.positions.is_empty() {
            return Err(Error::input(
                format!("{}: no particle remained on the surface", files.seeds.display()),
                "there is nothing to write",
                "use the distance field that the seeds were made from (--distfield), or run seed again",
            ));
        }
        summarise(&settled, &inputs.surface, context);
        let (kind, meta, history) = (ParticleKind::Particles, json!(settled.summary), context.history());
        let strata = matches!(inputs.surface, Surface::Materials(_)).then_some(settled.strata);
        Ok(ParticleFile { kind, particles: settled.particles, strata, meta, history, extra: Vec::new() })
    }

    /// Returns the engine name that a checkpoint stores.
    fn engine(&self) -> String {
        self.gpu.as_ref().map_or_else(cpu_engine, |gpu| format!("gpu: {}", gpu.summary().name))
    }

    /// Reads the checkpoint if --resume is given and the file exists.
    fn resume(&self, inputs: &Prepared) -> Result<Option<Resumed>> {
        match &self.args.checkpoint {
            Some(path) if self.args.resume && path.exists() => {
                resume(path, &self.parameters, &inputs.hashes, &self.engine(), self.context).map(Some)
            }
            _ => Ok(None),
        }
    }

    /// Settles the particles. Writes the log and the checkpoints.
    fn settle(&self, inputs: &Prepared, resumed: Option<Resumed>) -> Result<Settled> {
        let Self { args, context, gpu, parameters } = self;
        let records = resumed.as_ref().map_or_else(Vec::new, |r| r.2.clone());
        let mut log = args.log.as_deref().map(|path| Log::create(path, &records)).transpose()?;
        let most = parameters.max_passes + u64::from(parameters.level_count() - 1) * parameters.coarse_passes;
        let progress = context.progress(Some(most), "pass");
        let mut kept = Progress {
            parameters: parameters.clone(),
            inputs: inputs.hashes.clone(),
            records: records.clone(),
            engine: self.engine(),
        };
        let engines = Engines {
            gpu: gpu.as_ref(),
            parameters,
            // the CPU does not support the order by bins
            may_fall_back: args.backend == Backend::Auto
                && args.adapter.is_none()
                && parameters.order == Order::Classes,
            fell_back: Cell::new(false),
            context,
        };
        let mut observe = |record: &PassRecord, engine: &mut dyn Engine| {
            progress.set(record.pass);
            progress.message(progress_of(record));
            if let Some(log) = &mut log {
                log.write(record)?;
            }
            kept.records.push(*record);
            if let Some(path) = &args.checkpoint
                && record.pass.is_multiple_of(args.checkpoint_interval)
            {
                if engines.fell_back.get() {
                    kept.engine = cpu_engine();
                }
                keep(path, engine, &inputs.seeds.1.segments, &kept, context)?;
            }
            context.check_interrupt()
        };
        let resumed = resumed.map(|(set, strata, _)| ((set, strata.unwrap_or_default()), records.as_slice()));
        let ((particles, strata), summary, device) = match &inputs.surface {
            Surface::Object(surface) => {
                let fields = Fields { surface, sizing: &inputs.sizing };
                let resumed = resumed.map(|((set, _), records)| (set, records));
                let (set, summary, device) =
                    settle_levels(&inputs.seeds.0, resumed, &fields, parameters, &engines, &mut observe)?;
                ((set, Strata::default()), summary, device)
            }
            Surface::Materials(file) => {
                let materials = &file.materials;
                let surface = Interfaces::new(materials, materials.geometry().min_spacing());
                let fields = Fields { surface: &surface, sizing: &inputs.sizing };
                let make = |set, strata| engines.make_for_materials(materials, &fields, (set, strata));
                settle_interfaces_with(make, &inputs.seeds, resumed, &fields, parameters, &mut observe)?
            }
        };
        Ok(Settled { particles, strata, summary, device, records: kept.records })
    }
}

/// Returns the progress message of a pass.
fn progress_of(record: &PassRecord) -> String {
    format!(
        "{} particles ({} added, {} deleted), mean energy {:.5}",
        record.count,
        record.inserted,
        record.deleted,
        record.energy / record.count.max(1) as f64
    )
}

/// Writes the results to the closing table and to the report.
fn summarise(settled: &Settled, surface: &Surface, context: &Context) {
    let summary = &settled.summary;
    let (is_materials, name) = match surface {
        Surface::Object(_) => (false, "F = 0"),
        Surface::Materials(_) => (true, "their interface"),
    };
    if summary.escaped > 0 {
        context.warn(format!("{} particles could not be kept on {name} and were removed", summary.escaped));
    }
    context.summary("particles", settled.particles.positions.len());
    if is_materials {
        let held = settled.strata.of.iter().filter(|stratum| stratum.dimension() < 2).count();
        context.summary("  of junctions", held);
    }
    context.summary("passes", summary.passes);
    context.summary("stopped by", if summary.settled { "the stop test" } else { "the pass limit" });
    context.summary("escaped", summary.escaped);
    context.summary("energy over ideal", format!("{:.4}", summary.energy_ratio));
    context.summary("backend", settled.backend());
    if let Some(device) = &settled.device {
        tell(device, context);
    }
    context.report("settling", json!(summary));
    context.report("passes", json!(settled.records));
}

impl Settled {
    /// Returns the name of the backend that finished the run.
    fn backend(&self) -> &'static str {
        if self.device.is_some() { "gpu" } else { "cpu" }
    }
}

/// Runs the stage.
///
/// # Errors
/// If a file cannot be read or written; and the errors of [`compute()`].
pub fn run(args: &Args, context: &Context) -> Result<Outcome> {
    let Some(files) = Files::of(args) else {
        list_adapters();
        return Ok(Outcome::Passed);
    };
    // fails before the files are read if there is no GPU
    let run = Run::new(args, is_materials(files.distance), context)?;
    let step = context.step("read");
    let inputs = Inputs::read(files, context)?;
    drop(step);
    let made = run.compute(files, inputs)?;
    let _step = context.step("write");
    made.write(files.output)?;
    Ok(Outcome::Passed)
}

/// Settles particles. Messages call the inputs by the paths in `args`.
///
/// # Errors
/// If the inputs do not match, if there are no particles, if the options are not supported or need
/// a GPU that is not there, if the log or a checkpoint cannot be written, if there is not enough
/// memory, or if the run is interrupted.
pub fn compute(args: &Args, inputs: Inputs, context: &Context) -> Result<ParticleFile> {
    let files = Files::of(args).ok_or_else(|| {
        Error::input("--list-adapters: there is nothing to settle", "it only prints a list", "omit --list-adapters")
    })?;
    Run::new(args, inputs.distance.is_materials(), context)?.compute(files, inputs)
}
