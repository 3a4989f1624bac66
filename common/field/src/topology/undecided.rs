//! Finds the locations where the topology of F = 0 is undecided or where a mesh need not reproduce
//! it, and the topologies that these locations allow.

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

/// A location where a mesh need not have the topology of F = 0.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Undecided {
    /// Position in the grid frame, mm: the critical point of F, the middle of the uncertain cells,
    /// or a point near the fine component.
    pub place: [f64; 3],
    /// Size in mm: twice the radius of the neck, gap or speck, or the longest extent of the
    /// uncertain cells or the fine component along a grid axis.
    pub size: f64,
    /// F at `place`, or at the middle of `bounds` for a fine component, mm.
    pub value: f64,
    /// Kind of the location.
    pub kind: UndecidedKind,
    /// Components that the location touches, in ascending order.
    #[serde(skip)]
    pub components: Vec<u32>,
    /// Bounding box of the location in the grid frame, mm.
    #[serde(skip)]
    pub bounds: Bounds,
}

/// Kind of an undecided location. Gaps, necks and most specks are at critical points of F. The kind
/// depends on the number of principal directions in which F = 0 is reached. If the critical point
/// were on the other side of F = 0, the topology would change in a known way.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum UndecidedKind {
    /// Two parts of the surface that may be joined.
    Gap,
    /// A neck of the object or of its surroundings that may be cut.
    Neck,
    /// A speck or cavity that a mesh may omit.
    Speck,
    /// Cells in which the topology of F = 0 is uncertain, with the number of critical points in
    /// them. If none are found, two are assumed, because two critical points may almost cancel. A
    /// fine component near another one, and a critical point of unknown kind, are `Uncertain(1)`.
    Uncertain(usize),
}

/// A single component, or several components that undecided locations may join, with the topologies
/// that are allowed for them.
#[derive(Clone, Debug, PartialEq)]
pub struct Group {
    /// Allowed numbers of components for each Euler characteristic, in steps of two from the
    /// lowest.
    counts: Vec<RangeInclusive<usize>>,
    /// Components of the group, in ascending order. Empty if the group consists only of a possible
    /// speck.
    pub components: Vec<u32>,
    /// Allowed numbers of components.
    pub component_count: RangeInclusive<usize>,
    /// Allowed Euler characteristics.
    pub euler: RangeInclusive<i64>,
    /// Indices of the undecided locations in the group, in ascending order.
    pub undecided: Vec<u32>,
}

impl Group {
    /// Returns whether the group may consist of this number of components with this total Euler
    /// characteristic.
    pub fn may_be(&self, component_count: usize, euler: i64) -> bool {
        // the Euler characteristic of a surface that ends at the border may lie between two steps
        let above = euler - self.euler.start();
        [above.div_euclid(2), (above + 1).div_euclid(2)].into_iter().any(|step| {
            let counts = usize::try_from(step).ok().and_then(|step| self.counts.get(step));
            counts.is_some_and(|counts| counts.contains(&component_count))
        })
    }
}

/// All groups of components, with the topologies that the undecided locations allow.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Groups {
    all: Vec<Group>,
    group_of: Vec<u32>,
    may_vanish: Vec<bool>,
}

impl Groups {
    /// Returns the groups.
    pub fn all(&self) -> &[Group] {
        &self.all
    }

    /// Returns the group of a component, or `None` if no component has this number.
    pub fn of(&self, component: u32) -> Option<u32> {
        self.group_of.get(component as usize).copied()
    }

    /// Returns whether a mesh may omit a component.
    pub fn may_vanish(&self, component: u32) -> bool {
        self.may_vanish[component as usize]
    }

