//! Tests folders of masks against voxels that are computed directly.

use super::*;
use crate::geometry::Space;
use crate::nrrd::{Encoding, write_nrrd};
use crate::read::{ReadOptions, read_volume, read_volume_with};

fn grid(size: [usize; 3], spacing: f64, origin: f64) -> Geometry {
    let origin = DVec3::splat(origin);
    Geometry { origin, space: Space::Lps, ..Geometry::axis_aligned(size, DVec3::splat(spacing)) }
}

fn folder_of(masks: &[(&str, &Geometry, Voxels)]) -> tempfile::TempDir {
    let folder = tempfile::tempdir().expect("folder");
    std::fs::write(folder.path().join("statistics.json"), "{}").expect("written");
    std::fs::write(folder.path().join("._heart.nrrd"), "resource fork").expect("written");
    for (name, geometry, voxels) in masks {
        write_nrrd(&folder.path().join(name), geometry, voxels, Encoding::Gzip).expect("written");
    }
    folder
}

fn bytes(geometry: &Geometry, inside: impl Fn(DVec3) -> bool) -> Voxels {
    Voxels::U8((0..geometry.voxel_count()).map(|n| u8::from(inside(world(geometry, n)))).collect())
}

fn world(geometry: &Geometry, voxel: usize) -> DVec3 {
    geometry.grid_to_world(geometry.node_to_grid(voxel))
}

/// Returns the voxels of a segment.
fn mask(volume: &Volume, name: &str) -> Vec<bool> {
    volume.label_mask(&[volume.segment_named(name).expect(name)])
}

fn expected(geometry: &Geometry, inside: impl Fn(DVec3) -> bool) -> Vec<bool> {
    (0..geometry.voxel_count()).map(|n| inside(world(geometry, n))).collect()
}

#[test]
fn masks_that_overlap_keep_all_their_voxels() {
    let grid = grid([9, 8, 7], 1.5, -3.0);
    let ball = |centre: f64, radius: f64| move |p: DVec3| p.distance(DVec3::splat(centre)) < radius;
    let (heart, lung, rib) = (ball(1.0, 3.0), ball(3.0, 3.5), ball(-3.0, 0.5));
    let share = |p: DVec3| (0.85 - 0.1 * p.distance(DVec3::splat(3.0))).max(0.0) as f32;
    let shares = (0..grid.voxel_count()).map(|n| share(world(&grid, n))).collect();
    let Voxels::U8(rib_voxels) = bytes(&grid, rib) else { unreachable!() };
    let folder = folder_of(&[
        ("Heart.nrrd", &grid, bytes(&grid, heart)),
        ("lung.left.seg.nrrd", &grid, Voxels::F32(shares)),
        ("rib.nrrd", &grid, Voxels::I16(rib_voxels.iter().map(|&inside| 255 * i16::from(inside)).collect())),
        ("spleen.nrrd", &grid, bytes(&grid, |_| false)),
    ]);
    let volume = read_volume(folder.path()).expect("masks");
    assert_eq!(volume.geometry, read_volume(&folder.path().join("rib.nrrd")).expect("a mask").geometry);
    assert_eq!(mask(&volume, "Heart"), expected(&grid, heart));
    assert_eq!(mask(&volume, "lung.left"), expected(&grid, |p| p.distance(DVec3::splat(3.0)) <= 3.5));
    assert_eq!(mask(&volume, "rib"), expected(&grid, rib));
    assert_eq!(mask(&volume, "lung.left"), expected(&grid, lung), "no centre is on the sphere");
    let layers: Vec<usize> = volume.segments.iter().map(|segment| segment.at.layer).collect();
    assert_eq!(layers, [0, 1, 0, 0], "only masks that overlap are in different layers");
    assert_eq!(volume.remarks, ["1 of 4 masks are empty: spleen"]);
    std::fs::write(folder.path().join("kidney.npy"), "").expect("written");
    let remarks = read_volume(folder.path()).expect("read").remarks;
    assert!(remarks[1].ends_with("are not supported: kidney.npy"), "{remarks:?}");
}

