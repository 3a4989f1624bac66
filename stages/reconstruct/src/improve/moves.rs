//! Elementary moves: flip, collapse and split of an edge, and relocation of a vertex among its
//! neighbours. All moves preserve the topology of the mesh (link condition). The acceptance test
//! then decides whether the result is kept.

use super::acceptance::change_of_smallest;
use super::constants::{
    FIRST_STEP, HOPELESS_AFTER_RELOCATIONS, LAST_STEP, LEAST_GAIN, PASSES, SHARES, SURELY_WIDE, TURN,
};
use super::curves::{collapse_along, part_of_slide, slide};
use super::ring::{LANES, Ring};
use super::site::Site;
use super::surface::{DEAD, Surface, edges_of};
use fearless_simd::{Level, dispatch};
use glam::{DVec2, DVec3};
use std::f64::consts::TAU;

/// Replaces the edge a, b by the other diagonal of its two triangles. Returns whether this is
/// possible.
pub(super) fn flip(surface: &mut Surface, a: u32, b: u32) -> bool {
    let Some([(left, c), (right, d)]) = surface.edge_triangles(a, b) else { return false };
    if [a, b, c, d].iter().any(|&v| surface.frozen[v as usize])
        || c == d
        || surface.has_few(a)
        || surface.has_few(b)
        || surface.joined(c, d)
    {
        return false;
    }
    surface.set_triangle(left, [a, d, c]);
    surface.set_triangle(right, [d, b, c]);
    true
}

/// Merges `gone` into `keep` along an edge inside an interface, and moves `keep` to `at`. Returns
/// whether this is possible.
pub(super) fn collapse(surface: &mut Surface, keep: u32, gone: u32, at: DVec3) -> bool {
    let Some([(left, c), (right, d)]) = surface.edge_triangles(keep, gone) else { return false };
    if [keep, gone].iter().any(|&v| surface.frozen[v as usize])
        || !surface.is_free(gone)
        || !surface.is_free(keep) && at != surface.positions[keep as usize]
        || c == d
        || surface.has_few(c)
        || surface.has_few(d)
        || surface.is_free(keep) && surface.degree(keep) + surface.degree(gone) < 7
        || surface.link(gone).any(|(v, _)| surface.frozen[v as usize])
    {
        return false;
    }
    // link condition: the ends share no neighbours except the two opposite corners
    if surface.link(gone).filter(|&(v, _)| v != keep && surface.joined(v, keep)).count() != 2 {
        return false;
    }
    for t in surface.around[gone as usize].clone() {
        let corners = if t == left || t == right {
            DEAD
        } else {
            surface.triangles[t as usize].map(|v| if v == gone { keep } else { v })
        };
        surface.set_triangle(t, corners);
    }
    if surface.positions[keep as usize] != at {
        surface.move_vertex(keep, at);
    }
    true
}

/// Splits the edge a, b at a new vertex on F = 0 near its midpoint. Returns the vertex, or `None`
/// if this is not possible.
pub(super) fn split(surface: &mut Surface, a: u32, b: u32) -> Option<u32> {
    let [(left, c), (right, d)] = surface.edge_triangles(a, b)?;
    if [a, b, c, d].iter().any(|&v| surface.frozen[v as usize]) || c == d {
        return None;
    }
    let (p, q) = (surface.positions[a as usize], surface.positions[b as usize]);
    let normals = surface.normal_of([a, b, c]) + surface.normal_of([b, a, d]);
    let pair = surface.pair[left as usize];
    let middle =
        surface.field.projected_facing(pair, 0.5 * (p + q), normals.normalize_or_zero(), 0.5 * p.distance(q))?;
    let m = surface.add_vertex(middle);
    surface.set_triangle(left, [a, m, c]);
    surface.add_triangle([m, b, c], pair);
    surface.set_triangle(right, [b, m, d]);
    surface.add_triangle([m, a, d], pair);
    Some(m)
}

