//! Compares the reader of DICOM objects with highdicom, pydicom and rt-utils, which wrote the files
//! in `tests/data/dicom_objects` and read the expected values; see
//! `tests/data/make_dicom_objects.py`.

use glam::DVec3;
use isoparticles_volume::{
    Error, Geometry, LayerLabel, ReadOptions, Volume, data_files, read_volume, read_volume_with,
};
use serde_json::Value;
use std::path::{Path, PathBuf};

fn data(file: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/dicom_objects").join(file)
}

fn expected() -> Value {
    serde_json::from_slice(&std::fs::read(data("expected.json")).expect("expected.json")).expect("JSON")
}

fn read(file: &str) -> Volume {
    read_volume(&data(file)).unwrap_or_else(|error| panic!("{file}: {error}"))
}

/// Returns the message of the error for a file.
fn refusal(path: &Path) -> String {
    let error = read_volume(path).expect_err("no volume");
    assert!(!error.reason().is_empty() && !error.remedy().is_empty(), "{error}");
    format!("{error}; {}", error.remedy())
}

/// Returns the values that another program reads, and their world positions.
fn told(told: &Value) -> Vec<(DVec3, f64)> {
    let parsed = |name: &str| told[name].as_array().expect(name).clone();
    let size: Vec<usize> = parsed("size").iter().map(|n| n.as_u64().expect("a size") as usize).collect();
    let at: Vec<DVec3> = parsed("positions")
        .iter()
        .map(|point| DVec3::from_array(serde_json::from_value(point.clone()).expect("a point")))
        .collect();
    let place = |n: usize| {
        let index = [n % size[0], n / size[0] % size[1], n / size[0] / size[1]].map(|n| n as f64);
        at[0] + (0..3).map(|axis| (at[axis + 1] - at[0]) * index[axis]).sum::<DVec3>()
    };
    parsed("values").iter().enumerate().map(|(n, value)| (place(n), value.as_f64().expect("a value"))).collect()
}

/// Returns the number of the voxel at a world position.
fn voxel(geometry: &Geometry, world: DVec3) -> usize {
    let index = geometry.grid_to_index(geometry.world_to_grid(world));
    let nearest = index.round();
    assert!((index - nearest).length() < 1e-4, "{world} is between the voxels, at {index}");
    let [i, j, k] = nearest.to_array().map(|n| n as usize);
    assert!(i < geometry.size[0] && j < geometry.size[1] && k < geometry.size[2], "{world} is outside");
    geometry.linear(i, j, k)
}

#[test]
fn other_programs_see_the_same_voxels_in_the_same_places() {
    for (file, others) in expected()["volumes"].as_object().expect("volumes") {
        let volume = read(file);
        let (values, others) = (volume.voxels.to_f64(), told(others));
        assert_eq!(values.len(), others.len(), "{file}");
        for (world, value) in others {
            assert_eq!(values[voxel(&volume.geometry, world)], value, "{file} at {world}");
        }
    }
}

#[test]
fn other_programs_see_the_same_segments_in_the_same_places() {
    for (file, segments) in expected()["segments"].as_object().expect("segments") {
        let volume = read(file);
        assert_eq!(volume.segments.len(), segments.as_object().expect("segments").len(), "{file}");
        for (name, others) in segments.as_object().expect("segments") {
            let at = volume.segment_named(name).unwrap_or_else(|error| panic!("{file}: {error}"));
            assert_eq!(Some(at.label), others["number"].as_i64(), "{file}, {name}");
            let mask = volume.label_mask(&[at]);
            let others = told(others);
            for &(world, value) in &others {
                assert_eq!(mask[voxel(&volume.geometry, world)], value != 0.0, "{file}, {name} at {world}");
            }
            // voxels that the other program omits are background
            let count = others.iter().filter(|(_, value)| *value != 0.0).count();
            assert_eq!(mask.iter().filter(|&&inside| inside).count(), count, "{file}, {name}");
        }
    }
}

