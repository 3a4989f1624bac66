//! Tests which DICOM series can be read as volumes and which are rejected. The test files are
//! written with dicom-rs.

use super::*;
use crate::error::Error;
use crate::geometry::Space;
use crate::read::{ReadOptions, read_volume, read_volume_with};
use crate::voxels::Voxels;
use dicom_core::{DataElement, PrimitiveValue, VR};
use dicom_dictionary_std::tags;
use dicom_object::{FileMetaTableBuilder, InMemDicomObject, Tag};
use glam::DVec3;
use std::collections::BTreeMap;

/// The elements of a DICOM file.
type Elements = BTreeMap<Tag, (VR, PrimitiveValue)>;

fn texts(elements: &mut Elements, vr: VR, all: &[(Tag, &str)]) {
    elements.extend(all.iter().map(|&(tag, text)| (tag, (vr, PrimitiveValue::from(text)))));
}

fn numbers(elements: &mut Elements, all: &[(Tag, u16)]) {
    elements.extend(all.iter().map(|&(tag, number)| (tag, (VR::US, PrimitiveValue::from(number)))));
}

/// Creates a slice of 3 x 2 pixels with 16 bits allocated and 12 bits stored per pixel. The pixel
/// spacing is 0.5 mm within a row (along x) and 0.75 mm within a column (along y).
fn slice(position: DVec3, pixels: [u16; 6]) -> Elements {
    let mut elements = Elements::new();
    let place = position.to_array().map(|number| number.to_string()).join("\\");
    texts(&mut elements, VR::UI, &[(tags::SERIES_INSTANCE_UID, "1.2.3")]);
    texts(&mut elements, VR::LO, &[(tags::SERIES_DESCRIPTION, "Thorax 1.0")]);
    texts(&mut elements, VR::IS, &[(tags::SERIES_NUMBER, "7")]);
    texts(&mut elements, VR::CS, &[(tags::MODALITY, "CT"), (tags::PHOTOMETRIC_INTERPRETATION, "MONOCHROME2")]);
    let decimals = [
        (tags::IMAGE_ORIENTATION_PATIENT, "1\\0\\0\\0\\1\\0"),
        (tags::IMAGE_POSITION_PATIENT, &place),
        (tags::PIXEL_SPACING, "0.75\\0.5"),
    ];
    texts(&mut elements, VR::DS, &decimals);
    let whole = [
        (tags::ROWS, 2),
        (tags::COLUMNS, 3),
        (tags::SAMPLES_PER_PIXEL, 1),
        (tags::BITS_ALLOCATED, 16),
        (tags::BITS_STORED, 12),
        (tags::HIGH_BIT, 11),
        (tags::PIXEL_REPRESENTATION, 0),
    ];
    numbers(&mut elements, &whole);
    elements.insert(tags::PIXEL_DATA, (VR::OW, PrimitiveValue::U16(pixels.as_slice().into())));
    elements
}

fn write(path: &Path, elements: &Elements) {
    let all = elements.iter().map(|(&tag, (vr, value))| DataElement::new(tag, *vr, value.clone()));
    let meta = FileMetaTableBuilder::new()
        .transfer_syntax("1.2.840.10008.1.2.1")
        .media_storage_sop_class_uid("1.2.840.10008.5.1.4.1.1.2")
        .media_storage_sop_instance_uid("1.2.3.4");
    InMemDicomObject::from_element_iter(all).with_meta(meta).expect("a file").write_to_file(path).expect("written");
}

/// Creates three slices that are 2.5 mm apart, in descending order of z.
fn stack() -> Vec<Elements> {
    (0..3u16)
        .map(|n| {
            slice(
                DVec3::new(-10.0, 20.0, 5.0 - 2.5 * f64::from(n)),
                [0, 1, 2, 3, 4, 5].map(|pixel| pixel + 10 * (2 - n)),
            )
        })
        .collect()
}

fn folder_of(slices: &[Elements]) -> tempfile::TempDir {
    let folder = tempfile::tempdir().expect("folder");
    for (n, elements) in slices.iter().enumerate() {
        write(&folder.path().join(format!("slice{n}.dcm")), elements);
    }
    std::fs::write(folder.path().join("readme.txt"), "no slice").expect("written");
    folder
}

