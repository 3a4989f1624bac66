//! Marking and peeling: umbrellas mark the tetrahedra outside, and from the hull everything marked so is eaten away.

use super::cells::Cells;
use super::umbrellas::Umbrellas;
use super::walk::Sheets;
use crate::restricted::Facet;
use glam::DVec3;
use isoparticles_delaunay::Delaunay;
use rayon::prelude::*;
use std::collections::BTreeMap;

/// Marks of a tetrahedron none of whose vertices has an umbrella.
const TRANSPARENT: i8 = i8::MIN;

/// A sheet is met for sure when this part in a thousand of it is met on one side.
const SURELY_MET: i64 = 900;

/// Outside for all four vertices, and inside for all.
const UNANIMOUS: i8 = 4;

/// Peels until nothing more comes off; returns for each tetrahedron whether it is outside. Sheets met for the first time get their
/// sense then: what is outside on one side of them. Those that are never met bound cavities: what is inside is on one side of
/// them, and the other side is peeled as well.
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

/// For each tetrahedron, how many of its umbrellas have it outside less how many inside.
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

/// Eats from what is outside into tetrahedra marked outside, and into transparent ones through all facets but that of least
/// circumradius.
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

/// The facet of least circumradius.
fn opaque_facet(delaunay: &Delaunay, t: u32) -> usize {
    let radius = |i: &usize| {
        let [a, b, c] = delaunay.facet(t, *i).map(|v| delaunay.points()[v as usize]);
        let sides = [a.distance_squared(b), b.distance_squared(c), c.distance_squared(a)];
        sides.iter().product::<f64>() / (b - a).cross(c - a).length_squared().max(f64::MIN_POSITIVE)
    };
    (0..4).min_by(|i, j| radius(i).total_cmp(&radius(j))).unwrap_or(0)
}

/// The tetrahedra that what is marked inside reaches without crossing a candidate triangle.
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

/// Gives the sheets whose sense is not known yet and which are met on one side the sense that makes this side outward (`kind` 1) or
/// inward (-1). True when there was one.
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
    // a sheet met on both sides waits until those that are sure have had their say
    let share = |(sum, total): (i64, i64)| 1000 * sum.abs() / total.max(1);
    let met: Vec<(u32, (i64, i64))> = sums.into_iter().filter(|(_, (sum, _))| *sum != 0).collect();
    let bar = match met.iter().map(|(_, votes)| share(*votes)).max().unwrap_or(0) {
        most if most >= SURELY_MET => SURELY_MET,
        // halves, so that a noisy cloud with many small sheets does not take as many rounds
        most => most / 2,
    };
    for &(sheet, votes) in met.iter().filter(|(_, votes)| share(*votes) >= bar) {
        sheets.outward[sheet as usize] = kind * votes.0.signum() as i8;
    }
    !met.is_empty()
}

/// Parts of the object without a tetrahedron that all four vertices have inside are no parts: a few tetrahedra between sheets.
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

/// Share of the facets whose outward side agrees with the normals given at their vertices, of those that have any; `None` where no
/// facet has.
pub(super) fn agreement(delaunay: &Delaunay, facets: &[Facet], normals: &[DVec3]) -> Option<f64> {
    let given = |f: &Facet| f.vertices.iter().map(|&v| normals[v as usize].normalize_or_zero()).sum::<DVec3>();
    let agrees = |f: &&Facet| {
        let [a, b, c] = f.vertices.map(|v| delaunay.points()[v as usize]);
        (b - a).cross(c - a).dot(given(f)) > 0.0
    };
    let known = facets.par_iter().filter(|f| given(f) != DVec3::ZERO).count();
    (known > 0).then(|| facets.par_iter().filter(agrees).count() as f64 / known as f64)
}