/// Moves a vertex along the surface to maximise the minimum quality of its triangles. The search
/// tests eight directions at once. If none is better, it halves the step and rotates the
/// directions. Returns whether the vertex moved.
pub(super) fn relocate(surface: &mut Surface, vertex: u32) -> bool {
    let Some(site) = Site::of(surface, vertex) else { return false };
    let worth = |p: DVec3| site.worth_above(p, f64::NEG_INFINITY).unwrap_or(f64::NEG_INFINITY);
    let ring = Ring::of(&site);
    let instructions = Level::new();
    let before = worth(site.start);
    let (mut best, mut best_worth) = (DVec2::ZERO, before);
    let mut step = FIRST_STEP * site.reach;
    let mut directions: [DVec2; LANES] = std::array::from_fn(|d| DVec2::from_angle(TAU * d as f64 / LANES as f64));
    let turn = DVec2::from_angle(TURN);
    while step > LAST_STEP * site.reach {
        let candidates = directions.map(|direction| best + step * direction);
        let along = [candidates.map(|c| c.x), candidates.map(|c| c.y)];
        let ratios = dispatch!(instructions, simd => ring.smallest_ratios(simd, along));
        // a quality never exceeds its radius ratio, so the search tests the highest ratios first
        // and stops at the first ratio below the bar
        let mut lanes: [usize; LANES] = std::array::from_fn(|lane| lane);
        lanes.sort_by(|&a, &b| ratios[b].total_cmp(&ratios[a]));
        let mut next = None;
        for lane in lanes {
            let bar = best_worth + LEAST_GAIN;
            if ratios[lane] <= bar {
                break;
            }
            let is_ratio = ratios[lane] > SURELY_WIDE;
            let found = if is_ratio { Some(ratios[lane]) } else { site.worth_above(site.place(candidates[lane]), bar) };
            if let Some(found) = found {
                best_worth = found;
                next = Some(candidates[lane]);
            }
        }
        match next {
            Some(candidate) if candidate.length() < site.reach => best = candidate,
            Some(_) => break,
            None => {
                step *= 0.5;
                // the minimum of several functions has ridges, which may lie between two directions
                directions = directions.map(|direction| turn.rotate(direction));
            }
        }
    }
    if best == DVec2::ZERO {
        return false;
    }
    match surface.field.projected_facing(site.pair, site.place(best), site.normal, site.reach) {
        Some(p) if worth(p) > before + LEAST_GAIN => {
            surface.move_vertex(vertex, p);
            true
        }
        _ => false,
    }
}

/// Moves a vertex along the surface, or along its junction curve, to maximise the minimum quality
/// of its triangles. Returns whether the vertex moved.
fn relocate_or_slide(surface: &mut Surface, vertex: u32) -> bool {
    if surface.is_free(vertex) { relocate(surface, vertex) } else { slide(surface, vertex) }
}

/// Moves a vertex along the surface by `share` of the way to the weighted mean of the centroids of
/// its triangles. The weight is the area divided by the squared target length. Returns whether the
/// vertex moved.
pub(super) fn relax(surface: &mut Surface, vertex: u32, share: f64) -> bool {
    let v = vertex as usize;
    if surface.frozen[v] || !surface.is_free(vertex) || surface.around[v].is_empty() {
        return false;
    }
    let (start, pair) = (surface.positions[v], surface.pair_at(vertex));
    let (mut sum, mut weights, mut reach) = (DVec3::ZERO, 0.0, 0.0);
    for (a, b) in surface.link(vertex) {
        let (p, q) = (surface.positions[a as usize], surface.positions[b as usize]);
        let target = (surface.target[v] + surface.target[a as usize] + surface.target[b as usize]) / 3.0;
        let weight = (p - start).cross(q - start).length() / (target * target);
        sum += weight * (start + p + q) / 3.0;
        weights += weight;
        reach += p.distance(start);
    }
    reach /= surface.degree(vertex) as f64;
    let (_, gradient) = surface.field.value_gradient(pair, start);
    let normal = gradient.normalize_or_zero();
    let way = share * (sum / weights - start);
    let way = way - normal * way.dot(normal);
    if !way.is_finite() || way.length() < 1e-4 * reach {
        return false;
    }
    match surface.field.projected(pair, start + way, reach) {
        Some(p) => {
            surface.move_vertex(vertex, p);
            true
        }
        None => false,
    }
}

