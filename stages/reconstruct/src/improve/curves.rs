//! Moves of vertices on junction curves, where three sheets meet: along the curve to where the smallest quality round them is largest, and into a neighbour on the curve.
//! All triangles of the three sheets round them are judged together, by the same guard as every move.

use super::constants::{CURVE_STRAYS, FARTHEST_ALONG, FIRST_STEP, LAST_STEP, LEAST_GAIN, PROJECTION_TOLERANCE};
use super::guard::quality_facing;
use super::sheets::Freedom;
use super::surface::{DEAD, Surface};
use glam::DVec3;

/// The junction curve at a vertex on it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Curve {
    /// The neighbours on the curve.
    pub(super) ends: [u32; 2],
    /// The sheets that meet there, ascending.
    pub(super) sheets: [u32; 3],
}

impl Surface<'_> {
    /// The curve through a vertex, where the triangles round it are those of three sheets, of each a fan from one neighbour on the curve to the other.
    pub(super) fn curve_through(&self, vertex: u32) -> Option<Curve> {
        let fan: Vec<(u32, u32, u32)> = self.around[vertex as usize]
            .iter()
            .zip(self.link(vertex))
            .map(|(&t, (a, b))| (self.sheet[t as usize], a, b))
            .collect();
        let mut neighbours: Vec<u32> = fan.iter().flat_map(|&(_, a, b)| [a, b]).collect();
        neighbours.sort_unstable();
        let times: Vec<(u32, usize)> = neighbours.chunk_by(|a, b| a == b).map(|same| (same[0], same.len())).collect();
        let mut on_curve = times.iter().filter(|(_, n)| *n == 3).map(|(v, _)| *v);
        let ends = [on_curve.next()?, on_curve.next()?];
        let mut sheets: Vec<u32> = fan.iter().map(|&(sheet, ..)| sheet).collect();
        sheets.sort_unstable();
        sheets.dedup();
        let sheets = <[u32; 3]>::try_from(sheets).ok()?;
        let is_fan = |&sheet: &u32| {
            let mut left: Vec<(u32, u32)> = fan.iter().filter(|own| own.0 == sheet).map(|own| (own.1, own.2)).collect();
            let mut at = ends[0];
            while at != ends[1] {
                let Some(next) = left.iter().position(|&(a, b)| a == at || b == at) else { return false };
                let (a, b) = left.swap_remove(next);
                at = if a == at { b } else { a };
            }
            left.is_empty()
        };
        (on_curve.next().is_none() && sheets.iter().all(is_fan)).then_some(Curve { ends, sheets })
    }

    /// The same of a vertex that may move along it.
    fn way_of(&self, vertex: u32) -> Option<Curve> {
        let v = vertex as usize;
        (self.freedom[v] == Freedom::Curve && !self.frozen[v]).then(|| self.curve_through(vertex)).flatten()
    }

    /// The place of a curve near another, no farther than `limit` mm.
    fn onto_curve(&self, curve: &Curve, p: DVec3, limit: f64) -> Option<DVec3> {
        let [first, second, _] = curve.sheets;
        self.field.project_onto_curve([first, second], p, limit, PROJECTION_TOLERANCE * self.field.voxel())
    }

    /// How far the middle between two places of a curve lies from it, mm; infinite where it is not found.
    fn bow(&self, curve: &Curve, [p, q]: [DVec3; 2]) -> f64 {
        let middle = p.midpoint(q);
        self.onto_curve(curve, middle, 0.5 * p.distance(q)).map_or(f64::INFINITY, |foot| foot.distance(middle))
    }

    /// Whether the edges of a curve that meet at a place may be bent as much as `bow` (mm) says, or were before.
    fn may_bow(&self, vertex: u32, bow: f64, before: f64) -> bool {
        bow <= before.max(CURVE_STRAYS * self.target[vertex as usize])
    }
}

/// Moves a vertex along its curve to where the smallest quality of its triangles is largest.
pub(super) fn slide(surface: &mut Surface, vertex: u32) -> bool {
    let Some(curve) = surface.way_of(vertex) else { return false };
    let start = surface.positions[vertex as usize];
    let ends = curve.ends.map(|end| surface.positions[end as usize]);
    let normal = |sheet: u32| surface.field.value_gradient(sheet, start).1;
    let normals = curve.sheets.map(|sheet| (sheet, normal(sheet)));
    let ring: Vec<(DVec3, DVec3, DVec3)> = surface.around[vertex as usize]
        .iter()
        .zip(surface.link(vertex))
        .map(|(&t, (a, b))| {
            let sheet = surface.sheet[t as usize];
            let normal = normals.iter().find(|own| own.0 == sheet).map_or(DVec3::ZERO, |own| own.1);
            let (p, q) = surface.side(a, b);
            (p, q, normal)
        })
        .collect();
    let worth = |p: DVec3| {
        let quality = |&(a, b, normal): &(DVec3, DVec3, DVec3)| quality_facing([p, a, b], normal);
        ring.iter().map(quality).fold(f64::INFINITY, f64::min)
    };
    // so much of the way to the one neighbour, or to the other where it is negative
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

/// The place of the vertex's curve a share of the way from one place to another.
pub(super) fn part_of_slide(surface: &Surface, vertex: u32, [from, to]: [DVec3; 2], share: f64) -> Option<DVec3> {
    let curve = surface.way_of(vertex)?;
    surface.onto_curve(&curve, from.lerp(to, share), from.distance(to))
}

/// Merges `gone` into its neighbour `keep` on its curve, which stays where it is. A curve between two junction points keeps its last vertex where these are so near that no
/// triangle on the edge between them could be good ([`Surface::side`]).
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
    // link condition (Dey, Edelsbrunner, Guha and Nekhayev 1999), of the complex and of the curve: the ends share no neighbours but the corners opposite the edge, no two
    // of which have an edge with each of them in a triangle, and no neighbour on the curve
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
