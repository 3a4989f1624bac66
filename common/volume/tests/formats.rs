//! Compares the readers with other programs. All fixtures in `tests/data` and their expected values
//! were created with pynrrd, SimpleITK, Teem's unu, nibabel, pydicom, tifffile, NumPy and VTK; see
//! `tests/data/make_fixtures.py`.

use glam::DVec3;
use isoparticles_volume::{
    Content, Error, LayerLabel, ReadOptions, Space, Volume, Voxels, read_volume, read_volume_with,
};
use serde_json::Value;
use std::path::{Path, PathBuf};

fn data() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data")
}

fn expected() -> Value {
    serde_json::from_slice(&std::fs::read(data().join("expected.json")).expect("expected.json")).expect("JSON")
}

/// Returns the world positions of the first voxel and of the last voxel along each axis.
fn positions(volume: &Volume) -> [DVec3; 4] {
    let geometry = &volume.geometry;
    let end = geometry.upper_corner();
    [DVec3::ZERO, DVec3::X * end.x, DVec3::Y * end.y, DVec3::Z * end.z].map(|grid| geometry.grid_to_world(grid))
}

/// Returns whether the values exactly equal the numbers in the given strings.
fn same_values(voxels: &Voxels, texts: &[String]) -> bool {
    fn whole<T: ToString>(values: &[T], texts: &[String]) -> bool {
        values.iter().map(T::to_string).eq(texts.iter().cloned())
    }
    let numbers = || texts.iter().map(|text| text.parse::<f64>().expect("a number"));
    match voxels {
        Voxels::I8(values) => whole(values, texts),
        Voxels::U8(values) => whole(values, texts),
        Voxels::I16(values) => whole(values, texts),
        Voxels::U16(values) => whole(values, texts),
        Voxels::I32(values) => whole(values, texts),
        Voxels::U32(values) => whole(values, texts),
        Voxels::I64(values) => whole(values, texts),
        Voxels::U64(values) => whole(values, texts),
        Voxels::F32(values) => values.iter().map(|&value| f64::from(value)).eq(numbers()),
        Voxels::F64(values) => values.iter().copied().eq(numbers()),
    }
}

#[test]
fn other_programs_see_the_same_voxels_in_the_same_places() {
    let expected = expected();
    let volumes = expected["volumes"].as_object().expect("volumes");
    assert!(volumes.len() >= 146);
    for (file, told) in volumes {
        let spacing: Option<DVec3> =
            told.get("spacing").map(|spacing| serde_json::from_value(spacing.clone()).expect("mm"));
        let options = ReadOptions { spacing, ..ReadOptions::default() };
        let volume = read_volume_with(&data().join(file), &options).unwrap_or_else(|error| panic!("{error}"));
        assert_eq!(volume.voxels.type_name(), told["type"], "{file}");
        let texts: Vec<String> = serde_json::from_value(told["values"].clone()).expect("texts");
        assert!(same_values(&volume.voxels, &texts), "{file}: {:?}", volume.voxels);
        let places: [[f64; 3]; 4] = serde_json::from_value(told["positions"].clone()).expect("positions");
        // NIfTI and FreeSurfer store the geometry as 32-bit floats. VTK writes the origin with
        // about the same precision.
        let is_exact = ["nrrd", "npy", "tiff"].iter().any(|folder| file.starts_with(folder));
        let tolerance = if is_exact { 1e-10 } else { 1e-5 };
        for (ours, theirs) in positions(&volume).iter().zip(places) {
            let theirs = DVec3::from_array(theirs);
            assert!(ours.abs_diff_eq(theirs, tolerance), "{file}: {ours} is not {theirs} ({})", told["told_by"]);
        }
    }
}

#[test]
fn the_frame_of_the_file_is_known() {
    for (file, file_space) in [
        ("nrrd/space_ras.nrrd", Space::Ras),
        ("nrrd/space_las.nrrd", Space::Lps),
        ("nrrd/itk.nrrd", Space::Lps),
        ("nrrd/space_unnamed.nrrd", Space::Unnamed),
        ("nifti/sform.nii", Space::Ras),
        ("nifti/qform.nii.gz", Space::Ras),
        ("meta/orientation.mha", Space::Lps),
        ("dicom/oblique", Space::Lps),
        ("vti/pyvista.vti", Space::Unnamed),
    ] {
        let volume = read_volume(&data().join(file)).unwrap_or_else(|error| panic!("{error}"));
        assert_eq!(volume.file_space, file_space, "{file}");
        let is_named = file_space != Space::Unnamed;
        assert_eq!(volume.geometry.space, if is_named { Space::Lps } else { Space::Unnamed }, "{file}");
    }
}

