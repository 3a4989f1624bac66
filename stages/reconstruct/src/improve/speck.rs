//! Makes a small closed piece of the surface anew, where its few triangles cannot be mended.
//!
//! Where F encloses less than a few h (a speck of noise), the piece has a handful of vertices, and moves one by one lead nowhere. Such a
//! piece is star-shaped as a rule: an icosahedron is cast from its middle onto F = 0 and remeshed there to few triangles of equal size.

use super::excerpt::Edits;
use super::guard::{Limits, Rule, commit_if_welcome, fitness};
use super::last_resort::patch_round;
use super::moves::projected;
use super::surface::Surface;
use super::worst::{self, Aim, Effort, Failures};
use super::{Tally, remesh};
use glam::DVec3;
use isoparticles_mesh::quality::area;
use isoparticles_mesh::{TriangleMesh, shapes};

/// Most vertices of a piece that counts as a speck.
const LARGEST_SPECK: usize = 60;

/// Levels of the sphere that is cast: 42 vertices, which show a piece of this size.
const LEVELS: usize = 1;

/// Times that the middle is sought as the mean of what is cast from the one before.
const CENTRINGS: usize = 3;

/// F = 0 is sought as far from the middle as this times the farthest vertex, in so many steps; the one that crosses it is halved so often.
const REACH: f64 = 3.0;
const STEPS: usize = 90;
const HALVINGS: usize = 40;

/// Numbers of triangles that are aimed at, in the order tried, ...
const TRIANGLES: [f64; 6] = [20.0, 30.0, 48.0, 80.0, 120.0, 180.0];

/// ... but for those below this share of the triangles that the piece had.
const FEWEST: f64 = 0.7;

/// Rounds of splits, collapses, flips and relaxation.
const ROUNDS: usize = 6;

/// Range of edge lengths over the one aimed at, where they are within.
const LENGTHS: [f64; 2] = [0.5, 1.8];

/// Largest distance of a triangle's centroid from F = 0 over the edge length aimed at: an icosahedron in a ball has 0.2, an octahedron 0.3.
const STRAYS: f64 = 0.25;

/// Radius ratio that the triangles are lifted to afterwards.
const TARGET: f64 = 0.7;

/// A small closed piece of the surface.
#[derive(PartialEq, Eq, Hash)]
pub(super) struct Speck {
    /// Its vertices, ascending.
    vertices: Vec<u32>,
    /// Its triangles, ascending.
    triangles: Vec<u32>,
}

impl Speck {
    /// The piece that a triangle belongs to, if it is small and simply connected.
    pub(super) fn round(surface: &Surface, triangle: u32) -> Option<Self> {
        let vertices = patch_round(surface, surface.triangles[triangle as usize][0], |_, _| true)?;
        let round = |&v: &u32| surface.around[v as usize].iter().copied();
        let mut triangles: Vec<u32> = vertices.iter().flat_map(round).collect();
        triangles.sort_unstable();
        triangles.dedup();
        // V - F / 2 is the Euler characteristic of a closed piece
        let is_speck = vertices.len() <= LARGEST_SPECK && 2 * vertices.len() == triangles.len() + 4;
        is_speck.then_some(Self { vertices, triangles })
    }

    /// Makes it anew, if it is star-shaped and the guard lets it pass: the triangles touched, `None` where it is not or does not.
    pub(super) fn remake(&self, surface: &mut Surface, limits: &Limits) -> Option<Vec<u32>> {
        let ball = cast(surface, &self.vertices)?;
        let fewest = FEWEST * self.triangles.len() as f64;
        TRIANGLES.iter().filter(|&&count| count > fewest).find_map(|&count| {
            let made = remeshed(surface, &ball, count, limits)?;
            Edits::replacing(surface, &self.triangles, &made).make(surface);
            commit_if_welcome(surface, limits, Rule::Fit)
        })
    }
}

