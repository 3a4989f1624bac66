//! Tests lists of cases: failing rows are reported and do not stop other rows, and the next run
//! completes the remaining rows.

use super::support::{Ended, run};
use super::{Case, executable, make};
use std::collections::BTreeMap;
use std::path::Path;
use std::process::Command;

/// Writes a list of cases and returns the command `make batch` that makes their surfaces.
fn batch(case: &Case, list: &str, variables: &[&str]) -> Command {
    let path = case.folder.path().join("cases.csv");
    std::fs::write(&path, list).unwrap();
    let mut command = make();
    command.args(["batch", "GOAL=surface"]).arg(format!("LIST={}", path.display()));
    command.arg(format!("OUT={}", case.out().display())).arg(case.stand_in.variable()).args(variables);
    command
}

/// Returns the verdict and the headline of each case from the summary.
fn summary(case: &Case) -> BTreeMap<String, (String, String)> {
    let mut reader = csv::Reader::from_path(case.out().join("batch.csv")).expect("batch.csv");
    let columns = reader.headers().expect("a header").clone();
    let cell = |row: &csv::StringRecord, name: &str| {
        row[columns.iter().position(|column| column == name).expect("a column")].to_owned()
    };
    let rows: Vec<_> = reader.records().map(|row| row.expect("a row")).collect();
    rows.iter().map(|row| (cell(row, "name"), (cell(row, "verdict"), cell(row, "headline")))).collect()
}

pub(super) fn verdicts(case: &Case) -> BTreeMap<String, String> {
    summary(case).into_iter().map(|(name, (verdict, _))| (name, verdict)).collect()
}

pub(super) fn expected<const N: usize>(verdicts: [(&str, &str); N]) -> BTreeMap<String, String> {
    verdicts.map(|(name, verdict)| (name.to_owned(), verdict.to_owned())).into()
}

const LIST: &str = "NAME;INPUT;ISO;SIZE\n\
                    # a comment, and an empty line\n\n\
                    coarse;ball.nrrd;100;4\n\
                    missing;nowhere.nrrd;100;4\n\
                    \"wrong size\";ball.nrrd;100;-1\n\
                    \"no volume\";text.nrrd;100;4\n\
                    ;ball.nrrd;100;\n\
                    empty;ball.nrrd;100000;\n";

#[test]
fn what_fails_is_told_and_the_rest_is_made() {
    let case = Case::new();
    std::fs::write(case.folder.path().join("text.nrrd"), "no volume").unwrap();
    let ended = run(&mut batch(&case, LIST, &["SIZE=2.5"]));
    // make turns exit code 1 into 2.
    assert_eq!(ended.code, Some(2), "{}{}", ended.stdout, ended.stderr);
    let error = "error";
    let all = [
        ("coarse", "passed"),
        ("missing", error),
        ("wrong size", error),
        ("no volume", error),
        ("ball", "passed"),
        ("empty", error),
    ];
    assert_eq!(verdicts(&case), expected(all), "{}", ended.stdout);
    let told = summary(&case);
    for (name, words) in [
        ("missing", "not found"),
        ("wrong size", "SIZE=-1 (line 6 of the list)"),
        ("no volume", "text.nrrd"),
        ("empty", "100000"),
    ] {
        assert!(told[name].1.contains(words), "{name}: {:?}", told[name]);
        assert!(ended.stdout.contains(&format!("{name}: error: ")), "{}", ended.stdout);
    }
    assert!(ended.stdout.contains("2 of 6 cases are fit") && ended.stdout.contains("line 5 "), "{}", ended.stdout);
    assert!(ended.stdout.contains(".batch/missing.log"), "a run's log is told: {}", ended.stdout);
    assert!(!ended.stdout.contains("wrong size.log"), "there was no run: {}", ended.stdout);
    let log = std::fs::read_to_string(case.out().join(".batch/coarse.log")).expect("the log of a row");
    assert!(log.contains("distfield"), "{log}");
    let index = std::fs::read_to_string(case.out().join("index.html")).expect("the index");
    for name in all.map(|(name, _)| name) {
        assert!(index.contains(&format!("\"name\": \"{name}\"")), "{name} is not in the index: {index}");
    }
    // The row with an empty SIZE must use SIZE from the command line.
    assert!(case.text("status.json").contains("\"SIZE\": \"2.5\""), "{}", case.text("status.json"));

    let before = case.times();
    let mended = LIST
        .replace("nowhere", "ball")
        .replace(";-1", ";3")
        .replace("100000", "90")
        .replace("\"no volume\";text.nrrd;100;4\n", "");
    run(&mut batch(&case, &mended, &["SIZE=2.5"])).expect_success("the list, mended");
    let all = [
        ("coarse", "passed"),
        ("missing", "passed"),
        ("wrong size", "passed"),
        ("ball", "passed"),
        ("empty", "passed"),
    ];
    assert_eq!(verdicts(&case), expected(all));
    assert_eq!(case.times(), before, "what was made holds");
}

