//! Places where the topology of F = 0 is not told, or finer than is asked of a mesh, and what the topology may be up to them.

use super::cells::{BASE, Cell, Cells, around, moved};
use super::critical::CriticalPoint;
use super::surface::Surface;
use super::{Bounds, Component, RESOLUTION};
use crate::spline::CubicSpline;
use glam::DVec3;
use isoparticles_mesh::components::DisjointSets;
use rayon::prelude::*;
use serde::Serialize;
use std::collections::BTreeMap;
use std::ops::RangeInclusive;

/// A place where a mesh may have another topology than F.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Undecided {
    /// The critical point of F there, or the middle of the place; grid frame, mm.
    pub place: [f64; 3],
    /// Twice the radius of the neck, gap or speck, or the longest extent along an axis of the grid, mm.
    pub size: f64,
    /// F there, mm.
    pub value: f64,
    /// What is there.
    pub kind: UndecidedKind,
    /// Components that it touches, ascending.
    #[serde(skip)]
    pub components: Vec<u32>,
    /// A box round it, grid frame, mm.
    #[serde(skip)]
    pub bounds: Bounds,
}

/// What is at an undecided place. All but the last are critical points of F whose value tells what F has there; on the other side of F = 0
/// they would change it in one way.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum UndecidedKind {
    /// Two sheets, which may be joined.
    Gap,
    /// A neck of the object or of what surrounds it, which may be cut.
    Neck,
    /// An extremum of F within a speck or a cavity, which may be missing.
    Speck,
    /// Cells in which F = 0 is not certain, with this many critical points: two where none were found, as when two are about to cancel. Also a
    /// component finer than [`RESOLUTION`] in a flat F, which counts as one.
    Uncertain(usize),
}

/// Components that undecided places may join, or one by itself, and what it may be, however these are had.
#[derive(Clone, Debug, PartialEq)]
pub struct Group {
    /// Its components, ascending; none where all that it may be is a speck.
    pub components: Vec<u32>,
    /// How many components it may be.
    pub component_count: RangeInclusive<usize>,
    /// Euler characteristics that it may have.
    pub euler: RangeInclusive<i64>,
    /// The undecided places in it, ascending.
    pub undecided: Vec<u32>,
}

/// All groups: the topology of F up to its undecided places.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Groups {
    all: Vec<Group>,
    group_of: Vec<u32>,
    may_vanish: Vec<bool>,
}

impl Groups {
    /// The groups.
    pub fn all(&self) -> &[Group] {
        &self.all
    }

    /// The group of a component; `None` of a number that is no component's.
    pub fn of(&self, component: u32) -> Option<u32> {
        self.group_of.get(component as usize).copied()
    }

    /// Whether a component may be missing.
    pub fn may_vanish(&self, component: u32) -> bool {
        self.may_vanish[component as usize]
    }

    /// How components and places group.
    pub(super) fn new(components: &[Component], places: &[Undecided]) -> Self {
        let mut sets = DisjointSets::new(components.len());
        let mut may_vanish = vec![false; components.len()];
        for place in places {
            place.components.windows(2).for_each(|pair| sets.join(pair[0], pair[1]));
            for &c in &place.components {
                let bounds = &components[c as usize].bounds;
                may_vanish[c as usize] |= match place.kind {
                    UndecidedKind::Speck => true,
                    UndecidedKind::Uncertain(_) => place.bounds.holds(bounds.low) && place.bounds.holds(bounds.high),
                    _ => false,
                };
            }
        }
        let mut new = Self { all: Vec::new(), group_of: vec![0; components.len()], may_vanish };
        let mut ranges: Vec<Ranges> = Vec::new();
        for (n, component) in components.iter().enumerate() {
            let first = sets.find(n as u32) as usize;
            let group = if first == n { new.add(&mut ranges) } else { new.group_of[first] };
            new.group_of[n] = group;
            new.all[group as usize].components.push(n as u32);
            ranges[group as usize].add(component.euler);
        }
        for (n, place) in (0..).zip(places) {
            let group = match place.components.first() {
                Some(&c) => new.group_of[c as usize],
                None => new.add(&mut ranges),
            };
            new.all[group as usize].undecided.push(n);
            ranges[group as usize].widen(place);
        }
        for (group, range) in new.all.iter_mut().zip(ranges) {
            let least = i64::from(group.components.iter().any(|&c| !new.may_vanish[c as usize]));
            let [low, high] = range.count.map(|n| n.max(least) as usize);
            group.component_count = low..=high;
            group.euler = range.euler[0]..=range.euler[1];
        }
        new
    }

