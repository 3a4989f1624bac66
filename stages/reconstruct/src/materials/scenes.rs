//! Materials whose strata are known in closed form, and particles on these strata, for tests.

use glam::DVec3;
use isoparticles_field::materials::{
    Analytic, Bound, Indicator, Indicators, Material, MaterialId, Materials, Stratum, ball, half_space, maximum,
    negative,
};
use isoparticles_field::particle_set::{ParticleSet, Strata};
use isoparticles_field::random::uniform;
use isoparticles_mesh::spatial::Bins;
use isoparticles_volume::{Geometry, Image};
use std::f64::consts::TAU;

/// A junction curve: its materials, the positions along it for parameters from 0 to 1, and whether
/// it is closed.
pub(super) struct Curve {
    pub(super) ids: [u16; 3],
    pub(super) way: Box<dyn Fn(f64) -> DVec3 + Sync>,
    /// Length in mm.
    pub(super) length: f64,
    pub(super) closed: bool,
    /// Indices of the junction points at its ends; not used if it is closed.
    pub(super) ends: [usize; 2],
}

/// Indicators on a cube from 0 to `extent` (mm), with their junction points and curves.
pub(super) struct Scene {
    pub(super) analytic: Analytic,
    pub(super) extent: f64,
    pub(super) points: Vec<([u16; 4], DVec3)>,
    pub(super) curves: Vec<Curve>,
}

pub(super) fn stratum(ids: &[u16]) -> Stratum {
    Stratum::new(&ids.iter().map(|&id| MaterialId(id)).collect::<Vec<_>>()).expect("two to four")
}

impl Scene {
    /// Returns the grid, with nodes `spacing` mm apart.
    pub(super) fn geometry(&self, spacing: f64) -> Geometry {
        Geometry::axis_aligned([(self.extent / spacing).round() as usize + 1; 3], DVec3::splat(spacing))
    }

    /// Returns the table of the materials.
    pub(super) fn table(&self) -> Vec<Material> {
        self.analytic.ids().map(|id| Material { name: format!("m{}", id.0), labels: Vec::new() }).collect()
    }

    /// Returns indicators sampled on the grid.
    pub(super) fn sampled(&self, spacing: f64) -> Materials {
        let geometry = self.geometry(spacing);
        let of = |id: MaterialId| {
            let image = Image::sampled(geometry.clone(), |p| self.analytic.jet(id, p).value as f32);
            let (indicator, negative) = Indicator::new(&image, [0; 3], geometry.size, false);
            (self.table()[id.index()].clone(), indicator, negative)
        };
        Materials::new(geometry.clone(), self.analytic.ids().map(of).collect()).expect("parts of one grid")
    }

    /// Returns particles about h apart: equidistant on curves, random on interfaces. Each particle
    /// on an interface is at least `share` h from all others.
    pub(super) fn particles(&self, h: f64, share: f64) -> (ParticleSet, Strata) {
        self.particles_on(&self.analytic, h, share)
    }

    /// Returns particles like [`Self::particles`], on the interfaces of other indicators.
    pub(super) fn particles_on(&self, indicators: &dyn Indicators, h: f64, share: f64) -> (ParticleSet, Strata) {
        let mut positions: Vec<DVec3> = self.points.iter().map(|(_, p)| *p).collect();
        let mut of: Vec<Stratum> = self.points.iter().map(|(ids, _)| stratum(ids)).collect();
        let mut segments = Vec::new();
        for curve in &self.curves {
            let count = (curve.length / h).round().max(if curve.closed { 3.0 } else { 1.0 }) as usize;
            let first = positions.len() as u32;
            let inner = if curve.closed { 0..count } else { 1..count };
            let own: Vec<u32> = inner.clone().map(|k| first + (k - inner.start) as u32).collect();
            positions.extend(inner.map(|k| (curve.way)(k as f64 / count as f64)));
            of.resize(positions.len(), stratum(&curve.ids));
            let chain: Vec<u32> = if curve.closed {
                own.iter().copied().chain([first]).collect()
            } else {
                let [a, b] = curve.ends.map(|end| end as u32);
                std::iter::once(a).chain(own).chain([b]).collect()
            };
            segments.extend(chain.windows(2).map(|pair| [pair[0], pair[1]]));
        }
        let spacing = share * h;
        let mut bins = Bins::new(spacing);
        positions.iter().for_each(|&p| bins.add(p, p));
        let tries = (60.0 * (self.extent / h).powi(3)) as u64;
        for n in 0..tries {
            let start = self.extent * DVec3::new(uniform(1, 0, n), uniform(1, 1, n), uniform(1, 2, n));
            let near = indicators.near(start);
            let [(i, _), (j, _), ..] = near.entries() else { continue };
            let Some(p) = indicators.project_onto_interface([*i, *j], start, 2.0 * h, 1e-10) else { continue };
            let is_inside = p.min_element() >= 0.0 && p.max_element() <= self.extent;
            if !is_inside || !indicators.are_separate(&[*i, *j]) || indicators.clearance(p, &[*i, *j]) <= 0.0 {
                continue;
            }
            if !bins.near(p).any(|q: &DVec3| q.distance(p) < spacing) {
                bins.add(p, p);
                positions.push(p);
                of.push(Stratum::interface(*i, *j));
            }
        }
        let count = positions.len();
        let set = ParticleSet {
            geometry: self.geometry(1.0),
            positions,
            normals: vec![DVec3::ZERO; count],
            sizes: vec![h; count],
            energies: vec![0.0; count],
            lambdas: vec![0.1; count],
        };
        (set, Strata { of, segments })
    }
}

