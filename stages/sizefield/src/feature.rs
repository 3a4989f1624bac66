//! The surface seen at dense samples: local feature size, curvature, and the edge length they ask for.
//!
//! Local feature size is the distance from the surface to its medial axis (Amenta and Bern 1999), the basis of the
//! epsilon-sampling of Meyer, Kirby and Whitaker 2007 (the paper's reference 15).

use crate::medial::medial_points;
use glam::DVec3;
use isoparticles_common::components;
use isoparticles_common::image::Image;
use isoparticles_common::kd_tree::KdTree;
use isoparticles_common::marching_cubes::marching_cubes;
use isoparticles_common::spline::CubicSpline;
use rayon::prelude::*;

/// Samples of F = 0 with what was found at each.
#[derive(Clone, Debug)]
pub struct Features {
    /// Positions on F = 0, grid frame, mm.
    pub points: Vec<DVec3>,
    /// Unit normals, outward.
    pub normals: Vec<DVec3>,
    /// Largest principal curvature in magnitude, per mm.
    pub curvature: Vec<f64>,
    /// Distance to the medial axis, no larger than the radius of curvature, mm.
    pub feature_size: Vec<f64>,
    /// Triangles between the samples (marching cubes, projected).
    pub triangles: Vec<[u32; 3]>,
    /// Connected component of each sample.
    pub component: Vec<u32>,
    /// Area of each component, mm squared.
    pub component_area: Vec<f64>,
}

impl Features {
    /// Samples F = 0 at the projected vertices of marching cubes and measures them. Feature sizes above `largest` (mm) are
    /// not told apart from it. Empty where there is no surface.
    pub fn new(image: &Image<f32>, surface: &CubicSpline, largest: f64) -> Self {
        let mesh = marching_cubes(image, 0.0);
        let spacing = image.geometry.mean_spacing();
        let measured: Vec<(DVec3, DVec3, f64)> = mesh
            .vertices
            .par_iter()
            .map(|&v| {
                let p = surface.project(v, 1.5 * spacing, 1e-6 * spacing).unwrap_or(v);
                let jet = surface.jet(p);
                let normal = jet.gradient.normalize_or_zero();
                (p, normal, largest_curvature(&jet))
            })
            .collect();
        let points: Vec<DVec3> = measured.iter().map(|m| m.0).collect();
        let normals: Vec<DVec3> = measured.iter().map(|m| m.1).collect();
        let curvature: Vec<f64> = measured.iter().map(|m| m.2).collect();
        let axis = KdTree::new(&medial_points(&points, &normals, largest));
        let feature_size = points
            .par_iter()
            .zip(&curvature)
            .map(|(&p, &k)| axis.nearest_within(p, largest).map_or(largest, |(_, d)| d).min(1.0 / k.max(1.0 / largest)))
            .collect();
        let component = components::of_vertices(points.len(), &mesh.triangles);
        let mut component_area = vec![0.0; component.iter().map(|&c| c as usize + 1).max().unwrap_or(0)];
        for t in &mesh.triangles {
            component_area[component[t[0] as usize] as usize] += area(&points, t);
        }
        Self { points, normals, curvature, feature_size, triangles: mesh.triangles, component, component_area }
    }

    /// Integral of 2 / (sqrt(3) h^2) over the surface: the number of vertices of a mesh of equilateral triangles of
    /// edge h.
    pub fn predicted_count(&self, size: impl Fn(DVec3) -> f64 + Sync) -> f64 {
        self.triangles
            .iter()
            .map(|t| {
                let centre = t.iter().map(|&v| self.points[v as usize]).sum::<DVec3>() / 3.0;
                2.0 * area(&self.points, t) / (3f64.sqrt() * size(centre).powi(2))
            })
            .sum()
    }
}

/// Largest principal curvature in magnitude of the level set through a point (Goldman 2005), per mm.
fn largest_curvature(jet: &isoparticles_common::spline::Jet) -> f64 {
    let slope = jet.gradient.length();
    if slope < 1e-9 {
        return 0.0;
    }
    let n = jet.gradient / slope;
    let u = n.any_orthonormal_vector();
    let v = n.cross(u);
    let (hu, hv) = (jet.hessian * u, jet.hessian * v);
    let (a, b, c) = (u.dot(hu), u.dot(hv), v.dot(hv));
    ((0.5 * (a + c)).abs() + (0.5 * (a - c)).hypot(b)) / slope
}

fn area(points: &[DVec3], t: &[u32; 3]) -> f64 {
    let [a, b, c] = t.map(|v| points[v as usize]);
    0.5 * (b - a).cross(c - a).length()
}
