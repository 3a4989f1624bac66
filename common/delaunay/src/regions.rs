//! Inserts rounds of points on all cores. Planes recursively cut the triangulation into regions.
//! Each region has its own tetrahedra, and a single thread inserts the points of the region. A
//! point whose cavity would extend into another region is postponed until the two regions are
//! merged. Tetrahedra next to another region are therefore never removed, and merging only
//! renumbers the tetrahedra of one region. The small rounds come first, so most cavities are small
//! by the time the triangulation is cut.
//!
//! The cuts do not depend on the number of threads, and neither do the tetrahedron indices.

use super::insert::{Beyond, Cells, Sites};
use super::{DEAD, INFINITE, Tetrahedron};
use crate::error::Error;
use glam::DVec3;

/// Limits of the recursive division into regions.
#[derive(Clone, Copy, Debug)]
pub(super) struct Cutting {
    /// Minimum number of points to insert into a region for the region to be cut.
    pub(super) points: usize,
    /// Maximum number of nested cuts.
    pub(super) depth: u32,
}

impl Cutting {
    /// Default limits, which give at most 8 regions. On 16 cores, triangulating 377,000 particles
    /// of a ribcage while the topology of F is computed takes 1.32, 1.04, 0.77 and 0.74 s with 2,
    /// 4, 8 and 16 regions (`points` is 200,000 for 2 regions and 20,000 for 16). On one core, it
    /// takes 3.3 s with 2 regions and 3.5 s with 8.
    pub(super) const USUAL: Self = Self { points: 20_000, depth: 3 };
}

/// Minimum fraction of the points on each side of a cut. The cut is at the median, so each side has
/// about half of the points unless many points have the same coordinate. If one side has a smaller
/// fraction, the region is not cut, because a cut would save at most a tenth of the time.
const LEAST_SHARE_OF_SIDE: f64 = 0.1;

/// Maximum number of sampled points whose median determines the plane of a cut. The median of
/// 10,000 sampled points has a rank among all points with a standard error of 0.5 / sqrt(10,000),
/// or half a per cent, of the number of points.
const MEDIAN_SAMPLE: usize = 10_000;

/// Triangulates points that are given in insertion order. `rounds` contains the end index of each
/// round, and `seeds` the vertices of the first tetrahedron.
pub(super) fn triangulate(
    sites: Sites<'_>,
    rounds: &[usize],
    seeds: [u32; 4],
    cutting: Cutting,
) -> Result<Cells, Error> {
    let mut cells = Cells::default();
    cells.reserve(sites.points.len() * 8 + 16);
    cells.start(seeds);
    let mut start = 0;
    for &end in rounds {
        let members = (start as u32..end as u32).filter(|v| !seeds.contains(v)).collect();
        start = end;
        let Inserted { put_off, .. } = insert_all(&mut cells, sites, members, None, cutting)?;
        assert!(put_off.is_empty(), "a whole triangulation has all tetrahedra");
    }
    Ok(cells)
}

/// Result of inserting the points of a region.
struct Inserted {
    /// Postponed points, each with the cut that must be removed before the point can be inserted.
    put_off: Vec<(u32, Beyond)>,
    /// New index of each tetrahedron that existed before the insertion. `None` if the indices are
    /// unchanged.
    renumbered: Option<Vec<u32>>,
}

/// The triangulation from which a region was cut, used to locate a point when the walk leaves the
/// region.
struct Outer<'a> {
    whole: &'a Cells,
    /// For each tetrahedron of `whole`, its region and its index in that region.
    places: &'a [Slot],
    /// Side of the cut on which the region lies: 0 below the plane, 1 above.
    side: usize,
    /// The cut between the two sides.
    cut: Beyond,
    /// The triangulation from which `whole` was cut, if `whole` is a region.
    up: Option<&'a Self>,
}

