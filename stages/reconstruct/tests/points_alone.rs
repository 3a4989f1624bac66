//! Tests reconstruction from points alone (`--method tight-cocone` without fields): the files,
//! reports and exit codes of the program.

use glam::DVec3;
use isoparticles_field::particle_set::ParticleSet;
use isoparticles_mesh::shapes::{icosphere, torus};
use isoparticles_mesh::surface::read_surface;
use isoparticles_reconstruct::check::{CheckOptions, check_object};
use isoparticles_stage::history::History;
use isoparticles_stage::particle_file::{ParticleFile, ParticleKind};
use isoparticles_volume::{Geometry, Space};
use serde_json::{Value, json};
use std::path::{Path, PathBuf};
use std::process::Command;

struct Folder(tempfile::TempDir);

impl Folder {
    fn new() -> Self {
        Self(tempfile::tempdir().unwrap())
    }

    fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    /// Runs the program in the folder; returns the exit code, stderr and the report.
    fn run(&self, words: &[&str]) -> (i32, String, Value) {
        let output = Command::new(env!("CARGO_BIN_EXE_reconstruct"))
            .args(words)
            .args(["--report", "report.json", "--progress", "none"])
            .current_dir(self.0.path())
            .output()
            .unwrap();
        let report = std::fs::read(self.path("report.json")).ok().and_then(|bytes| serde_json::from_slice(&bytes).ok());
        let said = String::from_utf8_lossy(&output.stderr).into_owned();
        (output.status.code().unwrap(), said, report.unwrap_or(Value::Null))
    }
}

/// Asserts that a surface passes all checks; returns the number of its components and its Euler
/// characteristic.
fn sound(path: &Path) -> (usize, i64) {
    let report = check_object(&read_surface(path).unwrap().surface.mesh, &CheckOptions::default());
    assert!(report.failed.is_empty(), "{:?}", report.failed);
    (report.object().components.len(), report.object().euler)
}

fn lines(points: &[DVec3]) -> String {
    points.iter().map(|p| format!("{} {} {}\n", p.x, p.y, p.z)).collect()
}

#[test]
fn a_text_cloud_becomes_a_watertight_surface() {
    let folder = Folder::new();
    let points = torus(9.0, 3.0, 60, 22).vertices;
    std::fs::write(folder.path("cloud.xyz"), lines(&points)).unwrap();
    let (code, said, report) = folder.run(&["cloud.xyz", "--method", "tight-cocone", "-o", "s.vtp"]);
    assert_eq!(code, 0, "{said}");
    assert_eq!(sound(&folder.path("s.vtp")), (1, 0));
    let results = &report["results"];
    assert_eq!(results["cocone"]["points"], points.len());
    assert_eq!(results["cocone"]["unused"], 0);
    assert_eq!(results["check"]["open_edges"], 0);
    for key in ["improve", "refine", "topology"] {
        assert!(results[key].as_str().unwrap().starts_with("skipped"), "{key}: {}", results[key]);
    }
    // Without --force, the program must not replace an existing output. With --min-radius-ratio 1,
    // the check of the radius ratio must fail.
    assert_eq!(folder.run(&["cloud.xyz", "--method", "tight-cocone", "-o", "s.vtp"]).0, 2);
    let strict = ["cloud.xyz", "--method", "tight-cocone", "-o", "s.vtp", "--force", "--min-radius-ratio", "1"];
    let (code, said, _) = folder.run(&strict);
    assert!(code == 1 && said.contains("radius ratio"), "{said}");
    assert!(folder.path("s.offending.vtp").exists());
}

#[test]
fn a_written_surface_is_a_cloud_again() {
    let folder = Folder::new();
    let ball = |centre: f64| icosphere(3.0, 3).vertices.into_iter().map(move |p| p + DVec3::new(centre, 1e4, 0.0));
    let points: Vec<DVec3> = ball(0.0).chain(ball(7.0)).collect();
    std::fs::write(folder.path("cloud.xyz"), lines(&points)).unwrap();
    for (input, output) in [("cloud.xyz", "a.vtp"), ("a.vtp", "b.ply"), ("b.ply", "c.vtp")] {
        let (code, said, _) = folder.run(&[input, "--method", "tight-cocone", "-o", output]);
        assert_eq!(code, 0, "{input}: {said}");
    }
    assert_eq!((sound(&folder.path("a.vtp")), sound(&folder.path("c.vtp"))), ((2, 4), (2, 4)));
}

