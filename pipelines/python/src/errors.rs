//! Converts errors of the stages to Python exceptions.

use isoparticles_stage::error::{Error, Kind};
use pyo3::exceptions::PyKeyboardInterrupt;
use pyo3::prelude::*;

/// Converts an error of a stage to an exception: `isoparticles.Error`, or `KeyboardInterrupt` if
/// the run was interrupted.
pub(crate) fn raised(py: Python<'_>, error: Error) -> PyErr {
    if error.kind == Kind::Interrupted {
        return PyKeyboardInterrupt::new_err(());
    }
    let class = py.import("isoparticles._errors").and_then(|module| module.getattr("Error"));
    match class.and_then(|class| class.call1((error.what, error.why, error.next))) {
        Ok(value) => PyErr::from_value(value),
        Err(other) => other,
    }
}
