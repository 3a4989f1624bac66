//! Measures the curvature of material interfaces, and the thickness of the materials on both sides.

use crate::averages::average;
use crate::cell_nodes;
use crate::feature::{CURVATURE_ROUNDS, SHARP};
use crate::gradation::limit_gradient;
use glam::{DMat3, DVec3, Mat3};
use isoparticles_field::curvature::{curvature_tensor, largest_curvature};
use isoparticles_field::materials::complex::{Complex, Vertex};
use isoparticles_field::materials::{Indicators, MaterialId, Stratum};
use isoparticles_field::sizing::trilinear;
use isoparticles_mesh::incidence::Incidence;
use isoparticles_mesh::kd_tree::KdTree;
use isoparticles_volume::{Geometry, Image};
use rayon::prelude::*;
use std::collections::BTreeMap;
use std::ops::{Add, Mul};

/// Minimum clearance in voxels at which the curvature of an interface is used. Near a third
/// material, the indicators have kinks, which the spline rounds. At a kink, the second derivative
/// of the spline is 1.73 times the change in slope divided by the voxel size. It decays by a factor
/// of 2 - sqrt(3) = 0.27 per voxel, so the factor 1.73 becomes 0.46 at a distance of one voxel.
const CURVATURE_CLEARANCE: f64 = 1.0;

/// Maximum distance to a junction curve, as a multiple of the thickness of a layer, at which the
/// layer is treated as a wedge if its two interfaces meet at this curve. Such wedges have angles
/// above atan(1/2) = 27 degrees and do not limit h. With 1, 2 and 4, `make sizefield MATERIALS=all`
/// predicts 1,063,700, 1,063,100 and 1,062,700 particles for `frog_tissue_labels`.
const WEDGE_LENGTH: f64 = 2.0;

/// Minimum step, in voxels, of a ray across a material; also the length of its first step.
/// Thicknesses are overestimated by at most about this step. With the defaults of every quality
/// level, h depends only on thicknesses of at least 3 voxels (`2 * minimum h / epsilon`), so the
/// error of h is at most 3 %.
const LEAST_STEP: f64 = 0.1;

/// Length of a step as a fraction of the estimated distance to the nearest interface. A step
/// crosses no interface if the estimate is less than 1 / 0.8 = 1.25 times the true distance. The
/// distances at grid nodes are less than 6 % too large (test
/// `steady_state_is_a_cone_of_slope_delta`); the indicators give distances to first order.
const STEP_SHARE: f64 = 0.8;

/// Measurements at the vertices of a complex.
#[derive(Clone, Debug, Default)]
pub(super) struct StrataFeatures {
    /// Maximum magnitude of the principal curvatures in 1/mm, averaged along the interface. Before
    /// averaging, it is set to 0 near a third material.
    pub(super) curvature: Vec<f64>,
    /// Half the thickness in mm of the thinner adjacent material. Where the curvature is high, at
    /// most the radius of curvature. Infinite at junctions, and where the thickness exceeds the
    /// search limit.
    pub(super) feature_size: Vec<f64>,
}

/// A symmetric tensor, in single precision to save memory: a complex can have millions of them.
#[derive(Clone, Copy)]
struct Tensor(Mat3);

impl Add for Tensor {
    type Output = Self;

    fn add(self, other: Self) -> Self {
        Self(self.0 + other.0)
    }
}

impl Mul<f64> for Tensor {
    type Output = Self;

    fn mul(self, factor: f64) -> Self {
        Self(self.0 * factor as f32)
    }
}

/// Measures the interfaces of a complex. Thicknesses above `largest` (mm) are reported as infinite.
pub(super) fn measure<I: Indicators>(
    indicators: &I,
    geometry: &Geometry,
    complex: &Complex,
    largest: f64,
) -> StrataFeatures {
    let voxel = indicators.voxel();
    let ways = Ways::new(indicators, geometry, complex, largest);
    let measured: Vec<(DVec3, Tensor, f64)> = complex
        .vertices
        .par_iter()
        .map(|vertex| {
            let Some((low, high)) = interface(vertex) else {
                return (DVec3::ZERO, Tensor(Mat3::ZERO), f64::INFINITY);
            };
            let jet = indicators.difference(high, low, vertex.position);
            let Some(normal) = jet.gradient.try_normalize().filter(|normal| normal.is_finite()) else {
                return (DVec3::ZERO, Tensor(Mat3::ZERO), f64::INFINITY);
            };
            let is_clear = indicators.clearance(vertex.position, &[low, high]) >= CURVATURE_CLEARANCE * voxel;
            let tensor = if is_clear { curvature_tensor(&jet) } else { DMat3::ZERO };
            let sharp = largest_curvature(&tensor, normal);
            let thin = ways.thinner(vertex.position, normal, (low, high));
            let size = if sharp * SHARP * voxel > 1.0 { (1.0 / sharp).min(0.5 * thin) } else { 0.5 * thin };
            (normal, Tensor(tensor.as_mat3()), size)
        })
        .collect();
    let feature_size = measured.iter().map(|own| own.2).collect();
    let normals: Vec<DVec3> = measured.iter().map(|own| own.0).collect();
    let mut tensors: Vec<Tensor> = measured.into_iter().map(|own| own.1).collect();
    let triangles: Vec<[u32; 3]> = complex.triangles.iter().map(|triangle| triangle.corners).collect();
    average(&Incidence::new(&triangles, normals.len()), &mut tensors, Tensor(Mat3::ZERO), CURVATURE_ROUNDS);
    let largest = |(tensor, &normal): (&Tensor, &DVec3)| {
        if normal == DVec3::ZERO { 0.0 } else { largest_curvature(&tensor.0.as_dmat3(), normal) }
    };
    let curvature = tensors.par_iter().zip(&normals).map(largest).collect();
    StrataFeatures { curvature, feature_size }
}

