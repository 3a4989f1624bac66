//! Many materials: particles on strata become one conforming complex of triangles between materials.
//!
//! | step | module |
//! |---|---|
//! | the particles on their strata, triangulated; segments of junction curves | [`prepare`], [`segments`] |
//! | tetrahedra of materials, what is violated there, and what mends it | [`topology`], [`complex`], [`nodes`] |
//! | points added, most needed first | [`refine`] |
//! | tetrahedra given to another material where points do not help | `relabel` |
//! | superfluous segments dropped, vertices joined to the interfaces that pass them | `unite` |

pub mod complex;
pub mod criteria;
mod cut;
pub mod improve;
pub mod nodes;
pub mod pieces;
pub mod prepare;
#[cfg(test)]
mod program_tests;
pub mod reconstruct;
pub mod refine;
mod relabel;
pub mod run;
#[cfg(test)]
mod scenes;
pub mod segments;
#[cfg(test)]
mod tests;
pub mod topology;
mod unite;
pub(crate) mod way;
