//! Arrays of numbers: copied from objects with Python's buffer protocol, and returned as NumPy
//! arrays.

use crate::pool;
use glam::DVec3;
use isoparticles_mesh::TriangleMesh;
use isoparticles_stage::cli::Listener;
use isoparticles_volume::{Endian, Voxels};
use pyo3::buffer::{Element, PyBuffer};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::PyByteArray;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering::Relaxed};

/// A type of numbers that NumPy has as well.
pub(crate) trait Number: bytemuck::NoUninit {
    const DTYPE: &str;
}

impl Number for f64 {
    const DTYPE: &str = "float64";
}

impl Number for i64 {
    const DTYPE: &str = "int64";
}

impl Number for bool {
    const DTYPE: &str = "bool";
}

/// An array that Python receives as a writable NumPy array.
pub(crate) struct Array {
    dtype: &'static str,
    shape: Vec<usize>,
    bytes: Vec<u8>,
}

impl Array {
    /// Returns an array of shape `(n,)`.
    pub(crate) fn column<T: Number>(values: &[T]) -> Self {
        Self { dtype: T::DTYPE, shape: vec![values.len()], bytes: bytemuck::cast_slice(values).to_vec() }
    }

    /// Returns an array of shape `(n, N)`.
    pub(crate) fn rows<T: Number, const N: usize>(rows: &[[T; N]]) -> Self {
        Self { shape: vec![rows.len(), N], ..Self::column(rows.as_flattened()) }
    }

    /// Returns voxels as an array with the axes z, y and x.
    pub(crate) fn voxels(voxels: &Voxels, [nx, ny, nz]: [usize; 3]) -> PyResult<Self> {
        let mut bytes = Vec::new();
        voxels.write_to(&mut bytes, Endian::Little)?;
        Ok(Self { dtype: voxels.type_name(), shape: vec![nz, ny, nx], bytes })
    }

    /// Returns the array with another shape that has the same number of entries.
    pub(crate) fn shaped(self, shape: &[usize]) -> Self {
        Self { shape: shape.to_vec(), ..self }
    }

    /// Returns points as an array of shape `(n, 3)`.
    pub(crate) fn points(points: &[DVec3]) -> Self {
        Self::rows(&points.iter().map(|point| point.to_array()).collect::<Vec<_>>())
    }

    /// Returns indices as an array of shape `(n,)`.
    pub(crate) fn indices(indices: &[u32]) -> Self {
        Self::column(&indices.iter().map(|&index| i64::from(index)).collect::<Vec<_>>())
    }

    /// Returns cells as an array of shape `(n, N)`.
    pub(crate) fn cells<const N: usize>(cells: &[[u32; N]]) -> Self {
        Self { shape: vec![cells.len(), N], ..Self::indices(cells.as_flattened()) }
    }

    /// Returns the `N` measures of each item as `N` arrays of shape `(n,)`.
    pub(crate) fn columns<const N: usize>(rows: &[[f64; N]]) -> [Self; N] {
        std::array::from_fn(|k| Self::column(&rows.iter().map(|row| row[k]).collect::<Vec<_>>()))
    }
}

impl<'py> IntoPyObject<'py> for Array {
    type Target = PyAny;
    type Output = Bound<'py, PyAny>;
    type Error = PyErr;

    fn into_pyobject(self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        let flat = py.import("numpy")?.call_method1("frombuffer", (PyByteArray::new(py, &self.bytes), self.dtype))?;
        flat.call_method1("reshape", (self.shape,))
    }
}

/// Copies an array of any shape, in C order.
pub(crate) fn values<T: Element>(array: &Bound<'_, PyAny>) -> PyResult<Vec<T>> {
    PyBuffer::<T>::get(array)?.to_vec(array.py())
}

/// Copies an array of shape `(n, N)`.
pub(crate) fn rows<T: Element, const N: usize>(array: &Bound<'_, PyAny>) -> PyResult<Vec<[T; N]>> {
    let buffer = PyBuffer::<T>::get(array)?;
    if buffer.shape().len() != 2 || buffer.shape()[1] != N {
        return Err(PyValueError::new_err(format!("the array must have the shape (n, {N}), not {:?}", buffer.shape())));
    }
    Ok(buffer.to_vec(array.py())?.as_chunks().0.to_vec())
}

/// Copies points of shape `(n, 3)`.
pub(crate) fn points(array: &Bound<'_, PyAny>) -> PyResult<Vec<DVec3>> {
    Ok(rows(array)?.into_iter().map(DVec3::from_array).collect())
}

/// Copies an array of indices below `limit`.
pub(crate) fn indices(array: &Bound<'_, PyAny>, limit: usize) -> PyResult<Vec<u32>> {
    values::<i64>(array)?.into_iter().map(|index| checked(index, limit)).collect()
}

/// Copies cells of shape `(n, N)`, whose vertex indices must be below `vertices`.
pub(crate) fn cells<const N: usize>(array: &Bound<'_, PyAny>, vertices: usize) -> PyResult<Vec<[u32; N]>> {
    let cells = rows::<i64, N>(array)?;
    let indices: PyResult<Vec<u32>> = cells.as_flattened().iter().map(|&index| checked(index, vertices)).collect();
    Ok(indices?.as_chunks().0.to_vec())
}

fn checked(index: i64, limit: usize) -> PyResult<u32> {
    let found = u32::try_from(index).ok().filter(|&index| (index as usize) < limit);
    found.ok_or_else(|| PyValueError::new_err(format!("index {index} is not between 0 and {limit} (exclusive)")))
}

/// Copies a mesh with finite points.
pub(crate) fn mesh(points: &Bound<'_, PyAny>, triangles: &Bound<'_, PyAny>) -> PyResult<TriangleMesh> {
    let vertices = self::points(points)?;
    if !vertices.iter().all(|point| point.is_finite()) {
        return Err(PyValueError::new_err("the points must be finite"));
    }
    let triangles = cells(triangles, vertices.len())?;
    Ok(TriangleMesh { vertices, triangles })
}

/// Number of threads of [`compute`]; 0 means one per core.
static THREADS: AtomicUsize = AtomicUsize::new(0);

/// Sets the number of threads for checks and measures of meshes and fields; 0 means one per core.
#[pyfunction]
pub(crate) fn set_threads(count: usize) {
    THREADS.store(count, Relaxed);
}

/// Runs a job without Python's global lock.
pub(crate) fn compute<T: Send + 'static>(py: Python<'_>, job: impl FnOnce() -> T + Send + 'static) -> PyResult<T> {
    compute_unless_stopped(py, |_| job())
}

/// Works like [`compute`], for a long job that asks the listener whether to stop.
pub(crate) fn compute_unless_stopped<T: Send + 'static>(
    py: Python<'_>,
    job: impl FnOnce(&Listener) -> T + Send + 'static,
) -> PyResult<T> {
    let listener = Arc::new(Listener::default());
    let told = Arc::clone(&listener);
    pool::run(py, THREADS.load(Relaxed), &listener, None, move || job(&told))
}