impl Outer<'_> {
    /// Returns the tetrahedron at which the next walk starts in each enclosing triangulation,
    /// innermost first.
    fn starts(&self) -> Vec<u32> {
        std::iter::successors(Some(self), |outer| outer.up).map(|outer| outer.whole.last).collect()
    }

    /// Finds the tetrahedron that contained a point at the time of the cut, and returns its index
    /// in the region. Returns an error if the tetrahedron is in another region; the point must then
    /// be postponed.
    fn find(&self, sites: Sites<'_>, point: DVec3, starts: &mut [u32]) -> Result<u32, Beyond> {
        let (start, further) = starts.split_first_mut().ok_or(self.cut)?;
        let walked = self.whole.locate(sites, point, *start);
        *start = walked.or_else(|beyond| self.up.ok_or(beyond)?.find(sites, point, further))?;
        self.places[*start as usize].on(self.side).ok_or(self.cut)
    }
}

/// Inserts points into a region on all cores. `outer` is `None` for a whole triangulation.
fn insert_all(
    cells: &mut Cells,
    sites: Sites<'_>,
    members: Vec<u32>,
    outer: Option<&Outer<'_>>,
    cutting: Cutting,
) -> Result<Inserted, Error> {
    let depth = Beyond(outer.map_or(0, |outer| outer.cut.0 + 1));
    let cut = if members.len() < cutting.points || depth.0 >= cutting.depth {
        None
    } else {
        Cut::new(cells, sites, &members, depth)
    };
    let Some(Cut { mut regions, places, seams }) = cut else {
        // Reserve once. If a vector grew repeatedly in a thread, the allocator of that thread would
        // retain the freed memory.
        cells.reserve(members.len() * 8);
        let put_off = insert_in_order(cells, sites, members, outer, None)?;
        return Ok(Inserted { put_off, renumbered: None });
    };
    let whole = std::mem::take(cells);
    let insert = |side: usize, (cells, members): &mut (Cells, Vec<u32>)| {
        let outer = Outer { whole: &whole, places: &places, side, cut: depth, up: outer };
        insert_all(cells, sites, std::mem::take(members), Some(&outer), cutting)
    };
    let [low, high] = &mut regions;
    let (low_done, high_done) = rayon::join(|| insert(0, low), || insert(1, high));
    drop(whole);
    let done = [low_done?, high_done?];
    let [(low, _), (high, _)] = regions;
    let all: Vec<(u32, Beyond)> = done.iter().flat_map(|inserted| &inserted.put_off).copied().collect();
    let offset = low.tetrahedra.len() as u32;
    // maps the index of a tetrahedron in its region at the time of the cut to its index after
    // merging
    let number = |side: usize, number: u32| {
        let number = done[side].renumbered.as_ref().map_or(number, |new| new[number as usize]);
        if side == 0 { number } else { number + offset }
    };
    *cells = low.joined_by(high, all.len() * 9);
    cells.check_room()?;
    for facets in seams {
        let [low, high] = [0, 1].map(|side| number(side, facets[side] >> 2) << 2 | facets[side] & 3);
        cells.tetrahedra[(low >> 2) as usize].neighbours[(low & 3) as usize] = high;
        cells.tetrahedra[(high >> 2) as usize].neighbours[(high & 3) as usize] = low;
    }
    let renumbered: Vec<u32> =
        places.iter().map(|place| place.side_and_number().map_or(u32::MAX, |(side, old)| number(side, old))).collect();
    let (later, mut put_off): (Vec<_>, Vec<_>) = all.into_iter().partition(|&(_, beyond)| beyond == depth);
    let mut later: Vec<u32> = later.into_iter().map(|(v, _)| v).collect();
    later.sort_unstable();
    put_off.extend(insert_in_order(cells, sites, later, outer, Some(&renumbered))?);
    Ok(Inserted { put_off, renumbered: Some(renumbered) })
}

/// Inserts points one by one. Returns the points that need tetrahedra beyond a cut.
fn insert_in_order(
    cells: &mut Cells,
    sites: Sites<'_>,
    members: Vec<u32>,
    outer: Option<&Outer<'_>>,
    renumbered: Option<&[u32]>,
) -> Result<Vec<(u32, Beyond)>, Error> {
    let mut put_off = Vec::new();
    let mut starts = outer.map(Outer::starts).unwrap_or_default();
    for v in members {
        cells.check_room()?;
        let point = sites.points[v as usize];
        let walked = cells.locate(sites, point, cells.last);
        let located = walked.or_else(|beyond| {
            let first = outer.ok_or(beyond)?.find(sites, point, &mut starts)?;
            let now = renumbered.map_or(first, |new| new[first as usize]);
            if cells.is_alive(now) { cells.locate(sites, point, now) } else { Err(beyond) }
        });
        if let Err(beyond) = located.and_then(|located| cells.insert_at(sites, v, located)) {
            put_off.push((v, beyond));
        }
    }
    Ok(put_off)
}

