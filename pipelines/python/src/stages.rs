//! Runs one stage on values in memory.
//!
//! `words` are the arguments that a user of the program would write, so the history is the same.
//! The files among them are only names. All functions return the result, the failed checks and the
//! report as JSON. Warnings are passed to the callback `warn` when the run has ended.

use crate::data::{Data, Kept, Value};
use crate::errors::{raised, raised_by_run};
use crate::pool;
use crate::volume::{Volume, hash};
use isoparticles_mesh::surface::SurfaceFile;
use isoparticles_stage::cli::check::{Known, parse};
use isoparticles_stage::cli::{Context, Listener, Outcome, StageArgs};
use isoparticles_stage::error::{Error, Result};
use isoparticles_stage::history::file_name;
use pyo3::prelude::*;
use serde_json::json;
use std::ffi::OsString;
use std::sync::Arc;

/// A result, the failed checks, and the report as JSON.
type Finished = (Data, Vec<String>, String);

/// A value, and the failed checks.
type Made = (Value, Vec<String>);

/// Callbacks of a run.
#[derive(FromPyObject)]
pub(crate) struct Watch<'py> {
    /// Called with the stage, step, completed work, total work and message, or `None`.
    #[pyo3(item)]
    progress: Option<Bound<'py, PyAny>>,
    /// Called with the text of each warning.
    #[pyo3(item)]
    warn: Bound<'py, PyAny>,
}

/// Computes the distance field of a volume in memory or, if there is none, of the file that `words`
/// name.
#[pyfunction]
#[pyo3(signature = (words, watch, volume=None))]
pub(crate) fn distance_field(
    py: Python<'_>,
    words: Vec<String>,
    watch: Watch<'_>,
    volume: Option<Bound<'_, Volume>>,
) -> PyResult<Finished> {
    use isoparticles_distfield::run::{Args, compute};
    let volume = volume.map(|volume| volume.get().take()).transpose()?;
    run(py, "distfield", words, Known::default(), watch, move |args: &Args, context| {
        let volume = match volume {
            Some(volume) => {
                let _step = context.step("read");
                let path = &args.input.path;
                let hash = hash(&volume).map_err(|error| Error::file(path, "hash", &error, "report this bug"))?;
                context.add_value(file_name(path), hash, None);
                volume
            }
            None => args.input.load(context)?,
        };
        let made = compute(args, volume, context)?;
        Ok((Value::Distance(made.distance), made.failed))
    })
}

/// Computes the size field of a distance field, or changes `previous`.
#[pyfunction]
#[pyo3(signature = (words, watch, field, previous=None))]
pub(crate) fn size_field(
    py: Python<'_>,
    words: Vec<String>,
    watch: Watch<'_>,
    field: &Bound<'_, Data>,
    previous: Option<&Bound<'_, Data>>,
) -> PyResult<Finished> {
    use isoparticles_sizefield::run::{Args, compute, update};
    let (known, field, previous) = (known(py, field)?, keep(field), previous.map(keep));
    run(py, "sizefield", words, known, watch, move |args: &Args, context| {
        let made = match previous {
            Some(previous) => {
                previous.record(context)?;
                update(args, previous.sizing()?, context)?
            }
            None => {
                field.record(context)?;
                compute(args, field.distance()?, context)?
            }
        };
        Ok((Value::Size(made), Vec::new()))
    })
}

/// Places seeds on a surface.
#[pyfunction]
pub(crate) fn seed(
    py: Python<'_>,
    words: Vec<String>,
    watch: Watch<'_>,
    field: &Bound<'_, Data>,
    size: &Bound<'_, Data>,
) -> PyResult<Finished> {
    use isoparticles_seed::run::{Args, compute};
    let (known, field, size) = (known(py, field)?, keep(field), keep(size));
    run(py, "seed", words, known, watch, move |args: &Args, context| {
        field.record(context)?;
        size.record(context)?;
        let seeds = compute(args, field.distance()?, size.sizing()?, context)?;
        Ok((Value::Particles(seeds), Vec::new()))
    })
}

