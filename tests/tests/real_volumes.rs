//! Meshes real volumes, if they are available (in `../shared/data` relative to the repository's
//! root, or in `ISOPARTICLES_DATA`). Tests that the surface is closed and oriented outward, and has
//! the right components and good triangles.

mod support;

use isoparticles_mesh::surface::read_surface;
use std::path::Path;
use support::examine::examine;
use support::{binaries, real_volumes, root, run};

/// Meshes a case of `pipelines/` with make and examines the surface.
fn mesh(test: &str, case: &str, components: Option<usize>) {
    let Some(data) = real_volumes(test) else { return };
    let folder = tempfile::tempdir().expect("folder");
    let mut command = std::process::Command::new("make");
    command.current_dir(root()).args(["surface", "NO_BUILD=yes", "VERBOSITY=-q"]);
    for (key, value) in [("CASE", Path::new(case)), ("DATA", &data), ("OUT", folder.path()), ("BIN", binaries())] {
        command.arg(format!("{key}={}", value.display()));
    }
    for variable in ["MAKEFLAGS", "MFLAGS", "MAKELEVEL", "MAKEOVERRIDES"] {
        command.env_remove(variable);
    }
    run(&mut command).expect_success(case);
    let path = folder.path().join(case).join(format!("{case}.surface.vtp"));
    let surface = read_surface(&path).expect("surface").surface.mesh;
    let examined = examine(&surface.vertices, &surface.triangles);
    assert_eq!(examined.bad_edges, 0, "{case}: {examined:?}");
    assert!(examined.volume > 0.0, "{case}: {examined:?}");
    assert!(examined.mean_radius_ratio >= 0.95, "{case}: {examined:?}");
    assert!(examined.smallest_radius_ratio >= 0.30, "{case}: {examined:?}");
    if let Some(components) = components {
        assert_eq!(examined.components, components, "{case}: {examined:?}");
    }
}

#[test]
fn mickey() {
    // The object is a hollow ball, which has an outer and an inner surface.
    mesh("mickey", "mickey", Some(2));
}

#[test]
fn heart() {
    // The components are the surfaces of the object and of two cavities of eight voxels each. The
    // cavities touch the background only along voxel edges, where the object counts as connected.
    mesh("heart", "heart", Some(3));
}

#[test]
fn tooth() {
    mesh("tooth", "tooth", None);
}

#[test]
fn lungs() {
    mesh("lungs", "lungs", None);
}

#[test]
fn ribs() {
    mesh("ribs", "ribs", None);
}
