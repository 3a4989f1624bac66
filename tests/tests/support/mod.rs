//! Helpers for the integration tests. They run the programs, write phantoms, and examine meshes
//! without using the code under test.
#![allow(dead_code, unreachable_pub, reason = "each test binary uses its own part of these helpers")]

pub mod chain;
pub mod examine;

use isoparticles_tests::nrrd::{self, FileSpace, Voxels};
use isoparticles_tests::scene::{self, Options, Shape, Truth};
pub use isoparticles_tests::skip::skip;
use isoparticles_tests::volume;
use isoparticles_volume::Geometry;
use std::ffi::OsStr;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::OnceLock;

/// Returns the root of the repository.
pub fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).parent().expect("tests/ lies in the repository").to_path_buf()
}

/// Returns the folder of the release programs: `ISOPARTICLES_BIN`, if it is set. Otherwise, each
/// test binary first builds the programs, which takes a fraction of a second if they are up to
/// date.
pub fn binaries() -> &'static Path {
    static BINARIES: OnceLock<PathBuf> = OnceLock::new();
    BINARIES.get_or_init(|| {
        if let Some(folder) = std::env::var_os("ISOPARTICLES_BIN") {
            return PathBuf::from(folder);
        }
        let status = Command::new(env!("CARGO"))
            .args(["build", "--release", "--locked", "--quiet", "--bins"])
            .current_dir(root())
            .status()
            .expect("cargo can be started");
        assert!(status.success(), "the stage programs must build: cargo build --release --locked");
        let target = std::env::var_os("CARGO_TARGET_DIR").map_or_else(|| root().join("target"), PathBuf::from);
        root().join(target).join("release")
    })
}

/// Exit code and output of a program.
#[derive(Debug)]
pub struct Ended {
    /// Exit code.
    pub code: Option<i32>,
    /// Output on stderr.
    pub stderr: String,
    /// Output on stdout.
    pub stdout: String,
}

impl Ended {
    /// Panics with the program's stderr unless the exit code is 0.
    #[track_caller]
    pub fn expect_success(self, what: &str) -> Self {
        assert_eq!(self.code, Some(0), "{what} failed:\n{}", self.stderr);
        self
    }

    /// Asserts that the program failed with this exit code, without a panic, and with a three-part
    /// error that contains every word of `words`.
    #[track_caller]
    pub fn expect_error(&self, code: i32, words: &[&str]) {
        assert_eq!(self.code, Some(code), "exit code; stderr:\n{}", self.stderr);
        assert!(!self.stderr.contains("panicked"), "a panic:\n{}", self.stderr);
        for part in ["error: ", "why it matters: ", "what to do: "] {
            assert!(self.stderr.contains(part), "the message lacks '{part}':\n{}", self.stderr);
        }
        let lower = self.stderr.to_lowercase();
        for word in words {
            assert!(lower.contains(&word.to_lowercase()), "the message should say '{word}':\n{}", self.stderr);
        }
    }
}

/// Runs a program and waits for its end.
pub fn run(command: &mut Command) -> Ended {
    let output = command.stdin(Stdio::null()).output().unwrap_or_else(|e| panic!("{command:?} cannot be started: {e}"));
    Ended {
        code: output.status.code(),
        stderr: String::from_utf8_lossy(&output.stderr).into_owned(),
        stdout: String::from_utf8_lossy(&output.stdout).into_owned(),
    }
}

/// Runs a stage program without progress output.
pub fn stage<A: AsRef<OsStr>>(name: &str, arguments: impl IntoIterator<Item = A>) -> Ended {
    let mut command = Command::new(binaries().join(name));
    command.args(arguments).args(["--progress", "none"]);
    run(&mut command)
}

/// Makes a list of arguments from values that convert into `OsString`.
#[macro_export]
macro_rules! arguments {
    ($($argument:expr),* $(,)?) => { vec![$(std::ffi::OsString::from($argument)),*] };
}

/// Kind of a phantom's voxels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// 32-bit scalars.
    Scalar,
    /// Labels 0 and 1.
    Label,
}

/// Writes a phantom and returns its exact properties. Voxels of the object have values above 100,
/// or the label 1.
pub fn write_phantom(path: &Path, shape: Shape, geometry: &Geometry, kind: Kind) -> Truth {
    write_phantom_with(path, shape, geometry, kind, FileSpace::Lps, &Options::for_grid(geometry))
}

/// Writes a phantom with all options.
pub fn write_phantom_with(
    path: &Path,
    shape: Shape,
    geometry: &Geometry,
    kind: Kind,
    space: FileSpace,
    options: &Options,
) -> Truth {
    let scene = scene::build(shape, geometry, options);
    let voxels = match kind {
        Kind::Scalar => Voxels::F32(volume::scalar(scene.as_ref(), geometry, 0.0, 0).data),
        Kind::Label => Voxels::U8(volume::labels(scene.as_ref(), geometry).data),
    };
    nrrd::write(path, geometry, space, &voxels, true).expect("the phantom can be written");
    scene.truth()
}

/// Returns the sorted names of the files in a folder.
pub fn listing(folder: &Path) -> Vec<String> {
    let mut names: Vec<String> = std::fs::read_dir(folder)
        .expect("the folder can be listed")
        .map(|entry| entry.expect("entry").file_name().to_string_lossy().into_owned())
        .collect();
    names.sort();
    names
}

/// Returns the folder of the real volumes. If the folder is missing, records a skip and returns
/// `None`.
pub fn real_volumes(test: &str) -> Option<PathBuf> {
    let folder = isoparticles_tests::skip::real_volumes_folder();
    if folder.is_dir() {
        return Some(folder);
    }
    skip(test, &format!("{} is not there", folder.display()));
    None
}