    /// Groups components and undecided locations.
    pub(super) fn new(components: &[Component], places: &[Undecided]) -> Self {
        let mut sets = DisjointSets::new(components.len());
        let mut may_vanish = vec![false; components.len()];
        let mut changes = Vec::with_capacity(places.len());
        for place in places {
            let is_joining = place.components.windows(2).any(|pair| sets.find(pair[0]) != sets.find(pair[1]));
            changes.push(Changes::at(place, is_joining));
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
        let mut sums: Vec<(i64, Changes)> = Vec::new();
        for (n, component) in components.iter().enumerate() {
            let first = sets.find(n as u32) as usize;
            let group = if first == n { new.add(&mut sums) } else { new.group_of[first] };
            new.group_of[n] = group;
            new.all[group as usize].components.push(n as u32);
            sums[group as usize].0 += component.euler;
        }
        for ((n, place), changes) in (0..).zip(places).zip(changes) {
            let group = match place.components.first() {
                Some(&c) => new.group_of[c as usize],
                None => new.add(&mut sums),
            };
            new.all[group as usize].undecided.push(n);
            sums[group as usize].1 = sums[group as usize].1.and(&changes);
        }
        for (group, (euler, changes)) in new.all.iter_mut().zip(sums) {
            let least = i64::from(group.components.iter().any(|&c| !new.may_vanish[c as usize]));
            let count = |change: &i64| (group.components.len() as i64 + change).max(least) as usize;
            group.counts = changes.counts.iter().map(|[low, high]| count(low)..=count(high)).collect();
            let ends = |n: usize| changes.counts.iter().map(move |ends| ends[n]);
            let [low, high] = [ends(0).min().unwrap_or(0), ends(1).max().unwrap_or(0)];
            group.component_count = count(&low)..=count(&high);
            let lowest = euler - 2 * changes.removed as i64;
            group.euler = lowest..=lowest + 2 * (changes.counts.len() as i64 - 1);
        }
        new
    }

    fn add(&mut self, sums: &mut Vec<(i64, Changes)>) -> u32 {
        self.all.push(Group {
            counts: Vec::new(),
            components: Vec::new(),
            component_count: 0..=0,
            euler: 0..=0,
            undecided: Vec::new(),
        });
        sums.push((0, Changes::default()));
        self.all.len() as u32 - 1
    }
}

/// The changes that locations allow: for each change in the Euler characteristic, in steps of two,
/// the range of changes in the number of components.
#[derive(Clone)]
struct Changes {
    /// Maximum number of steps by which the Euler characteristic may decrease.
    removed: usize,
    /// Minimum and maximum change in the number of components, in ascending order of the Euler
    /// characteristic.
    counts: Vec<[i64; 2]>,
}

impl Default for Changes {
    /// Allows no change.
    fn default() -> Self {
        Self { removed: 0, counts: vec![[0, 0]] }
    }
}

impl Changes {
    /// Returns the changes that a location allows. `is_joining` is true if the location joins
    /// components that no earlier location has joined. Replacing two disks with a tube lowers the
    /// Euler characteristic by two. The tube either joins two components or forms a handle.
    fn at(place: &Undecided, is_joining: bool) -> Self {
        let none = [0, 0];
        // earlier locations need not join the components; if they do not, this location joins them
        let joined = [-i64::from(place.components.len() > 1), -i64::from(is_joining)];
        let joins = Self { removed: 1, counts: vec![joined, none] };
        match place.kind {
            UndecidedKind::Gap => joins,
            UndecidedKind::Neck => Self { removed: 0, counts: vec![none, [0, 1]] },
            UndecidedKind::Speck => Self { removed: 1, counts: vec![[-1, -1], none] },
            // a single critical point can join at most two components
            UndecidedKind::Uncertain(1) if place.components.len() > 1 => joins,
            UndecidedKind::Uncertain(critical_points) => {
                let n = critical_points as i64;
                // each critical point changes the Euler characteristic by at most one step, up or
                // down
                let counts = (-n..=n).map(|up| [-(n - up) / 2, (n + up) / 2]).collect();
                Self { removed: critical_points, counts }
            }
        }
    }

