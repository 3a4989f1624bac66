//! Tests `distfield`, which reads the user's files, with invalid input. The program must exit with
//! code 2, print a three-part error and leave no file behind.

mod support;

use glam::DVec3;
use isoparticles_tests::nrrd::{self, FileSpace, Voxels};
use isoparticles_tests::scene::Shape;
use isoparticles_volume::Geometry;
use std::ffi::OsString;
use std::path::{Path, PathBuf};
use support::{Kind, listing, stage, write_phantom};

/// A folder that contains one input file.
struct Case {
    folder: tempfile::TempDir,
    input: PathBuf,
}

impl Case {
    fn new(name: &str) -> Self {
        let folder = tempfile::tempdir().expect("folder");
        let input = folder.path().join(name);
        Self { folder, input }
    }

    fn bytes(name: &str, content: impl AsRef<[u8]>) -> Self {
        let case = Self::new(name);
        std::fs::write(&case.input, content).expect("input can be written");
        case
    }

    /// Creates an NRRD file: a small header in which `lines` are replaced or added, followed by
    /// `data`.
    fn nrrd(lines: &[&str], data: &[u8]) -> Self {
        let mut header =
            vec!["type: uint8", "dimension: 3", "sizes: 8 8 8", "spacings: 1 1 1", "endian: little", "encoding: raw"];
        for line in lines {
            let key = line.split(':').next().unwrap();
            header.retain(|old| old.split(':').next() != Some(key));
            header.push(line);
        }
        let mut bytes = format!("NRRD0004\n{}\n\n", header.join("\n")).into_bytes();
        bytes.extend_from_slice(data);
        Self::bytes("volume.nrrd", bytes)
    }

    fn floats(value: impl Fn(usize) -> f32) -> Self {
        let case = Self::new("volume.nrrd");
        let geometry = Geometry::axis_aligned([12, 12, 12], DVec3::ONE);
        let data = (0..geometry.voxel_count()).map(value).collect();
        nrrd::write(&case.input, &geometry, FileSpace::Lps, &Voxels::F32(data), false).expect("input can be written");
        case
    }

    fn phantom(kind: Kind) -> Self {
        let case = Self::new("volume.nrrd");
        write_phantom(&case.input, Shape::Ball, &Geometry::axis_aligned([16, 16, 16], DVec3::ONE), kind);
        case
    }

    /// Runs distfield and asserts that it refuses the file and leaves nothing behind.
    #[track_caller]
    fn refused(&self, options: &[&str], words: &[&str]) {
        let before = listing(self.folder.path());
        let output = self.folder.path().join("out.vti");
        let ended = stage("distfield", command(&self.input, &output, options));
        ended.expect_error(2, words);
        assert_eq!(listing(self.folder.path()), before, "something was left behind");
    }
}

fn command(input: &Path, output: &Path, options: &[&str]) -> Vec<OsString> {
    let mut arguments = arguments![input, "-o", output];
    arguments.extend(options.iter().map(OsString::from));
    arguments
}

/// Returns 512 voxels with two values.
fn blob() -> Vec<u8> {
    (0..512_usize).map(|i| if (200..300).contains(&i) { 200 } else { 0 }).collect()
}

#[test]
fn a_missing_file_is_named() {
    Case::new("volume.nrrd").refused(&["--iso", "1"], &["volume.nrrd"]);
}

#[test]
fn an_empty_file_is_refused() {
    Case::bytes("volume.nrrd", "").refused(&["--iso", "1"], &["volume.nrrd"]);
}

#[test]
fn files_of_the_wrong_kind_are_refused() {
    Case::bytes("volume.nrrd", "P5\n8 8\n255\n").refused(&["--iso", "1"], &["volume.nrrd"]);
    Case::bytes("volume.vti", "<html></html>").refused(&["--iso", "1"], &["volume.vti"]);
    Case::bytes("volume.nii.gz", [0x1f, 0x8b, 0, 0]).refused(&["--iso", "1"], &["volume.nii.gz"]);
    Case::bytes("volume.jpg", "not a volume").refused(&["--iso", "1"], &["volume.jpg"]);
}

