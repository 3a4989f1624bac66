//! Runs a list of cases with Snakemake on this machine. Failing rows are reported and do not stop
//! other rows, and the next run updates the results that are out of date.

use super::batch::{expected, verdicts};
use super::support::{root, run, skip};
use super::{Case, STAGES, make};
use std::process::Command;
use std::time::SystemTime;

/// Writes a list of cases and returns the command `make cluster` that makes their surfaces. Without
/// Snakemake, records a skip and returns `None`.
fn cluster(case: &Case, list: &str) -> Option<Command> {
    let snakemake = root().join(".venv-snakemake/bin/snakemake");
    if !snakemake.exists() {
        skip("a list by Snakemake", &format!("{} is not there (make snakemake-env)", snakemake.display()));
        return None;
    }
    let path = case.folder.path().join("cases.csv");
    std::fs::write(&path, list).unwrap();
    let mut command = make();
    command.args(["cluster", "GOAL=surface", "CLUSTER_OPTIONS=--cores 2"]);
    command.arg(format!("LIST={}", path.display())).arg(format!("OUT={}", case.out().display()));
    command.arg(case.stand_in.variable());
    Some(command)
}

/// Returns the modification times of the outputs of all stages for a row.
fn times(case: &Case, name: &str) -> Vec<SystemTime> {
    let time = |ending: &str| std::fs::metadata(case.out().join(name).join(format!("{name}.{ending}")));
    STAGES.iter().map(|(_, ending)| time(ending).and_then(|it| it.modified()).expect(ending)).collect()
}

const LIST: &str = "NAME,INPUT,ISO,SIZE,SCALE\n\
                    a ball,ball.nrrd,100,4,0\n\
                    broken,text.nrrd,100,4,\n\
                    empty,ball.nrrd,100000,,\n\
                    wrong,ball.nrrd,100,-1,\n";

#[test]
fn a_list_is_made_by_snakemake() {
    let case = Case::new();
    let Some(mut first) = cluster(&case, LIST) else { return };
    std::fs::write(case.folder.path().join("text.nrrd"), "no volume").unwrap();
    let ended = run(&mut first);
    let error = "error";
    let all = [("a ball", "passed"), ("broken", error), ("empty", error), ("wrong", error)];
    assert_eq!(verdicts(&case), expected(all), "{}{}", ended.stdout, ended.stderr);
    assert_eq!(ended.code, Some(2), "{}{}", ended.stdout, ended.stderr);
    assert!(ended.stdout.contains("1 of 4 cases are fit"), "{}", ended.stdout);
    let index = std::fs::read_to_string(case.out().join("index.html")).expect("the index");
    for (name, _) in all {
        assert!(index.contains(&format!("\"name\": \"{name}\"")), "{name} is not in the index: {index}");
    }
    assert!(case.out().join("broken/broken.report.html").exists(), "what failed has a page");

    // The new list contains only one row, with another SIZE. The distance field of this row does
    // not depend on SIZE, so it must be kept.
    let before = times(&case, "a ball");
    let mended = "NAME,INPUT,ISO,SIZE,SCALE\na ball,ball.nrrd,100,3,0\n";
    let run_mended = |list: &str| {
        let ended = run(&mut cluster(&case, list).expect("Snakemake is there"));
        assert_eq!(ended.code, Some(0), "{}{}", ended.stdout, ended.stderr);
    };
    run_mended(mended);
    let after = times(&case, "a ball");
    assert_eq!(before[0], after[0], "F does not depend on the size here");
    assert!(before.iter().zip(&after).skip(1).all(|(before, after)| before != after), "another size");
    run_mended(mended);
    assert_eq!(times(&case, "a ball"), after, "nothing has changed");
}

#[test]
fn a_list_that_cannot_be_meant_is_refused_before_any_job() {
    let case = Case::new();
    let Some(mut command) = cluster(&case, "INPUT,LABLES\nball.nrrd,1\n") else { return };
    run(&mut command).expect_error(2, &["LABLES", "did you mean LABELS?"]);
    assert!(!case.out().join(".snakemake").exists());
}