#[test]
fn slices_are_sorted_by_their_place() {
    let folder = folder_of(&stack());
    let volume = read_volume(folder.path()).expect("a volume");
    let expected: Vec<i16> = (0..3).flat_map(|n| (0..6).map(move |pixel| pixel + 10 * n)).collect();
    assert_eq!(volume.voxels, Voxels::I16(expected));
    let geometry = &volume.geometry;
    assert_eq!((geometry.size, geometry.space), ([3, 2, 3], Space::Lps));
    assert_eq!((geometry.spacing, geometry.origin), (DVec3::new(0.5, 0.75, 2.5), DVec3::new(-10.0, 20.0, 0.0)));
    assert!(!geometry.is_left_handed() && volume.remarks.is_empty());
    assert!(isoparticles_file::history::hash_file(folder.path()).is_ok());
}

#[test]
fn slope_intercept_sign_and_overlay_bits() {
    let with = |slope: &str, intercept: &str, signed: u16| -> Volume {
        let mut slices = stack();
        for elements in &mut slices {
            texts(elements, VR::DS, &[(tags::RESCALE_SLOPE, slope), (tags::RESCALE_INTERCEPT, intercept)]);
            numbers(elements, &[(tags::PIXEL_REPRESENTATION, signed)]);
            // the four highest bits contain an overlay, which must not affect the values
            let pixels = [0xf000u16, 0x0001, 0x0fff, 0x0800, 0x07ff, 0x1002];
            elements.insert(tags::PIXEL_DATA, (VR::OW, PrimitiveValue::U16(pixels.as_slice().into())));
        }
        read_volume(folder_of(&slices).path()).expect("a volume")
    };
    let first = |volume: &Volume| volume.voxels.to_f64()[..6].to_vec();
    let hounsfield = with("1", "-1024", 0);
    assert_eq!(hounsfield.voxels.type_name(), "int16");
    assert_eq!(first(&hounsfield), [-1024.0, -1023.0, 3071.0, 1024.0, 1023.0, -1022.0]);
    assert!(hounsfield.remarks[0].contains("stored value * 1 + -1024"));
    assert_eq!(first(&with("1", "0", 1)), [0.0, 1.0, -1.0, -2048.0, 2047.0, 2.0]);
    let dose = with("0.5", "0.25", 0);
    assert_eq!(dose.voxels.type_name(), "float32");
    assert_eq!(first(&dose), [0.25, 0.75, 2047.75, 1024.25, 1023.75, 1.25]);
}

#[test]
fn a_tilted_gantry_shears_the_grid() {
    let mut slices = stack();
    for (n, elements) in slices.iter_mut().enumerate() {
        texts(
            elements,
            VR::DS,
            &[(tags::IMAGE_POSITION_PATIENT, &format!("0\\{}\\{}", 0.5 * n as f64, 2.0 * n as f64))],
        );
    }
    let geometry = read_volume(folder_of(&slices).path()).expect("a volume").geometry;
    let last = geometry.grid_to_world(DVec3::Z * geometry.upper_corner().z);
    assert!(last.abs_diff_eq(DVec3::new(0.0, 1.0, 4.0), 1e-12), "{last}");
}

#[test]
fn one_of_several_series_is_chosen_by_name_number_or_uid() {
    let mut slices = stack();
    for mut elements in stack() {
        texts(&mut elements, VR::UI, &[(tags::SERIES_INSTANCE_UID, "1.2.9")]);
        texts(&mut elements, VR::LO, &[(tags::SERIES_DESCRIPTION, "Lung, sharp")]);
        texts(&mut elements, VR::IS, &[(tags::SERIES_NUMBER, "8")]);
        slices.push(elements);
    }
    let folder = folder_of(&slices);
    let error = read_volume(folder.path()).expect_err("two series");
    assert!(
        error.to_string().contains("2 series")
            && error.remedy().contains("'Lung, sharp' (CT, number 8, 3 files, UID 1.2.9)"),
        "{error}"
    );
    let choose =
        |series: &str| read_volume_with(folder.path(), &ReadOptions { series: Some(series), ..ReadOptions::default() });
    for name in ["lung, SHARP", "8", "1.2.9"] {
        let volume = choose(name).expect(name);
        assert_eq!(volume.geometry.size, [3, 2, 3]);
        assert!(volume.remarks[0].contains("left out: '") && volume.remarks.len() == 1, "{:?}", volume.remarks);
    }
    let error = choose("abdomen").expect_err("not there");
    assert!(error.to_string().contains("no series 'abdomen'") && error.remedy().contains("Thorax 1.0"), "{error}");
}

