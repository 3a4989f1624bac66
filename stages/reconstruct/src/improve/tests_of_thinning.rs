//! Meshes that are denser than h: thinning removes superfluous vertices and keeps the topology.

use super::tests::{assert_sound, improve_object};
use super::tests_of_patches::{SIDE, lattice, plane};
use super::thin::thin_out;
use super::*;
use crate::check::{CheckOptions, check_object};

#[test]
fn only_the_superfluous_vertices_of_a_lattice_are_removed() {
    let (field, mesh) = (plane(), lattice(0.0));
    let size = |_: DVec3| 1.0;
    let mut surface = Surface::new(&mesh, &field, &size);
    let count = |surface: &Surface| surface.around.iter().filter(|around| !around.is_empty()).count();
    let thinned = |surface: &mut Surface, is_in_question: bool| {
        let mut tally = Tally::default();
        let in_question = vec![is_in_question; surface.positions.len()];
        thin_out(surface, &in_question, &|| Ok(()), &mut tally).expect("nothing stops it");
        tally.collapses
    };
    assert_eq!(thinned(&mut surface, true), 0);
    for at in (10..50).step_by(8) {
        let v = (SIDE * at + at) as u32;
        let (_, corner) = surface.edge_triangles(v, v + 1).expect("an edge inside")[0];
        moves::split(&mut surface, v, v + 1).expect("F = 0 is near");
        moves::split(&mut surface, v, corner).expect("F = 0 is near");
        surface.commit_as_it_is();
    }
    assert_eq!((count(&surface), thinned(&mut surface, false)), (SIDE * SIDE + 10, 0));
    assert_eq!((thinned(&mut surface, true), count(&surface)), (10, SIDE * SIDE));
    let stopped = || Err(Error::input("stopped", "", ""));
    let all = vec![true; surface.positions.len()];
    assert!(thin_out(&mut surface, &all, &stopped, &mut Tally::default()).is_err());
}

#[test]
fn thinning_keeps_the_topology_of_walls_thinner_than_h() {
    let (scene, h) = (crate::scenes::gyroid(), 3.6);
    let (mesh, _, _) = crate::tests::restricted(&scene, h / 1.2);
    let before = check_object(&mesh, &CheckOptions::default());
    let improved = |thins: bool, threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads");
        let mut mesh = mesh.clone();
        let options = ImproveOptions { thins, ..ImproveOptions::default() };
        let report = pool.install(|| improve_object(&mut mesh, &[], &scene.field, &|_| h, &options, &|| Ok(())));
        let collapses = report.expect("a sound mesh").0.moves.collapses;
        (assert_sound(&mesh, &scene.field, &before, "gyroid"), mesh, collapses)
    };
    let ((dense, _, none), (thin, mesh, collapses)) = (improved(false, 2), improved(true, 1));
    assert_eq!(improved(true, 3).1, mesh);
    assert!(none == 0 && collapses > 0, "{none} and {collapses} collapses");
    // measured: 235 and 219 vertices, means of 0.956 and 0.966, 1.6 % of the volume
    assert!(thin.vertices < dense.vertices * 95 / 100, "{} of {}", thin.vertices, dense.vertices);
    let (was, is) = (&dense.quality, &thin.quality);
    assert!(is.radius_ratio_mean > was.radius_ratio_mean + 0.005, "{is:?} after {was:?}");
    assert!(is.radius_ratio_min > 0.6, "{is:?}");
    let [thin, dense] = [thin, dense].map(|report| report.object().volume);
    assert!((thin / dense - 1.0).abs() < 0.05, "{thin} and {dense}");
}
