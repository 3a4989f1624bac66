//! Tests failures. The status, the page and the index must describe the failure, and no file of an
//! earlier run may be mistaken for a result.

use super::support::{listing, run};
use super::{Case, PARAMETERS, TAKES_ALL, executable};

#[test]
fn a_failing_first_stage_has_a_page_and_stands_in_the_index() {
    let case = Case::new();
    let ended = case.surface(&["ISO=100000"]);
    assert_eq!(ended.code, Some(2), "{}", ended.stderr);
    assert!(ended.stderr.contains("100000") && ended.stderr.contains("what to do"), "{}", ended.stderr);
    assert!(!case.has("distfield.vti"));
    let status = case.status();
    assert_eq!((&status["verdict"], &status["stages"][0]["state"]), (&"error".into(), &"error".into()), "{status}");
    assert!(status["stages"][0]["error"]["what"].as_str().unwrap().contains("100000"), "{status}");
    assert_eq!(status["stages"][4]["state"], "not reached");
    assert!(case.text("report.html").contains("\"verdict\": \"error\""), "the page is made from the status");
    run(&mut case.bare("index", &[])).expect_success("make index");
    let index = std::fs::read_to_string(case.out().join("index.html")).expect("index.html");
    assert!(index.contains("\"verdict\": \"error\""), "{index}");
}

/// After a failed run, no result of an earlier run with the same name may be left (issue 17).
#[test]
fn a_failed_run_leaves_no_result_of_an_earlier_one() {
    let case = Case::new();
    case.mesh(0, &[]);
    let pictures = case.out().join("ball/pictures/cut.png");
    std::fs::write(case.file("report.of.mine.txt"), "mine").unwrap();
    assert!(case.has("volume.vtu") && case.has("volume.inp") && case.has("report.json") && pictures.exists());
    let ended = run(&mut case.command("mesh", &["ISO=100", "SIZE=500", "VERBOSITY=-q"]));
    assert_eq!(ended.code, Some(2), "{}", ended.stderr);
    let left = listing(&case.out().join("ball"));
    for ending in ["surface.vtp", "volume.vtu", "volume.inp", "report.json"] {
        assert!(!case.has(ending), "{ending} is left: {left:?}");
    }
    assert!(!pictures.exists());
    assert!(case.has("report.of.mine.txt"), "a file of the user's: {left:?}");
    let status = case.status();
    assert_eq!(status["verdict"], "error", "{status}");
    assert_eq!(case.states()["tetmesh-check"], "stale");
    assert!(case.text("report.html").contains("\"verdict\": \"error\""));
    // The status lists every file that exists.
    let listed = status.to_string();
    for name in left
        .iter()
        .filter(|name| !["ball.status.json", ".lock", "reports", "ball.report.of.mine.txt"].contains(&name.as_str()))
    {
        assert!(listed.contains(&format!("\"{name}\"")), "{name} is not in the status: {listed}");
    }
    // The next run with valid parameters must succeed and make all results again.
    case.mesh(0, &[]);
    assert_eq!(case.status()["verdict"], "passed");
    assert!(case.has("surface.vtp") && case.has("volume.vtu") && pictures.exists());
}

/// A run that makes a different surface under the same name must remove the earlier tetrahedra and
/// replace the page (issue 17).
#[test]
fn a_surface_of_something_else_takes_away_the_tetrahedra() {
    let case = Case::new();
    case.mesh(0, &[]);
    // A run that makes the same surface keeps the tetrahedra and the page.
    case.surface(&PARAMETERS).expect_success("make surface");
    assert!(case.has("volume.vtu") && case.has("report.html"));
    assert_eq!(case.status()["goal"], "surface");
    case.surface(&["ISO=120", "SIZE=2.5", "VERBOSITY=-q"]).expect_success("make surface");
    assert!(!case.has("volume.vtu") && !case.has("report.json"), "{:?}", listing(&case.out().join("ball")));
    assert_eq!(case.states()["tetmesh-check"], "stale");
    assert!(case.text("report.html").contains("\"ISO\": \"120\""), "the page is that of the new surface");
}

