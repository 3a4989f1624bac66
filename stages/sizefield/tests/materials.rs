//! Tests the program with several materials: a constant h, sizes by name, and h from the shape of
//! layers and balls.

use glam::DVec3;
use isoparticles_field::materials::{
    Analytic, Indicator, Indicators, Material, MaterialId, Materials, ball, half_space, maximum, negative,
};
use isoparticles_field::sizing::SizingField;
use isoparticles_stage::cli::Context;
use isoparticles_stage::field_file::{Field, FieldKind, read_field};
use isoparticles_stage::materials_file::{MaterialsFile, Shown};
use isoparticles_volume::{Geometry, Image};
use serde_json::{Value, json};
use std::path::Path;
use std::process::{Command, Output};

const CENTRE: DVec3 = DVec3::new(20.1, 19.8, 20.3);

/// Returns the indicators of a ball of radius 8 mm, a shell around it with an outer radius of 14
/// mm, and the outside.
fn nested() -> Analytic {
    let shell = maximum(ball(CENTRE, 14.0), negative(ball(CENTRE, 8.0)));
    Analytic::new(vec![negative(ball(CENTRE, 14.0)), shell, ball(CENTRE, 8.0)], 1.0)
}

/// Returns the indicators of the outside and of three parts of a ball of radius 14 mm. The parts, a
/// half and two quarters, meet along a diameter.
fn wedges() -> Analytic {
    let all = || ball(CENTRE, 14.0);
    let part = |x: DVec3, y: DVec3| maximum(all(), maximum(half_space(CENTRE, x), half_space(CENTRE, y)));
    let half = maximum(all(), half_space(CENTRE, DVec3::X));
    Analytic::new(vec![negative(all()), half, part(-DVec3::X, DVec3::Y), part(-DVec3::X, -DVec3::Y)], 1.0)
}

fn write(path: &Path, analytic: &Analytic) {
    let geometry = Geometry::axis_aligned([41; 3], DVec3::ONE);
    let of = |id: MaterialId| {
        let image = Image::sampled(geometry.clone(), |p| analytic.jet(id, p).value as f32);
        let (indicator, negative) = Indicator::new(&image, [0; 3], geometry.size, false);
        let name = ["outside", "shell", "core", "other"][id.index()].to_owned();
        (Material { name, labels: Vec::new() }, indicator, negative)
    };
    let materials = Materials::new(geometry.clone(), analytic.ids().map(of).collect()).expect("parts of one grid");
    let (material, interface_distance) = (vec![0; geometry.voxel_count()], vec![0.0; geometry.voxel_count()]);
    let (shown, history) = (Shown { material, interface_distance }, Some(Context::silent("test").history()));
    MaterialsFile { materials, shown, meta: json!({}), history }.write(path).expect("written");
}

fn sizefield(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_sizefield")).args(arguments).output().expect("the program runs")
}

/// Returns the sizing field and its metadata for the given options.
fn sized(folder: &Path, analytic: &Analytic, options: &[&str]) -> (SizingField, Value) {
    let at = |name: &str| folder.join(name).to_str().expect("text").to_owned();
    let [input, output] = ["case.materials.vti", "case.sizefield.vti"].map(at);
    write(Path::new(&input), analytic);
    let run = sizefield(&[&[input.as_str(), "-o", &output, "--force", "--quiet"], options].concat());
    assert!(run.status.success(), "{}", String::from_utf8_lossy(&run.stderr));
    let field = read_field(Path::new(&output), FieldKind::Sizing).expect("read");
    (SizingField::new(field.image), field.meta)
}

/// Returns the minimum and maximum h on a sphere around [`CENTRE`].
fn on_ball(h: &SizingField, radius: f64) -> (f64, f64) {
    let ways = (0..500).map(|n| {
        let (z, angle) = (1.0 - (f64::from(n) + 0.5) / 250.0, 2.399_963 * f64::from(n));
        DVec3::new(angle.cos() * (1.0 - z * z).sqrt(), angle.sin() * (1.0 - z * z).sqrt(), z)
    });
    let sizes = ways.map(|way| h.at(CENTRE + radius * way));
    sizes.fold((f64::INFINITY, 0.0), |(low, high), size| (low.min(size), high.max(size)))
}

