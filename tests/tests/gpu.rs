//! Tests the GPU backend of `particles` on the first adapter, which may be Mesa's lavapipe. The
//! mesh must be as good as with the CPU backend, repeated and resumed runs must give the same
//! particles, and a missing adapter must give exit code 3.

mod support;

use glam::DVec3;
use isoparticles_field::particle_set::ParticleSet;
use isoparticles_mesh::surface::read_surface;
use isoparticles_stage::particle_file::{ParticleKind, read_particles};
use isoparticles_tests::scene::Shape;
use isoparticles_volume::Geometry;
use std::ffi::OsString;
use std::path::Path;
use support::chain::{self, Files, Wishes};
use support::{Kind, examine, listing, skip, stage, write_phantom};

/// Returns the name of the first adapter. If there is no adapter, records a skip and returns
/// `None`.
fn adapter(test: &str) -> Option<String> {
    let ended = stage("particles", ["--list-adapters"]).expect_success("--list-adapters");
    let name = ended.stdout.lines().find_map(|line| line.split_once(" (").map(|(name, _)| name.to_owned()));
    if name.is_none() {
        skip(test, "no Vulkan, Metal or DX12 adapter");
    }
    name
}

/// Meshes a small bumpy torus with target edge length `h` (mm). The particles settle on the CPU.
fn torus(folder: &Path, h: f64) -> Files {
    let volume = folder.join("torus.nrrd");
    write_phantom(&volume, Shape::BumpyTorus, &Geometry::axis_aligned([36; 3], DVec3::ONE), Kind::Scalar);
    let wishes = Wishes { particles: arguments!["--backend", "cpu"], ..Wishes::scalar(Some(h)) };
    chain::surface(&volume, folder, &wishes)
}

/// Settles the seeds of a case on an adapter.
fn settle(files: &Files, adapter: &str, output: &Path, more: &[&str]) -> ParticleSet {
    let mut command =
        arguments![&files.seeds, "--distfield", &files.distfield, "--sizefield", &files.sizefield, "-o", output];
    command.extend(arguments!["--backend", "gpu", "--adapter", adapter]);
    command.extend(more.iter().map(OsString::from));
    stage("particles", command).expect_success("particles on the GPU");
    read_particles(output, &[ParticleKind::Particles]).expect("particles").particles
}

#[test]
fn the_mesh_is_as_good_as_that_of_the_cpu() {
    let Some(adapter) = adapter("the mesh from the GPU's particles") else { return };
    let folder = tempfile::tempdir().expect("folder");
    // h = 0.9 mm gives 2,400 particles. With only 600 particles, a difference of 1 % would be
    // within the random variation.
    let files = torus(folder.path(), 0.9);
    let report = folder.path().join("particles.json");
    let output = folder.path().join("gpu.bin");
    // Three levels are the default of the CPU backend. On such a small surface, a single level
    // gives 2 % more particles.
    let found = settle(&files, &adapter, &output, &["--levels", "3", "--report", &report.to_string_lossy()]);
    let on_cpu = read_particles(&files.particles, &[ParticleKind::Particles]).expect("particles").particles;
    let ratio = found.positions.len() as f64 / on_cpu.positions.len() as f64;
    assert!((ratio - 1.0).abs() < 0.01, "{} particles, {} on the CPU", found.positions.len(), on_cpu.positions.len());
    let surface = folder.path().join("gpu.vtp");
    let command = arguments![&output, "--distfield", &files.distfield, "--sizefield", &files.sizefield, "-o", &surface];
    stage("reconstruct", command).expect_success("reconstruct");
    let examined = |path: &Path| {
        let mesh = read_surface(path).expect("surface").surface.mesh;
        examine::examine(&mesh.vertices, &mesh.triangles)
    };
    let (gpu, cpu) = (examined(&surface), examined(&files.surface));
    assert_eq!((gpu.bad_edges, gpu.components, gpu.genus), (0, cpu.components, cpu.genus));
    assert!((gpu.mean_radius_ratio - cpu.mean_radius_ratio).abs() < 0.005, "{gpu:?}\n{cpu:?}");
    let text = std::fs::read_to_string(report).unwrap();
    assert!(text.contains("\"device_seconds\"") && text.contains("\"peak_device_bytes\""), "{text}");
}

#[test]
fn runs_repeat_and_resume_to_the_same_particles() {
    let Some(adapter) = adapter("repeated and resumed runs on the GPU") else { return };
    let folder = tempfile::tempdir().expect("folder");
    let files = torus(folder.path(), 1.8);
    let passes = ["--energy-tolerance", "0", "--levels", "2", "--coarse-passes", "15", "--max-passes", "17"];
    let whole = settle(&files, &adapter, &folder.path().join("whole.bin"), &passes);
    assert!(whole == settle(&files, &adapter, &folder.path().join("again.bin"), &passes), "two runs differ");
    // The first run leaves the checkpoint of pass 30, which belongs to the second level. The second
    // run resumes from it.
    let checkpoint = folder.path().join("checkpoint.bin");
    let mut more = passes.to_vec();
    let name = checkpoint.to_string_lossy().into_owned();
    more.extend(["--checkpoint", &name, "--resume"]);
    for output in ["first.bin", "second.bin"] {
        assert!(whole == settle(&files, &adapter, &folder.path().join(output), &more), "{output} differs");
    }
}

#[test]
fn an_adapter_that_is_not_there_ends_with_three() {
    let folder = tempfile::tempdir().expect("folder");
    let files = torus(folder.path(), 1.8);
    let before = listing(folder.path());
    let output = folder.path().join("out.bin");
    let mut command = arguments![&files.seeds, "--distfield", &files.distfield, "--sizefield", &files.sizefield];
    command.extend(arguments!["-o", &output, "--backend", "gpu", "--adapter", "no such adapter"]);
    stage("particles", command).expect_error(3, &["--adapter no such adapter", "--backend cpu"]);
    assert_eq!(listing(folder.path()), before);
}

/// Without a display, Mesa's device-selection layer prints a warning. The user must not see it.
#[test]
#[cfg(target_os = "linux")]
fn nothing_is_said_of_a_display_that_nobody_needs() {
    let Some(_) = adapter("adapters without a display") else { return };
    let mut command = std::process::Command::new(support::binaries().join("particles"));
    command.args(["--list-adapters", "--quiet"]);
    for variable in ["XDG_RUNTIME_DIR", "WAYLAND_DISPLAY", "NODEVICE_SELECT", "MESA_VK_DEVICE_SELECT"] {
        command.env_remove(variable);
    }
    let ended = support::run(&mut command).expect_success("--list-adapters");
    assert!(!ended.stdout.is_empty());
    assert_eq!(ended.stderr, "");
}
