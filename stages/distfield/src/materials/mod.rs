//! Many materials: labels become one smooth indicator each, the outside included (Meyer, Whitaker, Kirby, Ledergerber and Pfister 2008).
//!
//! [`choice`] says which labels make which material, [`mod@extract`] makes the indicators one after the other by the method of one object, at a scale from what [`scaled`] smooths, [`survey`] looks at what
//! came out: the material of every node, volumes, areas, junctions, voxel centres that changed; [`program`] is what the stage does with it.

pub mod choice;
pub mod contacts;
pub mod extract;
pub mod grid;
pub mod islands;
pub mod program;
pub mod scaled;
pub mod survey;

pub use choice::Choice;
pub use extract::{Extracted, MaterialOptions, Tally, extract};
pub use grid::LabelGrid;
