//! Tests files with incomplete headers or separate voxel files.

use crate::data_files::data_files;
use crate::geometry::Space;
use crate::read::read_volume;
use crate::volume::Volume;
use crate::voxels::Voxels;
use glam::DVec3;
use std::path::Path;

/// Creates a header for 2 x 2 x 2 one-byte voxels with a spacing of 2 mm and the given qform and
/// sform codes. All numbers of the sform are zero.
fn header(offset: f32, qform: i16, sform: i16, magic: &[u8; 4]) -> Vec<u8> {
    let mut header = vec![0u8; 348];
    let mut put = |at: usize, bytes: &[u8]| header[at..at + bytes.len()].copy_from_slice(bytes);
    put(0, &348i32.to_le_bytes());
    for (axis, size) in [3i16, 2, 2, 2, 1, 1, 1, 1].into_iter().enumerate() {
        put(40 + 2 * axis, &size.to_le_bytes());
        put(76 + 4 * axis, &if axis == 0 { 1f32 } else { 2f32 }.to_le_bytes());
    }
    put(70, &2i16.to_le_bytes());
    put(72, &8i16.to_le_bytes());
    put(108, &offset.to_le_bytes());
    put(252, &qform.to_le_bytes());
    put(254, &sform.to_le_bytes());
    // the qform sets the position of the first voxel to (3, 4, 5) in RAS
    [3f32, 4.0, 5.0].into_iter().enumerate().for_each(|(axis, at)| put(268 + 4 * axis, &at.to_le_bytes()));
    put(344, magic);
    header
}

const VALUES: [u8; 8] = [1, 2, 3, 4, 5, 6, 7, 8];

fn read(path: &Path, bytes: &[u8]) -> Volume {
    std::fs::write(path, bytes).expect("written");
    read_volume(path).unwrap_or_else(|error| panic!("{error}"))
}

#[test]
fn voxels_that_start_within_the_header_start_behind_it() {
    let folder = tempfile::tempdir().expect("folder");
    let path = folder.path().join("v.nii");
    for offset in [0.0, 40.0, 352.0] {
        let volume = read(&path, &[&header(offset, 1, 0, b"n+1\0")[..], &[0; 4], &VALUES].concat());
        assert_eq!(volume.voxels, Voxels::U8(VALUES.to_vec()), "{offset}");
        assert_eq!(volume.remarks.len(), usize::from(offset < 348.0), "{:?}", volume.remarks);
    }
}

#[test]
fn bytes_behind_the_voxels_are_left_out_and_told() {
    let folder = tempfile::tempdir().expect("folder");
    let path = folder.path().join("v.nii");
    let volume = read(&path, &[&header(352.0, 1, 0, b"n+1\0")[..], &[0; 4], &VALUES, &[7; 16]].concat());
    assert_eq!(volume.voxels, Voxels::U8(VALUES.to_vec()));
    assert!(volume.remarks[0].contains("v.nii has data after the last voxel"), "{:?}", volume.remarks);
}

#[test]
fn an_sform_without_directions_gives_way_to_the_qform() {
    let folder = tempfile::tempdir().expect("folder");
    let path = folder.path().join("v.nii");
    let at =
        |qform: i16, sform: i16| read(&path, &[&header(352.0, qform, sform, b"n+1\0")[..], &[0; 4], &VALUES].concat());
    let volume = at(1, 1);
    assert_eq!((volume.geometry.spacing, volume.geometry.origin), (DVec3::splat(2.0), DVec3::new(-3.0, -4.0, 5.0)));
    assert!(volume.remarks.len() == 1 && volume.remarks[0].contains("sform"), "{:?}", volume.remarks);
    let plain = at(0, 2);
    assert_eq!((plain.geometry.spacing, plain.geometry.origin), (DVec3::splat(2.0), DVec3::ZERO));
    assert_eq!(plain.remarks.len(), 2, "{:?}", plain.remarks);
}

#[test]
fn a_pair_is_read_by_either_of_its_names() {
    let folder = tempfile::tempdir().expect("folder");
    let [head, body] = ["p.hdr", "p.img"].map(|name| folder.path().join(name));
    std::fs::write(&head, header(0.0, 1, 0, b"ni1\0")).expect("written");
    let error = read_volume(&head).expect_err("no voxels");
    assert!(error.to_string().contains("voxels are missing"), "{error}");
    let volume = read(&body, &VALUES);
    assert_eq!((&volume.voxels, volume.remarks.len()), (&Voxels::U8(VALUES.to_vec()), 0));
    assert_eq!(read_volume(&head).expect("by its header"), volume);
    assert_eq!(data_files(&head).expect("files"), std::slice::from_ref(&body));
    assert_eq!(data_files(&body).expect("files"), std::slice::from_ref(&head));
}

#[test]
fn headers_without_a_magic_number_are_analyze() {
    let folder = tempfile::tempdir().expect("folder");
    let [head, body] = ["p.hdr", "p.img"].map(|name| folder.path().join(name));
    std::fs::write(&head, header(0.0, 1, 1, &[0; 4])).expect("written");
    let volume = read(&body, &VALUES);
    assert_eq!((volume.voxels, volume.geometry.space), (Voxels::U8(VALUES.to_vec()), Space::Unnamed));
    // x runs to the left, y to anterior, and the origin is the centre
    let at = |x: f64, y: f64, z: f64| volume.geometry.grid_to_world(DVec3::new(x, y, z));
    assert_eq!([at(1.0, 1.0, 1.0), at(3.0, 2.0, 1.0)], [DVec3::ZERO, DVec3::new(2.0, -1.0, 0.0)]);
    assert!(volume.remarks.len() == 1 && volume.remarks[0].contains("left"), "{:?}", volume.remarks);
}

#[test]
fn damaged_headers_are_refused() {
    let folder = tempfile::tempdir().expect("folder");
    let path = folder.path().join("v.nii");
    let whole = header(352.0, 1, 0, b"n+1\0");
    let with = |at: usize, bytes: &[u8]| {
        let mut header = whole.clone();
        header[at..at + bytes.len()].copy_from_slice(bytes);
        header
    };
    let two = [&540_i32.to_le_bytes()[..], &[0; 536]].concat();
    for (header, word) in [
        (whole[..300].to_vec(), "no complete NIfTI header"),
        (two, "magic number of NIfTI-2"),
        (with(40, &[8, 0]), "dimension 8"),
        (with(42, &[0xff, 0xff]), "[-1, 2, 2]"),
        (with(42, &[0, 0]), "a size is zero"),
        (with(108, &2e9_f32.to_le_bytes()), "vox_offset"),
        (with(108, &f32::NAN.to_le_bytes()), "vox_offset"),
    ] {
        std::fs::write(&path, [&header[..], &[0; 4], &VALUES].concat()).expect("written");
        let error = read_volume(&path).expect_err(word);
        assert!(error.to_string().contains(word) && !error.remedy().is_empty(), "'{word}' is not in '{error}'");
    }
}
