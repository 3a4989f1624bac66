//! Tests the arguments of make: missing, contradictory, misspelled and out-of-range values,
//! precedence, spaces in names, and goals.

use super::support::{binaries, run};
use super::{Case, PARAMETERS, STAGES, ball, make};
use std::process::Command;

#[test]
fn missing_and_contradicting_parameters_are_explained() {
    let case = Case::new();
    let attempts: [(&[&str], &str); 7] = [
        (&[], "ISO"),
        (&["ISO=1", "LABELS=1"], "both set"),
        (&["ISO=1", "SIZE=2", "MAX_SIZE=3"], "SIZE"),
        (&["ISO=1", "SIZE=2", "VERTICES=300"], "VERTICES"),
        (&["LABELS=1", "INSIDE=below"], "INSIDE"),
        (&["ISO=1", "INPUT=/nowhere/v.nrrd"], "/nowhere/v.nrrd"),
        (&["CASE=nothing"], "pipelines/nothing.mk"),
    ];
    for (variables, words) in attempts {
        let ended = case.surface(variables);
        assert_eq!(ended.code, Some(2), "{variables:?}: {}", ended.stderr);
        for part in [words, "why it matters", "what to do"] {
            assert!(ended.stderr.contains(part), "{variables:?} should say '{part}': {}", ended.stderr);
        }
        assert!(!case.out().exists(), "{variables:?} left something behind");
    }
    let ended = run(make().arg("mesh"));
    assert_eq!(ended.code, Some(2));
    assert!(ended.stderr.contains("INPUT is not set"), "{}", ended.stderr);
    let help = run(&mut make()).expect_success("make without a goal").stdout;
    for goal in ["make demo", "make mesh INPUT=", "make clean", "make info", "make verdict", "VERTICES="] {
        assert!(help.contains(goal), "{goal}: {help}");
    }
}

#[test]
fn help_lists_every_variable_of_a_case() {
    let help = run(&mut make()).expect_success("make without a goal").stdout;
    let keys = run(Command::new(binaries().join("isoparticles-case")).arg("keys")).expect_success("keys").stdout;
    for key in keys.lines().filter_map(|line| line.split('\t').next()).chain(["DATA"]) {
        assert!(help.contains(&format!("{key}=")), "{key}: {help}");
    }
}

/// A misspelled key such as `SZIE=8` must not be ignored, and the message for `SIZE=-1` must name
/// the variable (issue 17).
#[test]
fn slips_and_values_out_of_range_are_refused_before_any_work() {
    let case = Case::new();
    let attempts = [
        ("SZIE=8", "did you mean SIZE?"),
        ("VERBOSTY=-q", "did you mean VERBOSITY?"),
        ("BENCH_OPTION=1", "did you mean BENCH_OPTIONS?"),
        ("SIZE=-1", "SIZE=-1"),
        ("SIZE=abc", "SIZE=abc"),
        ("ISO=abc", "ISO=abc"),
        ("THREADS=two", "THREADS=two"),
        ("BORDER=opne", "did you mean open?"),
        ("VERTICES=2.5", "whole number"),
        ("MIN_SIZE=0", "above 0"),
        ("NAME=../elsewhere", "NAME=../elsewhere"),
        ("DISTFIELD_OPTIONS=--keep 'largest", "balanced quotes"),
    ];
    for (variable, words) in attempts {
        case.surface(&["ISO=100", variable]).expect_error(2, &[words]);
        assert!(!case.out().exists(), "{variable} left something behind");
    }
    let ended = run(make().args(["format", "SZIE=8"]));
    assert_eq!(ended.code, Some(2));
    assert!(ended.stderr.contains("SZIE: no such variable"), "{}", ended.stderr);
}

