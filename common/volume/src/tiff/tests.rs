//! Tests damaged and unusual TIFF files, and the rules for spacings.

use super::natural_order;
use crate::error::Result;
use crate::read::{ReadOptions, read_volume, read_volume_with};
use crate::volume::Volume;
use crate::voxels::Voxels;
use glam::DVec3;

/// A tag with one 32-bit integer, or with a text.
enum Tag<'a> {
    Number(u16, u32),
    Text(u16, &'a str),
}
use Tag::{Number, Text};

/// Creates a little-endian file: `pixels` from byte 8, then a directory per page. By default, each
/// page has 2 x 2 pixels of 8 bits: the first page has the first four bytes, and so on. `tags`
/// replaces these tags or adds others.
fn file(pages: usize, pixels: &[u8], tags: &[Tag<'_>]) -> Vec<u8> {
    let mut bytes = [b"II*\0", &(8 + pixels.len() as u32).to_le_bytes()[..], pixels].concat();
    for page in 0..pages {
        let plain = [(256, 2), (257, 2), (258, 8), (273, 8 + 4 * page as u32), (279, 4)];
        let is_own = |tag: u16| tags.iter().any(|own| matches!(own, Number(own, _) if *own == tag));
        let plain = plain.into_iter().filter(|(tag, _)| !is_own(*tag)).map(|(tag, value)| Number(tag, value));
        let all: Vec<Tag<'_>> = plain
            .chain(tags.iter().map(|tag| match tag {
                Number(tag, value) => Number(*tag, *value),
                Text(tag, text) => Text(*tag, text),
            }))
            .collect();
        let mut behind = bytes.len() + 2 + 12 * all.len() + 4;
        let mut texts = Vec::new();
        bytes.extend((all.len() as u16).to_le_bytes());
        for tag in all {
            let (tag, kind, count, value) = match tag {
                Number(tag, value) => (tag, 4_u16, 1, value),
                Text(tag, text) => {
                    texts.extend_from_slice(text.as_bytes());
                    behind += text.len();
                    (tag, 2, text.len() as u32, (behind - text.len()) as u32)
                }
            };
            bytes.extend([tag.to_le_bytes(), kind.to_le_bytes()].concat());
            bytes.extend([count.to_le_bytes(), value.to_le_bytes()].concat());
        }
        let next = if page + 1 < pages { behind as u32 } else { 0 };
        bytes.extend(next.to_le_bytes());
        bytes.extend(texts);
    }
    bytes
}

fn read(bytes: &[u8], spacing: Option<DVec3>) -> Result<Volume> {
    let folder = tempfile::tempdir().expect("folder");
    let path = folder.path().join("v.dat");
    std::fs::write(&path, bytes).expect("written");
    read_volume_with(&path, &ReadOptions { spacing, ..ReadOptions::default() })
}

const PIXELS: [u8; 8] = [1, 2, 3, 4, 5, 6, 7, 8];

#[test]
fn pages_are_slices() {
    let volume = read(&file(2, &PIXELS, &[]), Some(DVec3::ONE)).unwrap_or_else(|error| panic!("{error}"));
    assert_eq!((volume.geometry.size, volume.voxels), ([2, 2, 2], Voxels::U8(PIXELS.to_vec())));
    assert!(volume.remarks.is_empty(), "{:?}", volume.remarks);
}

#[test]
fn numbers_in_names_are_compared_as_numbers() {
    let mut names =
        ["s10.tif", "s9.tif", "S1.tif", "s09b.tif", "s2_10.tif", "s2_9.tif", "s.tif", "s010.tif", "10", "9"];
    names.sort_by(|a, b| natural_order(a, b));
    assert_eq!(
        names,
        ["9", "10", "S1.tif", "s2_9.tif", "s2_10.tif", "s9.tif", "s09b.tif", "s010.tif", "s10.tif", "s.tif"]
    );
}

#[test]
fn a_given_spacing_completes_that_of_the_file() {
    let given = DVec3::new(0.5, 0.5, 2.0);
    // 20 pixels per cm and, with a unit of 2, per inch
    let fraction = 8 + 8;
    let with = |unit: u32, above: u32, text: &str| {
        let pixels = [&PIXELS[..], &above.to_le_bytes(), &1_u32.to_le_bytes()].concat();
        let mut bytes =
            file(2, &pixels, &[Number(282, fraction), Number(283, fraction), Number(296, unit), Text(270, text)]);
        // both resolutions are fractions
        for tag in [282_u16, 283] {
            let at = bytes.windows(4).position(|window| window == [tag.to_le_bytes(), 4_u16.to_le_bytes()].concat());
            bytes[at.expect("the tag") + 2] = 5;
        }
        bytes
    };
    let spacing =
        |bytes: &[u8], given| read(bytes, given).map(|volume| (volume.geometry.spacing, volume.remarks.len()));
    // the same along x and y, different, and the resolution of a screen
    for (unit, above, remarks) in [(3, 20, 0), (3, 40, 1), (2, 72, 0), (1, 1, 0)] {
        let bytes = with(unit, above, "");
        assert_eq!(spacing(&bytes, Some(given)).expect("given"), (given, remarks), "{unit} {above}");
        let error = read(&bytes, None).expect_err("no spacing").to_string();
        assert_eq!(error.contains("not along z"), unit == 3, "{error}");
    }
    let complete = with(1, 2, "ImageJ=1.54\nimages=2\nslices=2\nunit=mm\nspacing=-2.0\n");
    for same in [None, Some(given)] {
        assert_eq!(spacing(&complete, same).expect("complete"), (given, 0));
    }
    let error = read(&complete, Some(DVec3::ONE)).expect_err("a contradiction");
    assert!(error.to_string().contains("0.5 x 0.5 x 2 mm, and 1 x 1 x 1 mm was given"), "{error}");
    let assumed = with(1, 2, "ImageJ=1.54\nimages=2\nslices=2\nunit=cm\n");
    assert_eq!(spacing(&assumed, None).expect("assumed"), (DVec3::new(5.0, 5.0, 10.0), 1));
    assert_eq!(spacing(&assumed, Some(given)).expect("given"), (given, 1));
}

#[test]
fn damaged_files_are_refused() {
    let mut circle = file(2, &PIXELS, &[]);
    let end = circle.len();
    circle[end - 4..].copy_from_slice(&16_u32.to_le_bytes());
    let cases = [
        (circle, "circle"),
        (file(0, &PIXELS, &[]), "end of the file"),
        (file(1, &PIXELS, &[]), "flat"),
        (file(200, &PIXELS, &[Number(273, 8), Number(256, 30), Number(257, 40)]), "have more bytes than the file"),
        (file(2, &PIXELS, &[Number(256, 0)]), "empty"),
        (file(2, &PIXELS, &[Number(256, u32::MAX), Number(257, u32::MAX)]), "end of the file"),
        (file(2, &PIXELS, &[Number(257, 9000), Number(256, 9000), Number(259, 8)]), "cannot contain"),
        (file(2, &PIXELS, &[Number(257, u32::MAX), Number(278, 1)]), "1 strips or tiles instead of 4294967295"),
        (
            file(
                2,
                &PIXELS,
                &[Number(322, 1), Number(323, 1), Number(324, 8), Number(256, u32::MAX), Number(257, u32::MAX)],
            ),
            "instead of 18446744065119617025",
        ),
        (file(2, &PIXELS, &[Number(259, 8)]), "cannot be decoded"),
        (file(2, &PIXELS, &[Number(259, 5)]), "cannot be decoded"),
        (file(2, &[9; 8], &[Number(259, 32773)]), "cannot be decoded"),
        (file(2, &PIXELS, &[Number(259, 50000)]), "zstd"),
        (file(2, &PIXELS, &[Number(317, 3), Number(259, 5)]), "predictor 3"),
        (file(2, &PIXELS, &[Number(258, 12)]), "integers of 12 bits"),
        (file(2, &PIXELS, &[Number(262, 2)]), "colours"),
        (file(2, &PIXELS, &[Number(277, 4)]), "4 values per pixel"),
        (file(1, &PIXELS, &[Text(270, "ImageJ=1.54\nimages=300\nslices=300\n")]), "contains only one"),
        (file(2, &PIXELS, &[Text(270, "<OME><Pixels SizeZ=\"5\"/></OME>")]), "declares 5 slices"),
        (file(2, &PIXELS, &[Text(270, "<OME><Pixels SizeT=\"5\"/></OME>")]), "5 time points"),
        (file(2, &PIXELS, &[Text(270, "<OME><Pixels SizeT='5</OME>")]), "damaged OME-XML"),
    ];
    for (bytes, word) in cases {
        let error = read(&bytes, Some(DVec3::ONE)).expect_err(word);
        assert!(error.to_string().contains(word) && !error.remedy().is_empty(), "'{word}' is not in '{error}'");
    }
    let whole = file(2, &PIXELS, &[]);
    (4..whole.len()).for_each(|end| assert!(read(&whole[..end], Some(DVec3::ONE)).is_err(), "{end}"));
}

#[test]
fn pack_bits_repeat_and_copy() {
    // 3 literal bytes, nothing, one byte twice, and 3 literal bytes, the last of which is ignored
    let pixels = [2, 1, 2, 3, 128, 255, 4, 2, 5, 6, 7];
    let packed = [Number(259, 32773), Number(257, 3), Number(273, 8), Number(279, 11)];
    let bytes = [pixels, pixels].concat();
    let volume = read(&file(2, &bytes, &packed), Some(DVec3::ONE)).unwrap_or_else(|error| panic!("{error}"));
    assert_eq!(volume.voxels, Voxels::U8([[1, 2, 3, 4, 4, 5]; 2].concat()));
}

#[test]
fn a_folder_contains_slices_or_masks() {
    let folder = tempfile::tempdir().expect("folder");
    let write = |name: &str, bytes: &[u8]| std::fs::write(folder.path().join(name), bytes).expect("written");
    let read = |spacing| read_volume_with(folder.path(), &ReadOptions { spacing, ..ReadOptions::default() });
    write("a1.tif", &file(2, &PIXELS, &[]));
    write(".a0.tif", b"no volume");
    assert_eq!(read(Some(DVec3::ONE)).expect("one stack").voxels.len(), 8);
    write("a2.TIFF", &file(1, &PIXELS, &[]));
    let error = read(Some(DVec3::ONE)).expect_err("a stack among slices");
    assert!(error.to_string().contains("a1.tif: is one of 2 TIFF files"), "{error}");
    write("a1.tif", &file(1, &PIXELS[4..], &[]));
    write("a10.tif", &file(1, &PIXELS, &[]));
    let voxels = read(Some(DVec3::ONE)).expect("slices").voxels;
    assert_eq!(voxels, Voxels::U8(vec![5, 6, 7, 8, 1, 2, 3, 4, 1, 2, 3, 4]));
    assert!(read(None).expect_err("no spacing").remedy().contains("SPACING="));
    write("heart.nii.gz", b"");
    let error = read_volume(folder.path()).expect_err("both");
    assert!(error.to_string().contains("heart.nii.gz and a1.tif"), "{error}");
}