pub(super) const CENTRE: DVec3 = DVec3::new(12.1, 11.8, 12.3);

/// A ball of radius 5 mm in one of 9 mm.
pub(super) fn nested() -> Scene {
    shell(9.0, 5.0)
}

/// A ball in a larger one, with the given radii.
pub(super) fn shell(outer: f64, inner: f64) -> Scene {
    let between = maximum(ball(CENTRE, outer), negative(ball(CENTRE, inner)));
    let analytic = Analytic::new(vec![negative(ball(CENTRE, outer)), between, ball(CENTRE, inner)], 1.0);
    Scene { analytic, extent: 24.0, points: Vec::new(), curves: Vec::new() }
}

/// Distance of the plane of [`cut`] from the centre of the balls, mm.
pub(super) const CUT: f64 = 3.0;

/// Returns the plane at which the balls of [`cut`] end. It is oblique to the grid.
pub(super) fn plane() -> Bound {
    let normal = DVec3::new(0.3, -0.4, 1.2).normalize();
    Bound { name: "cut".to_owned(), point: CENTRE + CUT * normal, normal }
}

/// The balls of [`nested`], cut by [`plane`] along two circles.
pub(super) fn cut() -> Scene {
    let Bound { point, normal, .. } = plane();
    let u = normal.any_orthonormal_vector();
    let v = normal.cross(u);
    let rim = |radius: f64, ids: [u16; 3]| {
        let radius = (radius * radius - CUT * CUT).sqrt();
        let way = move |x: f64| {
            let (sine, cosine) = (TAU * x).sin_cos();
            point + radius * (cosine * u + sine * v)
        };
        Curve { ids, way: Box::new(way), length: TAU * radius, closed: true, ends: [0, 0] }
    };
    Scene { curves: vec![rim(9.0, [0, 1, 3]), rim(5.0, [1, 2, 3])], ..nested() }
}

/// Radius of the ball of [`sectors`], mm.
pub(super) const RADIUS: f64 = 8.0;

fn round_the_axis(turns: f64) -> DVec3 {
    DVec3::new((turns * TAU).cos(), (turns * TAU).sin(), 0.0)
}

/// Three sectors of 120 degrees of a ball of radius 8 mm: one curve along the axis, three on the
/// surface, two junction points.
pub(super) fn sectors() -> Scene {
    let normal = |turns: f64| round_the_axis(turns + 0.25);
    let sector = |n: f64| {
        let wedge = maximum(half_space(CENTRE, -normal(n / 3.0)), half_space(CENTRE, normal((n + 1.0) / 3.0)));
        maximum(ball(CENTRE, RADIUS), wedge)
    };
    let analytic = Analytic::new(vec![negative(ball(CENTRE, RADIUS)), sector(0.1), sector(1.1), sector(2.1)], 1.0);
    let poles = [-1.0, 1.0].map(|z| ([0, 1, 2, 3], CENTRE + DVec3::Z * z * RADIUS));
    let axis = Curve {
        ids: [1, 2, 3],
        way: Box::new(|x| CENTRE + DVec3::Z * RADIUS * (2.0 * x - 1.0)),
        length: 2.0 * RADIUS,
        closed: false,
        ends: [0, 1],
    };
    let meridian = |n: u16| Curve {
        // the plane at the start of sector n separates it from the previous one
        ids: [0, n + 1, (n + 2) % 3 + 1],
        way: Box::new(move |x| {
            let (sine, cosine) = (0.5 * TAU * x).sin_cos();
            CENTRE + RADIUS * (sine * round_the_axis((f64::from(n) + 0.1) / 3.0) - cosine * DVec3::Z)
        }),
        length: 0.5 * TAU * RADIUS,
        closed: false,
        ends: [0, 1],
    };
    let curves = vec![axis, meridian(0), meridian(1), meridian(2)];
    Scene { analytic, extent: 24.0, points: poles.into(), curves }
}

