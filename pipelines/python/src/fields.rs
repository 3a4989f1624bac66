//! Numbers on grids, evaluated at world positions, and the meshes that need them, for
//! `tetmesh-check`. Positions are arrays of shape `(n, 3)` in mm.

use crate::arrays::{Array, cells, compute, mesh, points};
use crate::errors::raised;
use glam::{DMat3, DVec3};
use isoparticles_field::background::{BackgroundMesh, WorldGrid};
use isoparticles_field::overlap::overlaps;
use isoparticles_field::sizing::SizingField;
use isoparticles_survey::input::{InputArgs, Spacing};
use isoparticles_volume::{Geometry, Image, Space};
use pyo3::buffer::{Element, PyBuffer};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use rayon::prelude::*;
use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::Arc;

/// Numbers at the nodes of a grid.
#[pyclass(frozen, module = "isoparticles._native")]
pub(crate) struct GridField(Arc<SizingField>);

#[pymethods]
impl GridField {
    /// Copies an array of type `float32` with the axes x, y and z. `axes` contains the unit vectors
    /// of the axes.
    #[new]
    fn new(array: &Bound<'_, PyAny>, spacing: [f64; 3], origin: [f64; 3], axes: [[f64; 3]; 3]) -> PyResult<Self> {
        let (geometry, data) = grid(array, spacing, origin, axes)?;
        if geometry.size.iter().any(|&count| count < 2) {
            return Err(PyValueError::new_err("the array must have two nodes or more along each axis"));
        }
        Ok(Self(Arc::new(SizingField::new(Image { geometry, data }))))
    }

    /// Geometric mean of the spacings, mm.
    #[getter]
    fn voxel(&self) -> f64 {
        self.0.image().geometry.mean_spacing()
    }

    /// Interpolates trilinearly, and clamps positions to the grid.
    fn trilinear(&self, py: Python<'_>, positions: &Bound<'_, PyAny>) -> PyResult<Array> {
        let (field, positions) = (Arc::clone(&self.0), points(positions)?);
        compute(py, move || {
            let geometry = &field.image().geometry;
            let at = |&p: &DVec3| field.at(geometry.world_to_grid(p));
            Array::column(&positions.par_iter().map(at).collect::<Vec<_>>())
        })
    }

    /// Samples the field on a grid along the world axes. Returns the values, the position of the
    /// first node, and the distance of adjacent nodes.
    fn world_grid(
        &self,
        py: Python<'_>,
        positions: &Bound<'_, PyAny>,
        max_nodes: usize,
    ) -> PyResult<(Array, [f64; 3], f64)> {
        let (field, positions) = (Arc::clone(&self.0), points(positions)?);
        compute(py, move || {
            let grid = WorldGrid::new(&field, &positions, max_nodes);
            (Array::column(&grid.values).shaped(&grid.size), grid.origin.to_array(), grid.spacing)
        })
    }

    /// Covers a closed surface with tetrahedra. Returns their points, their vertices, the field at
    /// the points, and the distance between adjacent points in voxels.
    fn background(
        &self,
        py: Python<'_>,
        points: &Bound<'_, PyAny>,
        triangles: &Bound<'_, PyAny>,
        max_nodes: usize,
    ) -> PyResult<(Array, Array, Array, usize)> {
        let (field, surface) = (Arc::clone(&self.0), mesh(points, triangles)?);
        compute(py, move || {
            let found = BackgroundMesh::new(&field, &surface, max_nodes);
            let (points, cells) = (Array::points(&found.points), Array::cells(&found.cells));
            (points, cells, Array::column(&found.values), found.stride)
        })
    }
}

/// A volume as read from a file.
#[derive(IntoPyObject)]
pub(crate) struct VolumeFile {
    /// Voxels of the first layer, in the type of the file, with the axes z, y and x.
    values: Array,
    spacing: [f64; 3],
    /// World position of the first voxel, mm.
    origin: [f64; 3],
    /// Unit vectors of the axes, which may be oblique.
    axes: [[f64; 3]; 3],
    /// Names of the labels of the first layer.
    names: BTreeMap<i64, String>,
    layers: usize,
    /// Whether the world frame is LPS.
    is_lps: bool,
}

