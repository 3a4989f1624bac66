//! Tests the stages that read files written by other stages. They must refuse files of the wrong
//! kind, damaged files, fields of another volume and impossible parameters. The module also tests
//! interrupted and resumed runs.

mod support;

use glam::DVec3;
use isoparticles_stage::particle_file::{ParticleKind, read_particles};
use isoparticles_tests::scene::Shape;
use isoparticles_volume::Geometry;
use std::ffi::OsString;
use std::path::Path;
use std::process::{Command, Stdio};
use std::sync::OnceLock;
use support::chain::{self, Files, Wishes};
use support::{Kind, binaries, listing, stage, write_phantom};

/// Returns the files of a small valid case, which is made once per test program.
fn good() -> &'static Files {
    static GOOD: OnceLock<(tempfile::TempDir, Files)> = OnceLock::new();
    &GOOD
        .get_or_init(|| {
            let folder = tempfile::tempdir().expect("folder");
            let volume = folder.path().join("ball.nrrd");
            write_phantom(&volume, Shape::Ball, &Geometry::axis_aligned([24; 3], DVec3::ONE), Kind::Scalar);
            let files = chain::surface(&volume, folder.path(), &Wishes::scalar(Some(2.5)));
            (folder, files)
        })
        .1
}

/// Returns, for each stage from `sizefield` to `reconstruct`, its name, its arguments with valid
/// inputs, and the file name of its output.
fn commands(files: &Files) -> [(&'static str, Vec<OsString>, &'static str); 4] {
    let fields = arguments!["--distfield", &files.distfield, "--sizefield", &files.sizefield];
    let with_fields = |first: &Path| {
        let mut arguments = arguments![first];
        arguments.extend(fields.clone());
        arguments
    };
    [
        ("sizefield", arguments![&files.distfield], "out.vti"),
        ("seed", arguments![&files.distfield, &files.sizefield], "out.bin"),
        ("particles", with_fields(&files.seeds), "out.bin"),
        ("reconstruct", with_fields(&files.particles), "out.vtp"),
    ]
}

/// Runs a stage and asserts that it refuses its input and leaves no file behind.
#[track_caller]
fn refused(name: &str, mut arguments: Vec<OsString>, output: &str, words: &[&str]) {
    let folder = tempfile::tempdir().expect("folder");
    let output = folder.path().join(output);
    arguments.extend(arguments!["-o", &output]);
    let ended = stage(name, &arguments);
    assert_eq!(ended.code, Some(2), "{name} {arguments:?}: {}", ended.stderr);
    ended.expect_error(2, words);
    assert_eq!(listing(folder.path()), [] as [&str; 0], "{name} left something behind");
}

/// Replaces each input of each stage with a missing, empty, damaged or unrelated file, which the
/// stage must refuse.
#[test]
fn every_input_of_every_stage_is_checked() {
    let folder = tempfile::tempdir().expect("folder");
    let files = good();
    for (name, arguments, output) in commands(files) {
        for position in (0..arguments.len()).filter(|i| !arguments[*i].to_string_lossy().starts_with("--")) {
            let right = Path::new(&arguments[position]).to_path_buf();
            let ending = right.extension().unwrap().to_string_lossy().into_owned();
            let bytes = std::fs::read(&right).unwrap();
            let mut flipped = bytes.clone();
            let middle = flipped.len() / 2;
            flipped[middle] ^= 0x55;
            let mut longer = bytes.clone();
            longer.extend_from_slice(b"more than was promised");
            let mut replacements = vec![
                ("missing", None),
                ("empty", Some(Vec::new())),
                ("text", Some(b"this is no file of ours\n".to_vec())),
                ("truncated", Some(bytes[..bytes.len() / 2].to_vec())),
            ];
            if ending == "bin" {
                // Changed, added and missing bytes are detected reliably only in particle files,
                // which store a length and a checksum. A VTK file, for example, is still valid
                // without its final line break.
                let shorter = bytes[..bytes.len() - 1].to_vec();
                replacements.extend([("flipped", Some(flipped)), ("longer", Some(longer)), ("shorter", Some(shorter))]);
            }
            for (what, content) in replacements {
                let wrong = folder.path().join(format!("{what}.{ending}"));
                if let Some(content) = content {
                    std::fs::write(&wrong, content).unwrap();
                }
                let mut arguments = arguments.clone();
                arguments[position] = wrong.clone().into();
                refused(name, arguments, output, &[wrong.file_name().unwrap().to_str().unwrap()]);
            }
        }
    }
}