/// If the output of a stage fails a check, make fails and the output is renamed.
#[test]
#[cfg(unix)]
fn the_output_of_a_failed_check_is_kept_aside() {
    let case = Case::new();
    let programs = case.linked_programs();
    // This stand-in for sizefield writes its output and exits with the code of a failed check.
    executable(&programs.join("sizefield"), &format!("{TAKES_ALL}echo made > \"$3\"\nexit 1\n"));
    let bin = format!("BIN={}", programs.display());
    let ended = case.surface(&["ISO=100", "VERBOSITY=-q", &bin]);
    assert_eq!(ended.code, Some(2), "{}", ended.stderr);
    assert!(ended.stderr.contains("sizefield.failed.vti"), "{}", ended.stderr);
    assert!(!case.has("sizefield.vti") && !case.has("seeds.bin"));
    assert_eq!(case.text("sizefield.failed.vti"), "made\n");
    assert_eq!(case.status()["verdict"], "failed");
    assert_eq!(case.status()["stages"][1]["kept"][0], "ball.sizefield.failed.vti");
    // With the real program, the case succeeds and the failed output is removed.
    case.surface(&PARAMETERS).expect_success("make surface");
    assert!(!case.has("sizefield.failed.vti"));
}

/// A three-part error must be reported if a program exits without a report, is killed by a signal,
/// or does not exist.
#[test]
#[cfg(unix)]
fn a_program_that_crashes_is_told_in_three_parts() {
    let case = Case::new();
    let programs = case.linked_programs();
    let bin = format!("BIN={}", programs.display());
    let seed = programs.join("seed");
    for (script, words) in [("kill -9 $$\n", "signal 9"), ("exit 2\n", "exit code 2"), ("exit 0\n", "is missing")] {
        executable(&seed, &format!("{TAKES_ALL}{script}"));
        let ended = case.surface(&["ISO=100", "SIZE=2.5", "VERBOSITY=-q", &bin]);
        ended.expect_error(2, &["seed", words]);
        assert_eq!(case.states()["seed"], "error");
    }
    std::fs::remove_file(&seed).unwrap();
    case.surface(&["ISO=100", "SIZE=2.5", "VERBOSITY=-q", &bin]).expect_error(2, &["seed", "cannot be started"]);
    assert_eq!(case.states()["seed"], "error", "nothing was begun");
}

/// However the last stage ends, no file of an earlier run may be left that looks like its result.
#[test]
fn no_stale_mesh_or_page_is_left() {
    let case = Case::new();
    case.mesh(0, &["TETMESH_OPTIONS=-a"]);
    assert_eq!(case.text("volume.vtu"), "0\n");
    assert!(case.text("report.html").contains("\"verdict\": \"passed\""), "{}", case.text("report.html"));
    assert!(case.mesh(1, &["TETMESH_OPTIONS=-b"]).stderr.contains("ball.volume.failed.vtu"));
    assert_eq!(case.text("volume.failed.vtu"), "1\n");
    assert!(case.text("report.html").contains("too flat"), "{}", case.text("report.html"));
    assert!(!case.has("volume.vtu") && !case.has("report.json") && !case.has("volume.inp"));
    case.mesh(0, &["TETMESH_OPTIONS=-c"]);
    assert!(!case.has("volume.failed.vtu") && !case.has("report.failed.json"));
    case.mesh(2, &["TETMESH_OPTIONS=-d"]);
    assert!(!case.has("volume.vtu") && !case.has("volume.failed.vtu"));
    assert!(case.text("report.html").contains("\"verdict\": \"error\""), "the page says that there is no mesh");
    // A failed run is repeated even if nothing has changed.
    case.mesh(2, &["TETMESH_OPTIONS=-d"]);
    case.mesh(0, &["TETMESH_OPTIONS=-d"]);
    assert_eq!(case.status()["verdict"], "passed");
}

