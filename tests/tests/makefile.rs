//! The Makefile from end to end: what reruns when a parameter changes, failures, interrupts, several cases at once.

mod support;

use glam::DVec3;
use isoparticles_common::geometry::Geometry;
use isoparticles_tests::scene::Shape;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::SystemTime;
use support::{Ended, Kind, binaries, listing, root, run, skip, write_phantom};

/// Stages in order, with the output of each.
const STAGES: [(&str, &str); 5] = [
    ("distfield", "distfield.vti"),
    ("sizefield", "sizefield.vti"),
    ("seed", "seeds.bin"),
    ("particles", "particles.bin"),
    ("reconstruct", "surface.vtp"),
];

struct Case {
    folder: tempfile::TempDir,
    volume: PathBuf,
}

impl Case {
    fn new() -> Self {
        let folder = tempfile::tempdir().expect("folder");
        let volume = folder.path().join("ball.nrrd");
        write_phantom(&volume, Shape::Ball, &Geometry::axis_aligned([24; 3], DVec3::ONE), Kind::Scalar);
        Self { folder, volume }
    }

    fn out(&self) -> PathBuf {
        self.folder.path().join("out")
    }

    fn command(&self, goal: &str, variables: &[&str]) -> Command {
        let mut command = make();
        command.arg(goal).arg(format!("INPUT={}", self.volume.display())).arg(format!("OUT={}", self.out().display()));
        command.args(variables);
        command
    }

    fn surface(&self, variables: &[&str]) -> Ended {
        run(&mut self.command("surface", variables))
    }

    fn file(&self, ending: &str) -> PathBuf {
        self.out().join("ball").join(format!("ball.{ending}"))
    }

    /// When each stage's output was written.
    fn times(&self) -> BTreeMap<&'static str, SystemTime> {
        let time = |ending| std::fs::metadata(self.file(ending)).and_then(|m| m.modified());
        STAGES.iter().map(|(name, ending)| (*name, time(ending).expect(name))).collect()
    }

    /// Makes the surface with other variables and tells which stages ran.
    #[track_caller]
    fn reran(&self, variables: &[&str]) -> Vec<&'static str> {
        let before = self.times();
        self.surface(variables).expect_success("make surface");
        let after = self.times();
        STAGES.iter().map(|(name, _)| *name).filter(|name| before[name] != after[name]).collect()
    }
}

/// GNU make on the Makefile, with the programs that are built already.
fn make() -> Command {
    let mut command = Command::new("make");
    command.current_dir(root()).arg("NO_BUILD=yes").arg(format!("BIN={}", binaries().display()));
    // What the make that runs these tests was told is none of this one's business.
    for variable in ["MAKEFLAGS", "MFLAGS", "MAKELEVEL", "MAKEOVERRIDES"] {
        command.env_remove(variable);
    }
    command
}

const PARAMETERS: [&str; 3] = ["ISO=100", "SIZE=2.5", "VERBOSITY=-q"];

#[test]
fn one_parameter_reruns_exactly_the_stages_that_depend_on_it() {
    let case = Case::new();
    case.surface(&PARAMETERS).expect_success("make surface");
    assert_eq!(case.reran(&PARAMETERS), [] as [&str; 0], "nothing changed");
    assert_eq!(
        case.reran(&["ISO=100", "SIZE=2.5", "VERBOSITY=-v", "THREADS=1"]),
        [] as [&str; 0],
        "how loud and how many"
    );
    assert_eq!(case.reran(&["ISO=100", "SIZE=2.5", "BACKEND=cpu"]), ["particles", "reconstruct"]);
    let reseeded = ["ISO=100", "SIZE=2.5", "BACKEND=cpu", "SEED=3"];
    assert_eq!(case.reran(&reseeded), ["seed", "particles", "reconstruct"]);
    let resized = ["ISO=100", "SIZE=2.4", "BACKEND=cpu", "SEED=3"];
    assert_eq!(case.reran(&resized), ["sizefield", "seed", "particles", "reconstruct"]);
    let graded = ["ISO=100", "EPSILON=0.4", "MAX_SIZE=3", "BACKEND=cpu", "SEED=3"];
    assert_eq!(case.reran(&graded), ["sizefield", "seed", "particles", "reconstruct"]);
    let another = ["ISO=120", "EPSILON=0.4", "MAX_SIZE=3", "BACKEND=cpu", "SEED=3"];
    assert_eq!(case.reran(&another), ["distfield", "sizefield", "seed", "particles", "reconstruct"]);
    // A touched input reruns everything; one lost output, what comes after it.
    std::fs::File::options().append(true).open(&case.volume).unwrap().set_modified(SystemTime::now()).unwrap();
    assert_eq!(case.reran(&another).len(), 5);
    std::fs::remove_file(case.file("surface.vtp")).unwrap();
    case.surface(&another).expect_success("make surface");
    assert!(case.file("surface.vtp").exists());
}

