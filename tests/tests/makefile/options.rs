//! Tests options that a stage refuses. The run ends before it removes or starts anything, and
//! earlier results are kept.

use super::support::{Kind, listing, run, write_phantom};
use super::{Case, make};
use glam::DVec3;
use isoparticles_tests::scene::Shape;
use isoparticles_volume::Geometry;
use std::path::Path;
use std::time::SystemTime;

/// Returns the files in a folder with their modification times.
fn snapshot(folder: &Path) -> Vec<(String, SystemTime)> {
    let time = |name: &String| std::fs::metadata(folder.join(name)).and_then(|it| it.modified()).expect("a time");
    let files = listing(folder).into_iter().filter(|name| folder.join(name).is_file() && name != ".lock");
    files.map(|name| (name.clone(), time(&name))).collect()
}

#[test]
fn refused_options_leave_the_results_of_the_run_before() {
    let case = Case::new();
    case.mesh(0, &[]);
    let before = snapshot(&case.out().join("ball"));
    let attempts: [(&[&str], &[&str]); 11] = [
        (&["TETMESH_OPTIONS=--export stl,feb"], &["tetmesh-check", "stl", "nothing was removed"]),
        (&["DISTFIELD_OPTIONS=--keep bigest"], &["distfield", "bigest"]),
        (&["SIZEFIELD_OPTIONS=--sise 3"], &["sizefield", "--sise", "'--size'", "/sizefield --help`"]),
        (
            &["SIZEFIELD_OPTIONS=--refine ball:0,0,0,4=1"],
            &["sizefield", "SIZE=2.5 (--uniform) and --refine", "MIN_SIZE and MAX_SIZE"],
        ),
        (&["SIZEFIELD_OPTIONS=--size body=8"], &["sizefield", "--size body=8 for one object"]),
        (&["SIZE=", "MIN_SIZE=5", "MAX_SIZE=4"], &["sizefield", "--min-size 5 is above --max-size 4"]),
        (&["SIZE=", "SIZEFIELD_OPTIONS=--refine mask:no.nrrd=1"], &["sizefield", "no.nrrd"]),
        (&["PARTICLES_OPTIONS=--levels 9"], &["particles", "--levels"]),
        (&["RECONSTRUCT_OPTIONS=--each parts"], &["reconstruct", "--each"]),
        (&["MAX_MEMORY=plenty"], &["distfield", "--max-memory", "8G"]),
        (&["ISO=100000"], &["distfield", "100000"]),
    ];
    for (variables, words) in attempts {
        // Another iso value makes every stage run again.
        let mut command = case.command("mesh", &["ISO=120", "SIZE=2.5", "VERBOSITY=-q"]);
        run(command.args(variables)).expect_error(2, words);
        assert_eq!(snapshot(&case.out().join("ball")), before, "{variables:?}");
    }
    assert_eq!(case.status()["verdict"], "passed");
    // Only stages that run are checked.
    case.surface(&["ISO=120", "SIZE=2.5", "TETMESH_OPTIONS=--export stl"]).expect_success("make surface");
}

#[test]
fn an_open_surface_is_not_filled() {
    let case = Case::new();
    let attempts = [("BORDER=open", "BORDER=open gives"), ("DISTFIELD_OPTIONS=--border open", "--border open' gives")];
    for (variable, what) in attempts {
        let variables = ["PHANTOM=ball --size 24", "ISO=100", "SIZE=3", "SCALE=0", "VERBOSITY=-q", variable];
        let told = [what, "an open surface", "`make surface`", "BORDER=cap"];
        run(&mut case.bare("mesh", &variables)).expect_error(2, &told);
        assert!(!case.out().exists());
    }
    let open = ["PHANTOM=ball --size 24", "ISO=100", "SCALE=0", "BORDER=open"];
    run(&mut case.bare("distfield", &open)).expect_success("make distfield");
}

#[test]
fn the_options_of_a_phantom_are_checked_first() {
    let case = Case::new();
    let phantom = |words: &str| run(&mut case.bare("distfield", &[&format!("PHANTOM={words}"), "ISO=100"]));
    phantom("bal --size 24").expect_error(2, &["phantom", "bal"]);
    assert!(!case.out().exists());
    phantom("ball --size 24").expect_success("make distfield");
    // The new phantom replaces the scan of the earlier run, so LABELS must not be checked against
    // that scan.
    let labels = ["PHANTOM=ball --size 24 --kind label", "LABELS=1"];
    run(&mut case.bare("distfield", &labels)).expect_success("labels in place of a scan");
}

#[test]
fn names_of_materials_are_checked_before_any_stage() {
    let case = Case::new();
    let volume = case.folder.path().join("labels.nrrd");
    write_phantom(&volume, Shape::Ball, &Geometry::axis_aligned([24; 3], DVec3::ONE), Kind::Label);
    let surface = |variables: &[&str]| {
        let mut command = make();
        command.args(["surface", &format!("INPUT={}", volume.display()), "VERBOSITY=-q"]);
        command.arg(format!("OUT={}", case.out().display())).arg(case.stand_in.variable()).args(variables);
        run(&mut command)
    };
    let given = "SIZEFIELD_OPTIONS=--size body=3";
    surface(&["MATERIALS=body:1", "SCALE=0", given]).expect_success("make surface");
    let before = snapshot(&case.out().join("labels"));
    let wrong = "SIZEFIELD_OPTIONS=--size bdoy=3";
    let told = ["sizefield", "--size bdoy=3: no such material", "outside, body"];
    // The distance field is valid.
    surface(&["MATERIALS=body:1", "SCALE=0", wrong]).expect_error(2, &told);
    // The distance field is out of date, so the material names must come from the options or the
    // volume.
    surface(&["MATERIALS=body:1", "SCALE=2", wrong]).expect_error(2, &told);
    surface(&["MATERIALS=all", "SCALE=0", wrong]).expect_error(2, &["sizefield", "bdoy", "outside, "]);
    surface(&["MATERIALS=body:7", "SCALE=0"]).expect_error(2, &["distfield", "7"]);
    surface(&["LABELS=lnug", "SCALE=0"]).expect_error(2, &["distfield", "lnug"]);
    let levels = "PARTICLES_OPTIONS=--levels 2";
    surface(&["MATERIALS=body:1", "SCALE=2", levels]).expect_error(2, &["particles", "one level"]);
    assert_eq!(snapshot(&case.out().join("labels")), before);
}
