//! A displaced vertex, 5-7 pairs, and a sliver in a lattice of equilateral triangles. The
//! undisturbed lattice is optimal.

use super::acceptance::{Goal, commit_or_rollback};
use super::surface::measure::quality_of;
use super::tests_of_patches::{SIDE, lattice, plane};
use super::*;
use constants::GOOD;

const LIMITS: Limits = Limits::STRICT;
/// A vertex far from the rim, and its neighbours in the direction of x and in the next row.
const MIDDLE: u32 = (SIDE * 30 + 30) as u32;
const RIGHT: u32 = MIDDLE + 1;
const ABOVE: u32 = MIDDLE + SIDE as u32;

fn smallest(surface: &Surface) -> f64 {
    let alive = (0..surface.triangles.len() as u32).filter(|&t| surface.is_alive(t));
    alive.map(|t| surface.quality(t)).fold(f64::INFINITY, f64::min)
}

/// Returns the number of vertices away from the rim whose degree is not six.
fn irregular(surface: &Surface) -> usize {
    let is_irregular = |v: &u32| !surface.frozen[*v as usize] && ![0, 6].contains(&surface.degree(*v));
    (0..surface.positions.len() as u32).filter(is_irregular).count()
}

#[test]
fn a_displaced_vertex_returns_to_the_centre_of_its_ring() {
    let (field, mesh) = (plane(), lattice(0.0));
    let size = |_: DVec3| 1.0;
    let mut surface = Surface::new(&mesh, &field, &size);
    let home = surface.positions[MIDDLE as usize];
    for way in [DVec3::new(0.3, 0.1, 0.0), DVec3::new(-0.1, -0.45, 0.0)] {
        surface.move_vertex(MIDDLE, home + way);
        surface.commit_as_it_is();
        let mut before = smallest(&surface);
        for _ in 0..8 {
            smooth::smooth(&mut surface, MIDDLE, &LIMITS, Goal::Mean { floor: GOOD, price: 0.0 });
            let now = smallest(&surface);
            assert!(now >= before.min(GOOD), "{now} after {before}");
            before = now;
        }
        // moving the rest of the way would gain less than the minimum gain
        assert!(surface.positions[MIDDLE as usize].distance(home) < 0.02, "{}", surface.positions[MIDDLE as usize]);
    }
}

#[test]
fn two_pairs_of_degrees_five_and_seven_cancel() {
    let (field, mesh) = (plane(), lattice(0.0));
    let size = |_: DVec3| 1.0;
    let mut surface = Surface::new(&mesh, &field, &size);
    assert_eq!(irregular(&surface), 0);
    assert!(moves::flip(&mut surface, MIDDLE, ABOVE));
    // smooth until the vertices are at rest
    for _ in 0..20 {
        (0..surface.positions.len() as u32).for_each(|v| smooth::shift(&mut surface, v));
        surface.commit_as_it_is();
    }
    assert_eq!(irregular(&surface), 4);
    sweep::sweep(&mut surface, &LIMITS, 3, false, &|| Ok(()), &mut Tally::default()).expect("nothing stops it");
    assert_eq!(irregular(&surface), 0);
    assert!(smallest(&surface) > 0.97, "{}", smallest(&surface));
}

#[test]
fn a_sliver_is_improved_without_lowering_the_minimum() {
    let (field, mesh) = (plane(), lattice(0.0));
    let size = |_: DVec3| 1.0;
    let mut surface = Surface::new(&mesh, &field, &size);
    // the new vertex has four triangles
    let added = moves::split(&mut surface, MIDDLE, RIGHT).expect("an edge of the lattice");
    let to = surface.positions[added as usize].lerp(surface.positions[ABOVE as usize], 0.3);
    surface.move_vertex(added, to);
    assert!(commit_or_rollback(&mut surface, &LIMITS, Goal::Keep { floor: 0.0 }).is_some());
    let before = smallest(&surface);
    assert!(before < 0.7, "{before}");
    optimise::optimise(&mut surface, GOOD, &|| Ok(()), &mut Tally::default()).expect("no stop");
    assert!(smallest(&surface) >= before, "{} after {before}", smallest(&surface));
    let after = smallest(&surface);
    assert!(after >= GOOD, "{after}");
    let mesh = surface.into_mesh();
    assert!((0..mesh.triangles.len()).all(|t| {
        let [a, b, c] = mesh.corners(t);
        quality_of(a, b, c) >= GOOD
    }));
}