#[test]
fn a_program_built_anew_to_the_same_bytes_reruns_nothing() {
    let case = Case::new();
    let programs = case.folder.path().join("bin");
    std::fs::create_dir(&programs).unwrap();
    let copy = || {
        for (name, _) in STAGES {
            std::fs::copy(binaries().join(name), programs.join(name)).unwrap();
        }
    };
    copy();
    let bin = format!("BIN={}", programs.display());
    let variables = ["ISO=100", "SIZE=2.5", "VERBOSITY=-q", &bin];
    case.surface(&variables).expect_success("make surface");
    copy();
    assert_eq!(case.reran(&variables), [] as [&str; 0]);
    // One more byte at the end changes the program, not what it does.
    use std::io::Write;
    std::fs::File::options().append(true).open(programs.join("particles")).unwrap().write_all(&[0]).unwrap();
    assert_eq!(case.reran(&variables), ["particles", "reconstruct"]);
}

#[test]
fn missing_and_contradicting_parameters_are_explained() {
    let case = Case::new();
    let attempts: [(&[&str], &str); 5] = [
        (&[], "ISO"),
        (&["ISO=1", "LABELS=1"], "both set"),
        (&["ISO=1", "SIZE=2", "MAX_SIZE=3"], "SIZE"),
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
    assert!(help.contains("make demo") && help.contains("make mesh INPUT="), "{help}");
}

#[test]
fn a_failing_stage_fails_make_and_leaves_no_output() {
    let case = Case::new();
    let ended = case.surface(&["ISO=100000"]);
    assert_eq!(ended.code, Some(2), "{}", ended.stderr);
    assert!(ended.stderr.contains("100000") && ended.stderr.contains("what to do"), "{}", ended.stderr);
    assert!(!case.file("distfield.vti").exists());
}

/// A stage that made its output but failed a check: make fails, the output is kept under another name.
#[test]
#[cfg(unix)]
fn the_output_of_a_failed_check_is_kept_aside() {
    use std::os::unix::fs::PermissionsExt;
    let case = Case::new();
    let programs = case.folder.path().join("bin");
    std::fs::create_dir(&programs).unwrap();
    for (name, _) in STAGES {
        std::os::unix::fs::symlink(binaries().join(name), programs.join(name)).unwrap();
    }
    // A stand-in for sizefield that writes its output and says that a check failed.
    std::fs::remove_file(programs.join("sizefield")).unwrap();
    std::fs::write(programs.join("sizefield"), "#!/bin/sh\necho made > \"$3\"\nexit 1\n").unwrap();
    std::fs::set_permissions(programs.join("sizefield"), std::fs::Permissions::from_mode(0o755)).unwrap();
    let bin = format!("BIN={}", programs.display());
    let ended = case.surface(&["ISO=100", "VERBOSITY=-q", &bin]);
    assert_eq!(ended.code, Some(2), "{}", ended.stderr);
    assert!(ended.stderr.contains("sizefield.failed.vti"), "{}", ended.stderr);
    assert!(!case.file("sizefield.vti").exists() && !case.file("seeds.bin").exists());
    assert_eq!(std::fs::read_to_string(case.file("sizefield.failed.vti")).unwrap(), "made\n");
    // With the real program the case goes on from there, and the failed output goes away.
    case.surface(&PARAMETERS).expect_success("make surface");
    assert!(!case.file("sizefield.failed.vti").exists());
}

/// Stand-ins for tetmesh-check and its pages; the first ends with the exit code that `end_with` sets.
#[cfg(unix)]
struct StandIn {
    folder: tempfile::TempDir,
}

#[cfg(unix)]
impl StandIn {
    fn new() -> Self {
        use std::os::unix::fs::PermissionsExt;
        let folder = tempfile::tempdir().expect("folder");
        let outputs =
            "for word; do case $before in -o) out=$word;; --report) report=$word;; esac; before=$word; done\n";
        let programs = [
            (
                "",
                "code=$(cat \"$0.code\"); [ $code = 2 ] || echo $code > \"$out\"; echo {} > \"$report\"; exit $code\n",
            ),
            ("-page", "echo \"$1\" > \"$out\"\n"),
            ("-index", "echo \"$*\" > \"$out\"\n"),
        ];
        for (ending, does) in programs {
            let path = folder.path().join(format!("tetmesh-check{ending}"));
            std::fs::write(&path, format!("#!/bin/sh\n{outputs}{does}")).unwrap();
            std::fs::set_permissions(&path, std::fs::Permissions::from_mode(0o755)).unwrap();
        }
        Self { folder }
    }

    fn end_with(&self, code: i32) {
        std::fs::write(self.folder.path().join("tetmesh-check.code"), code.to_string()).unwrap();
    }

    fn variable(&self) -> String {
        format!("TETMESH_CHECK={}/tetmesh-check", self.folder.path().display())
    }
}

/// However the last stage ends, nothing of an earlier run is left that could be taken for its result.
#[test]
#[cfg(unix)]
fn no_stale_mesh_or_page_is_left() {
    let (case, stand_in) = (Case::new(), StandIn::new());
    let program = stand_in.variable();
    let text = |ending: &str| std::fs::read_to_string(case.file(ending)).unwrap_or_default();
    let mesh = |code: i32, options: &str| {
        stand_in.end_with(code);
        let ended = run(&mut case.command("mesh", &["ISO=100", "SIZE=2.5", "VERBOSITY=-q", &program, options]));
        assert_eq!(ended.code, Some(if code == 0 { 0 } else { 2 }), "{}", ended.stderr);
        ended.stderr
    };
    mesh(0, "TETMESH_OPTIONS=-a");
    assert_eq!(text("volume.vtu"), "0\n");
    assert!(text("report.html").ends_with("ball.report.json\n"), "{}", text("report.html"));
    assert!(mesh(1, "TETMESH_OPTIONS=-b").contains("ball.volume.failed.vtu"));
    assert_eq!(text("volume.failed.vtu"), "1\n");
    assert!(text("report.html").ends_with("ball.report.failed.json\n"), "{}", text("report.html"));
    assert!(!case.file("volume.vtu").exists() && !case.file("report.json").exists());
    mesh(0, "TETMESH_OPTIONS=-c");
    assert!(!case.file("volume.failed.vtu").exists() && !case.file("report.failed.json").exists());
    mesh(2, "TETMESH_OPTIONS=-d");
    assert!(!case.file("volume.vtu").exists() && !case.file("volume.failed.vtu").exists());
    assert!(text("report.html").ends_with("ball.report.failed.json\n"), "the page says that there is no mesh");
    // An earlier stage that fails takes the page of the earlier run with it.
    mesh(0, "TETMESH_OPTIONS=-e");
    let ended = run(&mut case.command("mesh", &["ISO=100000", "SIZE=2.5", "VERBOSITY=-q", &program]));
    assert_eq!(ended.code, Some(2), "{}", ended.stderr);
    assert!(!case.file("report.html").exists(), "{:?}", listing(&case.out().join("ball")));
}

/// The program of the order of convergence lies beside tetmesh-check; a change to it must not make tetrahedra anew.
#[test]
fn the_stamp_of_the_tetrahedra_leaves_out_other_programs() {
    let planned =
        run(Case::new().command("mesh", &["ISO=100", "-n"]).arg("HXT=no")).expect_success("make -n mesh").stdout;
    let stamp = planned.lines().find(|line| line.contains("tetmesh_check/fill.py")).expect("the stamp");
    assert!(stamp.contains("requirements*.lock") && stamp.contains("pipeline.py"), "{stamp}");
    assert!(!stamp.contains("convergence.py") && !stamp.contains("page/"), "{stamp}");
}

/// A case that fails stops neither the others nor the index, and make says that something failed.
#[test]
#[cfg(unix)]
fn the_index_is_written_although_a_case_fails() {
    let (folder, stand_in) = (tempfile::tempdir().expect("folder"), StandIn::new());
    let command = |goal: &str| {
        let mut command = make();
        command.args([goal, "CASES=nothing ball", "VERBOSITY=-q"]).arg(stand_in.variable());
        command.arg(format!("OUT={}", folder.path().display()));
        command
    };
    let ended = run(&mut command("index"));
    assert_eq!(ended.code, Some(2));
    for part in ["no reports of cases", "why it matters", "what to do"] {
        assert!(ended.stderr.contains(part), "{}", ended.stderr);
    }
    stand_in.end_with(0);
    let ended = run(&mut command("cases"));
    assert_eq!(ended.code, Some(2), "{}", ended.stderr);
    assert!(ended.stderr.contains("pipelines/nothing.mk"), "{}", ended.stderr);
    let index = std::fs::read_to_string(folder.path().join("index.html")).expect("index.html");
    assert!(index.contains("ball/ball.report.json"), "{index}");
    // With a check that fails the report has another name.
    stand_in.end_with(1);
    assert_eq!(run(command("cases").args(["CASES=ball", "TETMESH_OPTIONS=-a"])).code, Some(2));
    let index = std::fs::read_to_string(folder.path().join("index.html")).expect("index.html");
    assert!(index.contains("ball/ball.report.failed.json") && !index.contains("ball.report.json"), "{index}");
    run(&mut command("index")).expect_success("make index");
}

/// Stopping make in the middle of `particles` leaves no particle file, and the next run finishes the case with the same
/// bytes as one that was never stopped.
#[test]
#[cfg(unix)]
fn a_stopped_run_is_finished_by_the_next() {
    use std::os::unix::process::CommandExt;
    let (stopped, unbroken) = (Case::new(), Case::new());
    let options = "PARTICLES_OPTIONS=--max-passes 300 --energy-tolerance 0";
    let variables = ["ISO=100", "SIZE=1.2", "VERBOSITY=-q", options];
    let mut command = stopped.command("surface", &variables);
    // a process group of its own: the signal must reach make and what it runs alike, as Ctrl-C does in a terminal
    command.process_group(0);
    let mut child = command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null()).spawn().expect("make");
    let checkpoint = stopped.file("checkpoint.bin");
    let mut waited = 0;
    while !checkpoint.exists() {
        assert!(child.try_wait().unwrap().is_none() && waited < 6000, "no checkpoint after {waited} x 10 ms");
        std::thread::sleep(std::time::Duration::from_millis(10));
        waited += 1;
    }
    let killed = Command::new("sh").args(["-c", &format!("kill -s INT -- -{}", child.id())]).status().expect("sh");
    assert!(killed.success());
    assert!(!child.wait().expect("make ends").success(), "make must not call a stopped run a success");
    assert!(!stopped.file("particles.bin").exists(), "{:?}", listing(&stopped.out().join("ball")));

    stopped.surface(&variables).expect_success("the second run");
    unbroken.surface(&variables).expect_success("the unbroken run");
    assert!(!checkpoint.exists(), "a finished run needs no checkpoint");
    // Histories hold the paths of the inputs, which differ between the two folders: compare the particles themselves.
    let particles = |case: &Case| {
        use isoparticles_common::io::particles::{ParticleKind, read_particles};
        read_particles(&case.file("particles.bin"), &[ParticleKind::Particles]).expect("particles").particles
    };
    assert!(particles(&stopped) == particles(&unbroken), "the resumed run differs from the unbroken one");
}

