//! Tests input that `distfield` rejects or warns about: labels for a scan, iso values for label
//! maps, missing labels, NaN voxels, and too little memory.

use isoparticles_stage::field_file::{Field, FieldKind, read_field};
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

fn distfield(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_distfield")).args(arguments).output().expect("the program runs")
}

/// Writes a raw NRRD file of 16-bit numbers in LPS with a spacing of 1 x 1 x 2 mm.
fn write_nrrd(path: &Path, size: [usize; 3], value: impl Fn(f64, usize) -> i16) {
    let [nx, ny, nz] = size;
    let header = format!(
        "NRRD0004\ntype: short\ndimension: 3\nspace: left-posterior-superior\nsizes: {nx} {ny} {nz}\n\
         space directions: (1,0,0) (0,1,0) (0,0,2)\nspace origin: (0,0,0)\nendian: little\nencoding: raw\n\n"
    );
    let mut bytes = header.into_bytes();
    let middle = [0.5 * (nx as f64 - 1.0), 0.5 * (ny as f64 - 1.0), nz as f64 - 1.0];
    for n in 0..nx * ny * nz {
        let at = [(n % nx) as f64, (n / nx % ny) as f64, 2.0 * (n / (nx * ny)) as f64];
        let radius = (0..3).map(|a| (at[a] - middle[a]).powi(2)).sum::<f64>().sqrt();
        bytes.extend(value(radius, n).to_le_bytes());
    }
    std::fs::write(path, bytes).expect("written");
}

/// Returns the voxel value of a scan of a noisy ball with a blurred edge. The mean value is 100 at
/// a radius of 12 mm.
fn scan(radius: f64, n: usize) -> i16 {
    let noise = ((n * 7919) % 31) as f64 - 15.0;
    (200.0 / (1.0 + ((radius - 12.0) / 0.9).exp()) + noise) as i16
}

/// Returns the voxel value of a label map with a ball of label 3 in a shell of label 2, and one
/// voxel of label 9.
fn labels(radius: f64, n: usize) -> i16 {
    match radius {
        _ if n == 0 => 9,
        r if r < 8.0 => 3,
        r if r < 12.0 => 2,
        _ => 0,
    }
}

struct Case {
    folder: tempfile::TempDir,
    input: PathBuf,
}

impl Case {
    fn new(value: impl Fn(f64, usize) -> i16) -> Self {
        let folder = tempfile::tempdir().expect("folder");
        let input = folder.path().join("in.nrrd");
        write_nrrd(&input, [36, 34, 18], value);
        Self { folder, input }
    }

    fn run(&self, options: &[&str]) -> Output {
        let output = self.folder.path().join("f.vti");
        let files = [self.input.to_str().expect("text"), "-o", output.to_str().expect("text"), "--force"];
        distfield(&[&files[..], options].concat())
    }

    /// Runs the program and checks that it succeeds.
    #[track_caller]
    fn field(&self, options: &[&str]) {
        let run = self.run(options);
        assert_eq!(run.status.code(), Some(0), "{options:?}: {}", String::from_utf8_lossy(&run.stderr));
    }

    /// Runs the program and checks that it exits with code 2 and a message that contains `words`,
    /// and that it writes no output.
    #[track_caller]
    fn refused(&self, options: &[&str], words: &[&str]) {
        let run = self.run(options);
        let told = String::from_utf8_lossy(&run.stderr);
        assert_eq!(run.status.code(), Some(2), "{options:?}: {told}");
        for word in ["error: ", "why it matters: ", "what to do: "].iter().chain(words) {
            assert!(told.contains(word), "{options:?} should say '{word}': {told}");
        }
        assert!(!self.folder.path().join("f.vti").exists(), "{options:?} left an output behind");
    }
}

