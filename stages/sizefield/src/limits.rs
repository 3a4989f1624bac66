//! Checks the sizing field before later stages use it. Rejects a constant h that is too large for
//! the object, and a field with so many particles that they would not fit into memory. Reports
//! components that are too small for their h.

use isoparticles_field::sizing::SizingField;
use isoparticles_field::topology::Component;
use isoparticles_stage::cli::values::{place, significant};
use isoparticles_stage::cli::{Context, particles_bytes};
use isoparticles_stage::error::{Error, Result};
use serde::Serialize;
use std::path::Path;

/// Minimum number of particles on a component. `seed` places at least this many on every component.
/// Twelve vertices form an icosahedron, the closed surface with five equilateral triangles at every
/// vertex.
const FEWEST_PARTICLES: f64 = 12.0;

/// Returns the number of particles per mm^2 in a hexagonal lattice with spacing h (mm).
fn density(h: f64) -> f64 {
    2.0 / (3f64.sqrt() * h * h)
}

/// A component that is too small for its h.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct TooSmall {
    /// A point near the component, in mm in the world frame.
    pub place: [f64; 3],
    /// Maximum extent of the component in mm along an axis of the grid.
    pub size: f64,
    /// h at `place`, mm.
    pub h: f64,
}

/// Returns the components of F = 0 on which h results in fewer than twelve particles, in the order
/// of `components`.
pub fn too_small(components: &[Component], sizing: &SizingField) -> Vec<TooSmall> {
    let told = |component: &Component| {
        let h = sizing.at(component.place);
        let place = sizing.image().geometry.grid_to_world(component.place).to_array();
        let size = (component.bounds.high - component.bounds.low).max_element();
        (component.area * density(h) < FEWEST_PARTICLES).then_some(TooSmall { place, size, h })
    };
    components.iter().filter_map(told).collect()
}

/// Returns a message about components that are too small, or `None` if there are none. `components`
/// is the total number of components.
pub fn too_small_told(found: &[TooSmall], components: usize) -> Option<String> {
    let smallest = found.iter().min_by(|a, b| a.size.total_cmp(&b.size))?;
    Some(format!(
        "{} of {components} components are too small for their h and may be meshed poorly; the smallest is {} mm \
         wide, where h is {} mm, at {} mm. Lower SIZE, MIN_SIZE or EPSILON (--uniform, --min-size, --epsilon), \
         refine there (SIZEFIELD_OPTIONS=\"--refine ...\"), or remove small components (DISTFIELD_OPTIONS=\"--keep \
         ...\", SCALE)",
        found.len(),
        significant(smallest.size),
        significant(smallest.h),
        place(smallest.place),
    ))
}

/// Rejects a constant h if even the largest component, with an area of `area` mm^2, gets too few
/// particles.
///
/// # Errors
/// If there would be too few particles. The message suggests an edge length.
pub fn check_size(path: &Path, size: f64, area: f64) -> Result<()> {
    let count = area * density(size);
    if count >= FEWEST_PARTICLES {
        return Ok(());
    }
    // about 100 vertices can represent a simple shape
    let would_do = (area * density(1.0) / 100.0).sqrt();
    let largest = (area * density(1.0) / FEWEST_PARTICLES).sqrt();
    Err(Error::input(
        format!(
            "{}: h = {size} mm is too large for the object: {count:.1} particles on its largest part",
            path.display()
        ),
        format!(
            "a closed surface needs at least {FEWEST_PARTICLES} particles; the largest part has an area of {} mm^2",
            significant(area)
        ),
        format!(
            "set SIZE (--uniform) below {} mm, or raise VERTICES (--vertices); {} mm gives about 100 vertices",
            significant(largest),
            significant(would_do)
        ),
    ))
}

/// Rejects a minimum edge length above the maximum (mm); `more` is appended to the advice.
pub(crate) fn check_bounds((min, max): (f64, f64), more: &str) -> Result<()> {
    if min <= max {
        return Ok(());
    }
    Err(Error::input(
        format!("--min-size {min} is above --max-size {max}"),
        "no edge length satisfies both",
        format!("set MIN_SIZE (--min-size) below MAX_SIZE (--max-size){more}"),
    ))
}

/// Rejects a sizing field if the `predicted` number of particles would not fit into memory in later
/// stages. `nodes` is the number of grid nodes.
///
/// # Errors
/// If there is not enough memory. The message states the required and the available memory.
pub fn check_count(path: &Path, predicted: f64, nodes: usize, context: &Context) -> Result<()> {
    context.check_memory(
        particles_bytes(predicted, nodes),
        &format!("{}: reconstructing {predicted:.0} particles on a grid of {nodes} nodes", path.display()),
        "raise SIZE (--uniform) or MIN_SIZE (--min-size), lower VERTICES (--vertices), or set \
         SIZEFIELD_OPTIONS=\"--scale 2\"",
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;
    use isoparticles_field::spline::CubicSpline;
    use isoparticles_field::topology::FieldComponents;
    use isoparticles_stage::monitor::Silent;
    use isoparticles_volume::{Geometry, Image};

    #[test]
    fn a_small_component_without_samples_is_reported() {
        // a ball, and a component so small that it lies between grid nodes and has no samples
        let geometry = Geometry::axis_aligned([32, 24, 24], DVec3::ONE);
        let (ball, speck) = (DVec3::new(9.0, 12.0, 12.0), DVec3::new(24.5, 12.45, 12.52));
        let distance = |p: DVec3| (p.distance(ball) - 6.0).min(0.4 * (p.distance_squared(speck) - 0.3)) as f32;
        let image = Image::sampled(geometry.clone(), distance);
        let surface = CubicSpline::new(&image);
        let components = FieldComponents::new(&surface, &Silent).expect("not interrupted");
        let at = |h: f32| too_small(components.all(), &SizingField::new(Image::filled(geometry.clone(), h)));
        let found = at(2.0);
        assert_eq!((components.all().len(), found.len()), (2, 1), "{found:?}");
        assert!(DVec3::from_array(found[0].place).distance(speck) < 0.8 && found[0].size < 1.2, "{found:?}");
        let told = too_small_told(&found, 2).expect("words");
        assert!(
            told.starts_with("1 of 2 components are too small for their h") && told.contains("h is 2 mm"),
            "{told}"
        );
        assert_eq!((at(0.25), too_small_told(&[], 2)), (vec![], None));
    }

    #[test]
    fn a_size_above_the_object_is_refused_with_a_better_one() {
        // a ball of radius 10 mm has an area of 1257 mm^2, which gives twelve particles at h = 11
        // mm
        let area = 400.0 * std::f64::consts::PI;
        let path = Path::new("f.vti");
        assert!(check_size(path, 10.9, area).is_ok());
        let error = check_size(path, 500.0, area).expect_err("too large");
        assert!(error.what.contains("h = 500 mm") && error.what.contains("0.0 particles"), "{error}");
        assert!(error.next.contains("below 11 mm") && error.next.contains("3.809 mm gives about 100"), "{error}");
    }
}
