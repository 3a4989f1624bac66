//! Analytic scenes for the tests: F sampled on small grids, and well-spaced points on F = 0.

use glam::DVec3;
use isoparticles_field::marching_cubes::marching_cubes;
use isoparticles_field::random::uniform;
use isoparticles_field::spline::CubicSpline;
use isoparticles_mesh::TriangleMesh;
use isoparticles_mesh::shapes::icosphere;
use isoparticles_mesh::spatial::Bins;
use isoparticles_volume::{Geometry, Image};

/// A function on a grid that is similar to a signed distance.
pub(crate) struct Scene {
    /// Samples of the function.
    pub(crate) image: Image<f32>,
    /// Spline through the samples.
    pub(crate) field: CubicSpline,
}

impl Scene {
    /// Samples a function on a grid of `size` voxels with a given spacing (mm).
    pub(crate) fn new(size: [usize; 3], spacing: DVec3, function: impl Fn(DVec3) -> f64) -> Self {
        let geometry = Geometry::axis_aligned(size, spacing);
        let mut data = Vec::with_capacity(geometry.voxel_count());
        for k in 0..size[2] {
            for j in 0..size[1] {
                for i in 0..size[0] {
                    let p = geometry.index_to_grid(DVec3::new(i as f64, j as f64, k as f64));
                    data.push(function(p) as f32);
                }
            }
        }
        let image = Image { geometry, data };
        let field = CubicSpline::new(&image);
        Self { image, field }
    }

    /// Returns the gradient of F.
    pub(crate) fn gradient(&self, p: DVec3) -> DVec3 {
        self.field.value_gradient(p).1
    }

    /// Returns points on F = 0 with a minimum distance of `spacing`, by dart throwing on a dense
    /// sample. The sampling radius is about `spacing`, which is less even than settled particles.
    pub(crate) fn points(&self, spacing: f64) -> Vec<DVec3> {
        let mesh = marching_cubes(&self.image, 0.0);
        let mut candidates: Vec<DVec3> = Vec::new();
        for (t, triangle) in mesh.triangles.iter().enumerate() {
            let [a, b, c] = triangle.map(|v| mesh.vertices[v as usize]);
            for n in 0..6u64 {
                let (r, s) = (uniform(1, t as u64, 2 * n).sqrt(), uniform(1, t as u64, 2 * n + 1));
                let p = a * (1.0 - r) + b * (r * (1.0 - s)) + c * (r * s);
                candidates.extend(self.field.project(p, 1.0, 1e-9));
            }
        }
        let mut order: Vec<usize> = (0..candidates.len()).collect();
        order.sort_by(|&i, &j| uniform(2, 0, i as u64).total_cmp(&uniform(2, 0, j as u64)));
        let mut kept: Vec<DVec3> = Vec::new();
        let mut bins = Bins::new(spacing);
        for i in order {
            let p = candidates[i];
            if !bins.near(p).any(|q: &DVec3| q.distance(p) < spacing) {
                bins.add(p, p);
                kept.push(p);
            }
        }
        kept
    }
}

pub(crate) const CENTRE: DVec3 = DVec3::splat(15.7);

/// Returns the triangles of a ball of radius 10.
pub(crate) fn ball() -> TriangleMesh {
    let mut mesh = icosphere(10.0, 3);
    mesh.vertices.iter_mut().for_each(|p| *p += CENTRE);
    mesh
}

/// A ball of radius 10.
pub(crate) fn sphere() -> Scene {
    Scene::new([32; 3], DVec3::ONE, |p| p.distance(CENTRE) - 10.0)
}

/// A torus of radii 9 and 4.
pub(crate) fn torus() -> Scene {
    Scene::new([32; 3], DVec3::ONE, |p| {
        let q = p - CENTRE;
        (q.truncate().length() - 9.0).hypot(q.z) - 4.0
    })
}

/// Two balls of radius 5 with a gap of 2.
pub(crate) fn two_balls() -> Scene {
    Scene::new([32, 24, 24], DVec3::ONE, |p| {
        let centre = |x: f64| DVec3::new(x, 11.6, 11.6);
        (p.distance(centre(9.6)) - 5.0).min(p.distance(centre(21.6)) - 5.0)
    })
}

/// A spherical shell between the radii 8 and 10.5.
pub(crate) fn shell() -> Scene {
    Scene::new([32; 3], DVec3::ONE, |p| (p.distance(CENTRE) - 9.25).abs() - 1.25)
}

/// A gyroid inside a ball of radius 13: one component of high genus.
pub(crate) fn gyroid() -> Scene {
    Scene::new([36; 3], DVec3::ONE, |p| {
        let q = (p - DVec3::splat(17.6)) * 0.45;
        let g = q.x.sin() * q.y.cos() + q.y.sin() * q.z.cos() + q.z.sin() * q.x.cos();
        let (g, ball) = (g / 0.7, (p - DVec3::splat(17.6)).length() - 13.0);
        // smooth maximum, so that the rim has no crease
        (g + ball + (g - ball).hypot(1.0)) / 2.0
    })
}

/// A torus of radii 5 and 4.8, as a smooth function. Its hole is 0.4 voxel wide, and no grid node
/// is in the narrow part of the hole.
pub(crate) fn pierced() -> Scene {
    let (ring, tube) = (5.0, 4.8);
    Scene::new([28; 3], DVec3::ONE, |p| {
        let q = p - DVec3::new(13.43, 13.61, 13.52);
        let square = q.length_squared() + ring * ring - tube * tube;
        (square * square - 4.0 * ring * ring * q.truncate().length_squared()) / (8.0 * ring * ring * tube)
    })
}

/// Two balls of radius 6, connected by a neck with a radius of about half a voxel.
pub(crate) fn hourglass() -> Scene {
    Scene::new([34, 24, 24], DVec3::ONE, |p| {
        let q = p - DVec3::new(16.43, 11.61, 11.52);
        let ball = |x: f64| (q - DVec3::X * x).length() - 6.0;
        let soft = (-2.0 * ball(-6.33)).exp() + (-2.0 * ball(6.33)).exp();
        -0.5 * soft.ln()
    })
}

/// A smooth union of two to five balls, tori and thin plates.
pub(crate) fn random(seed: u64) -> Scene {
    let u = |k: u64| uniform(78, seed, k);
    let parts: Vec<(DVec3, DVec3, f64, f64, f64)> = (0..2 + (4.0 * u(0)) as u64)
        .map(|k| {
            let at = |n: u64| u(10 * (k + 1) + n);
            let centre = DVec3::new(at(0), at(1), at(2)) * 13.0 + DVec3::splat(9.5);
            let axis = DVec3::new(at(3), at(4), at(5)) - 0.5;
            (centre, axis.normalize_or(DVec3::Z), 2.5 + 3.0 * at(6), at(7), at(8))
        })
        .collect();
    let distance = |p: DVec3, &(centre, axis, radius, thickness, kind): &(DVec3, DVec3, f64, f64, f64)| {
        let q = p - centre;
        let along = q.dot(axis);
        let across = (q - along * axis).length();
        if kind < 0.33 {
            q.length() - radius
        } else if kind < 0.67 {
            (across - radius).hypot(along) - 1.0 - thickness
        } else {
            // a round plate, 1.4 to 2.4 thick
            (across - radius).max(0.0).hypot(along) - 0.7 - 0.5 * thickness
        }
    };
    Scene::new([32; 3], DVec3::ONE, |p| {
        -0.4 * parts.iter().map(|part| (-2.5 * distance(p, part)).exp()).sum::<f64>().ln()
    })
}
