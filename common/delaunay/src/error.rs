//! Errors of the triangulation.

use glam::DVec3;

/// Reasons why points cannot be triangulated.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum Error {
    /// A coordinate is NaN, infinite or above 1e50 in absolute value. Larger coordinates would
    /// overflow the exact predicates.
    #[error("point {0} has a coordinate that is not finite or larger than 1e50")]
    Coordinate(DVec3),
    /// There are fewer than four distinct points. The value is the number of distinct points.
    #[error("only {0} distinct points to triangulate")]
    TooFew(usize),
    /// All points lie on one line. The value is the number of points.
    #[error("all {0} points lie on one line")]
    Collinear(usize),
    /// All points lie in one plane. The value is the number of points.
    #[error("all {0} points lie in one plane")]
    Coplanar(usize),
    /// There are too many points for 32-bit indices.
    #[error("{0} points to triangulate, more than 32 bits number")]
    TooManyPoints(usize),
    /// There are more than 2^29 tetrahedra, so the next insertion could overflow the 30-bit
    /// indices.
    #[error("more than {0} tetrahedra between the points")]
    TooManyTetrahedra(usize),
}

/// Result of a triangulation operation.
pub type Result<T> = std::result::Result<T, Error>;
