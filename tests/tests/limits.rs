//! Tests that stages refuse to start if the edge length is too large for the object, or if the work
//! needs more memory than the limit. The error must state the edge length or the memory, and no
//! file may be left behind.

mod support;

use glam::DVec3;
use isoparticles_stage::field_file::{Field, FieldKind, read_field};
use isoparticles_tests::scene::Shape;
use isoparticles_volume::{Geometry, Image};
use std::ffi::OsString;
use std::path::Path;
use support::chain::{Files, Wishes, surface};
use support::{Kind, listing, stage, write_phantom};

/// Makes the surface of a ball in a temporary folder.
fn ball() -> (tempfile::TempDir, Files) {
    let folder = tempfile::tempdir().expect("folder");
    let volume = folder.path().join("ball.nrrd");
    write_phantom(&volume, Shape::Ball, &Geometry::axis_aligned([24; 3], DVec3::ONE), Kind::Scalar);
    let files = surface(&volume, folder.path(), &Wishes::scalar(Some(2.0)));
    (folder, files)
}

/// Runs a stage and asserts that it fails with an error that contains `words` and leaves no file
/// behind.
#[track_caller]
fn refused(folder: &Path, name: &str, arguments: Vec<OsString>, output: &str, words: &[&str]) {
    let before = listing(folder);
    let output = folder.join(output);
    let ended = stage(name, [arguments, arguments!["-o", output]].concat());
    ended.expect_error(2, words);
    assert_eq!(listing(folder), before, "{name} left something behind");
}

#[test]
fn a_size_above_the_object_is_refused_with_a_better_one() {
    let (folder, files) = ball();
    let too_large = arguments![&files.distfield, "--uniform", "500"];
    refused(folder.path(), "sizefield", too_large, "new.vti", &["h = 500 mm is too large", "gives about 100 vertices"]);

    // seed must also refuse a size field that was edited so that h is too large.
    let field = read_field(&files.sizefield, FieldKind::Sizing).expect("a size field");
    let large = folder.path().join("large.vti");
    let image = Image::filled(field.image.geometry.clone(), 500.0).into();
    Field { image, ..field }.write(&large).expect("written");
    let seeding = arguments![&files.distfield, &large];
    refused(folder.path(), "seed", seeding, "new.bin", &["particles on the whole surface", "sizefield --uniform"]);
}

#[test]
fn every_stage_refuses_work_above_the_memory_limit() {
    let (folder, files) = ball();
    let fields = arguments!["--distfield", &files.distfield, "--sizefield", &files.sizefield];
    let too_fine = arguments![&files.distfield, "--uniform", "0.01", "--max-memory", "1G"];
    refused(
        folder.path(),
        "sizefield",
        too_fine,
        "new.vti",
        &["reconstructing", "GiB of memory", "raise SIZE (--uniform)"],
    );
    for (name, mut arguments, output) in [
        ("seed", arguments![&files.distfield, &files.sizefield], "new.bin"),
        ("particles", [arguments![&files.seeds], fields.clone()].concat(), "new.bin"),
        ("reconstruct", [arguments![&files.particles], fields].concat(), "new.vtp"),
    ] {
        arguments.extend(arguments!["--max-memory", "10K"]);
        refused(folder.path(), name, arguments, output, &["of memory", "(--max-memory) allows 0 MiB", "particles"]);
    }
}