/// Returns the CT slices of [`stack`] and two additional images: a colour picture and a multi-frame
/// segmentation.
fn mixed() -> Vec<Elements> {
    let mut slices = stack();
    let mut picture = slices[0].clone();
    texts(&mut picture, VR::UI, &[(tags::SERIES_INSTANCE_UID, "1.2.99")]);
    texts(&mut picture, VR::LO, &[(tags::SERIES_DESCRIPTION, "screen")]);
    numbers(&mut picture, &[(tags::SAMPLES_PER_PIXEL, 3)]);
    picture.remove(&tags::IMAGE_POSITION_PATIENT);
    let mut frames = slices[0].clone();
    texts(&mut frames, VR::UI, &[(tags::SERIES_INSTANCE_UID, "1.2.100")]);
    texts(&mut frames, VR::CS, &[(tags::MODALITY, "SEG")]);
    texts(&mut frames, VR::IS, &[(tags::NUMBER_OF_FRAMES, "19"), (tags::SERIES_NUMBER, "300")]);
    slices.extend([picture, frames]);
    slices
}

#[test]
fn series_that_are_not_volumes_do_not_prevent_reading() {
    let expected = read_volume(folder_of(&stack()).path()).expect("a volume");
    let folder = folder_of(&mixed());
    for series in [None, Some("thorax 1.0"), Some("7"), Some("1.2.3")] {
        let volume = read_volume_with(folder.path(), &ReadOptions { series, ..ReadOptions::default() })
            .unwrap_or_else(|error| panic!("{error}"));
        assert_eq!((&volume.voxels, &volume.geometry), (&expected.voxels, &expected.geometry), "{series:?}");
        let remarks = volume.remarks.join("; ");
        assert!(volume.remarks.len() == 2 && remarks.contains("'screen' (CT, number 7"), "{remarks}");
        assert!(remarks.contains("(SEG, number 300") && remarks.contains("19 frames"), "{remarks}");
    }
    let error = read_volume_with(folder.path(), &ReadOptions { series: Some("300"), ..ReadOptions::default() })
        .expect_err("a segmentation");
    assert!(error.to_string().contains("contains 19 frames"), "{error}");
    // a single slice, such as a localizer, is not a stack, so the choice remains unambiguous
    let mut slices = stack();
    let mut localizer = slices[0].clone();
    texts(&mut localizer, VR::UI, &[(tags::SERIES_INSTANCE_UID, "1.2.4")]);
    slices.push(localizer);
    assert_eq!(read_volume(folder_of(&slices).path()).expect("a volume").voxels, expected.voxels);
}

#[test]
fn files_without_preamble_or_file_group_are_read() {
    let expected = read_volume(folder_of(&stack()).path()).expect("a volume");
    // remove only the preamble, then the letters DICM as well, then the file meta group as well
    for kept in ["DICM", "group", "data set"] {
        let folder = folder_of(&stack());
        for n in 0..3 {
            let path = folder.path().join(format!("slice{n}.dcm"));
            let bytes = std::fs::read(&path).expect("bytes");
            let group_length = u32::from_le_bytes(bytes[140..144].try_into().expect("four"));
            let from = match kept {
                "DICM" => 128,
                "group" => 132,
                _ => 144 + group_length as usize,
            };
            std::fs::write(&path, &bytes[from..]).expect("written");
        }
        let volume = read_volume(folder.path()).unwrap_or_else(|error| panic!("{kept}: {error}"));
        assert_eq!(volume, expected, "{kept}");
        let error = read_volume(&folder.path().join("slice0.dcm")).expect_err("one file");
        assert!(matches!(error, Error::NotAVolume { content: crate::error::Content::DicomSlice, .. }), "{error}");
    }
}

