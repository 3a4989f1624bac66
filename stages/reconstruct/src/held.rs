//! Vertices that the improvement must not move, so that each component of F = 0 keeps a vertex.
//!
//! At an undecided gap, a mesh may join two components. If one of them is a speck with few
//! vertices, local moves may shift all of them to the other component or merge them with its
//! vertices. No other criterion prevents this.

use crate::object::component_at;
use isoparticles_field::spline::CubicSpline;
use isoparticles_field::topology::FieldTopology;
use isoparticles_mesh::TriangleMesh;
use isoparticles_mesh::quality::radius_ratios;
use rayon::prelude::*;

/// Returns one vertex of each component of F = 0 that an undecided place may join to another. It is
/// the vertex whose worst triangle has the highest radius ratio, so it needs improvement least.
pub(crate) fn one_of_each_component(mesh: &TriangleMesh, field: &CubicSpline, topology: &FieldTopology) -> Vec<u32> {
    // components that no undecided place joins start at infinity, which no radius ratio exceeds
    let mut best = vec![(f64::INFINITY, None); topology.components().len()];
    let joined = topology.undecided().iter().map(|place| &place.components).filter(|components| components.len() > 1);
    joined.flatten().for_each(|&c| best[c as usize].0 = f64::NEG_INFINITY);
    if best.iter().all(|(bar, _)| *bar == f64::INFINITY) {
        return Vec::new();
    }
    let mut poorest = vec![f64::INFINITY; mesh.vertices.len()];
    for (t, ratio) in mesh.triangles.iter().zip(radius_ratios(mesh)) {
        t.iter().for_each(|&v| poorest[v as usize] = poorest[v as usize].min(ratio));
    }
    let component_of: Vec<u32> = mesh.vertices.par_iter().map(|&p| component_at(p, field, topology)).collect();
    for ((v, component), ratio) in (0..).zip(component_of).zip(poorest) {
        // vertices of unknown component have a number beyond the list
        if let Some(best) = best.get_mut(component as usize)
            && ratio.is_finite()
            && ratio > best.0
        {
            *best = (ratio, Some(v));
        }
    }
    best.into_iter().filter_map(|(_, v)| v).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::improve::ImproveOptions;
    use crate::improve::tests::improve_object;
    use crate::scenes::Scene;
    use crate::tests::restricted;
    use crate::verdict::TopologyReport;
    use glam::DVec3;
    use isoparticles_field::topology::critical_points;
    use isoparticles_mesh::quality::summarise;

    /// A ball of radius 8, and a speck of a given radius next to it in a given direction. The gap
    /// is too fine for a mesh to resolve.
    fn ball_and_speck(direction: DVec3, radius: f64) -> Scene {
        let centre = DVec3::splat(15.7);
        let [gap, speck] = [8.0, 8.0 + radius].map(|r| centre + r * direction.normalize());
        let scene = |level: f64| {
            Scene::new([36; 3], DVec3::ONE, |p| (p.distance(centre) - 8.0).min(p.distance(speck) - radius) - level)
        };
        let saddles = critical_points(&scene(0.0).field, 0.0).into_iter();
        let saddle = saddles.min_by(|a, b| a.position.distance(gap).total_cmp(&b.position.distance(gap)));
        scene(saddle.expect("a saddle in the gap").value - 2e-4)
    }

    /// Direction and radius of the speck, and spacing of the points.
    const CASES: [([f64; 3], f64, f64); 7] = [
        ([0.569, 0.818, -0.084], 0.799, 2.829),
        ([0.481, 0.114, -0.870], 0.919, 2.401),
        ([0.098, 0.653, -0.751], 0.686, 3.178),
        ([-0.883, -0.006, -0.469], 0.786, 2.984),
        ([-0.959, 0.276, 0.064], 0.634, 1.958),
        ([-0.647, 0.264, 0.715], 1.028, 2.730),
        ([0.902, -0.165, 0.398], 0.835, 2.906),
    ];

    #[test]
    fn a_speck_joined_to_a_ball_keeps_a_vertex() {
        let mut plain_loses = 0;
        for (direction, radius, spacing) in CASES {
            let scene = ball_and_speck(DVec3::from_array(direction), radius);
            let topology = FieldTopology::new(&scene.field);
            assert_eq!((topology.components().len(), topology.undecided().len()), (2, 1));
            let mesh = restricted(&scene, spacing).0;
            let report = |mesh: &TriangleMesh| TopologyReport::new(mesh, &scene.field, &topology);
            assert_eq!(report(&mesh).missing, [[0.0; 3]; 0]);
            let size = |_: DVec3| 1.2 * spacing;
            let (options, step) = (ImproveOptions::default(), || Ok(()));
            let mut plain = mesh.clone();
            improve_object(&mut plain, &[], &scene.field, &size, &options, &step).expect("a sound mesh");
            plain_loses += report(&plain).missing.len();
            let mut kept = mesh;
            let held = one_of_each_component(&kept, &scene.field, &topology);
            assert_eq!(held.len(), 2);
            improve_object(&mut kept, &held, &scene.field, &size, &options, &step).expect("a sound mesh");
            assert_eq!(report(&kept).differences(false).0, Vec::<String>::new());
            assert!(summarise(&kept).radius_ratio_min > 0.5, "{:?}", summarise(&kept));
        }
        assert!(plain_loses > 2, "{plain_loses} were at stake: this shows nothing");
    }
}
