//! The `sizefield` stage: computes the target edge length h from local feature size and curvature,
//! and limits its gradient.
//!
//! The method follows section 3.1 of Kim, Chen and Hansen 2012, and Meyer, Kirby and Whitaker 2007.
//! At the surface, the initial size h0 is epsilon times the local feature size, with an upper bound
//! from the curvature. h is then lowered until |grad h| <= delta.

pub mod args;
mod averages;
mod blocks;
pub mod connections;
pub mod feature;
pub mod gradation;
pub mod limits;
pub mod materials;
pub mod medial;
pub mod noise;
pub mod patch;
pub mod region;
mod report;
pub mod resize;
pub mod run;
mod scheme;
pub mod vertices;

use averages::average;
use feature::Features;
use glam::DVec3;
use gradation::NodeSet;
use isoparticles_field::sizing::SizingField;
use isoparticles_mesh::incidence::Incidence;
use isoparticles_volume::{Geometry, Image};
use rayon::prelude::*;
use region::SizedNode;

/// Number of averaging rounds that smooth the graded h along the surface. Six rounds act like a
/// Gaussian with a standard deviation of sqrt(6 / 3) = 1.4 marching-cubes edges ([`averages`]),
/// about one voxel. Particles settle poorly where h is rough. Measured with 0, 3, 6 and 12 rounds
/// (`make surface`): for label 2 of `mickey_labels`, the mean radius ratio of the triangles is
/// 0.979, 0.981, 0.982 and 0.979; for `tooth_ct` at iso value 600, it is 0.986, 0.987, 0.987 and
/// 0.988, with 57,900, 55,700, 54,300 and 52,300 vertices.
const SMOOTHING_ROUNDS: usize = 6;

/// Lower bound on h for small components, as a fraction of the minimum h. It takes effect if
/// [`MIN_PARTICLES`] would require a smaller h. With the default minimum h of 0.75 voxel, such
/// components have areas below `32 * sqrt(3) / 2 * (0.25 * 0.75)^2` = 0.97 voxel faces, which the
/// data cannot resolve.
const SMALLEST_SHARE: f64 = 0.25;

/// Minimum number of particles that h must allow on every component, unless h reaches the bound
/// [`SMALLEST_SHARE`]. It is the smallest number of vertices of a triangulated sphere in which all
/// vertices have degree 5 or 6 and no two vertices of degree 5 are adjacent (the dual of C60, the
/// smallest fullerene with isolated pentagons).
const MIN_PARTICLES: f64 = 32.0;

/// Parameters of the sizing field. All lengths are in mm.
#[derive(Clone, Debug)]
pub struct Parameters {
    /// Ratio of h0 to the local feature size.
    pub epsilon: f64,
    /// Bound on |grad h|.
    pub delta: f64,
    /// Minimum h.
    pub min_size: f64,
    /// Maximum h at the surface.
    pub max_size: f64,
    /// Maximum distance from a triangle's centre to the surface due to curvature. It limits h0 to
    /// `sqrt(6 * max_deviation * R)`, where R is the radius of curvature.
    pub max_deviation: f64,
    /// Minimum number of particles on each component of the surface.
    pub min_particles: f64,
    /// Factor by which h is multiplied before gradation, after the limits above have been applied.
    pub scale: f64,
    /// Nodes at which the user limits h, with the limits in mm. A limit may be below the minimum h.
    pub refined: Vec<SizedNode>,
}

/// Returns the edge length in mm at each sample, before gradation.
pub fn wanted_sizes(features: &Features, parameters: &Parameters) -> Vec<f64> {
    (0..features.points.len())
        .map(|i| {
            let by_feature = parameters.epsilon * features.feature_size[i];
            // the centre of an equilateral triangle of edge length h inscribed in a ball of radius
            // R lies h^2 / (6 R) below the surface
            let by_deviation = (6.0 * parameters.max_deviation / features.curvature[i].max(1e-12)).sqrt();
            let area = features.component_area.get(features.component[i] as usize).copied().unwrap_or(f64::INFINITY);
            let by_component = size_for_area(area, parameters);
            parameters.scale
                * by_feature.min(by_deviation).min(parameters.max_size).max(parameters.min_size).min(by_component)
        })
        .collect()
}

/// Returns the edge length in mm at which a component of `area` mm^2 has the minimum number of
/// particles, but at least [`SMALLEST_SHARE`] times the minimum h.
fn size_for_area(area: f64, parameters: &Parameters) -> f64 {
    let size = (2.0 * area / (3f64.sqrt() * parameters.min_particles)).sqrt();
    size.max(SMALLEST_SHARE * parameters.min_size)
}