#[test]
fn files_of_another_kind_are_refused_by_name() {
    let files = good();
    refused("sizefield", arguments![&files.sizefield], "out.vti", &["case.sizefield.vti", "distfield"]);
    refused("sizefield", arguments![&files.seeds], "out.vti", &["case.seeds.bin"]);
    refused("seed", arguments![&files.sizefield, &files.distfield], "out.bin", &["case.sizefield.vti"]);
    refused("seed", arguments![&files.distfield, &files.distfield], "out.bin", &["case.distfield.vti", "sizefield"]);
    let fields = arguments!["--distfield", &files.distfield, "--sizefield", &files.sizefield];
    let mut particles = arguments![&files.surface];
    particles.extend(fields);
    refused("particles", particles, "out.bin", &["case.surface.vtp"]);
    let surface = arguments![&files.surface, "--distfield", &files.distfield];
    refused("reconstruct", surface, "out.vtp", &["case.surface.vtp"]);
}

#[test]
fn fields_of_another_volume_are_refused() {
    let folder = tempfile::tempdir().expect("folder");
    let volume = folder.path().join("other.nrrd");
    write_phantom(&volume, Shape::Ball, &Geometry::axis_aligned([20, 24, 24], DVec3::ONE), Kind::Scalar);
    let other = chain::fields(&volume, folder.path(), &Wishes::scalar(Some(2.5)));
    let files = good();
    refused("seed", arguments![&files.distfield, &other.sizefield], "out.bin", &["case.sizefield.vti"]);
    for (distance, sizing) in [(&files.distfield, &other.sizefield), (&other.distfield, &other.sizefield)] {
        let arguments = arguments![&files.seeds, "--distfield", distance, "--sizefield", sizing];
        refused("particles", arguments, "out.bin", &[]);
    }
    let arguments = arguments![&files.particles, "--distfield", &other.distfield];
    refused("reconstruct", arguments, "out.vtp", &["case.particles.bin"]);
}

#[test]
fn impossible_parameters_are_bad_usage() {
    let files = good();
    let [sizefield, seed, particles, reconstruct] = commands(files);
    let attempts = [
        (&sizefield, vec!["--epsilon", "0"]),
        (&sizefield, vec!["--epsilon", "-1"]),
        (&sizefield, vec!["--epsilon", "nan"]),
        (&sizefield, vec!["--delta", "-0.1"]),
        (&sizefield, vec!["--min-size", "3", "--max-size", "2"]),
        (&sizefield, vec!["--uniform", "0"]),
        (&sizefield, vec!["--uniform", "2", "--epsilon", "0.3"]),
        (&seed, vec!["--count", "-5"]),
        (&seed, vec!["--count", "many"]),
        (&particles, vec!["--backend", "abacus"]),
        (&particles, vec!["--max-passes", "0"]),
        (&particles, vec!["--resume"]),
        (&reconstruct, vec!["--threads", "-1"]),
    ];
    for ((name, arguments, output), options) in attempts {
        let folder = tempfile::tempdir().expect("folder");
        let mut arguments = arguments.clone();
        arguments.extend(arguments!["-o", folder.path().join(output)]);
        arguments.extend(options.iter().map(OsString::from));
        let ended = stage(name, &arguments);
        assert_eq!(ended.code, Some(2), "{name} {options:?}: {}", ended.stderr);
        assert!(!ended.stderr.contains("panicked") && !ended.stderr.is_empty(), "{name} {options:?}: {}", ended.stderr);
        assert_eq!(listing(folder.path()), [] as [&str; 0], "{name} {options:?} left something behind");
    }
}

