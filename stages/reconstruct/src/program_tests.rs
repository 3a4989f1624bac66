//! Runs the whole program on files.

use crate::run::{Args, run};
use crate::scenes::{self, Scene};
use clap::Parser;
use glam::{DMat3, DVec2, DVec3};
use isoparticles_field::particle_set::ParticleSet;
use isoparticles_mesh::measure::measure;
use isoparticles_mesh::surface::{DataArray, SurfaceFile, read_surface};
use isoparticles_mesh::topology::analyse;
use isoparticles_stage::cli::{Context, Outcome};
use isoparticles_stage::field_file::{Field, FieldKind};
use isoparticles_stage::history::History;
use isoparticles_stage::particle_file::{ParticleFile, ParticleKind};
use isoparticles_volume::{Geometry, Space, Voxels};
use serde_json::{Value, json};
use std::f64::consts::TAU;
use std::path::PathBuf;

struct Case {
    folder: tempfile::TempDir,
}

impl Case {
    /// Writes the two input files of a scene. `geometry` places them in the world.
    fn new(scene: &Scene, geometry: Geometry, spacing: f64, meta: &Value) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let case = Self { folder };
        let history = |tool: &str| History {
            tool: tool.into(),
            version: "0".into(),
            command_line: tool.into(),
            parameters: json!({}),
            inputs: vec![],
        };
        let mut image = scene.image.clone();
        image.geometry = geometry.clone();
        let (meta, kind) = (meta.clone(), FieldKind::Distance);
        Field { image: image.into(), meta, history: Some(history("distfield")), kind }
            .write(&case.path("f.vti"))
            .unwrap();
        let positions = scene.points(spacing);
        let count = positions.len();
        let particles = ParticleSet {
            geometry,
            normals: positions.iter().map(|&p| scene.gradient(p).normalize()).collect(),
            positions,
            sizes: vec![1.25 * spacing; count],
            energies: vec![0.0; count],
            lambdas: vec![0.1; count],
        };
        let (kind, history) = (ParticleKind::Particles, history("particles"));
        let file = ParticleFile { kind, particles, strata: None, meta: Value::Null, history, extra: Vec::new() };
        file.write(&case.path("p.bin")).unwrap();
        case
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    fn run(&self, output: &str, more: &[&str]) -> isoparticles_stage::error::Result<Outcome> {
        let files = ["reconstruct", "p.bin", "--distfield", "f.vti", "-o", output];
        let files =
            files.map(|word| if word.contains('.') { self.path(word).display().to_string() } else { word.into() });
        let args = Args::try_parse_from(files.into_iter().chain(more.iter().map(|w| (*w).to_owned()))).unwrap();
        run(&args, &Context::silent("reconstruct"))
    }

    fn surface(&self, output: &str) -> SurfaceFile {
        read_surface(&self.path(output)).unwrap()
    }
}

fn numbers<'a>(arrays: &'a [DataArray], name: &str) -> &'a [f64] {
    match arrays.iter().find(|a| a.name == name).map(|a| &a.values) {
        Some(Voxels::F64(values)) => values,
        other => panic!("{name}: {other:?}"),
    }
}

#[test]
fn surface_in_an_oblique_left_handed_frame_faces_outward() {
    let scene = scenes::torus();
    let mut geometry = scene.image.geometry.clone();
    geometry.directions = DMat3::from_axis_angle(DVec3::new(1.0, 2.0, 3.0).normalize(), 0.7)
        * DMat3::from_diagonal(DVec3::new(1.0, -1.0, 1.0));
    geometry.origin = DVec3::new(-120.0, 45.0, 300.0);
    geometry.space = Space::Lps;
    let case = Case::new(&scene, geometry.clone(), 0.8, &json!({"source": "scalar", "border": "cap"}));
    assert_eq!(case.run("torus.vtp", &[]).unwrap(), Outcome::Passed);
    let file = case.surface("torus.vtp");
    let surface = &file.surface;
    // 2 pi^2 R r^2 and 4 pi^2 R r; points at a spacing of 0.8 lose 1.2 % of the volume and 0.3 % of
    // the area
    let measured = measure(&surface.mesh);
    assert!((measured.volume / 2842.4 - 1.0).abs() < 0.015, "{measured:?}");
    assert!((measured.area / 1421.2 - 1.0).abs() < 0.005, "{measured:?}");
    let normals = numbers(&surface.point_data, "normal");
    for (n, &p) in normals.chunks(3).zip(&surface.mesh.vertices) {
        let grid = geometry.world_to_grid(p);
        let (value, gradient) = scene.field.value_gradient(grid);
        assert!(value.abs() < 1e-4 * gradient.length(), "{p} is off by {value}");
        assert!(DVec3::from_slice(n).dot(geometry.directions * gradient) > 0.99 * gradient.length());
    }
    assert!(numbers(&surface.cell_data, "radius_ratio").iter().all(|&q| q >= 0.3));
    assert_eq!(file.history.unwrap().inputs.len(), 2);
    assert!(!case.path("torus.offending.vtp").exists());
    for other in ["t.ply", "t.stl", "t.obj", "t.vtk"] {
        assert_eq!(case.run(other, &[]).unwrap(), Outcome::Passed);
        assert!(case.path(other).metadata().unwrap().len() > 1000);
    }
    case.run("again.vtp", &["--threads", "1"]).unwrap();
    let bytes = |name: &str| case.surface(name).surface;
    assert_eq!(bytes("again.vtp"), bytes("torus.vtp"));
}

