//! Computes the area and signed volume of a mesh and of its components.

use super::TriangleMesh;
use glam::DVec3;
use serde::Serialize;

/// Area in mm^2, and signed volume in mm^3 (positive if the triangles face outward).
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Measure {
    /// Area in mm^2.
    pub area: f64,
    /// Signed volume in mm^3. It is meaningful only for a closed surface.
    pub volume: f64,
}

/// Computes the area and volume of the whole mesh.
pub fn measure(mesh: &TriangleMesh) -> Measure {
    let everything = vec![0; mesh.triangles.len()];
    measure_components(mesh, &everything, 1)[0]
}

/// Computes the area and volume of each component, given the component of every triangle
/// (`Topology::component_of_triangle` of [`super::topology`]).
pub fn measure_components(mesh: &TriangleMesh, component_of_triangle: &[u32], count: usize) -> Vec<Measure> {
    let mut measures = vec![Measure::default(); count];
    // A reference point on the component keeps the volume accurate for a small component far from
    // the origin.
    let mut references: Vec<Option<DVec3>> = vec![None; count];
    for (t, &component) in component_of_triangle.iter().enumerate() {
        let [a, b, c] = mesh.corners(t);
        let reference = *references[component as usize].get_or_insert(a);
        let normal = (b - a).cross(c - a);
        let measure = &mut measures[component as usize];
        measure.area += 0.5 * normal.length();
        measure.volume += (a - reference).dot((b - reference).cross(c - reference)) / 6.0;
    }
    measures
}

#[cfg(test)]
mod tests {
    use super::super::shapes;
    use super::*;
    use std::f64::consts::PI;

    #[test]
    fn a_box_far_from_the_origin_has_its_volume() {
        let mut mesh = shapes::cuboid(DVec3::new(1.0, 2.0, 3.0));
        for p in &mut mesh.vertices {
            *p += DVec3::splat(1e6);
        }
        let got = measure(&mesh);
        assert!((got.volume - 6.0).abs() < 1e-8, "{got:?}");
        assert!((got.area - 22.0).abs() < 1e-8, "{got:?}");
    }

    #[test]
    fn a_fine_sphere_approaches_the_analytic_measure() {
        // The volume of an inscribed icosphere of level n is too small by a fraction of about
        // `0.83 / 4^n`. Its area is too small by half that fraction.
        let got = measure(&shapes::icosphere(2.0, 5));
        let (area, volume) = (16.0 * PI, 32.0 / 3.0 * PI);
        assert!((got.area / area - 1.0).abs() < 1e-3, "{got:?}");
        assert!((got.volume / volume - 1.0).abs() < 2e-3, "{got:?}");
    }

    #[test]
    fn turning_a_mesh_inside_out_negates_its_volume() {
        let mut mesh = shapes::torus(3.0, 1.0, 40, 20);
        let outward = measure(&mesh);
        for t in &mut mesh.triangles {
            t.swap(1, 2);
        }
        assert_eq!(measure(&mesh).volume, -outward.volume);
        assert!((outward.volume / (6.0 * PI * PI) - 1.0).abs() < 0.03);
    }
}
