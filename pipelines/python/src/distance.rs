//! The distance field of one object or of many materials, and quadratic tetrahedra whose nodes lie
//! on its interfaces, for `tetmesh-check`. Positions are arrays of shape `(n, 3)` in mm, in LPS if
//! the field has an anatomical frame.

use crate::arrays::{Array, cells, compute, indices, points, values};
use crate::errors::raised;
use glam::DVec3;
use isoparticles_field::materials::{Indicators, MOST_MATERIALS, MaterialId, Object};
use isoparticles_field::spline::CubicSpline;
use isoparticles_mesh::tetrahedra::quadratic::{self, Meeting, Quadratic, meetings};
use isoparticles_stage::distance_field::DistanceField as Stored;
use isoparticles_stage::error::{Error, Result};
use isoparticles_volume::{Geometry, Space};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use rayon::prelude::*;
use serde_json::json;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Distance from an interface at which a projection ends, in voxels: less than a tenth of the error
/// of the spline for a ball with a radius of ten voxels (1.6e-5).
const TOLERANCE: f64 = 1e-6;

type Argument<'a, 'py> = &'a Bound<'py, PyAny>;

/// The indicators of many materials, or of one object (1) and the outside (0).
#[pyclass(frozen, module = "isoparticles._native")]
pub(crate) struct DistanceField {
    functions: Arc<Functions>,
    /// Names of the materials, starting with the outside; none for one object.
    #[pyo3(get)]
    materials: Vec<String>,
    /// History as JSON.
    #[pyo3(get)]
    history: String,
}

struct Functions {
    geometry: Geometry,
    indicators: Box<dyn Indicators + Send>,
}

#[pymethods]
impl DistanceField {
    /// Reads a file of `distfield` that contains the given positions.
    #[new]
    fn new(py: Python<'_>, path: PathBuf, positions: Argument) -> PyResult<Self> {
        let positions = points(positions)?;
        let read = compute(py, move || {
            let stored = Stored::read(&path)?.in_space(Space::Lps);
            check_reach(&path, stored.geometry(), &positions)?;
            let (materials, history) = (stored.material_names(), json!(stored.history()).to_string());
            let geometry = stored.geometry().clone();
            let indicators: Box<dyn Indicators + Send> = match stored {
                Stored::Object(field) => Box::new(Object(CubicSpline::new(&field.image))),
                Stored::Materials(file) => Box::new(Arc::unwrap_or_clone(file).materials),
            };
            Ok(Self { functions: Arc::new(Functions { geometry, indicators }), materials, history })
        })?;
        read.map_err(|error| raised(py, error))
    }

    /// Returns half the difference of the indicators of two materials, and its gradient.
    fn difference(&self, py: Python<'_>, pair: [u16; 2], positions: Argument) -> PyResult<(Array, Array)> {
        let (functions, positions) = (Arc::clone(&self.functions), points(positions)?);
        compute(py, move || {
            let at = |&p: &DVec3| {
                let [i, j] = pair.map(MaterialId);
                let (value, gradient) =
                    functions.indicators.difference_gradient(i, j, functions.geometry.world_to_grid(p));
                (value, functions.geometry.directions * gradient)
            };
            let (values, gradients): (Vec<f64>, Vec<DVec3>) = positions.par_iter().map(at).unzip();
            (Array::column(&values), Array::points(&gradients))
        })
    }

    /// Moves positions to where the materials meet, each by at most its limit. Returns the
    /// positions and whether each has arrived; the others do not move.
    fn project(
        &self,
        py: Python<'_>,
        materials: Vec<u32>,
        positions: Argument,
        limits: Argument,
    ) -> PyResult<(Array, Array)> {
        let (functions, positions, limits) = (Arc::clone(&self.functions), points(positions)?, values::<f64>(limits)?);
        if limits.len() != positions.len() {
            return Err(PyValueError::new_err("each position must have a limit"));
        }
        compute(py, move || {
            let found = positions.par_iter().zip(&limits).map(|(&p, &limit)| functions.project(&materials, p, limit));
            let found: Vec<Option<DVec3>> = found.collect();
            let moved: Vec<DVec3> = positions.iter().zip(&found).map(|(&p, found)| found.unwrap_or(p)).collect();
            (Array::points(&moved), Array::column(&found.iter().map(Option::is_some).collect::<Vec<_>>()))
        })
    }

    /// Places a node on each edge of tetrahedra. `inside` and `outside` are the materials on both
    /// sides of each triangle. The nodes of its edges are moved to where these materials meet,
    /// unless both are the same: such a triangle stays flat.
    fn quadratic(
        &self,
        py: Python<'_>,
        points: Argument,
        tetrahedra: Argument,
        triangles: Argument,
        inside: Argument,
        outside: Argument,
    ) -> PyResult<Curved> {
        let points = self::points(points)?;
        let (tetrahedra, triangles) = (cells(tetrahedra, points.len())?, cells(triangles, points.len())?);
        let (inside, outside) = (indices(inside, MOST_MATERIALS)?, indices(outside, MOST_MATERIALS)?);
        if [inside.len(), outside.len()] != [triangles.len(); 2] {
            return Err(PyValueError::new_err("each triangle must have a material on both sides"));
        }
        let sides = inside.into_iter().zip(outside);
        let between: Vec<Option<[u32; 2]>> = sides.map(|(a, b)| (a != b).then_some([a, b])).collect();
        let functions = Arc::clone(&self.functions);
        compute(py, move || {
            let project = |own: &[u32], p, limit| functions.project(own, p, limit);
            let found = Quadratic::new(&points, &tetrahedra, &triangles, &between, project);
            Curved::new(&found, &points, &meetings(&triangles, &between), &functions)
        })
    }
}

