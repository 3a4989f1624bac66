//! Complexes of shapes that are known, against the truth.

use super::complex::Complex;
use super::nodes::Nodes;
use super::prepare::prepare;
use super::refine::{RefineReport, Refinement};
use super::scenes::{self, Scene};
use isoparticles_field::materials::Indicators;

fn refined<'a>(scene: &Scene, indicators: &'a dyn Indicators, h: f64, share: f64) -> (Refinement<'a>, RefineReport) {
    let (particles, strata) = scene.particles(h, share);
    let prepared = prepare(&particles, &strata, indicators).expect("on their strata");
    println!("{:?}", prepared.report);
    let upper = particles.geometry.upper_corner();
    let nodes = Nodes::new(&particles.geometry, indicators);
    let complex = Complex::new(prepared, indicators, upper, None);
    let mut refinement = Refinement::new(complex);
    let facets = refinement.run(Some(&nodes), |_| Ok(())).expect("refined");
    let report = refinement.report.clone();
    println!("{} facets, {} points, {report:?}", facets.len(), refinement.complex.points().len());
    (refinement, report)
}

#[test]
fn complexes_of_known_shapes_are_refined_to_their_topology() {
    for (name, scene) in [
        ("nested", scenes::nested()),
        ("sectors", scenes::sectors()),
        ("two balls", scenes::two_balls()),
        ("quarters", scenes::quarters()),
    ] {
        for h in [2.0, 1.0] {
            println!("{name} {h}");
            let (_, report) = refined(&scene, &scene.analytic, h, 0.75);
            assert!(report.unresolved.is_empty(), "{name}");
            let sampled = scene.sampled(1.0);
            let (_, report) = refined(&scene, &sampled, h, 0.75);
            println!("sampled {:?}", report.unresolved);
        }
    }
}
