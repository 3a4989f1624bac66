//! Rejects invalid options before the computation: options that conflict and, if the volume exists,
//! labels, names and iso values that it does not contain.

use crate::args::Args;
use crate::choose::Object;
use crate::materials::check_options;
use crate::materials::choice::{names, resolve};
use crate::reduce::reduce;
use isoparticles_stage::cli::Context;
use isoparticles_stage::cli::check::Known;
use isoparticles_stage::error::{Error, Result};

/// Checks the options and adds the names of the materials to `known`.
///
/// # Errors
/// If `--material` is combined with an unsupported option; if the volume exists but cannot be read
/// or is of the wrong kind; or if labels, names, materials or the iso value are not in the volume.
pub(crate) fn check(args: &Args, known: Known) -> Result<Known> {
    if !args.material.is_empty() {
        check_options(args)?;
    }
    if !known.volume {
        return Ok(Known { materials: names(&args.material), ..known });
    }
    let volume = reduce(args, args.input.read()?, &Context::silent("distfield"))?;
    let about_file = |error: Error| Error { what: format!("{}: {}", args.input.name(), error.what), ..error };
    args.space.of(volume.geometry.clone(), Some(volume.file_space)).map_err(about_file)?;
    let mut materials = Vec::new();
    if !args.material.is_empty() {
        let chosen = resolve(&args.material, &volume).map_err(about_file)?;
        materials = chosen.table.into_iter().map(|material| material.name).collect();
    } else if let Some(labels) = &args.labels {
        labels.resolve(&volume).map_err(about_file)?;
    } else if let Some(iso) = args.iso {
        Object::Iso(iso, args.inside).locate(volume).map_err(about_file)?;
    }
    Ok(Known { materials: Some(materials), ..known })
}