/// SIZE on the command line overrides MIN_SIZE in the case file (issue 17).
#[test]
fn a_case_file_gives_way_to_the_user() {
    let case = Case::new();
    let small = ["CASE=demo", "NAME=ball", "PHANTOM=ball --size 24", "ISO=100", "SIZE=3", "VERBOSITY=-q"];
    run(&mut case.bare("surface", &small)).expect_success("make CASE=demo SIZE=3");
    let parameters = &case.status()["parameters"];
    assert_eq!((&parameters["SIZE"], &parameters["MIN_SIZE"]), (&"3".into(), &serde_json::Value::Null), "{parameters}");
    assert_eq!(parameters["INSIDE"], "above", "what does not contradict stays: {parameters}");
}

#[test]
fn blanks_and_quotes_in_names_are_taken_as_they_are() {
    let case = Case::new();
    let folder = case.folder.path().join("Mary's scans");
    std::fs::create_dir(&folder).unwrap();
    ball(&folder.join("left lung (2).nrrd"));
    let volume = folder.join("left lung (2).nrrd");
    let mut command = case.bare("surface", &["ISO=100", "MIN_SIZE=2", "VERBOSITY=-q"]);
    command.arg(format!("INPUT={}", volume.display())).arg(format!("OUT={}", folder.join("my results").display()));
    // Options are split into words as in a shell, so names with spaces need quotes.
    command.arg(format!("SIZEFIELD_OPTIONS=--refine \"mask:{}=1.5\"", volume.display()));
    run(&mut command).expect_success("make surface");
    assert!(folder.join("my results/left lung (2)/left lung (2).surface.vtp").exists());
    // distfield must receive the label names as one argument.
    let ended = case.surface(&["LABELS=left lung,right lung", "VERBOSITY=-q"]);
    assert_eq!(ended.code, Some(2));
    assert!(ended.stdout.contains("--labels 'left lung,right lung'"), "{}", ended.stdout);
}

#[test]
fn single_stages_are_goals() {
    let case = Case::new();
    for (position, (stage, _)) in STAGES.iter().enumerate() {
        run(&mut case.command(stage, &PARAMETERS)).expect_success(stage);
        for (later, (_, ending)) in STAGES.iter().enumerate() {
            assert_eq!(case.has(ending), later <= position, "{ending} after make {stage}");
        }
    }
    assert_eq!(case.status()["goal"], "surface");
    std::fs::remove_file(case.file("report.html")).unwrap();
    run(&mut case.bare("page", &["NAME=ball"])).expect_success("make page");
    assert!(case.has("report.html"));
    run(&mut case.bare("page", &["NAME=other"])).expect_error(2, &["other.status.json"]);
    run(&mut case.bare("verdict", &["NAME=other"])).expect_error(2, &["`make mesh NAME=other ...` first"]);
}

#[test]
fn info_says_what_a_volume_is_and_makes_nothing() {
    let case = Case::new();
    let told = run(&mut case.command("info", &[])).expect_success("make info").stdout;
    assert!(told.contains("24 x 24 x 24"), "{told}");
    assert!(!case.out().exists());
    run(&mut case.bare("info", &["CASE=demo"])).expect_error(2, &["phantom", "make distfield"]);
}

#[test]
fn clean_removes_one_case_and_nothing_else() {
    let case = Case::new();
    let keep = case.out().join("mine");
    std::fs::create_dir_all(&keep).unwrap();
    std::fs::write(keep.join("notes.txt"), "mine").unwrap();
    run(&mut case.command("distfield", &PARAMETERS)).expect_success("make distfield");
    run(&mut case.bare("clean", &[])).expect_error(2, &["CASE", "NAME"]);
    run(&mut case.bare("clean", &["NAME=mine"])).expect_error(2, &["contains no results"]);
    run(&mut case.bare("clean", &["NAME=.."])).expect_error(2, &["NAME=.."]);
    run(&mut case.bare("clean", &["NAME=ball"])).expect_success("make clean");
    assert!(!case.out().join("ball").exists() && keep.join("notes.txt").exists() && case.volume.exists());
    run(&mut case.bare("clean", &["NAME=ball"])).expect_success("make clean of nothing");
}
