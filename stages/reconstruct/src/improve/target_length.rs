//! Patch remeshing: remeshes the surroundings of a triangle at a smaller target length, where h is
//! too long for the curvature of F.
//!
//! If edges are short compared with the radii of curvature, nearly equilateral triangles have a
//! small deviation and normal deviation (sampling by local feature size, Amenta and Bern 1999). The
//! target length is 1 / sqrt(k1^2 + k2^2) with the principal curvatures k1 and k2. It grows with
//! distance up to the edge length at the rim of the patch. A small closed component is a patch
//! without a rim.

use super::Tally;
use super::acceptance::{Goal, Limits, commit_or_rollback};
use super::constants::{
    COARSEN_DEVIATION, GRADATIONS, LONG, MOST_TRIANGLES, PATCH_LENGTHS, RIM, RINGS_OF_LENGTH, ROUNDS, SHORT, SHORTER,
    TARGET,
};
use super::lift::{After, lift, make};
use super::moves::Move;
use super::nodes::NodeSides;
use super::patch::Patch;
use super::remesh::{self, Curves};
use super::surface::{DEAD, Surface, edges_of};
use crate::interfaces::Interface;
use glam::DVec3;
use isoparticles_field::curvature::curvature_tensor;
use isoparticles_mesh::spatial::Bounds;

/// A demand for short edges: an upper bound of the target length at a position, which grows with
/// distance at the rate of the gradation. The lower bound [`Place::least`] takes precedence.
#[derive(Clone, Copy, Debug)]
struct Demand {
    /// Position in the grid frame, mm.
    at: DVec3,
    /// Target length at the position, mm.
    length: f64,
}

/// Centre and scale of a patch: the centroid of its triangle, and the mean edge length of the mesh
/// around it (at most h), in mm.
#[derive(Clone, Copy)]
struct Place {
    centre: DVec3,
    length: f64,
    /// Radius of the patch, mm.
    reach: f64,
}

impl Place {
    fn of(surface: &Surface, triangle: u32, reach: f64) -> Self {
        let corners = surface.triangles[triangle as usize];
        let [a, b, c] = surface.corners(triangle);
        let h = corners.iter().map(|&v| surface.target[v as usize]).sum::<f64>() / 3.0;
        let round = surface.rings(triangle, RINGS_OF_LENGTH);
        let edges = edges_of(round.triangles.iter().map(|&t| &surface.triangles[t as usize]));
        let sum: f64 = edges.iter().map(|&(a, b)| surface.length(a, b)).sum();
        let length = h.min(sum / edges.len() as f64);
        Self { centre: (a + b + c) / 3.0, length, reach: reach * length }
    }

    /// Returns the lower bound of the target length (mm) at `p`. A length that grows from it with
    /// the gradation reaches [`RIM`] times the length of the mesh at the rim. A negative value is
    /// no bound; [`MOST_TRIANGLES`] then limits the number of triangles.
    fn least(&self, p: DVec3, gradation: f64) -> f64 {
        RIM * self.length - gradation * (self.reach - p.distance(self.centre))
    }
}

/// Returns the box that contains all changes of the remeshing of the patch around a triangle.
pub(super) fn region(surface: &Surface, triangle: u32, reach: f64) -> Bounds {
    let place = Place::of(surface, triangle, reach);
    // the triangles across the rim extend beyond the ball
    let half = place.reach + 2.0 * place.length;
    Bounds { low: place.centre - half, high: place.centre + half }
}

/// Remeshes the patch around a triangle with each gradation in turn. `reach` is its radius in units
/// of the length of the mesh there. Commits the first result that passes the acceptance test with
/// the loose limits and [`Goal::Lift`] at `bar`, and then removes superfluous vertices. Returns
/// whether a result passed.
pub(super) fn remesh(surface: &mut Surface, triangle: u32, reach: f64, bar: f64) -> bool {
    let place = Place::of(surface, triangle, reach);
    let Some(free) = free_vertices(surface, triangle, &place) else { return false };
    let mut demands = demands_of_curvature(surface, &free, &place);
    demands.extend(demands_of_nodes(surface, &place));
    GRADATIONS.into_iter().any(|gradation| {
        let h = surface.size;
        let target = |p: DVec3| {
            let asked =
                demands.iter().fold(place.length, |least, d| least.min(d.length + gradation * p.distance(d.at)));
            h(p).min(asked.max(place.least(p, gradation)))
        };
        let patch = remeshed(surface, &free, &target);
        surface.tried += patch.surface.tried;
        if is_too_large(&patch.surface) {
            return false;
        }
        patch.edits(surface).make(surface);
        let touched = commit_or_rollback(surface, &Limits::LOOSE, Goal::Lift { bar });
        touched.map(|touched| coarsen(surface, touched, place.length)).is_some()
    })
}

/// Returns the vertices of the patch that may move, ascending, or `None` if there are none. They
/// lie within the radius of the patch, are connected with the triangle, and have all neighbours in
/// the region.
fn free_vertices(surface: &Surface, triangle: u32, place: &Place) -> Option<Vec<u32>> {
    let is_free = |v: u32| {
        let p = surface.positions[v as usize];
        let is_inside = |u: u32| surface.region.is_none_or(|region| region.encloses(surface.positions[u as usize]));
        p.distance(place.centre) < place.reach
            && !surface.frozen[v as usize]
            && surface.link(v).all(|(u, _)| is_inside(u))
    };
    let mut open: Vec<u32> = surface.triangles[triangle as usize].into_iter().filter(|&v| is_free(v)).collect();
    let mut found = open.clone();
    while let Some(v) = open.pop() {
        for (u, _) in surface.link(v) {
            if !found.contains(&u) && is_free(u) {
                found.push(u);
                open.push(u);
            }
        }
    }
    found.sort_unstable();
    (!found.is_empty()).then_some(found)
}

