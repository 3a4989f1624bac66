//! Marking and peeling: umbrellas mark tetrahedra as outside or inside, and tetrahedra marked
//! outside are removed from the convex hull inward.

use super::cells::Cells;
use super::umbrellas::Umbrellas;
use super::walk::Sheets;
use crate::restricted::Facet;
use glam::DVec3;
use isoparticles_delaunay::Delaunay;
use rayon::prelude::*;
use std::collections::BTreeMap;

/// Mark of a tetrahedron without any vertex that has an umbrella.
const TRANSPARENT: i8 = i8::MIN;

/// Net share of the votes of a sheet, in thousandths, from which its orientation is certain.
const SURELY_MET: i64 = 900;

/// Mark of a tetrahedron that is outside for all four vertices. The negative is inside for all
/// four.
const UNANIMOUS: i8 = 4;

/// Returns whether each tetrahedron is outside. Peeling removes tetrahedra until no further one can
/// be removed. When it reaches a sheet of unknown orientation, the side of the removed tetrahedra
/// becomes its outer side. Sheets that peeling does not reach bound cavities. They are oriented by
/// the tetrahedra inside on one side, and the other side is removed, too.
pub(super) fn peel(cells: &Cells, umbrellas: &Umbrellas, sheets: &mut Sheets) -> Vec<bool> {
    let delaunay = cells.delaunay;
    let slots = delaunay.slot_count() as u32;
    let mut is_out: Vec<bool> =
        (0..slots).into_par_iter().map(|t| delaunay.is_alive(t) && delaunay.is_ghost(t)).collect();
    let mut marks = mark(cells, umbrellas, sheets);
    loop {
        eat(delaunay, &marks, &mut is_out);
        let met = |t: u32| is_out[t as usize];
        if orient(cells, umbrellas, sheets, 1, met) {
            marks = mark(cells, umbrellas, sheets);
            continue;
        }
        let before = is_out.iter().filter(|&&out| out).count();
        for t in 0..slots as usize {
            is_out[t] |= marks[t] == UNANIMOUS;
        }
        if is_out.iter().filter(|&&out| out).count() > before {
            continue;
        }
        let filled = fill(cells, &marks, &is_out);
        if !orient(cells, umbrellas, sheets, -1, |t| filled[t as usize]) {
            break;
        }
        marks = mark(cells, umbrellas, sheets);
    }
    drop_unsupported(delaunay, &marks, &mut is_out);
    is_out
}

/// Returns the mark of each tetrahedron: the number of its vertices whose umbrellas have it
/// outside, minus the number of those that have it inside.
fn mark(cells: &Cells, umbrellas: &Umbrellas, sheets: &Sheets) -> Vec<i8> {
    let mut marks = vec![TRANSPARENT; cells.delaunay.slot_count()];
    for v in (0..cells.stars.vertex_count() as u32).filter(|&v| umbrellas.is_good[v as usize]) {
        let sense = sheets.sense_of(v);
        for (t, side) in umbrellas.star(cells, v) {
            let mark = &mut marks[t as usize];
            *mark = if *mark == TRANSPARENT { 0 } else { *mark } + side * sense;
        }
    }
    marks
}

/// Removes tetrahedra marked outside that are adjacent to removed ones. Transparent tetrahedra are
/// removed through any facet except the one with the minimum circumradius.
fn eat(delaunay: &Delaunay, marks: &[i8], is_out: &mut [bool]) {
    let mut front: Vec<u32> = (0..is_out.len() as u32).filter(|&t| is_out[t as usize]).collect();
    while let Some(t) = front.pop() {
        for n in delaunay.neighbours(t) {
            if is_out[n as usize] {
                continue;
            }
            let mark = marks[n as usize];
            let is_eaten =
                if mark == TRANSPARENT { delaunay.neighbours(n)[opaque_facet(delaunay, n)] != t } else { mark > 0 };
            if is_eaten {
                is_out[n as usize] = true;
                front.push(n);
            }
        }
    }
}

/// Returns the local index of the facet with the minimum circumradius.
fn opaque_facet(delaunay: &Delaunay, t: u32) -> usize {
    let radius = |i: &usize| {
        let [a, b, c] = delaunay.facet(t, *i).map(|v| delaunay.points()[v as usize]);
        let sides = [a.distance_squared(b), b.distance_squared(c), c.distance_squared(a)];
        sides.iter().product::<f64>() / (b - a).cross(c - a).length_squared().max(f64::MIN_POSITIVE)
    };
    (0..4).min_by(|i, j| radius(i).total_cmp(&radius(j))).unwrap_or(0)
}