/// Position of a tetrahedron after a cut: its index in the region times 2, plus the side.
#[derive(Clone, Copy)]
struct Slot(u32);

impl Slot {
    /// Value for an unused tetrahedron index.
    const NONE: Self = Self(u32::MAX);

    fn new(side: usize, number: u32) -> Self {
        Self(number << 1 | side as u32)
    }

    fn side_and_number(self) -> Option<(usize, u32)> {
        (self.0 != u32::MAX).then_some(((self.0 & 1) as usize, self.0 >> 1))
    }

    fn on(self, side: usize) -> Option<u32> {
        self.side_and_number().filter(|&(own, _)| own == side).map(|(_, number)| number)
    }
}

/// A triangulation or region that is cut into two halves.
struct Cut {
    /// The tetrahedra of each half, and the points to insert into it.
    regions: [(Cells, Vec<u32>); 2],
    /// For each tetrahedron before the cut, its half and its index in that half.
    places: Vec<Slot>,
    /// The facets on the cut, as (tetrahedron * 4 + facet index) on both sides.
    seams: Vec<[u32; 2]>,
}

impl Cut {
    /// Cuts a region perpendicular to the axis along which the points to insert extend farthest, at
    /// their median coordinate. Returns `None` if one side would have less than
    /// [`LEAST_SHARE_OF_SIDE`] of the points, or no tetrahedra.
    fn new(cells: &Cells, sites: Sites<'_>, members: &[u32], depth: Beyond) -> Option<Self> {
        let at = |v: u32| sites.points[v as usize];
        let mut sample: Vec<DVec3> =
            members.iter().step_by(members.len() / MEDIAN_SAMPLE + 1).map(|&v| at(v)).collect();
        let low = sample.iter().copied().reduce(DVec3::min)?;
        let high = sample.iter().copied().reduce(DVec3::max)?;
        let axis = (high - low).max_position();
        let middle = sample.len() / 2;
        let plane = sample.select_nth_unstable_by(middle, |p, q| p[axis].total_cmp(&q[axis])).1[axis];

        let (above, below): (Vec<u32>, Vec<u32>) = members.iter().partition(|&&v| at(v)[axis] >= plane);
        if (above.len().min(below.len()) as f64) < LEAST_SHARE_OF_SIDE * members.len() as f64 {
            return None;
        }
        let mut places = vec![Slot::NONE; cells.tetrahedra.len()];
        let mut halves: [Vec<Tetrahedron>; 2] = Default::default();
        for (place, t) in places.iter_mut().zip(&cells.tetrahedra).filter(|(_, t)| t.vertices[0] != DEAD) {
            let finite = t.vertices.iter().filter(|&&v| v != INFINITE);
            let (sum, count) = finite.fold((0.0, 0.0), |(sum, count), &v| (sum + at(v)[axis], count + 1.0));
            let side = usize::from(sum >= plane * count);
            *place = Slot::new(side, halves[side].len() as u32);
            halves[side].push(*t);
        }
        if halves.iter().any(Vec::is_empty) {
            return None;
        }
        let mut seams = Vec::new();
        for (side, half) in halves.iter_mut().enumerate() {
            for (number, t) in half.iter_mut().enumerate() {
                for (i, n) in t.neighbours.iter_mut().enumerate().filter(|(_, n)| Beyond::check(**n).is_ok()) {
                    let (other, there) = places[(*n >> 2) as usize].side_and_number()?;
                    let there = there << 2 | *n & 3;
                    if other == side {
                        *n = there;
                        continue;
                    }
                    *n = depth.neighbour();
                    if side == 0 {
                        seams.push([(number as u32) << 2 | i as u32, there]);
                    }
                }
            }
        }
        let [low, high] = halves.map(Cells::of);
        Some(Self { regions: [(low, below), (high, above)], places, seams })
    }
}