/// Reads a volume in any format that `distfield` reads. `series` selects a series of a folder of
/// DICOM slices. `spacing` is the spacing of a file that does not contain it, mm.
#[pyfunction]
#[pyo3(signature = (path, series=None, spacing=None))]
pub(crate) fn read_volume(
    py: Python<'_>,
    path: PathBuf,
    series: Option<String>,
    spacing: Option<[f64; 3]>,
) -> PyResult<VolumeFile> {
    let input = InputArgs { path, series, spacing: spacing.map(Spacing), ..InputArgs::default() };
    let volume = compute(py, move || input.read())?.map_err(|error| raised(py, error))?;
    let geometry = &volume.geometry;
    let named = volume.segments.iter().filter(|segment| segment.at.layer == 0);
    Ok(VolumeFile {
        values: Array::voxels(&volume.voxels, geometry.size)?,
        spacing: geometry.spacing.to_array(),
        origin: geometry.origin.to_array(),
        axes: geometry.directions.to_cols_array_2d(),
        names: named.map(|segment| (segment.at.label, segment.name.clone())).collect(),
        layers: volume.layer_count(),
        is_lps: geometry.space == Space::Lps,
    })
}

/// Returns the label at each position: that of its voxel, or of the nearest voxel with a wanted
/// label. Without `wanted`, all labels but 0 are wanted. `labels` is an array of type `int32` with
/// the axes x, y and z, and `step` contains the vectors from a voxel to the next along each axis.
#[pyfunction]
pub(crate) fn labels_at(
    py: Python<'_>,
    labels: &Bound<'_, PyAny>,
    step: [[f64; 3]; 3],
    origin: [f64; 3],
    positions: &Bound<'_, PyAny>,
    wanted: Option<Vec<i32>>,
) -> PyResult<Array> {
    let (geometry, data) = stepped_grid(labels, step, origin)?;
    let (labels, positions) = (Image { geometry, data }, points(positions)?);
    compute(py, move || {
        let is_wanted = |label: i32| wanted.as_ref().map_or(label != 0, |wanted| wanted.contains(&label));
        let found = isoparticles_field::label_lookup::labels_at(&labels, is_wanted, &positions);
        Array::column(&found.into_iter().map(i64::from).collect::<Vec<_>>())
    })
}

/// Returns the mean of an image over each tetrahedron, and the share of the tetrahedron that lies
/// inside the image. `image` is an array of type `float32` on a grid as in [`labels_at`].
#[pyfunction]
pub(crate) fn tetrahedron_means(
    py: Python<'_>,
    image: &Bound<'_, PyAny>,
    step: [[f64; 3]; 3],
    origin: [f64; 3],
    points: &Bound<'_, PyAny>,
    tetrahedra: &Bound<'_, PyAny>,
) -> PyResult<(Array, Array)> {
    let (geometry, data) = stepped_grid(image, step, origin)?;
    let (image, points) = (Image { geometry, data }, self::points(points)?);
    let tetrahedra = cells(tetrahedra, points.len())?;
    compute(py, move || {
        let found = overlaps(&image, &points, &tetrahedra);
        let (means, shares): (Vec<f64>, Vec<f64>) = found.iter().map(|own| (own.mean, own.share)).unzip();
        (Array::column(&means), Array::column(&shares))
    })
}

/// Copies an array of numbers on a grid. `step` contains, for each axis, the vector between
/// adjacent voxels.
fn stepped_grid<T: Element>(
    array: &Bound<'_, PyAny>,
    step: [[f64; 3]; 3],
    origin: [f64; 3],
) -> PyResult<(Geometry, Vec<T>)> {
    let step = DMat3::from_cols_array_2d(&step);
    let spacing = DVec3::new(step.x_axis.length(), step.y_axis.length(), step.z_axis.length());
    let axes = (step * DMat3::from_diagonal(spacing.recip())).to_cols_array_2d();
    grid(array, spacing.to_array(), origin, axes)
}

/// Copies an array of numbers on a grid with the axes x, y and z.
fn grid<T: Element>(
    array: &Bound<'_, PyAny>,
    spacing: [f64; 3],
    origin: [f64; 3],
    axes: [[f64; 3]; 3],
) -> PyResult<(Geometry, Vec<T>)> {
    let buffer = PyBuffer::<T>::get(array)?;
    let size =
        <[usize; 3]>::try_from(buffer.shape()).map_err(|_| PyValueError::new_err("the array must have three axes"))?;
    let geometry = Geometry {
        size,
        spacing: DVec3::from_array(spacing),
        directions: DMat3::from_cols_array_2d(&axes),
        origin: DVec3::from_array(origin),
        space: Space::Unnamed,
    };
    Ok((geometry, buffer.to_fortran_vec(array.py())?))
}
