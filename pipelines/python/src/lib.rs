//! The Python module `isoparticles._native`: the stages as functions on values in memory.
//!
//! The Python package `isoparticles` (`pipelines/wheel`) converts images and keyword arguments to
//! volumes and command-line words, and wraps the values. The module `stages` parses the words as
//! the programs do, so histories and files are the same. The module `pool` runs the stages on
//! threads that do not hold Python's global lock.

mod data;
mod options;
mod pool;
mod stages;
mod volume;

use isoparticles_stage::error::{Error, Kind};
use pyo3::exceptions::PyKeyboardInterrupt;
use pyo3::prelude::*;

/// Converts an error of a stage to an exception: `isoparticles.Error`, or `KeyboardInterrupt` if
/// the run was interrupted.
fn raised(py: Python<'_>, error: Error) -> PyErr {
    if error.kind == Kind::Interrupted {
        return PyKeyboardInterrupt::new_err(());
    }
    let class = py.import("isoparticles._errors").and_then(|module| module.getattr("Error"));
    match class.and_then(|class| class.call1((error.what, error.why, error.next))) {
        Ok(value) => PyErr::from_value(value),
        Err(other) => other,
    }
}

/// Native parts of the package isoparticles.
#[pymodule]
mod _native {
    #[pymodule_export]
    use crate::data::{Data, load};
    #[pymodule_export]
    use crate::options::{case_keys, case_name, case_words, options};
    #[pymodule_export]
    use crate::stages::{distance_field, reconstruct, seed, settle, size_field};
    #[pymodule_export]
    use crate::volume::Volume;
}
