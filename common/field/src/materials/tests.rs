//! Tests of indicators with known strata: nested balls, sectors of a ball, and four regions of a
//! cube. The indicators are given as functions and as samples.

use super::*;
use crate::random::uniform;
use crate::spline::CubicSpline;
use glam::DVec3;
use isoparticles_volume::{Geometry, Image};
use std::collections::BTreeMap;

pub(super) const IDS: [MaterialId; 4] = [MaterialId(0), MaterialId(1), MaterialId(2), MaterialId(3)];

/// A ball of radius 5 mm within a ball of radius 9 mm. The outside surrounds both.
pub(super) fn nested(centre: DVec3) -> Analytic {
    let shell = maximum(ball(centre, 9.0), negative(ball(centre, 5.0)));
    Analytic::new(vec![negative(ball(centre, 9.0)), shell, ball(centre, 5.0)], 1.0)
}

/// A ball of radius 8 mm, divided into three sectors of 120 degrees around the z axis through its
/// centre. The outside surrounds the ball.
pub(super) fn sectors(centre: DVec3) -> Analytic {
    let normal =
        |turns: f64| DVec3::new(-(turns * std::f64::consts::TAU).sin(), (turns * std::f64::consts::TAU).cos(), 0.0);
    let sector = |n: f64| {
        let wedge = maximum(half_space(centre, -normal(n / 3.0)), half_space(centre, normal((n + 1.0) / 3.0)));
        maximum(ball(centre, 8.0), wedge)
    };
    Analytic::new(vec![negative(ball(centre, 8.0)), sector(0.1), sector(1.1), sector(2.1)], 1.0)
}

/// Four regions that meet at a point, each around the direction to a corner of a tetrahedron.
pub(super) fn corners(point: DVec3) -> Analytic {
    let ways = [DVec3::ONE, DVec3::new(1.0, -1.0, -1.0), DVec3::new(-1.0, 1.0, -1.0), DVec3::new(-1.0, -1.0, 1.0)];
    let region = |own: DVec3| {
        let planes = ways.into_iter().filter(|way| *way != own).map(|way| half_space(point, (way - own).normalize()));
        planes.reduce(maximum).expect("three planes")
    };
    Analytic::new(ways.map(region).into(), 1.0)
}

/// Balls of different sizes whose surfaces all pass through a point. At this point, their
/// indicators are smooth and equal.
fn balls(point: DVec3) -> Analytic {
    let ball_towards = |x: f64, y: f64, z: f64| ball(point + DVec3::new(x, y, z), DVec3::new(x, y, z).length());
    let four = [(7.0, 6.0, 8.0), (9.0, -8.0, -6.0), (-6.0, 9.0, -9.0), (-8.0, -7.0, 7.0)];
    Analytic::new(four.map(|(x, y, z)| ball_towards(x, y, z)).into(), 1.0)
}

/// Samples the indicators on a cube with an edge length of 24 mm, at nodes `spacing` mm apart.
pub(super) fn sampled(analytic: &Analytic, spacing: f64) -> Materials {
    let nodes = (24.0 / spacing).round() as usize + 1;
    let geometry = Geometry::axis_aligned([nodes; 3], DVec3::splat(spacing));
    let of = |id: MaterialId| {
        let image = Image::sampled(geometry.clone(), |p| analytic.jet(id, p).value as f32);
        let (indicator, negative) = Indicator::new(&image, [0; 3], geometry.size, false);
        (Material { name: format!("m{}", id.0), labels: Vec::new() }, indicator, negative)
    };
    let materials = analytic.ids().map(of).collect();
    Materials::new(geometry, materials).expect("parts of one grid")
}

fn place(n: u64) -> DVec3 {
    24.0 * DVec3::new(uniform(3, 0, n), uniform(3, 1, n), uniform(3, 2, n))
}

pub(super) const CENTRE: DVec3 = DVec3::new(12.1, 11.8, 12.3);