/// A sphere cast onto F = 0 from the middle of some vertices, oriented as they are; `None` where F = 0 is not met in all directions.
fn cast(surface: &Surface, vertices: &[u32]) -> Option<TriangleMesh> {
    let sphere = shapes::icosphere(1.0, LEVELS);
    let own = || vertices.iter().map(|&v| surface.positions[v as usize]);
    let (mut from, mut middle) = (DVec3::ZERO, own().sum::<DVec3>() / vertices.len() as f64);
    let reach = REACH * own().map(|p| p.distance(middle)).fold(0.0, f64::max);
    let mut ball = sphere.clone();
    for _ in 0..CENTRINGS {
        from = middle;
        let hits: Option<Vec<DVec3>> =
            sphere.vertices.iter().map(|&way| crossing(surface, from, way * reach)).collect();
        ball.vertices = hits?;
        middle = ball.vertices.iter().sum::<DVec3>() / ball.vertices.len() as f64;
    }
    if surface.field.value(from) > 0.0 {
        ball.triangles.iter_mut().for_each(|corners| corners.swap(1, 2));
    }
    Some(ball)
}

/// The first point of F = 0 on the way out from a position.
fn crossing(surface: &Surface, from: DVec3, way: DVec3) -> Option<DVec3> {
    let is_inside = |share: f64| surface.field.value(from + share * way) < 0.0;
    let at_first = is_inside(0.0);
    let beyond = (1..=STEPS).find(|&k| is_inside(k as f64 / STEPS as f64) != at_first)?;
    let (mut near, mut far) = ((beyond - 1) as f64 / STEPS as f64, beyond as f64 / STEPS as f64);
    for _ in 0..HALVINGS {
        let between = 0.5 * (near + far);
        if is_inside(between) == at_first { near = between } else { far = between }
    }
    projected(surface, from + near * way, way.length())
}

