//! Handles and gaps: the critical points of F that the mesh has on the wrong side get points around them. Where all are on their right
//! sides, and mesh and marching cubes differ in genus or in the number of pieces, it is marching cubes that errs.

use super::insert::{Candidate, Reason};
use super::pieces::Pieces;
use super::{GENUS_ROUNDS, Refinement, TURNED, component_at};
use crate::critical::{CriticalPoint, critical_points};
use crate::defects::Defects;
use crate::isosurface::bounds;
use crate::restricted::Facet;
use glam::DVec3;
use isoparticles_mesh::components::NO_COMPONENT;
use isoparticles_mesh::spatial::Bounds;
use isoparticles_stage::error::Result;
use rayon::prelude::*;
use std::collections::{BTreeSet, HashSet};

/// Necks, gaps and specks of a smaller radius, in voxels, are taken as the mesh has them: they say nothing of the object, and edges that
/// short would cost more than they tell.
const FINEST: f64 = 0.1;

/// Spheres of points round a critical point that is still on the wrong side after its nearest points of F = 0 are in the mesh, each twice
/// as large as the one before.
const SPHERES: i32 = 4;

/// Points of such a sphere keep this part of its radius from all others.
const APART: f64 = 0.5;

/// Vertices of a piece of the mesh that may be a scrap, and tetrahedra within it.
const LARGEST_SCRAP: usize = 16;
const SCRAP_TETRAHEDRA: usize = 64;

