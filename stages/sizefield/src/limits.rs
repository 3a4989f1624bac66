//! What is refused before the later stages start: an edge longer than the object, and more particles than memory holds.

use isoparticles_stage::cli::{Context, particles_bytes};
use isoparticles_stage::error::{Error, Result};
use std::path::Path;

/// Particles that the largest part must be given by one edge length: `seed` gives a closed part at least so many (a lattice of twelve
/// is the icosahedron, the coarsest in which five triangles meet everywhere), and fewer make no shape.
const FEWEST: f64 = 12.0;

/// Refuses one edge length that gives even the largest part of the surface, of `area` mm^2, too few particles.
///
/// # Errors
/// As said, with an edge length that would do.
pub fn check_size(path: &Path, size: f64, area: f64) -> Result<()> {
    let density = |h: f64| 2.0 / (3f64.sqrt() * h * h);
    let count = area * density(size);
    if count >= FEWEST {
        return Ok(());
    }
    // with room for a shape: a hundred vertices
    let would_do = (area * density(1.0) / 100.0).sqrt();
    let largest = (area * density(1.0) / FEWEST).sqrt();
    Err(Error::input(
        format!(
            "{}: h = {size} mm is too large for the object: {count:.1} particles on its largest part",
            path.display()
        ),
        format!("fewer than {FEWEST} do not make a closed surface; the largest part has an area of {area:.4} mm^2"),
        format!("give a size below {largest:.3} mm; {would_do:.2} mm gives about 100 vertices"),
    ))
}

/// Refuses sizes that ask for more particles than there is memory for in the stages to come.
///
/// # Errors
/// As said, with the figures.
pub fn check_count(path: &Path, predicted: f64, nodes: usize, context: &Context) -> Result<()> {
    context.check_memory(
        particles_bytes(predicted, nodes),
        &format!(
            "{}: the sizes ask for {predicted:.0} particles in reconstruct, on a grid of {nodes} nodes",
            path.display()
        ),
        "ask for larger triangles (--uniform, --min-size, --scale)",
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_size_above_the_object_is_refused_and_one_that_would_do_is_named() {
        // a ball of radius 10: 1257 mm^2, twelve particles at 11 mm
        let area = 400.0 * std::f64::consts::PI;
        let path = Path::new("f.vti");
        assert!(check_size(path, 10.9, area).is_ok());
        let error = check_size(path, 500.0, area).expect_err("too large");
        assert!(error.what.contains("h = 500 mm") && error.what.contains("0.0 particles"), "{error}");
        assert!(error.next.contains("below 10.99") && error.next.contains("3.81 mm gives about 100"), "{error}");
    }
}
