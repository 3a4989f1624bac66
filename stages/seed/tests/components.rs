//! Tests that every component of F = 0 gets particles, even one that marching cubes does not
//! resolve. Seeds come from Poisson-disk sampling or from marching-cubes vertices.

use glam::DVec3;
use isoparticles_field::marching_cubes::marching_cubes;
use isoparticles_field::sizing::SizingField;
use isoparticles_field::spline::CubicSpline;
use isoparticles_field::topology::FieldComponents;
use isoparticles_mesh::components::of_vertices;
use isoparticles_seed::sampling::{COMPONENT_MINIMUM, Summary, seed_surface, seed_vertices};
use isoparticles_seed::vertices::vertices;
use isoparticles_stage::monitor::{Interrupted, Silent};
use isoparticles_volume::{Geometry, Image};

/// Number of samples along each axis, and h in mm.
const SIZE: [usize; 3] = [40, 24, 24];
const H: f32 = 2.0;

/// Seeds the zero set of a function by Poisson-disk sampling or at the vertices of marching cubes.
/// Returns the statistics and the number of seeds on each component.
fn seeded(function: impl Fn(DVec3) -> f64, at_vertices: bool) -> (Summary, Vec<usize>) {
    let geometry = Geometry::axis_aligned(SIZE, DVec3::ONE);
    let image = Image::sampled(geometry.clone(), |p| function(p) as f32);
    let surface = CubicSpline::new(&image);
    let sizing = SizingField::new(Image::filled(geometry, H));
    let seeds = if at_vertices {
        let found = vertices(&image, &surface, None, |_| Ok::<_, Interrupted>(()), &Silent).expect("not interrupted");
        seed_vertices(&found, &surface, &sizing, 1, &Silent)
    } else {
        seed_surface(&marching_cubes(&image, 0.0), &surface, (&sizing, &sizing), 1, &Silent)
    };
    let (seeds, summary) = seeds.expect("not interrupted");
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
    for at_vertices in [false, true] {
        let function = |p: DVec3| (p.distance(ball) - 7.0).min(0.4 * (p.distance_squared(speck) - 0.3));
        let (summary, counts) = seeded(function, at_vertices);
        assert_eq!((summary.components, summary.underpopulated_components, counts.len()), (2, 1, 2));
        assert!(counts.iter().all(|&n| n >= COMPONENT_MINIMUM), "{counts:?}");
    }
}

#[test]
fn marching_cubes_seeds_are_all_vertices_on_the_surface() {
    let balls = |p: DVec3| {
        let ball = |x: f64, radius: f64| p.distance(DVec3::new(x, 12.0, 12.0)) - radius;
        ball(11.0, 7.0).min(ball(28.0, 5.0))
    };
    let image = Image::sampled(Geometry::axis_aligned(SIZE, DVec3::ONE), |p| balls(p) as f32);
    let mesh = marching_cubes(&image, 0.0);
    let (of_vertex, _) = of_vertices(mesh.vertices.len(), &mesh.triangles);
    let (summary, mut counts) = seeded(balls, true);
    assert_eq!((summary.components, summary.not_projected, summary.refinement), (2, 0, Some(1)));
    assert_eq!(summary.vertices, Some(mesh.vertices.len()));
    let mut wanted = [0, 1].map(|c| of_vertex.iter().filter(|&&v| v as usize == c).count());
    wanted.sort_unstable();
    counts.sort_unstable();
    assert_eq!(counts, wanted);
}

#[test]
fn two_balls_that_marching_cubes_joins_are_two() {
    // two adjacent samples lie in different balls, so marching cubes joins the balls, although
    // F > 0 between these samples
    let distance = |p: DVec3| {
        let ball = |x: f64| p.distance(DVec3::new(x, 12.0, 12.0)) - 7.05;
        ball(11.0).min(ball(26.0))
    };
    let image = Image::sampled(Geometry::axis_aligned(SIZE, DVec3::ONE), |p| distance(p) as f32);
    let mesh = marching_cubes(&image, 0.0);
    assert_eq!(of_vertices(mesh.vertices.len(), &mesh.triangles).1, 1);
    let (summary, counts) = seeded(distance, false);
    assert_eq!((summary.components, summary.underpopulated_components, counts.len()), (2, 0, 2));
    assert!(counts.iter().all(|&n| n > 100), "{counts:?}");
}

#[test]
fn the_number_goes_by_one_field_and_the_sizes_by_the_other() {
    let image = Image::sampled(Geometry::axis_aligned(SIZE, DVec3::ONE), |p| {
        (p.distance(DVec3::new(20.0, 12.0, 12.0)) - 9.0) as f32
    });
    let (surface, mesh) = (CubicSpline::new(&image), marching_cubes(&image, 0.0));
    let sizing = SizingField::new(Image::filled(image.geometry.clone(), H));
    let seeded = |spread: &SizingField| {
        let (seeds, _) = seed_surface(&mesh, &surface, (spread, &sizing), 1, &Silent).expect("not interrupted");
        assert!(seeds.sizes.iter().all(|&h| h == f64::from(H)));
        seeds.positions.len() as f64
    };
    let ratio = seeded(&sizing.scaled(0.5)) / seeded(&sizing);
    assert!((ratio / 4.0 - 1.0).abs() < 0.1, "{ratio} times as many, not 4");
    // area of the sphere, 4 pi R^2, times the lattice density 2 / (sqrt(3) h^2)
    let want = 4.0 * std::f64::consts::PI * 81.0 * 2.0 / (3f64.sqrt() * f64::from(H * H));
    for (count, off) in
        [(sizing.count_on(&mesh.vertices, &mesh.triangles), 0.02), (sizing.predicted_count(&surface), 0.01)]
    {
        assert!((count / want - 1.0).abs() < off, "{count}, not {want}");
    }
}
