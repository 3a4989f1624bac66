//! Tests of RESIZE, which changes the edge length in regions of the finished surface.

use super::support::stage;
use super::{Case, PARAMETERS};
use crate::arguments;
use isoparticles_mesh::surface::read_surface;
use std::path::Path;

/// Two balls at opposite ends of the phantom, whose centre is at 11.5 mm in x, y and z: one with a
/// smaller and one with a larger h.
const REGIONS: [&str; 2] = ["ball:19.5,11.5,11.5,2=0.8", "ball:3.5,11.5,11.5,2=2"];

/// Parameters of a surface with enough vertices.
const FINE: [&str; 4] = ["ISO=100", "SCALE=0", "SIZE=1.2", "VERBOSITY=-q"];

#[test]
fn regions_are_resized_in_turn_as_by_the_programs() {
    let case = Case::new();
    case.surface(&FINE).expect_success("make surface");
    let before = read_surface(&case.file("surface.vtp")).expect("surface").surface.mesh;
    let folder = tempfile::tempdir().expect("folder");
    for (n, region) in REGIONS.iter().enumerate() {
        // histories contain the names of files, but not their folders
        let at = |n: usize, ending: &str| folder.path().join(n.to_string()).join(format!("ball.{ending}"));
        if n == 0 {
            std::fs::create_dir_all(folder.path().join("0")).expect("folder");
            for ending in ["sizefield.vti", "surface.vtp"] {
                std::fs::copy(case.file(ending), at(0, ending)).expect("copy");
            }
        }
        std::fs::create_dir_all(folder.path().join((n + 1).to_string())).expect("folder");
        let field = case.file("distfield.vti");
        let sized = at(n + 1, "sizefield.vti");
        stage("sizefield", arguments![&field, "--update", at(n, "sizefield.vti"), "-o", &sized, "--resize", region])
            .expect_success("sizefield");
        let fields = arguments!["--distfield", &field, "--sizefield", &sized, "-o", at(n + 1, "surface.vtp")];
        let words = [arguments!["--update", at(n, "surface.vtp")], fields].concat();
        stage("reconstruct", words).expect_success("reconstruct");
    }
    let resize = format!("RESIZE={}", REGIONS.join(" "));
    let parameters = [&FINE[..], &[&resize]].concat();
    assert_eq!(case.reran(&parameters), ["reconstruct"]);
    let bytes = |path: &Path| std::fs::read(path).expect("file");
    assert!(bytes(&case.file("surface.vtp")) == bytes(&folder.path().join("2/ball.surface.vtp")));
    let sized = case.out().join("ball/updates/ball.sizefield.vti");
    assert!(bytes(&sized) == bytes(&folder.path().join("2/ball.sizefield.vti")));
    assert_eq!(case.reran(&parameters), [""; 0], "nothing changed");

    let after = read_surface(&case.file("surface.vtp")).expect("surface").surface.mesh;
    let is_kept = |p: &&glam::DVec3| after.vertices.contains(p);
    let kept = before.vertices.iter().filter(is_kept).count();
    assert!(kept > before.vertices.len() / 5 && kept < before.vertices.len(), "{kept} of {}", before.vertices.len());
    assert_eq!(case.reran(&FINE), ["reconstruct"]);
    assert!(!sized.exists(), "a run without RESIZE removes the size field of the updates");
}

#[test]
fn wrong_regions_are_refused_before_any_work() {
    let case = Case::new();
    case.surface(&PARAMETERS).expect_success("make surface");
    for (region, words) in [
        ("ball:1,2,3=1", ["ball:X,Y,Z,RADIUS=H", "--resize"]),
        ("mask:missing.nrrd=1", ["missing.nrrd", "check the name of the file"]),
    ] {
        let ended = case.surface(&[&PARAMETERS[..], &[&format!("RESIZE={region}")]].concat());
        ended.expect_error(2, &words);
        assert!(case.has("surface.vtp"), "nothing was removed");
    }
    let outside = case.surface(&[&PARAMETERS[..], &["RESIZE=ball:500,0,0,3=1"]].concat());
    outside.expect_error(2, &["outside the grid of F"]);
}

#[test]
fn an_update_needs_its_fields_and_a_surface_of_them() {
    let case = Case::new();
    case.surface(&PARAMETERS).expect_success("make surface");
    let [field, size, surface] = ["distfield.vti", "sizefield.vti", "surface.vtp"].map(|ending| case.file(ending));
    let out = case.folder.path().join("new.vtp");
    let update = arguments!["--update", &surface, "-o", &out];
    let ended = stage("reconstruct", update.clone());
    assert!(ended.code == Some(2) && ended.stderr.contains("--sizefield"), "{}", ended.stderr);
    let fields = arguments!["--distfield", &field, "--sizefield", &size];
    let particles = arguments!["--update", case.file("particles.bin"), "-o", &out];
    stage("reconstruct", [particles, fields.clone()].concat()).expect_error(2, &["particles.bin"]);
    stage("reconstruct", [update, fields].concat()).expect_success("an update without a change");
    let [old, new] = [&surface, &out].map(|path| read_surface(path).expect("surface").surface.mesh);
    assert_eq!(old, new);
    let words = arguments![&field, "--update", &size, "--resize", "ball:0,0,0,3=1", "--epsilon", "0.3", "-o", &out];
    let ended = stage("sizefield", words);
    assert!(ended.code == Some(2) && ended.stderr.contains("--epsilon"), "{}", ended.stderr);
}
