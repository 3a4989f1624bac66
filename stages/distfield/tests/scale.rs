//! Tests `--scale` against analytic solutions: large parts keep their position and volume, and
//! small parts vanish and are reported.

mod support;

use glam::DVec3;
use isoparticles_distfield::changes::Kind;
use isoparticles_distfield::crop::Grid;
use isoparticles_distfield::mask::Mask;
use isoparticles_distfield::occupancy::Occupancy;
use isoparticles_distfield::scale::{Scale, Scaled, edge_length, scaled};
use isoparticles_distfield::{Border, Inside, Keep};
use isoparticles_field::marching_cubes::marching_cubes;
use isoparticles_field::sizing::trilinear;
use isoparticles_mesh::measure::measure;
use isoparticles_volume::{Image, Voxels};
use support::{directions, sampled, topology, volume};

fn smoothed(inside: &Image<bool>, length: f64, keep_thin: bool) -> Scaled {
    let occupancy = Occupancy::of_mask(&Mask::from(inside));
    scaled(occupancy, Scale { length, keep_thin }, Keep::All, Grid::Volume)
        .expect("few parts")
        .expect("something is left")
}

#[test]
fn parts_that_keep_drops_are_not_reported_as_lost() {
    let [ball, speck] = [DVec3::new(12.0, 12.0, 12.0), DVec3::new(28.0, 12.0, 12.0)];
    let balls = |p: DVec3| (8.0 - p.distance(ball)).max(1.5 - p.distance(speck)) as f32;
    let image = sampled([36, 24, 24], DVec3::ONE, balls);
    let inside = Image { data: image.data.iter().map(|value| *value > 0.0).collect(), geometry: image.geometry };
    let lost = |keep: Keep| {
        let occupancy = Occupancy::of_mask(&Mask::from(&inside));
        let scale = Scale { length: 6.0, keep_thin: false };
        scaled(occupancy, scale, keep, Grid::Volume).expect("few parts").expect("the ball").changes.count(Kind::Gone)
    };
    assert_eq!([Keep::All, Keep::Volume(5.0), Keep::Volume(50.0), Keep::Largest].map(lost), [1, 1, 0, 0]);
}

/// Returns the level set with the sign of F: negative inside.
fn field(scaled: &Scaled) -> Image<f32> {
    Image { data: scaled.level.data.iter().map(|value| -value).collect(), geometry: scaled.level.geometry.clone() }
}

#[test]
fn a_ball_keeps_its_radius_on_any_spacing() {
    let (size, spacing) = ([48, 48, 36], DVec3::new(1.0, 1.0, 1.4));
    let (centre, radius) = (DVec3::new(24.3, 23.8, 24.9), 15.0);
    let inside = sampled(size, spacing, |p| (p - centre).length() < radius);
    for length in [3.0, 8.0, 14.0] {
        let found = smoothed(&inside, length, false);
        let ratio = (volume(&field(&found)) / found.changes.volume_before).cbrt();
        // at a constant level of 1/2, the radius would shrink by (sigma / radius)^2 to first order:
        // by 1, 7 and 22 %
        assert!((ratio - 1.0).abs() < 0.004, "scale {length}: {ratio} of the radius");
        // the radius is correct in all directions
        let level = |share: f64, way: DVec3| trilinear(&found.level, centre + share * radius * way);
        assert!(directions(500).all(|way| level(0.96, way) > 0.0 && level(1.04, way) < 0.0), "scale {length}");
        assert_eq!(found.changes.components, [1, 1]);
        assert_eq!(found.changes.euler, [1, 1]);
        assert!(found.changes.events.is_empty(), "{:?}", found.changes.events);
        // only voxels at the surface change sides
        assert!(found.changes.depth.max < 1.1, "{:?}", found.changes.depth);
    }
}

#[test]
fn a_plane_stays_where_the_volume_cuts_it() {
    let inside = sampled([30, 26, 28], DVec3::new(1.0, 1.2, 0.9), |p| p.z < 12.0);
    let found = smoothed(&inside, 7.0, false);
    assert_eq!(found.changes.voxels_changed, 0);
    // the level set is constant in each slice, even at the faces of the volume, and its zero lies
    // midway between two voxel centres
    for (k, slice) in found.level.data.chunks(30 * 26).enumerate() {
        assert!(slice.iter().all(|value| (value - slice[0]).abs() < 2e-5), "slice {k}");
    }
    let at = |k: usize| found.level.at(15, 13, k);
    let zero = (0..27).find(|&k| at(k) > 0.0 && at(k + 1) <= 0.0).map(|k| k as f32 + at(k) / (at(k) - at(k + 1)));
    assert!(zero.is_some_and(|zero| (zero - 13.5).abs() < 0.02), "{zero:?}");
}

