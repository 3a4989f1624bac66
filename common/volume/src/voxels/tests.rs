//! Bytes in both orders, labels, and ranges.

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
    for bad in [1.5, f64::NAN, f64::INFINITY, 1e300] {
        assert!(Voxels::F64(vec![0.0, bad]).label_set().is_err(), "{bad}");
    }
    assert!(Voxels::U64(vec![u64::MAX]).label_set().is_err());
    let error = Voxels::U8(vec![0, 1, 3]).check_labels(&[3, 4]).expect_err("4 is missing");
    assert!(error.what.contains('4') && error.next.contains("0, 1, 3"), "{error}");
}

#[test]
fn the_range_leaves_out_what_is_not_finite() {
    let voxels = Voxels::F32(vec![f32::NAN, -2.0, 5.0, f32::INFINITY]);
    assert_eq!(voxels.range(), Some((-2.0, 5.0)));
    assert_eq!(voxels.non_finite_count(), 2);
    assert_eq!(Voxels::F64(vec![f64::NAN]).range(), None);
}