/// Returns the two materials of a vertex on an interface, or `None` for other vertices.
fn interface(vertex: &Vertex) -> Option<(MaterialId, MaterialId)> {
    match *vertex.stratum.materials() {
        [low, high] => Some((low, high)),
        _ => None,
    }
}

/// Marches rays across the materials, from one interface to the next.
struct Ways<'a, I> {
    indicators: &'a I,
    /// Estimated distance to the nearest interface, mm ([`free_distances`]).
    free: Image<f32>,
    /// Vertices of each junction curve.
    curves: BTreeMap<Stratum, KdTree>,
    largest: f64,
}

impl<'a, I: Indicators> Ways<'a, I> {
    fn new(indicators: &'a I, geometry: &Geometry, complex: &Complex, largest: f64) -> Self {
        let mut points: BTreeMap<Stratum, Vec<DVec3>> = BTreeMap::new();
        for chain in &complex.chains {
            points.entry(chain.curve).or_default().extend(complex.line(chain));
        }
        let curves = points.into_iter().map(|(curve, points)| (curve, KdTree::new(&points))).collect();
        Self { indicators, free: free_distances(geometry, complex), curves, largest }
    }

    /// Returns the thickness (mm) of the thinner of the two materials at a point of an interface.
    /// Rays follow the normal in both directions; the normal points from `high` to `low`. A
    /// thickness is infinite if it exceeds the limit, if the ray leaves the materials through a
    /// plane at which they end, or if it ends at an interface that meets this interface nearby.
    fn thinner(&self, place: DVec3, normal: DVec3, (low, high): (MaterialId, MaterialId)) -> f64 {
        let sides = [(normal, low, high), (-normal, high, low)];
        let thickness = |(way, across, behind): (DVec3, MaterialId, MaterialId)| {
            let (length, hit) = self.way_across(place, way, across).unwrap_or((f64::INFINITY, behind));
            let curve = Stratum::new(&[across, behind, hit]).and_then(|curve| self.curves.get(&curve));
            let meets = |curve: &KdTree| curve.nearest_within(place, WEDGE_LENGTH * length).is_some();
            if length.is_finite() && curve.is_some_and(meets) { f64::INFINITY } else { length }
        };
        sides.into_iter().map(thickness).fold(f64::INFINITY, f64::min)
    }

    /// Marches a ray across the material `across`. Returns the length of the ray in mm and the
    /// material at its end, or `None` if the ray exceeds the limit or leaves the grid.
    fn way_across(&self, place: DVec3, way: DVec3, across: MaterialId) -> Option<(f64, MaterialId)> {
        let voxel = self.indicators.voxel();
        let corner = self.free.geometry.upper_corner();
        let mut length = LEAST_STEP * voxel;
        while length < self.largest {
            let at = place + way * length;
            if at.cmplt(DVec3::ZERO).any() || at.cmpgt(corner).any() {
                return None;
            }
            let near = self.indicators.near(at);
            let own = near.first().unwrap_or(MaterialId::OUTSIDE);
            if own != across {
                return self.indicators.are_separate(&[own, across]).then_some((length, own));
            }
            let known = Some(near.interface_distance()).filter(|distance| distance.is_finite()).unwrap_or(0.0);
            length += (STEP_SHARE * known.max(trilinear(&self.free, at))).max(LEAST_STEP * voxel);
        }
        None
    }
}

/// Returns the estimated distance in mm from each node to the nearest interface. It is zero at the
/// nodes of all cells that contain a vertex of the complex.
fn free_distances(geometry: &Geometry, complex: &Complex) -> Image<f32> {
    let mut free = Image::filled(geometry.clone(), f32::INFINITY);
    for vertex in &complex.vertices {
        cell_nodes(geometry, vertex.position).into_iter().for_each(|node| free.data[node] = 0.0);
    }
    limit_gradient(&mut free, 1.0, None);
    free
}
