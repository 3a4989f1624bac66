//! Places particles on material interfaces.

use super::Curves;
use crate::sampling::{
    COMPONENT_MINIMUM, Candidates, DISK_RADIUS, MAX_PROJECTION, OVERSAMPLING, PROJECTION_TOLERANCE, centre_and_normal,
    eliminate, sample, sample_alone,
};
use glam::DVec3;
use isoparticles_field::materials::complex::Complex;
use isoparticles_field::materials::{Indicators, Stratum};
use isoparticles_field::neighbours::LevelBins;
use isoparticles_field::sizing::SizingField;
use isoparticles_mesh::TriangleMesh;
use rayon::prelude::*;

/// Minimum distance, in units of h, from a particle on an interface to the particles on the border
/// of the interface: the same as the minimum distance between two particles on the interface.
const BORDER_DISTANCE: f64 = DISK_RADIUS;

/// Area, in squared voxel lengths, below which a component with a border is left without particles
/// if sampling gives it none. A disc of this area has a diameter of 0.25 voxel and a circumference
/// of 0.8 voxel. The complex itself drops closed curves shorter than 0.5 voxel (`SPECK` in
/// `complex/chains.rs`).
const SPECK_AREA: f64 = 0.05;

/// The particles on interfaces.
#[derive(Clone, Debug, Default)]
pub struct InterfaceParticles {
    /// Positions in mm in the grid frame.
    pub positions: Vec<DVec3>,
    /// Unit normals that point from the material with the higher ID to the material with the lower
    /// ID.
    pub normals: Vec<DVec3>,
    /// Edge lengths h, mm.
    pub sizes: Vec<f64>,
    /// Interface of each particle.
    pub of: Vec<Stratum>,
    /// Number of components of the interfaces.
    pub components: usize,
    /// Number of components that were resampled separately because sampling at spacing h gave them
    /// too few particles.
    pub crowded: usize,
    /// Number of components that have no particle even after resampling.
    pub bare: usize,
    /// Number of components without particles whose area is below `SPECK_AREA`.
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

/// Places particles on the interfaces of a complex, at a minimum distance from the particles at
/// junction points and on curves.
pub fn seed_interfaces<I: Indicators>(
    indicators: &I,
    complex: &Complex,
    (spread, sizing): (&SizingField, &SizingField),
    curves: &Curves,
    seed: u64,
) -> InterfaceParticles {
    let parts = Components::new(complex);
    let count = parts.interface.len();
    let border = Border::new(curves, spread);
    let placed = parts.sampled(indicators, &border, spread, seed);
    let mut found = InterfaceParticles { components: count, ..InterfaceParticles::default() };
    found.not_projected = placed.iter().filter(|placed| placed.is_none()).count();
    let mut counts = vec![0usize; count];
    placed.iter().flatten().for_each(|placed| counts[placed.component as usize] += 1);
    let is_bare = |c: usize| if parts.is_closed[c] { counts[c] < COMPONENT_MINIMUM } else { counts[c] == 0 };
    for placed in placed.into_iter().flatten().filter(|placed| !is_bare(placed.component as usize)) {
        found.add(placed, &parts.interface, sizing);
    }
    let least = SPECK_AREA * indicators.voxel().powi(2);
    for c in (0..count).filter(|&c| is_bare(c)) {
        if !parts.is_closed[c] && parts.area(c) < least {
            found.specks += 1;
            continue;
        }
        let own = sample_alone(&parts.mesh, &parts.members[c], seed, c as u64);
        let mut own: Vec<Placed> =
            own.into_iter().filter_map(|(p, normal)| parts.place(indicators, p, normal, c as u32)).collect();
        if !parts.is_closed[c] {
            own = border.farthest(own, parts.interface[c]).into_iter().collect();
        }
        found.crowded += 1;
        found.bare += usize::from(own.is_empty());
        own.into_iter().for_each(|placed| found.add(placed, &parts.interface, sizing));
    }
    found
}

/// The triangles of a complex, grouped by the components of its interfaces.
struct Components {
    mesh: TriangleMesh,
    /// Component of each triangle.
    of_triangle: Vec<u32>,
    /// Triangles of each component.
    members: Vec<Vec<u32>>,
    /// Whether a component has no border.
    is_closed: Vec<bool>,
    /// Interface of each component.
    interface: Vec<Stratum>,
}

impl Components {
    fn new(complex: &Complex) -> Self {
        let vertices = complex.vertices.iter().map(|vertex| vertex.position).collect();
        let mesh = TriangleMesh { vertices, triangles: complex.triangles.iter().map(|t| t.corners).collect() };
        let (of_triangle, count) = complex.interface_components();
        let mut members = vec![Vec::new(); count];
        let mut is_closed = vec![true; count];
        for (t, &c) in (0..).zip(&of_triangle) {
            members[c as usize].push(t);
            let corners = mesh.triangles[t as usize];
            is_closed[c as usize] &= corners.iter().all(|&v| complex.vertices[v as usize].stratum.dimension() == 2);
        }
        let interface = members.iter().map(|own| complex.triangles[own[0] as usize].interface).collect();
        Self { mesh, of_triangle, members, is_closed, interface }
    }