#[test]
fn a_small_part_keeps_its_own_volume_beside_a_large_one() {
    let (large, small) = (DVec3::new(20.0, 20.0, 20.0), DVec3::new(48.0, 20.0, 20.0));
    let inside = sampled([60, 40, 40], DVec3::ONE, |p| (p - large).length() < 14.0 || (p - small).length() < 7.0);
    let found = smoothed(&inside, 6.0, false);
    assert_eq!(found.changes.components, [2, 2]);
    let small_before = inside.data.iter().enumerate().filter(|(n, inside)| n % 60 > 36 && **inside).count() as f64;
    let mut alone = field(&found);
    alone.data.iter_mut().enumerate().filter(|(n, _)| n % 60 <= 36).for_each(|(_, value)| *value = 1.0);
    assert!((volume(&alone) / small_before - 1.0).abs() < 0.03, "{} of {small_before}", volume(&alone));
}

#[test]
fn lost_and_merged_parts_are_reported_with_their_position() {
    let pair = |gap: f64| {
        let (a, b) = (DVec3::new(14.0, 16.0, 16.0), DVec3::new(34.0 + gap, 16.0, 16.0));
        let speck = DVec3::new(24.0, 28.0, 28.0);
        sampled([52, 34, 34], DVec3::ONE, move |p| {
            (p - a).length() < 10.0 || (p - b).length() < 10.0 || (p - speck).length() < 1.5
        })
    };
    let near = smoothed(&pair(1.0), 10.0, false);
    assert_eq!(near.changes.components, [3, 1]);
    assert_eq!((near.changes.counts[&Kind::Joined], near.changes.counts[&Kind::Gone]), (1, 1));
    let gone = near.changes.events.iter().find(|event| event.kind == Kind::Gone).expect("the speck");
    assert!(
        (DVec3::from_array(gone.place) - DVec3::new(24.0, 28.0, 28.0)).length() < 0.5 && gone.volume < 20.0,
        "{gone:?}"
    );
    assert_eq!(near.changes.events.iter().find(|event| event.kind == Kind::Joined).map(|event| event.pieces), Some(2));
    assert_eq!(smoothed(&pair(7.0), 4.0, false).changes.components, [3, 2]);
}

#[test]
fn keep_thin_preserves_a_thin_rod() {
    let (centre, axis) = (DVec3::new(14.0, 18.0, 18.0), DVec3::new(44.0, 18.0, 18.0));
    let inside = sampled([64, 36, 36], DVec3::ONE, |p| {
        (p - centre).length() < 9.0 || (p.y - axis.y).hypot(p.z - axis.z) < 2.8 && (p.x - axis.x).abs() < 14.0
    });
    let plain = smoothed(&inside, 9.0, false);
    assert_eq!(plain.changes.components, [2, 1]);
    let gone = &plain.changes.events[0];
    assert!(gone.kind == Kind::Gone && (DVec3::from_array(gone.place) - axis).length() < 0.6, "{gone:?}");
    let kept = smoothed(&inside, 9.0, true);
    assert_eq!(kept.changes.components, [2, 2]);
    assert_eq!(topology(&field(&kept)).components.len(), 2);
    // The rod keeps at least four fifths of its voxels (measured: 473 of 567); some are lost
    // because its ends become round.
    let rod = |holds: &dyn Fn(usize) -> bool| (0..inside.data.len()).filter(|&n| n % 64 > 26 && holds(n)).count();
    let (before, after) = (rod(&|n| inside.data[n]), rod(&|n| kept.level.data[n] > 0.0));
    assert!(after.abs_diff(before) * 5 < before, "{before} voxels before, {after} after");
}