#[test]
fn one_scan_is_the_same_volume_in_all_objects() {
    let series = read("series");
    for file in ["enhanced.dcm", "legacy.dcm", "rle.dcm"] {
        let volume = read(file);
        assert_eq!(volume.voxels, series.voxels, "{file}");
        let [ours, theirs] = [&volume.geometry, &series.geometry];
        assert!((ours.origin - theirs.origin).length() < 1e-7, "{file}: {}", ours.origin);
        assert!((ours.spacing - theirs.spacing).length() < 1e-7, "{file}: {}", ours.spacing);
        assert!(ours.directions.abs_diff_eq(theirs.directions, 1e-7), "{file}: {}", ours.directions);
    }
    // the segment consists of the voxels of 1500 - 1024 HU
    let whole = read("seg_whole.dcm");
    let inside: Vec<bool> = series.voxels.to_f64().iter().map(|&value| value == 476.0).collect();
    assert_eq!(whole.label_mask(&[LayerLabel { layer: 0, label: 1 }]), inside);
    assert!(whole.geometry.grid_to_world(DVec3::ONE).abs_diff_eq(series.geometry.grid_to_world(DVec3::ONE), 1e-6));
    assert_eq!((whole.geometry.size, whole.layer_count(), whole.remarks.len()), (series.geometry.size, 1, 0));
}

#[test]
fn overlapping_segments_go_to_further_layers() {
    let overlapping = read("seg.dcm");
    assert_eq!(overlapping.layer_count(), 2);
    assert_eq!(overlapping.segment_named("tumour").expect("there"), LayerLabel { layer: 1, label: 2 });
    assert_eq!(overlapping.segment_named("vessel").expect("there"), LayerLabel { layer: 0, label: 3 });
    assert_eq!(read("seg_labelmap.dcm").layer_count(), 1);
    let structures = read("structures/rs.dcm");
    assert!(structures.layer_count() > 1);
    assert_eq!(structures.segments.len(), 3);
}

#[test]
fn slices_without_frames_are_background() {
    let sparse = read("seg_sparse.dcm");
    // frames in slices 1 and 3, the slice between them, and an empty slice at each end
    assert_eq!(sparse.geometry.size, [7, 6, 5]);
    assert!((sparse.geometry.spacing.z - 3.0).abs() < 1e-6);
    assert!(sparse.remarks.iter().any(|remark| remark.contains("empty slice was added")), "{:?}", sparse.remarks);
}

#[test]
fn a_part_of_a_multi_frame_image_is_chosen_like_a_series() {
    let path = data("times.dcm");
    let text = refusal(&path);
    assert!(text.contains("'enhanced, TemporalPositionIndex 2' (CT, number 4.2, 1 file, 5 frames"), "{text}");
    let choose = |series| read_volume_with(&path, &ReadOptions { series: Some(series), ..ReadOptions::default() });
    let [first, second] = ["4.1", "enhanced, temporalpositionindex 2"].map(|name| choose(name).expect(name));
    assert_eq!(first.voxels, read("enhanced.dcm").voxels);
    let later: Vec<f64> = first.voxels.to_f64().iter().map(|value| value + 1.0).collect();
    assert_eq!((second.voxels.to_f64(), &second.geometry), (later, &first.geometry));
}

#[test]
fn what_cannot_be_read_is_refused_with_the_reason() {
    for (file, word) in expected()["refused"].as_object().expect("refused") {
        let text = refusal(&data(file));
        let word = word.as_str().expect("a word");
        assert!(text.contains(word) && text.contains(file), "{file}: '{word}' is not in '{text}'");
    }
    let slice = data("series/a.dcm");
    assert!(matches!(read_volume(&slice).expect_err("one slice"), Error::NotAVolume { .. }));
}

/// Copies files to a folder.
fn folder_of(files: &[&str]) -> tempfile::TempDir {
    let folder = tempfile::tempdir().expect("folder");
    for file in files {
        let name = Path::new(file).file_name().expect("a name");
        std::fs::copy(data(file), folder.path().join(name)).expect("copied");
    }
    folder
}

const SERIES: [&str; 5] = ["series/a.dcm", "series/b.dcm", "series/c.dcm", "series/d.dcm", "series/e.dcm"];

#[test]
fn slices_are_preferred_to_segmentations_in_a_folder() {
    let folder = folder_of(&[&SERIES[..], &["seg.dcm", "contours/alone.dcm"]].concat());
    let volume = read_volume(folder.path()).expect("the scan");
    assert_eq!(volume.voxels, read("series").voxels);
    let remarks = volume.remarks.join("; ");
    assert!(remarks.contains("'seg' (SEG, number 300") && remarks.contains("'structures' (RTSTRUCT"), "{remarks}");
    let chosen = read_volume_with(folder.path(), &ReadOptions { series: Some("seg"), ..ReadOptions::default() });
    assert_eq!(chosen.expect("the segmentation").segments, read("seg.dcm").segments);
    // alone in a folder, a segmentation or a multi-frame image is read without a choice
    for file in ["seg.dcm", "enhanced.dcm", "contours/alone.dcm"] {
        assert_eq!(read_volume(folder_of(&[file]).path()).expect(file).voxels, read(file).voxels, "{file}");
    }
    let text = refusal(folder_of(&["seg.dcm", "seg_sparse.dcm"]).path());
    assert!(text.contains("contains 2 series") && text.contains("'seg_sparse' (SEG"), "{text}");
}