impl Functions {
    /// Moves a world position to where materials meet, by at most `limit`.
    fn project(&self, own: &[u32], p: DVec3, limit: f64) -> Option<DVec3> {
        let start = self.geometry.world_to_grid(p);
        let tolerance = TOLERANCE * self.indicators.voxel();
        let found = self.indicators.project_onto_meeting(&ids(own), start, limit, tolerance);
        found.filter(|&p| self.geometry.holds(p)).map(|p| self.geometry.grid_to_world(p))
    }

    /// Returns the distances of positions from where materials meet, except where they are not
    /// known.
    fn distances(&self, positions: &[DVec3], meetings: &[Meeting]) -> Array {
        let at = |(n, own): &Meeting| {
            let grid = self.geometry.world_to_grid(positions[*n as usize]);
            self.indicators.distance_from_meeting(&ids(own), grid)
        };
        Array::column(&meetings.par_iter().map(at).filter(|distance| distance.is_finite()).collect::<Vec<_>>())
    }
}

fn ids(materials: &[u32]) -> Vec<MaterialId> {
    materials.iter().map(|&id| MaterialId(id as u16)).collect()
}

/// Returns an error if a grid is two-dimensional or does not contain all positions.
fn check_reach(path: &Path, geometry: &Geometry, positions: &[DVec3]) -> Result<()> {
    let refuse =
        |what, why: &str| Err(Error::of_file(path, what, why, "give the file that distfield wrote for this surface"));
    if geometry.size.contains(&1) {
        return refuse(format!("is two-dimensional ({:?} voxels)", geometry.size), "the surface is three-dimensional");
    }
    let index = |&p: &DVec3| geometry.grid_to_index(geometry.world_to_grid(p));
    let empty = (DVec3::INFINITY, DVec3::NEG_INFINITY);
    let (low, high) = positions.iter().map(index).fold(empty, |(low, high), p| (low.min(p), high.max(p)));
    let last = DVec3::from_array(geometry.size.map(|count| count as f64 - 1.0));
    // the border of the volume is half a voxel beyond the outermost voxel centres
    if low.cmplt(DVec3::splat(-0.5)).any() || high.cmpgt(last + 0.5).any() {
        return refuse(
            format!("the surface reaches beyond this field (voxels {low:.1} to {high:.1} of {:?})", geometry.size),
            "F is not known there, so they do not belong together",
        );
    }
    Ok(())
}

/// Tetrahedra with a node on each edge.
#[derive(IntoPyObject)]
pub(crate) struct Curved {
    /// Positions of the nodes.
    nodes: Array,
    /// The nodes of each tetrahedron, in VTK order.
    of_cells: Array,
    /// The nodes of each triangle.
    of_triangles: Array,
    /// Number of nodes that should lie on an interface.
    surface_nodes: usize,
    /// Number of these nodes that should lie on a junction curve.
    curve_nodes: usize,
    /// Number of the surface nodes that were moved back so that no element folds.
    drawn_back: usize,
    /// Number of the surface nodes that could not be moved onto their interface.
    not_reached: usize,
    /// Lower bound of the Jacobian of each element, relative to that of the straight tetrahedron.
    jacobian: Array,
    /// Number of elements whose Jacobian may not be positive everywhere.
    folded: usize,
    /// Volume of each element, mm^3.
    volumes: Array,
    /// Volume of each straight tetrahedron, mm^3.
    straight_volumes: Array,
    /// Distances from the interfaces of the vertices, midpoints and nodes that should lie on them.
    vertex_distances: Array,
    midpoint_distances: Array,
    node_distances: Array,
}

impl Curved {
    fn new(found: &Quadratic, points: &[DVec3], vertices: &[Meeting], functions: &Functions) -> Self {
        Self {
            nodes: Array::points(&found.nodes),
            of_cells: Array::cells(&found.of_cells),
            of_triangles: Array::cells(&found.of_triangles),
            surface_nodes: found.on_surface.len(),
            curve_nodes: found.on_surface.iter().filter(|(_, own)| own.len() > 2).count(),
            drawn_back: found.drawn_back,
            not_reached: found.not_reached,
            folded: found.folded(),
            jacobian: Array::column(&found.jacobian),
            volumes: Array::column(&found.volumes),
            straight_volumes: Array::column(&found.straight_volumes),
            vertex_distances: functions.distances(points, vertices),
            midpoint_distances: functions.distances(&found.midpoints, &found.on_surface),
            node_distances: functions.distances(&found.nodes, &found.on_surface),
        }
    }
}

/// Returns the Bezier coefficients of the Jacobian of quadratic tetrahedra, shape `(m, 20)`.
/// `nodes` contains their ten nodes in VTK order, shape `(10 m, 3)`.
#[pyfunction]
pub(crate) fn jacobian_coefficients(py: Python<'_>, nodes: Argument) -> PyResult<Array> {
    let nodes = points(nodes)?;
    compute(py, move || {
        let of_element = |own: &[DVec3; 10]| {
            let [a, b, c, d, ref middles @ ..] = *own;
            quadratic::jacobian_coefficients([a, b, c, d], *middles)
        };
        Array::rows(&nodes.as_chunks().0.iter().map(of_element).collect::<Vec<_>>())
    })
}
