//! Every component of F = 0 gets particles, whether marching cubes sees it or not.

use glam::DVec3;
use isoparticles_field::marching_cubes::marching_cubes;
use isoparticles_field::sizing::SizingField;
use isoparticles_field::spline::CubicSpline;
use isoparticles_field::topology::FieldComponents;
use isoparticles_mesh::components::of_vertices;
use isoparticles_seed::sampling::{COMPONENT_MINIMUM, Summary, seed_surface};
use isoparticles_stage::monitor::Silent;
use isoparticles_volume::{Geometry, Image};

/// Samples along each axis, and h, mm.
const SIZE: [usize; 3] = [40, 24, 24];
const H: f32 = 2.0;

/// Seeds of a function, with how many there are on each component of it.
fn seeded(function: impl Fn(DVec3) -> f64) -> (Summary, Vec<usize>) {
    let geometry = Geometry::axis_aligned(SIZE, DVec3::ONE);
    let image = Image::sampled(geometry.clone(), |p| function(p) as f32);
    let surface = CubicSpline::new(&image);
    let sizing = SizingField::new(Image::filled(geometry, H));
    let predicted = sizing.predicted_count(&surface);
    let (seeds, summary) =
        seed_surface(&image, &surface, &sizing, predicted, None, 1, &Silent).expect("not interrupted");
    let components = FieldComponents::new(&surface, &Silent).expect("not interrupted");
    let mut counts = vec![0; components.all().len()];
    for &p in &seeds.positions {
        let (value, normal) = surface.value_gradient(p);
        assert!(value.abs() < 1e-5, "{p} is off F = 0 by {value}");
        counts[components.at(&surface, p, normal).expect("a component") as usize] += 1;
    }
    (summary, counts)
}

#[test]
fn a_component_between_the_samples_gets_particles() {
    let (ball, speck) = (DVec3::new(11.0, 12.0, 12.0), DVec3::new(28.5, 12.45, 12.52));
    let (summary, counts) = seeded(|p| (p.distance(ball) - 7.0).min(0.4 * (p.distance_squared(speck) - 0.3)));
    assert_eq!((summary.components, summary.underpopulated_components, counts.len()), (2, 1, 2));
    assert!(counts.iter().all(|&n| n >= COMPONENT_MINIMUM), "{counts:?}");
}

#[test]
fn two_balls_that_marching_cubes_joins_are_two() {
    // neighbouring samples lie in one ball each, and F is above 0 between them
    let distance = |p: DVec3| {
        let ball = |x: f64| p.distance(DVec3::new(x, 12.0, 12.0)) - 7.05;
        ball(11.0).min(ball(26.0))
    };
    let image = Image::sampled(Geometry::axis_aligned(SIZE, DVec3::ONE), |p| distance(p) as f32);
    let mesh = marching_cubes(&image, 0.0);
    assert_eq!(of_vertices(mesh.vertices.len(), &mesh.triangles).1, 1);
    let (summary, counts) = seeded(distance);
    assert_eq!((summary.components, summary.underpopulated_components, counts.len()), (2, 0, 2));
    assert!(counts.iter().all(|&n| n > 100), "{counts:?}");
}