impl Refinement<'_> {
    /// The critical points that the mesh had on the wrong side at the last comparison, with the nearest vertex of each.
    pub(super) fn astray(&self) -> &[(CriticalPoint, u32)] {
        let wrong = |c: &CriticalPoint| {
            let near = self.nearest.to(c.position)?.0;
            (!self.has_right(c, near)).then_some((*c, near))
        };
        let find = || self.critical_points().par_iter().filter_map(wrong).collect();
        if self.sides_are_known { self.astray.get_or_init(find) } else { &[] }
    }

    /// Whether the mesh has a critical point on its right side; `near` is a vertex not far from it.
    fn has_right(&self, c: &CriticalPoint, near: u32) -> bool {
        self.restricted.holds(c.position, near) == (c.value < 0.0)
    }

    /// Whether a critical point on the wrong side lies in a box or within a margin (mm) of it.
    fn any_astray_near(&self, (low, high): (DVec3, DVec3), margin: f64) -> bool {
        let near = Bounds { low: low - margin, high: high + margin };
        self.astray().iter().any(|(c, _)| near.holds(c.position))
    }

    /// The facets that lie across F = 0.
    fn across<'f>(&self, facets: &'f [Facet]) -> impl ParallelIterator<Item = &'f Facet> {
        facets.par_iter().filter(|f| self.at_centroid(f).1 < TURNED)
    }

    /// Pieces of the mesh that are components of F = 0 between its samples, where marching cubes has nothing: they hold an extremum of F
    /// on its right side, and no facet of theirs lies across F = 0.
    pub(super) fn unsampled_components(&self, facets: &[Facet], defects: &Defects) -> usize {
        let mut unknown = vec![true; defects.component_count];
        let piece = |v: u32| defects.piece_of_vertex[v as usize];
        for (&component, &piece) in self.component_of.iter().zip(&defects.piece_of_vertex) {
            if component != NO_COMPONENT && piece != NO_COMPONENT {
                unknown[piece as usize] = false;
            }
        }
        if !self.sides_are_known || !unknown.contains(&true) {
            return 0;
        }
        for across in self.across(facets).map(|f| piece(f.vertices[0])).collect::<Vec<u32>>() {
            unknown[across as usize] = false;
        }
        let holder = |c: &CriticalPoint| {
            let near = self.nearest.to(c.position)?.0;
            let piece = piece(near);
            (piece != NO_COMPONENT && unknown[piece as usize] && self.has_right(c, near)).then_some(piece)
        };
        let extrema = self.critical_points().iter().filter(|c| c.is_enclosed());
        extrema.filter_map(holder).collect::<BTreeSet<u32>>().len()
    }

    /// Takes the word of the mesh for classes that it joins, and that no look at the spline could tell apart or together, where no critical
    /// point near the joint is on the wrong side and no facet of it lies across F = 0. True when some are joined.
    pub(super) fn trust_joins(&mut self, facets: &[Facet], defects: &Defects, pairs: Vec<(u32, u32)>) -> bool {
        if pairs.is_empty() || !self.sides_are_known {
            return false;
        }
        let mut learnt = false;
        for (a, b) in pairs {
            let of_pair = |v: u32| [a, b].contains(&self.isosurface.class_of(self.component_of[v as usize]));
            let bridges = defects.bridges.iter().map(|&f| &facets[f as usize]);
            let joint: Vec<&Facet> = bridges.filter(|f| f.vertices.into_iter().all(of_pair)).collect();
            let points = joint.iter().flat_map(|f| f.vertices).map(|v| self.restricted.points()[v as usize]);
            let Some(bounds) = bounds(&points.collect::<Vec<DVec3>>()) else { continue };
            let sizes = joint.iter().flat_map(|f| f.vertices).map(|v| self.sizes[v as usize]);
            let is_wrong = self.any_astray_near(bounds, sizes.fold(0.0, f64::max));
            if !is_wrong && joint.iter().all(|f| self.at_centroid(f).1 >= TURNED) {
                self.isosurface.merge(a, b);
                learnt = true;
            }
        }
        learnt
    }

    pub(super) fn critical_points(&self) -> &[CriticalPoint] {
        let field = self.restricted.field();
        self.critical.get_or_init(|| critical_points(field, FINEST * field.geometry().mean_spacing()))
    }

    /// Takes the word of the mesh for the genus and the pieces of a class where it has every critical point on the right side, no
    /// facet across F = 0, and no defect else. True when that tells something new of the isosurface.
    pub(super) fn trust_critical_points(&mut self, facets: &[Facet], defects: &Defects) -> bool {
        let doubtful = !(defects.wrong_genus.is_empty() && defects.in_pieces.is_empty());
        if !doubtful
            || !self.sides_are_known
            || !defects.is_manifold()
            || !defects.bridges.is_empty()
            || !defects.missing.is_empty()
        {
            return false;
        }
        let mut wrong = BTreeSet::new();
        for &(c, near) in self.astray() {
            let ways = c.ways.iter().flat_map(|&way| [c.position + way, c.position - way]);
            let around = ways.map(|p| component_at(p, self.restricted.field(), &self.isosurface));
            wrong.extend(around.chain([self.component_of[near as usize]]));
        }
        if wrong.contains(&NO_COMPONENT) {
            // whose it is, nobody knows
            return false;
        }
        let across: Vec<u32> = self.across(facets).flat_map_iter(|f| f.vertices).collect();
        wrong.extend(across.iter().map(|&v| self.component_of[v as usize]));
        let across: HashSet<u32> = across.iter().map(|&v| defects.piece_of_vertex[v as usize]).collect();
        let joints = self.hidden_joints(defects);
        if self.is_by_sign && self.astray().is_empty() && !joints.is_empty() {
            joints.iter().for_each(|(_, [a, b])| self.isosurface.merge(*a, *b));
            return true;
        }
        let shared: HashSet<u32> = joints.into_iter().map(|(piece, _)| piece).collect();
        let mut learnt = false;
        for pieces in self.pieces(defects) {
            // the largest piece may err elsewhere, the others must not
            let is_right = |k: &usize| {
                let is_own = !shared.contains(&defects.piece_of_vertex[pieces.vertices(*k)[0] as usize]);
                is_own && (!wrong.contains(&pieces.class()) || self.is_right(&pieces, *k, defects, &across))
            };
            let count = 1 + (1..pieces.count()).filter(is_right).count();
            if count > self.isosurface.pieces(pieces.class()) {
                self.isosurface.set_pieces(pieces.class(), count);
                learnt = true;
            }
        }
        for &(class, euler) in defects.wrong_genus.iter().filter(|(class, _)| !wrong.contains(class)) {
            self.isosurface.set_euler(class, euler);
            learnt = true;
        }
        learnt
    }

    /// Components of facets that join two classes through vertices of which no class is known, so that there is no facet to tell, and these
    /// classes.
    fn hidden_joints(&self, defects: &Defects) -> Vec<(u32, [u32; 2])> {
        let mut class_of = vec![NO_COMPONENT; defects.component_count];
        let mut joints = Vec::new();
        for (&piece, &class) in defects.piece_of_vertex.iter().zip(&self.component_of) {
            if piece != NO_COMPONENT && class != NO_COMPONENT {
                let known = &mut class_of[piece as usize];
                if *known == NO_COMPONENT {
                    *known = class;
                } else if *known != class {
                    joints.push((piece, [*known, class]));
                }
            }
        }
        joints.sort_unstable();
        joints.dedup();
        joints
    }

    /// Whether one of the smaller pieces of a class is a component of its own: no critical point near it, or in the gap between it and the
    /// larger ones, is on the wrong side, and no facet of it lies across F = 0, or else it holds an extremum of F on its right side. `across` are
    /// the components of facets that have such a facet.
    fn is_right(&self, pieces: &Pieces, k: usize, defects: &Defects, across: &HashSet<u32>) -> bool {
        let place = |&v: &u32| self.restricted.points()[v as usize];
        let Some(gap) = self.gap(pieces, k, defects) else { return false };
        let own = pieces.vertices(k);
        let Some(bounds) = bounds(&own.iter().chain(&gap).map(place).collect::<Vec<DVec3>>()) else { return false };
        let margin = own.iter().map(|&v| self.sizes[v as usize]).fold(0.0, f64::max);
        !self.any_astray_near(bounds, margin)
            && (!across.contains(&defects.piece_of_vertex[own[0] as usize]) || self.holds_extremum(own))
    }

    /// Whether an extremum of F next to some vertices (ascending) is on its right side.
    fn holds_extremum(&self, vertices: &[u32]) -> bool {
        let is_held = |c: &CriticalPoint| {
            let near = self.nearest.to(c.position).map(|(v, _)| v).filter(|v| vertices.binary_search(v).is_ok());
            near.is_some_and(|near| self.has_right(c, near))
        };
        self.critical_points().par_iter().any(|c| c.is_enclosed() && is_held(c))
    }

    /// Lets the tetrahedra of small pieces change sides that are none of F = 0: they have a facet across it and no extremum of F, which every
    /// closed surface F = 0 goes round. Returns how many pieces there were.
    pub(super) fn drop_scraps(&mut self, facets: &[Facet], defects: &Defects) -> usize {
        if !self.sides_are_known || defects.in_pieces.is_empty() {
            return 0;
        }
        let piece = |f: &Facet| defects.piece_of_vertex[f.vertices[0] as usize];
        let across: HashSet<u32> = self.across(facets).map(piece).collect();
        let mut scraps = Vec::new();
        for pieces in self.pieces(defects) {
            for own in (1..pieces.count()).map(|k| pieces.vertices(k)).filter(|own| own.len() <= LARGEST_SCRAP) {
                let number = defects.piece_of_vertex[own[0] as usize];
                if across.contains(&number) && !self.holds_extremum(own) {
                    let shell: Vec<Facet> = facets.iter().copied().filter(|f| piece(f) == number).collect();
                    scraps.extend(self.restricted.enclosed(&shell, SCRAP_TETRAHEDRA));
                }
            }
        }
        scraps.iter().for_each(|scrap| self.restricted.change_sides(scrap));
        self.report.dropped_scraps += scraps.len();
        scraps.len()
    }

    /// Adds points round the critical points on the wrong side until some fit, and returns how many; the critical points are counted for the
    /// report. The first time the rounds are granted anew, so that other defects, of which noise has many, cannot use them up.
    ///
    /// # Errors
    /// None as a rule; those of the triangulation.
    pub(super) fn insert_at_critical_points(&mut self) -> Result<usize> {
        let astray = self.astray().to_vec();
        self.report.unresolved_critical = astray.len();
        if self.genus_rounds == 0 && !astray.is_empty() {
            self.allow_rounds(self.granted);
        }
        // what the points upset takes rounds to come right again
        let has_room = 2 * (self.options.max_rounds - self.report.rounds) >= self.granted.max(1);
        while has_room && !astray.is_empty() && self.genus_rounds < GENUS_ROUNDS {
            let candidates = self.at_critical_points(&astray, self.genus_rounds);
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
    fn at_critical_points(&self, astray: &[(CriticalPoint, u32)], attempt: usize) -> Vec<Candidate> {
        let candidate = |start: DVec3, c: &CriticalPoint, size: f64, apart: f64| {
            let point = self.on_surface(start, 2.0)?;
            let (near, radius) = self.nearest.to(point)?;
            let reach = start.distance(c.position);
            let fits = radius > apart && point.distance(start) < reach;
            fits.then_some(Candidate { reason: Reason::Genus, point, radius: radius.min(reach), size, near })
        };
        let mut candidates = Vec::new();
        for &(c, near) in astray {
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::isosurface::Isosurface;
    use crate::refine::RefineOptions;
    use crate::refine::looks::LOOKS;
    use crate::scenes::{self, Scene};
    use crate::tests::surface_points;
    use std::sync::OnceLock;

    /// What is made of the joint of two classes that the mesh joins, at each spacing of the points at which it does so and neither marching
    /// cubes nor a look does.
    fn trusted(scene: &Scene) -> Vec<bool> {
        let mut answers = Vec::new();
        for spacing in [0.3, 0.5, 0.85] {
            let isosurface = Isosurface::new(&scene.image);
            let mut points = surface_points(scene, spacing);
            let options = RefineOptions::default();
            let mut refinement = Refinement::new(&mut points, &scene.field, isosurface, options).unwrap();
            refinement.nearest.update(refinement.restricted.points());
            let facets = refinement.facets();
            let defects = refinement.defects(&facets);
            let bridges = defects.bridges.iter().map(|&f| facets[f as usize].vertices);
            let edges = bridges.flat_map(|[a, b, c]| [[a, b], [b, c], [c, a]]);
            let joint: Vec<_> = edges.filter(|e| e.map(|v| refinement.component_of[v as usize]) == [0, 1]).collect();
            let places = |e: &[u32; 2]| e.map(|v| refinement.restricted.points()[v as usize]);
            let is_seen = (0..LOOKS).any(|look| joint.iter().any(|e| Isosurface::joins(&scene.field, places(e), look)));
            if refinement.component_count() == 2 && !joint.is_empty() && !is_seen {
                answers.push(refinement.trust_joins(&facets, &defects, vec![(0, 1)]));
                assert_eq!(refinement.component_count(), if answers.ends_with(&[true]) { 1 } else { 2 });
            }
        }
        answers
    }

    #[test]
    fn a_joint_too_fine_for_any_look_is_taken_from_the_mesh_unless_a_facet_lies_across_it() {
        // a neck of a few thousandths of a voxel; with points 0.3 apart, one of the facets there is turned away from grad F
        let scene = scenes::touching_tips(2.0, DVec3::new(15.4, 15.7, 15.6), -1e-6);
        assert_eq!(trusted(&scene), [false, true, true]);
    }

    #[test]
    fn a_piece_is_right_unless_a_critical_point_near_it_is_not_or_it_has_facets_across_f_and_no_extremum() {
        let scene = scenes::two_balls();
        let mut points = surface_points(&scene, 1.4);
        let isosurface = Isosurface::new(&scene.image);
        let mut refinement = Refinement::new(&mut points, &scene.field, isosurface, RefineOptions::default()).unwrap();
        let facets = refinement.run(|_, _| Ok(())).unwrap();
        assert!(refinement.hidden_joints(&refinement.defects(&facets)).is_empty());
        let changed = facets[0].vertices[0];
        refinement.component_of[changed as usize] ^= 1;
        let defects = refinement.defects(&facets);
        let joint = (defects.piece_of_vertex[changed as usize], [1, 0]);
        assert!([joint, (joint.0, [0, 1])].contains(&refinement.hidden_joints(&defects)[0]));
        // the two balls as one class in two pieces
        refinement.isosurface.merge(0, 1);
        refinement.component_of.iter_mut().for_each(|c| *c = 0);
        let defects = refinement.defects(&facets);
        assert_eq!(defects.in_pieces, [(0, 2)]);
        let pieces = &refinement.pieces(&defects)[0];
        let smaller = defects.piece_of_vertex[pieces.vertices(1)[0] as usize];
        let is_right = |refinement: &Refinement, across: &[u32]| {
            refinement.is_right(pieces, 1, &defects, &across.iter().copied().collect())
        };
        assert!(is_right(&refinement, &[]) && is_right(&refinement, &[1 - smaller]));
        // it holds the ball's centre
        assert!(is_right(&refinement, &[smaller]));
        // with the sides of the other ball alone its centre is outside
        let other: Vec<Facet> =
            facets.into_iter().filter(|f| defects.piece_of_vertex[f.vertices[0] as usize] != smaller).collect();
        refinement.restricted.set_sides(refinement.restricted.sides_of(&other));
        refinement.astray = OnceLock::new();
        assert!(!is_right(&refinement, &[]) && !is_right(&refinement, &[smaller]));
    }
}