/// Returns whether each tetrahedron is marked inside, or can be reached from one marked inside
/// without crossing a candidate triangle.
fn fill(cells: &Cells, marks: &[i8], is_out: &[bool]) -> Vec<bool> {
    let mut filled: Vec<bool> = marks.iter().map(|&mark| mark < 0 && mark != TRANSPARENT).collect();
    let mut front: Vec<u32> = (0..filled.len() as u32).filter(|&t| filled[t as usize]).collect();
    while let Some(t) = front.pop() {
        for (i, n) in cells.delaunay.neighbours(t).into_iter().enumerate() {
            if !filled[n as usize] && !is_out[n as usize] && marks[n as usize] <= 0 && !cells.is_candidate(t, i) {
                filled[n as usize] = true;
                front.push(n);
            }
        }
    }
    filled
}

/// Orients the sheets of unknown orientation that have `is_met` tetrahedra mainly on one side: this
/// side becomes the outer one (`kind` 1) or the inner one (-1). Returns whether there is such a
/// sheet.
fn orient(
    cells: &Cells,
    umbrellas: &Umbrellas,
    sheets: &mut Sheets,
    kind: i8,
    is_met: impl Fn(u32) -> bool + Sync,
) -> bool {
    let count = cells.stars.vertex_count() as u32;
    let unknown = |v: &u32| umbrellas.is_good[*v as usize] && sheets.sense_of(*v) == 0;
    let votes: Vec<(u32, i64)> = (0..count)
        .into_par_iter()
        .filter(unknown)
        .map(|v| {
            let met = umbrellas.star(cells, v).filter(|&(t, _)| is_met(t));
            let vote = met.map(|(_, side)| i64::from(side)).sum::<i64>();
            (sheets.sheet[v as usize], vote * i64::from(sheets.sense[v as usize]))
        })
        .collect();
    let mut sums: BTreeMap<u32, (i64, i64)> = BTreeMap::new();
    for (sheet, vote) in votes {
        let (sum, total) = sums.entry(sheet).or_default();
        *sum += vote;
        *total += vote.abs();
    }
    // sheets with such tetrahedra on both sides wait until the clear ones are oriented
    let share = |(sum, total): (i64, i64)| 1000 * sum.abs() / total.max(1);
    let met: Vec<(u32, (i64, i64))> = sums.into_iter().filter(|(_, (sum, _))| *sum != 0).collect();
    let bar = match met.iter().map(|(_, votes)| share(*votes)).max().unwrap_or(0) {
        most if most >= SURELY_MET => SURELY_MET,
        // half of the maximum, so that noisy clouds with many small sheets need fewer rounds
        most => most / 2,
    };
    for &(sheet, votes) in met.iter().filter(|(_, votes)| share(*votes) >= bar) {
        sheets.outward[sheet as usize] = kind * votes.0.signum() as i8;
    }
    !met.is_empty()
}

/// Removes connected parts of the object without a tetrahedron that is inside for all four
/// vertices. Such parts are a few tetrahedra between sheets.
fn drop_unsupported(delaunay: &Delaunay, marks: &[i8], is_out: &mut [bool]) {
    let mut is_seen = is_out.to_vec();
    let mut part = Vec::new();
    for (seed, _) in delaunay.finite_tetrahedra() {
        if is_seen[seed as usize] {
            continue;
        }
        part.clear();
        part.push(seed);
        is_seen[seed as usize] = true;
        let mut next = 0;
        while next < part.len() {
            for n in delaunay.neighbours(part[next]) {
                if !is_seen[n as usize] {
                    is_seen[n as usize] = true;
                    part.push(n);
                }
            }
            next += 1;
        }
        if part.iter().all(|&t| marks[t as usize] != -UNANIMOUS) {
            part.iter().for_each(|&t| is_out[t as usize] = true);
        }
    }
}

/// Returns the share of the facets whose outer side agrees with the given normals at their
/// vertices, among the facets with normals. Returns `None` if there are no such facets.
pub(super) fn agreement(delaunay: &Delaunay, facets: &[Facet], normals: &[DVec3]) -> Option<f64> {
    let given = |f: &Facet| f.vertices.iter().map(|&v| normals[v as usize].normalize_or_zero()).sum::<DVec3>();
    let agrees = |f: &&Facet| {
        let [a, b, c] = f.vertices.map(|v| delaunay.points()[v as usize]);
        (b - a).cross(c - a).dot(given(f)) > 0.0
    };
    let known = facets.par_iter().filter(|f| given(f) != DVec3::ZERO).count();
    (known > 0).then(|| facets.par_iter().filter(agrees).count() as f64 / known as f64)
}
