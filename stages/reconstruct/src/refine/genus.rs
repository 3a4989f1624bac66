//! Handles and gaps: the critical points of F that the mesh has on the wrong side get points around them.

use super::insert::{Candidate, Reason};
use super::{GENUS_ROUNDS, Refinement, TURNED};
use crate::defects::Defects;
use crate::restricted::Facet;
use glam::DVec3;
use isoparticles_field::topology::{CriticalPoint, RESOLUTION};
use isoparticles_mesh::components::NO_COMPONENT;
use isoparticles_stage::error::Result;
use rayon::prelude::*;
use std::collections::{BTreeMap, HashSet};

/// Spheres of points round a critical point that is still on the wrong side after its nearest points of F = 0 are in the mesh, each twice
/// as large as the one before.
const SPHERES: i32 = 4;

/// Points of such a sphere keep this part of its radius from all others.
const APART: f64 = 0.5;

/// Vertices of a piece of the mesh that may be dropped, and tetrahedra within it.
const LARGEST_DROPPED: usize = 16;
const DROPPED_TETRAHEDRA: usize = 64;

impl Refinement<'_> {
    /// The critical points that the mesh had on the wrong side at the last comparison, with the nearest vertex of each.
    pub(super) fn wrong_sided(&self) -> &[(CriticalPoint, u32)] {
        let wrong = |c: &CriticalPoint| {
            let near = self.nearest.to(c.position)?.0;
            (!self.has_right(c, near)).then_some((*c, near))
        };
        let find = || self.critical_points().filter_map(wrong).collect();
        if self.sides_are_known { self.wrong_sided.get_or_init(find) } else { &[] }
    }

    /// Whether the mesh has a critical point on its right side; `near` is a vertex not far from it.
    fn has_right(&self, c: &CriticalPoint, near: u32) -> bool {
        self.restricted.holds(c.position, near) == (c.value < 0.0)
    }

    /// The facets that lie across F = 0.
    fn across<'f>(&self, facets: &'f [Facet]) -> impl ParallelIterator<Item = &'f Facet> {
        facets.par_iter().filter(|f| self.at_centroid(f).1 < TURNED)
    }

    /// The critical points that the mesh must have on their right sides.
    pub(super) fn critical_points(&self) -> impl ParallelIterator<Item = &CriticalPoint> {
        let resolution = RESOLUTION * self.restricted.field().geometry().mean_spacing();
        self.topology.critical_points().par_iter().filter(move |c| c.radius >= resolution)
    }

    /// Whether an extremum of F next to some vertices (ascending) is on its right side.
    fn holds_extremum(&self, vertices: &[u32]) -> bool {
        let is_held = |c: &CriticalPoint| {
            let near = self.nearest.to(c.position).map(|(v, _)| v).filter(|v| vertices.binary_search(v).is_ok());
            near.is_some_and(|near| self.has_right(c, near))
        };
        self.critical_points().any(|c| c.is_enclosed() && is_held(c))
    }

    /// Lets the tetrahedra of small pieces change sides that are none of F = 0: pieces too many of their group, or near no component, with a
    /// facet across F = 0 and no extremum of F, which every closed surface F = 0 goes round. Returns how many there were.
    pub(super) fn drop_pieces(&mut self, facets: &[Facet], defects: &Defects) -> usize {
        if !self.sides_are_known || (defects.in_pieces.is_empty() && defects.strangers == 0) {
            return 0;
        }
        let piece = |f: &Facet| defects.piece_of_vertex[f.vertices[0] as usize];
        let across: HashSet<u32> = self.across(facets).map(piece).collect();
        let pieces = self.pieces(defects);
        let smaller = pieces.iter().flat_map(|pieces| (1..pieces.count()).map(|k| pieces.vertices(k).to_vec()));
        let mut enclosed = Vec::new();
        for own in smaller.chain(self.strange_pieces(defects)).filter(|own| own.len() <= LARGEST_DROPPED) {
            let number = defects.piece_of_vertex[own[0] as usize];
            if across.contains(&number) && !self.holds_extremum(&own) {
                let shell: Vec<Facet> = facets.iter().copied().filter(|f| piece(f) == number).collect();
                enclosed.extend(self.restricted.enclosed(&shell, DROPPED_TETRAHEDRA));
            }
        }
        enclosed.iter().for_each(|tetrahedra| self.restricted.change_sides(tetrahedra));
        self.report.dropped_pieces += enclosed.len();
        enclosed.len()
    }

    /// The vertices, ascending, of each piece of the mesh that lies near no component of F = 0.
    fn strange_pieces(&self, defects: &Defects) -> Vec<Vec<u32>> {
        let mut pieces: BTreeMap<u32, Vec<u32>> = BTreeMap::new();
        if defects.strangers > 0 {
            let mut is_known = vec![false; defects.component_count];
            let used = || (0..).zip(&defects.piece_of_vertex).filter(|(_, piece)| **piece != NO_COMPONENT);
            used().for_each(|(v, &piece)| is_known[piece as usize] |= self.component_of[v as usize] != NO_COMPONENT);
            for (v, &piece) in used().filter(|(_, piece)| !is_known[**piece as usize]) {
                pieces.entry(piece).or_default().push(v as u32);
            }
        }
        pieces.into_values().collect()
    }

    /// Adds points round the critical points on the wrong side until some fit, and returns how many; the critical points are counted for the
    /// report. The first time the rounds are granted anew, so that other defects, of which noise has many, cannot use them up.
    ///
    /// # Errors
    /// None as a rule; those of the triangulation.
    pub(super) fn insert_at_critical_points(&mut self) -> Result<usize> {
        let wrong_sided = self.wrong_sided().to_vec();
        self.report.unresolved_critical = wrong_sided.len();
        if self.genus_rounds == 0 && !wrong_sided.is_empty() {
            self.allow_rounds(self.granted);
        }
        // what the points upset takes rounds to come right again
        let has_room = 2 * (self.options.max_rounds - self.report.rounds) >= self.granted.max(1);
        while has_room && !wrong_sided.is_empty() && self.genus_rounds < GENUS_ROUNDS {
            let candidates = self.at_critical_points(&wrong_sided, self.genus_rounds);
            self.genus_rounds += 1;
            let inserted = self.insert_all(candidates)?;
            if inserted > 0 {
                return Ok(inserted);
            }
        }
        Ok(0)
    }

    /// Points round the critical points on the wrong side: first where F = 0 is nearest to each in its principal directions, then on spheres
    /// around it.
    fn at_critical_points(&self, wrong_sided: &[(CriticalPoint, u32)], attempt: usize) -> Vec<Candidate> {
        let candidate = |start: DVec3, c: &CriticalPoint, size: f64, apart: f64| {
            let point = self.on_surface(start, 2.0)?;
            let (near, radius) = self.nearest.to(point)?;
            let reach = start.distance(c.position);
            let fits = radius > apart && point.distance(start) < reach;
            fits.then_some(Candidate { reason: Reason::Genus, point, radius: radius.min(reach), size, near })
        };
        let mut candidates = Vec::new();
        for &(c, near) in wrong_sided {
            let size = |radius: f64| self.sizes[near as usize].min(2.0 * radius);
            if attempt == 0 {
                let ends = c.ways.iter().filter(|way| **way != DVec3::ZERO).flat_map(|&way| [way, -way]);
                candidates.extend(ends.filter_map(|way| candidate(c.position + way, &c, size(way.length()), 0.0)));
                continue;
            }
            let radii = (0..SPHERES).map(|k| c.radius * f64::powi(2.0, k - attempt as i32 + 1));
            for radius in radii.filter(|&r| r < 2.0 * self.sizes[near as usize]) {
                let starts = directions().map(|d| c.position + radius * d);
                candidates.extend(starts.filter_map(|start| candidate(start, &c, size(radius), APART * radius)));
            }
        }
        candidates
    }
}

/// The 26 directions to the neighbours in a grid.
fn directions() -> impl Iterator<Item = DVec3> {
    let all = (0..27).map(|n| DVec3::new(f64::from(n % 3) - 1.0, f64::from(n / 3 % 3) - 1.0, f64::from(n / 9) - 1.0));
    all.filter(|d| *d != DVec3::ZERO).map(DVec3::normalize)
}
