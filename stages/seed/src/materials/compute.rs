//! Seeds several materials by [`super::seed_strata`]: checks the options and fills in the report.

use super::seed_strata;
use crate::args::{Args, From};
use crate::limits::check_prediction;
use isoparticles_field::materials::Materials;
use isoparticles_field::materials::complex::Complex;
use isoparticles_field::particle_set::{ParticleSet, Strata};
use isoparticles_field::sizing::SizingField;
use isoparticles_stage::cli::Context;
use isoparticles_stage::error::{Error, Result};
use serde_json::{Value, json};

/// Seeds the strata of several materials. Also returns the metadata of the file.
pub(crate) fn compute(
    args: &Args,
    materials: &Materials,
    sizing: SizingField,
    context: &Context,
) -> Result<(ParticleSet, Strata, Value)> {
    if args.from == From::MarchingCubes {
        return Err(Error::input(
            format!("--from marching-cubes: {} contains many materials", args.distfield.display()),
            "marching cubes needs the distance field of one object; it has no vertices at junctions",
            "leave out --from, or mesh one object with ISO or LABELS (distfield --iso, --labels)",
        ));
    }
    let step = context.step("trace the strata");
    let complex = Complex::new(materials);
    let predicted = complex.predicted_count(&sizing);
    drop(step);
    if complex.triangles.is_empty() {
        return Err(Error::input(
            format!("{}: has no interface to seed", args.distfield.display()),
            "seeds are placed on interfaces, and the whole volume is one material",
            "check MATERIALS (distfield --material)",
        ));
    }
    check_prediction(args, || predicted, context)?;
    context.check_interrupt()?;
    let step = context.step("sample");
    let scaled = args.count.map(|count| sizing.scaled((predicted / count.max(1) as f64).sqrt()));
    let spread = scaled.as_ref().unwrap_or(&sizing);
    let (particles, strata, summary) = seed_strata(materials, &complex, (spread, &sizing), predicted, context.seed());
    drop(step);
    if summary.bare_components > 0 {
        context.warn(format!(
            "{} of {} components of interfaces got no particle, because no sample could be projected onto them",
            summary.bare_components, summary.components
        ));
    }
    let [points, curves, interfaces] = summary.particles;
    context.summary("particles", particles.positions.len());
    context.summary("at junction points", points);
    context.summary("on junction curves", curves);
    context.summary("on interfaces", interfaces);
    context.summary("predicted particles", summary.predicted_count.round());
    context.summary("components of interfaces", summary.components);
    context.summary("not projected", summary.not_projected);
    let table: Vec<&str> = materials.table().iter().map(|material| material.name.as_str()).collect();
    let meta = json!({ "materials": table, "seeding": summary, "complex": complex.tally });
    Ok((particles, strata, meta))
}