    /// Samples all components with the density of `spread`, at a minimum distance from the
    /// particles on their borders. A sample is `None` if it cannot be projected onto its interface.
    fn sampled<I: Indicators>(
        &self,
        indicators: &I,
        border: &Border<'_>,
        spread: &SizingField,
        seed: u64,
    ) -> Vec<Option<Placed>> {
        let every: Vec<u32> = (0..self.mesh.triangles.len() as u32).collect();
        let density = |p, normal| OVERSAMPLING * spread.lattice_density(p, normal);
        let all = sample(&self.mesh, &every, |t| self.of_triangle[t], density, |p| spread.at(p), seed);
        let all = border.beyond(all, &self.interface);
        let mut chosen = eliminate(&all, seed, |a, b| all.component[a] == all.component[b]);
        chosen.sort_unstable();
        let place = |&i: &u32| {
            let i = i as usize;
            self.place(indicators, all.points[i], all.normals[i], all.component[i])
        };
        chosen.par_iter().map(place).collect()
    }

    /// Projects a point of a component onto the interface to which the component belongs.
    fn place<I: Indicators>(&self, indicators: &I, point: DVec3, normal: DVec3, component: u32) -> Option<Placed> {
        let (position, normal) = met(indicators, self.interface[component as usize], point, normal)?;
        Some(Placed { position, normal, component })
    }

    /// Returns the area of a component in mm^2.
    fn area(&self, c: usize) -> f64 {
        self.members[c].iter().map(|&t| 0.5 * centre_and_normal(&self.mesh, t as usize).1.length()).sum()
    }
}

impl InterfaceParticles {
    fn add(&mut self, placed: Placed, interface_of: &[Stratum], sizing: &SizingField) {
        self.positions.push(placed.position);
        self.normals.push(placed.normal);
        self.sizes.push(sizing.at(placed.position));
        self.of.push(interface_of[placed.component as usize]);
    }
}

/// Projects a point of a triangle onto an interface. Returns the projected point and the unit
/// normal there. Returns `None` if the projection fails, if another material is nearer, or if the
/// unit normal and the normal of the triangle differ by 90 degrees or more.
fn met<I: Indicators>(indicators: &I, interface: Stratum, point: DVec3, normal: DVec3) -> Option<(DVec3, DVec3)> {
    let &[low, high] = interface.materials() else { return None };
    let voxel = indicators.voxel();
    let position =
        indicators.project_onto_interface([high, low], point, MAX_PROJECTION * voxel, PROJECTION_TOLERANCE * voxel)?;
    let own = indicators.difference_gradient(high, low, position).1.try_normalize()?;
    let is_real = indicators.clearance(position, &[low, high]) > 0.0;
    (is_real && own.dot(normal) > 0.0).then_some((position, own))
}

/// The particles at points and on curves, from which particles on interfaces keep a distance of at
/// least [`BORDER_DISTANCE`] times h.
struct Border<'a> {
    curves: &'a Curves,
    sizes: Vec<f64>,
    bins: LevelBins,
}

impl<'a> Border<'a> {
    fn new(curves: &'a Curves, spread: &SizingField) -> Self {
        let sizes: Vec<f64> = curves.positions.iter().map(|&p| spread.at(p)).collect();
        let bins = LevelBins::new(&curves.positions, &sizes, BORDER_DISTANCE);
        Self { curves, sizes, bins }
    }

    /// Returns the candidates that are at least [`BORDER_DISTANCE`] times h away from the particles
    /// on the border of their interface.
    fn beyond(&self, all: Candidates, interface_of: &[Stratum]) -> Candidates {
        let is_beyond = |i: usize| {
            let (p, h, interface) = (all.points[i], all.sizes[i], &interface_of[all.component[i] as usize]);
            let mut far = true;
            self.bins.visit(p, h, |j| {
                let j = j as usize;
                let radius = BORDER_DISTANCE * h.min(self.sizes[j]);
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

    /// Returns the particle in `own` that is farthest from the border of `interface`.
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