#[test]
fn one_size_is_everywhere_and_the_count_is_that_of_the_areas() {
    let folder = tempfile::tempdir().expect("folder");
    let (h, meta) = sized(folder.path(), &nested(), &["--uniform", "1.5"]);
    assert!(h.image().data.iter().all(|&size| size == 1.5));
    let area = 4.0 * std::f64::consts::PI * (14.0 * 14.0 + 64.0);
    let expected = 2.0 / 3f64.sqrt() * area / 2.25;
    assert!((meta["predicted_count"].as_f64().expect("a count") / expected - 1.0).abs() < 0.02, "{meta}");
    assert_eq!(meta["components"], 2);
    // surfaces of several materials are not thinned, so the count is that of the particles
    let (_, meta) = sized(folder.path(), &nested(), &["--vertices", "1000"]);
    let predicted = meta["predicted_count"].as_f64().expect("a count");
    assert!((predicted / 1000.0 - 1.0).abs() < 0.002, "{predicted}");
}

#[test]
fn materials_and_interfaces_are_sized_by_name() {
    let folder = tempfile::tempdir().expect("folder");
    let (h, _) = sized(folder.path(), &nested(), &["--uniform", "3", "--size", "core=1"]);
    let ((low, high), (outer_low, outer_high)) = (on_ball(&h, 8.0), on_ball(&h, 14.0));
    assert!(low > 0.99 && high < 1.3, "{low} {high}");
    assert!(outer_low > 2.5 && outer_high < 3.3, "{outer_low} {outer_high}");
    // the pair takes precedence over the material
    let (h, _) = sized(folder.path(), &nested(), &["--uniform", "3", "--size", "shell=2", "--size", "core/shell=1.5"]);
    assert!(on_ball(&h, 8.0).1 < 1.9 && on_ball(&h, 14.0).0 > 1.95);
    let run = sizefield(&[
        folder.path().join("case.materials.vti").to_str().expect("text"),
        "-o",
        folder.path().join("other.vti").to_str().expect("text"),
        "--size",
        "liver=1",
    ]);
    let told = String::from_utf8_lossy(&run.stderr);
    assert_eq!(run.status.code(), Some(2));
    assert!(told.contains("liver") && told.contains("outside, shell, core"), "{told}");
}

#[test]
fn thin_layers_and_small_balls_ask_for_smaller_triangles() {
    let folder = tempfile::tempdir().expect("folder");
    let options = ["--max-deviation", "0", "--min-size", "0.2", "--epsilon", "0.5", "--delta", "0.4"];
    let (h, _) = sized(folder.path(), &nested(), &options);
    // the shell is 6 mm thick, so a ball of radius 3 mm fits into it, and h is about epsilon = 0.5
    // times this radius
    for radius in [8.0, 14.0] {
        let (low, high) = on_ball(&h, radius);
        assert!(low > 1.2 && high < 1.9, "{radius}: {low} {high}");
    }
}

#[test]
fn h_does_not_vanish_where_materials_meet() {
    let folder = tempfile::tempdir().expect("folder");
    let options = ["--max-deviation", "0", "--min-size", "0.01", "--epsilon", "0.5"];
    let (h, _) = sized(folder.path(), &wedges(), &options);
    for n in -8..=8 {
        let size = h.at(CENTRE + DVec3::Z * f64::from(n));
        assert!(size > 0.75, "{n}: {size}");
    }
}

#[test]
fn a_name_for_one_object_is_refused() {
    let folder = tempfile::tempdir().expect("folder");
    let [input, output] = ["one.vti", "other.vti"].map(|name| folder.path().join(name));
    let image =
        Image::sampled(Geometry::axis_aligned([17; 3], DVec3::ONE), |p| (p.distance(DVec3::splat(8.0)) - 5.0) as f32);
    let field = Field { image: image.into(), meta: json!({}), history: None, kind: FieldKind::Distance };
    field.write(&input).expect("written");
    let [input, output] = [&input, &output].map(|path| path.to_str().expect("text"));
    let run = sizefield(&[input, "-o", output, "--size", "lung=1"]);
    assert_eq!(run.status.code(), Some(2));
    assert!(String::from_utf8_lossy(&run.stderr).contains("--size lung=1 for one object"));
}