#[test]
fn segments_have_names_and_layers() {
    let read =
        |name: &str| read_volume(&data().join("segmentation").join(name)).unwrap_or_else(|error| panic!("{error}"));
    let one = read("one_layer.seg.nrrd");
    assert_eq!(one.layer_count(), 1);
    assert_eq!(one.segment_named("left lung").expect("there"), LayerLabel { layer: 0, label: 1 });
    let two = read("two_layers.seg.nrrd");
    assert_eq!((two.layer_count(), two.segments.len()), (2, 3));
    assert_eq!(two.segment_named("vessel").expect("there"), LayerLabel { layer: 1, label: 1 });
    // The second layer is the first one, rotated right by five voxels in NumPy's order (z fastest).
    let in_numpy =
        |mask: Vec<bool>| -> Vec<bool> { (0..24).map(|n| mask[(n % 2) * 12 + (n / 2 % 4) * 3 + n / 8]).collect() };
    let lung = in_numpy(one.label_mask(&[LayerLabel { layer: 0, label: 1 }]));
    let mut vessel = in_numpy(two.label_mask(&[LayerLabel { layer: 1, label: 1 }]));
    vessel.rotate_left(5);
    assert_eq!(vessel, lung);
    assert!(two.label_numbered(1).is_err() && two.label_numbered(2).is_err());
}

/// The error for a mesh or particle file describes its contents.
#[test]
fn what_is_no_volume_is_told_by_what_it_is() {
    let folder = tempfile::tempdir().expect("folder");
    let starts: [(&str, &[u8], Content); 9] = [
        ("a.vtp", b"<VTKFile type=\"PolyData\">", Content::SurfaceVtk),
        ("a.vtu", b"<VTKFile type=\"UnstructuredGrid\">", Content::TetrahedraVtk),
        ("a.vtk", b"# vtk DataFile Version 3.0", Content::LegacyVtk),
        ("a.ply", b"ply\nformat", Content::SurfacePly),
        ("a", b"solid a", Content::SurfaceStl),
        ("a.obj", b"v 0 0 0", Content::SurfaceObj),
        ("seeds", b"ISOPART\n\x01\0\0\0", Content::Seeds),
        ("settled", b"ISOPART\n\x02\0\0\0", Content::Particles),
        ("checkpoint", b"ISOPART\n\x03\0\0\0", Content::Checkpoint),
    ];
    for (name, bytes, is) in starts {
        let path = folder.path().join(name);
        std::fs::write(&path, bytes).expect("written");
        let error = read_volume(&path).expect_err("no volume");
        assert!(matches!(error, Error::NotAVolume { content, .. } if content == is), "{error}");
    }
}

#[test]
fn the_first_bytes_tell_the_format_whatever_the_name() {
    let folder = tempfile::tempdir().expect("folder");
    for file in ["nrrd/plain.nrrd", "nifti/sform.nii", "nifti/qform.nii.gz", "meta/itk_int16.mha", "vti/pyvista.vti"] {
        let path = folder.path().join("volume.dat");
        let Ok(bytes) = std::fs::read(data().join(file)) else { panic!("{file} is not there") };
        std::fs::write(&path, bytes).expect("written");
        let volume = read_volume(&path).unwrap_or_else(|error| panic!("{error}"));
        assert_eq!(volume, read_volume(&data().join(file)).expect("read"), "{file}");
    }
}

#[test]
fn what_cannot_be_meshed_is_refused_with_the_reason() {
    let expected = expected();
    for (file, word) in expected["refused"].as_object().expect("refused") {
        let error = read_volume(&data().join(file)).expect_err(file);
        let word = word.as_str().expect("a word");
        assert!(error.to_string().contains(word), "{file}: '{word}' is not in '{error}'");
        assert!(error.to_string().contains(file.rsplit('/').next().expect("a name")), "{file}: not named in '{error}'");
        assert!(!error.reason().is_empty() && !error.remedy().is_empty(), "{file}");
    }
}
