//! Runs all stages as library calls, from labels to triangles, without intermediate files:
//! `cargo run --release -p isoparticles-tests --example chain`.

use glam::DVec3;
use isoparticles_distfield::{Border, Keep, LabelOptions, from_labels};
use isoparticles_field::marching_cubes::marching_cubes;
use isoparticles_field::spline::CubicSpline;
use isoparticles_particles::{Fields, Parameters, settle};
use isoparticles_reconstruct::{Options, reconstruct};
use isoparticles_seed::sampling::seed_surface;
use isoparticles_sizefield::uniform_field;
use isoparticles_stage::error::Result;
use isoparticles_stage::monitor::Silent;
use isoparticles_volume::{Geometry, Image};

fn main() -> Result<()> {
    // The object consists of the voxels of two overlapping balls.
    let geometry = Geometry::axis_aligned([40, 28, 28], DVec3::ONE);
    let centres = [14.0, 25.0].map(|x| DVec3::new(x, 13.5, 13.5));
    let inside = Image::sampled(geometry, |p| centres.iter().any(|&centre| p.distance(centre) < 9.0));
    let options =
        LabelOptions { border: Border::Cap, margin: 5, cut: Default::default(), clearance: 0.05, keep: Keep::All };
    let distance = from_labels(&inside, &options, &Silent)?.field;
    let surface = CubicSpline::new(&distance);
    let sizing = uniform_field(&distance, 2.0);
    let (seeds, _) = seed_surface(&marching_cubes(&distance, 0.0), &surface, (&sizing, &sizing), 1, &Silent)?;
    let fields = Fields { surface: &surface, sizing: &sizing };
    let (particles, summary) = settle(&seeds, None, &fields, &Parameters::default(), |_, _| Ok(()))?;
    let options = Options { keeps_voxels: true, ..Options::default() };
    let made = reconstruct(&particles, (&surface, &distance), Some(&sizing), &options, &Silent)?;
    println!(
        "{} seeds, {} particles after {} passes",
        seeds.positions.len(),
        particles.positions.len(),
        summary.passes
    );
    println!("{} triangles, mean radius ratio {:.3}", made.checked.triangles, made.checked.quality.radius_ratio_mean);
    println!("failed checks: {:?}", made.failed);
    Ok(())
}
