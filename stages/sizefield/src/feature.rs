//! Samples the surface densely and measures the local feature size and curvature at the samples.
//! Also determines the component of each sample.
//!
//! Local feature size is the distance to the medial axis (Amenta and Bern 1999). The
//! epsilon-sampling of Meyer, Kirby and Whitaker 2007 (reference 15 of the paper) is based on it.

use crate::averages::average;
use crate::connections::Connections;
use crate::medial::{Surface, medial_points};
use crate::noise::Smoothed;
use crate::patch::{Patch, Samples};
use glam::{DMat3, DVec3};
use isoparticles_field::curvature::{curvature_tensor, largest_curvature};
use isoparticles_field::marching_cubes::marching_cubes;
use isoparticles_field::spline::CubicSpline;
use isoparticles_field::topology::{Component, FieldComponents};
use isoparticles_mesh::components::NO_COMPONENT;
use isoparticles_mesh::incidence::Incidence;
use isoparticles_mesh::kd_tree::KdTree;
use isoparticles_volume::Image;
use rayon::prelude::*;

/// Number of averaging rounds that remove ripple from the curvature. A spline through samples of a
/// steep intensity edge rings, and the ringing can double the curvature: for a ball of radius R =
/// 19 voxels with an edge two voxels wide, the maximum curvature is 2.1 / R without averaging and
/// 1.25 / R with it.
pub(crate) const CURVATURE_ROUNDS: usize = 8;

/// Maximum radius of curvature, in voxels, that limits the feature size. At tips this sharp,
/// pruning the end of the medial axis causes larger errors than ripple in the curvature. With 2.5,
/// the test `ellipsoid_tip_is_bounded_by_its_curvature` fails. With 10, the minimum feature size of
/// a noisy torus with a tube radius of 8 voxels falls from 7.1 to 6.6 voxels.
pub(crate) const SHARP: f64 = 5.0;

/// Maximum depth, in voxels, to which samples may lie inside a medial ball. At 0, ripple next to
/// the touching point would shrink balls to nothing. Larger values reduce the feature size: on a
/// ball, 0.03 reduces it by 2.5 %.
const BLUR: f64 = 0.01;

/// Maximum depth to which samples of a noisy surface may lie inside a medial ball, as a fraction of
/// the height of the noise. It allows for the noise that remains in the patches. On a noisy ball of
/// radius 19 voxels, with the pruning of balls under bumps disabled, the 5th percentile of the
/// feature size is 7.5 voxels at 0.3, and 18 voxels at 0.6 and 1.
const LEFT_OVER: f64 = 0.6;

/// Maximum number of leaves that one nearest-point query visits in the k-d tree of medial points.
/// The limit saves time on a ball, whose medial points cluster near the centre, at nearly equal
/// distances from each sample. A limit of 100 and no limit give the same feature sizes for balls,
/// tori, an ellipsoid and a slab.
const MOST_LEAVES: usize = 400;

/// Maximum distance, in voxels, from a marching-cubes vertex to F = 0. F changes sign on the cell
/// edge that contains the vertex, so the distance along this edge is less than one voxel. The limit
/// includes a margin.
const MAX_PROJECTION: f64 = 1.5;

/// Tolerance of the projection, in voxels. It is small compared with [`BLUR`].
const PROJECTION_TOLERANCE: f64 = 1e-6;

/// Interpretation of small bumps on the surface.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Bumps {
    /// In a scalar volume, bumps may be noise. Detected noise is not treated as shape.
    MayBeNoise,
    /// Bumps are part of the shape. In a label map, every bump contains a voxel centre.
    AreShape,
}

/// Purpose of the measurement.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Purpose {
    /// Finding where a constant h is too large. This needs only feature sizes.
    OneSize,
    /// Choosing a size for each sample. This also needs curvature and components.
    Grading,
}

