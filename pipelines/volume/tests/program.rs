//! Tests the program on small volumes: the output of `info` and of `convert`.

use glam::{DMat3, DVec3};
use isoparticles_volume::nrrd::{Encoding, write_nrrd};
use isoparticles_volume::{Geometry, Space, Voxels, read_volume};
use serde_json::{Value, json};
use std::f64::consts::PI;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

fn program(folder: &Path, words: &[&str]) -> Output {
    let run = Command::new(env!("CARGO_BIN_EXE_isoparticles-volume")).current_dir(folder).args(words).output();
    run.expect("the program runs")
}

/// A temporary folder that contains the volume `v.nrrd`.
struct Case(tempfile::TempDir);

impl Case {
    fn new(geometry: &Geometry, voxels: &Voxels) -> Self {
        let folder = tempfile::tempdir().expect("folder");
        write_nrrd(&folder.path().join("v.nrrd"), geometry, voxels, Encoding::Gzip).expect("written");
        Self(folder)
    }

    /// Creates a case whose voxels are `value(distance, index)`, where `distance` is the distance
    /// of the voxel from the centre in mm, and `index` is its linear index.
    fn of(value: impl Fn(f64, usize) -> f32) -> Self {
        let mut geometry = Geometry::axis_aligned([36, 34, 18], DVec3::new(1.0, 1.0, 2.0));
        geometry.space = Space::Lps;
        let centre = DVec3::new(17.5, 16.5, 17.0);
        let at = |n: usize| DVec3::new((n % 36) as f64, (n / 36 % 34) as f64, 2.0 * (n / (36 * 34)) as f64);
        let values = (0..geometry.voxel_count()).map(|n| value(at(n).distance(centre), n)).collect();
        Self::new(&geometry, &Voxels::F32(values))
    }

    /// Creates a scan: a ball with a radius of 12 mm at iso value 100, with a blurred edge and
    /// noise.
    fn scan() -> Self {
        Self::of(|radius, n| {
            let noise = ((n * 7919) % 31) as f64 - 15.0;
            (200.0 / (1.0 + ((radius - 12.0) / 0.9).exp()) + noise).trunc() as f32
        })
    }

    /// Creates a label map: a ball of label 3 inside a shell of label 2, and a single voxel of
    /// label 9. All other voxels have the value `background`.
    fn labels(background: f32) -> Self {
        Self::of(|radius, n| match radius {
            _ if n == 0 => 9.0,
            r if r < 8.0 => 3.0,
            r if r < 12.0 => 2.0,
            _ => background,
        })
    }

    fn run(&self, words: &[&str]) -> Output {
        program(self.0.path(), words)
    }

    fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    fn info(&self, options: &[&str]) -> Value {
        let run = self.run(&[&["info", "v.nrrd", "--json", "-", "-q"][..], options].concat());
        assert_eq!(run.status.code(), Some(0), "{}", String::from_utf8_lossy(&run.stderr));
        serde_json::from_slice(&run.stdout).expect("JSON on stdout")
    }
}

fn assert_near(found: &Value, due: f64, tolerance: f64) {
    let found = found.as_f64().expect("a number");
    assert!((found / due - 1.0).abs() < tolerance, "{found}, due {due}");
}

#[test]
fn info_describes_a_label_map() {
    let case = Case::labels(0.0);
    let info = case.info(&[]);
    assert_eq!((&info["kind"], &info["certain"]), (&json!("labels"), &json!(true)));
    assert_eq!(info["orientation"]["letters"], "LPS");
    assert_eq!(info["spacing"], json!([1.0, 1.0, 2.0]));
    let table = info["labels"].as_array().expect("labels");
    assert_eq!(table.iter().map(|label| label["label"].as_i64()).collect::<Vec<_>>(), [Some(2), Some(3), Some(9)]);
    assert_near(&table[1]["volume"], 4.0 / 3.0 * PI * 512.0, 0.05);
    assert_eq!(table[2]["parts"], json!({ "count": 1, "largest": 1 }));
    let bounds =
        |label: &Value| [0, 1, 2].map(|a| label["bounds"]["high"][a].as_f64() > label["bounds"]["low"][a].as_f64());
    assert!(table.iter().all(|label| bounds(label) == [true; 3]), "{table:?}");
}

