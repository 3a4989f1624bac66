//! Reconstructs a ball from points on its surface: `cargo run --release -p isoparticles-reconstruct
//! --example ball`.

use glam::DVec3;
use isoparticles_field::particle_set::ParticleSet;
use isoparticles_field::spline::CubicSpline;
use isoparticles_mesh::shapes::icosphere;
use isoparticles_reconstruct::{Options, reconstruct};
use isoparticles_stage::error::Result;
use isoparticles_stage::monitor::Silent;
use isoparticles_volume::{Geometry, Image};

fn main() -> Result<()> {
    let (centre, radius) = (DVec3::splat(15.5), 10.0);
    let field = Image::sampled(Geometry::axis_aligned([32; 3], DVec3::ONE), |p| (p.distance(centre) - radius) as f32);
    let points = icosphere(radius, 3).vertices;
    let particles = ParticleSet {
        geometry: field.geometry.clone(),
        positions: points.iter().map(|&p| p + centre).collect(),
        normals: points.iter().map(|p| p.normalize()).collect(),
        sizes: vec![1.5; points.len()],
        energies: vec![0.0; points.len()],
        lambdas: vec![0.1; points.len()],
    };
    let spline = CubicSpline::new(&field);
    let made = reconstruct(&particles, (&spline, &field), None, &Options::default(), &Silent)?;
    let (object, quality) = (made.checked.object(), &made.checked.quality);
    let volume = object.volume;
    println!("{} triangles, Euler characteristic {}", made.checked.triangles, object.euler);
    println!("volume {volume:.1} mm^3 of {:.1}", 4.0 / 3.0 * std::f64::consts::PI * radius.powi(3));
    println!("radius ratio: mean {:.3}, smallest {:.3}", quality.radius_ratio_mean, quality.radius_ratio_min);
    println!("failed checks: {:?}", made.failed);
    Ok(())
}
