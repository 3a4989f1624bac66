//! Remeshes the patch round a triangle so that its edges follow the curvature of F, where h is too long for it.
//!
//! On a piece of surface whose edges are short beside its radii of curvature, triangles near to equilateral stray and fold little; that is
//! what sampling by the local feature size ensures (Amenta and Bern 1999). So edges are aimed at a share of the radius of curvature, growing
//! with the distance until they meet h at the rim of the patch, by the moves of [`remesh::round`] in an [`Excerpt`]. What curvature at the
//! samples did not tell, the outcome does: where it strays or is turned against F, edges half as long are asked for, and the patch is
//! remeshed again from the start. The guard of the whole surface decides.

use super::excerpt::{Edits, Excerpt};
use super::guard::{Limits, Rule, commit_if_welcome};
use super::last_resort::patch_round;
use super::moves::projected_facing;
use super::surface::Surface;
use super::worst::{self, Aim, Effort, Failures};
use super::{Step, Tally, remesh};
use glam::DVec3;
use isoparticles_mesh::spatial::Bounds;
use isoparticles_stage::error::Result;
use rayon::prelude::*;

/// Growths of the edges with the distance, mm per mm, in the order tried.
const SLOPES: [f64; 3] = [0.45, 0.3, 0.6];

/// Radius of the patch, over h: enough for edges to grow from the shortest to h.
const REACH: f64 = 2.5;

/// Edges are aimed at this share of the radius of curvature, ...
const CHORD: f64 = 1.0;

/// ... but at no less than this share of h, ...
const FINEST: f64 = 0.08;

/// ... and at the rim at no less than this one.
const RIM: f64 = 0.8;

/// Times that a patch is remeshed in one way, each with what the outcome before it asks for.
const ATTEMPTS: usize = 4;

/// A triangle asks for shorter edges when its centroid is farther from F = 0 than this share of its mean side, ...
const STRAYS: f64 = 0.2;

/// ... or the cosine between its normal and grad F is below this; ...
const TURNED: f64 = 0.6;

/// ... and then for this share of its mean side.
const SHORTER: f64 = 0.5;

/// Rounds of splits, collapses, flips and relaxation.
const ROUNDS: usize = 5;

/// Range of edge lengths over their aims, where they are within.
const LENGTHS: [f64; 2] = [0.5, 1.6];

/// Radius ratio that the triangles of the patch are lifted to afterwards.
const TARGET: f64 = 0.6;

/// Most triangles that remeshing may add to a patch.
const MOST_TRIANGLES: usize = 4000;

/// A place that asks for short edges.
#[derive(Clone, Copy, Debug)]
struct Demand {
    /// Where, grid frame, mm.
    at: DVec3,
    /// How short, mm.
    size: f64,
}

/// The part of the surface to remesh.
struct Patch {
    centre: DVec3,
    /// Mean target edge length at the triangle, mm.
    h: f64,
    /// Vertices that may move, ascending.
    vertices: Vec<u32>,
    /// Growth of the edges, mm per mm.
    slope: f64,
}

impl Patch {
    fn new(surface: &Surface, triangle: u32, slope: f64) -> Option<Self> {
        let corners = surface.triangles[triangle as usize];
        let [a, b, c] = surface.corners(triangle);
        let centre = (a + b + c) / 3.0;
        let h = corners.iter().map(|&v| surface.target[v as usize]).sum::<f64>() / 3.0;
        let vertices = patch_round(surface, corners[0], |p, _| p.distance(centre) < REACH * h)?;
        Some(Self { centre, h, vertices, slope })
    }

    /// A demand, as far as it lets edges grow to the length at the rim.
    fn demand(&self, at: DVec3, size: f64) -> Demand {
        let at_rim = RIM * self.h - self.slope * (REACH * self.h - at.distance(self.centre));
        Demand { at, size: size.max(FINEST * self.h).max(at_rim) }
    }

    /// Demands by the curvature of F at corners, sides and centroids of the triangles.
    fn demands_of_curvature(&self, surface: &Surface) -> Vec<Demand> {
        let mut triangles: Vec<u32> = self.vertices.iter().flat_map(|&v| surface.around[v as usize].clone()).collect();
        triangles.sort_unstable();
        triangles.dedup();
        let samples = triangles.into_iter().flat_map(|t| {
            let [a, b, c] = surface.corners(t);
            let normal = surface.normal_of(surface.triangles[t as usize]);
            let places = [a, b, c, a.midpoint(b), b.midpoint(c), c.midpoint(a), (a + b + c) / 3.0];
            places.into_iter().filter_map(move |p| projected_facing(surface, p, normal, self.h))
        });
        let demands = samples.map(|p| self.demand(p, CHORD / curvature(surface, p)));
        demands.filter(|demand| demand.size < self.h).collect()
    }

