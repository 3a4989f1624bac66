use super::*;
use crate::geometry::Space;
use crate::image::Image;
use std::collections::BTreeMap;

/// Creates a grid that is rotated in the world frame. `lean` is the slope of its z axis towards y;
/// `others` are the slopes of its y and z axes towards x.
fn sheared(size: [usize; 3], lean: f64, others: [f64; 2]) -> Geometry {
    let turn = DMat3::from_axis_angle(DVec3::new(0.6, 0.0, 0.8), 0.7);
    let steps = [DVec3::X, DVec3::new(others[0], 1.0, 0.0), DVec3::new(others[1], lean, 1.0)];
    Geometry {
        directions: DMat3::from_cols(turn * steps[0], turn * steps[1].normalize(), turn * steps[2].normalize()),
        origin: DVec3::new(-40.0, 7.0, 120.0),
        space: Space::Lps,
        spacing: DVec3::from_array(steps.map(DVec3::length)),
        size,
    }
}

/// Evaluates a function of the world position at every voxel centre.
fn sampled<T: Copy + Send + Sync>(geometry: &Geometry, value: impl Fn(DVec3) -> T) -> Vec<T> {
    Image::sampled(geometry.clone(), |grid| value(geometry.grid_to_world(grid))).data
}

fn middle(geometry: &Geometry) -> DVec3 {
    geometry.grid_to_world(0.5 * geometry.upper_corner())
}

fn counts(voxels: &Voxels) -> BTreeMap<i64, usize> {
    let mut counts = BTreeMap::new();
    voxels.each_run(0..voxels.len(), |label, count| *counts.entry(label.expect("a label")).or_default() += count);
    counts
}

const TILT: f64 = 0.577_350_269; // 30 degrees

#[test]
fn shear_below_a_tenth_of_a_voxel_is_ignored() {
    for (lean, others, found) in [
        (0.0, [0.0, 0.0], None),
        (0.002, [0.002, -0.002], None),
        (0.003, [0.0, 0.0], Some(1)),
        (0.0, [-0.003, 0.0], Some(1)),
        (-0.5, [0.0, 0.2], Some(2)),
    ] {
        let shear = Shear::of(&sheared([40, 40, 40], lean, others));
        assert_eq!(shear.map(|shear| shear.passes.len()), found, "{lean} {others:?}");
    }
}

#[test]
fn the_new_grid_is_orthonormal_and_covers_the_old_one() {
    for mirror in [1.0, -1.0] {
        let mut old = sheared([9, 8, 7], -TILT, [0.3, 0.2]);
        old.directions.z_axis *= mirror;
        let shear = Shear::of(&old).expect("sheared");
        let new = &shear.geometry;
        let product = new.directions.transpose() * new.directions;
        assert!(product.abs_diff_eq(DMat3::IDENTITY, 1e-12) && new.is_left_handed() == old.is_left_handed());
        let volume = old.spacing.element_product() * old.directions.determinant().abs();
        assert!((new.spacing.element_product() - volume).abs() < 1e-12 * volume);
        for corner in 0..8 {
            let far = DVec3::from_array([0, 1, 2].map(|axis| f64::from(corner >> axis & 1)));
            let at = new.grid_to_index(new.world_to_grid(old.grid_to_world(far * old.upper_corner())));
            let last = new.grid_to_index(new.upper_corner());
            assert!(at.cmpge(DVec3::splat(-1e-9)).all() && at.cmple(last + 1e-9).all(), "{at} of {last}");
        }
    }
}

