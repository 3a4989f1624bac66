//! Measures the surface at dense samples: local feature size, curvature and components.
//!
//! Local feature size is the distance to the medial axis (Amenta and Bern 1999). It is the basis of
//! the epsilon-sampling of Meyer, Kirby and Whitaker 2007 (reference 15 of the paper).

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

/// Rounds of averaging that remove ripple from the curvature. A spline through samples of a steep
/// edge rings, which affects its second derivatives as much as the shape does. Measured on a ball
/// of radius 19 voxels with an edge two voxels wide: the maximum curvature is 2.1 / R without
/// averaging and 1.25 / R with it.
pub(crate) const CURVATURE_ROUNDS: usize = 8;

/// Radius of curvature, in voxels, below which it bounds the feature size. At such radii ripple is
/// comparatively small, while the pruned end of the medial axis behind a tip is not.
pub(crate) const SHARP: f64 = 5.0;

/// Depth, in voxels, to which samples may lie inside a medial ball. Without it, ripple next to the
/// touching point would shrink balls to nothing. A larger value reduces the feature size (2.5 % on
/// the ball at 0.03).
const BLUR: f64 = 0.01;

/// The same depth where there is noise, as a share of the noise: the part that remains in the
/// patches. At 0.3 the 5th percentile of the feature size of a noisy ball of 19 voxels fell from 18
/// to 7.5 (without pruning of bumps); 1 gives the same as 0.6.
const LEFT_OVER: f64 = 0.6;

/// Maximum number of leaves of the axis tree that one nearest-point query visits. The axis of a
/// ball is a cloud of points at nearly equal distances.
const MOST_LEAVES: usize = 400;

/// Meaning of small bumps of the surface.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Bumps {
    /// They may be noise of a scalar volume, which is detected and not treated as shape.
    MayBeNoise,
    /// They are shape and are measured as they are: on labels, each bump has a voxel centre on its
    /// side.
    AreShape,
}

/// Purpose of the measurement.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Purpose {
    /// To find where a constant h is too large; needs feature sizes only.
    OneSize,
    /// To size each sample; needs curvature and components too.
    Grading,
}

/// Samples of F = 0 with their measurements.
#[derive(Clone, Debug)]
pub struct Features {
    /// Positions on F = 0, grid frame, mm.
    pub points: Vec<DVec3>,
    /// Unit normals, outward.
    pub normals: Vec<DVec3>,
    /// Maximum principal curvature in magnitude, per mm; that of the surface under the noise where
    /// there is some. Empty for [`Purpose::OneSize`].
    pub curvature: Vec<f64>,
    /// Distance to the medial axis, inside or outside, mm; at sharp places at most the radius of
    /// curvature. Where there is noise, that of the surface under it.
    pub feature_size: Vec<f64>,
    /// Height of the noise that is not treated as shape, root mean square, mm.
    pub noise: Vec<f64>,
    /// Triangles between the samples (marching cubes, projected).
    pub triangles: Vec<[u32; 3]>,
    /// Component of F = 0 of each sample; [`NO_COMPONENT`] if it cannot be determined. Empty for
    /// [`Purpose::OneSize`].
    pub component: Vec<u32>,
    /// Area of each component, mm squared; for [`Purpose::OneSize`] to first order in the edge of
    /// the topology's cells.
    pub component_area: Vec<f64>,
}

impl Features {
    /// Samples F = 0 at the projected vertices of marching cubes and measures it. Feature sizes are
    /// limited to `largest` (mm). Empty if there is no surface.
    pub fn new(
        image: &Image<f32>,
        surface: &CubicSpline,
        components: &FieldComponents,
        largest: f64,
        (bumps, purpose): (Bumps, Purpose),
    ) -> Self {
        let mesh = marching_cubes(image, 0.0);
        let spacing = image.geometry.mean_spacing();
        let measure = |&v: &DVec3| {
            let p = surface.project(v, 1.5 * spacing, 1e-6 * spacing).unwrap_or(v);
            let jet = surface.jet(p);
            ((p, jet.gradient.normalize_or_zero()), curvature_tensor(&jet))
        };
        let ((points, normals), tensors): ((Vec<DVec3>, Vec<DVec3>), Vec<DMat3>) =
            mesh.vertices.par_iter().map(measure).unzip();
        let incidence = Incidence::new(&mesh.triangles, points.len());
        let smoothed = match bumps {
            Bumps::AreShape => Smoothed::none(points.len()),
            Bumps::MayBeNoise => {
                let connections = Connections::new(points.len(), &mesh.triangles);
                let samples = Samples { points: &points, normals: &normals, connections: &connections };
                Smoothed::new(&samples, &incidence, spacing)
            }
        };
        // not averaged: the curvature of a tip would become that of its surroundings
        let sharp: Vec<f64> = (0..points.len())
            .into_par_iter()
            .map(|i| match &smoothed.patches[i] {
                Some(patch) => largest_curvature(&patch.curvature, patch.normal),
                // next to a noisy place, the derivatives of F are noisy too
                None if smoothed.noise[i] > 0.0 => 0.0,
                None => largest_curvature(&tensors[i], normals[i]),
            })
            .collect();
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
        Self {
            points,
            normals,
            curvature,
            feature_size,
            noise: smoothed.noise,
            triangles: mesh.triangles,
            component,
            component_area,
        }
    }
}

/// The area of each component, mm squared: of its triangles, or the topology's estimate if it has
/// none (components between the samples).
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

/// Maximum principal curvature (per mm) from the tensors of F, averaged along the surface; where
/// there is noise, from the tensors of the patches.
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

/// Distance to the medial axis of the surface under the noise, mm; where the curvature `sharp` is
/// high, at most its radius.
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
