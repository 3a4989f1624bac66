//! Tests the names of results, and two volumes with the same name.

use super::support::run;
use super::{Case, ball};

/// `patient.001.nrrd` and `patient.002.nrrd` must get separate results folders (issue 17).
#[test]
fn only_known_endings_are_taken_off() {
    let case = Case::new();
    for file in ["patient.001.nrrd", "patient.002.nrrd"] {
        let volume = case.folder.path().join(file);
        ball(&volume);
        let input = format!("INPUT={}", volume.display());
        run(&mut case.bare("distfield", &["ISO=100", "VERBOSITY=-q", &input])).expect_success(file);
    }
    for name in ["patient.001", "patient.002"] {
        assert!(case.out().join(name).join(format!("{name}.distfield.vti")).exists(), "{name}");
    }
}

/// `A/heart.nrrd` and `B/heart.nrrd` must not share the folder `out/heart/` (issue 17).
#[test]
fn two_volumes_of_one_name_do_not_replace_each_other() {
    let case = Case::new();
    let volume = |folder: &str, size: usize| {
        let folder = case.folder.path().join(folder);
        std::fs::create_dir(&folder).unwrap();
        let path = folder.join("heart.nrrd");
        let geometry = isoparticles_volume::Geometry::axis_aligned([size; 3], glam::DVec3::ONE);
        super::write_phantom(&path, isoparticles_tests::scene::Shape::Ball, &geometry, super::Kind::Scalar);
        path
    };
    let (first, second) = (volume("A", 24), volume("B", 26));
    let distfield = |input: &std::path::Path, more: &[&str]| {
        let input = format!("INPUT={}", input.display());
        run(case.bare("distfield", &["ISO=100", "VERBOSITY=-q", &input]).args(more))
    };
    distfield(&first, &[]).expect_success("the first");
    let words = [first.to_string_lossy(), second.to_string_lossy(), "NAME=".into(), "make clean".into()];
    let words: Vec<&str> = words.iter().map(AsRef::as_ref).collect();
    distfield(&second, &[]).expect_error(2, &words);
    assert!(case.out().join("heart/heart.distfield.vti").exists(), "the first one's result stays");
    distfield(&second, &["NAME=heart B"]).expect_success("under a name of its own");
    // A link to the volume of the case must be accepted as the same volume.
    #[cfg(unix)]
    {
        let link = case.folder.path().join("heart.nrrd");
        std::os::unix::fs::symlink(&first, &link).unwrap();
        distfield(&link, &[]).expect_success("by a link");
    }
    // A phantom must be refused as a different volume.
    let phantom = ["PHANTOM=ball --size 24", "NAME=heart", "ISO=100", "VERBOSITY=-q"];
    run(&mut case.bare("distfield", &phantom)).expect_error(2, &["a phantom", "make clean"]);
    run(&mut case.bare("clean", &["NAME=heart"])).expect_success("make clean");
    distfield(&second, &[]).expect_success("after make clean");
}

/// A case must not use one of its own results as its volume, because the result would be removed
/// before it is read.
#[test]
fn a_case_is_not_made_of_its_own_result() {
    let mut case = Case::new();
    run(&mut case.command("distfield", &["ISO=100", "VERBOSITY=-q"])).expect_success("make distfield");
    case.volume = case.file("distfield.vti");
    run(&mut case.command("distfield", &["ISO=0", "NAME=ball"])).expect_error(2, &["ball.distfield.vti", "NAME"]);
    assert!(case.has("distfield.vti"));
}