#[test]
fn labels_keep_their_voxels_and_roundness() {
    // a ball in index coordinates, whose 11,536 voxels of 1 mm^3 form an ellipsoid in the world
    // frame
    let old = sheared([40, 40, 40], TILT, [0.0, 0.0]);
    let ball = |index: DVec3| index.distance_squared(DVec3::splat(19.5)) <= 196.0;
    let mask = Image::sampled(old.clone(), |grid| u8::from(ball(old.grid_to_index(grid)))).data;
    let shear = Shear::of(&old).expect("sheared");
    assert!((shear.degrees - 30.0).abs() < 1e-6 && shear.geometry.size == [40, 63, 40]);
    let moved = shear.move_labels(&Voxels::U8(mask), Some(0));
    assert_eq!(counts(&moved)[&1], 11_536);
    let Voxels::U8(moved) = moved else { panic!("another type") };
    // measured: 126 voxels are on the wrong side of the ellipsoid; with rounding only, 310 would be
    let right = sampled(&shear.geometry, |world| u8::from(ball(old.grid_to_index(old.world_to_grid(world)))));
    let wrong = moved.iter().zip(&right).filter(|(a, b)| a != b).count();
    assert!(wrong < 150, "{wrong} voxels differ");
}

#[test]
fn labels_of_every_layer_and_thin_parts_stay() {
    let old = sheared([30, 26, 24], -0.8, [0.45, 0.3]);
    let centre = middle(&old);
    // shells and a core, which must nearly keep their voxel counts; a single voxel and a line with
    // one voxel per slice, which must keep theirs exactly
    let label = |world: DVec3| [-5i16, 300, 7, 0][((world.distance(centre) / 3.0) as usize).min(3)];
    let mut labels = sampled(&old, label);
    labels[old.linear(3, 3, 2)] = 42;
    (0..24).for_each(|k| labels[old.linear(28, 20, k)] = 9);
    let shear = Shear::of(&old).expect("sheared");
    let before = counts(&Voxels::I16(labels.clone()));
    let after = counts(&shear.move_labels(&Voxels::I16(labels), Some(0)));
    for (&label, &count) in before.iter().filter(|(label, _)| **label != 0) {
        let change = after[&label] as f64 / count as f64 - 1.0;
        assert!(change.abs() < if count > 100 { 0.01 } else { 1e-9 }, "{label}: {count} and {}", after[&label]);
    }
    assert_eq!(after.values().sum::<usize>(), shear.geometry.voxel_count());
}

#[test]
fn whole_shifts_move_values_as_they_are() {
    let old = sheared([5, 4, 3], 1.0, [0.0, -2.0]);
    let shear = Shear::of(&old).expect("sheared");
    assert_eq!(shear.geometry.size, [9, 6, 3]);
    let values: Vec<i32> = (1..=60).collect();
    let voxels = Voxels::I32(values.clone());
    let kept = |value: f64| (value != -1.0).then_some(value as i32);
    let labels: Vec<i32> = shear.move_labels(&voxels, Some(-1)).to_f64().into_iter().filter_map(kept).collect();
    let scan = shear.interpolate(&voxels, |_| -1.0);
    let scan: Vec<i32> = scan.into_iter().map(f64::from).filter_map(kept).collect();
    assert_eq!((&labels, &scan), (&values, &values));
    let open = shear.move_labels(&voxels, None);
    assert!(open.to_f64().iter().all(|label| *label > 0.0));
}

#[test]
fn polynomials_of_second_degree_are_interpolated_exactly() {
    let old = sheared([20, 18, 16], TILT, [0.25, -0.4]);
    let centre = middle(&old);
    let value = |world: DVec3| {
        let p = world - centre;
        (3.0 + p.x - 0.5 * p.y + 0.1 * p.x * p.y - 0.2 * p.z * p.z + 0.05 * p.y * p.y) as f32
    };
    let shear = Shear::of(&old).expect("sheared");
    let found = shear.interpolate(&Voxels::F32(sampled(&old, value)), |_| f32::NAN);
    let inner: Vec<f32> =
        found.iter().zip(sampled(&shear.geometry, value)).map(|(a, b)| (a - b).abs()).filter(|e| !e.is_nan()).collect();
    assert!(inner.len() > 2000, "{} voxels", inner.len());
    assert!(inner.iter().all(|error| *error < 1e-4), "{:?}", inner.iter().fold(0f32, |a, &b| a.max(b)));
}
