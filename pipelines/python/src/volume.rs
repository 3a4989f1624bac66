//! Volumes from NumPy arrays, and from masks.

use crate::arrays::compute;
use crate::errors::raised;
use glam::{DMat3, DVec3};
use isoparticles_stage::history::{History, hash_written};
use isoparticles_volume::masks::join_masks;
use isoparticles_volume::{Endian, Geometry, LayerLabel, Segment, Space, Voxels, read_volume, write_volume};
use pyo3::buffer::{Element, PyBuffer};
use pyo3::exceptions::{PyTypeError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::PyIterator;
use std::path::PathBuf;
use std::sync::{Mutex, PoisonError};

/// A volume. A stage takes the voxels out, so each volume can be used once.
#[pyclass(frozen, module = "isoparticles._native")]
pub(crate) struct Volume(Mutex<Option<isoparticles_volume::Volume>>);

#[pymethods]
impl Volume {
    /// Copies an array whose axes are x, y and z. `slabs` returns its parts along z, in order. The
    /// caller has checked the geometry: `spacing` and `origin` are in mm, and `axes` contains the
    /// unit vectors of the three axes. `space` is the world frame: `lps`, `ras` or none.
    #[new]
    fn new(
        slabs: &Bound<'_, PyIterator>,
        dtype: &str,
        size: [usize; 3],
        spacing: [f64; 3],
        origin: [f64; 3],
        axes: [[f64; 3]; 3],
        space: Option<&str>,
    ) -> PyResult<Self> {
        let count = size.iter().product();
        let voxels = match dtype {
            "int8" => Voxels::I8(values(slabs, count)?),
            "uint8" => Voxels::U8(values(slabs, count)?),
            "int16" => Voxels::I16(values(slabs, count)?),
            "uint16" => Voxels::U16(values(slabs, count)?),
            "int32" => Voxels::I32(values(slabs, count)?),
            "uint32" => Voxels::U32(values(slabs, count)?),
            "int64" => Voxels::I64(values(slabs, count)?),
            "uint64" => Voxels::U64(values(slabs, count)?),
            "float32" => Voxels::F32(values(slabs, count)?),
            "float64" => Voxels::F64(values(slabs, count)?),
            _ => return Err(PyTypeError::new_err(format!("arrays of {dtype} are not supported"))),
        };
        let geometry = Geometry {
            size,
            spacing: DVec3::from_array(spacing),
            directions: DMat3::from_cols_array_2d(&axes),
            origin: DVec3::from_array(origin),
            space: match space {
                Some("lps") => Space::Lps,
                Some("ras") => Space::Ras,
                _ => Space::Unnamed,
            },
        };
        Ok(Self(Mutex::new(Some(isoparticles_volume::Volume::new(geometry, voxels).in_lps()))))
    }

    /// Sets the names of labels.
    fn name_labels(&self, names: Vec<(String, i64)>) -> PyResult<()> {
        let mut volume = self.take()?;
        let named = |(name, label)| Segment { name, at: LayerLabel { layer: 0, label } };
        volume.segments = names.into_iter().map(named).collect();
        self.put(volume);
        Ok(())
    }

    /// Returns the hash of the type, the geometry, the values and the segments.
    fn hash(&self, py: Python<'_>) -> PyResult<String> {
        let volume = self.take()?;
        let (volume, hash) = compute(py, move || {
            let hash = hash(&volume);
            (volume, hash)
        })?;
        self.put(volume);
        Ok(hash?)
    }

    /// Writes the volume as a VTK image, with a history in JSON. The volume is then unusable.
    fn write(&self, py: Python<'_>, path: PathBuf, history: &str) -> PyResult<()> {
        let volume = self.take()?;
        let history: History =
            serde_json::from_str(history).map_err(|error| PyValueError::new_err(error.to_string()))?;
        compute(py, move || write_volume(&path, &volume, &history))?.map_err(|error| raised(py, error.into()))
    }

    /// Joins masks into a label volume whose segments have the given names. A mask is a volume or
    /// the path of one.
    #[staticmethod]
    fn of_masks(py: Python<'_>, masks: Vec<(String, Mask<'_>)>) -> PyResult<Self> {
        let taken = |(name, mask)| match mask {
            Mask::Volume(volume) => volume.get().take().map(|volume| (name, Source::Volume(Box::new(volume)))),
            Mask::Path(path) => Ok((name, Source::Path(path))),
        };
        let masks = masks.into_iter().map(taken).collect::<PyResult<Vec<_>>>()?;
        let read = |(name, source)| match source {
            Source::Volume(volume) => Ok((name, *volume)),
            Source::Path(path) => read_volume(&path).map(|volume| (name, volume)),
        };
        let join = move || join_masks(masks.into_iter().map(read).collect::<Result<_, _>>()?);
        let volume = compute(py, join)?.map_err(|error| raised(py, error.into()))?;
        Ok(Self(Mutex::new(Some(volume))))
    }
}

/// A mask as Python passes it.
#[derive(FromPyObject)]
enum Mask<'py> {
    Volume(Bound<'py, Volume>),
    Path(PathBuf),
}

/// A mask without a reference to Python.
enum Source {
    Volume(Box<isoparticles_volume::Volume>),
    Path(PathBuf),
}

impl Volume {
    /// Takes the volume out.
    pub(crate) fn take(&self) -> PyResult<isoparticles_volume::Volume> {
        let volume = self.0.lock().unwrap_or_else(PoisonError::into_inner).take();
        volume.ok_or_else(|| PyValueError::new_err("this volume has been used"))
    }

    fn put(&self, volume: isoparticles_volume::Volume) {
        *self.0.lock().unwrap_or_else(PoisonError::into_inner) = Some(volume);
    }
}

fn values<T: Element + Default>(slabs: &Bound<'_, PyIterator>, count: usize) -> PyResult<Vec<T>> {
    let mut values = vec![T::default(); count];
    let mut rest = values.as_mut_slice();
    for slab in slabs {
        let buffer = PyBuffer::<T>::get(&slab?)?;
        let (own, after) = rest.split_at_mut(buffer.item_count().min(rest.len()));
        buffer.copy_to_fortran_slice(slabs.py(), own)?;
        rest = after;
    }
    Ok(values)
}

/// Returns the hash of a volume that has no file: of its type, its geometry, its values and its
/// segments.
pub(crate) fn hash(volume: &isoparticles_volume::Volume) -> std::io::Result<String> {
    hash_written(|hasher| {
        let (geometry, voxels) = (&volume.geometry, &volume.voxels);
        write!(hasher, "{}\n{}\n", voxels.type_name(), serde_json::json!(geometry))?;
        std::iter::once(voxels)
            .chain(&volume.more_layers)
            .try_for_each(|layer| layer.write_to(hasher, Endian::Little))?;
        volume.segments.iter().try_for_each(|segment| writeln!(hasher, "{}", serde_json::json!(segment)))
    })
}