#[test]
fn an_unknown_surface_format_is_refused_before_the_work() {
    let (name, arguments, _) = commands(good())[3].clone();
    refused(name, arguments, "out.docx", &["out.docx", ".vtp"]);
}

#[test]
fn a_gpu_that_is_not_there_ends_with_three() {
    let (name, mut arguments, _) = commands(good())[2].clone();
    let folder = tempfile::tempdir().expect("folder");
    arguments.extend(arguments!["-o", folder.path().join("out.bin"), "--backend", "gpu"]);
    arguments.extend(arguments!["--adapter", "no such adapter"]);
    stage(name, arguments).expect_error(3, &["--adapter no such adapter", "--backend cpu"]);
    assert_eq!(listing(folder.path()), [] as [&str; 0]);
}

#[test]
fn existing_outputs_are_kept_by_every_stage() {
    for (name, mut arguments, output) in commands(good()) {
        let folder = tempfile::tempdir().expect("folder");
        let output = folder.path().join(output);
        std::fs::write(&output, "precious").unwrap();
        arguments.extend(arguments!["-o", &output]);
        stage(name, arguments).expect_error(2, &["--force"]);
        assert_eq!(std::fs::read(&output).unwrap(), b"precious", "{name}");
    }
}

#[test]
fn every_stage_has_help_version_and_the_shared_options() {
    for name in ["distfield", "sizefield", "seed", "particles", "reconstruct"] {
        let help = stage(name, ["--help"]).expect_success(name).stdout;
        for option in [
            "--verbose",
            "--quiet",
            "--force",
            "--threads",
            "--max-memory",
            "--seed",
            "--report",
            "--progress",
            "--version",
        ] {
            assert!(help.contains(option), "{name} --help lacks {option}");
        }
        assert!(help.to_lowercase().contains("example"), "{name} --help lacks an example");
        let version = stage(name, ["--version"]).expect_success(name).stdout;
        assert_eq!(version.trim(), format!("{name} {}", env!("CARGO_PKG_VERSION")));
    }
}

#[test]
fn output_bytes_do_not_depend_on_the_thread_count() {
    let (one, two) = (tempfile::tempdir().expect("folder"), tempfile::tempdir().expect("folder"));
    for (name, arguments, output) in commands(good()) {
        let outputs = [(&one, "1"), (&two, "3")].map(|(folder, threads)| {
            let path = folder.path().join(format!("{name}-{output}"));
            let mut arguments = arguments.clone();
            arguments.extend(arguments!["-o", &path, "--threads", threads]);
            stage(name, arguments).expect_success(name);
            std::fs::read(path).unwrap()
        });
        assert!(outputs[0] == outputs[1], "{name}: one and three threads give different bytes");
    }
}

