//! Multi-material test bodies with known strata. The positions of junction particles are computed
//! in closed form. Particles on interfaces are random points projected onto the interfaces.

use crate::coarse::empty;
use crate::constants::INITIAL_LAMBDA;
use crate::cpu::OnStrata;
use glam::DVec3;
use isoparticles_field::materials::{
    Analytic, Indicator, Indicators, Material, MaterialId, Materials, Stratum, ball, half_space, maximum, negative,
};
use isoparticles_field::particle_set::Strata;
use isoparticles_field::random::uniform;
use isoparticles_field::sizing::SizingField;
use isoparticles_volume::{Geometry, Image};
use std::f64::consts::{PI, TAU};

/// Centre of every body in mm.
pub(crate) const CENTRE: DVec3 = DVec3::new(12.1, 11.8, 12.3);

/// Radius of the outer ball in mm.
pub(crate) const RADIUS: f64 = 8.0;

/// A test body: indicators, h, seeds and the expected interfaces.
pub(crate) struct Body {
    pub indicators: Analytic,
    pub sizing: SizingField,
    pub seeds: OnStrata,
    /// Interfaces with their areas in mm^2 and the lengths of their borders in mm.
    pub interfaces: Vec<(Stratum, f64, f64)>,
}

/// Returns the stratum of the given materials.
pub(crate) fn stratum(ids: &[u16]) -> Stratum {
    Stratum::new(&ids.iter().map(|&id| MaterialId(id)).collect::<Vec<_>>()).expect("two to four materials")
}

/// A junction curve.
struct Curve {
    on: Stratum,
    /// Length in mm.
    length: f64,
    /// Indices of the particles at the ends.
    ends: [u32; 2],
    /// Returns the point at a fraction of the length, from 0 to 1.
    point_at: Box<dyn Fn(f64) -> DVec3>,
}

impl Body {
    /// Creates a body. Adds the particles of junction points and curves first, then projects random
    /// points until `count` particles lie on interfaces.
    fn new(
        indicators: Analytic,
        h: f64,
        points: &[(Stratum, DVec3)],
        curves: &[Curve],
        interfaces: Vec<(Stratum, f64, f64)>,
        count: usize,
    ) -> Self {
        let geometry = Geometry::axis_aligned([25; 3], DVec3::ONE);
        let sizing = SizingField::new(Image::filled(geometry.clone(), h as f32));
        let (mut set, mut strata) = (empty(&geometry), Strata::default());
        let mut add = |on: Stratum, p: DVec3, normal: DVec3| {
            set.positions.push(p);
            set.normals.push(normal);
            set.sizes.push(h);
            set.energies.push(0.0);
            set.lambdas.push(INITIAL_LAMBDA);
            strata.of.push(on);
            set.positions.len() as u32 - 1
        };
        points.iter().for_each(|&(on, p)| {
            add(on, p, DVec3::ZERO);
        });
        for curve in curves {
            let pieces = (curve.length / h).round().max(1.0);
            let mut last = curve.ends[0];
            for n in 1..pieces as usize {
                let share = n as f64 / pieces;
                let tangent = (curve.point_at)(share + 1e-6) - (curve.point_at)(share - 1e-6);
                let own = add(curve.on, (curve.point_at)(share), tangent.normalize());
                strata.segments.push([last, own]);
                last = own;
            }
            strata.segments.push([last, curve.ends[1]]);
        }
        let mut tried = 0;
        let mut on_interfaces = 0;
        while on_interfaces < count {
            tried += 1;
            let random = |stream| 2.4 * (uniform(5, stream, tried) - 0.5) * RADIUS;
            let start = CENTRE + DVec3::new(random(0), random(1), random(2));
            let near = indicators.near(start);
            if let &[(a, _), (b, _), ..] = near.entries()
                && let Some((p, gradient)) = indicators.place_on_interface([a.max(b), a.min(b)], start, 0.5, 1e-7)
            {
                add(Stratum::interface(a, b), p, gradient.normalize());
                on_interfaces += 1;
            }
        }
        Self { indicators, sizing, seeds: (set, strata), interfaces }
    }

    /// Returns the indicators sampled on the grid of h.
    pub(crate) fn sampled(&self) -> Materials {
        let geometry = self.sizing.image().geometry.clone();
        let parts = self.indicators.ids().map(|id| {
            let image = Image::sampled(geometry.clone(), |p| self.indicators.jet(id, p).value as f32);
            let (indicator, negative) = Indicator::new(&image, [0; 3], geometry.size, id == MaterialId::OUTSIDE);
            (Material { name: format!("m{}", id.0), labels: Vec::new() }, indicator, negative)
        });
        Materials::new(geometry.clone(), parts.collect()).expect("parts of one grid")
    }

    /// Returns the number of lattice particles inside the border of each interface. By Pick's
    /// theorem, this is the area in lattice cells, minus half the number of border particles, plus
    /// one if there is a border.
    pub(crate) fn lattice_counts(&self) -> Vec<(Stratum, f64)> {
        let h = self.sizing.at(CENTRE);
        let count = |area: f64, border: f64| {
            area / (0.75f64.sqrt() * h * h) - border / (2.0 * h) + if border > 0.0 { 1.0 } else { 0.0 }
        };
        self.interfaces.iter().map(|&(on, area, border)| (on, count(area, border))).collect()
    }
}