    /// Demands of the triangles that still stray or are turned.
    fn demands_of_outcome(&self, part: &Surface) -> Vec<Demand> {
        let mut demands = Vec::new();
        for t in (0..part.triangles.len() as u32).filter(|&t| part.is_alive(t)) {
            let corners = part.triangles[t as usize];
            if corners.iter().any(|&v| part.frozen[v as usize]) {
                continue;
            }
            let [a, b, c] = part.corners(t);
            let side = (a.distance(b) + b.distance(c) + c.distance(a)) / 3.0;
            let target = corners.iter().map(|&v| part.target[v as usize]).sum::<f64>() / 3.0;
            let facts = &part.facts[t as usize];
            if facts.agreement < TURNED || facts.deviation * target > STRAYS * side {
                demands.push(self.demand((a + b + c) / 3.0, SHORTER * side.min(target)));
            }
        }
        demands
    }

    /// The patch remeshed to meet the demands, and what the outcome asks for; `None` where it gets too large.
    fn remeshed(&self, surface: &Surface, limits: &Limits, demands: &[Demand]) -> Option<(Edits, Vec<Demand>)> {
        let h = surface.size;
        let size = |p: DVec3| demands.iter().fold(h(p), |size, d| size.min(d.size + self.slope * p.distance(d.at)));
        let reach = REACH * self.h;
        let region = Bounds { low: self.centre - reach, high: self.centre + reach };
        let mut part = Excerpt::new(surface, &region, &size, LENGTHS);
        part.keep_free(|v| self.vertices.binary_search(&v).is_ok());
        let most = part.surface.triangles.len() + MOST_TRIANGLES;
        let tally = &mut Tally::default();
        for _ in 0..ROUNDS {
            remesh::round(&mut part.surface, limits, tally);
            if part.surface.triangles.len() > most {
                return None;
            }
        }
        for effort in [Effort::Settled, Effort::Double] {
            let never = &|| Ok(());
            let aim = Aim { limits, bar: TARGET, effort };
            worst::lift(&mut part.surface, None, aim, &mut Failures::default(), never, tally).ok()?;
        }
        let more = self.demands_of_outcome(&part.surface);
        Some((part.edits(surface), more))
    }
}

/// A way to remesh the patch, and what was asked for so far.
struct Variant<'a> {
    patch: Patch,
    /// Limits of the moves on the way.
    limits: &'a Limits,
    demands: Vec<Demand>,
}

/// Remeshes the patch round a triangle and commits the first outcome that the guard lets pass: the triangles touched, `None` where none did.
/// `step` is called now and then.
///
/// # Errors
/// Those of `step`.
pub(super) fn lift(surface: &mut Surface, limits: &Limits, triangle: u32, step: Step) -> Result<Option<Vec<u32>>> {
    // on the way only the lengths aimed at are short, so that deviation over them may pass any bound
    let free = Limits { deviation: f64::INFINITY, ..*limits };
    let mut variants = Vec::new();
    for slope in SLOPES {
        for limits in [limits, &free] {
            let Some(patch) = Patch::new(surface, triangle, slope) else { return Ok(None) };
            let demands = patch.demands_of_curvature(surface);
            variants.push(Variant { patch, limits, demands });
        }
    }
    for _ in 0..ATTEMPTS {
        step()?;
        let remeshed = |v: &Variant| v.patch.remeshed(surface, v.limits, &v.demands);
        let outcomes: Vec<Option<(Edits, Vec<Demand>)>> = variants.par_iter().map(remeshed).collect();
        let mut going_on = Vec::new();
        for (mut variant, outcome) in variants.into_iter().zip(outcomes) {
            let Some((edits, more)) = outcome else { continue };
            edits.make(surface);
            if let Some(touched) = commit_if_welcome(surface, limits, Rule::Fit) {
                return Ok(Some(touched));
            }
            if !more.is_empty() {
                variant.demands.extend(more);
                going_on.push(variant);
            }
        }
        variants = going_on;
    }
    Ok(None)
}

/// Root of the sum of the squares of the principal curvatures of F at a point, per mm.
fn curvature(surface: &Surface, p: DVec3) -> f64 {
    let jet = surface.field.jet(p);
    let slope = jet.gradient.length().max(1e-12);
    let (x, y) = (jet.gradient / slope).any_orthonormal_pair();
    let (xx, xy, yy) = (x.dot(jet.hessian * x), x.dot(jet.hessian * y), y.dot(jet.hessian * y));
    (xx * xx + 2.0 * xy * xy + yy * yy).sqrt() / slope
}