/// Returns the number of sampled components whose minimum number of particles lowers h below
/// `min_size`, and the smallest h on them in mm, multiplied by `scale`. Returns `None` if there are
/// no such components.
pub fn lowered(features: &Features, parameters: &Parameters) -> Option<(usize, f64)> {
    let mut is_sampled = vec![false; features.component_area.len()];
    for &component in &features.component {
        if let Some(sampled) = is_sampled.get_mut(component as usize) {
            *sampled = true;
        }
    }
    let areas = features.component_area.iter().zip(is_sampled).filter(|(_, is_sampled)| *is_sampled);
    let sizes = areas.map(|(&area, _)| size_for_area(area, parameters));
    let low: Vec<f64> = sizes.filter(|&h| h < parameters.min_size).collect();
    let smallest = low.iter().copied().reduce(f64::min)?;
    Some((low.len(), parameters.scale * smallest))
}

/// Returns the sizing field on the grid of the distance field. Grades the sizes of the samples,
/// smooths them along the surface, and grades them into the volume.
pub fn size_field(distance: &Image<f32>, features: &Features, parameters: &Parameters) -> SizingField {
    let wanted = wanted_sizes(features, parameters);
    let samples = Samples { geometry: &distance.geometry, points: &features.points, triangles: &features.triangles };
    graded_field(&samples, &wanted, parameters, &[])
}

/// A triangulated surface and the grid of its sizing field.
pub(crate) struct Samples<'a> {
    /// The grid.
    pub(crate) geometry: &'a Geometry,
    /// Positions in mm in the grid frame.
    pub(crate) points: &'a [DVec3],
    /// Triangles between the positions.
    pub(crate) triangles: &'a [[u32; 3]],
}

/// Returns the sizing field for the sizes `wanted` at the samples. Grades the sizes, smooths them
/// along the surface, and grades them into the volume. `most` contains an upper bound for the
/// smoothed size at each sample, or is empty if there are no bounds.
pub(crate) fn graded_field(
    samples: &Samples<'_>,
    wanted: &[f64],
    parameters: &Parameters,
    most: &[f64],
) -> SizingField {
    let mut near = NodeSet::new(samples.geometry.voxel_count());
    samples.points.iter().flat_map(|&p| cell_nodes(samples.geometry, p)).for_each(|node| near.insert(node));
    let graded = spread(samples, wanted, parameters, Some(&near));
    let mut smooth: Vec<f64> = samples.points.par_iter().map(|&p| graded.at(p)).collect();
    drop(graded);
    average(&Incidence::new(samples.triangles, samples.points.len()), &mut smooth, 0.0, SMOOTHING_ROUNDS);
    smooth.iter_mut().zip(most).for_each(|(size, most)| *size = size.min(*most));
    spread(samples, &smooth, parameters, None)
}

/// For each triangle, limits h at the nodes of the cell around the triangle's centre to the minimum
/// size at the triangle's corners. The trilinear h in this cell is then at most this size. Then
/// limits the gradient of h at all nodes, or at least at those in `asked`.
fn spread(samples: &Samples<'_>, sizes: &[f64], parameters: &Parameters, asked: Option<&NodeSet>) -> SizingField {
    let geometry = samples.geometry;
    let mut h = Image::filled(geometry.clone(), f32::INFINITY);
    for t in samples.triangles {
        let size = t.iter().map(|&v| sizes[v as usize]).fold(f64::INFINITY, f64::min) as f32;
        let centre = t.iter().map(|&v| samples.points[v as usize]).sum::<DVec3>() / 3.0;
        for node in cell_nodes(geometry, centre) {
            h.data[node] = h.data[node].min(size);
        }
    }
    for &(node, size) in &parameters.refined {
        h.data[node] = h.data[node].min(size as f32);
    }
    gradation::limit_gradient(&mut h, parameters.delta, asked);
    SizingField::new(h)
}

/// Returns the nodes of the cell that contains a position, or of the nearest cell for a position
/// outside the grid.
pub(crate) fn cell_nodes(geometry: &Geometry, p: DVec3) -> [usize; 8] {
    let index = geometry.grid_to_index(p);
    let base: [usize; 3] =
        std::array::from_fn(|a| (index[a].max(0.0) as usize).min(geometry.size[a].saturating_sub(2)));
    std::array::from_fn(|corner| {
        let at: [usize; 3] = std::array::from_fn(|a| (base[a] + (corner >> a & 1)).min(geometry.size[a] - 1));
        geometry.linear(at[0], at[1], at[2])
    })
}

/// Returns a constant sizing field.
pub fn uniform_field(distance: &Image<f32>, size: f64) -> SizingField {
    SizingField::new(Image::filled(distance.geometry.clone(), size as f32))
}