#[test]
fn the_smallest_indicator_names_the_material() {
    for analytic in [nested(CENTRE), sectors(CENTRE), corners(CENTRE)] {
        let materials = sampled(&analytic, 0.75);
        let mut near_several = 0;
        for p in (0..5000).map(place) {
            let (truth, found) = (analytic.near(p), materials.near(p));
            assert_eq!(analytic.material_at(p), truth.first().expect("some"));
            // away from interfaces, the error of the spline is too small to change the material
            if truth.interface_distance() > 0.4 {
                assert_eq!(materials.material_at(p), analytic.material_at(p), "at {p}: {found:?} {truth:?}");
            }
            near_several += usize::from(found.entries().len() > 1);
            assert!(found.entries().is_sorted_by(|a, b| (a.1, a.0) < (b.1, b.0)));
            for &(id, value) in found.entries() {
                let (own, gradient) = materials.value_gradient(id, p);
                assert_eq!(own, value);
                let jet = materials.jet(id, p);
                assert!(jet.value == value || (jet.value - value).abs() < 1e-12);
                assert!((jet.gradient - gradient).length() < 1e-12);
            }
        }
        assert!(near_several > 300, "{near_several}");
    }
}

#[test]
fn indicators_are_known_wherever_their_border_is_near() {
    let analytic = nested(CENTRE);
    let materials = sampled(&analytic, 0.75);
    let spline = |id: MaterialId| {
        CubicSpline::new(&Image::sampled(materials.geometry().clone(), |p| analytic.jet(id, p).value as f32))
    };
    for id in analytic.ids() {
        let whole = spline(id);
        for p in (0..5000).map(place) {
            let (truth, found) = (whole.jet(p), materials.jet(id, p));
            assert_eq!(truth.value < 0.0, found.value < 0.0, "{id:?} at {p}");
            if truth.value.abs() < 0.75 * KNOWN_VOXELS as f64 {
                assert!((truth.value - found.value).abs() < 1e-6, "{id:?} at {p}: {truth:?} {found:?}");
                assert!((truth.gradient - found.gradient).length() < 1e-6);
            }
        }
    }
}

#[test]
fn interfaces_are_met_to_second_order() {
    let analytic = nested(CENTRE);
    let worst = |materials: &dyn Indicators| {
        let mut worst = 0.0f64;
        for n in 0..600 {
            let way = (place(n) - DVec3::splat(12.0)).normalize();
            for (own, radius) in [([IDS[0], IDS[1]], 9.0), ([IDS[1], IDS[2]], 5.0)] {
                let start = CENTRE + way * (radius + 0.7 * (uniform(4, 0, n) - 0.5));
                let p = materials.project_onto_interface(own, start, 1.0, 1e-9).expect("near the interface");
                worst = worst.max((p.distance(CENTRE) - radius).abs());
                assert!(materials.clearance(p, &own) > 0.0);
                assert!(materials.clearance(p, &[IDS[0], IDS[2]]) < 0.0);
            }
        }
        worst
    };
    assert!(worst(&analytic) < 1e-9);
    let (coarse, fine) = (worst(&sampled(&analytic, 1.0)), worst(&sampled(&analytic, 0.5)));
    assert!(coarse < 0.02 && fine < coarse / 4.0, "{coarse} {fine}");
}

#[test]
fn differences_have_the_derivatives_that_they_say() {
    let materials = sampled(&balls(CENTRE), 1.0);
    let interface = materials.interface(IDS[0], IDS[2]);
    for n in 0..50 {
        let p = CENTRE + 0.05 * (place(n) - DVec3::splat(12.0));
        let jet = interface.jet(p);
        assert!((interface.value_gradient(p).0 - jet.value).abs() < 1e-14);
        for axis in 0..3 {
            let step = DVec3::AXES[axis] * 1e-4;
            let (up, down) = (interface.jet(p + step), interface.jet(p - step));
            assert!(((up.value - down.value) / 2e-4 - jet.gradient[axis]).abs() < 1e-6);
            assert!(((up.gradient - down.gradient) / 2e-4 - jet.hessian.col(axis)).length() < 1e-4);
        }
    }
}