/// A move that may improve a bad triangle.
#[derive(Clone, Copy, Debug)]
pub(super) enum Move {
    /// A move of the vertex by this share of the way to its best position.
    Relocate(u32, f64),
    /// A flip of an edge.
    Flip(u32, u32),
    /// A collapse of the second vertex into the first, which moves by this share of the way to the
    /// second.
    Collapse(u32, u32, f64),
    /// A split of an edge.
    Split(u32, u32),
}

impl Move {
    /// Returns whether the move is a relocation that stops short of the best position.
    pub(super) fn is_partial(self) -> bool {
        matches!(self, Self::Relocate(_, share) if share < 1.0)
    }

    /// Makes the move. Returns the vertices that should be relocated afterwards, or `None` if the
    /// move is not possible.
    pub(super) fn make(self, surface: &mut Surface) -> Option<Vec<u32>> {
        let with_neighbours = |surface: &Surface, v: u32| surface.link(v).map(|(a, _)| a).chain([v]).collect();
        match self {
            Self::Relocate(v, share) => {
                let from = surface.positions[v as usize];
                if !relocate_or_slide(surface, v) {
                    return None;
                }
                if share < 1.0 {
                    let best = surface.positions[v as usize];
                    let on_interface =
                        |way: DVec3| surface.field.projected(surface.pair_at(v), from + share * way, way.length());
                    let to = match surface.is_free(v) {
                        true => on_interface(best - from),
                        false => part_of_slide(surface, v, [from, best], share),
                    }?;
                    surface.move_vertex(v, to);
                }
                Some(with_neighbours(surface, v))
            }
            Self::Flip(a, b) => {
                let [(_, c), (_, d)] = surface.edge_triangles(a, b)?;
                flip(surface, a, b).then(|| vec![a, b, c, d])
            }
            Self::Collapse(keep, gone, share) => {
                let (p, q) = (surface.positions[keep as usize], surface.positions[gone as usize]);
                let Some([(t, _), _]) = surface.edge_triangles(keep, gone) else {
                    let made = share == 0.0 && collapse_along(surface, keep, gone);
                    return made.then(|| with_neighbours(surface, keep));
                };
                let pair = surface.pair[t as usize];
                let at =
                    if share == 0.0 { p } else { surface.field.projected(pair, p.lerp(q, share), p.distance(q))? };
                collapse(surface, keep, gone, at).then(|| with_neighbours(surface, keep))
            }
            Self::Split(a, b) => split(surface, a, b).map(|middle| with_neighbours(surface, middle)),
        }
    }
}

/// Returns all moves on the vertices and edges of some triangles.
pub(super) fn moves_near(triangles: impl IntoIterator<Item = [u32; 3]>) -> Vec<Move> {
    let triangles: Vec<[u32; 3]> = triangles.into_iter().collect();
    let mut vertices: Vec<u32> = Vec::new();
    for &v in triangles.iter().flatten() {
        if !vertices.contains(&v) {
            vertices.push(v);
        }
    }
    let mut moves: Vec<Move> = Vec::new();
    for v in vertices {
        moves.extend(SHARES.map(|share| Move::Relocate(v, share)));
    }
    for (a, b) in edges_of(&triangles) {
        moves.extend([
            Move::Flip(a, b),
            Move::Collapse(a, b, 0.5),
            Move::Collapse(a, b, 0.0),
            Move::Collapse(b, a, 0.0),
            Move::Split(a, b),
        ]);
    }
    moves
}

/// Relocates vertices in turn, in up to [`PASSES`] passes. Stops if no vertex moved, or if the
/// minimum quality has changed by less than [`HOPELESS_AFTER_RELOCATIONS`].
pub(super) fn relocate_all(surface: &mut Surface, mut vertices: Vec<u32>) {
    vertices.sort_unstable();
    for _ in 0..PASSES {
        let mut moved = false;
        for &v in &vertices {
            moved |= relocate_or_slide(surface, v);
        }
        if !moved || change_of_smallest(surface) < HOPELESS_AFTER_RELOCATIONS {
            break;
        }
    }
}
