//! `--vertices`: an edge length, or a factor on a graded field, of which the finished surface has a given number of vertices.

use crate::uniform_field;
use isoparticles_field::sizing::SizingField;
use isoparticles_field::spline::CubicSpline;
use isoparticles_volume::Image;

/// Vertices of the finished surface over what the size field predicts: 0.948 to 0.965 on four solid organs of 1,000 to 75,000 vertices, 0.914 to 0.975 on four thin objects, where
/// chords shorten and refinement adds (docs/developer/scale.md).
const FINISHED_OVER_PREDICTED: f64 = 0.95;

/// Rounds that find the factor: the count goes with the inverse square of it but for the slope of h, which the factor changes, too.
const ROUNDS: usize = 3;

/// The same where one edge length is looked for, and the count does not go with its inverse square alone because of junction curves.
const ROUNDS_OF_ONE_SIZE: usize = 6;

/// The edge length, mm, that gives a surface so many vertices.
pub fn size_for_vertices(distance: &Image<f32>, surface: &CubicSpline, vertices: f64) -> f64 {
    let at_one = uniform_field(distance, 1.0).predicted_count(surface);
    (FINISHED_OVER_PREDICTED * at_one / vertices).sqrt()
}

/// What [`size_for_vertices`] of so many predicts.
pub(crate) fn predicted_for(vertices: f64) -> f64 {
    vertices / FINISHED_OVER_PREDICTED
}

/// The same with the count that an edge length asks for, which falls with it.
pub(crate) fn size_for_count(count: impl Fn(f64) -> f64, vertices: f64) -> f64 {
    let mut size = 1.0;
    for _ in 0..ROUNDS_OF_ONE_SIZE {
        size *= (FINISHED_OVER_PREDICTED * count(size) / vertices).sqrt();
    }
    size
}

/// A size field times the factor that gives the surface so many vertices.
pub fn scaled_to_vertices(sizing: SizingField, surface: &CubicSpline, vertices: f64) -> SizingField {
    scaled_to_count(sizing, |sizing| sizing.predicted_count(surface), vertices)
}

/// The same with the count that a size field asks for.
pub(crate) fn scaled_to_count(sizing: SizingField, count: impl Fn(&SizingField) -> f64, vertices: f64) -> SizingField {
    let mut factor = 1.0;
    let mut scaled = sizing.clone();
    for _ in 0..ROUNDS {
        factor *= (FINISHED_OVER_PREDICTED * count(&scaled) / vertices).sqrt();
        scaled = sizing.scaled(factor);
    }
    scaled
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;
    use isoparticles_volume::Geometry;

    #[test]
    fn the_edge_length_for_a_count_predicts_what_is_said_of_it() {
        let geometry = Geometry::axis_aligned([24; 3], DVec3::new(1.0, 1.2, 0.9));
        let image = Image::sampled(geometry, |p| (p.distance(DVec3::splat(10.0)) - 7.0) as f32);
        let surface = CubicSpline::new(&image);
        for vertices in [100.0, 5000.0] {
            let size = size_for_vertices(&image, &surface, vertices);
            let predicted = uniform_field(&image, size).predicted_count(&surface);
            assert!((predicted / predicted_for(vertices) - 1.0).abs() < 1e-6, "{predicted}");
        }
    }
}
