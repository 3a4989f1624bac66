//! Volumes from NumPy arrays.

use glam::{DMat3, DVec3};
use isoparticles_stage::history::hash_written;
use isoparticles_volume::{Endian, Geometry, Space, Voxels};
use pyo3::buffer::{Element, PyBuffer};
use pyo3::exceptions::{PyTypeError, PyValueError};
use pyo3::prelude::*;
use std::sync::{Mutex, PoisonError};

/// A volume with one layer. A stage takes the voxels out, so each volume can be used once.
#[pyclass(frozen, module = "isoparticles._native")]
pub(crate) struct Volume(Mutex<Option<isoparticles_volume::Volume>>);

#[pymethods]
impl Volume {
    /// Copies an array whose axes are x, y and z. The caller has checked the geometry: `spacing`
    /// and `origin` are in mm, and `axes` contains the unit vectors of the three axes. `is_lps`
    /// states that the world frame is LPS.
    #[new]
    fn new(
        array: &Bound<'_, PyAny>,
        dtype: &str,
        spacing: [f64; 3],
        origin: [f64; 3],
        axes: [[f64; 3]; 3],
        is_lps: bool,
    ) -> PyResult<Self> {
        let voxels = match dtype {
            "int8" => Voxels::I8(values(array)?),
            "uint8" => Voxels::U8(values(array)?),
            "int16" => Voxels::I16(values(array)?),
            "uint16" => Voxels::U16(values(array)?),
            "int32" => Voxels::I32(values(array)?),
            "uint32" => Voxels::U32(values(array)?),
            "int64" => Voxels::I64(values(array)?),
            "uint64" => Voxels::U64(values(array)?),
            "float32" => Voxels::F32(values(array)?),
            "float64" => Voxels::F64(values(array)?),
            _ => return Err(PyTypeError::new_err(format!("arrays of {dtype} are not supported"))),
        };
        let shape: Vec<usize> = array.getattr("shape")?.extract()?;
        let size =
            <[usize; 3]>::try_from(shape).map_err(|_| PyValueError::new_err("the array must have three axes"))?;
        let geometry = Geometry {
            size,
            spacing: DVec3::from_array(spacing),
            directions: DMat3::from_cols_array_2d(&axes),
            origin: DVec3::from_array(origin),
            space: if is_lps { Space::Lps } else { Space::Unnamed },
        };
        Ok(Self(Mutex::new(Some(isoparticles_volume::Volume::new(geometry, voxels)))))
    }
}

impl Volume {
    /// Takes the volume out.
    pub(crate) fn take(&self) -> PyResult<isoparticles_volume::Volume> {
        let volume = self.0.lock().unwrap_or_else(PoisonError::into_inner).take();
        volume.ok_or_else(|| PyValueError::new_err("this volume has been used"))
    }
}

fn values<T: Element>(array: &Bound<'_, PyAny>) -> PyResult<Vec<T>> {
    PyBuffer::<T>::get(array)?.to_fortran_vec(array.py())
}

/// Returns the hash of a volume that has no file: of its type, its geometry and its values.
pub(crate) fn hash(volume: &isoparticles_volume::Volume) -> std::io::Result<String> {
    hash_written(|hasher| {
        let (geometry, voxels) = (&volume.geometry, &volume.voxels);
        write!(hasher, "{}\n{}\n", voxels.type_name(), serde_json::json!(geometry))?;
        voxels.write_to(hasher, Endian::Little)
    })
}
