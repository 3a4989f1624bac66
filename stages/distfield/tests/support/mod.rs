//! Analytic volumes and measurements shared by the tests.
#![allow(dead_code, reason = "each test binary uses its own part of these helpers")]

use glam::DVec3;
use isoparticles_field::marching_cubes::marching_cubes;
use isoparticles_mesh::topology::{Topology, analyse};
use isoparticles_volume::{Geometry, Image};

/// Samples a function of the grid position (mm).
pub(crate) fn sampled<T: Copy>(size: [usize; 3], spacing: DVec3, f: impl Fn(DVec3) -> T) -> Image<T> {
    let geometry = Geometry::axis_aligned(size, spacing);
    let data = positions(&geometry).map(f).collect();
    Image { geometry, data }
}

/// Returns the grid positions of the nodes (mm), x fastest.
pub(crate) fn positions(geometry: &Geometry) -> impl Iterator<Item = DVec3> {
    let (spacing, [nx, ny, nz]) = (geometry.spacing, geometry.size);
    (0..nx * ny * nz).map(move |n| DVec3::new((n % nx) as f64, (n / nx % ny) as f64, (n / (nx * ny)) as f64) * spacing)
}

/// Returns evenly distributed directions (a Fibonacci lattice on the sphere).
pub(crate) fn directions(count: usize) -> impl Iterator<Item = DVec3> {
    (0..count).map(move |n| {
        let z = 1.0 - 2.0 * (n as f64 + 0.5) / count as f64;
        let (sine, cosine) = (n as f64 * 2.399_963_229_728_653).sin_cos();
        let r = (1.0 - z * z).sqrt();
        DVec3::new(r * cosine, r * sine, z)
    })
}

/// Returns the topology of the marching-cubes mesh of a field.
pub(crate) fn topology(field: &Image<f32>) -> Topology {
    analyse(&marching_cubes(field, 0.0))
}

/// Returns the volume enclosed by the marching-cubes mesh of a field.
pub(crate) fn volume(field: &Image<f32>) -> f64 {
    let mesh = marching_cubes(field, 0.0);
    isoparticles_mesh::measure::measure(&mesh).volume
}