#[test]
fn a_scalar_ball_keeps_its_radius_at_a_scale() {
    let centre = DVec3::splat(20.2);
    let ball = |p: DVec3| 13.0 - (p - centre).length();
    // the surroundings are very dark (very bright with the sign reversed), which must have no
    // effect on the radius
    let values =
        sampled([42; 3], DVec3::ONE, |p| ball(p).clamp(-3.0, 2.0) as f32 * if ball(p) < -2.0 { 1e4 } else { 1.0 });
    for inside in [Inside::Above, Inside::Below] {
        let sign = if inside == Inside::Above { 1.0 } else { -1.0 };
        let voxels = Voxels::F32(values.data.iter().map(|value| sign * value).collect());
        let occupancy = Occupancy::of_scalar(&voxels, &values.geometry, 0.0, inside);
        assert!((occupancy.volume() / (4.0 / 3.0 * std::f64::consts::PI * 13f64.powi(3)) - 1.0).abs() < 0.002);
        let found = scaled(occupancy, Scale { length: 7.0, keep_thin: false }, Keep::All, Grid::Volume)
            .expect("few parts")
            .expect("a ball");
        let radius = (volume(&field(&found)) * 0.75 / std::f64::consts::PI).cbrt();
        assert!((radius - 13.0).abs() < 0.05, "{radius}");
    }
}

#[test]
fn edge_length_matches_the_area_of_a_ball() {
    let centre = DVec3::new(30.0, 30.0, 30.0);
    let ball = Occupancy::of_mask(&Mask::from(&sampled([40, 40, 60], DVec3::new(1.5, 1.5, 1.0), |p| {
        (p - centre).length() < 22.0
    })));
    for vertices in [200.0, 2000.0, 8000.0] {
        let want = (2.0 * 4.0 * std::f64::consts::PI * 22.0 * 22.0 / (3f64.sqrt() * vertices)).sqrt();
        let found = edge_length(&ball, Border::Cap, vertices, false).expect("few parts").expect("a ball");
        assert!((found / want - 1.0).abs() < 0.02, "{vertices}: {found}, not {want}");
    }
    let nothing = Occupancy::of_mask(&Mask::from(&sampled([8; 3], DVec3::ONE, |_| false)));
    assert_eq!(edge_length(&nothing, Border::Cap, 100.0, false).expect("no parts"), None);
}

#[test]
fn edge_length_includes_the_cap_area_at_closed_borders() {
    // the upper half of a ball; a closed border adds a disc half a voxel below the voxel centres of
    // the first slice
    let half = Occupancy::of_mask(&Mask::from(&sampled([60, 60, 40], DVec3::ONE, |p| {
        (p - DVec3::new(30.0, 30.0, -0.5)).length() < 20.0
    })));
    let vertices = 1000.0;
    for (border, discs) in [(Border::Open, 2.0), (Border::Cap, 3.0)] {
        let want = (2.0 * discs * std::f64::consts::PI * 20.0 * 20.0 / (3f64.sqrt() * vertices)).sqrt();
        let found = edge_length(&half, border, vertices, false).expect("few parts").expect("half a ball");
        assert!((found / want - 1.0).abs() < 0.02, "{border:?}: {found}, not {want}");
    }
}

#[test]
fn edge_length_gives_the_vertex_count_despite_lost_area() {
    // rods of several radii: thinner rods vanish before thicker rods as the scale grows
    let rods: Vec<(f64, f64, f64)> = (0..6)
        .flat_map(|i| {
            (0..6).map(move |j| {
                (10.0 + 12.0 * f64::from(i), 10.0 + 12.0 * f64::from(j), 1.5 + 0.6 * f64::from((5 * i + j) % 6))
            })
        })
        .collect();
    let object = sampled([80, 80, 60], DVec3::ONE, |p| {
        (p.z - 30.0).abs() < 20.0 && rods.iter().any(|&(x, y, radius)| (p.x - x).hypot(p.y - y) < radius)
    });
    let occupancy = Occupancy::of_mask(&Mask::from(&object));
    for vertices in [500.0, 1000.0, 2000.0, 4000.0, 8000.0] {
        let length = edge_length(&occupancy, Border::Cap, vertices, false).expect("few parts").expect("rods");
        let area = measure(&marching_cubes(&smoothed(&object, 1.6 * length, false).level, 0.0)).area;
        let have = 2.0 * area / (3f64.sqrt() * length * length);
        assert!((have / vertices - 1.0).abs() < 0.1, "{vertices}: {have} with edges of {length}");
    }
}