#[test]
fn particles_need_no_field_and_come_out_in_the_world() {
    let folder = Folder::new();
    let mut geometry = Geometry::axis_aligned([30; 3], DVec3::ONE);
    geometry.directions.x_axis = DVec3::NEG_X;
    geometry.origin = DVec3::new(100.0, 0.0, 0.0);
    geometry.space = Space::Lps;
    let normals = icosphere(1.0, 3).vertices;
    let count = normals.len();
    let set = ParticleSet {
        geometry,
        positions: normals.iter().map(|n| 15.0 + 10.0 * *n).collect(),
        normals,
        sizes: vec![1.5; count],
        energies: vec![0.0; count],
        lambdas: vec![0.1; count],
    };
    let history = History {
        tool: "particles".into(),
        version: "0".into(),
        command_line: "particles".into(),
        parameters: json!({ "file_space": "ras" }),
        inputs: vec![],
    };
    let (kind, meta, extra) = (ParticleKind::Particles, Value::Null, Vec::new());
    let file = ParticleFile { kind, particles: set, strata: None, meta, history, extra };
    file.write(&folder.path("p.bin")).unwrap();
    let (code, said, report) = folder.run(&["p.bin", "--method", "tight-cocone", "-o", "s.vtp"]);
    assert_eq!(code, 0, "{said}");
    assert_eq!(sound(&folder.path("s.vtp")), (1, 2));
    assert_eq!(report["results"]["cocone"]["normals_oriented"], true);
    let surface = read_surface(&folder.path("s.vtp")).unwrap();
    assert_eq!(surface.surface.space, Space::Lps);
    assert!(surface.surface.mesh.vertices.iter().all(|p| (p.x - 85.0).abs() < 10.01));
    assert_eq!(surface.history.unwrap().inputs[0].history.as_ref().unwrap().tool, "particles");
    // The surface can be read as a point cloud. The result must have the same world frame.
    assert_eq!(folder.run(&["s.vtp", "--method", "tight-cocone", "-o", "again.vtp"]).0, 0);
    let again = read_surface(&folder.path("again.vtp")).unwrap();
    assert_eq!(again.surface.space, Space::Lps);
    assert_eq!(again.history.unwrap().inputs[0].history.as_ref().unwrap().tool, "reconstruct");
    // In the frame of the volume's file, the signs of x and y differ.
    for (input, like) in [("p.bin", &surface.surface), ("s.vtp", &again.surface)] {
        let words = [input, "--method", "tight-cocone", "--space", "scanner", "-o", "ras.vtp", "--force"];
        let (code, said, report) = folder.run(&words);
        assert_eq!((code, &report["parameters"]["space"]), (0, &json!("ras")), "{said}");
        let ras = read_surface(&folder.path("ras.vtp")).unwrap().surface;
        assert_eq!(ras.space, Space::Ras);
        let turned = like.mesh.vertices.iter().map(|p| DVec3::new(-p.x, -p.y, p.z));
        assert!(ras.mesh.vertices.iter().copied().eq(turned) && ras.mesh.triangles == like.mesh.triangles);
    }
}

#[test]
fn an_input_named_as_the_offending_simplices_is_kept() {
    let folder = Folder::new();
    // Some programs write a byte order mark.
    let text = format!("\u{feff}{}", lines(&icosphere(3.0, 3).vertices));
    std::fs::write(folder.path("cloud.xyz"), text).unwrap();
    let (code, said, _) = folder.run(&["cloud.xyz", "--method", "tight-cocone", "-o", "s.offending.vtp"]);
    assert_eq!(code, 0, "{said}");
    let (code, said, _) = folder.run(&["s.offending.vtp", "--method", "tight-cocone", "-o", "s.vtp"]);
    assert!(code == 2 && said.contains("offending simplices"), "{said}");
    assert!(folder.path("s.offending.vtp").exists() && !folder.path("s.vtp").exists());
}

#[test]
fn bad_input_and_usage_are_refused_with_code_2() {
    let folder = Folder::new();
    std::fs::write(folder.path("cloud.xyz"), lines(&icosphere(3.0, 2).vertices)).unwrap();
    std::fs::write(folder.path("words.xyz"), "1 2 3\nfour five six\n").unwrap();
    std::fs::write(folder.path("empty.ply"), "").unwrap();
    std::fs::write(folder.path("p.bin"), "no particles").unwrap();
    std::fs::write(folder.path("f.vti"), "no field").unwrap();
    std::fs::write(folder.path("flat.xyz"), "0 0 0\n1 0 0\n0 1 0\n1 1 0\n2 2 0\n").unwrap();
    std::fs::write(folder.path("few.xyz"), "0 0 0\n1 0 0\n0 1 0\n0 0 1\n1 1 1\n").unwrap();
    for (words, says) in [
        (&["words.xyz", "--method", "tight-cocone"][..], "line 2: 'four'"),
        (&["empty.ply", "--method", "tight-cocone"], "not a PLY file"),
        (&["absent.vtp", "--method", "tight-cocone"], "absent.vtp"),
        (&["p.bin", "--method", "tight-cocone"], "p.bin"),
        (&["flat.xyz", "--method", "tight-cocone"], "one plane"),
        (&["few.xyz", "--method", "tight-cocone"], "do not enclose a solid"),
        (&["cloud.xyz"], "--distfield"),
        (&["p.bin"], "--distfield"),
        (&["cloud.xyz", "--method", "tight-cocone", "--distfield", "f.vti"], "point cloud"),
        (&["cloud.xyz", "--method", "poisson"], "tight-cocone"),
        (&["p.bin", "--method", "tight-cocone", "--sizefield", "f.vti"], "--distfield"),
    ] {
        let (code, said, _) = folder.run(&[words, &["-o", "s.vtp"]].concat());
        assert!(code == 2 && said.contains(says), "{words:?}: {code} {said}");
        assert!(!folder.path("s.vtp").exists());
    }
}