#[test]
fn junction_curves_are_met() {
    let analytic = sectors(CENTRE);
    for n in 0..200 {
        let away = 0.04 * (place(n) - DVec3::splat(12.0));
        let start = CENTRE + DVec3::new(away.x, away.y, 8.0 * away.z);
        let own = [IDS[1], IDS[2], IDS[3]];
        let p = analytic.project_onto_curve(own, start, 2.0, 1e-9).expect("near the axis");
        assert!((p - CENTRE).truncate().length() < 1e-9, "{p}");
        // each step is the shortest possible, so the position does not move along the curve
        assert!((p.z - start.z).abs() < 1e-9);
        // the curve is real only within the ball
        assert_eq!(analytic.clearance(p, &own) > 0.0, (p.z - CENTRE.z).abs() < 8.0);
    }
    // the indicators of the sectors have kinks on the curve, so the error of sampled indicators is
    // proportional to the spacing
    for (spacing, tolerance) in [(1.0, 0.08), (0.5, 0.04)] {
        let materials = sampled(&analytic, spacing);
        for n in 0..100 {
            let z = 5.0 * (uniform(5, 0, n) - 0.5);
            let start = CENTRE + DVec3::new(0.3 * (uniform(5, 1, n) - 0.5), 0.3 * (uniform(5, 2, n) - 0.5), z);
            let p = materials.project_onto_curve([IDS[1], IDS[2], IDS[3]], start, 1.0, 1e-6).expect("near the axis");
            assert!((p - CENTRE).truncate().length() < tolerance, "{spacing}: {p}");
        }
    }
}

#[test]
fn a_meeting_is_an_interface_or_the_nearest_real_curve() {
    let analytic = sectors(CENTRE);
    let meet = |own: &[usize], start| {
        let own: Vec<MaterialId> = own.iter().map(|&n| IDS[n]).collect();
        analytic.project_onto_meeting(&own, start, 2.0, 1e-9).inspect(|&p| {
            assert!(own.len() > 3 || analytic.distance_from_meeting(&own, p) < 1e-8);
        })
    };
    let near = CENTRE + DVec3::new(0.3, -0.2, 5.0);
    let on_axis = meet(&[1, 2, 3], near).expect("near the axis");
    assert!((on_axis - near).z.abs() < 1e-9);
    // the other curves of the four materials are farther than 2 mm
    assert_eq!(meet(&[0, 1, 2, 3], near), Some(on_axis));
    // beyond the ball, the planes between the sectors are not real
    assert_eq!(meet(&[1, 2, 3], CENTRE + DVec3::Z * 9.0), None);
    assert_eq!(meet(&[0, 2], near), None);
    assert_eq!(meet(&[1], near), None);
    let own = [IDS[0], IDS[1], IDS[2]];
    // 1 mm below the sphere, whose function and that of a plane have normals at right angles
    assert!((analytic.distance_from_meeting(&own, CENTRE + DVec3::Z * 7.0) - 0.5f64.sqrt()).abs() < 1e-12);
}

#[test]
fn the_interface_of_an_object_is_its_zero_set() {
    let geometry = Geometry::axis_aligned([25; 3], DVec3::ONE);
    let spline = CubicSpline::new(&Image::sampled(geometry, |p| (p.distance(CENTRE) - 7.0) as f32));
    let object = Object(spline.clone());
    let own = [Object::INSIDE, MaterialId::OUTSIDE];
    for n in 0..50 {
        let start = place(n);
        assert_eq!(object.difference_gradient(own[0], own[1], start), spline.value_gradient(start));
        assert_eq!(object.material_at(start) == Object::INSIDE, spline.value(start) < 0.0);
        let [one, other] = [object.project_onto_interface(own, start, 2.0, 1e-9), spline.project(start, 2.0, 1e-9)];
        assert_eq!(one.is_some(), other.is_some());
        assert!(one.zip(other).is_none_or(|(p, q)| p.distance(q) < 1e-8));
    }
}

#[test]
fn junction_points_are_met_to_second_order() {
    for analytic in [corners(CENTRE), balls(CENTRE)] {
        for n in 0..100 {
            let start = CENTRE + 0.05 * (place(n) - DVec3::splat(12.0));
            let p = analytic.project_onto_point(IDS, start, 2.0, 1e-9).expect("near the point");
            assert!(p.distance(CENTRE) < 1e-8, "{p}");
        }
    }
    let analytic = balls(CENTRE);
    let error = |spacing: f64| {
        let materials = sampled(&analytic, spacing);
        let p = materials.project_onto_point(IDS, CENTRE + DVec3::splat(0.2), 2.0, 1e-9).expect("near the point");
        assert!(materials.clearance(p, &IDS).is_infinite());
        let on_curve = materials.project_onto_curve([IDS[0], IDS[1], IDS[2]], CENTRE + DVec3::splat(0.2), 1.0, 1e-9);
        let on_curve = on_curve.expect("near the curve");
        let values = [0, 1, 2].map(|n| analytic.jet(IDS[n], on_curve).value);
        p.distance(CENTRE).max((values[0] - values[1]).abs()).max((values[0] - values[2]).abs())
    };
    let (coarse, fine) = (error(1.0), error(0.5));
    assert!(coarse < 1e-2 && fine < coarse / 4.0, "{coarse} {fine}");
}