#[test]
fn masks_are_resampled_to_the_finest_grid() {
    // each voxel of the coarse grid contains eight of the fine grid, which covers a part of it
    let (fine, coarse) = (grid([8, 8, 4], 1.0, 0.0), grid([6, 6, 6], 2.0, -1.5));
    let whole = grid([12, 12, 12], 1.0, -2.0);
    let is_low = |p: DVec3| p.x + 2.0 * p.y + 3.0 * p.z < 20.2;
    let nearest = |p: DVec3| DVec3::splat(-1.5) + 2.0 * ((p + 1.5) / 2.0).round();
    let mut turned = coarse.clone();
    turned.directions = DMat3::from_cols(DVec3::NEG_Y, DVec3::NEG_X, DVec3::Z);
    turned.origin = DVec3::new(8.5, 8.5, -1.5);
    for (a, b) in [("a.nrrd", "b.nrrd"), ("b.nrrd", "a.nrrd")] {
        let folder = folder_of(&[
            (a, &fine, bytes(&fine, |p| p.x < 3.5)),
            (b, &coarse, bytes(&coarse, is_low)),
            ("turned.nrrd", &turned, bytes(&turned, is_low)),
        ]);
        let volume = read_volume(folder.path()).expect("masks");
        assert_eq!((volume.geometry.size, volume.geometry.origin), (whole.size, whole.origin));
        assert_eq!(mask(&volume, &b[..1]), expected(&whole, |p| is_low(nearest(p))));
        assert_eq!(mask(&volume, "turned"), mask(&volume, &b[..1]));
        let in_fine = |p: DVec3| p.min_element() >= 0.0 && p.x < 3.5 && p.y < 7.5 && p.z < 3.5;
        assert_eq!(mask(&volume, &a[..1]), expected(&whole, in_fine));
        assert!(volume.remarks[0].contains("12 x 12 x 12 voxels"), "{:?}", volume.remarks);
    }
    // halfway between two voxels, all positions take the same side
    let odd = Geometry { origin: DVec3::splat(0.1), ..grid([9, 9, 9], 0.3, 0.0) };
    let even = Geometry { origin: DVec3::splat(0.1), ..grid([5, 5, 5], 0.6, 0.0) };
    let folder =
        folder_of(&[("odd.nrrd", &odd, bytes(&odd, |_| true)), ("even.nrrd", &even, bytes(&even, |p| p.x > 1.0))]);
    let volume = read_volume(folder.path()).expect("masks");
    assert_eq!(mask(&volume, "even"), expected(&volume.geometry, |p| p.x > 0.9));
}

#[test]
fn folders_that_are_not_masks_are_refused() {
    let lps = grid([3, 3, 3], 1.0, 0.0);
    let unnamed = Geometry { space: Space::Unnamed, ..lps.clone() };
    let one = || bytes(&lps, |p| p.x > 0.5);
    let refused = |masks: &[(&str, &Geometry, Voxels)], series: Option<&str>| {
        let folder = folder_of(masks);
        let error =
            read_volume_with(folder.path(), &ReadOptions { series, ..ReadOptions::default() }).expect_err("refused");
        [error.to_string(), error.reason(), error.remedy()].join("; ")
    };
    let labels = Voxels::I32((0..27).collect());
    for (masks, series, told) in [
        (&[("a.nrrd", &lps, one()), ("b.nrrd", &unnamed, one())][..], None, "b.nrrd: is not in the same space"),
        (
            &[("a.nrrd", &lps, one()), ("ct.nrrd", &lps, labels)],
            None,
            "ct.nrrd: is not a mask; it contains values from 0 to 26",
        ),
        (&[("a.nrrd", &lps, Voxels::F32(vec![-0.5; 27]))], None, "values from -0.5 to -0.5"),
        (&[("a.nrrd", &lps, one()), ("a.seg.nrrd", &lps, one())], None, "contains two masks of 'a'"),
        (&[("a.nrrd", &lps, one())], Some("3"), "has no series, and '3' was requested"),
        (&[], None, "is a folder without DICOM files, TIFF files or masks"),
    ] {
        let error = refused(masks, series);
        assert!(error.contains(told), "{error}");
    }
}