#[test]
fn sparse_particles_on_a_thin_wall_still_pass() {
    let scene = scenes::shell();
    let case = Case::new(&scene, scene.image.geometry.clone(), 2.2, &Value::Null);
    assert_eq!(case.run("shell.vtp", &["--min-radius-ratio", "0.1"]).unwrap(), Outcome::Passed);
    let Voxels::I64(components) = &case.surface("shell.vtp").surface.point_data[4].values else { panic!("integers") };
    assert_eq!(components.iter().max(), Some(&1));
}

#[test]
fn no_node_of_a_label_volume_changes_side() {
    let scene = scenes::gyroid();
    let meta = json!({"source": "labels", "border": "cap"});
    let case = Case::new(&scene, scene.image.geometry.clone(), 1.5, &meta);
    assert_eq!(case.run("g.vtp", &["--min-radius-ratio", "0"]).unwrap(), Outcome::Passed);
}

#[test]
fn the_surface_is_open_only_at_an_open_border() {
    // a cylinder of radius 6 through the whole volume along z
    let scene = Scene::new([24, 24, 20], DVec3::ONE, |p| (p.truncate() - DVec2::splat(11.6)).length() - 6.0);
    let case = Case::new(&scene, scene.image.geometry.clone(), 1.0, &json!({"source": "scalar", "border": "open"}));
    for (method, name) in [("restricted", "tube.vtp"), ("tight-cocone", "cocone.vtp")] {
        assert_eq!(case.run(name, &["--method", method]).unwrap(), Outcome::Passed);
        let file = case.surface(name);
        let mesh = file.surface.mesh;
        let topology = analyse(&mesh);
        assert_eq!((topology.components.len(), topology.euler), (1, 0), "{method}: a tube");
        let ends = |v: u32| mesh.vertices[v as usize].z.min(19.0 - mesh.vertices[v as usize].z);
        assert!(!topology.open_edges.is_empty() && topology.open_edges.iter().flatten().all(|&v| ends(v) < 1.5));
        // 2 pi r times the length that the particles cover
        let area = measure(&mesh).area;
        assert!((area / (TAU * 6.0 * 18.0) - 1.0).abs() < 0.06, "{method}: {area}");
        // the facets that close the tube at the border of the volume are not refined
        let added = file.meta["refine"]["inserted"].as_object().expect("points by what asked for them");
        assert!(added.values().filter_map(|n| n.as_u64()).sum::<u64>() < 40, "{method}: {added:?} points added");
    }
}

#[test]
fn tight_cocone_with_a_field_is_improved_and_checked() {
    let scene = scenes::torus();
    let meta = json!({"source": "scalar", "border": "cap"});
    let case = Case::new(&scene, scene.image.geometry.clone(), 0.9, &meta);
    let raw =
        ["--method", "tight-cocone", "--relaxation-sweeps", "0", "--improve-below", "0", "--min-radius-ratio", "0"];
    assert_eq!(case.run("raw.vtp", &raw).unwrap(), Outcome::Passed);
    assert_eq!(case.run("full.vtp", &raw[..2]).unwrap(), Outcome::Passed);
    let [raw, full] = ["raw.vtp", "full.vtp"].map(|name| case.surface(name).surface.mesh);
    assert_eq!((analyse(&raw).euler, analyse(&full).euler), (0, 0));
    let mean = |mesh| isoparticles_mesh::quality::summarise(mesh).radius_ratio_mean;
    assert!(mean(&full) > mean(&raw) + 0.01);
}

#[test]
fn a_failed_check_writes_the_mesh_and_the_offenders() {
    let scene = scenes::sphere();
    let case = Case::new(&scene, scene.image.geometry.clone(), 2.0, &Value::Null);
    let outcome =
        case.run("s.vtp", &["--min-radius-ratio", "1", "--improve-below", "0", "--relaxation-sweeps", "0"]).unwrap();
    let Outcome::ChecksFailed(failed) = outcome else { panic!("passed") };
    assert!(failed.len() == 1 && failed[0].contains("radius ratio"), "{failed:?}");
    assert!(case.path("s.vtp").exists() && case.path("s.offending.vtp").exists());
    assert_eq!(case.run("s.vtp", &["--min-radius-ratio", "0.05"]).unwrap(), Outcome::Passed);
    assert!(!case.path("s.offending.vtp").exists(), "the list of an earlier run is taken away");
}

#[test]
fn wrong_input_is_rejected_without_output() {
    let scene = scenes::sphere();
    let case = Case::new(&scene, scene.image.geometry.clone(), 2.0, &Value::Null);
    let refused = |output: &str, says: &str| {
        let error = case.run(output, &[]).unwrap_err();
        assert!(error.what.contains(says), "{}", error.what);
        assert!(!case.path(output).exists());
    };
    refused("s.xyz", "extension");
    std::fs::copy(case.path("f.vti"), case.path("kept.vti")).unwrap();
    std::fs::copy(case.path("p.bin"), case.path("f.vti")).unwrap();
    refused("s.vtp", "f.vti");
    // a field on a different grid
    let other = Case::new(&scenes::gyroid(), scenes::gyroid().image.geometry, 3.0, &Value::Null);
    std::fs::copy(other.path("f.vti"), case.path("f.vti")).unwrap();
    refused("s.vtp", "vti");
    std::fs::copy(case.path("kept.vti"), case.path("f.vti")).unwrap();
    std::fs::write(case.path("p.bin"), b"not particles").unwrap();
    refused("s.vtp", "p.bin");
    for wrong in [["--max-deviation", "-1"], ["--improve-below", "2"], ["--max-rounds", "1000"]] {
        let words = [&["reconstruct", "p", "--distfield", "f", "-o", "o.vtp"][..], &wrong[..]].concat();
        assert!(Args::try_parse_from(words).is_err());
    }
}
