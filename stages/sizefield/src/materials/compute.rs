//! Computes h for several materials: evaluates the options and fills in the report.

use super::features::{StrataFeatures, measure};
use super::lines;
use crate::args::{Args, Defaults};
use crate::limits::{check_bounds, check_count};
use crate::region::refined_nodes;
use crate::report::percentiles;
use crate::resize::resized_by;
use crate::vertices::{scaled_to_count, size_for_count};
use crate::{Parameters, SMALLEST_SHARE, Samples, graded_field};
use glam::DVec3;
use isoparticles_field::materials::complex::Complex;
use isoparticles_field::materials::{Indicators, MaterialId, Materials, Stratum};
use isoparticles_field::sizing::SizingField;
use isoparticles_stage::cli::Context;
use isoparticles_stage::cli::values::significant;
use isoparticles_stage::error::{Error, Result};
use isoparticles_stage::material_sizes::Given;
use isoparticles_stage::meta::{self, SizeMeta};
use isoparticles_volume::{Geometry, Image};
use serde_json::json;

/// Computes the sizing field of several materials, and the metadata of its file.
pub(crate) fn compute(args: &Args, materials: &Materials, context: &Context) -> Result<(SizingField, SizeMeta)> {
    let geometry = materials.geometry();
    let given = Given::new(&args.size, &materials.names())?;
    let refined = refined_nodes(&args.refine, geometry, context)?;
    context.check_interrupt()?;
    let step = context.step("trace the strata");
    let complex = Complex::new(materials);
    drop(step);
    if complex.triangles.is_empty() {
        return Err(Error::input(
            format!("{}: has no interface; the whole volume is one material", args.input.display()),
            "h is computed on the interfaces",
            "check MATERIALS (distfield --material)",
        ));
    }
    context.check_interrupt()?;
    let is_one_size = args.size.is_empty() && (args.uniform.is_some() || !args.is_graded());
    let count = |sizing: &SizingField| complex.predicted_count(sizing);
    let one_size = match (args.uniform, args.vertices) {
        (Some(size), _) if is_one_size => Some(size),
        (None, Some(vertices)) if is_one_size => {
            let size = size_for_count(|size| count(&uniform(geometry, size)), vertices as f64);
            context.info(format!("h: {} mm ({vertices} vertices)", significant(size)));
            context.set_parameter("uniform", size);
            Some(size)
        }
        _ => None,
    };
    let sizing = match one_size {
        Some(size) => uniform(geometry, size),
        None => {
            let sizing = by_shape(args, materials, &complex, &given, refined, context)?;
            match args.vertices {
                Some(vertices) => scaled_to_count(sizing, count, vertices as f64),
                None => sizing,
            }
        }
    };
    let sizing = resized_by(args, args.delta(), sizing, context)?;
    let step = context.step("predict the count");
    let predicted = count(&sizing);
    drop(step);
    check_count(&args.input, predicted, geometry.voxel_count(), context)?;
    let meta = describe(&complex, &sizing, predicted, context);
    Ok((sizing, meta))
}

fn uniform(geometry: &Geometry, size: f64) -> SizingField {
    SizingField::new(Image::filled(geometry.clone(), size as f32))
}

/// Computes h from the shape of the strata and from the sizes given with `--size`.
fn by_shape(
    args: &Args,
    materials: &Materials,
    complex: &Complex,
    given: &Given,
    refined: Vec<(usize, f64)>,
    context: &Context,
) -> Result<SizingField> {
    let parameters = resolve(args, materials, refined, context)?;
    let largest = LargestSizes::new(args, complex, materials.indicators().len(), parameters.min_size);
    let mut wanted = vec![f64::INFINITY; complex.vertices.len()];
    match args.uniform {
        Some(size) => {
            let on_interfaces = wanted.iter_mut().zip(&complex.vertices);
            on_interfaces.filter(|(_, vertex)| vertex.stratum.count() == 2).for_each(|(own, _)| *own = size);
        }
        None => {
            let step = context.step("measure features");
            // thicker layers do not limit h, because epsilon times half of their thickness exceeds
            // the maximum h
            let thickest = 2.0 * largest.largest() / parameters.epsilon;
            let features = measure(materials, materials.geometry(), complex, thickest);
            drop(step);
            by_features(complex, &features, &largest, &parameters, &mut wanted);
            lines::lower(complex, materials.voxel(), parameters.epsilon, parameters.max_deviation, &mut wanted);
            let floors = smallest_sizes(complex, &parameters);
            wanted
                .iter_mut()
                .zip(floors)
                .for_each(|(own, (least, most))| *own = parameters.scale * own.max(least).min(most));
        }
    }
    let mut most = vec![f64::INFINITY; wanted.len()];
    for (n, vertex) in complex.vertices.iter().enumerate() {
        if let Some(size) = given.of(&vertex.stratum).filter(|_| vertex.stratum.count() == 2) {
            (wanted[n], most[n]) = (size, size);
        }
    }
    let _step = context.step("size and grade");
    let points: Vec<DVec3> = complex.vertices.iter().map(|vertex| vertex.position).collect();
    let triangles: Vec<[u32; 3]> = complex.triangles.iter().map(|triangle| triangle.corners).collect();
    let samples = Samples { geometry: materials.geometry(), points: &points, triangles: &triangles };
    Ok(graded_field(&samples, &wanted, &parameters, &most))
}

/// Sets the sizes at interface vertices from curvature and thickness.
fn by_features(
    complex: &Complex,
    features: &StrataFeatures,
    largest: &LargestSizes,
    parameters: &Parameters,
    wanted: &mut [f64],
) {
    for (n, vertex) in complex.vertices.iter().enumerate().filter(|(_, vertex)| vertex.stratum.count() == 2) {
        // as for one object, the centre of a triangle of edge length h lies h^2 / (6 R) below the
        // surface
        let by_deviation = (6.0 * parameters.max_deviation / features.curvature[n].max(1e-12)).sqrt();
        let by_feature = parameters.epsilon * features.feature_size[n];
        wanted[n] = by_feature.min(by_deviation).min(largest.of(&vertex.stratum));
    }
}