/// Samples of F = 0 with their measurements.
#[derive(Clone, Debug)]
pub struct Features {
    /// Positions on F = 0, in mm in the grid frame.
    pub points: Vec<DVec3>,
    /// Unit normals, outward.
    pub normals: Vec<DVec3>,
    /// Maximum magnitude of the principal curvatures in 1/mm. On noisy parts, it is measured on the
    /// denoised surface. Empty for [`Purpose::OneSize`].
    pub curvature: Vec<f64>,
    /// Distance in mm to the medial axis inside or outside the object. On noisy parts, it is
    /// measured from the denoised surface. Where the curvature is high, it is at most the radius of
    /// curvature.
    pub feature_size: Vec<f64>,
    /// Root mean square height in mm of the noise that is not treated as shape.
    pub noise: Vec<f64>,
    /// Triangles between the samples, from marching cubes with projected vertices.
    pub triangles: Vec<[u32; 3]>,
    /// Component of F = 0 that contains each sample; [`NO_COMPONENT`] if it cannot be determined.
    /// Empty for [`Purpose::OneSize`].
    pub component: Vec<u32>,
    /// Area of each component in mm^2. For [`Purpose::OneSize`], it is the estimate
    /// [`Component::area`], which is accurate to first order in the cell size.
    pub component_area: Vec<f64>,
}

impl Features {
    /// Samples F = 0 at the projected vertices of marching cubes and measures the samples. Feature
    /// sizes are limited to `largest` (mm). The result is empty if there is no surface.
    pub fn new(
        image: &Image<f32>,
        surface: &CubicSpline,
        components: &FieldComponents,
        largest: f64,
        (bumps, purpose): (Bumps, Purpose),
    ) -> Self {
        let mesh = marching_cubes(image, 0.0);
        let spacing = image.geometry.mean_spacing();
        let (points, normals, tensors) = projected(&mesh.vertices, surface, spacing);
        let incidence = Incidence::new(&mesh.triangles, points.len());
        let smoothed = match bumps {
            Bumps::AreShape => Smoothed::none(points.len()),
            Bumps::MayBeNoise => {
                let connections = Connections::new(points.len(), &mesh.triangles);
                let samples = Samples { points: &points, normals: &normals, connections: &connections };
                Smoothed::new(&samples, &incidence, spacing)
            }
        };
        let sharp = sharp_curvature(&smoothed, &tensors, &normals);
        let curvature = match purpose {
            Purpose::OneSize => {
                drop(tensors);
                Vec::new()
            }
            Purpose::Grading => averaged_curvature(tensors, &normals, &smoothed.patches, &incidence),
        };
        drop(incidence);
        let feature_size = feature_sizes(&points, &normals, &sharp, &smoothed, image, largest);
        let (component, component_area) = match purpose {
            Purpose::OneSize => (Vec::new(), components.all().iter().map(|component| component.area).collect()),
            Purpose::Grading => {
                let at = |(&p, &n)| components.at(surface, p, n).unwrap_or(NO_COMPONENT);
                let component: Vec<u32> = points.par_iter().zip(&normals).map(at).collect();
                let areas = component_areas(&points, &mesh.triangles, &component, components.all());
                (component, areas)
            }
        };
        let (noise, triangles) = (smoothed.noise, mesh.triangles);
        Self { points, normals, curvature, feature_size, noise, triangles, component, component_area }
    }
}

/// Projects points onto F = 0. Returns the projected points, the unit normals and the curvature
/// tensors of F. Points that cannot be projected stay in place.
fn projected(vertices: &[DVec3], surface: &CubicSpline, spacing: f64) -> (Vec<DVec3>, Vec<DVec3>, Vec<DMat3>) {
    let measure = |&v: &DVec3| {
        let p = surface.project(v, MAX_PROJECTION * spacing, PROJECTION_TOLERANCE * spacing).unwrap_or(v);
        let jet = surface.jet(p);
        ((p, jet.gradient.normalize_or_zero()), curvature_tensor(&jet))
    };
    let ((points, normals), tensors): ((Vec<DVec3>, Vec<DVec3>), Vec<DMat3>) = vertices.par_iter().map(measure).unzip();
    (points, normals, tensors)
}

