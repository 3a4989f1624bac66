//! The elementary moves: flip, collapse and split of an edge, and the best place of a vertex among its neighbours. They keep
//! the mesh a manifold of the same topology (link condition); whether the outcome is kept is for the guard to say.

use super::constants::{
    FIRST_STEP, HALVINGS, HOPELESS_AFTER_RELOCATIONS, LAST_STEP, LEAST_GAIN, LINE_STEPS, PROJECTION_TOLERANCE,
    RELOCATIONS, SHARES, SURELY_WIDE, TURN,
};
use super::curves::{collapse_along, part_of_slide, slide};
use super::guard::{change_of_smallest, quality_facing};
use super::ring::{LANES, Ring};
use super::surface::{DEAD, Surface, edges_of};
use fearless_simd::{Level, dispatch};
use glam::{DVec2, DVec3};
use isoparticles_field::spline::LEAST_GRADIENT;
use std::f64::consts::TAU;

/// The point of a sheet (F = 0, where there is one object) near a position, no farther than `limit` mm.
pub(super) fn projected(surface: &Surface, sheet: u32, p: DVec3, limit: f64) -> Option<DVec3> {
    surface.field.project(sheet, p, limit, PROJECTION_TOLERANCE * surface.field.voxel()).map(|(q, _)| q)
}

/// The same where the gradient of F points to the side of `normal` (unit length): not on the other flank of a thin wall or gap. Newton's
/// steps along the gradient may end there; then the nearest such point on the line along `normal` is taken.
pub(super) fn projected_facing(surface: &Surface, sheet: u32, p: DVec3, normal: DVec3, limit: f64) -> Option<DVec3> {
    let field = surface.field;
    let tolerance = PROJECTION_TOLERANCE * field.voxel();
    let facing = |start: DVec3, limit: f64| {
        field.project(sheet, start, limit, tolerance).filter(|(_, g)| g.dot(normal) > 0.0).map(|(q, _)| q)
    };
    facing(p, limit).or_else(|| {
        let (mut below, mut above) = crossing_along(|x| field.value(sheet, p + x * normal), limit)?;
        for _ in 0..HALVINGS {
            let middle = 0.5 * (below + above);
            if field.value(sheet, p + middle * normal) < 0.0 { below = middle } else { above = middle }
        }
        facing(p + 0.5 * (below + above) * normal, limit)
    })
}

/// The interval nearest to 0 over which a function rises through 0, of those between -`limit` and `limit`.
fn crossing_along(f: impl Fn(f64) -> f64, limit: f64) -> Option<(f64, f64)> {
    let step = limit / LINE_STEPS as f64;
    let centre = f(0.0);
    let (mut up, mut down) = (centre, centre);
    for k in 0..LINE_STEPS {
        let (near, far) = (k as f64 * step, (k + 1) as f64 * step);
        let next = f(far);
        if up < 0.0 && next >= 0.0 {
            return Some((near, far));
        }
        up = next;
        let next = f(-far);
        if next < 0.0 && down >= 0.0 {
            return Some((-far, -near));
        }
        down = next;
    }
    None
}

/// Replaces the edge a, b by the other diagonal of its two triangles.
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

/// Merges `gone` into `keep`, which moves to `at`, along an edge inside a sheet.
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
    // link condition: the ends share no neighbour but the two opposite corners
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

/// Cuts the edge a, b at a new vertex on F = 0 next to its middle.
pub(super) fn split(surface: &mut Surface, a: u32, b: u32) -> Option<u32> {
    let [(left, c), (right, d)] = surface.edge_triangles(a, b)?;
    if [a, b, c, d].iter().any(|&v| surface.frozen[v as usize]) || c == d {
        return None;
    }
    let (p, q) = (surface.positions[a as usize], surface.positions[b as usize]);
    let normals = surface.normal_of([a, b, c]) + surface.normal_of([b, a, d]);
    let sheet = surface.sheet[left as usize];
    let middle = projected_facing(surface, sheet, 0.5 * (p + q), normals.normalize_or_zero(), 0.5 * p.distance(q))?;
    let m = surface.add_vertex(middle);
    surface.set_triangle(left, [a, m, c]);
    surface.add_triangle([m, b, c], sheet);
    surface.set_triangle(right, [b, m, d]);
    surface.add_triangle([m, a, d], sheet);
    Some(m)
}

/// A vertex that may move, and what is round it.
pub(super) struct Site {
    pub(super) start: DVec3,
    pub(super) sheet: u32,
    pub(super) normal: DVec3,
    /// Of the tangent plane.
    pub(super) axes: [DVec3; 2],
    /// Of the paraboloid over the tangent plane that the surface is to second order: xx, xy, yy, per mm.
    pub(super) bend: [f64; 3],
    /// The other corners of the triangles.
    pub(super) ring: Vec<(DVec3, DVec3)>,
    /// Mean distance of the neighbours.
    pub(super) reach: f64,
}