#[test]
fn a_folder_is_no_volume() {
    let case = Case::new("volume.nrrd");
    std::fs::create_dir(&case.input).unwrap();
    case.refused(&["--iso", "1"], &["volume.nrrd"]);
}

#[test]
fn nan_and_infinite_voxels_are_counted_or_placed() {
    Case::floats(|i| if i == 700 { f32::NAN } else { i as f32 }).refused(&["--iso", "800"], &["nan"]);
    Case::floats(|i| if i == 700 { f32::INFINITY } else { i as f32 }).refused(&["--iso", "800"], &["infinit"]);
    Case::floats(|_| f32::NAN).refused(&["--iso", "800"], &["nan"]);
}

#[test]
fn a_constant_volume_has_no_surface() {
    Case::floats(|_| 7.0).refused(&["--iso", "7"], &["7"]);
    Case::floats(|_| 7.0).refused(&["--iso", "3"], &["7"]);
}

#[test]
fn an_iso_value_outside_the_range_is_told_the_range() {
    Case::floats(|i| (i % 97) as f32).refused(&["--iso", "500"], &["500", "96"]);
    Case::floats(|i| (i % 97) as f32).refused(&["--iso", "-3"], &["-3", "96"]);
    Case::floats(|i| (i % 97) as f32).refused(&["--iso", "nan"], &[]);
}

#[test]
fn missing_labels_are_told_the_present_ones() {
    Case::phantom(Kind::Label).refused(&["--labels", "5"], &["5", "1"]);
    Case::phantom(Kind::Label).refused(&["--labels", "1,9"], &["9"]);
}

#[test]
fn labels_of_a_volume_of_fractions_are_refused() {
    Case::floats(|i| i as f32 * 0.37).refused(&["--labels", "1"], &["label"]);
}

#[test]
fn two_and_four_dimensions_are_refused() {
    Case::nrrd(&["dimension: 2", "sizes: 16 32", "spacings: 1 1"], &blob()).refused(&["--iso", "100"], &["2"]);
    Case::nrrd(&["dimension: 4", "sizes: 8 8 4 2", "spacings: 1 1 1 1"], &blob()).refused(&["--iso", "100"], &["4"]);
}

#[test]
fn a_volume_one_voxel_thin_or_of_no_size_is_refused() {
    Case::nrrd(&["sizes: 16 32 1"], &blob()).refused(&["--iso", "100"], &["1"]);
    Case::nrrd(&["sizes: 0 8 8"], &blob()).refused(&["--iso", "100"], &["0"]);
    Case::nrrd(&["sizes: -8 8 8"], &blob()).refused(&["--iso", "100"], &["-8"]);
}

#[test]
fn zero_huge_and_missing_spacing_are_refused() {
    Case::nrrd(&["spacings: 0 1 1"], &blob()).refused(&["--iso", "100"], &["spacing", "0"]);
    Case::nrrd(&["spacings: 1e300 1 1"], &blob()).refused(&["--iso", "100"], &["spacing"]);
    Case::nrrd(&["spacings: nan 1 1"], &blob()).refused(&["--iso", "100"], &["spacing"]);
    Case::nrrd(&["spacings: inf 1 1"], &blob()).refused(&["--iso", "100"], &["spacing"]);
}

#[test]
fn directions_in_one_plane_are_refused() {
    let flat = ["space dimension: 3", "space directions: (1,0,0) (0,1,0) (1,1,0)"];
    let mut case = Case::nrrd(&flat, &blob());
    let text = String::from_utf8_lossy(&std::fs::read(&case.input).unwrap()).replace("spacings: 1 1 1\n", "");
    std::fs::write(&case.input, text.as_bytes()).unwrap();
    case.refused(&["--iso", "100"], &["direction"]);
    case = Case::nrrd(&["space dimension: 3", "space directions: (1,0,0) (0,1,0)"], &blob());
    case.refused(&["--iso", "100"], &["direction"]);
}

#[test]
fn truncated_data_is_refused() {
    Case::nrrd(&[], &blob()[..300]).refused(&["--iso", "100"], &["volume.nrrd"]);
    Case::nrrd(&["encoding: gzip"], &[0x1f, 0x8b, 8, 0, 0]).refused(&["--iso", "100"], &["volume.nrrd"]);
    Case::nrrd(&["encoding: gzip"], b"this is not gzip").refused(&["--iso", "100"], &["volume.nrrd"]);
}