/// Returns the minimum h and the maximum h at each vertex. The maximum takes precedence. It is
/// finite only on closed interfaces, where it ensures the minimum number of particles.
fn smallest_sizes(complex: &Complex, parameters: &Parameters) -> Vec<(f64, f64)> {
    let (component, count) = complex.interface_components();
    let mut areas = vec![(0.0, true); count];
    for (triangle, &c) in complex.triangles.iter().zip(&component) {
        let [a, b, d] = complex.corners(triangle);
        let (area, is_closed) = &mut areas[c as usize];
        *area += 0.5 * (b - a).cross(d - a).length();
        *is_closed &= triangle.corners.iter().all(|&v| complex.vertices[v as usize].stratum.count() == 2);
    }
    let mut sizes = vec![(parameters.min_size, f64::INFINITY); complex.vertices.len()];
    for (triangle, &c) in complex.triangles.iter().zip(&component) {
        let (area, is_closed) = areas[c as usize];
        if is_closed {
            let most = (2.0 * area / (3f64.sqrt() * parameters.min_particles)).sqrt();
            let most = most.max(SMALLEST_SHARE * parameters.min_size);
            triangle.corners.iter().for_each(|&v| sizes[v as usize].1 = most);
        }
    }
    sizes
}

/// Maximum h of each material, from `--max-size` or from the extent of the material.
struct LargestSizes(Vec<f64>);

impl LargestSizes {
    fn new(args: &Args, complex: &Complex, materials: usize, min_size: f64) -> Self {
        if let Some(size) = args.max_size {
            return Self(vec![size; materials]);
        }
        let mut boxes = vec![(DVec3::INFINITY, DVec3::NEG_INFINITY); materials];
        for vertex in &complex.vertices {
            for id in vertex.stratum.materials() {
                let Some((low, high)) = boxes.get_mut(id.index()) else { continue };
                (*low, *high) = (low.min(vertex.position), high.max(vertex.position));
            }
        }
        let share = Defaults::of(args.quality()).max_size_diagonals;
        Self(
            boxes
                .into_iter()
                .map(|(low, high)| (share * (high - low).max(DVec3::ZERO).length()).max(min_size))
                .collect(),
        )
    }

    /// Returns the maximum h of an interface: the smaller of the maxima of its two materials. The
    /// outside and the spaces beyond planes are ignored.
    fn of(&self, interface: &Stratum) -> f64 {
        let named = interface.materials().iter().filter(|&&id| id != MaterialId::OUTSIDE);
        named.filter_map(|id| self.0.get(id.index()).copied()).fold(f64::INFINITY, f64::min)
    }

    fn largest(&self) -> f64 {
        self.0.iter().copied().fold(0.0, f64::max)
    }
}

/// Derives the parameters from the options and the data, and reports the origin of each parameter.
fn resolve(args: &Args, materials: &Materials, refined: Vec<(usize, f64)>, context: &Context) -> Result<Parameters> {
    let voxel = materials.voxel();
    let quality = args.quality().name();
    let (parameters, deviation) = args.parameters_with(voxel, f64::INFINITY, refined);
    check_bounds((parameters.min_size, parameters.max_size), "")?;
    for (name, value, is_given) in [
        ("epsilon", parameters.epsilon, args.epsilon.is_some()),
        ("delta", parameters.delta, args.delta.is_some()),
        ("minimum h, mm", parameters.min_size, args.min_size.is_some()),
        ("maximum deviation, mm", deviation, args.max_deviation.is_some()),
    ] {
        let reason = if is_given {
            "given".to_owned()
        } else {
            format!("quality {quality}, voxel size {} mm", significant(voxel))
        };
        context.info(format!("{name}: {} ({reason})", significant(value)));
    }
    context.set_parameter("epsilon", parameters.epsilon);
    context.set_parameter("delta", parameters.delta);
    context.set_parameter("min_size", parameters.min_size);
    context.set_parameter("max_deviation", parameters.max_deviation);
    context.set_parameter("min_particles", parameters.min_particles);
    Ok(parameters)
}

/// Adds statistics of the field to the report and to the closing table. Returns the metadata of the
/// output file.
fn describe(complex: &Complex, sizing: &SizingField, predicted: f64, context: &Context) -> SizeMeta {
    let mut sizes: Vec<f64> = complex.vertices.iter().map(|vertex| sizing.at(vertex.position)).collect();
    let (_, components) = complex.interface_components();
    let length: f64 = complex.lengths().values().sum();
    let area: f64 = complex.areas().values().sum();
    let notes = [
        ("size_at_surface", percentiles(&mut sizes)),
        ("junctions", json!({ "points": complex.points.len(), "curves": complex.chains.len(), "length": length })),
        ("interface_area", json!(area)),
        ("complex", json!(complex.tally)),
    ];
    let meta = SizeMeta {
        version: meta::VERSION,
        components,
        predicted_count: Some(predicted.round()),
        notes: notes.into_iter().map(|(key, value)| (key.to_owned(), value)).collect(),
    };
    context.summary("components of interfaces", components);
    context.summary("junction points and curves", format!("{} and {}", complex.points.len(), complex.chains.len()));
    context.summary("predicted particles", predicted.round());
    context.summary("h at interfaces (mm)", [sizes[0], sizes[sizes.len() - 1]].map(significant).join(" to "));
    context.report("fields", json!(meta));
    meta
}