/// Two cases at once give what each gives alone.
#[test]
fn two_cases_at_once() {
    let folder = tempfile::tempdir().expect("folder");
    let together = folder.path().join("together");
    let case = |name: &str, shape: &str, out: &Path| {
        let mut command = make();
        command.args(["surface", "ISO=100", "SIZE=2.5", "VERBOSITY=-q"]);
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
        isoparticles_common::io::surface::read_surface(&path).expect("surface").surface
    };
    assert_eq!(surface(&together), surface(&alone));
}

/// `make -j` over files of pipelines/, down to the tetrahedra, where the Python environment is there.
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
        let report: serde_json::Value = serde_json::from_slice(&std::fs::read(file("report.json")).unwrap()).unwrap();
        assert_eq!(report["outcome"], "passed", "{report}");
        let page = std::fs::read_to_string(file("report.html")).expect("the page");
        assert!(page.contains("Fit for simulation") && page.contains(name), "{name}.report.html");
    }
    let index = std::fs::read_to_string(folder.path().join("index.html")).expect("the index");
    assert!(index.contains("All 2 cases are fit for simulation"), "{index}");
    assert!(index.contains("ball/ball.report.html") && index.contains("two-balls/two-balls.report.html"));
    let lines = std::fs::read_to_string(folder.path().join("index.csv")).expect("the numbers");
    assert_eq!(lines.lines().count(), 3, "{lines}");
}