/// A closed mesh on F = 0 remeshed to about so many triangles of equal size; `None` where one of them does not keep the limits that finite elements ask
/// for.
fn remeshed(surface: &Surface, ball: &TriangleMesh, count: f64, limits: &Limits) -> Option<TriangleMesh> {
    let corners = (0..ball.triangles.len()).map(|t| ball.corners(t));
    let whole: f64 = corners.map(|[a, b, c]| area(a, b, c)).sum();
    // of an equilateral triangle of the mean area
    let side = (4.0 / 3f64.sqrt() * whole / count).sqrt();
    let size = |_: DVec3| side;
    let mut part = Surface::new(ball, surface.field, &size, LENGTHS);
    let limits = &Limits { deviation: STRAYS, ..*limits };
    let tally = &mut Tally::default();
    for _ in 0..ROUNDS {
        remesh::round(&mut part, limits, tally);
    }
    for effort in [Effort::Settled, Effort::Double] {
        let aim = Aim { limits, bar: TARGET, effort };
        worst::lift(&mut part, None, aim, &mut Failures::default(), &|| Ok(()), tally).ok()?;
    }
    let made = part.into_mesh();
    (0..made.triangles.len()).all(|t| fitness(made.corners(t)) >= 1.0).then_some(made)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::check::{CheckOptions, check};
    use crate::improve::last_resort;
    use isoparticles_field::spline::CubicSpline;
    use isoparticles_mesh::quality::summarise;
    use isoparticles_volume::{Geometry, Image};

    const MIDDLE: DVec3 = DVec3::new(6.2, 5.9, 6.1);
    const HALF_AXES: DVec3 = DVec3::new(2.4, 1.5, 1.2);
    const LIMITS: Limits = Limits { agreement: 0.0, fold: -0.3, fold_of_f: -0.8, deviation: 0.35, excess: 0.35 };

    /// A quadratic, which the spline reproduces, with an ellipsoid as its zero set; `sign` is 1 for an object, -1 for a hole.
    fn ellipsoid(sign: f64) -> CubicSpline {
        let mut image = Image::filled(Geometry::axis_aligned([13; 3], DVec3::ONE), 0.0f32);
        for (n, value) in image.data.iter_mut().enumerate() {
            let node = DVec3::new((n % 13) as f64, (n / 13 % 13) as f64, (n / 169) as f64);
            *value = (sign * (((node - MIDDLE) / HALF_AXES).length_squared() - 1.0)) as f32;
        }
        CubicSpline::new(&image)
    }

    /// Two poles and a few points of the equator, at given angles, on F = 0.
    fn bipyramid(field: &CubicSpline, angles: &[f64], is_hole: bool) -> TriangleMesh {
        let ring = angles.iter().map(|a| DVec3::new(a.cos(), a.sin(), 0.1 * a.sin()));
        let ways = ring.chain([DVec3::new(0.1, 0.2, 1.0), DVec3::new(0.2, -0.1, -1.0)]);
        let on_surface =
            |way: DVec3| field.project(MIDDLE + way.normalize() * HALF_AXES, 1.0, 1e-7).expect("F = 0 is near");
        let count = angles.len() as u32;
        let sides = (0..count).flat_map(|a| {
            let b = (a + 1) % count;
            [[a, b, count], [b, a, count + 1]]
        });
        let turned = |[a, b, c]: [u32; 3]| if is_hole { [a, c, b] } else { [a, b, c] };
        TriangleMesh { vertices: ways.map(on_surface).collect(), triangles: sides.map(turned).collect() }
    }

    #[test]
    fn a_speck_of_needles_becomes_a_fit_mesh_of_the_same_ellipsoid() {
        let size = |_: DVec3| 3.0;
        for sign in [1.0, -1.0] {
            let field = ellipsoid(sign);
            let mesh = bipyramid(&field, &[0.2, 1.4, 2.9], sign < 0.0);
            assert!(summarise(&mesh).angle_min < 25.0, "{:?}", summarise(&mesh));
            let mut surface = Surface::new(&mesh, &field, &size, last_resort::LENGTHS);
            let mut tally = Tally::default();
            last_resort::lift(&mut surface, &LIMITS, &|| Ok(()), &mut tally).expect("nothing stops it");
            assert_eq!(tally, Tally { remade_specks: 1, ..Tally::default() });
            let options = CheckOptions { field: Some(&field), max_vertex_distance: Some(1e-4), ..Default::default() };
            let after = check(&surface.into_mesh(), &options);
            assert_eq!(after.failed_checks(), Vec::<String>::new());
            assert_eq!((after.euler, after.turned_triangles), (2, Some(0)));
            let quality = &after.quality;
            assert!(quality.radius_ratio_min >= 0.5 && quality.angle_min >= 25.0 && quality.angle_max <= 120.0);
            // an icosahedron has 0.6 of the volume of the ball round it
            let share = after.volume / (sign * 4.0 / 3.0 * std::f64::consts::PI * HALF_AXES.element_product());
            assert!((0.5..1.0).contains(&share), "{share}");
        }
    }

    #[test]
    fn what_is_no_speck_is_left_alone() {
        let field = ellipsoid(1.0);
        let size = |_: DVec3| 3.0;
        let many: Vec<f64> =
            (0..LARGEST_SPECK).map(|n| std::f64::consts::TAU * n as f64 / LARGEST_SPECK as f64).collect();
        // a rim that is open, where the last triangle lies, and more vertices than a speck has
        let mut open = bipyramid(&field, &[0.2, 1.4, 2.9], false);
        open.triangles.pop();
        for mesh in [open, bipyramid(&field, &many, false)] {
            let surface = Surface::new(&mesh, &field, &size, last_resort::LENGTHS);
            assert!(Speck::round(&surface, 0).is_none());
            assert_eq!(surface.into_mesh(), mesh);
        }
        // F = 0 is not met round a piece that lies elsewhere
        let mut elsewhere = bipyramid(&field, &[0.2, 1.4, 2.9], false);
        elsewhere.vertices.iter_mut().for_each(|p| *p = DVec3::splat(0.5) + 0.1 * (*p - MIDDLE));
        let mut surface = Surface::new(&elsewhere, &field, &size, last_resort::LENGTHS);
        assert!(Speck::round(&surface, 0).expect("a speck").remake(&mut surface, &LIMITS).is_none());
    }
}