/// Returns a ball of radius 5 mm inside a ball of radius [`RADIUS`]: two interfaces without
/// junctions.
pub(crate) fn nested(h: f64, count: usize) -> Body {
    let shell = maximum(ball(CENTRE, RADIUS), negative(ball(CENTRE, 5.0)));
    let indicators = Analytic::new(vec![negative(ball(CENTRE, RADIUS)), shell, ball(CENTRE, 5.0)], 1.0);
    let interfaces =
        vec![(stratum(&[0, 1]), 4.0 * PI * RADIUS * RADIUS, 0.0), (stratum(&[1, 2]), 4.0 * PI * 25.0, 0.0)];
    Body::new(indicators, h, &[], &[], interfaces, count)
}

/// Returns a ball cut into three sectors of 120 degrees around an axis parallel to z. The axis and
/// three meridians are junction curves that meet at the two poles.
pub(crate) fn sectors(h: f64, count: usize) -> Body {
    // angles of the planes between the sectors
    let turns = [0.1, 1.1, 2.1].map(|n: f64| n / 3.0 * TAU);
    let normal = |turn: f64| DVec3::new(-turn.sin(), turn.cos(), 0.0);
    let sector = |n: usize| {
        let wedge = maximum(half_space(CENTRE, -normal(turns[n])), half_space(CENTRE, normal(turns[(n + 1) % 3])));
        maximum(ball(CENTRE, RADIUS), wedge)
    };
    let indicators = Analytic::new(vec![negative(ball(CENTRE, RADIUS)), sector(0), sector(1), sector(2)], 1.0);
    let pole = stratum(&[0, 1, 2, 3]);
    let points = [(pole, CENTRE + RADIUS * DVec3::Z), (pole, CENTRE - RADIUS * DVec3::Z)];
    let mut curves = vec![Curve {
        on: stratum(&[1, 2, 3]),
        length: 2.0 * RADIUS,
        ends: [0, 1],
        point_at: Box::new(|share| CENTRE + RADIUS * (1.0 - 2.0 * share) * DVec3::Z),
    }];
    let mut interfaces = Vec::new();
    // plane n lies between sector n - 1 and sector n
    for (n, turn) in turns.into_iter().enumerate() {
        let sides = [(n + 2) as u16 % 3 + 1, n as u16 + 1];
        let out = DVec3::new(turn.cos(), turn.sin(), 0.0);
        curves.push(Curve {
            on: stratum(&[0, sides[0], sides[1]]),
            length: PI * RADIUS,
            ends: [0, 1],
            point_at: Box::new(move |share| {
                CENTRE + RADIUS * ((PI * share).cos() * DVec3::Z + (PI * share).sin() * out)
            }),
        });
        interfaces.push((stratum(&sides), 0.5 * PI * RADIUS * RADIUS, (2.0 + PI) * RADIUS));
        interfaces.push((stratum(&[0, n as u16 + 1]), 4.0 / 3.0 * PI * RADIUS * RADIUS, 2.0 * PI * RADIUS));
    }
    Body::new(indicators, h, &points, &curves, interfaces, count)
}

/// Returns a ball cut into four regions that meet at its centre. Each region is centred on the
/// direction towards one corner of a regular tetrahedron. There is one junction point inside the
/// ball and four on its surface.
pub(crate) fn corners(h: f64, count: usize) -> Body {
    let ways = [DVec3::ONE, DVec3::new(1.0, -1.0, -1.0), DVec3::new(-1.0, 1.0, -1.0), DVec3::new(-1.0, -1.0, 1.0)];
    let region = |own: DVec3| {
        let planes = ways.into_iter().filter(|way| *way != own).map(|way| half_space(CENTRE, (way - own).normalize()));
        maximum(ball(CENTRE, RADIUS), planes.reduce(maximum).expect("three planes"))
    };
    let mut functions = vec![negative(ball(CENTRE, RADIUS))];
    functions.extend(ways.map(region));
    let indicators = Analytic::new(functions, 1.0);
    // direction of the ray along which all regions except `without` meet
    let ray = |without: usize| -ways[without].normalize();
    let others = |without: &[usize]| (0..4).filter(|n| !without.contains(n)).map(|n| n as u16 + 1).collect::<Vec<_>>();
    let mut points = vec![(stratum(&[1, 2, 3, 4]), CENTRE)];
    let (mut curves, mut interfaces) = (Vec::new(), Vec::new());
    for n in 0..4 {
        points.push((stratum(&[&[0], others(&[n]).as_slice()].concat()), CENTRE + RADIUS * ray(n)));
        let out = ray(n);
        curves.push(Curve {
            on: stratum(&others(&[n])),
            length: RADIUS,
            ends: [0, n as u32 + 1],
            point_at: Box::new(move |share| CENTRE + RADIUS * share * out),
        });
    }
    let angle = ray(0).angle_between(ray(1));
    for c in 0..4 {
        for d in c + 1..4 {
            let (from, to) = (ray(c), ray(d));
            let sides = others(&[c, d]);
            curves.push(Curve {
                on: stratum(&[&[0], sides.as_slice()].concat()),
                length: RADIUS * angle,
                ends: [c as u32 + 1, d as u32 + 1],
                point_at: Box::new(move |share| {
                    let part = |share: f64| (share * angle).sin() / angle.sin();
                    CENTRE + RADIUS * (part(1.0 - share) * from + part(share) * to)
                }),
            });
            interfaces.push((stratum(&sides), 0.5 * angle * RADIUS * RADIUS, (2.0 + angle) * RADIUS));
        }
        interfaces.push((stratum(&[0, c as u16 + 1]), PI * RADIUS * RADIUS, 3.0 * angle * RADIUS));
    }
    Body::new(indicators, h, &points, &curves, interfaces, count)
}
