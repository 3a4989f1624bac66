//! Tests several cases at once.

use super::support::{root, run, skip};
use super::{StandIn, make};
use std::path::Path;
use std::process::Stdio;

/// If a case fails, the other cases and the index are still made, and make reports the failure.
#[test]
fn the_index_is_written_although_a_case_fails() {
    let (folder, stand_in) = (tempfile::tempdir().expect("folder"), StandIn::new());
    let command = |goal: &str| {
        let mut command = make();
        command.args([goal, "CASES=nothing ball", "VERBOSITY=-q"]).arg(stand_in.variable());
        command.arg(format!("OUT={}", folder.path().display()));
        command
    };
    run(&mut command("index")).expect_error(2, &["no cases"]);
    let ended = run(&mut command("cases"));
    assert_eq!(ended.code, Some(2), "{}", ended.stderr);
    assert!(ended.stderr.contains("pipelines/nothing.mk"), "{}", ended.stderr);
    assert!(ended.stdout.trim_end().ends_with("ball.report.html"), "the last line is a verdict's: {}", ended.stdout);
    let index = || std::fs::read_to_string(folder.path().join("index.html")).expect("index.html");
    assert!(index().contains("\"verdict\": \"passed\""), "{}", index());
    stand_in.end_with(1);
    assert_eq!(run(command("cases").args(["CASES=ball", "TETMESH_OPTIONS=-a"])).code, Some(2));
    assert!(index().contains("\"verdict\": \"failed\"") && !index().contains("\"verdict\": \"passed\""), "{}", index());
    run(&mut command("index")).expect_success("make index");
}

/// A case must give the same result in parallel with another case as when it runs alone.
#[test]
fn two_cases_at_once() {
    let folder = tempfile::tempdir().expect("folder");
    let stand_in = StandIn::new();
    let together = folder.path().join("together");
    let case = |name: &str, shape: &str, out: &Path| {
        let mut command = make();
        command.args(["surface", "ISO=100", "SIZE=2.5", "VERBOSITY=-q"]).arg(stand_in.variable());
        command
            .arg(format!("PHANTOM={shape} --size 24"))
            .arg(format!("NAME={name}"))
            .arg(format!("OUT={}", out.display()));
        command
    };
    let children: Vec<_> = [("one", "ball"), ("two", "ellipsoid")]
        .map(|(name, shape)| case(name, shape, &together).stdout(Stdio::null()).spawn().expect("make"))
        .into();
    for mut child in children {
        assert!(child.wait().unwrap().success());
    }
    let alone = folder.path().join("alone");
    run(&mut case("two", "ellipsoid", &alone)).expect_success("the case alone");
    let surface = |out: &Path| {
        let path = out.join("two/two.surface.vtp");
        isoparticles_mesh::surface::read_surface(&path).expect("surface").surface
    };
    assert_eq!(surface(&together), surface(&alone));
}

/// Runs `make -j` on two case files from pipelines/, up to the tetrahedra, if the Python
/// environment exists.
#[test]
fn make_j_over_two_cases_down_to_the_tetrahedra() {
    let test = "make_j_over_two_cases_down_to_the_tetrahedra";
    let program = root().join(".venv/bin/tetmesh-check");
    if !program.exists() {
        return skip(test, &format!("{} is not there (make env)", program.display()));
    }
    let folder = tempfile::tempdir().expect("folder");
    let mut command = make();
    command.args(["-j2", "cases", "CASES=ball two-balls", "VERBOSITY=-q"]);
    command.arg(format!("OUT={}", folder.path().display()));
    run(&mut command).expect_success("make -j2 cases");
    for name in ["ball", "two-balls"] {
        let file = |ending: &str| folder.path().join(name).join(format!("{name}.{ending}"));
        for ending in
            ["distfield.vti", "sizefield.vti", "seeds.bin", "particles.bin", "surface.vtp", "volume.vtu", "report.json"]
        {
            assert!(file(ending).exists(), "{name}.{ending} is missing");
        }
        let json = |ending: &str| -> serde_json::Value {
            serde_json::from_slice(&std::fs::read(file(ending)).unwrap()).unwrap()
        };
        assert_eq!(json("report.json")["outcome"], "passed", "{name}");
        let status = json("status.json");
        assert!(["passed", "warning"].contains(&status["verdict"].as_str().unwrap()), "{status}");
        assert_eq!(status["page"], format!("{name}.report.html"));
        assert!(std::fs::read_to_string(file("report.html")).expect("the page").contains(name));
    }
    let index = std::fs::read_to_string(folder.path().join("index.html")).expect("the index");
    assert!(index.contains("ball/ball.report.html") && index.contains("two-balls/two-balls.report.html"));
    let lines = std::fs::read_to_string(folder.path().join("index.csv")).expect("the numbers");
    assert_eq!(lines.lines().count(), 3, "{lines}");
}