impl Site {
    /// `None` where the vertex must stay, or F is flat.
    pub(super) fn of(surface: &Surface, vertex: u32) -> Option<Self> {
        let v = vertex as usize;
        if surface.frozen[v] || !surface.is_free(vertex) || surface.around[v].is_empty() {
            return None;
        }
        let (start, sheet) = (surface.positions[v], surface.sheet_at(vertex));
        let jet = surface.field.jet(sheet, start);
        let slope = jet.gradient.length();
        if slope < LEAST_GRADIENT {
            return None;
        }
        let normal = jet.gradient / slope;
        let axes = <[DVec3; 2]>::from(normal.any_orthonormal_pair());
        let ring: Vec<(DVec3, DVec3)> = surface.link(vertex).map(|(a, b)| surface.side(a, b)).collect();
        let reach = ring.iter().map(|(a, _)| a.distance(start)).sum::<f64>() / ring.len() as f64;
        let [h1, h2] = axes.map(|axis| jet.hessian * axis / slope);
        let bend = [axes[0].dot(h1), axes[0].dot(h2), axes[1].dot(h2)];
        Some(Self { start, sheet, normal, axes, bend, ring, reach })
    }

    /// The point of that paraboloid over a place of the tangent plane (mm along its axes).
    pub(super) fn place(&self, at: DVec2) -> DVec3 {
        let [xx, xy, yy] = self.bend;
        let height = 0.5 * (xx * at.x * at.x + yy * at.y * at.y) + xy * at.x * at.y;
        self.start + self.axes[0] * at.x + self.axes[1] * at.y - self.normal * height
    }

    /// Smallest quality of the triangles with the vertex at `p`, if it is above a bar; negative where one is turned against the normal.
    fn worth_above(&self, p: DVec3, bar: f64) -> Option<f64> {
        let mut smallest = f64::INFINITY;
        for &(a, b) in &self.ring {
            smallest = smallest.min(quality_facing([p, a, b], self.normal));
            if smallest <= bar {
                return None;
            }
        }
        Some(smallest)
    }
}

/// Moves a vertex along the surface to where the smallest quality of its triangles is largest: looks in eight directions at once, and halves the step where
/// none is better.
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
        // no quality is above its ratio: by that, the most promising come first
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
                // other directions, lest a ridge of the smallest of several functions hide between two of them
                directions = directions.map(|direction| turn.rotate(direction));
            }
        }
    }
    if best == DVec2::ZERO {
        return false;
    }
    match projected_facing(surface, site.sheet, site.place(best), site.normal, site.reach) {
        Some(p) if worth(p) > before + LEAST_GAIN => {
            surface.move_vertex(vertex, p);
            true
        }
        _ => false,
    }
}

/// Moves a vertex to where the smallest quality of its triangles is largest, along the surface, or along its curve.
fn relocate_or_slide(surface: &mut Surface, vertex: u32) -> bool {
    if surface.is_free(vertex) { relocate(surface, vertex) } else { slide(surface, vertex) }
}

/// Moves a vertex along the surface towards the centre of its triangles, weighted by area over target area.
/// `share` of the way is gone.
pub(super) fn relax(surface: &mut Surface, vertex: u32, share: f64) -> bool {
    let v = vertex as usize;
    if surface.frozen[v] || !surface.is_free(vertex) || surface.around[v].is_empty() {
        return false;
    }
    let (start, sheet) = (surface.positions[v], surface.sheet_at(vertex));
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
    let (_, gradient) = surface.field.value_gradient(sheet, start);
    let normal = gradient.normalize_or_zero();
    let way = share * (sum / weights - start);
    let way = way - normal * way.dot(normal);
    if !way.is_finite() || way.length() < 1e-4 * reach {
        return false;
    }
    match projected(surface, sheet, start + way, reach) {
        Some(p) => {
            surface.move_vertex(vertex, p);
            true
        }
        None => false,
    }
}

/// A move on behalf of a bad triangle.
#[derive(Clone, Copy, Debug)]
pub(super) enum Move {
    /// Of a vertex, this share of the way to its best place.
    Relocate(u32, f64),
    /// Of an edge.
    Flip(u32, u32),
    /// Keeps the first vertex; the new place is this share of the way to the second.
    Collapse(u32, u32, f64),
    /// Of an edge.
    Split(u32, u32),
}

impl Move {
    /// Whether it is a relocation that stops short of the best place.
    pub(super) fn is_partial(self) -> bool {
        matches!(self, Self::Relocate(_, share) if share < 1.0)
    }

    /// Makes the move, and names the vertices that gain by relocation afterwards; `None` where it cannot be made.
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
                    let on_sheet =
                        |way: DVec3| projected(surface, surface.sheet_at(v), from + share * way, way.length());
                    let to = match surface.is_free(v) {
                        true => on_sheet(best - from),
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
                let sheet = surface.sheet[t as usize];
                let at = if share == 0.0 { p } else { projected(surface, sheet, p.lerp(q, share), p.distance(q))? };
                collapse(surface, keep, gone, at).then(|| with_neighbours(surface, keep))
            }
            Self::Split(a, b) => split(surface, a, b).map(|middle| with_neighbours(surface, middle)),
        }
    }
}

/// The moves on the vertices and edges of some triangles.
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

/// Relocates some vertices in turn, and again while any of them moves, but where that cannot make up for the move before.
pub(super) fn relocate_all(surface: &mut Surface, mut vertices: Vec<u32>) {
    vertices.sort_unstable();
    for _ in 0..RELOCATIONS {
        let mut moved = false;
        for &v in &vertices {
            moved |= relocate_or_slide(surface, v);
        }
        if !moved || change_of_smallest(surface) < HOPELESS_AFTER_RELOCATIONS {
            break;
        }
    }
}
