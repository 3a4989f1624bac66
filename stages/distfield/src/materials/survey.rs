//! Measures the indicators: the material of every node and its distance from the nearest interface,
//! the volumes of materials, the areas of interfaces, the numbers of junctions, and the voxel
//! centres that changed material.

use super::grid::LabelGrid;
use crate::Border;
use glam::DVec3;
use isoparticles_field::enclosed::enclosed_volumes;
use isoparticles_field::marching_cubes::marching_cubes;
use isoparticles_field::materials::{Bound, Indicators, KNOWN_VOXELS, MaterialId};
use isoparticles_stage::error::Result;
use isoparticles_stage::monitor::Monitor;
use isoparticles_volume::{Geometry, Image, VoxelBox};
use rayon::prelude::*;
use serde::Serialize;
use std::collections::BTreeMap;
use std::ops::Range;

/// The interface between two materials.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Interface {
    /// The materials, with the lower number first.
    pub materials: [MaterialId; 2],
    /// Area of the interface, mm^2.
    pub area: f64,
    /// Number of grid edges that the interface crosses.
    pub crossings: usize,
}

/// Numbers of junctions, where three or more materials meet, counted from the materials of the
/// nodes. Junction curves cross grid faces; junction points lie in grid cells.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct JunctionCounts {
    /// Number of grid faces with three materials at the corners.
    pub edges_of_three: usize,
    /// Number of grid faces with four materials at the corners.
    pub edges_of_four: usize,
    /// Number of grid cells with four or more materials at the corners.
    pub corners: usize,
}

/// The result of a survey.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Survey {
    /// Material number of each node, x fastest.
    pub material: Vec<u16>,
    /// Half the difference of the two smallest indicators at each node, in mm, at most
    /// [`distance_limit`].
    pub interface_distance: Vec<f32>,
    /// For each material, the number of its voxel centres where another indicator is smaller.
    pub changed: Vec<usize>,
    /// Volume of the voxels of each material, mm^3, as far as the planes leave them.
    pub voxel_volumes: Vec<f64>,
    /// Volume of each material, mm^3. The outside includes only space within the volume.
    pub volumes: Vec<f64>,
    /// The pairs of materials that touch.
    pub interfaces: Vec<Interface>,
    /// Numbers of junctions, where more than two materials meet.
    pub junctions: JunctionCounts,
}

/// Returns the distance (mm) from an interface within which both of its indicators are known.
pub fn distance_limit(geometry: &Geometry) -> f64 {
    KNOWN_VOXELS as f64 * geometry.min_spacing()
}

/// Sums over the nodes of a slice.
#[derive(Default)]
struct Sums {
    /// Area (mm^2) and number of crossings of each pair of materials.
    pairs: BTreeMap<[MaterialId; 2], (f64, usize)>,
    junctions: JunctionCounts,
}

