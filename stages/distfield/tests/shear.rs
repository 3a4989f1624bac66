//! Checks that sheared label maps, materials and scans are measured in world coordinates.

use glam::{DMat3, DVec3};
use isoparticles_stage::field_file::{FieldKind, read_field};
use isoparticles_volume::nrrd::{Encoding, write_nrrd};
use isoparticles_volume::{Geometry, Voxels};
use serde_json::Value;
use std::path::Path;
use std::process::Command;

/// Number of voxels within a radius of 14 voxels in index space. Each voxel has a volume of 1 mm^3.
const VOXELS: f64 = 11_536.0;

/// Returns a grid of 40^3 voxels of 1 mm^3. The slices are shifted along y, as by a gantry tilt of
/// 30 degrees.
fn sheared() -> Geometry {
    let step = DVec3::new(0.0, 30f64.to_radians().tan(), 1.0);
    Geometry {
        spacing: DVec3::new(1.0, 1.0, step.length()),
        directions: DMat3::from_cols(DVec3::X, DVec3::Y, step.normalize()),
        ..Geometry::axis_aligned([40; 3], DVec3::ONE)
    }
}

/// Returns voxel values as a function of the distance from `centre` in index space.
fn by_distance(centre: DVec3, value: impl Fn(f64) -> f64) -> Vec<f64> {
    let index = |n: usize| DVec3::new((n % 40) as f64, (n / 40 % 40) as f64, (n / 1600) as f64);
    (0..64_000).map(|n| value(index(n).distance(centre))).collect()
}

fn mask(centre: DVec3) -> Voxels {
    Voxels::U8(by_distance(centre, |r| f64::from(u8::from(r <= 14.0))).into_iter().map(|v| v as u8).collect())
}

/// Runs the program and returns its report.
fn distfield(folder: &Path, voxels: &Voxels, words: &[&str]) -> Value {
    write_nrrd(&folder.join("v.nrrd"), &sheared(), voxels, Encoding::Gzip).expect("written");
    let run = Command::new(env!("CARGO_BIN_EXE_distfield")).current_dir(folder).arg("v.nrrd").args(words).output();
    let run = run.expect("the program runs");
    let told = String::from_utf8_lossy(&run.stderr);
    assert_eq!(run.status.code(), Some(0), "{told}");
    assert!(told.contains("30.0 degrees off right angles"), "{told}");
    serde_json::from_slice(&std::fs::read(folder.join("r.json")).expect("a report")).expect("JSON")
}

fn assert_near(found: &Value, due: f64, tolerance: f64) {
    let found = found.as_f64().expect("a number");
    assert!((found / due - 1.0).abs() < tolerance, "{found}, due {due}");
}

/// Returns the volume of F from the report.
fn volume_of_f(report: &Value) -> &Value {
    &report["results"]["meta"]["volume"]
}

const FIELD: [&str; 5] = ["--report", "r.json", "--force", "-o", "f.vti"];

#[test]
fn a_sheared_mask_has_its_volume_in_the_world() {
    let folder = tempfile::tempdir().expect("folder");
    let ball = mask(DVec3::splat(19.5));
    let report = distfield(folder.path(), &ball, &[&["--labels", "1"], &FIELD[..]].concat());
    assert_near(&report["results"]["meta"]["volume_before"], VOXELS, 1e-9);
    assert_near(volume_of_f(&report), VOXELS, 0.006);
    let field = read_field(&folder.path().join("f.vti"), FieldKind::Distance).expect("a field").image;
    assert!(field.geometry.spacing.abs_diff_eq(DVec3::ONE, 1e-12));
}

#[test]
fn sheared_materials_keep_their_voxels() {
    let folder = tempfile::tempdir().expect("folder");
    let shells = by_distance(DVec3::splat(19.5), |r| f64::from(u8::from(r <= 14.0)) + f64::from(u8::from(r <= 9.0)));
    let core = shells.iter().filter(|&&label| label == 2.0).count() as f64;
    let shells = Voxels::I16(shells.into_iter().map(|label| label as i16).collect());
    let report = distfield(folder.path(), &shells, &[&["--material", "all"], &FIELD[..]].concat());
    let table = report["results"]["materials"].as_array().expect("a table");
    for (name, due) in [("label_1", VOXELS - core), ("label_2", core)] {
        let row = table.iter().find(|row| row["name"] == name).expect(name);
        assert_near(&row["voxels"], due, 0.002);
    }
}

#[test]
fn a_sheared_scan_has_its_volume_in_the_world() {
    let folder = tempfile::tempdir().expect("folder");
    // the shear preserves volume, so a unit of volume in index space is 1 mm^3
    let ball = 4.0 / 3.0 * std::f64::consts::PI * 14f64.powi(3);
    let scan = by_distance(DVec3::splat(19.5), |r| 100.0 * (14.0 - r));
    let scan = Voxels::I16(scan.into_iter().map(|value| value as i16).collect());
    let report = distfield(folder.path(), &scan, &[&["--iso", "0"], &FIELD[..]].concat());
    assert_near(volume_of_f(&report), ball, 0.005);
    let report = distfield(folder.path(), &scan, &[&["--iso", "0", "--inside", "below"], &FIELD[..]].concat());
    assert_near(volume_of_f(&report), 64_000.0 - ball, 0.005);
}

#[test]
fn an_object_is_closed_where_the_sheared_volume_ends() {
    let folder = tempfile::tempdir().expect("folder");
    let cut = DVec3::new(19.5, 34.0, 19.5);
    let count = by_distance(cut, |r| f64::from(u8::from(r <= 14.0))).iter().sum::<f64>();
    let report = distfield(folder.path(), &mask(cut), &[&["--labels", "1"], &FIELD[..]].concat());
    assert_near(volume_of_f(&report), count, 0.01);
    // the object is now the background of the mask, label 0
    let report = distfield(folder.path(), &mask(cut), &[&["--labels", "0"], &FIELD[..]].concat());
    assert_near(&report["results"]["meta"]["volume_before"], 64_000.0 - count, 0.005);
    let scan = Voxels::F32(by_distance(cut, |r| 14.0 - r).into_iter().map(|value| value as f32).collect());
    let report = distfield(folder.path(), &scan, &[&["--iso", "0"], &FIELD[..]].concat());
    assert_near(volume_of_f(&report), count, 0.01);
}