#[test]
fn unreadable_files_of_other_series_do_not_matter() {
    let expected = read("series").voxels;
    let whole = std::fs::read(data("legacy.dcm")).expect("bytes");
    for length in [132, 400, whole.len() / 2, whole.len() - 1] {
        let folder = folder_of(&SERIES);
        std::fs::write(folder.path().join("other.dcm"), &whole[..length]).expect("written");
        let volume = read_volume(folder.path()).unwrap_or_else(|error| panic!("cut to {length} bytes: {error}"));
        assert_eq!(volume.voxels, expected);
        assert!(volume.remarks.iter().any(|remark| remark.contains("could not be read")), "{:?}", volume.remarks);
    }
    // the fourth of five slices; its first 300 bytes do not contain the series
    let whole = std::fs::read(data("series/d.dcm")).expect("bytes");
    for (length, says) in [(whole.len() - 1, "truncated"), (300, "may be the missing slice")] {
        let folder = folder_of(&SERIES);
        std::fs::write(folder.path().join("d.dcm"), &whole[..length]).expect("written");
        let error = read_volume(folder.path()).expect_err("a gap");
        let text = format!("{error}; {}", error.reason());
        assert!(text.contains(says) && text.contains("d.dcm"), "{text}");
    }
}

#[test]
fn contours_without_slices_get_a_grid_of_their_own() {
    let alone = read("contours/alone.dcm");
    let remarks = alone.remarks.join("; ");
    assert!(remarks.contains("not in the same folder") && remarks.contains("1 contours of type 'POINT'"), "{remarks}");
    let options = ReadOptions { spacing: Some(DVec3::new(0.75, 0.75, 3.0)), ..ReadOptions::default() };
    let given = read_volume_with(&data("contours/alone.dcm"), &options).expect("with a spacing");
    assert!(given.geometry.spacing.abs_diff_eq(DVec3::new(0.75, 0.75, 3.0), 1e-9), "{}", given.geometry.spacing);
    // with the pixel size of the scan, the masks equal those on the grid of the scan
    let structures = read("structures/rs.dcm");
    for segment in &structures.segments {
        let at = given.segment_named(&segment.name).expect("there");
        let count = |volume: &Volume, at| volume.label_mask(&[at]).iter().filter(|&&inside| inside).count();
        assert_eq!(count(&given, at), count(&structures, segment.at), "{}", segment.name);
    }
    // the slices beside the contours determine the grid, so they are files of the volume as well
    assert_eq!(data_files(&data("structures/rs.dcm")).expect("read").len(), 5);
    assert_eq!(data_files(&data("seg.dcm")).expect("read").len(), 0);
    // a grid that exceeds the memory is refused before contours are drawn on it
    let tiny = ReadOptions { spacing: Some(DVec3::splat(2e-9)), ..ReadOptions::default() };
    read_volume_with(&data("contours/alone.dcm"), &tiny).expect_err("too many pixels");
    // a spacing is refused for files that contain one
    for file in ["structures/rs.dcm", "seg.dcm", "enhanced.dcm", "series"] {
        let error = read_volume_with(&data(file), &options).expect_err(file);
        assert!(error.to_string().contains("contains the spacing"), "{error}");
    }
}

#[test]
fn objects_cut_short_anywhere_are_errors_or_complete() {
    let folder = tempfile::tempdir().expect("folder");
    let path = folder.path().join("cut.dcm");
    for file in ["seg.dcm", "seg_fractional.dcm", "enhanced.dcm", "jpeg2000.dcm", "contours/alone.dcm"] {
        let whole = std::fs::read(data(file)).expect("bytes");
        for length in (132..whole.len()).step_by(37) {
            std::fs::write(&path, &whole[..length]).expect("cut");
            // elements after the contours may be missing
            match read_volume(&path) {
                Ok(volume) => assert_eq!(volume, read(file), "{file}, cut to {length} bytes"),
                Err(error) => assert!(!error.reason().is_empty() && !error.remedy().is_empty(), "{error}"),
            }
        }
    }
}
