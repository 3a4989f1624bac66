//! `--vertices`: an edge length, or a factor on a graded field, of which the finished surface has a given number of vertices.

use crate::feature::Features;
use crate::{Parameters, size_field, uniform_field};
use isoparticles_common::image::Image;
use isoparticles_common::sizing::SizingField;
use isoparticles_common::spline::CubicSpline;

/// Vertices of the finished surface over what the size field predicts: 0.964, 0.962 and 0.948 on `heart_label` smoothed for 1,000, 5,000 and 24,000 vertices.
const FINISHED_OVER_PREDICTED: f64 = 0.955;

/// How much more there are for each unit by which h exceeds the local feature size: on ribs, trabecular bone and vessels, where that is 0.44 to 1.03 on average, 7 to 14 %
/// more were made than by the share above alone, which is 0.10 to 0.18 of it.
const MORE_WHERE_THIN: f64 = 0.13;

/// Most that h counts as exceeding the local feature size, as a share of that: beyond, the part goes.
const MOST_EXCESS: f64 = 2.0;

/// Vertices of the finished surface over what the size field predicts.
fn finished_over_predicted(features: &Features, sizing: &SizingField) -> f64 {
    let (mut weights, mut excess) = (0.0, 0.0);
    for (&point, &feature_size) in features.points.iter().zip(&features.feature_size) {
        let size = sizing.at(point);
        // by the vertices that there are to be at a sample, not by its area
        weights += size.powi(-2);
        excess += (size / feature_size - 1.0).clamp(0.0, MOST_EXCESS) * size.powi(-2);
    }
    let excess = if weights > 0.0 { excess / weights } else { 0.0 };
    FINISHED_OVER_PREDICTED * (1.0 + MORE_WHERE_THIN * excess)
}

/// Rounds that find the factor: the count goes with the inverse square of it but for the slope of h, which the factor changes, too.
const ROUNDS: usize = 3;

/// About the edge length, mm, that gives a surface so many vertices, as far as it is not thin.
pub fn size_for_vertices(distance: &Image<f32>, surface: &CubicSpline, vertices: f64) -> f64 {
    let at_one = uniform_field(distance, 1.0).predicted_count(surface);
    (FINISHED_OVER_PREDICTED * at_one / vertices).sqrt()
}

/// A size field times the factor that gives the surface so many vertices.
pub fn scaled_to_vertices(
    sizing: SizingField,
    features: &Features,
    surface: &CubicSpline,
    vertices: f64,
) -> SizingField {
    let mut factor = 1.0;
    let mut scaled = sizing.clone();
    for _ in 0..ROUNDS {
        let finished = finished_over_predicted(features, &scaled) * scaled.predicted_count(surface);
        factor *= (finished / vertices).sqrt();
        scaled = sizing.scaled(factor);
    }
    scaled
}

/// h over local feature size where F was made with a scale that shrinks at thin places ([`thin_for_vertices`]): five edges fit round a rod. With 0.9 trabecular bone at
/// 5,000 vertices came to the same quality (0.935 / 0.53 and 0.937 / 0.51).
const THIN_EPSILON: f64 = 1.2;

/// Largest slope of h there: that of the scale is 0.3.
const THIN_DELTA: f64 = 0.3;

/// Rounds that find the largest h; what is left is a factor near one.
const THIN_ROUNDS: usize = 2;

/// Fewest particles that a component is given room for.
const THIN_PARTICLES: f64 = 32.0;

/// A size field of which the surface has so many vertices, with one h but for places that are too thin for it, where it is down to `shrink` times smaller.
/// `size` is about the largest h.
pub fn thin_for_vertices(
    distance: &Image<f32>,
    features: &Features,
    surface: &CubicSpline,
    (size, shrink): (f64, f64),
    vertices: f64,
) -> SizingField {
    let of_size = |size: f64| {
        let parameters = Parameters {
            epsilon: THIN_EPSILON,
            delta: THIN_DELTA,
            min_size: size / shrink,
            max_size: size,
            max_deviation: f64::MAX,
            min_particles: THIN_PARTICLES,
            scale: 1.0,
            refined: Vec::new(),
        };
        size_field(distance, features, &parameters)
    };
    let mut size = size;
    let mut sizing = of_size(size);
    for _ in 0..THIN_ROUNDS {
        let finished = finished_over_predicted(features, &sizing) * sizing.predicted_count(surface);
        size *= (finished / vertices).sqrt();
        sizing = of_size(size);
    }
    scaled_to_vertices(sizing, features, surface, vertices)
}