/// Surveys the nodes of the padded grid and the edges between them.
///
/// The area of an interface is a sum over the grid edges that it crosses. Each edge contributes the
/// area of its dual face times |n_a|, where n_a is the component of the unit normal along the edge.
/// For axis a, the dual faces of the edges crossed by an interface element dA have a total area of
/// |n_a| dA. The element therefore contributes n_a^2 dA, and the squares of n_a sum to one. The
/// volume of a material is the volume enclosed by the surface where its indicator equals the
/// smallest of all other indicators.
///
/// `materials` is the number of materials, including the spaces beyond the planes `bounds` at which
/// they end.
///
/// # Errors
/// If the run is interrupted.
pub fn survey(
    indicators: &impl Indicators,
    geometry: &Geometry,
    grid: &LabelGrid,
    materials: usize,
    bounds: &[Bound],
    monitor: &dyn Monitor,
) -> Result<Survey> {
    // beyond an open border, interfaces continue straight but do not belong to the volume
    let counted: [Range<usize>; 3] = std::array::from_fn(|a| match grid.border {
        Border::Cap => 0..geometry.size[a],
        Border::Open => grid.margin..geometry.size[a] - grid.margin,
    });
    let (material, distance, changed) = survey_nodes(indicators, geometry, grid, &counted);
    monitor.check()?;
    let slices = counted[2].clone().into_par_iter();
    let sums: Vec<Sums> = slices.map(|k| slice_sums(indicators, geometry, &material, &counted, k)).collect();
    monitor.check()?;
    let mut survey = Survey { changed: vec![0; materials], volumes: vec![0.0; materials], ..Survey::default() };
    survey.voxel_volumes = voxel_volumes(grid, bounds, materials);
    for (id, count) in changed.into_iter().flatten() {
        survey.changed[id.index()] += count;
    }
    let voxel = geometry.spacing.element_product();
    let mut pairs: BTreeMap<[MaterialId; 2], (f64, usize)> = BTreeMap::new();
    for slice in sums {
        for (pair, (area, crossings)) in slice.pairs {
            let sum = pairs.entry(pair).or_default();
            *sum = (sum.0 + area, sum.1 + crossings);
        }
        let (all, own) = (&mut survey.junctions, slice.junctions);
        all.edges_of_three += own.edges_of_three;
        all.edges_of_four += own.edges_of_four;
        all.corners += own.corners;
    }
    let extents = node_extents(&material, geometry.size, &counted, materials);
    for (id, extent) in extents.into_iter().enumerate().skip(1) {
        monitor.check()?;
        if let Some(extent) = extent {
            let near = NodesNear { geometry, material: &material, distance: &distance, counted: &counted };
            survey.volumes[id] = near.volume(indicators, MaterialId(id as u16), extent);
        }
    }
    survey.volumes[0] = grid.geometry.voxel_count() as f64 * voxel - survey.volumes[1..].iter().sum::<f64>();
    let told = |(materials, (area, crossings))| Interface { materials, area, crossings };
    survey.interfaces = pairs.into_iter().map(told).collect();
    (survey.material, survey.interface_distance) = (material, distance);
    Ok(survey)
}

/// Returns the volume of the voxels of each material (mm^3), as far as the planes leave them.
pub(super) fn voxel_volumes(grid: &LabelGrid, bounds: &[Bound], materials: usize) -> Vec<f64> {
    let Geometry { size: [nx, ny, _], spacing, .. } = grid.geometry;
    let mut fractions = vec![0.0; materials];
    for (row, numbers) in grid.numbers.chunks(nx).enumerate() {
        for (i, &number) in numbers.iter().enumerate() {
            let voxel = DVec3::from_array([i, row % ny, row / ny].map(|n| (n + grid.margin) as f64));
            fractions[usize::from(number)] += fraction_left(bounds, voxel * spacing, spacing);
        }
    }
    fractions.into_iter().map(|fraction| fraction * spacing.element_product()).collect()
}

/// Returns the fraction of a voxel that the planes leave. The fraction for one plane is exact if
/// the normal is an axis of the grid; otherwise its errors cancel on average. The fractions for
/// several planes are multiplied, which is exact if these planes are perpendicular.
fn fraction_left(bounds: &[Bound], centre: DVec3, spacing: DVec3) -> f64 {
    let left = |bound: &Bound| (0.5 - bound.distance(centre) / bound.normal.abs().dot(spacing)).clamp(0.0, 1.0);
    bounds.iter().map(left).product()
}

/// Returns the material of each node and the distance (mm) from the nearest interface, at most
/// [`distance_limit`]. Also returns, for each slice, the number of counted nodes of each material
/// where another material has a smaller indicator.
fn survey_nodes(
    indicators: &impl Indicators,
    geometry: &Geometry,
    grid: &LabelGrid,
    counted: &[Range<usize>; 3],
) -> (Vec<u16>, Vec<f32>, Vec<BTreeMap<MaterialId, usize>>) {
    let [nx, ny, _] = geometry.size;
    let plane = nx * ny;
    let limit = distance_limit(geometry) as f32;
    let (mut material, mut distance) = (vec![0u16; geometry.voxel_count()], vec![0.0f32; geometry.voxel_count()]);
    let counted_at = |node: [usize; 3]| (0..3).all(|a| counted[a].contains(&node[a]));
    let position = |i: usize, j: usize, k: usize| geometry.index_to_grid(DVec3::new(i as f64, j as f64, k as f64));
    let slices = material.par_chunks_mut(plane).zip(distance.par_chunks_mut(plane)).enumerate();
    let changed: Vec<BTreeMap<MaterialId, usize>> = slices
        .map(|(k, (material, distance))| {
            let mut changed = BTreeMap::new();
            for (n, (material, distance)) in material.iter_mut().zip(distance).enumerate() {
                let (i, j) = (n % nx, n / nx);
                let near = indicators.near(position(i, j, k));
                let own = near.first().unwrap_or(MaterialId::OUTSIDE);
                *material = own.0;
                *distance = (near.interface_distance() as f32).min(limit);
                let label = grid.at([i, j, k]);
                let is_beyond = indicators.is_beyond(own);
                if label != own && !is_beyond && counted_at([i, j, k]) {
                    *changed.entry(label).or_default() += 1;
                }
            }
            changed
        })
        .collect();
    (material, distance, changed)
}

