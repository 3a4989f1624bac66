//! Fields on grids, evaluated at world positions, and the meshes that need them, for
//! `tetmesh-check`. Positions are arrays of shape `(n, 3)` in mm.

use crate::arrays::{Array, cells, compute, mesh, points, values};
use crate::errors::raised;
use glam::{DMat3, DVec3};
use isoparticles_field::background::{BackgroundMesh, WorldGrid};
use isoparticles_field::overlap::overlaps;
use isoparticles_field::sizing::SizingField;
use isoparticles_field::spline::{CubicSpline, distance_estimate};
use isoparticles_mesh::tetrahedra::quadratic::{self, Quadratic};
use isoparticles_survey::input::{InputArgs, Spacing};
use isoparticles_volume::{Geometry, Image, Space};
use pyo3::buffer::{Element, PyBuffer};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use rayon::prelude::*;
use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::{Arc, OnceLock};

/// Distance from F = 0 at which a projection ends, in voxels: less than a tenth of the error of the
/// spline for a ball with a radius of ten voxels (1.6e-5).
const TOLERANCE: f64 = 1e-6;

/// Numbers at the nodes of a grid.
#[pyclass(frozen, module = "isoparticles._native")]
pub(crate) struct GridField(Arc<Samples>);

struct Samples {
    field: SizingField,
    /// The spline through the numbers, computed on first use.
    spline: OnceLock<CubicSpline>,
}

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
        let field = SizingField::new(Image { geometry, data });
        Ok(Self(Arc::new(Samples { field, spline: OnceLock::new() })))
    }

    /// Geometric mean of the spacings, mm.
    #[getter]
    fn voxel(&self) -> f64 {
        self.0.field.image().geometry.mean_spacing()
    }

    /// Interpolates trilinearly, and clamps positions to the grid.
    fn trilinear(&self, py: Python<'_>, positions: &Bound<'_, PyAny>) -> PyResult<Array> {
        let (samples, positions) = (Arc::clone(&self.0), points(positions)?);
        compute(py, move || {
            let geometry = &samples.field.image().geometry;
            let at = |&p: &DVec3| samples.field.at(geometry.world_to_grid(p));
            Array::column(&positions.par_iter().map(at).collect::<Vec<_>>())
        })
    }

    /// Returns the values and the gradients of the cubic B-spline.
    fn spline(&self, py: Python<'_>, positions: &Bound<'_, PyAny>) -> PyResult<(Array, Array)> {
        let (samples, positions) = (Arc::clone(&self.0), points(positions)?);
        compute(py, move || {
            let spline = samples.spline();
            let at = |&p: &DVec3| {
                let (value, gradient) = spline.value_gradient(spline.geometry().world_to_grid(p));
                (value, spline.geometry().directions * gradient)
            };
            let (values, gradients): (Vec<f64>, Vec<DVec3>) = positions.par_iter().map(at).unzip();
            (Array::column(&values), Array::points(&gradients))
        })
    }

    /// Moves positions onto the zero set of the spline, each by at most its limit. Returns the
    /// positions and whether each has arrived; the others do not move.
    fn project(
        &self,
        py: Python<'_>,
        positions: &Bound<'_, PyAny>,
        limits: &Bound<'_, PyAny>,
    ) -> PyResult<(Array, Array)> {
        let (samples, positions, limits) = (Arc::clone(&self.0), points(positions)?, values::<f64>(limits)?);
        compute(py, move || {
            let spline = samples.spline();
            let found = positions.par_iter().zip(&limits).map(|(&p, &limit)| project(spline, p, limit));
            let found: Vec<Option<DVec3>> = found.collect();
            let moved: Vec<DVec3> = positions.iter().zip(&found).map(|(&p, found)| found.unwrap_or(p)).collect();
            (Array::points(&moved), Array::column(&found.iter().map(Option::is_some).collect::<Vec<_>>()))
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
        let (samples, positions) = (Arc::clone(&self.0), points(positions)?);
        compute(py, move || {
            let grid = WorldGrid::new(&samples.field, &positions, max_nodes);
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
        let (samples, surface) = (Arc::clone(&self.0), mesh(points, triangles)?);
        compute(py, move || {
            let found = BackgroundMesh::new(&samples.field, &surface, max_nodes);
            let (points, cells) = (Array::points(&found.points), Array::cells(&found.cells));
            (points, cells, Array::column(&found.values), found.stride)
        })
    }

    /// Places a node on each edge of tetrahedra. `curved` states which triangles of the boundary
    /// lie on the zero set of the spline; the nodes of their edges are moved onto it.
    fn quadratic(
        &self,
        py: Python<'_>,
        points: &Bound<'_, PyAny>,
        tetrahedra: &Bound<'_, PyAny>,
        boundary: &Bound<'_, PyAny>,
        curved: &Bound<'_, PyAny>,
    ) -> PyResult<Curved> {
        let points = self::points(points)?;
        let (tetrahedra, boundary) = (cells(tetrahedra, points.len())?, cells(boundary, points.len())?);
        let curved: Vec<bool> = values::<u8>(curved)?.into_iter().map(|curved| curved != 0).collect();
        let samples = Arc::clone(&self.0);
        compute(py, move || {
            let spline = samples.spline();
            let found = Quadratic::new(&points, &tetrahedra, &boundary, &curved, |p, limit| project(spline, p, limit));
            let on_surface = boundary.iter().zip(&curved).filter(|own| *own.1).flat_map(|own| *own.0);
            let mut on_surface: Vec<u32> = on_surface.collect();
            on_surface.sort_unstable();
            on_surface.dedup();
            Curved::new(&found, &points, &on_surface, spline)
        })
    }
}

impl Samples {
    fn spline(&self) -> &CubicSpline {
        self.spline.get_or_init(|| CubicSpline::new(self.field.image()))
    }
}

/// Moves a world position onto the zero set of a spline, by at most `limit`.
fn project(spline: &CubicSpline, p: DVec3, limit: f64) -> Option<DVec3> {
    let geometry = spline.geometry();
    let found = spline.project(geometry.world_to_grid(p), limit, TOLERANCE * spline.voxel());
    found.map(|p| geometry.grid_to_world(p))
}

/// Tetrahedra with a node on each edge.
#[derive(IntoPyObject)]
pub(crate) struct Curved {
    /// Positions of the nodes.
    nodes: Array,
    /// The nodes of each tetrahedron, in VTK order.
    of_cells: Array,
    /// The nodes of each triangle of the boundary.
    of_triangles: Array,
    /// Number of nodes that should lie on the surface.
    surface_nodes: usize,
    /// Number of these nodes that were moved back so that no element folds.
    drawn_back: usize,
    /// Number of these nodes that are too far from the surface.
    too_far: usize,
    /// Lower bound of the Jacobian of each element, relative to that of the straight tetrahedron.
    jacobian: Array,
    /// Number of elements whose Jacobian may not be positive everywhere.
    folded: usize,
    /// Volume of the elements, mm^3.
    volume: f64,
    /// Volume of the straight tetrahedra, mm^3.
    straight_volume: f64,
    /// Distances from the surface of the vertices, midpoints and nodes that should lie on it.
    vertex_distances: Array,
    midpoint_distances: Array,
    node_distances: Array,
}

impl Curved {
    fn new(found: &Quadratic, points: &[DVec3], on_surface: &[u32], spline: &CubicSpline) -> Self {
        let distances = |positions: &[DVec3], chosen: &[u32]| {
            let at = |&n: &u32| {
                let (value, gradient) = spline.value_gradient(spline.geometry().world_to_grid(positions[n as usize]));
                distance_estimate(value, gradient).abs()
            };
            Array::column(&chosen.par_iter().map(at).collect::<Vec<_>>())
        };
        Self {
            nodes: Array::points(&found.nodes),
            of_cells: Array::cells(&found.of_cells),
            of_triangles: Array::cells(&found.of_triangles),
            surface_nodes: found.on_surface.len(),
            drawn_back: found.drawn_back,
            too_far: found.too_far,
            folded: found.folded(),
            jacobian: Array::column(&found.jacobian),
            volume: found.volumes.iter().sum(),
            straight_volume: found.straight_volumes.iter().sum(),
            vertex_distances: distances(points, on_surface),
            midpoint_distances: distances(&found.midpoints, &found.on_surface),
            node_distances: distances(&found.nodes, &found.on_surface),
        }
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

/// Returns the Bezier coefficients of the Jacobian of quadratic tetrahedra, shape `(m, 20)`.
/// `nodes` contains their ten nodes in VTK order, shape `(10 m, 3)`.
#[pyfunction]
pub(crate) fn jacobian_coefficients(py: Python<'_>, nodes: &Bound<'_, PyAny>) -> PyResult<Array> {
    let nodes = points(nodes)?;
    compute(py, move || {
        let of_element = |own: &[DVec3; 10]| {
            let [a, b, c, d, ref middles @ ..] = *own;
            quadratic::jacobian_coefficients([a, b, c, d], *middles)
        };
        Array::rows(&nodes.as_chunks().0.iter().map(of_element).collect::<Vec<_>>())
    })
}