#[test]
fn what_is_not_near_is_not_met() {
    let analytic = nested(CENTRE);
    let materials = sampled(&analytic, 0.5);
    // the indicator of the outside is not known at the centre, so the projection fails
    assert_eq!(materials.project_onto_interface([IDS[0], IDS[1]], CENTRE, 30.0, 1e-6), None);
    // the start is 1 mm from the interface: a limit of 1.2 mm suffices, 0.8 mm does not
    let start = CENTRE + DVec3::X * 10.0;
    assert!(materials.project_onto_interface([IDS[0], IDS[1]], start, 1.2, 1e-6).is_some());
    assert_eq!(materials.project_onto_interface([IDS[0], IDS[1]], start, 0.8, 1e-6), None);
    // concentric interfaces have no curve in common
    assert_eq!(analytic.project_onto_curve([IDS[0], IDS[1], IDS[2]], start, 5.0, 1e-6), None);
    assert_eq!(materials.clearance(CENTRE, &[IDS[0], IDS[2]]), f64::NEG_INFINITY);
    assert!(materials.clearance(CENTRE, &[IDS[2]]) > 5.0);
}

#[test]
fn parts_make_the_same_materials_and_damaged_ones_none() {
    let materials = sampled(&sectors(CENTRE), 1.5);
    let parts = |own: &Indicator| {
        let (first, size) = own.extent();
        let (bricks, coefficients) = (own.bricks().to_vec(), own.coefficients().to_vec());
        IndicatorParts { first, size, surrounds: own.surrounds(), bricks, coefficients }
    };
    let grid = materials.geometry().size;
    let again = materials
        .table()
        .iter()
        .cloned()
        .zip(materials.indicators())
        .map(|(material, own)| (material, Indicator::from_parts(parts(own), grid).expect("whole")));
    let again = Materials::from_parts(materials.geometry().clone(), again.collect(), materials.fill().to_vec());
    assert_eq!(again.expect("whole"), materials);
    let good = parts(&materials.indicators()[1]);
    type Damage = fn(&mut IndicatorParts);
    let damages: [Damage; 6] = [
        |parts| parts.size[0] = usize::MAX,
        |parts| parts.bricks.reverse(),
        |parts| parts.bricks.push(u32::MAX),
        |parts| parts.bricks[0] = parts.bricks[1],
        |parts| parts.coefficients.truncate(64),
        |parts| parts.coefficients[5] = f32::NAN,
    ];
    for damage in damages {
        let mut parts = good.clone();
        damage(&mut parts);
        Indicator::from_parts(parts, grid).expect_err("damaged");
    }
    let own = || vec![(materials.table()[1].clone(), materials.indicators()[1].clone())];
    let geometry = || materials.geometry().clone();
    Materials::from_parts(geometry(), own(), vec![1; materials.fill().len()]).expect_err("no material of that number");
    Materials::from_parts(geometry(), own(), vec![0; 3]).expect_err("bricks without fill");
    Materials::from_parts(geometry(), Vec::new(), materials.fill().to_vec()).expect_err("no material");
}

#[test]
fn the_nearest_are_kept_in_order() {
    let mut near = Near::default();
    for n in 0..20u16 {
        near.insert(MaterialId(n), f64::from((n * 7) % 20));
    }
    let values: Vec<f64> = near.entries().iter().map(|(_, value)| *value).collect();
    assert_eq!(values, (0..MOST_NEAR).map(|n| n as f64).collect::<Vec<_>>());
    assert_eq!(near.interface_distance(), 0.5);
    near.insert(MaterialId(1), 0.0);
    assert_eq!(near.first(), Some(MaterialId(0)));
}

