//! Tests negative byte skips, which count from the end of the data, and data after the last voxel.

use crate::read::read_volume;
use crate::voxels::Voxels;
use std::io::Write;
use std::path::Path;

const VALUES: [u8; 8] = [1, 2, 3, 4, 5, 6, 7, 8];

fn gzip(bytes: &[u8]) -> Vec<u8> {
    let mut encoder = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::fast());
    encoder.write_all(bytes).expect("in memory");
    encoder.finish().expect("in memory")
}

fn bzip2(bytes: &[u8]) -> Vec<u8> {
    let mut encoder = bzip2::write::BzEncoder::new(Vec::new(), bzip2::Compression::fast());
    encoder.write_all(bytes).expect("in memory");
    encoder.finish().expect("in memory")
}

/// Writes an NRRD file of 2 x 2 x 2 voxels that contains the given header lines and data.
fn write(path: &Path, lines: &str, data: &[u8]) {
    let header = format!("NRRD0004\ntype: uchar\ndimension: 3\nsizes: 2 2 2\nspacings: 1 1 1\n{lines}\n\n");
    std::fs::write(path, [header.as_bytes(), data].concat()).expect("written");
}

#[test]
fn a_negative_skip_counts_from_the_end_of_decoded_data() {
    let folder = tempfile::tempdir().expect("folder");
    let path = folder.path().join("v.nrrd");
    // the voxels follow a header in another format, as when an .nhdr file refers to a .nii.gz file
    let before = [&[9; 352][..], &VALUES].concat();
    let behind = [&before[..], &[7; 3]].concat();
    let halves = [gzip(&before[..100]), gzip(&before[100..])].concat();
    for (encoding, skip, data) in [
        ("raw", -1, before.clone()),
        ("gzip", -1, gzip(&before)),
        ("gzip", -1, halves),
        ("bzip2", -1, bzip2(&before)),
        ("hex", -1, before.iter().map(|byte| format!("{byte:02x}\n")).collect::<String>().into_bytes()),
        ("raw", -4, behind.clone()),
        ("gzip", -4, gzip(&behind)),
    ] {
        write(&path, &format!("encoding: {encoding}\nbyte skip: {skip}"), &data);
        let volume = read_volume(&path).unwrap_or_else(|error| panic!("{encoding}: {error}"));
        assert_eq!((volume.voxels, volume.remarks.len()), (Voxels::U8(VALUES.to_vec()), 0), "{encoding} {skip}");
        write(&path, &format!("encoding: {encoding}\nbyte skip: -400"), &data);
        assert!(read_volume(&path).expect_err("too short").to_string().contains("truncated"));
    }
}

#[test]
fn bytes_behind_compressed_data_are_left_out_and_told() {
    let folder = tempfile::tempdir().expect("folder");
    let path = folder.path().join("v.nrrd");
    for (encoding, data) in [("gzip", gzip(&VALUES)), ("bzip2", bzip2(&VALUES))] {
        for byte in [0, b' '] {
            write(&path, &format!("encoding: {encoding}"), &[&data[..], &[byte; 200]].concat());
            let volume = read_volume(&path).unwrap_or_else(|error| panic!("{encoding}: {error}"));
            assert_eq!(volume.voxels, Voxels::U8(VALUES.to_vec()), "{encoding}");
            assert!(
                volume.remarks.len() == 1 && volume.remarks[0].contains("has data after the last voxel"),
                "{:?}",
                volume.remarks
            );
        }
    }
}

#[test]
fn more_data_than_voxels_and_damage_are_refused() {
    let folder = tempfile::tempdir().expect("folder");
    let path = folder.path().join("v.nrrd");
    let longer = [&VALUES[..], &[0; 5]].concat();
    let more = [
        ("raw", longer.clone()),
        ("gzip", gzip(&longer)),
        ("bzip2", bzip2(&longer)),
        ("text", b"1 2 3 4 5 6 7 8 9\n".to_vec()),
        ("hex", b"0102030405060708 09".to_vec()),
    ];
    for (encoding, data) in more {
        write(&path, &format!("encoding: {encoding}"), &data);
        let error = read_volume(&path).expect_err(encoding);
        assert!(error.to_string().contains("after the last voxel"), "{encoding}: {error}");
    }
    // a wrong checksum must be reported as an error, not treated as the end of the data
    let mut damaged = gzip(&VALUES);
    let end = damaged.len() - 6;
    damaged[end] ^= 1;
    write(&path, "encoding: gzip", &damaged);
    assert!(read_volume(&path).is_err());
}