/// Moves seeds until they settle.
#[pyfunction]
pub(crate) fn settle(
    py: Python<'_>,
    words: Vec<String>,
    watch: Watch<'_>,
    seeds: &Bound<'_, Data>,
    field: &Bound<'_, Data>,
    size: &Bound<'_, Data>,
) -> PyResult<Finished> {
    use isoparticles_particles::args::Args;
    use isoparticles_particles::run::{Inputs, compute};
    let (known, seeds, field, size) = (known(py, field)?, keep(seeds), keep(field), keep(size));
    run(py, "particles", words, known, watch, move |args: &Args, context| {
        let all = [&seeds, &field, &size];
        all.iter().try_for_each(|kept| kept.record(context))?;
        let inputs = Inputs {
            seeds: seeds.particles()?.clone(),
            distance: field.distance()?.clone(),
            sizing: size.sizing()?.clone(),
            hashes: [seeds.hash()?, field.hash()?, size.hash()?],
        };
        Ok((Value::Particles(compute(args, inputs, context)?), Vec::new()))
    })
}

/// Connects particles to a surface, or updates a surface.
#[pyfunction]
#[pyo3(signature = (words, watch, points, field=None, size=None))]
pub(crate) fn reconstruct(
    py: Python<'_>,
    words: Vec<String>,
    watch: Watch<'_>,
    points: &Bound<'_, Data>,
    field: Option<&Bound<'_, Data>>,
    size: Option<&Bound<'_, Data>>,
) -> PyResult<Finished> {
    use isoparticles_reconstruct::run::{Args, Inputs, compute};
    let known = field.map_or(Ok(Known::default()), |field| known(py, field))?;
    let (points, field, size) = (keep(points), field.map(keep), size.map(keep));
    run(py, "reconstruct", words, known, watch, move |args: &Args, context| {
        let all = std::iter::once(&points).chain(&field).chain(&size);
        all.into_iter().try_for_each(|kept| kept.record(context))?;
        let distance = field.as_ref().map(|field| field.distance().cloned()).transpose()?;
        let sizing = size.map(|size| size.sizing().cloned()).transpose()?;
        let inputs = match (distance, sizing) {
            (Some(distance), Some(sizing)) if args.update => {
                let reference = field.as_ref().map(|field| field.reference(context)).transpose()?;
                Inputs::Surface { previous: points.surface_file()?.clone(), distance, sizing, reference }
            }
            (None, _) => Inputs::Particles(points.particles()?.clone()),
            (Some(distance), sizing) => Inputs::Field { particles: points.particles()?.clone(), distance, sizing },
        };
        let made = compute(args, inputs, context)?;
        let (meta, failed) = (json!(made.meta), made.meta.failed_checks);
        let file = SurfaceFile { surface: made.surface, meta, history: Some(context.history()) };
        Ok((Value::Surface { file, offending: made.offending.filter(|_| !failed.is_empty()) }, failed))
    })
}

/// Parses `words` and runs `work` on the pool.
fn run<A: clap::Parser + StageArgs + Send + 'static>(
    py: Python<'_>,
    tool: &'static str,
    words: Vec<String>,
    known: Known,
    watch: Watch<'_>,
    work: impl FnOnce(&A, &Context) -> Result<Made> + Send + 'static,
) -> PyResult<Finished> {
    let args: A = parse(tool, words.iter().map(OsString::from))
        .map_err(|error| raised(py, Error { next: format!("see `isoparticles {tool} --help`"), ..error }))?;
    let name = args.outputs().first().map_or_else(String::new, |path| file_name(path));
    let listener = Arc::new(Listener::default());
    let (threads, told) = (args.common().threads, Arc::clone(&listener));
    let (made, report, warnings) = pool::run(py, threads, &listener, watch.progress.as_ref(), move || {
        let context = Context::for_listener(tool, &args, &words, told);
        let made = args.check_options(known).and_then(|_| work(&args, &context));
        let outcome = made.as_ref().map(|(_, failed)| Outcome::from_failed_checks(failed.clone()));
        let report = context.report_of(&outcome.map_err(Clone::clone));
        (made, report, context.warnings())
    })?;
    for warning in warnings {
        watch.warn.call1((warning,))?;
    }
    let report = report.to_string();
    let (value, failed) = made.map_err(|error| raised_by_run(py, error, &report))?;
    Ok((Data(Arc::new(Kept::new(value, name))), failed, report))
}

fn keep(data: &Bound<'_, Data>) -> Arc<Kept> {
    Arc::clone(&data.get().0)
}

/// Returns the information in a distance field that options are checked against.
fn known(py: Python<'_>, field: &Bound<'_, Data>) -> PyResult<Known> {
    let distance = field.get().0.distance().map_err(|error| raised(py, error))?;
    Ok(Known { materials: Some(distance.material_names()), volume: false })
}
