//! Corrects the indicators so that materials touch exactly where their nodes are adjacent.
//!
//! Each indicator is computed separately, and protrusions of one voxel are smoothed away. At a hole
//! of one voxel in a thin layer, the materials on both sides recede, so the indicator of the layer
//! can be the smallest between them. The mesh then contains a film that the labels do not contain,
//! and lacks the junction curve around the hole. Where the indicator of the layer is only slightly
//! larger than the smallest one, a tube a tenth of a voxel wide connects two such holes. The
//! indicators are therefore checked at the midpoints of grid edges, faces and cells whose corners
//! belong to several materials:
//!
//! - At the midpoint, no material that is absent from the corners may have the smallest indicator,
//!   or nearly the smallest. On an edge, both corner materials must have smaller indicators than
//!   all others.
//! - If the ends of every edge of a face have different materials, the corners of either diagonal
//!   may touch, or be connected if they have the same material. If a material has exactly two
//!   corners of a cell and they are opposite, they may be connected or not. The indicators make
//!   these open decisions, and the correction gives each decision a margin.
//!
//! An indicator that violates the margin is raised at the corners of other materials, where another
//! indicator is already smaller. No node changes its material.

use glam::DVec3;
use isoparticles_field::materials::{CELLS, Indicators, MaterialId, Materials, Near, bricks_along};
use isoparticles_stage::error::Result;
use isoparticles_stage::monitor::Monitor;
use isoparticles_volume::Geometry;
use rayon::prelude::*;
use serde::Serialize;
use std::collections::{BTreeMap, BTreeSet};

/// Minimum margin by which an indicator must exceed smaller indicators at a midpoint, in units of
/// the mean voxel spacing, without and with a scale. With a scale, mesh edges are longer, and
/// details between nodes matter less.
///
/// For `thorax_labels` with `--scale-for-size 6` (h = 6 mm), two segments of junction curves are
/// missing with 0.2 and none with 0.4. With h = 3 mm, the minimum radius ratio is 0.31 with 0.2 and
/// 0.42 with 0.4. With default sizes and without a scale: on `frog_tissue_labels`, 0.2, 0.3 and 0.4
/// give 0, 1 and 1 triangles forced by curves and a minimum radius ratio of 0.51, 0.23 and 0.16; on
/// `brain_parcellation`, 0.2 and 0.3 give 13 and 15 such triangles.
const CLEARANCE: [f64; 2] = [0.2, 0.4];

/// Tolerance, in units of the mean voxel spacing, within which the four indicators at the midpoint
/// of a face are considered equal. All faces along a line where four materials meet then choose the
/// same diagonal. For eight adjacent cubes of 6^3 voxels, the indicators along such lines (pinned
/// to 0.0005 voxel) differ by up to 0.0026 voxel. Without this tolerance, the faces there choose
/// different diagonals, and eight segments of junction curves are missing.
const TIE: f64 = 0.004;

/// Target margin of a raise, relative to the required margin. A raise that increases its indicator
/// at one midpoint decreases it at the next midpoint by 0.13 / 0.6 = 22 % of that amount (see
/// [`MOST_ROUNDS`]). The excess of 25 % compensates for about one such loss. With a target of 1,
/// 1.25 and 1.5, the margin is below the required one at 1137, 43 and 51 contacts of
/// `frog_tissue_labels` (`near` in the report of `make distfield MATERIALS=all`).
const AIM: f64 = 1.25;

/// Maximum total raise of an indicator sample, in units of the mean voxel spacing. Adjacent raises
/// can feed back indefinitely, and a steeper indicator moves interfaces towards nodes. If an
/// interface lies midway between two nodes one voxel apart, its indicators differ by 1 and -1 voxel
/// at the nodes. A raise of 1 changes these differences to 2 and -1, so the interface moves to a
/// point one third of the way along the edge. With 0.5, 1 and 2, `frog_tissue_labels` loses 17, 0
/// and 0 contacts (`left` in the report of `make distfield MATERIALS=all`).
const MOST_RAISE: f64 = 1.0;

/// Effect of a unit raise at a node on the value at the midpoint of an adjacent grid edge. It is
/// the value of the cardinal cubic spline (one at the node, zero at all others) at this midpoint.
const HALF_WAY: f64 = 0.6005;

/// Distance in nodes beyond which the effect of a raise is neglected. Beyond this distance, the
/// spline of a unit raise is below 0.003 in absolute value.
const REACH: usize = 4;

/// Maximum number of rounds of raises. A raise lowers its own indicator between the next two nodes
/// by 13 % of the raise (the undershoot of the spline there), and increases the values that other
/// indicators must exceed. Real volumes take six to thirteen rounds.
const MOST_ROUNDS: usize = 40;

