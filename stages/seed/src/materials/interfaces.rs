//! Places particles on material interfaces.

use super::Curves;
use crate::sampling::{
    COMPONENT_MINIMUM, Candidates, DISK_RADIUS, OVERSAMPLING, centre_and_normal, eliminate, sample, sample_alone,
};
use glam::DVec3;
use isoparticles_field::materials::complex::Complex;
use isoparticles_field::materials::{Indicators, Stratum};
use isoparticles_field::neighbours::LevelBins;
use isoparticles_field::sizing::SizingField;
use isoparticles_mesh::TriangleMesh;
use rayon::prelude::*;

/// Minimum distance, in units of h, from a particle on an interface to the particles on the border
/// of the interface.
const FROM_BORDER: f64 = DISK_RADIUS;

/// Maximum distance from the triangles to their interface and tolerance of the projection, both in
/// voxels. The values are the same as for one object.
const FARTHEST: f64 = 1.5;
const TOLERANCE: f64 = 1e-6;

/// Area in squared voxels below which a component with a border gets no particle. The border of
/// such a component is a closed curve that is about half a voxel long or shorter. The complex omits
/// curves shorter than half a voxel.
const SPECK: f64 = 0.05;

/// The particles on interfaces.
#[derive(Clone, Debug, Default)]
pub struct InterfaceParticles {
    /// Positions in mm in the grid frame.
    pub positions: Vec<DVec3>,
    /// Unit normals that point from the material with the higher number to the material with the
    /// lower number.
    pub normals: Vec<DVec3>,
    /// Edge lengths h, mm.
    pub sizes: Vec<f64>,
    /// Interface of each particle.
    pub of: Vec<Stratum>,
    /// Number of components of the interfaces.
    pub components: usize,
    /// Number of components that were sampled separately because they have too few particles at the
    /// spacing h.
    pub crowded: usize,
    /// Number of components that have no particle even after separate sampling.
    pub bare: usize,
    /// Number of components that were skipped because they are far smaller than a voxel's face.
    pub specks: usize,
    /// Number of points that were skipped because the projection failed or a third material is
    /// nearer.
    pub not_projected: usize,
}

/// A particle on an interface.
struct Placed {
    position: DVec3,
    normal: DVec3,
    component: u32,
}

/// Samples the interfaces of a complex, and holds the particles at points and on curves fixed.
pub fn seed_interfaces<I: Indicators>(
    indicators: &I,
    complex: &Complex,
    (spread, sizing): (&SizingField, &SizingField),
    curves: &Curves,
    seed: u64,
) -> InterfaceParticles {
    let vertices = complex.vertices.iter().map(|vertex| vertex.position).collect();
    let mesh = TriangleMesh { vertices, triangles: complex.triangles.iter().map(|t| t.corners).collect() };
    let (component, count) = complex.interface_components();
    let mut members = vec![Vec::new(); count];
    let mut is_closed = vec![true; count];
    for (t, &c) in (0..).zip(&component) {
        members[c as usize].push(t);
        let corners = mesh.triangles[t as usize];
        is_closed[c as usize] &= corners.iter().all(|&v| complex.vertices[v as usize].stratum.dimension() == 2);
    }
    let interface_of: Vec<Stratum> = members.iter().map(|own| complex.triangles[own[0] as usize].interface).collect();
    let every: Vec<u32> = (0..mesh.triangles.len() as u32).collect();
    let density = |p, normal| OVERSAMPLING * spread.lattice_density(p, normal);
    let all = sample(&mesh, &every, |t| component[t], density, |p| spread.at(p), seed);
    let border = Border::new(curves, spread);
    let all = border.beyond(all, &interface_of);
    let mut chosen = eliminate(&all, seed, |a, b| all.component[a] == all.component[b]);
    chosen.sort_unstable();
    let place = |point: DVec3, normal: DVec3, component: u32| {
        met(indicators, interface_of[component as usize], point, normal).map(|(position, normal)| Placed {
            position,
            normal,
            component,
        })
    };
    let placed: Vec<Option<Placed>> = chosen
        .par_iter()
        .map(|&i| place(all.points[i as usize], all.normals[i as usize], all.component[i as usize]))
        .collect();
    let mut found = InterfaceParticles { components: count, ..InterfaceParticles::default() };
    found.not_projected = placed.iter().filter(|placed| placed.is_none()).count();
    let mut counts = vec![0usize; count];
    placed.iter().flatten().for_each(|placed| counts[placed.component as usize] += 1);
    let is_bare = |c: usize| if is_closed[c] { counts[c] < COMPONENT_MINIMUM } else { counts[c] == 0 };
    for placed in placed.into_iter().flatten().filter(|placed| !is_bare(placed.component as usize)) {
        found.add(placed, &interface_of, sizing);
    }
    let area =
        |c: usize| members[c].iter().map(|&t| 0.5 * centre_and_normal(&mesh, t as usize).1.length()).sum::<f64>();
    let least = SPECK * indicators.voxel().powi(2);
    for c in (0..count).filter(|&c| is_bare(c)) {
        if !is_closed[c] && area(c) < least {
            found.specks += 1;
            continue;
        }
        let own = sample_alone(&mesh, &members[c], seed, c as u64);
        let mut own: Vec<Placed> = own.into_iter().filter_map(|(p, normal)| place(p, normal, c as u32)).collect();
        if !is_closed[c] {
            own = border.farthest(own, interface_of[c]).into_iter().collect();
        }
        found.crowded += 1;
        found.bare += usize::from(own.is_empty());
        own.into_iter().for_each(|placed| found.add(placed, &interface_of, sizing));
    }
    found
}