    fn add(&mut self, ranges: &mut Vec<Ranges>) -> u32 {
        self.all.push(Group { components: Vec::new(), component_count: 0..=0, euler: 0..=0, undecided: Vec::new() });
        ranges.push(Ranges::default());
        self.all.len() as u32 - 1
    }
}

/// Least and most of what a group may be.
#[derive(Clone, Default)]
struct Ranges {
    count: [i64; 2],
    euler: [i64; 2],
}

impl Ranges {
    /// Takes in a component.
    fn add(&mut self, euler: i64) {
        self.count = self.count.map(|n| n + 1);
        self.euler = self.euler.map(|n| n + euler);
    }

    /// Takes in a place. A tube in place of two disks has an Euler characteristic lower by two, and joins two components or is a handle.
    fn widen(&mut self, place: &Undecided) {
        let is_between = i64::from(place.components.len() > 1);
        let (count, euler) = match place.kind {
            UndecidedKind::Gap => ([-is_between, 0], [-2, 0]),
            UndecidedKind::Neck => ([0, 1], [0, 2]),
            UndecidedKind::Speck => ([-1, 0], [-2, 0]),
            // one critical point can do no more than join two
            UndecidedKind::Uncertain(1) if is_between == 1 => ([-1, 0], [-2, 0]),
            UndecidedKind::Uncertain(critical_points) => {
                let n = critical_points as i64;
                ([-n, n], [-2 * n, 2 * n])
            }
        };
        self.count = [self.count[0] + count[0], self.count[1] + count[1]];
        self.euler = [self.euler[0] + euler[0], self.euler[1] + euler[1]];
    }
}

/// The undecided places: clusters of cells in which F = 0 is not certain, in the order of their lowest cells, and then all critical points
/// elsewhere whose neck, gap or speck is finer than [`RESOLUTION`], in their order, and components as fine.
pub(super) fn places(
    field: &CubicSpline,
    cells: &Cells,
    surface: &Surface,
    critical: &[CriticalPoint],
) -> Vec<Undecided> {
    let resolution = RESOLUTION * field.geometry().mean_spacing();
    let mut own: Vec<Cell> = surface.undecided.iter().map(|cell| cell.within(BASE)).collect();
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
    let mut clusters: BTreeMap<u32, (Vec<Cell>, usize)> = BTreeMap::new();
    for (n, &cell) in (0..).zip(&own) {
        clusters.entry(sets.find(n)).or_default().0.push(cell);
    }
    let mut fine: Vec<&CriticalPoint> = Vec::new();
    for c in critical.iter().filter(|c| c.radius < resolution) {
        match own.binary_search(&cells.finest_at(field, c.position).within(BASE)) {
            Ok(n) => clusters.entry(sets.find(n as u32)).or_default().1 += 1,
            Err(_) => fine.push(c),
        }
    }
    let clusters: Vec<(Vec<Cell>, usize)> = clusters.into_values().collect();
    let mut places: Vec<Undecided> =
        clusters.par_iter().map(|(own, critical)| uncertain(field, cells, surface, own, *critical)).collect();
    places.par_extend(fine.par_iter().map(|c| at_critical_point(field, cells, surface, c)));
    let is_told = |n: u32| places.iter().any(|place| place.kind == UndecidedKind::Speck && place.components == [n]);
    let is_fine = |own: &Component| (own.bounds.high - own.bounds.low).max_element() < 2.0 * resolution;
    let fine = (0..).zip(&surface.components).filter(|&(n, own)| is_fine(own) && !is_told(n));
    let fine: Vec<Undecided> = fine.map(|(n, own)| at_fine_component(field, cells, surface, n, own)).collect();
    places.extend(fine);
    places
}

