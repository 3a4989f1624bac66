//! The Python module `isoparticles._native`: the stages as functions on values in memory.
//!
//! The Python package `isoparticles` (`pipelines/wheel`) converts images and keyword arguments to
//! volumes and command-line words, and wraps the values. The module `stages` parses the words as
//! the programs do, so histories and files are the same. The module `pool` runs the stages on
//! threads that do not hold Python's global lock.

mod arrays;
mod context;
mod data;
mod distance;
mod errors;
mod fields;
mod meshes;
mod options;
mod pool;
mod stages;
mod tetrahedra;
mod volume;

use pyo3::prelude::*;

/// Native parts of the package isoparticles.
#[pymodule]
mod _native {
    /// Version of the programs and of this module.
    #[pymodule_export]
    const VERSION: &str = env!("CARGO_PKG_VERSION");

    #[pymodule_export]
    use crate::arrays::set_threads;
    #[pymodule_export]
    use crate::context::{Context, Progress, Step, check_memory, check_output, number_of_bytes};
    #[pymodule_export]
    use crate::data::{Data, load};
    #[pymodule_export]
    use crate::distance::{DistanceField, jacobian_coefficients};
    #[pymodule_export]
    use crate::fields::{GridField, labels_at, read_volume, tetrahedron_means};
    #[pymodule_export]
    use crate::meshes::{
        changed_triangles, check_complex, describe_complex, distances_both_ways, distances_to, nearest_flags,
        self_intersections, summarize, surface_components, surface_topology, tetrahedron_boundary, tetrahedron_quality,
        tetrahedron_volumes, triangle_quality,
    };
    #[pymodule_export]
    use crate::options::{case_keys, case_name, case_words, options};
    #[pymodule_export]
    use crate::stages::{distance_field, reconstruct, seed, settle, size_field};
    #[pymodule_export]
    use crate::tetrahedra::{conform, forced_sides, largest_jacobians, mend};
    #[pymodule_export]
    use crate::volume::Volume;
}