impl InterfaceParticles {
    fn add(&mut self, placed: Placed, interface_of: &[Stratum], sizing: &SizingField) {
        self.positions.push(placed.position);
        self.normals.push(placed.normal);
        self.sizes.push(sizing.at(placed.position));
        self.of.push(interface_of[placed.component as usize]);
    }
}

/// Projects a point of a triangle with this normal onto an interface. Returns the projected point
/// and the unit normal at this point, or `None` if the projection fails, another material is
/// nearer, or the normal points to the other side.
fn met<I: Indicators>(indicators: &I, interface: Stratum, point: DVec3, normal: DVec3) -> Option<(DVec3, DVec3)> {
    let &[low, high] = interface.materials() else { return None };
    let voxel = indicators.voxel();
    let position = indicators.project_onto_interface([high, low], point, FARTHEST * voxel, TOLERANCE * voxel)?;
    let own = indicators.difference_gradient(high, low, position).1.try_normalize()?;
    let is_real = indicators.clearance(position, &[low, high]) > 0.0;
    (is_real && own.dot(normal) > 0.0).then_some((position, own))
}

/// The particles at points and on curves. Particles on interfaces keep a minimum distance from
/// them.
struct Border<'a> {
    curves: &'a Curves,
    sizes: Vec<f64>,
    bins: LevelBins,
}

impl<'a> Border<'a> {
    fn new(curves: &'a Curves, spread: &SizingField) -> Self {
        let sizes: Vec<f64> = curves.positions.iter().map(|&p| spread.at(p)).collect();
        let bins = LevelBins::new(&curves.positions, &sizes, FROM_BORDER);
        Self { curves, sizes, bins }
    }

    /// Returns the candidates that are far enough from the particles on the borders of their
    /// interfaces.
    fn beyond(&self, all: Candidates, interface_of: &[Stratum]) -> Candidates {
        let is_beyond = |i: usize| {
            let (p, h, interface) = (all.points[i], all.sizes[i], &interface_of[all.component[i] as usize]);
            let mut far = true;
            self.bins.visit(p, h, |j| {
                let j = j as usize;
                let radius = FROM_BORDER * h.min(self.sizes[j]);
                let is_near = p.distance_squared(self.curves.positions[j]) < radius * radius;
                far &= !(is_near && self.curves.strata.of[j].is_on(interface));
            });
            far
        };
        let kept: Vec<usize> = (0..all.points.len()).into_par_iter().filter(|&i| is_beyond(i)).collect();
        Candidates {
            points: kept.iter().map(|&i| all.points[i]).collect(),
            normals: kept.iter().map(|&i| all.normals[i]).collect(),
            sizes: kept.iter().map(|&i| all.sizes[i]).collect(),
            component: kept.iter().map(|&i| all.component[i]).collect(),
        }
    }

    /// Returns the particle in `own` that is farthest from the particles on the border of the
    /// interface `interface`.
    fn farthest(&self, own: Vec<Placed>, interface: Stratum) -> Option<Placed> {
        let border: Vec<DVec3> = (0..self.curves.positions.len())
            .filter(|&j| self.curves.strata.of[j].is_on(&interface))
            .map(|j| self.curves.positions[j])
            .collect();
        let distance = |p: DVec3| border.iter().map(|b| b.distance_squared(p)).fold(f64::INFINITY, f64::min);
        let all = own.into_iter().map(|placed| (distance(placed.position), placed));
        all.reduce(|best, next| if next.0 > best.0 { next } else { best }).map(|(_, placed)| placed)
    }
}
