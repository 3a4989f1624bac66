//! Places where the topology of F = 0 cannot be told, and the components that they may join or part.

use super::cells::{Cell, Cells, FINE, around, moved};
use super::critical::CriticalPoint;
use super::polygons::Surface;
use super::{Bounds, Component, Group, RESOLUTION};
use crate::components::DisjointSets;
use crate::spline::CubicSpline;
use glam::DVec3;
use rayon::prelude::*;
use serde::Serialize;
use std::collections::BTreeMap;

/// Smallest cells that share a face, an edge or a corner, in which F = 0 is not certain or finer than [`RESOLUTION`].
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Undecided {
    /// Middle of the place, grid frame, mm.
    pub place: [f64; 3],
    /// Its longest extent along an axis of the grid, mm.
    pub size: f64,
    /// |F| in its middle, mm.
    pub value: f64,
    /// Critical points of F in it whose neck, gap or speck is finer than [`RESOLUTION`], one at least: each may change the number of components by one, and the Euler characteristic by two.
    pub critical_points: usize,
    /// The group that it touches.
    pub group: u32,
    /// A box round it and the smallest cells beside it, grid frame, mm.
    #[serde(skip)]
    pub bounds: Bounds,
    /// Components that it touches.
    #[serde(skip)]
    pub components: Vec<u32>,
}

/// The undecided places, in the order of their lowest cells: cells in which F = 0 is not certain, and all from critical points too near to F = 0
/// to where they meet it.
pub(super) fn places(
    field: &CubicSpline,
    cells: &Cells,
    surface: &Surface,
    critical: &[CriticalPoint],
) -> Vec<Undecided> {
    let resolution = RESOLUTION * field.geometry().mean_spacing();
    let fine: Vec<&CriticalPoint> = critical.iter().filter(|c| c.radius < resolution).collect();
    let mut own = surface.undecided.clone();
    own.extend(fine.iter().flat_map(|c| cells_round(field, cells, c)));
    own.sort_unstable();
    own.dedup();
    let mut sets = DisjointSets::new(own.len());
    for (n, &cell) in (0..).zip(&own) {
        for other in around().filter_map(|away| moved(cell, away)) {
            if let Ok(other) = own.binary_search(&other) {
                sets.join(n, other as u32);
            }
        }
    }
    let mut places: BTreeMap<u32, (Vec<Cell>, usize)> = BTreeMap::new();
    for (n, &cell) in (0..).zip(&own) {
        places.entry(sets.find(n)).or_default().0.push(cell);
    }
    for c in fine {
        if let Ok(n) = own.binary_search(&cells.finest_at(field, c.position)) {
            places.entry(sets.find(n as u32)).or_default().1 += 1;
        }
    }
    let places: Vec<(Vec<Cell>, usize)> = places.into_values().collect();
    places.par_iter().map(|(own, critical)| place(field, cells, surface, own, (*critical).max(1))).collect()
}

/// The finest cells from a critical point to where F = 0 is met by the second-order expansion, no farther than [`RESOLUTION`].
fn cells_round(field: &CubicSpline, cells: &Cells, c: &CriticalPoint) -> Vec<Cell> {
    let reach = RESOLUTION * field.geometry().mean_spacing();
    let steps = 2 * (RESOLUTION * FINE as f64).ceil() as i32;
    let ways = c.ways.iter().map(|way| way.clamp_length_max(reach));
    let along = ways.flat_map(|way| (-steps..=steps).map(move |n| way * (f64::from(n) / f64::from(steps))));
    along.map(|step| cells.finest_at(field, c.position + step)).collect()
}

fn place(field: &CubicSpline, cells: &Cells, surface: &Surface, own: &[Cell], critical_points: usize) -> Undecided {
    let edge = field.geometry().spacing / FINE as f64;
    let low = |cell: &Cell| DVec3::from_array(cell.at.map(f64::from)) * edge;
    let corners: Vec<DVec3> = own.iter().flat_map(|cell| [low(cell), low(cell) + edge]).collect();
    let bounds = Bounds::of(&corners);
    let beside = own.iter().flat_map(|&cell| around().filter_map(move |away| moved(cell, away)));
    let mut beside: Vec<Cell> = beside.filter_map(|cell| cells.find(cell)).map(|(cell, _)| cell).collect();
    beside.sort_unstable();
    beside.dedup();
    let crossings = beside.iter().flat_map(|&cell| surface.crossings_in(cells, cell));
    let mut components: Vec<u32> = crossings.map(|&crossing| surface.component_of[crossing as usize]).collect();
    components.sort_unstable();
    components.dedup();
    Undecided {
        place: bounds.centre().to_array(),
        size: (bounds.high - bounds.low).max_element(),
        value: field.value(bounds.centre()).abs(),
        critical_points,
        group: 0,
        bounds: Bounds { low: bounds.low - edge, high: bounds.high + edge },
        components,
    }
}

/// Puts components that the same places touch into one group; places that touch none are groups of their own, after the others.
pub(super) fn groups(components: &mut [Component], mut undecided: Vec<Undecided>) -> (Vec<Group>, Vec<Undecided>) {
    let mut sets = DisjointSets::new(components.len());
    for place in &undecided {
        place.components.windows(2).for_each(|pair| sets.join(pair[0], pair[1]));
    }
    let mut groups: Vec<Group> = Vec::new();
    let new = || Group { components: Vec::new(), component_count: 0..=0, euler: 0..=0, undecided: Vec::new() };
    for n in 0..components.len() {
        let first = sets.find(n as u32) as usize;
        if first == n {
            components[n].group = groups.len() as u32;
            groups.push(new());
        }
        components[n].group = components[first].group;
        groups[components[n].group as usize].components.push(n as u32);
    }
    for (n, place) in (0..).zip(&mut undecided) {
        place.group = place.components.first().map_or(groups.len() as u32, |&c| components[c as usize].group);
        if place.components.is_empty() {
            groups.push(new());
        }
        groups[place.group as usize].undecided.push(n);
        for &c in &place.components {
            let own = &mut components[c as usize];
            own.is_certain &= !(place.bounds.holds(own.bounds.low) && place.bounds.holds(own.bounds.high));
        }
    }
    for group in &mut groups {
        let euler: i64 = group.components.iter().map(|&c| components[c as usize].euler).sum();
        let changes: usize = group.undecided.iter().map(|&n| undecided[n as usize].critical_points).sum();
        let count = group.components.len();
        let is_certain = group.components.iter().any(|&c| components[c as usize].is_certain);
        group.component_count = count.saturating_sub(changes).max(usize::from(is_certain))..=count + changes;
        group.euler = euler - 2 * changes as i64..=euler + 2 * changes as i64;
    }
    (groups, undecided)
}
