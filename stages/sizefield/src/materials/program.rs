//! The program around the sizes of many materials: options, files, report.

use crate::limits::check_count;
use crate::run::Args;
use isoparticles_field::materials::complex::Complex;
use isoparticles_field::sizing::SizingField;
use isoparticles_stage::cli::{Context, Outcome};
use isoparticles_stage::error::{Error, Result};
use isoparticles_stage::field_file::{FieldKind, write_field};
use isoparticles_stage::materials_file::read_materials;
use isoparticles_stage::meta::{self, SizeMeta};
use isoparticles_volume::Image;
use serde_json::json;

/// Makes the sizing field of many materials.
pub(crate) fn run(args: &Args, context: &Context) -> Result<Outcome> {
    let step = context.step("read");
    let file = read_materials(&args.input)?;
    let materials = &file.materials;
    context.add_input(&args.input, file.history.clone())?;
    drop(step);
    context.check_interrupt()?;
    let step = context.step("trace the strata");
    let complex = Complex::new(materials);
    drop(step);
    if complex.triangles.is_empty() {
        return Err(Error::input(
            format!("{}: has no interface, because all of it is of one material", args.input.display()),
            "there is nothing to size",
            "look at the materials that distfield was given",
        ));
    }
    let size = args.uniform.unwrap_or(materials.geometry().mean_spacing());
    let sizing = SizingField::new(Image::filled(materials.geometry().clone(), size as f32));
    let predicted = complex.predicted_count(&sizing);
    let (_, components) = complex.sheet_components();
    context.summary("components of interfaces", components);
    context.summary("predicted particles", predicted.round());
    check_count(&args.input, predicted, materials.geometry().voxel_count(), context)?;
    let meta =
        SizeMeta { version: meta::VERSION, components, predicted_count: predicted.round(), ..SizeMeta::default() };
    context.report("fields", json!(meta));
    context.check_interrupt()?;
    let _step = context.step("write");
    write_field(&args.output, FieldKind::Sizing, sizing.image(), &meta, &context.history())?;
    Ok(Outcome::Passed)
}