/// Half the distance between the centres of two balls of radius 6 mm that share a disk, mm.
pub(super) const HALF: f64 = 4.0;

/// Two balls of radius 6 mm that share a disk: one closed curve.
pub(super) fn two_balls() -> Scene {
    let part = |side: f64| maximum(ball(CENTRE + DVec3::X * side * HALF, 6.0), half_space(CENTRE, DVec3::X * -side));
    let outside = isoparticles_field::materials::minimum(
        ball(CENTRE - DVec3::X * HALF, 6.0),
        ball(CENTRE + DVec3::X * HALF, 6.0),
    );
    let analytic = Analytic::new(vec![negative(outside), part(-1.0), part(1.0)], 1.0);
    let radius = (36.0 - HALF * HALF).sqrt();
    let rim = Curve {
        ids: [0, 1, 2],
        way: Box::new(move |x| {
            let (sine, cosine) = (TAU * x).sin_cos();
            CENTRE + radius * DVec3::new(0.0, cosine, sine)
        }),
        length: TAU * radius,
        closed: true,
        ends: [0, 0],
    };
    Scene { analytic, extent: 24.0, points: Vec::new(), curves: vec![rim] }
}

/// Four regions of a ball of radius 9 mm that meet at its centre, each around the direction of a
/// corner of a tetrahedron. They have four curves inside and six on the surface, and one junction
/// point inside and four on the surface.
pub(super) fn quarters() -> Scene {
    let radius = 9.0;
    let ways = [DVec3::ONE, DVec3::new(1.0, -1.0, -1.0), DVec3::new(-1.0, 1.0, -1.0), DVec3::new(-1.0, -1.0, 1.0)];
    let region = |own: DVec3| {
        let planes = ways.into_iter().filter(|way| *way != own).map(|way| half_space(CENTRE, (way - own).normalize()));
        maximum(ball(CENTRE, radius), planes.reduce(maximum).expect("three planes"))
    };
    let mut functions = vec![negative(ball(CENTRE, radius))];
    functions.extend(ways.map(region));
    let analytic = Analytic::new(functions, 1.0);
    // the three other materials meet opposite to each direction
    let others = |n: usize| [1u16, 2, 3, 4].into_iter().filter(|&id| usize::from(id) != n + 1).collect::<Vec<_>>();
    let corner = |n: usize| CENTRE - radius * ways[n].normalize();
    let mut points = vec![([1, 2, 3, 4], CENTRE)];
    let mut curves = Vec::new();
    for n in 0..4 {
        let [a, b, c] = others(n)[..] else { panic!("three") };
        points.push(([0, a, b, c], corner(n)));
        let end = corner(n);
        let way = Box::new(move |x| CENTRE.lerp(end, x));
        curves.push(Curve { ids: [a, b, c], way, length: radius, closed: false, ends: [0, n + 1] });
        for m in 0..n {
            let both: Vec<u16> = others(n).into_iter().filter(|id| others(m).contains(id)).collect();
            let (from, to) = (-ways[m].normalize(), -ways[n].normalize());
            let angle = from.angle_between(to);
            let way = Box::new(move |x: f64| {
                CENTRE + radius * (((1.0 - x) * angle).sin() * from + (x * angle).sin() * to) / angle.sin()
            });
            let ends = [m + 1, n + 1];
            curves.push(Curve { ids: [0, both[0], both[1]], way, length: radius * angle, closed: false, ends });
        }
    }
    Scene { analytic, extent: 24.0, points, curves }
}