#[test]
fn info_predicts_the_cost_of_the_given_object() {
    let case = Case::labels(0.0);
    assert_near(&case.info(&["--labels", "3"])["objects"][0]["cost"]["area"], 4.0 * PI * 64.0, 0.1);
    assert_eq!(case.info(&["--labels", "2..5"])["objects"][0]["options"], "LABELS=2,3");
    let absent = case.run(&["info", "v.nrrd", "--labels", "7"]);
    assert_eq!(absent.status.code(), Some(2));
    assert!(String::from_utf8_lossy(&absent.stderr).contains("no voxel has the label 7"));
}

#[test]
fn info_prints_text_and_writes_the_same_as_json() {
    let case = Case::labels(0.0);
    let run = case.run(&["info", "v.nrrd", "--json", "info.json"]);
    let text = String::from_utf8_lossy(&run.stdout);
    for part in [
        "36 x 34 x 18",
        "x right to left",
        "kind         labels",
        "LABELS=all",
        "right-handed",
        "vertices",
        "; centre (",
    ] {
        assert!(text.contains(part), "'{part}' is missing: {text}");
    }
    let file: Value = serde_json::from_slice(&std::fs::read(case.path("info.json")).expect("a file")).expect("JSON");
    assert_eq!(file, case.info(&[]));
    let again = case.run(&["info", "v.nrrd", "--json", "info.json"]);
    assert_eq!(again.status.code(), Some(2), "replaced without --force");
}

#[test]
fn info_proposes_iso_values_of_a_scan() {
    let info = Case::scan().info(&[]);
    assert_eq!(info["kind"], "scan");
    let objects = info["objects"].as_array().expect("objects").iter();
    let isos = objects.map(|object| object["options"].as_str().expect("text").trim_start_matches("ISO=").parse());
    let isos: Vec<f64> = isos.collect::<Result<_, _>>().expect("numbers");
    assert!(isos.iter().any(|iso| (60.0..140.0).contains(iso)), "{isos:?}");
    assert!(info["labels"].as_array().is_some_and(Vec::is_empty));
    let cost = &info["objects"][0]["cost"];
    assert!(cost["vertices"].as_u64() > Some(500) && cost["stages"].as_array().is_some_and(|s| s.len() == 4), "{cost}");
}

#[test]
fn nan_among_labels_is_remarked() {
    let info = Case::labels(f32::NAN).info(&[]);
    assert_eq!((&info["kind"], &info["certain"]), (&json!("labels"), &json!(true)));
    assert!(info["remarks"].to_string().contains("NaN"), "{info}");
}

#[test]
fn info_measures_sheared_volumes_in_the_world() {
    // The slices are 1 mm apart. Each is shifted along y relative to the previous one, as in a scan
    // with a gantry tilt of 30 degrees.
    let step = DVec3::new(0.0, 30f64.to_radians().tan(), 1.0);
    let geometry = Geometry {
        spacing: DVec3::new(1.0, 1.0, step.length()),
        directions: DMat3::from_cols(DVec3::X, DVec3::Y, step.normalize()),
        ..Geometry::axis_aligned([40; 3], DVec3::ONE)
    };
    let index = |n: usize| DVec3::new((n % 40) as f64, (n / 40 % 40) as f64, (n / 1600) as f64);
    let ball = (0..64_000).map(|n| u8::from(index(n).distance(DVec3::splat(19.5)) <= 14.0)).collect();
    let info = Case::new(&geometry, &Voxels::U8(ball)).info(&["--labels", "1"]);
    assert_near(&info["objects"][0]["volume"], 11_536.0, 1e-9);
    assert_near(&info["labels"][0]["volume"], 11_536.0, 1e-9);
    assert_near(&info["objects"][0]["cost"]["area"], 2565.0, 0.02);
}

#[test]
fn convert_keeps_voxels_and_geometry() {
    let case = Case::labels(0.0);
    assert_eq!(case.run(&["convert", "v.nrrd", "-o", "w.vti"]).status.code(), Some(0));
    let volumes = ["v.nrrd", "w.vti"].map(|name| read_volume(&case.path(name)).expect("a volume"));
    assert_eq!((&volumes[0].geometry, &volumes[0].voxels), (&volumes[1].geometry, &volumes[1].voxels));
    assert_eq!(case.run(&["convert", "v.nrrd", "-o", "w.vti"]).status.code(), Some(2), "replaced without --force");
    assert_eq!(case.run(&["convert", "v.nrrd", "-o", "x.vti", "--series", "lung"]).status.code(), Some(2));
    assert!(!case.path("x.vti").exists());
}