/// Returns the bounding box of the counted nodes of each material, or `None` for a material without
/// counted nodes.
fn node_extents(
    material: &[u16],
    [nx, ny, _]: [usize; 3],
    counted: &[Range<usize>; 3],
    materials: usize,
) -> Vec<Option<VoxelBox>> {
    let mut extents: Vec<Option<VoxelBox>> = vec![None; materials];
    for (k, j) in counted[2].clone().flat_map(|k| counted[1].clone().map(move |j| (k, j))) {
        let mut first = counted[0].start;
        let row = &material[(k * ny + j) * nx..][counted[0].clone()];
        for run in row.chunk_by(|a, b| a == b) {
            let own = VoxelBox { low: [first, j, k], high: [first + run.len() - 1, j, k] };
            let extent = &mut extents[usize::from(run[0])];
            *extent = Some(extent.map_or(own, |extent| extent.around(own)));
            first += run.len();
        }
    }
    extents
}

/// Survey data of the nodes of the padded grid.
struct NodesNear<'a> {
    geometry: &'a Geometry,
    material: &'a [u16],
    /// Half the difference of the two smallest indicators, mm.
    distance: &'a [f32],
    /// Range of the counted nodes along each axis.
    counted: &'a [Range<usize>; 3],
}

impl NodesNear<'_> {
    /// Returns the volume (mm^3) of a material whose nodes lie in `extent`. The material is closed
    /// half a voxel beyond the counted nodes.
    fn volume(&self, indicators: &impl Indicators, id: MaterialId, extent: VoxelBox) -> f64 {
        // add one node on each face, which may lie beyond the grid
        let size = extent.size().map(|n| n + 2);
        let first = DVec3::from_array(extent.low.map(|n| n as f64 - 1.0));
        let nodes = Geometry { size, ..self.geometry.clone() };
        let value = |n: usize| {
            let at = [n % size[0], n / size[0] % size[1], n / (size[0] * size[1])];
            let at: [usize; 3] = std::array::from_fn(|a| (extent.low[a] + at[a]).wrapping_sub(1));
            let nearest: [usize; 3] = std::array::from_fn(|a| {
                let Range { start, end } = self.counted[a];
                if at[a] == usize::MAX { start } else { at[a].clamp(start, end - 1) }
            });
            let node = self.geometry.linear(nearest[0], nearest[1], nearest[2]);
            let is_own = nearest == at && self.material[node] == id.0;
            if is_own { -self.distance[node] } else { self.distance[node] }
        };
        let data = (0..nodes.voxel_count()).into_par_iter().map(value).collect();
        let mesh = marching_cubes(&Image { geometry: nodes, data }, 0.0);
        let border = |end: bool| {
            DVec3::from_array(std::array::from_fn(|a| {
                if end { self.counted[a].end as f64 - 0.5 } else { self.counted[a].start as f64 - 0.5 }
            })) * self.geometry.spacing
        };
        let (low, high) = (border(false), border(true));
        let first = first * self.geometry.spacing;
        let value_gradient = |p: DVec3| {
            let p = p + first;
            let near = indicators.near(p);
            let other = near.entries().iter().map(|(other, _)| *other).find(|other| *other != id);
            let own =
                other.map_or((f64::NEG_INFINITY, DVec3::ZERO), |other| indicators.difference_gradient(id, other, p));
            (0..3)
                .flat_map(|a| [(low[a] - p[a], -DVec3::AXES[a]), (p[a] - high[a], DVec3::AXES[a])])
                .fold(own, |most, face| if face.0 > most.0 { face } else { most })
        };
        enclosed_volumes(&mesh, self.geometry.spacing.max_element(), value_gradient).iter().sum()
    }
}