#[test]
fn a_mask_in_a_list_is_relative_to_the_list() {
    let case = Case::new();
    std::fs::copy(&case.volume, case.folder.path().join("mask.nrrd")).unwrap();
    let list = "NAME,INPUT,ISO,SIZE,CROP\nmask,ball.nrrd,100,4,mask.nrrd\nbox,ball.nrrd,100,4,\"voxels:..22,..,..\"\n";
    run(&mut batch(&case, list, &[])).expect_success("the list");
    assert_eq!(verdicts(&case), expected([("mask", "passed"), ("box", "passed")]));
}

/// Options that a later stage would refuse are reported before the first row runs, and earlier
/// results are kept.
#[test]
fn refused_options_are_told_before_the_first_row() {
    let case = Case::new();
    let list = "NAME,INPUT,ISO,SIZE,SIZEFIELD_OPTIONS\r\ngood,ball.nrrd,100,4,\r\nbad,ball.nrrd,100,4,\r\n";
    run(&mut batch(&case, list, &[])).expect_success("the list");
    let bad = list.replace("bad,ball.nrrd,100,4,", "bad,ball.nrrd,100,4,--sise 3");
    let ended = run(&mut batch(&case, &bad, &[]));
    let told = ended.stderr.find("line 3 of the list, bad: error: sizefield: ").expect("told at once");
    assert!(ended.stderr[told..].contains("--sise"), "{}", ended.stderr);
    assert_eq!(verdicts(&case), expected([("good", "passed"), ("bad", "error")]));
    assert!(!ended.stdout.contains("bad.log"), "it was not begun: {}", ended.stdout);
    assert!(case.out().join("bad/bad.surface.vtp").exists(), "the surface of the run before");
}

#[test]
fn a_list_that_cannot_be_meant_is_refused_before_any_work() {
    let case = Case::new();
    let refused = |list: &str, words: &[&str]| {
        run(&mut batch(&case, list, &[])).expect_error(2, words);
        assert!(!case.out().exists(), "{list}");
    };
    refused("INPUT,LABLES\nball.nrrd,1\n", &["LABLES", "a column of", "did you mean LABELS?"]);
    refused("INPUT,ISO\nball.nrrd,1\nball.nrrd,2\n", &["lines 2 and 3", "the same name, ball", "NAME"]);
    refused("INPUT,ISO,ISO\nball.nrrd,1,2\n", &["two columns", "ISO"]);
    refused("INPUT,ISO\nball.nrrd,1,2\n", &["line: 2", "header"]);
    refused("INPUT,OUT\nball.nrrd,x\n", &["OUT cannot be a column"]);
    refused("INPUT,ISO\n", &["no rows"]);
    let nothing = |variables: &[&str], words: &[&str]| {
        let mut command = make();
        command.args(["batch", &format!("OUT={}", case.out().display())]).args(variables);
        run(&mut command).expect_error(2, words);
    };
    nothing(&[], &["LIST is not set", "INPUT"]);
    nothing(&["LIST=nowhere.csv"], &["nowhere.csv", "LIST"]);
    nothing(&["LIST=nowhere.csv", "TIME_LIMIT=soon"], &["TIME_LIMIT=soon", "2h"]);
}

/// A case that exceeds the time limit is stopped, and the other cases still run.
#[cfg(unix)]
#[test]
fn a_case_that_takes_too_long_is_stopped() {
    let case = Case::new();
    let programs = case.linked_programs();
    let real = |name: &str| super::support::binaries().join(name).display().to_string();
    let slow = |seconds: u32| {
        let script = format!(
            "case \"$*\" in --check-options*) echo \"$2\";; *slow*) exec sleep {seconds};; *) exec '{}' \"$@\";; esac\n",
            real("sizefield")
        );
        executable(&programs.join("sizefield"), &script);
    };
    slow(600);
    let list = "NAME,INPUT,ISO,SIZE\nslow,ball.nrrd,100,4\nquick,ball.nrrd,100,4\n";
    let go = |limit: &str| -> Ended {
        let bin = format!("BIN={}", Path::new(&programs).display());
        run(&mut batch(&case, list, &[&bin, limit]))
    };
    let ended = go("TIME_LIMIT=20s");
    assert_eq!(ended.code, Some(2), "{}{}", ended.stdout, ended.stderr);
    assert_eq!(verdicts(&case), expected([("slow", "out of time"), ("quick", "passed")]), "{}", ended.stdout);
    executable(&programs.join("sizefield"), &format!("exec '{}' \"$@\"\n", real("sizefield")));
    go("TIME_LIMIT=").expect_success("the rest");
    assert_eq!(verdicts(&case), expected([("slow", "passed"), ("quick", "passed")]));
}