/// Report of the contacts.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct ContactReport {
    /// Number of pairs of a midpoint and a material absent from its corners for which the indicator
    /// of the material had too small a margin before the raises.
    pub crossed: usize,
    /// Number of open decisions whose margin was too small before the raises.
    pub undecided: usize,
    /// Number of indicator samples raised.
    pub raised: usize,
    /// Number of pairs, as in `crossed`, for which the indicator is still smaller, after the
    /// raises, than one that it must exceed.
    pub left: usize,
    /// Number of other pairs and open decisions whose margin is still too small after the raises.
    pub near: usize,
}

/// Returns the material of each node, x fastest.
fn owners(materials: &Materials) -> Vec<u16> {
    let geometry = materials.geometry();
    let [nx, ny, _] = geometry.size;
    let node = |n: usize| DVec3::from_array([n % nx, n / nx % ny, n / (nx * ny)].map(|n| n as f64));
    let all = (0..geometry.voxel_count()).into_par_iter();
    all.map(|n| materials.material_at(geometry.index_to_grid(node(n))).0).collect()
}

/// Raises indicators so that materials touch exactly where their nodes are adjacent. With a scale,
/// the required margin is larger. With only two materials, each indicator is the negative of the
/// other, and both stay unchanged.
///
/// # Errors
/// If the run is interrupted.
pub fn keep_contacts(materials: &mut Materials, is_scaled: bool, monitor: &dyn Monitor) -> Result<ContactReport> {
    if materials.table().len() < 3 {
        return Ok(ContactReport::default());
    }
    let _step = monitor.phase("contacts");
    let owners = &owners(materials)[..];
    let size = materials.geometry().size;
    let elements = GridElements::of(materials, owners, CLEARANCE[usize::from(is_scaled)] * materials.voxel());
    let mut lacks = elements.lacking(materials, owners, |_| true);
    let undecided = lacks.iter().filter(|lack| lack.is_undecided).count();
    let mut contacts = ContactReport { crossed: lacks.len() - undecided, undecided, ..ContactReport::default() };
    // total raise per material and node
    let mut raised: BTreeMap<(MaterialId, [usize; 3]), f64> = BTreeMap::new();
    let most = MOST_RAISE * materials.voxel();
    for _ in 0..MOST_ROUNDS {
        monitor.check()?;
        let mut raises: BTreeMap<(MaterialId, [usize; 3]), f64> = BTreeMap::new();
        for lack in &lacks {
            for &node in &lack.corners {
                let raise = raises.entry((lack.material, node)).or_insert(0.0);
                *raise = raise.max(lack.raise);
            }
        }
        let mut changes: BTreeMap<MaterialId, Vec<([usize; 3], f64)>> = BTreeMap::new();
        let mut changed = BTreeSet::new();
        for ((id, node), raise) in raises {
            let so_far = raised.entry((id, node)).or_insert(0.0);
            let raise = raise.min(most - *so_far);
            if raise > 0.0 {
                *so_far += raise;
                changes.entry(id).or_default().push((node, raise));
                changed.extend(bricks_near(node, size));
            }
        }
        if changes.is_empty() {
            break;
        }
        materials.add_at_nodes(&changes);
        lacks = elements.lacking(materials, owners, |brick| changed.contains(&brick));
        if lacks.is_empty() {
            // effects of raises beyond `REACH` can add up
            lacks = elements.lacking(materials, owners, |_| true);
        }
    }
    contacts.raised = raised.len();
    if !lacks.is_empty() {
        // recheck everything, including bricks unchanged in the last round
        lacks = elements.lacking(materials, owners, |_| true);
    }
    contacts.left = lacks.iter().filter(|lack| lack.is_lost && !lack.is_undecided).count();
    contacts.near = lacks.len() - contacts.left;
    Ok(contacts)
}

/// Returns the bricks that contain cells within [`REACH`] of a node.
fn bricks_near(node: [usize; 3], size: [usize; 3]) -> impl Iterator<Item = usize> {
    let [bx, by, bz] = bricks_along(size);
    let span = move |a: usize, bricks: usize| {
        node[a].saturating_sub(REACH) / CELLS..=((node[a] + REACH) / CELLS).min(bricks - 1)
    };
    span(2, bz).flat_map(move |z| span(1, by).flat_map(move |y| span(0, bx).map(move |x| (z * by + y) * bx + x)))
}

/// An edge, face or cell of the grid, given by the index of its first corner (x fastest) and one
/// bit for each axis along which it extends.
#[derive(Clone, Copy)]
struct GridElement {
    node: usize,
    axes: u8,
    /// The corner that decides an open contact ([`Corners::deciding`]). It is chosen before any
    /// raise; otherwise adjacent raises could make the choice alternate.
    deciding: u8,
}