/// Returns the maximum magnitude of the principal curvatures (1/mm) at each sample, from the patch
/// on noisy parts, 0 next to them, and from F elsewhere. It is not averaged, because averaging
/// would reduce it at tips.
fn sharp_curvature(smoothed: &Smoothed, tensors: &[DMat3], normals: &[DVec3]) -> Vec<f64> {
    (0..normals.len())
        .into_par_iter()
        .map(|i| match &smoothed.patches[i] {
            Some(patch) => largest_curvature(&patch.curvature, patch.normal),
            // next to a noisy region, the derivatives of F are noisy too
            None if smoothed.noise[i] > 0.0 => 0.0,
            None => largest_curvature(&tensors[i], normals[i]),
        })
        .collect()
}

/// Returns the area of each component in mm^2. A component that marching cubes misses has no
/// triangles; its area is the estimate [`Component::area`].
fn component_areas(points: &[DVec3], triangles: &[[u32; 3]], component: &[u32], all: &[Component]) -> Vec<f64> {
    let mut areas = vec![0.0; all.len()];
    for t in triangles {
        if let Some(own) = areas.get_mut(component[t[0] as usize] as usize) {
            *own += area(points, t);
        }
    }
    areas.iter_mut().zip(all).filter(|(own, _)| **own == 0.0).for_each(|(own, component)| *own = component.area);
    areas
}

/// Averages curvature tensors along the surface and returns the maximum magnitude of their
/// principal curvatures (1/mm). Uses the tensors of the patches on noisy parts, and the tensors of
/// F elsewhere.
fn averaged_curvature(
    mut tensors: Vec<DMat3>,
    normals: &[DVec3],
    patches: &[Option<Patch>],
    incidence: &Incidence<'_>,
) -> Vec<f64> {
    let largest = |tensors: &[DMat3]| -> Vec<f64> {
        tensors.par_iter().zip(normals).map(|(t, &n)| largest_curvature(t, n)).collect()
    };
    average(incidence, &mut tensors, DMat3::ZERO, CURVATURE_ROUNDS);
    let mut curvature = largest(&tensors);
    if patches.iter().any(Option::is_some) {
        tensors.iter_mut().zip(patches).for_each(|(t, patch)| *t = patch.map_or(*t, |patch| patch.curvature));
        average(incidence, &mut tensors, DMat3::ZERO, CURVATURE_ROUNDS);
        for (i, patch) in patches.iter().enumerate() {
            if let Some(patch) = patch {
                curvature[i] = largest_curvature(&tensors[i], patch.normal);
            }
        }
    }
    curvature
}

/// Returns the distance in mm from each sample to the medial axis of the denoised surface. Where
/// the curvature `sharp` is high, the distance is at most the radius of curvature.
fn feature_sizes(
    points: &[DVec3],
    normals: &[DVec3],
    sharp: &[f64],
    smoothed: &Smoothed,
    image: &Image<f32>,
    largest: f64,
) -> Vec<f64> {
    let spacing = image.geometry.mean_spacing();
    let under = |i: usize| smoothed.patches[i].map_or((points[i], normals[i]), |patch| (patch.point, patch.normal));
    let (points, normals): (Vec<DVec3>, Vec<DVec3>) = (0..points.len()).into_par_iter().map(under).unzip();
    let blur: Vec<f64> = smoothed.noise.par_iter().map(|noise| (LEFT_OVER * noise).max(BLUR * spacing)).collect();
    let surface = Surface { points: &points, normals: &normals, blur: &blur, noise: &smoothed.noise, distance: image };
    let balls = medial_points(&surface, largest);
    let axis = KdTree::new(&balls.iter().flatten().flatten().copied().collect::<Vec<_>>());
    points
        .par_iter()
        .zip(sharp)
        .zip(&balls)
        .map(|((&p, &k), own)| {
            let own = own.iter().flatten().map(|centre| centre.distance(p)).fold(largest, f64::min);
            let bound = if k * SHARP * spacing > 1.0 { own.min(1.0 / k) } else { own };
            axis.nearest_of_leaves(p, bound, MOST_LEAVES).map_or(bound, |(_, d)| d)
        })
        .collect()
}

fn area(points: &[DVec3], t: &[u32; 3]) -> f64 {
    let [a, b, c] = t.map(|v| points[v as usize]);
    0.5 * (b - a).cross(c - a).length()
}