    /// Returns the changes that `self` and `other` allow together.
    fn and(&self, other: &Self) -> Self {
        let mut counts = vec![[i64::MAX, i64::MIN]; self.counts.len() + other.counts.len() - 1];
        for (n, own) in self.counts.iter().enumerate() {
            for (sum, other) in counts[n..].iter_mut().zip(&other.counts) {
                *sum = [sum[0].min(own[0] + other[0]), sum[1].max(own[1] + other[1])];
            }
        }
        Self { removed: self.removed + other.removed, counts }
    }
}

/// Returns whether a component is thin everywhere, not only at an extremum of F inside it. The
/// ratio of volume to area is half the thickness for a plate, and smaller for other shapes of the
/// same thickness.
fn is_thin(component: &Component, resolution: f64) -> bool {
    component.volume.abs() < resolution * component.area
}

/// Returns the undecided locations. Clusters of cells in which F = 0 is uncertain come first,
/// ordered by their lowest cells. They are followed by all other critical points whose neck, gap or
/// speck is finer than [`RESOLUTION`], in the order of `critical`, and by the remaining components
/// finer than [`RESOLUTION`].
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
    places.par_extend(fine.par_iter().filter_map(|c| at_critical_point(field, cells, surface, c)));
    let is_told = |n: u32| places.iter().any(|place| place.kind == UndecidedKind::Speck && place.components == [n]);
    let is_fine = |own: &Component| (own.bounds.high - own.bounds.low).max_element() < 2.0 * resolution;
    let fine = (0..).zip(&surface.components).filter(|&(n, own)| is_fine(own) && !is_told(n));
    let fine: Vec<Undecided> = fine.map(|(n, own)| at_fine_component(field, cells, surface, n, own)).collect();
    places.extend(fine);
    places
}

/// Returns an undecided location for a component finer than [`RESOLUTION`] that is not yet listed
/// as a speck. A mesh may contain the component, omit it, or join it to the nearest component.
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
        kind: if nearest.is_some() { UndecidedKind::Uncertain(1) } else { UndecidedKind::Speck },
        components: sorted(
            nearest.map(|crossing| surface.component_of[crossing as usize]).into_iter().chain([n]).collect(),
        ),
        bounds: own.bounds,
    }
}

/// Returns an undecided location for a critical point, or `None` for an extremum in a component
/// that is not thin. A mesh must contain such a component, even if the extremum is on the wrong
/// side of the mesh.
fn at_critical_point(field: &CubicSpline, cells: &Cells, surface: &Surface, c: &CriticalPoint) -> Option<Undecided> {
    let ways: Vec<DVec3> = c.ways.into_iter().filter(|way| *way != DVec3::ZERO).collect();
    let component = |way: DVec3| {
        let limit = way.length();
        let (p, normal) = field.project_with_gradient(c.position + way, limit, 1e-6 * limit)?;
        surface.component_at(field, cells, p, normal)
    };
    let ends: Vec<Option<u32>> = ways.iter().flat_map(|&way| [way, -way]).map(component).collect();
    let components = sorted(ends.iter().flatten().copied().collect());
    let is_certain = ends.iter().all(Option::is_some);
    let kind = match (ways.len(), &components[..]) {
        _ if !is_certain => UndecidedKind::Uncertain(1),
        (1, _) => UndecidedKind::Gap,
        (2, _) => UndecidedKind::Neck,
        (_, &[own]) if is_thin(&surface.components[own as usize], RESOLUTION * field.geometry().mean_spacing()) => {
            UndecidedKind::Speck
        }
        (_, &[_]) => return None,
        _ => UndecidedKind::Uncertain(1),
    };
    let reach = DVec3::splat(c.radius);
    Some(Undecided {
        place: c.position.to_array(),
        size: 2.0 * c.radius,
        value: c.value,
        kind,
        components,
        bounds: Bounds { low: c.position - reach, high: c.position + reach },
    })
}

/// Returns an undecided location for a cluster of cells in which F = 0 is uncertain.
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