/// An interrupted stage must exit with code 130 and leave only its checkpoint.
#[test]
#[cfg(unix)]
fn an_interrupted_run_leaves_nothing_but_its_checkpoint() {
    let folder = tempfile::tempdir().expect("folder");
    let files = good();
    let output = folder.path().join("out.bin");
    let checkpoint = folder.path().join("checkpoint.bin");
    let many_passes = arguments![
        &files.seeds,
        "--distfield",
        &files.distfield,
        "--sizefield",
        &files.sizefield,
        "-o",
        &output,
        "--checkpoint",
        &checkpoint,
        "--max-passes",
        "100000",
        "--energy-tolerance",
        "0",
        "--quiet",
    ];
    let mut child = Command::new(binaries().join("particles"))
        .args(&many_passes)
        .stdin(Stdio::null())
        .stderr(Stdio::piped())
        .spawn()
        .expect("particles can be started");
    // The checkpoint shows that settling has begun.
    let mut waited = 0;
    while !checkpoint.exists() {
        assert!(child.try_wait().unwrap().is_none() && waited < 6000, "no checkpoint after {waited} x 10 ms");
        std::thread::sleep(std::time::Duration::from_millis(10));
        waited += 1;
    }
    let killed = Command::new("sh").args(["-c", &format!("kill -INT {}", child.id())]).status().expect("sh");
    assert!(killed.success());
    let ended = child.wait_with_output().expect("particles ends");
    let stderr = String::from_utf8_lossy(&ended.stderr);
    assert_eq!(ended.status.code(), Some(130), "{stderr}");
    assert!(stderr.contains("why it matters"), "{stderr}");
    assert_eq!(listing(folder.path()), ["checkpoint.bin"]);
}

/// A run of 20 passes, and a run resumed from the checkpoint of pass 10, must give bit-identical
/// particles. The files differ, because their histories contain the command lines.
#[test]
fn a_resumed_run_gives_the_particles_of_an_unbroken_one() {
    let folder = tempfile::tempdir().expect("folder");
    let files = good();
    let run = |name: &str, passes: &str, more: &[&str]| {
        let output = folder.path().join(name);
        let mut arguments = arguments![
            &files.seeds,
            "--distfield",
            &files.distfield,
            "--sizefield",
            &files.sizefield,
            "-o",
            &output,
            "--energy-tolerance",
            "0",
            "--levels",
            "1",
            "--max-passes",
            passes,
        ];
        arguments.extend(more.iter().map(OsString::from));
        let ended = stage("particles", arguments);
        (ended, output)
    };
    let (ended, unbroken) = run("unbroken.bin", "20", &[]);
    ended.expect_success("the unbroken run");
    let checkpoint = folder.path().join("checkpoint.bin").to_string_lossy().into_owned();
    // A run can be resumed only with its original parameters. Therefore, a run of 20 passes is
    // killed after it has written the checkpoint of pass 10.
    let mut child = Command::new(binaries().join("particles"))
        .args(arguments![
            &files.seeds,
            "--distfield",
            &files.distfield,
            "--sizefield",
            &files.sizefield,
            "-o",
            folder.path().join("broken.bin"),
            "--energy-tolerance",
            "0",
            "--levels",
            "1",
            "--max-passes",
            "20",
            "--checkpoint",
            &checkpoint,
            "--quiet",
        ])
        .spawn()
        .expect("particles can be started");
    while !Path::new(&checkpoint).exists() && child.try_wait().unwrap().is_none() {
        std::thread::sleep(std::time::Duration::from_millis(1));
    }
    // The process may already have ended; only its checkpoint is needed.
    child.kill().ok();
    child.wait().unwrap();
    assert!(Path::new(&checkpoint).exists(), "a checkpoint is written at pass 10");
    let (ended, resumed) = run("resumed.bin", "20", &["--checkpoint", &checkpoint, "--resume"]);
    ended.expect_success("the resumed run");
    let particles = |path: &Path| read_particles(path, &[ParticleKind::Particles]).expect("particles").particles;
    assert!(particles(&unbroken) == particles(&resumed), "the resumed run differs");
    // A run resumed from the checkpoint of the last pass executes only the final steps. It must
    // also give the same particles.
    let last = folder.path().join("last.bin").to_string_lossy().into_owned();
    let (ended, _) = run("whole.bin", "20", &["--checkpoint", &last]);
    ended.expect_success("the run with checkpoints");
    let (ended, resumed) = run("ended.bin", "20", &["--checkpoint", &last, "--resume"]);
    ended.expect_success("the run resumed at its end");
    assert!(particles(&unbroken) == particles(&resumed), "the run resumed at its end differs");
}
