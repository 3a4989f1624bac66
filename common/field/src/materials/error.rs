//! Errors that occur when material indicators are assembled from stored parts.

/// Reasons why stored parts cannot be assembled.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// A box does not lie within the grid.
    #[error("a box of {size:?} nodes at {first:?} extends beyond the grid of {grid:?} nodes")]
    Box {
        /// First node of the box.
        first: [usize; 3],
        /// Number of nodes of the box along each axis.
        size: [usize; 3],
        /// Number of nodes of the grid along each axis.
        grid: [usize; 3],
    },
    /// The brick indices are not in ascending order, or one of them is not below the number of
    /// bricks.
    #[error("the brick numbers are not ascending, or exceed the {count} bricks of the grid")]
    Bricks {
        /// Number of bricks of the grid.
        count: usize,
    },
    /// There are too many or too few coefficients.
    #[error("{found} coefficients, but the bricks need {expected}")]
    Coefficients {
        /// Number of coefficients given.
        found: usize,
        /// Number of coefficients required.
        expected: usize,
    },
    /// A coefficient is not finite.
    #[error("a coefficient is {value}")]
    NotFinite {
        /// The coefficient.
        value: f32,
    },
    /// The fill of the bricks does not match the grid or the materials.
    #[error(
        "{found} materials of bricks, up to number {largest:?}, but there are {bricks} bricks and {materials} materials"
    )]
    Fill {
        /// Number of bricks for which a fill is given.
        found: usize,
        /// Largest material number in the fill.
        largest: Option<u16>,
        /// Number of bricks of the grid.
        bricks: usize,
        /// Number of materials.
        materials: usize,
    },
    /// There are no materials, or more than the maximum number.
    #[error("{found} materials, but the number must be from 1 to {most}")]
    Count {
        /// Number of materials given.
        found: usize,
        /// Maximum number of materials.
        most: usize,
    },
    /// The grid has too many bricks for 32-bit indices.
    #[error("a grid of {size:?} nodes has too many bricks to number")]
    Grid {
        /// Number of nodes of the grid along each axis.
        size: [usize; 3],
    },
}
