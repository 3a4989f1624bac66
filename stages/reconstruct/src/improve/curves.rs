//! Moves of vertices on junction curves, where two or three interfaces meet. A vertex slides along
//! its curve to maximise the minimum quality, or is merged into a neighbour on the curve. The
//! acceptance test covers the triangles of all these interfaces together.

use super::constants::{CURVE_DEVIATION, FARTHEST_ALONG, FIRST_STEP, LAST_STEP, LEAST_GAIN, PROJECTION_TOLERANCE};
use super::functions::Freedom;
use super::surface::measure::quality_facing;
use super::surface::{Curve, DEAD, Surface};
use crate::interfaces::Interface;
use glam::DVec3;

impl Surface<'_> {
    /// Returns the junction curve of a vertex that may move along it, or `None` for any other
    /// vertex.
    fn way_of(&self, vertex: u32) -> Option<Curve> {
        let v = vertex as usize;
        (self.freedom[v] == Freedom::Curve && !self.frozen[v]).then(|| self.curve_through(vertex)).flatten()
    }

    /// Returns the projection of `p` onto a curve, or `None` if it fails or is farther than `limit`
    /// (mm).
    fn onto_curve(&self, curve: &Curve, p: DVec3, limit: f64) -> Option<DVec3> {
        let tolerance = PROJECTION_TOLERANCE * self.field.voxel();
        self.field.project_onto_curve([curve.pairs[0], curve.pairs[1]], p, limit, tolerance)
    }

    /// Returns the distance (mm) between a curve and the midpoint of two of its points, or infinity
    /// if the projection fails.
    fn bow(&self, curve: &Curve, [p, q]: [DVec3; 2]) -> f64 {
        let middle = p.midpoint(q);
        self.onto_curve(curve, middle, 0.5 * p.distance(q)).map_or(f64::INFINITY, |foot| foot.distance(middle))
    }

    /// Returns whether the bow (mm, [`Self::bow`]) of the edges at a vertex of a curve is at most
    /// [`CURVE_DEVIATION`] h, or at most the bow before.
    fn may_bow(&self, vertex: u32, bow: f64, before: f64) -> bool {
        bow <= before.max(CURVE_DEVIATION * self.target[vertex as usize])
    }
}

/// Moves a vertex along its curve to maximise the minimum quality of its triangles. Returns whether
/// the vertex moved.
pub(super) fn slide(surface: &mut Surface, vertex: u32) -> bool {
    let Some(curve) = surface.way_of(vertex) else { return false };
    let start = surface.positions[vertex as usize];
    let ends = curve.ends.map(|end| surface.positions[end as usize]);
    let normal = |pair: Interface| surface.field.value_gradient(pair, start).1;
    let normals: Vec<(Interface, DVec3)> = curve.pairs.iter().map(|&pair| (pair, normal(pair))).collect();
    let ring: Vec<(DVec3, DVec3, DVec3)> = surface.around[vertex as usize]
        .iter()
        .zip(surface.link(vertex))
        .map(|(&t, (a, b))| {
            let pair = surface.pair[t as usize];
            let normal = normals.iter().find(|own| own.0 == pair).map_or(DVec3::ZERO, |own| own.1);
            let (p, q) = surface.side(a, b);
            (p, q, normal)
        })
        .collect();
    let worth = |p: DVec3| {
        let quality = |&(a, b, normal): &(DVec3, DVec3, DVec3)| quality_facing([p, a, b], normal);
        ring.iter().map(quality).fold(f64::INFINITY, f64::min)
    };
    // position after a share of the way to the second neighbour on the curve, or to the first if
    // the share is negative
    let place = |along: f64| {
        let end = ends[usize::from(along > 0.0)];
        let limit = along.abs() * start.distance(end);
        surface.onto_curve(&curve, start.lerp(end, along.abs()), limit)
    };
    let before = worth(start);
    let (mut best, mut step) = ((0.0, start, before), FIRST_STEP);
    while step > LAST_STEP {
        let tried = [best.0 - step, best.0 + step].into_iter().filter(|along: &f64| along.abs() < FARTHEST_ALONG);
        let rated = tried.filter_map(|along| place(along).map(|p| (along, p, worth(p))));
        match rated.filter(|next| next.2 > best.2 + LEAST_GAIN).max_by(|a, b| a.2.total_cmp(&b.2)) {
            Some(next) => best = next,
            None => step *= 0.5,
        }
    }
    let (_, p, after) = best;
    let bow = |p: DVec3| ends.map(|end| surface.bow(&curve, [p, end])).into_iter().fold(0.0, f64::max);
    if after <= before || !surface.may_bow(vertex, bow(p), bow(start)) {
        return false;
    }
    surface.move_vertex(vertex, p);
    true
}