/// The place of a component finer than [`RESOLUTION`] whose critical point does not tell so, because F is nearly flat there. A mesh that has its
/// points beside it may have it, lack it, or join it to the nearest.
fn at_fine_component(field: &CubicSpline, cells: &Cells, surface: &Surface, n: u32, own: &Component) -> Undecided {
    let around = surface.crossings_round(cells, cells.finest_at(field, own.place).within(0));
    let others = around.into_iter().filter(|&crossing| surface.component_of[crossing as usize] != n);
    let away = |crossing: &u32| surface.positions[*crossing as usize].distance_squared(own.place);
    let nearest = others.min_by(|a, b| away(a).total_cmp(&away(b)));
    let Bounds { low, high } = own.bounds;
    Undecided {
        place: own.place.to_array(),
        size: (high - low).max_element(),
        value: field.value(own.bounds.centre()),
        kind: UndecidedKind::Uncertain(1),
        components: sorted(
            nearest.map(|crossing| surface.component_of[crossing as usize]).into_iter().chain([n]).collect(),
        ),
        bounds: own.bounds,
    }
}

/// The place at a critical point.
fn at_critical_point(field: &CubicSpline, cells: &Cells, surface: &Surface, c: &CriticalPoint) -> Undecided {
    let ways: Vec<DVec3> = c.ways.into_iter().filter(|way| *way != DVec3::ZERO).collect();
    let component = |way: DVec3| {
        let limit = way.length();
        let (p, normal) = field.project_with_gradient(c.position + way, limit, 1e-6 * limit)?;
        surface.component_at(field, cells, p, normal)
    };
    let ends: Vec<Option<u32>> = ways.iter().flat_map(|&way| [way, -way]).map(component).collect();
    let kind = match ways.len() {
        _ if ends.iter().any(Option::is_none) => UndecidedKind::Uncertain(1),
        1 => UndecidedKind::Gap,
        2 => UndecidedKind::Neck,
        _ => UndecidedKind::Speck,
    };
    let reach = DVec3::splat(c.radius);
    Undecided {
        place: c.position.to_array(),
        size: 2.0 * c.radius,
        value: c.value,
        kind,
        components: sorted(ends.into_iter().flatten().collect()),
        bounds: Bounds { low: c.position - reach, high: c.position + reach },
    }
}

/// A cluster of cells in which F = 0 is not certain.
fn uncertain(field: &CubicSpline, cells: &Cells, surface: &Surface, own: &[Cell], critical_points: usize) -> Undecided {
    let edge = field.geometry().spacing / f64::from(1u32 << BASE);
    let low = |cell: &Cell| DVec3::from_array(cell.at.map(f64::from)) * edge;
    let corners: Vec<DVec3> = own.iter().flat_map(|cell| [low(cell), low(cell) + edge]).collect();
    let bounds = Bounds::of(&corners);
    let mut beside = Vec::new();
    for cell in own.iter().flat_map(|&cell| around().filter_map(move |away| moved(cell, away))) {
        cells.crossed_in(cell, &mut beside);
    }
    let crossings = beside.iter().flat_map(|&(cell, _)| surface.crossings_in(cells, cell));
    Undecided {
        place: bounds.centre().to_array(),
        size: (bounds.high - bounds.low).max_element(),
        value: field.value(bounds.centre()),
        kind: UndecidedKind::Uncertain(if critical_points == 0 { 2 } else { critical_points }),
        components: sorted(crossings.map(|&crossing| surface.component_of[crossing as usize]).collect()),
        bounds: Bounds { low: bounds.low - edge, high: bounds.high + edge },
    }
}

fn sorted(mut components: Vec<u32>) -> Vec<u32> {
    components.sort_unstable();
    components.dedup();
    components
}