/// An indicator whose margin at a midpoint is too small.
struct Lack {
    material: MaterialId,
    /// The corners that belong to other materials.
    corners: Vec<[usize; 3]>,
    /// Required raise in mm at each of these corners.
    raise: f64,
    /// Whether the margin belongs to an open decision.
    is_undecided: bool,
    /// Whether the indicator is smaller than an indicator that it must exceed.
    is_lost: bool,
}

/// The corners of an edge, face or cell, and their materials.
struct Corners {
    nodes: [[usize; 3]; 8],
    materials: [MaterialId; 8],
    count: usize,
}

impl Corners {
    fn of(element: GridElement, owners: &[u16], geometry: &Geometry) -> Self {
        let [nx, ny, _] = geometry.size;
        let n = element.node;
        let first = [n % nx, n / nx % ny, n / (nx * ny)];
        let mut found = Self { nodes: [[0; 3]; 8], materials: [MaterialId::OUTSIDE; 8], count: 0 };
        for corner in (0..8).filter(|corner| corner & !element.axes == 0) {
            let node: [usize; 3] = std::array::from_fn(|a| first[a] + usize::from(corner >> a & 1));
            found.nodes[found.count] = node;
            found.materials[found.count] = MaterialId(owners[geometry.linear(node[0], node[1], node[2])]);
            found.count += 1;
        }
        found
    }

    fn materials(&self) -> &[MaterialId] {
        &self.materials[..self.count]
    }

    fn are_of_one(&self) -> bool {
        self.materials().iter().all(|&id| id == self.materials[0])
    }

    fn has(&self, id: MaterialId) -> bool {
        self.materials().contains(&id)
    }

    /// Returns whether the two ends of every edge of a face have different materials. The corners
    /// of either diagonal may then touch, or be connected if they have the same material.
    fn is_open_face(&self) -> bool {
        let own = self.materials();
        own.len() == 4 && [[0, 1], [1, 3], [3, 2], [2, 0]].iter().all(|&[a, b]| own[a] != own[b])
    }

    /// Returns whether a material has exactly two corners of a cell and they are opposite. These
    /// corners may be connected or not.
    fn is_across(&self, id: MaterialId) -> bool {
        let own = self.materials();
        let is_own = |n: usize| own[n] == id;
        own.len() == 8 && (0..8).filter(|&n| is_own(n)).count() == 2 && (0..4).any(|n| is_own(n) && is_own(7 - n))
    }

    /// Returns whether the corners leave open which materials touch at the midpoint.
    fn are_open(&self) -> bool {
        self.is_open_face() || self.materials().iter().any(|&id| self.is_across(id))
    }

    /// Returns the indicators stored near the midpoint.
    fn near(&self, materials: &Materials) -> Near {
        let [first, last] = [self.nodes[0], self.nodes[self.count - 1]];
        let middle = DVec3::from_array(std::array::from_fn(|a| 0.5 * (first[a] + last[a]) as f64));
        materials.near(materials.geometry().index_to_grid(middle))
    }

    /// Returns the corner that decides which materials touch at the midpoint. On a face, it is the
    /// first corner of the diagonal whose larger indicator is smaller, or of the first diagonal if
    /// all four indicators are equal within [`TIE`]. In a cell, it is the corner with the smallest
    /// indicator.
    fn deciding(&self, materials: &Materials) -> u8 {
        let near = self.near(materials);
        let value = |n: u8| near.value(self.materials[usize::from(n)]);
        if self.count == 4 {
            let [first, second] = [[0, 3], [1, 2]].map(|pair| pair.map(value));
            let larger = [first, second].map(|[a, b]| a.max(b));
            let smallest = first[0].min(first[1]).min(second[0]).min(second[1]);
            let is_tie = larger[0].max(larger[1]) - smallest <= TIE * materials.voxel();
            return u8::from(!is_tie && larger[1] < larger[0]);
        }
        (0..self.count as u8).min_by(|&a, &b| value(a).total_cmp(&value(b))).unwrap_or(0)
    }
}

/// The edges, faces and cells whose margins are checked, grouped by brick.
struct GridElements {
    /// Required margin, mm.
    clearance: f64,
    all: Vec<GridElement>,
    /// Bricks that store several indicators, each with the end of its range in `all`.
    bricks: Vec<(usize, usize)>,
}

