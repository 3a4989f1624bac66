//! Tetrahedral meshes. A tetrahedron lists its four vertices in VTK order: the first three are
//! counter-clockwise as seen from the fourth.

mod cavity;
pub mod conform;
pub mod faces;
pub mod forced;
pub mod mend;
mod patch;
pub mod quadratic;
pub mod quality;
pub mod target;

/// Positions in a tetrahedron of the vertices of its four faces. The faces of a positive
/// tetrahedron are counter-clockwise as seen from outside.
pub const FACES: [[usize; 3]; 4] = [[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]];

#[cfg(test)]
mod tests;
