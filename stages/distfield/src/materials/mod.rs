//! Computes one smooth indicator for each of several materials, including the outside (Meyer,
//! Whitaker, Kirby, Ledergerber and Pfister 2008).
//!
//! [`choice`] maps labels to materials, [`overlaps`] ranks materials that overlap, and [`grid`]
//! maps voxels to materials; [`islands`] removes small components. [`mod@extract`] computes the
//! indicators one after the other, by the method for a single object or, if there are [`scales`],
//! from the level sets of [`scaled`]. [`contacts`] corrects the indicators where several materials
//! meet. `cut` ends materials at planes, and `object` does so for a single object. [`survey`]
//! measures the result: the material of every node, volumes, areas, junctions and changed voxel
//! centres. `compute` performs these steps.

pub mod choice;
mod compute;
pub mod contacts;
mod cut;
pub mod extract;
pub mod grid;
pub mod islands;
mod object;
pub mod overlaps;
pub mod scaled;
pub mod scales;
pub mod survey;

pub use choice::MaterialChoice;
pub(crate) use compute::{check_options, compute};
pub use cut::Cut;
pub use extract::{Extracted, MaterialOptions, Tally, extract};
pub use grid::LabelGrid;
pub(crate) use object::object_with_planes;
