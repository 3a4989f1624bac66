//! Converts errors of the stages to Python exceptions.

use isoparticles_stage::error::{Error, Kind};
use pyo3::exceptions::PyKeyboardInterrupt;
use pyo3::prelude::*;

/// Converts an error of a stage to an exception: `isoparticles.Error` without a report, or
/// `KeyboardInterrupt` if the run was interrupted.
pub(crate) fn raised(py: Python<'_>, error: Error) -> PyErr {
    raised_by_run(py, error, "null")
}

/// Converts an error like [`raised`], and attaches the report of the run, which is JSON.
pub(crate) fn raised_by_run(py: Python<'_>, error: Error, report: &str) -> PyErr {
    if error.kind == Kind::Interrupted {
        return PyKeyboardInterrupt::new_err(());
    }
    let exception = || -> PyResult<Bound<'_, PyAny>> {
        let report = py.import("json")?.call_method1("loads", (report,))?;
        py.import("isoparticles._errors")?.call_method1("Error", (error.what, error.why, error.next, report))
    };
    exception().map_or_else(|other| other, PyErr::from_value)
}