/// Collapses edges of given triangles that are shorter than [`SHORT`] times `length` (mm), shortest
/// first, if the minimum quality stays at least [`TARGET`] or does not decrease. This removes
/// vertices that remeshing has added where no demand requires them.
pub(super) fn coarsen(surface: &mut Surface, mut triangles: Vec<u32>, length: f64) {
    // stricter limits keep the resolution that the curvature of F requires
    let limits = Limits { fold_of_f: Limits::STRICT.fold, deviation: COARSEN_DEVIATION, ..Limits::STRICT };
    let mut collapsed = true;
    while collapsed {
        collapsed = false;
        triangles.retain(|&t| surface.is_alive(t));
        let edges = edges_of(triangles.iter().map(|&t| &surface.triangles[t as usize]));
        let rated = edges.into_iter().map(|(a, b)| (surface.length(a, b), a, b));
        let mut short: Vec<(f64, u32, u32)> = rated.filter(|edge| edge.0 < SHORT * length).collect();
        short.sort_by(|a, b| a.0.total_cmp(&b.0));
        for (_, a, b) in short {
            for (keep, gone, share) in [(a, b, 0.5), (a, b, 0.0), (b, a, 0.0)] {
                let too_long = |s: &Surface| s.link(keep).any(|(v, _)| s.length(keep, v) > LONG * length);
                if make(surface, Move::Collapse(keep, gone, share), After::Relocations)
                    && !too_long(surface)
                    && commit_or_rollback(surface, &limits, Goal::Keep { floor: TARGET }).is_some()
                {
                    collapsed = true;
                    break;
                }
                surface.rollback();
            }
        }
    }
}

/// Returns whether a patch has more triangles than [`MOST_TRIANGLES`].
fn is_too_large(part: &Surface) -> bool {
    part.triangles.iter().filter(|t| **t != DEAD).count() > MOST_TRIANGLES
}

/// Returns a copy of the surface in which the vertices in `free` are remeshed to a target length.
/// Remeshing stops if the patch becomes too large.
fn remeshed<'a>(surface: &Surface<'a>, free: &[u32], target: &'a (dyn Fn(DVec3) -> f64 + Sync)) -> Patch<'a> {
    // the deviation has no limit, because its unit is a target length that the edges do not have
    // yet
    let limits = &Limits { deviation: f64::INFINITY, lengths: PATCH_LENGTHS, ..Limits::LOOSE };
    let mut patch = Patch::with_target(surface, target);
    patch.keep_free(|v| free.binary_search(&v).is_ok());
    let part = &mut patch.surface;
    for _ in 0..ROUNDS {
        remesh::round(part, limits, Curves::Keep, &mut Tally::default());
        if is_too_large(part) {
            return patch;
        }
    }
    for _ in 0..ROUNDS {
        let quality = |part: &Surface, t: u32| part.facts[t as usize].quality;
        let all = 0..part.triangles.len() as u32;
        let mut bad: Vec<u32> = all.filter(|&t| part.is_alive(t) && quality(part, t) < TARGET).collect();
        bad.sort_by(|&a, &b| quality(part, a).total_cmp(&quality(part, b)));
        bad.retain(|&t| part.is_alive(t) && quality(part, t) < TARGET && lift(part, t, limits, TARGET));
        if bad.is_empty() {
            break;
        }
    }
    patch
}

/// Returns the demands from the curvature of F at the corners, midpoints of sides and centroids of
/// the triangles at given vertices. Only lengths below the length of the mesh are demands.
fn demands_of_curvature(surface: &Surface, vertices: &[u32], place: &Place) -> Vec<Demand> {
    let mut triangles: Vec<u32> = vertices.iter().flat_map(|&v| surface.around[v as usize].iter().copied()).collect();
    triangles.sort_unstable();
    triangles.dedup();
    let samples = triangles.into_iter().flat_map(|t| {
        let pair = surface.pair[t as usize];
        let [a, b, c] = surface.corners(t);
        let normal = surface.normal_of(surface.triangles[t as usize]);
        let places = [a, b, c, a.midpoint(b), b.midpoint(c), c.midpoint(a), (a + b + c) / 3.0];
        let foot = move |p| Some((surface.field.projected_facing(pair, p, normal, place.length)?, pair));
        places.into_iter().filter_map(foot)
    });
    let demands = samples.map(|(p, pair)| Demand { at: p, length: 1.0 / curvature(surface, pair, p) });
    demands.filter(|demand| demand.length < place.length).collect()
}

/// Returns the demands of grid nodes on the wrong side within the radius of the patch.
fn demands_of_nodes(part: &Surface, place: &Place) -> Vec<Demand> {
    let places = part.sides.as_ref().map_or_else(Vec::new, NodeSides::wrong_places);
    let in_reach = places.into_iter().filter(|p| p.distance(place.centre) < place.reach);
    in_reach.map(|at| Demand { at, length: SHORTER * (part.size)(at).min(place.length) }).collect()
}

/// Returns the square root of the sum of the squared principal curvatures of an interface at a
/// point, per mm.
fn curvature(surface: &Surface, pair: Interface, p: DVec3) -> f64 {
    let tensor = curvature_tensor(&surface.field.jet(pair, p));
    tensor.to_cols_array().iter().map(|x| x * x).sum::<f64>().sqrt()
}