#[test]
fn trailing_data_is_refused() {
    let mut data = blob();
    data.extend_from_slice(&[1; 64]);
    Case::nrrd(&[], &data).refused(&["--iso", "100"], &["volume.nrrd"]);
}

#[test]
fn a_header_that_promises_too_much_memory_is_refused() {
    Case::nrrd(&["sizes: 100000 100000 100000"], &blob()).refused(&["--iso", "100"], &["declares", "MiB"]);
    let overflow = format!("sizes: {0} {0} {0}", u64::MAX / 2);
    Case::nrrd(&[overflow.as_str()], &blob()).refused(&["--iso", "100"], &[]);
}

#[test]
fn unknown_types_and_encodings_are_named() {
    Case::nrrd(&["type: block"], &blob()).refused(&["--iso", "100"], &["block"]);
    Case::nrrd(&["encoding: zstd"], &blob()).refused(&["--iso", "100"], &["zstd"]);
    Case::nrrd(&["type: complex"], &blob()).refused(&["--iso", "100"], &["complex"]);
}

#[test]
fn a_detached_header_without_its_data_names_the_data_file() {
    let header = "NRRD0004\ntype: uint8\ndimension: 3\nsizes: 8 8 8\nencoding: raw\ndata file: gone.raw\n\n";
    Case::bytes("volume.nhdr", header).refused(&["--iso", "100"], &["gone.raw"]);
}

#[test]
fn bad_usage_ends_with_two() {
    let case = Case::phantom(Kind::Scalar);
    let output = case.folder.path().join("out.vti");
    for options in
        [vec![], vec!["--iso", "100", "--labels", "1"], vec!["--iso", "x"], vec!["--iso", "100", "--nonsense"]]
    {
        let ended = stage("distfield", command(&case.input, &output, &options));
        assert_eq!(ended.code, Some(2), "{options:?}: {}", ended.stderr);
        assert!(ended.stdout.is_empty() && !ended.stderr.contains("panicked"), "{ended:?}");
        assert_eq!(listing(case.folder.path()), ["volume.nrrd"]);
    }
}

#[test]
fn an_existing_output_is_kept_without_force() {
    let case = Case::phantom(Kind::Scalar);
    let output = case.folder.path().join("out.vti");
    std::fs::write(&output, "precious").unwrap();
    stage("distfield", command(&case.input, &output, &["--iso", "100"])).expect_error(2, &["out.vti", "--force"]);
    assert_eq!(std::fs::read(&output).unwrap(), b"precious");
    stage("distfield", command(&case.input, &output, &["--iso", "100", "--force"])).expect_success("distfield --force");
    assert!(std::fs::read(&output).unwrap() != b"precious");
    assert_eq!(listing(case.folder.path()), ["out.vti", "volume.nrrd"]);
}

#[test]
fn a_failed_run_keeps_the_output_of_the_last_one() {
    let case = Case::floats(|_| 1.0);
    let output = case.folder.path().join("out.vti");
    std::fs::write(&output, "precious").unwrap();
    stage("distfield", command(&case.input, &output, &["--iso", "5", "--force"])).expect_error(2, &[]);
    assert_eq!(std::fs::read(&output).unwrap(), b"precious");
}

#[test]
fn a_folder_that_is_not_there_is_refused() {
    let case = Case::phantom(Kind::Scalar);
    let output = case.folder.path().join("nowhere/out.vti");
    stage("distfield", command(&case.input, &output, &["--iso", "100"])).expect_error(2, &["nowhere"]);
    assert_eq!(listing(case.folder.path()), ["volume.nrrd"]);
}

#[test]
#[cfg(target_os = "linux")]
fn an_unwritable_folder_and_a_full_disk_are_told() {
    let case = Case::phantom(Kind::Scalar);
    // Not even root can create files in /proc. Writing to /dev/full fails as on a full disk.
    for output in ["/proc/out.vti", "/dev/full"] {
        stage("distfield", command(&case.input, Path::new(output), &["--iso", "100"])).expect_error(2, &[output]);
        assert_eq!(listing(case.folder.path()), ["volume.nrrd"]);
    }
}
