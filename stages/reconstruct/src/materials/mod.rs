//! Many materials: computes one conforming complex of material interfaces from particles on strata.
//! The method is Delaunay refinement (Cheng, Dey and Levine 2008; `docs/developer/materials.md`).
//!
//! | step | module |
//! |---|---|
//! | projection onto strata, triangulation, junction segments | [`prepare`], [`segments`] |
//! | materials of tetrahedra | [`complex`] |
//! | violations and their remedies | [`topology`], [`criteria`], [`nodes`] |
//! | insertion of points, segments split on their curves | [`refine`], `cut` |
//! | tetrahedra that change their material where points do not help | `relabel` |
//! | edges that become segments where strata are merged, redundant segments dropped | `unite` |
//! | short segments of curves contracted at a scale | `contract` |
//! | contraction of segments that still limit the quality | `simplify` |
//! | functions of the interfaces, topology of the materials | [`subject`], [`pieces`] |
//! | all steps in order | [`reconstruct`] |
//! | surfaces of single materials | `each` |

pub mod complex;
mod contract;
pub mod criteria;
mod cut;
pub(crate) mod each;
pub mod nodes;
pub mod pieces;
pub mod prepare;
#[cfg(test)]
mod program_tests;
pub mod reconstruct;
pub mod refine;
mod relabel;
#[cfg(test)]
mod scenes;
pub mod segments;
mod simplify;
pub mod subject;
#[cfg(test)]
mod tests;
pub mod topology;
mod unite;
#[cfg(test)]
mod update_tests;
pub(crate) mod way;
