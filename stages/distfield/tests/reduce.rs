//! Tests `--crop` and `--downsample`: the result equals that of a volume that was cropped or
//! downsampled beforehand, and the report gives the effect on the object.

use glam::{DMat3, DQuat, DVec3};
use isoparticles_stage::field_file::{Field, FieldKind, read_field};
use isoparticles_volume::nrrd::{Encoding, write_nrrd};
use isoparticles_volume::{Geometry, Pooling, Space, Volume, Voxels, read_volume};
use serde_json::{Value, json};
use std::path::PathBuf;
use std::process::{Command, Output};

struct Case {
    folder: tempfile::TempDir,
}

impl Case {
    /// Writes `scan.nrrd`, a blurred ball of radius 9 mm, and `labels.nrrd`, the ball as label 3
    /// with a plate of label 5, one voxel thick, above it.
    fn new() -> Self {
        let case = Self { folder: tempfile::tempdir().expect("folder") };
        let directions = DMat3::from_quat(DQuat::from_euler(glam::EulerRot::XYZ, 0.1, 0.2, -0.3));
        let geometry = Geometry {
            directions,
            origin: DVec3::new(-40.0, 25.0, 310.0),
            space: Space::Lps,
            ..Geometry::axis_aligned([33, 30, 27], DVec3::new(0.8, 0.9, 1.0))
        };
        let radius = |n: usize| geometry.node_to_grid(n).distance(DVec3::new(13.1, 12.9, 11.8));
        let voxels = 0..geometry.voxel_count();
        let scan = voxels.clone().map(|n| (1000.0 / (1.0 + ((radius(n) - 9.0) / 0.8).exp())) as i16).collect();
        case.write("scan.nrrd", &Volume::new(geometry.clone(), Voxels::I16(scan)));
        let label = |n: usize| match n / (33 * 30) {
            24 => 5,
            _ if radius(n) < 9.0 => 3,
            _ => 0,
        };
        case.write("labels.nrrd", &Volume::new(geometry.clone(), Voxels::U8(voxels.map(label).collect())));
        case
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    fn read(&self, name: &str) -> Volume {
        read_volume(&self.path(name)).expect(name)
    }

    fn write(&self, name: &str, volume: &Volume) {
        write_nrrd(&self.path(name), &volume.geometry, &volume.voxels, Encoding::Raw).expect("written");
    }

    fn run(&self, input: &str, options: &[&str]) -> Output {
        let mut command = Command::new(env!("CARGO_BIN_EXE_distfield"));
        command.current_dir(self.folder.path()).arg(input).args(["-o", "f.vti", "--force", "--report", "r.json"]);
        command.args(options).output().expect("the program runs")
    }

    /// Runs the program and returns F and the report.
    #[track_caller]
    fn field(&self, input: &str, options: &[&str]) -> (Field, Value) {
        let run = self.run(input, options);
        assert_eq!(run.status.code(), Some(0), "{options:?}: {}", String::from_utf8_lossy(&run.stderr));
        let report = serde_json::from_slice(&std::fs::read(self.path("r.json")).expect("a report")).expect("JSON");
        (read_field(&self.path("f.vti"), FieldKind::Distance).expect("a field"), report)
    }

    #[track_caller]
    fn refused(&self, input: &str, options: &[&str], words: &[&str]) {
        let run = self.run(input, options);
        let told = String::from_utf8_lossy(&run.stderr);
        assert_eq!(run.status.code(), Some(2), "{options:?}: {told}");
        for word in words {
            assert!(told.contains(word), "{options:?} should say '{word}': {told}");
        }
    }
}

#[test]
fn a_cropped_ball_equals_that_of_a_cropped_file() {
    let case = Case::new();
    for (input, object) in [("scan.nrrd", ["--iso", "500"]), ("labels.nrrd", ["--labels", "3"])] {
        let mut volume = case.read(input);
        let whole = volume.geometry.clone();
        volume.crop([4, 0, 9], [20, 30, 18]);
        case.write("part.nrrd", &volume);
        let (plain, _) = case.field("part.nrrd", &object);
        let mut mask = Volume::new(whole.clone(), Voxels::U8(vec![0; whole.voxel_count()]));
        let Voxels::U8(values) = &mut mask.voxels else { unreachable!() };
        [whole.linear(4, 0, 26), whole.linear(23, 29, 9)].into_iter().for_each(|n| values[n] = 7);
        case.write("mask.nrrd", &mask);
        for region in ["voxels:4..23,..,9..", "mask.nrrd"] {
            let (cropped, report) = case.field(input, &[&object[..], &["--crop", region]].concat());
            assert_eq!(cropped.image.data, plain.image.data, "{region}");
            let origins = [&cropped, &plain].map(|field| field.image.geometry.origin);
            assert!(origins[0].distance(origins[1]) < 1e-9, "{origins:?}");
            assert_eq!(cropped.meta["cap_planes"], plain.meta["cap_planes"]);
            let history = cropped.history.expect("history");
            assert_eq!(history.parameters["crop"], json!(region));
            assert_eq!(history.inputs.len(), if region == "mask.nrrd" { 2 } else { 1 });
            assert_eq!(report["results"]["crop"]["voxels"], json!([[4, 0, 9], [23, 29, 26]]));
            let inside = |volume: &Volume| match &volume.voxels {
                Voxels::U8(values) => values.iter().filter(|&&value| value == 3).count(),
                voxels => voxels.to_f32().iter().filter(|&&value| value > 500.0).count(),
            };
            let (all, kept) = (inside(&case.read(input)), inside(&volume));
            let object = &report["results"]["crop_object"];
            assert_eq!((&object["voxels"], &object["cut_away"]), (&json!(all), &json!(all - kept)));
            let faces: Vec<&String> = object["at_new_border"].as_object().expect("faces").keys().collect();
            assert_eq!(faces, ["high x", "low z"].map(String::from).iter().collect::<Vec<_>>());
        }
    }
}

#[test]
fn downsampled_volumes_equal_those_of_a_downsampled_file() {
    let case = Case::new();
    let choices =
        [("scan.nrrd", ["--iso", "500"], Pooling::Mean), ("labels.nrrd", ["--labels", "3"], Pooling::MostFrequent)];
    for (input, object, pooling) in choices {
        let mut volume = case.read(input);
        volume.crop([0, 0, 3], [33, 30, 24]);
        volume.downsample([2, 2, 1], pooling);
        case.write("small.nrrd", &volume);
        let (plain, _) = case.field("small.nrrd", &object);
        let options = [&object[..], &["--crop", "voxels:..,..,3..", "--downsample", "2,2,1"]].concat();
        let (field, report) = case.field(input, &options);
        assert_eq!(field.image.data, plain.image.data, "{input}");
        assert!(field.image.geometry.origin.distance(plain.image.geometry.origin) < 1e-9);
        assert_eq!(field.history.expect("history").parameters["downsample"], json!([2, 2, 1]));
        let told = &report["results"]["downsample"];
        assert_eq!((&told["size"][1], &told["dropped"]), (&json!([16, 15, 24]), &json!([1, 0, 0])));
        let volumes = &report["results"]["downsample_volumes"][0];
        let [before, after] = ["before", "after"].map(|key| volumes[key].as_f64().expect("a volume"));
        let ball = 4.0 / 3.0 * std::f64::consts::PI * 729.0;
        assert!((before / ball - 1.0).abs() < 0.02 && (after / ball - 1.0).abs() < 0.08, "{volumes}");
    }
}

#[test]
fn lost_labels_are_named() {
    let case = Case::new();
    let run = case.run("labels.nrrd", &["--labels", "3", "--downsample", "4"]);
    assert!(!String::from_utf8_lossy(&run.stderr).contains("changes the volume"));
    case.refused(
        "labels.nrrd",
        &["--labels", "3,5", "--downsample", "4"],
        &["label 5 (-100 %)", "no voxel has the label 5"],
    );
    case.refused("labels.nrrd", &["--material", "plate=5", "--downsample", "4"], &["plate (-100 %)"]);
    let cropped = ["--labels", "5", "--crop", "voxels:..,..,..20"];
    case.refused("labels.nrrd", &cropped, &["cropped to voxels:..,..,..20", "no voxel has the label 5"]);
}

#[test]
fn options_that_leave_no_volume_are_refused() {
    let case = Case::new();
    let refused =
        |option: &[&str], words: &[&str]| case.refused("scan.nrrd", &[&["--iso", "500"], option].concat(), words);
    refused(&["--downsample", "20"], &["--downsample 20 of 33 voxels leaves fewer than two"]);
    refused(&["--downsample", "2,2"], &["has 2 values"]);
    refused(&["--downsample", "0"], &["whole numbers of at least 1"]);
    refused(&["--spacing", "1,NaN,1"], &["must be finite and above 0"]);
    refused(&["--spacing", "1"], &["contains the spacing of its voxels"]);
    refused(&["--crop", "mm:0..NaN,..,.."], &["'NaN' is not a number of mm"]);
    refused(&["--crop", "mm:1000..,..,.."], &["no voxel centre lies in the region mm:1000..,..,.."]);
    refused(&["--crop", "voxels:3..3,..,.."], &["one voxel along the first axis"]);
    refused(&["--crop", "absent.nrrd"], &["absent.nrrd"]);
}
