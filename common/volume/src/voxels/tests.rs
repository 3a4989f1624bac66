//! Tests byte orders, labels and ranges.

use super::*;

#[test]
fn bytes_come_back_in_both_orders() {
    let all = [
        Voxels::I8(vec![-1, 2]),
        Voxels::U8(vec![255, 2]),
        Voxels::I16(vec![-300, 2]),
        Voxels::U16(vec![65_000, 2]),
        Voxels::I32(vec![-70_000, 2]),
        Voxels::U32(vec![4_000_000_000, 2]),
        Voxels::I64(vec![i64::MIN, 2]),
        Voxels::U64(vec![u64::MAX, 2]),
        Voxels::F32(vec![-1.5, 2.0]),
        Voxels::F64(vec![1e300, 2.0]),
    ];
    for voxels in all {
        for endian in [Endian::Little, Endian::Big] {
            let mut bytes = Vec::new();
            voxels.write_to(&mut bytes, endian).expect("written");
            assert_eq!(bytes.len(), 2 * voxels.scalar_type().bytes());
            let back = Voxels::read_from(&mut &bytes[..], voxels.scalar_type(), endian, 2).expect("read");
            assert_eq!(back, voxels);
            let error = Voxels::read_from(&mut &bytes[1..], voxels.scalar_type(), endian, 2).expect_err("short");
            assert_eq!(error.kind(), std::io::ErrorKind::UnexpectedEof);
        }
    }
}

#[test]
fn labels_are_whole_numbers() {
    assert_eq!(Voxels::F32(vec![2.0, 0.0, 2.0, -3.0]).label_set().expect("whole"), [-3, 0, 2]);
    assert_eq!(Voxels::U16(vec![7, 7, 1]).label_mask(&[7]), [true, true, false]);
    let background = Voxels::F32(vec![f32::NAN, 3.0, f32::NAN, 0.0]);
    assert_eq!((background.label_set().expect("whole"), background.nan_count()), (vec![0, 3], 2));
    assert_eq!(background.label_mask(&[0]), [true, false, true, true]);
    assert!(!Voxels::empty(ScalarType::U8).push_text("nan"));
    for bad in [1.5, f64::INFINITY, 1e300] {
        assert!(Voxels::F64(vec![0.0, bad]).label_set().is_err(), "{bad}");
    }
    assert!(Voxels::U64(vec![u64::MAX]).label_set().is_err());
}

#[test]
fn the_range_leaves_out_what_is_not_finite() {
    let voxels = Voxels::F32(vec![f32::NAN, -2.0, 5.0, f32::INFINITY]);
    assert_eq!(voxels.range(), Some((-2.0, 5.0)));
    assert_eq!(Voxels::F64(vec![f64::NAN]).range(), None);
}

#[test]
fn a_box_is_cut_out_in_place() {
    let size = [5, 4, 3];
    let values: Vec<i16> = (0..60).collect();
    for (first, to) in [([0, 0, 0], size), ([1, 2, 1], [3, 2, 2]), ([4, 3, 2], [1, 1, 1]), ([0, 0, 0], [5, 4, 1])] {
        let mut voxels = Voxels::I16(values.clone());
        voxels.crop(size, first, to);
        let at = |n: usize| [n % to[0] + first[0], n / to[0] % to[1] + first[1], n / (to[0] * to[1]) + first[2]];
        let expected = (0..to.iter().product()).map(at).map(|[i, j, k]| (k * 20 + j * 5 + i) as i16).collect();
        assert_eq!(voxels, Voxels::I16(expected), "{first:?} {to:?}");
    }
}

#[test]
fn ends_are_counted_from_the_start_of_the_range() {
    let labels = Voxels::U8(vec![9, 0, 0, 3, 3, 0, 4, 0, 9]);
    assert_eq!(labels.ends_of_labels(1..8, |label| label == 3 || label == 4), Some((2, 5)));
    assert_eq!(labels.ends_of_labels(3..5, |label| label == 3), Some((0, 1)));
    assert_eq!(labels.ends_of_labels(1..8, |label| label == 9), None);
    let values = Voxels::F64(vec![2.0, f64::NAN, 0.5, 0.7, -1.0]);
    assert_eq!(values.ends_of_values(0..5, |value| value > 0.4), Some((0, 3)));
    assert_eq!(values.ends_of_values(1..3, |value| value > 0.4), Some((1, 1)));
    assert_eq!(values.ends_of_values(4..5, |value| value > 0.4), None);
    // NaN counts as label 0; non-integers are not labels
    assert_eq!(values.ends_of_labels(0..5, |_| true), Some((0, 4)));
    assert_eq!(values.ends_of_labels(1..4, |_| true), Some((0, 0)));
}

#[test]
fn what_all_threads_read_of_a_file_is_what_one_reader_finds() {
    let folder = tempfile::tempdir().expect("folder");
    let path = folder.path().join("values.raw");
    let all = [
        Voxels::U8((0..2_200_001).map(|n| (n * 7 / 3) as u8).collect()),
        Voxels::I16((0..1_200_007).map(|n| (n * 11) as i16).collect()),
        Voxels::F64((0..300_003).map(|n| 1.0 / (f64::from(n) - 5.5)).collect()),
        Voxels::F32(Vec::new()),
    ];
    for voxels in all {
        for (endian, start) in [(Endian::Little, 0), (Endian::Big, 13)] {
            let mut bytes = vec![0xaa; start];
            voxels.write_to(&mut bytes, endian).expect("written");
            assert!(
                voxels.is_empty() || bytes.len() > 2 * CHUNK_BYTES && bytes.len() % CHUNK_BYTES != 0,
                "chunks and a part"
            );
            std::fs::write(&path, &bytes).expect("written");
            let read = |start: u64, count| Voxels::read_file(&path, start, voxels.scalar_type(), endian, count);
            assert_eq!(read(start as u64, voxels.len()).expect("read"), voxels);
            let error = read(start as u64, voxels.len() + 1).expect_err("one more than there are");
            assert_eq!(error.kind(), std::io::ErrorKind::UnexpectedEof);
            assert!(error.to_string().contains(&format!("{} of {}", voxels.len(), voxels.len() + 1)), "{error}");
            assert!(read(u64::MAX, 1).is_err() && read(0, usize::MAX).is_err());
        }
    }
}
