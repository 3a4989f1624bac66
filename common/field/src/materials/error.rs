//! What can be wrong with the parts that indicators of materials are put together from.

/// The parts do not belong together.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// A box does not lie in the grid.
    #[error("a box of {size:?} nodes at {first:?} does not lie in the grid of {grid:?} nodes")]
    Box {
        /// First node of the box.
        first: [usize; 3],
        /// Nodes of the box.
        size: [usize; 3],
        /// Nodes of the grid.
        grid: [usize; 3],
    },
    /// Bricks are not in ascending order, or beyond the last.
    #[error("the numbers of the bricks do not ascend within the {count} bricks of the grid")]
    Bricks {
        /// Bricks of the grid.
        count: usize,
    },
    /// There are too many or too few coefficients.
    #[error("{found} coefficients where the bricks read {expected}")]
    Coefficients {
        /// How many there are.
        found: usize,
        /// How many there should be.
        expected: usize,
    },
    /// A coefficient is no number.
    #[error("a coefficient is {value}")]
    NotFinite {
        /// The coefficient.
        value: f32,
    },
    /// The fill of the bricks is not that of this grid and these materials.
    #[error(
        "{found} materials of bricks, up to number {largest:?}, where there are {bricks} bricks and {materials} materials"
    )]
    Fill {
        /// How many there are.
        found: usize,
        /// The largest of them.
        largest: Option<u16>,
        /// Bricks of the grid.
        bricks: usize,
        /// Materials.
        materials: usize,
    },
    /// More materials than can be numbered, or none.
    #[error("{found} materials; from 1 to {most} are understood")]
    Count {
        /// How many there are.
        found: usize,
        /// How many there may be.
        most: usize,
    },
    /// The grid has more bricks than can be numbered.
    #[error("a grid of {size:?} nodes has too many bricks to number")]
    Grid {
        /// Nodes of the grid.
        size: [usize; 3],
    },
}
