//! Complexes of shapes that are known, against the truth.

use super::check::{CheckOptions, ComplexReport, check};
use super::complex::Complex;
use super::improve::improve;
use super::interfaces::Interfaces;
use super::nodes::Nodes;
use super::prepare::prepare;
use super::refine::{RefineReport, Refinement};
use super::scenes::{self, Scene};
use crate::improve::ImproveOptions;
use isoparticles_field::materials::Indicators;

/// A finished complex with what is known of it.
struct Made {
    interfaces: Interfaces,
    checked: ComplexReport,
    refined: RefineReport,
}

/// All the way from particles of a scene to a checked complex.
fn made(scene: &Scene, indicators: &dyn Indicators, h: f64) -> Made {
    let (refinement, refined) = refined(scene, indicators, h, 0.75);
    let facets = refinement.complex.labelled.facets();
    let (mut interfaces, dimensions) = Interfaces::of(&refinement.complex, &facets);
    let nodes = Nodes::new(&scene.geometry(1.0), indicators);
    let options = ImproveOptions::polish();
    improve(&mut interfaces, &dimensions, indicators, Some(&nodes), &|_| h, &options, &|| Ok(())).expect("improved");
    let options = CheckOptions {
        indicators,
        table: &scene.table(),
        nodes: &nodes,
        keeps_nodes: true,
        min_radius_ratio: Some(0.3),
        max_vertex_distance: 1e-4,
    };
    let checked = check(&interfaces, &options);
    Made { interfaces, checked, refined }
}

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
            let sampled = scene.sampled(1.0);
            for (kind, indicators) in [("analytic", &scene.analytic as &dyn Indicators), ("sampled", &sampled)] {
                let made = made(&scene, indicators, h);
                let q = &made.checked.quality;
                println!("{name} {kind} {h}: {:?}", made.checked.failed);
                println!("{:.4} {:.4} {:.1} {:.1} {:?}", q.radius_ratio_mean, q.radius_ratio_min, q.angle_min, q.angle_max, made.checked.vertex_distance);
                println!("{:?}", made.checked.materials.iter().map(|m| (m.volume, m.area)).collect::<Vec<_>>());
                println!("{} {} {}", made.checked.nodes_changed, made.checked.junction_edges, made.checked.segments);
            }
        }
    }
}
