//! End-to-end tests of the Makefile: reruns after a change, files left after a failure, arguments,
//! and several cases.

#[path = "../support/mod.rs"]
mod support;

mod arguments;
mod batch;
mod cases;
mod cluster;
mod failures;
mod materials;
mod names;
mod options;
mod reruns;
mod updates;

use glam::DVec3;
use isoparticles_tests::scene::Shape;
use isoparticles_volume::Geometry;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::SystemTime;
use support::{Ended, Kind, binaries, root, run, write_phantom};

/// The stages in order, each with the file name ending of its output.
const STAGES: [(&str, &str); 5] = [
    ("distfield", "distfield.vti"),
    ("sizefield", "sizefield.vti"),
    ("seed", "seeds.bin"),
    ("particles", "particles.bin"),
    ("reconstruct", "surface.vtp"),
];

/// Parameters that make a surface of the ball quickly.
const PARAMETERS: [&str; 3] = ["ISO=100", "SIZE=2.5", "VERBOSITY=-q"];

/// A ball in a temporary folder, and stand-ins for the Python programs.
struct Case {
    folder: tempfile::TempDir,
    volume: PathBuf,
    stand_in: StandIn,
}

impl Case {
    fn new() -> Self {
        let folder = tempfile::tempdir().expect("folder");
        let volume = folder.path().join("ball.nrrd");
        ball(&volume);
        Self { folder, volume, stand_in: StandIn::new() }
    }

    fn out(&self) -> PathBuf {
        self.folder.path().join("out")
    }

    /// Returns the make command for a goal, with the ball as its volume.
    fn command(&self, goal: &str, variables: &[&str]) -> Command {
        let mut command = self.bare(goal, &[&format!("INPUT={}", self.volume.display())]);
        command.args(variables);
        command
    }

    /// Returns the make command for a goal with these variables, without a volume.
    fn bare(&self, goal: &str, variables: &[&str]) -> Command {
        let mut command = make();
        command.arg(goal).arg(format!("OUT={}", self.out().display())).arg(self.stand_in.variable()).args(variables);
        command
    }

    fn surface(&self, variables: &[&str]) -> Ended {
        run(&mut self.command("surface", variables))
    }

    /// Runs `make mesh` with a stand-in for tetmesh-check that exits with `code`.
    #[track_caller]
    fn mesh(&self, code: i32, variables: &[&str]) -> Ended {
        self.stand_in.end_with(code);
        let ended = run(self.command("mesh", &PARAMETERS).args(variables));
        assert_eq!(ended.code, Some(if code == 0 { 0 } else { 2 }), "{}{}", ended.stdout, ended.stderr);
        ended
    }

    fn file(&self, ending: &str) -> PathBuf {
        self.out().join("ball").join(format!("ball.{ending}"))
    }

    fn has(&self, ending: &str) -> bool {
        self.file(ending).exists()
    }

    fn text(&self, ending: &str) -> String {
        std::fs::read_to_string(self.file(ending)).unwrap_or_default()
    }

    fn status(&self) -> serde_json::Value {
        serde_json::from_str(&self.text("status.json")).expect("the status is JSON")
    }

    /// Returns the state of each stage in the status.
    fn states(&self) -> BTreeMap<String, String> {
        let status = self.status();
        let text = |value: &serde_json::Value| value.as_str().unwrap_or_default().to_owned();
        let stages = status["stages"].as_array().expect("stages");
        stages.iter().map(|stage| (text(&stage["stage"]), text(&stage["state"]))).collect()
    }

    /// Returns the modification time of each stage's output.
    fn times(&self) -> BTreeMap<&'static str, SystemTime> {
        let time = |ending| std::fs::metadata(self.file(ending)).and_then(|m| m.modified());
        STAGES.iter().map(|(name, ending)| (*name, time(ending).expect(name))).collect()
    }

    /// Makes the surface with these variables and returns the stages that ran.
    #[track_caller]
    fn reran(&self, variables: &[&str]) -> Vec<&'static str> {
        let before = self.times();
        self.surface(variables).expect_success("make surface");
        let after = self.times();
        STAGES.iter().map(|(name, _)| *name).filter(|name| before[name] != after[name]).collect()
    }

    /// Creates a folder of links to the programs and returns its path. A test can replace a link
    /// with a stand-in.
    #[cfg(unix)]
    fn linked_programs(&self) -> PathBuf {
        let programs = self.folder.path().join("bin");
        std::fs::create_dir(&programs).unwrap();
        for name in STAGES.map(|(name, _)| name).into_iter().chain(["isoparticles-case", "phantom"]) {
            std::os::unix::fs::symlink(binaries().join(name), programs.join(name)).unwrap();
        }
        programs
    }
}

/// Writes a ball of radius 8.05 mm in 24^3 voxels of 1 mm, with the iso value 100.
fn ball(path: &Path) {
    write_phantom(path, Shape::Ball, &Geometry::axis_aligned([24; 3], DVec3::ONE), Kind::Scalar);
}

/// Returns a make command that uses the programs already built.
fn make() -> Command {
    let mut command = Command::new("make");
    command.current_dir(root()).arg("NO_BUILD=yes").arg(format!("BIN={}", binaries().display()));
    // If make runs these tests, its settings must not be inherited.
    for variable in ["MAKEFLAGS", "MFLAGS", "MAKELEVEL", "MAKEOVERRIDES"] {
        command.env_remove(variable);
    }
    command
}

/// Stand-ins for tetmesh-check and its page and index programs. The stand-in for tetmesh-check
/// exits with the code set by `end_with`. The page is a copy of the status file, and the index is
/// the concatenation of all status files.
struct StandIn {
    folder: tempfile::TempDir,
}

impl StandIn {
    fn new() -> Self {
        let folder = tempfile::tempdir().expect("folder");
        let outputs = "for word; do case $before in -o) out=$word;; --report) report=$word;; --pictures) pictures=$word;; esac; \
                       before=$word; done\n";
        let programs = [
            (
                "",
                "case \"$*\" in --check-options*stl*) echo 'error: stl is no format' >&2; exit 2;; \
                 --check-options*) echo \"$2\"; exit 0;; esac\n\
                 code=$(cat \"$0.code\" 2>/dev/null || echo 0)\n[ $code = 2 ] || echo $code > \"$out\"\n\
                 mkdir -p \"$pictures\"; echo drawn > \"$pictures/cut.png\"; echo mesh > \"${out%.vtu}.inp\"\n\
                 [ $code = 1 ] && checks='\"too flat\"'\n\
                 echo \"{\\\"failed_checks\\\": [$checks], \\\"warnings\\\": []}\" > \"$report\"; exit $code\n",
            ),
            ("-page", "cat \"$1\" > \"$out\"\n"),
            ("-index", "for word; do case $word in *.status.json) cat \"$word\";; esac; done > \"$out\"\n"),
        ];
        for (ending, does) in programs {
            executable(&folder.path().join(format!("tetmesh-check{ending}")), &format!("{outputs}{does}"));
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

/// First line of a stand-in for a stage. When the stage is called only to check its options, this
/// line accepts them all.
const TAKES_ALL: &str = "[ \"$1\" = --check-options ] && { echo \"$2\"; exit 0; }\n";

/// Writes an executable shell script.
fn executable(path: &Path, script: &str) {
    // Replace a link instead of writing to its target.
    let _ = std::fs::remove_file(path);
    std::fs::write(path, format!("#!/bin/sh\n{script}")).unwrap();
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt;
        std::fs::set_permissions(path, std::fs::Permissions::from_mode(0o755)).unwrap();
    }
}
