//! Writes the surface, the offending simplices and the closing table.

use crate::args::Args;
use crate::check::{CheckReport, Fault};
use isoparticles_mesh::surface::{Simplices, Surface, write_simplices, write_surface};
use isoparticles_stage::cli::values::significant;
use isoparticles_stage::cli::{Context, Outcome};
use isoparticles_stage::error::{Error, Result};
use isoparticles_stage::meta::SurfaceMeta;
use serde_json::json;
use std::path::{Path, PathBuf};

/// Returns the path of the file with the offending simplices of the failed checks.
fn offenders(args: &Args) -> PathBuf {
    args.output.with_extension("offending.vtp")
}

/// Returns an error if the file of offending simplices, which is replaced or removed, is an input.
pub(crate) fn check_offenders(args: &Args) -> Result<()> {
    let path = offenders(args);
    let Ok(place) = path.canonicalize() else { return Ok(()) };
    let mut inputs = [Some(&args.particles), args.distfield.as_ref(), args.sizefield.as_ref()].into_iter().flatten();
    match inputs.find(|input| input.canonicalize().is_ok_and(|input| input == place)) {
        None => Ok(()),
        Some(input) => Err(Error::input(
            format!(
                "{}: this input has the name of the file for the offending simplices of {}",
                input.display(),
                args.output.display()
            ),
            "that file is replaced if a check fails, and removed if all checks pass",
            "rename the output or the input",
        )),
    }
}

/// Writes the surface and returns the outcome. If a check failed, also writes the offending
/// simplices; otherwise removes their file.
pub(crate) fn write(
    args: &Args,
    context: &Context,
    surface: &Surface,
    meta: &SurfaceMeta,
    offending: Option<Simplices>,
    failed: Vec<String>,
) -> Result<Outcome> {
    let step = context.step("write");
    write_surface(&args.output, surface, &json!(meta), &context.history())?;
    let offenders = offenders(args);
    match offending {
        Some(simplices) if !failed.is_empty() => {
            write_simplices(&offenders, &simplices, &context.history())?;
            context.info(format!("the offending simplices are in {}", offenders.display()));
        }
        // a file of an earlier run would be misleading
        _ => remove_stale(&offenders, context),
    }
    drop(step);
    Ok(Outcome::from_failed_checks(failed))
}

fn remove_stale(path: &Path, context: &Context) {
    if path.exists()
        && let Err(error) = std::fs::remove_file(path)
    {
        context.warn(format!("{}: cannot remove this file of an earlier run: {error}", path.display()));
    }
}

/// Adds the rows of the closing table that one object and many materials share. `expected` is
/// appended to the number of components of one object. `particles` are the numbers of used and
/// unused particles.
pub(crate) fn describe_mesh(checked: &CheckReport, expected: &str, particles: [usize; 2], context: &Context) {
    let (quality, junctions) = (&checked.quality, &checked.junctions);
    context.summary("vertices, triangles", format!("{}, {}", checked.vertices, checked.triangles));
    if let [object] = &checked.regions[..] {
        context.summary("components", format!("{}{expected}", object.components.len()));
        context.summary("Euler characteristic", object.euler);
        let (area, volume) = (significant(object.area), significant(object.volume));
        context.summary("area, mm^2; volume, mm^3", format!("{area}; {volume}"));
    } else {
        let (materials, pairs) = (checked.regions.len(), checked.pairs.len());
        context.summary("materials, pairs that touch", format!("{materials}, {pairs}"));
        let (edges, points) = (junctions.junction_edges, junctions.junction_points);
        let missing = checked.count(Fault::MissingSegments);
        context.summary(
            "junction edges, points",
            format!("{edges}, {points}; {missing} of {} segments missing", junctions.segments),
        );
    }
    context.summary("particles used, not used", format!("{}, {}", particles[0], particles[1]));
    context.summary(
        "radius ratio",
        format!("mean {:.4}, minimum {:.4}", quality.radius_ratio_mean, quality.radius_ratio_min),
    );
    context.summary("angles, degrees", format!("{:.1} to {:.1}", quality.angle_min, quality.angle_max));
    if let (Some(v), Some(c)) = (checked.vertex_distance, checked.centroid_distance) {
        let [vertices, mean, maximum] = [v.max, c.mean, c.max].map(significant);
        context.summary(
            "distance from F = 0, voxels",
            format!("vertices at most {vertices}; centroids mean {mean}, maximum {maximum}"),
        );
    }
    if let Some(nodes) = checked.counts.get(&Fault::NodesOnWrongSide) {
        context.summary("voxel centres on the wrong side", nodes);
    }
}