/// Computes the sums over the counted nodes of slice `k` and the edges to the next slice.
fn slice_sums(
    indicators: &impl Indicators,
    geometry: &Geometry,
    material: &[u16],
    counted: &[Range<usize>; 3],
    k: usize,
) -> Sums {
    let [nx, ny, _] = geometry.size;
    let stride = [1, nx, nx * ny];
    let mut sums = Sums::default();
    for (i, j) in counted[1].clone().flat_map(|j| counted[0].clone().map(move |i| (i, j))) {
        let (at, n) = ([i, j, k], (k * ny + j) * nx + i);
        let has_next: [bool; 3] = std::array::from_fn(|a| at[a] + 1 < counted[a].end);
        for axis in 0..3 {
            let ends = [n, n + if has_next[axis] { stride[axis] } else { 0 }].map(|node| MaterialId(material[node]));
            if indicators.are_separate(&ends) {
                sums.add_crossing(indicators, geometry, at, axis, ends);
            }
            let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
            if has_next[u] && has_next[v] {
                sums.add_face([0, stride[u], stride[v], stride[u] + stride[v]].map(|step| material[n + step]));
            }
        }
        if has_next == [true; 3] {
            let corner = |c: usize| material[n + (c & 1) + (c >> 1 & 1) * nx + (c >> 2) * nx * ny];
            sums.junctions.corners += usize::from(distinct(std::array::from_fn::<u16, 8, _>(corner)) >= 4);
        }
    }
    sums
}

/// Returns the number of distinct values.
fn distinct<const N: usize>(mut numbers: [u16; N]) -> usize {
    if numbers.iter().all(|number| *number == numbers[0]) {
        return 1;
    }
    numbers.sort_unstable();
    1 + numbers.windows(2).filter(|pair| pair[0] != pair[1]).count()
}

impl Sums {
    /// Counts a grid face by the number of materials at its corners.
    fn add_face(&mut self, corners: [u16; 4]) {
        match distinct(corners) {
            3 => self.junctions.edges_of_three += 1,
            4 => self.junctions.edges_of_four += 1,
            _ => {}
        }
    }

    /// Adds the interface crossing between a node and the next node along an axis.
    fn add_crossing(
        &mut self,
        indicators: &impl Indicators,
        geometry: &Geometry,
        at: [usize; 3],
        axis: usize,
        [i, j]: [MaterialId; 2],
    ) {
        let step = DVec3::AXES[axis] * geometry.spacing[axis];
        let start = geometry.index_to_grid(DVec3::from_array(at.map(|n| n as f64)));
        let value = |p: DVec3| indicators.difference_gradient(i, j, p).0;
        let (low, high) = (value(start), value(start + step));
        // position of the zero of the linearly interpolated difference, or the midpoint if an
        // indicator is not known
        let share = if low < 0.0 && high > 0.0 && (high - low).is_finite() { low / (low - high) } else { 0.5 };
        let (_, gradient) = indicators.difference_gradient(i, j, start + step * share);
        let face = geometry.spacing.element_product() / geometry.spacing[axis];
        let weight = gradient.try_normalize().map_or(1.0 / 3f64.sqrt(), |normal| normal[axis].abs());
        let pair = self.pairs.entry([i.min(j), i.max(j)]).or_default();
        *pair = (pair.0 + face * weight, pair.1 + 1);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fractions_of_voxels_sum_to_the_volume_that_a_plane_leaves() {
        let spacing = DVec3::new(1.0, 0.5, 2.0);
        let bound = |normal: DVec3, at: f64| {
            let normal = normal.normalize();
            [Bound { name: String::new(), point: DVec3::new(10.0, 5.0, 20.0) + at * normal, normal }]
        };
        let sum = |bounds: &[Bound]| -> f64 {
            let centres = (0..8000).map(|n| DVec3::new((n % 20) as f64, (n / 20 % 20) as f64, (n / 400) as f64) + 0.5);
            centres.map(|at| fraction_left(bounds, at * spacing, spacing)).sum()
        };
        assert!((sum(&bound(DVec3::X, 0.3)) - 8000.0 * 10.3 / 20.0).abs() < 1e-9);
        assert!((sum(&bound(DVec3::new(1.0, 2.0, 0.5), 0.0)) / 4000.0 - 1.0).abs() < 1e-3);
    }
}