impl GridElements {
    fn of(materials: &Materials, owners: &[u16], clearance: f64) -> Self {
        let geometry = materials.geometry();
        let (size, bricks) = (geometry.size, bricks_along(geometry.size));
        let of_brick = |brick: usize| {
            let known: Vec<MaterialId> = materials.known_in(brick).map(|(id, _)| id).collect();
            let first =
                [brick % bricks[0], brick / bricks[0] % bricks[1], brick / (bricks[0] * bricks[1])].map(|n| n * CELLS);
            // the last layer of nodes of a brick belongs to the next brick, except at the end of
            // the grid
            let is_last = |a: usize| first[a] + CELLS + 1 == size[a];
            let nodes: [usize; 3] = std::array::from_fn(|a| CELLS + usize::from(is_last(a)));
            let mut elements = Vec::new();
            for c in 0..nodes.iter().product() {
                let within = [c % nodes[0], c / nodes[0] % nodes[1], c / (nodes[0] * nodes[1])];
                let node: [usize; 3] = std::array::from_fn(|a| first[a] + within[a]);
                for axes in 1..8u8 {
                    if (0..3).any(|a| node[a] + usize::from(axes >> a & 1) >= size[a]) {
                        continue;
                    }
                    let element = GridElement { node: geometry.linear(node[0], node[1], node[2]), axes, deciding: 0 };
                    let corners = Corners::of(element, owners, geometry);
                    let is_open = corners.are_open();
                    if !corners.are_of_one() && (is_open || known.iter().any(|&id| !corners.has(id))) {
                        let deciding = if is_open { corners.deciding(materials) } else { 0 };
                        elements.push(GridElement { deciding, ..element });
                    }
                }
            }
            (brick, elements)
        };
        let of_many = (0..materials.fill().len()).into_par_iter().filter(|&n| materials.known_in(n).len() > 1);
        let found: Vec<(usize, Vec<GridElement>)> = of_many.map(of_brick).collect();
        let mut own = Self { clearance, all: Vec::new(), bricks: Vec::new() };
        for (brick, elements) in found {
            own.all.extend(elements);
            own.bricks.push((brick, own.all.len()));
        }
        own
    }

    /// Returns the indicators whose margin is too small at an edge, face or cell of the chosen
    /// bricks.
    fn lacking(&self, materials: &Materials, owners: &[u16], is_chosen: impl Fn(usize) -> bool + Sync) -> Vec<Lack> {
        let in_brick = |n: usize| {
            let (brick, end) = self.bricks[n];
            let start = n.checked_sub(1).map_or(0, |before| self.bricks[before].1);
            let chosen = if is_chosen(brick) { start..end } else { start..start };
            let known: Vec<MaterialId> = materials.known_in(brick).map(|(id, _)| id).collect();
            let mut lacks = Vec::new();
            for &element in &self.all[chosen] {
                lacking_at(element, self.clearance, (materials, owners), &known, &mut lacks);
            }
            lacks
        };
        (0..self.bricks.len()).into_par_iter().flat_map_iter(in_brick).collect()
    }
}

/// Finds the indicators whose margin is too small at an edge, face or cell. `known` lists the
/// materials whose indicators are stored in its brick.
fn lacking_at(
    element: GridElement,
    clearance: f64,
    (materials, owners): (&Materials, &[u16]),
    known: &[MaterialId],
    lacks: &mut Vec<Lack>,
) {
    let corners = Corners::of(element, owners, materials.geometry());
    let near = corners.near(materials);
    // effect of a unit raise at one corner on the value at the midpoint
    let share = HALF_WAY.powi(corners.count.ilog2() as i32);
    let mut keep_above = |id: MaterialId, limit: f64, is_undecided: bool| {
        let value = near.value(id);
        if value.is_finite() && value < limit + clearance {
            let not_own = (0..corners.count).filter(|&n| corners.materials[n] != id);
            let nodes: Vec<[usize; 3]> = not_own.map(|n| corners.nodes[n]).collect();
            let raise = (limit + AIM * clearance - value) / (share * nodes.len() as f64);
            lacks.push(Lack { material: id, corners: nodes, raise, is_undecided, is_lost: value < limit });
        }
    };
    let values = || corners.materials().iter().map(|&id| near.value(id));
    let largest = values().fold(f64::NEG_INFINITY, f64::max);
    let limit = if corners.count == 2 { largest } else { values().fold(f64::INFINITY, f64::min) };
    if !limit.is_finite() {
        return;
    }
    known.iter().filter(|&&id| !corners.has(id)).for_each(|&id| keep_above(id, limit, false));
    if !corners.are_open() {
        return;
    }
    let deciding = usize::from(element.deciding);
    let touching = [deciding, corners.count - 1 - deciding].map(|n| corners.materials[n]);
    let limit = touching.map(|id| near.value(id)).into_iter().fold(f64::NEG_INFINITY, f64::max);
    let smallest = corners.materials[deciding];
    let is_after = |id: MaterialId| match corners.count {
        4 => !touching.contains(&id),
        _ => id != smallest && (corners.is_across(smallest) || corners.is_across(id)),
    };
    let limit = if corners.count == 4 { limit } else { near.value(smallest) };
    known.iter().filter(|&&id| corners.has(id) && is_after(id)).for_each(|&id| keep_above(id, limit, true));
}