#[test]
fn labels_of_a_scan_are_refused_unless_it_is_insisted() {
    let case = Case::new(scan);
    case.refused(&["--labels", "200"], &["--labels 200: the volume is a scan", "set ISO (--iso)", "--kind labels"]);
    case.refused(&["--labels", "all"], &["the volume is a scan"]);
    let insisted = case.run(&["--labels", "180..220", "--kind", "labels"]);
    assert!(matches!(insisted.status.code(), Some(0 | 1)), "{}", String::from_utf8_lossy(&insisted.stderr));
}

#[test]
fn iso_is_refused_for_labels_and_warned_of_for_a_mask() {
    let case = Case::new(labels);
    case.refused(&["--iso", "2"], &["--iso 2: the volume is a label map", "--labels", "--kind scan"]);
    case.field(&["--iso", "1", "--kind", "scan"]);
    let mask = Case::new(|radius, _| if radius < 10.0 { 255 } else { 0 });
    let run = mask.run(&["--iso", "127.5"]);
    let told = String::from_utf8_lossy(&run.stderr);
    assert_eq!(run.status.code(), Some(0), "{told}");
    assert!(told.contains("warning: ") && told.contains("is a mask of two values"), "{told}");
}

#[test]
fn labels_named_in_any_way_are_the_same_object() {
    let case = Case::new(labels);
    case.refused(&["--labels", "7"], &["no voxel has the label 7", "present: 2, 3, 9"]);
    case.refused(&["--labels", "heart"], &["no segment is called 'heart'"]);
    case.field(&["--labels", "2,3"]);
    let read = || read_field(&case.folder.path().join("f.vti"), FieldKind::Distance).expect("a field");
    let plain = read();
    assert_eq!(plain.history.as_ref().expect("history").parameters["labels"], serde_json::json!([2, 3]));
    for named in ["2..5", "2 3", "2, 2..3"] {
        case.field(&["--labels", named]);
        let field = read();
        assert!(field.image == plain.image && field.meta == plain.meta, "{named}");
        let parameters = |field: &Field| field.history.as_ref().map(|history| history.parameters.clone());
        assert_eq!(parameters(&field), parameters(&plain), "{named}");
    }
}

#[test]
fn nan_among_labels_is_background_and_told() {
    let case = Case::new(labels);
    let plain = isoparticles_volume::read_volume(&case.input).expect("a volume");
    let values: Vec<f32> = plain.voxels.to_f32().into_iter().map(|v| if v == 0.0 { f32::NAN } else { v }).collect();
    let count = values.iter().filter(|value| value.is_nan()).count();
    case.field(&["--labels", "2,3"]);
    let read = || read_field(&case.folder.path().join("f.vti"), FieldKind::Distance).expect("a field").image;
    let expected = read();
    let voxels = isoparticles_volume::Voxels::F32(values);
    let raw = isoparticles_volume::nrrd::Encoding::Raw;
    isoparticles_volume::nrrd::write_nrrd(&case.input, &plain.geometry, &voxels, raw).expect("written");
    let run = case.run(&["--labels", "2,3"]);
    let told = String::from_utf8_lossy(&run.stderr);
    assert_eq!(run.status.code(), Some(0), "{told}");
    assert!(told.contains(&format!("{count} voxels are NaN and are treated as background")), "{told}");
    assert_eq!(read(), expected);
}

#[test]
fn a_volume_that_is_mostly_lost_is_a_failed_check() {
    // these isolated voxels are so close together that most of their volume is lost, so the check
    // of the volume must fail
    let rods = Case::new(|radius, n| i16::from(radius < 12.0 && n % 5 == 0 && n / 36 % 4 == 0));
    let run = rods.run(&["--labels", "1"]);
    let told = String::from_utf8_lossy(&run.stderr);
    assert_eq!(run.status.code(), Some(1), "{told}");
    assert!(told.contains("check failed: the volume changed by -"), "{told}");
}

#[test]
fn a_field_above_the_memory_limit_is_refused_with_the_figure() {
    let case = Case::new(scan);
    case.refused(&["--iso", "100", "--max-memory", "10K"], &["46 x 44 x 28 nodes", "MiB of memory", "--max-memory"]);
    case.field(&["--iso", "100", "--max-memory", "1G"]);
}