#[test]
fn an_uneven_stack_within_a_tenth_of_its_distance_is_read() {
    let at = |middle: f64| {
        let mut slices = stack();
        texts(&mut slices[1], VR::DS, &[(tags::IMAGE_POSITION_PATIENT, &format!("-10\\20\\{middle}"))]);
        read_volume(folder_of(&slices).path())
    };
    for (middle, told) in [(2.5, None), (2.52, None), (2.5325, Some("1.3 %")), (2.7, Some("8.0 %"))] {
        let volume = at(middle).unwrap_or_else(|error| panic!("{error}"));
        assert_eq!(volume.geometry.spacing.z, 2.5);
        let remarks = volume.remarks.join("; ");
        assert_eq!(remarks.contains("unevenly spaced"), told.is_some(), "{middle}: {remarks}");
        assert!(told.is_none_or(|told| remarks.contains(told)), "{middle}: {remarks}");
    }
    assert!(at(2.8).expect_err("12 %").to_string().contains("unevenly spaced"));
}

/// An expected part of the error message, and the modification of a valid stack that causes the
/// error.
type Fault = (&'static str, fn(&mut Vec<Elements>));

#[test]
fn what_is_no_stack_is_refused_with_the_place() {
    let faults: [Fault; 11] = [
        ("lacks 1 of its slices between", |slices| {
            let place = "-10\\20\\-2.5";
            let mut far = slices[0].clone();
            texts(&mut far, VR::DS, &[(tags::IMAGE_POSITION_PATIENT, place)]);
            let mut next = slices[0].clone();
            texts(&mut next, VR::DS, &[(tags::IMAGE_POSITION_PATIENT, "-10\\20\\-5")]);
            slices.extend([far, next]);
            slices.remove(1);
        }),
        ("unevenly spaced", |slices| {
            texts(&mut slices[1], VR::DS, &[(tags::IMAGE_POSITION_PATIENT, "-10\\20\\3")]);
        }),
        ("same position", |slices| slices.push(slices[1].clone())),
        ("away from its regular position", |slices| {
            texts(&mut slices[1], VR::DS, &[(tags::IMAGE_POSITION_PATIENT, "-9\\20\\2.5")]);
        }),
        ("in orientation or pixel spacing", |slices| {
            texts(&mut slices[1], VR::DS, &[(tags::IMAGE_ORIENTATION_PATIENT, "1\\0\\0\\0\\0\\1")]);
        }),
        ("flat image", |slices| slices.truncate(1)),
        ("has no ImagePositionPatient", |slices| drop(slices[2].remove(&tags::IMAGE_POSITION_PATIENT))),
        ("has 3 values per pixel", |slices| numbers(&mut slices[0], &[(tags::SAMPLES_PER_PIXEL, 3)])),
        ("contains 40 frames", |slices| texts(&mut slices[0], VR::IS, &[(tags::NUMBER_OF_FRAMES, "40")])),
        ("bytes of pixels, but needs 12", |slices| {
            slices[0].insert(tags::PIXEL_DATA, (VR::OW, PrimitiveValue::U16([1, 2].as_slice().into())));
        }),
        ("none with an image", |slices| slices.iter_mut().for_each(|slice| drop(slice.remove(&tags::ROWS)))),
    ];
    for (says, fault) in faults {
        let mut slices = stack();
        fault(&mut slices);
        let error = read_volume(folder_of(&slices).path()).expect_err(says);
        assert!(error.to_string().contains(says), "'{says}' is not in: {error}");
        assert!(!error.reason().is_empty() && !error.remedy().is_empty());
    }
}

#[test]
fn a_file_cut_short_anywhere_is_an_error() {
    let folder = folder_of(&stack());
    let path = folder.path().join("slice1.dcm");
    let whole = std::fs::read(&path).expect("bytes");
    // a file cut within the preamble or the letters DICM is not detected as DICOM
    for length in source::START..whole.len() {
        std::fs::write(&path, &whole[..length]).expect("cut");
        let error = read_volume(folder.path()).expect_err("cut short");
        assert!(!error.reason().is_empty() && !error.remedy().is_empty(), "cut to {length} bytes: {error}");
    }
}

#[test]
fn folders_and_single_files_say_what_to_give() {
    let folder = folder_of(&stack());
    let error = read_volume(&folder.path().join("slice0.dcm")).expect_err("one file");
    assert!(error.remedy().contains("folder"), "{error}");
    let outer = tempfile::tempdir().expect("folder");
    std::fs::create_dir(outer.path().join("series7")).expect("made");
    let error = read_volume(outer.path()).expect_err("no slices");
    assert!(error.remedy().contains("series7"), "{error}");
}