/// The output must end with the verdict, the warnings and the path of the report page. `make
/// verdict` must print the same lines again.
#[test]
fn the_last_lines_are_the_verdict() {
    let case = Case::new();
    let ended = case.mesh(0, &[]);
    let page = case.file("report.html").display().to_string();
    let last: Vec<&str> = ended.stdout.lines().rev().take(6).collect();
    assert!(last[0].contains("page") && last[0].contains(&page), "{}", ended.stdout);
    assert!(last.iter().any(|line| line.starts_with("ball: passed")), "{}", ended.stdout);
    let asked = run(&mut case.bare("verdict", &["NAME=ball"])).expect_success("make verdict");
    assert!(ended.stdout.ends_with(&asked.stdout), "{}\n{}", ended.stdout, asked.stdout);
    let ended = case.mesh(1, &["TETMESH_OPTIONS=-b"]);
    let verdict = ended.stderr.split("ball: NOT FIT").nth(1).expect("the verdict");
    assert!(
        verdict.contains("too flat") && verdict.contains("volume.failed.vtu") && verdict.contains(&page),
        "{verdict}"
    );
}

/// A killed run leaves the state "running" in the status. The next command must report this run as
/// interrupted.
#[test]
fn a_killed_run_is_told() {
    let case = Case::new();
    case.mesh(0, &[]);
    let mut status = case.status();
    status["verdict"] = "running".into();
    status["stages"][5]["state"] = "running".into();
    std::fs::write(case.file("status.json"), status.to_string()).unwrap();
    let asked = run(&mut case.bare("verdict", &["NAME=ball"])).expect_success("make verdict");
    assert!(
        asked.stdout.contains("INTERRUPTED") && asked.stdout.contains("killed in tetmesh-check"),
        "{}",
        asked.stdout
    );
    assert_eq!(case.states()["tetmesh-check"], "interrupted");
    case.mesh(0, &[]);
    assert_eq!(case.status()["verdict"], "passed");
}

/// A process of a killed run may write an output after the next run has removed old files. The next
/// run must still make this output and list it as a result in the status.
#[test]
#[cfg(unix)]
fn late_output_of_a_killed_run_is_made_again() {
    let case = Case::new();
    let programs = case.linked_programs();
    let orphan = "echo orphan > \"${3%sizefield.vti}seeds.bin\"";
    executable(&programs.join("sizefield"), &format!("{TAKES_ALL}echo made > \"$3\"\n{orphan}\n"));
    executable(&programs.join("seed"), &format!("{TAKES_ALL}echo made > \"$4\"\n"));
    let bin = format!("BIN={}", programs.display());
    run(&mut case.command("seed", &["ISO=100", "SIZE=2.5", "VERBOSITY=-q", &bin])).expect_success("make seed");
    assert_eq!(case.text("seeds.bin"), "made\n");
    assert_eq!(case.status()["stages"][2]["outputs"][0], "ball.seeds.bin");
    // A failed run leaves no such file.
    executable(&programs.join("seed"), &format!("{TAKES_ALL}exit 2\n"));
    run(&mut case.command("seed", &["ISO=100", "SIZE=2", "VERBOSITY=-q", &bin])).expect_error(2, &["seed"]);
    assert!(!case.has("seeds.bin"));
}

/// A second, simultaneous run of a case is refused and does not disturb the first run.
#[test]
fn two_runs_on_one_name_do_not_meet() {
    let case = Case::new();
    case.surface(&PARAMETERS).expect_success("make surface");
    let lock = std::fs::File::options().write(true).open(case.out().join("ball/.lock")).expect("the lock");
    lock.lock().expect("taken");
    let before = case.text("status.json");
    case.surface(&["ISO=120", "VERBOSITY=-q"]).expect_error(2, &["another run is working on this case", "NAME"]);
    assert_eq!(before, case.text("status.json"));
    drop(lock);
    case.surface(&PARAMETERS).expect_success("make surface");
}