#[test]
fn interfaces_are_real_where_their_clearance_is_positive() {
    let analytic = sectors(CENTRE);
    let materials = sampled(&analytic, 0.75);
    let (mut real, mut not) = (0, 0);
    for n in 0..4000 {
        let start = place(n);
        for own in [[IDS[1], IDS[0]], [IDS[2], IDS[1]], [IDS[3], IDS[2]]] {
            let Some(p) = materials.project_onto_interface(own, start, 1.0, 1e-6) else { continue };
            let is_real = materials.clearance(p, &own) > 0.0;
            assert_eq!(materials.is_real_interface(own, p), is_real, "{own:?} at {p}");
            let (value, gradient) = materials.difference_gradient(own[0], own[1], p);
            let [a, b] = own.map(|id| materials.value_gradient(id, p));
            assert!((value - 0.5 * (a.0 - b.0)).abs() < 1e-12 && (gradient - 0.5 * (a.1 - b.1)).length() < 1e-12);
            assert_eq!(materials.place_on_interface(own, start, 1.0, 1e-6), is_real.then_some((p, gradient)));
            if is_real { real += 1 } else { not += 1 }
        }
    }
    assert!(real > 200 && not > 500, "{real} real, {not} not");
}

#[test]
fn what_is_added_at_nodes_is_at_no_other() {
    // a node in the middle of the grid, and two nodes near its border, where the spline is mirrored
    let at_borders = [(DVec3::new(-1.0, 12.0, 12.0), [1, 14, 16]), (DVec3::new(25.0, 12.0, 12.0), [23, 14, 16])];
    for (centre, node) in [(CENTRE, [16, 12, 12])].into_iter().chain(at_borders) {
        let before = sampled(&nested(centre), 1.0);
        let at = |[i, j, k]: [usize; 3]| DVec3::new(i as f64, j as f64, k as f64);
        let id = before.near(at(node)).first().expect("known");
        let mut materials = before.clone();
        materials.add_at_nodes(&BTreeMap::from([(id, vec![(node, 0.5)])]));
        let change = |p: DVec3| materials.value_gradient(id, p).0 - before.value_gradient(id, p).0;
        let mut known = 0;
        for n in 0..729 {
            let other = [(node[0] + n % 9).saturating_sub(4).min(24), node[1] + n / 9 % 9 - 4, node[2] + n / 81 - 4];
            let expected = if other == node { 0.5 } else { 0.0 };
            // where the indicator is not known, the change is the difference of two infinities: NaN
            let found = change(at(other));
            known += usize::from(!found.is_nan());
            assert!(found.is_nan() || (found - expected).abs() < 1e-5, "{found} at {other:?}");
        }
        assert!(known > 300, "{known}");
        // midway to the next node, the cubic spline that is one at a node and zero at all other
        // nodes has the value 0.6005
        assert!((change(at(node) + 0.5 * DVec3::Y) / 0.5 - 0.6005).abs() < 1e-4);
        let pairs = materials.indicators().iter().zip(before.indicators()).enumerate();
        assert!(pairs.filter(|(n, _)| *n != id.index()).all(|(_, (now, then))| now == then));
    }
}

#[test]
fn a_sample_is_added_to_on_axes_of_few_nodes() {
    // with 1 to 9 nodes along x, a sample has many mirror images within reach; adding to it must
    // give the coefficients of a new spline
    for nodes in 1..10 {
        let geometry = Geometry::axis_aligned([nodes, 9, 9], DVec3::ONE);
        let image = |added: f64| {
            Image::sampled(geometry.clone(), |p| {
                (p.y - 4.2 + if p.distance(DVec3::new(0.0, 4.0, 4.0)) < 0.5 { added } else { 0.0 }) as f32
            })
        };
        let (mut found, _) = Indicator::new(&image(0.0), [0; 3], geometry.size, false);
        let (expected, _) = Indicator::new(&image(0.1), [0; 3], geometry.size, false);
        found.add_at_nodes(&[([0, 4, 4], 0.1)], geometry.size);
        let largest =
            found.coefficients().iter().zip(expected.coefficients()).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
        assert!(largest < 1e-5, "{nodes} nodes: {largest}");
    }
}