/// Returns the point of the curve of a vertex at a share of the way from one position to another.
pub(super) fn part_of_slide(surface: &Surface, vertex: u32, [from, to]: [DVec3; 2], share: f64) -> Option<DVec3> {
    let curve = surface.way_of(vertex)?;
    surface.onto_curve(&curve, from.lerp(to, share), from.distance(to))
}

/// Splits the edge a, b of a junction curve at a new vertex, which lies on the curve near the
/// midpoint of the edge. Returns the vertex. Returns `None` if a triangle at the edge has a frozen
/// corner, if the edge does not join two or three different interfaces, or if no such point of the
/// curve is found.
pub(super) fn split_along(surface: &mut Surface, a: u32, b: u32) -> Option<u32> {
    let at_edge = |t: &&u32| surface.triangles[**t as usize].contains(&b);
    let triangles: Vec<u32> = surface.around[a as usize].iter().filter(at_edge).copied().collect();
    let mut pairs: Vec<Interface> = triangles.iter().map(|&t| surface.pair[t as usize]).collect();
    pairs.sort_unstable();
    let is_curve = (2..=3).contains(&pairs.len()) && pairs.is_sorted_by(|first, second| first < second);
    let mut corners = triangles.iter().flat_map(|&t| surface.triangles[t as usize]);
    if !is_curve || corners.any(|v| surface.frozen[v as usize]) {
        return None;
    }
    let [p, q] = [a, b].map(|v| surface.positions[v as usize]);
    let curve = Curve { ends: [a, b], pairs };
    let middle = surface.onto_curve(&curve, p.midpoint(q), 0.5 * p.distance(q))?;
    let new = surface.add_vertex(middle);
    surface.freedom[new as usize] = Freedom::Curve;
    for t in triangles {
        let (corners, pair) = (surface.triangles[t as usize], surface.pair[t as usize]);
        let with = |gone: u32| corners.map(|v| if v == gone { new } else { v });
        surface.set_triangle(t, with(b));
        surface.add_triangle(with(a), pair);
    }
    Some(new)
}

/// Merges `gone` into its neighbour `keep` on the same curve. `keep` does not move. The last vertex
/// between two junction points stays if the edge between them would be short
/// ([`Surface::is_short_side`]). Returns whether the collapse is possible.
pub(super) fn collapse_along(surface: &mut Surface, keep: u32, gone: u32) -> bool {
    let Some(curve) = surface.way_of(gone) else { return false };
    let Some(&other) = curve.ends.iter().find(|&&end| end != keep).filter(|_| curve.ends.contains(&keep)) else {
        return false;
    };
    let at_edge = |t: &&u32| surface.triangles[**t as usize].contains(&keep);
    let corners: Vec<u32> = surface.around[gone as usize]
        .iter()
        .filter(at_edge)
        .filter_map(|&t| surface.triangles[t as usize].into_iter().find(|&v| v != keep && v != gone))
        .collect();
    let mut neighbours: Vec<u32> = surface.link(gone).flat_map(|(a, b)| [a, b]).filter(|&v| v != keep).collect();
    neighbours.sort_unstable();
    neighbours.dedup();
    // link condition (Dey, Edelsbrunner, Guha and Nekhayev 1999) for the complex and the curve: the
    // two ends share no neighbours except the corners opposite the edge, no two of these corners
    // form a triangle with `gone`, and no other neighbour on the curve is shared
    let shared = neighbours.iter().filter(|&&v| surface.joined(v, keep)).count();
    let is_shared_side = |&(a, b): &(u32, u32)| corners.contains(&a) && corners.contains(&b);
    let is_held = |&v: &u32| surface.frozen[v as usize];
    if is_held(&keep)
        || neighbours.iter().any(is_held)
        || corners.contains(&other)
        || surface.is_short_side(keep, other)
        || shared != corners.len()
        || corners.iter().any(|&v| surface.has_few(v))
        || surface.link(gone).any(|side| is_shared_side(&side))
    {
        return false;
    }
    let [p, q, r] = [keep, gone, other].map(|v| surface.positions[v as usize]);
    let before = surface.bow(&curve, [p, q]).max(surface.bow(&curve, [q, r]));
    if !surface.may_bow(gone, surface.bow(&curve, [p, r]), before) {
        return false;
    }
    for t in surface.around[gone as usize].clone() {
        let corners = surface.triangles[t as usize];
        let is_at_edge = corners.contains(&keep);
        surface.set_triangle(t, if is_at_edge { DEAD } else { corners.map(|v| if v == gone { keep } else { v }) });
    }
    true
}
