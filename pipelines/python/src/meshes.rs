//! Checks and measures of triangle meshes, complexes and tetrahedra, for `tetmesh-check`.
//!
//! Points are arrays of shape `(n, 3)` in mm, and cells are arrays of vertex indices of shape
//! `(m, 3)` or `(m, 4)`.

use crate::arrays::{Array, cells, compute, indices, mesh, points, values};
use glam::DVec3;
use isoparticles_mesh::complex::{Complex, MaterialSummary};
use isoparticles_mesh::difference::differing_triangles;
use isoparticles_mesh::nearest::{self, sampled_distances};
use isoparticles_mesh::nesting::nest;
use isoparticles_mesh::quality::{angles, area, mean, percentile, radius_ratio, zero_area_triangles};
use isoparticles_mesh::tetrahedra::faces::boundary;
use isoparticles_mesh::tetrahedra::quality::{TetrahedronQuality, qualities};
use isoparticles_mesh::topology::{Topology, analyse, duplicate_triangles};
use isoparticles_mesh::{TriangleMesh, intersect};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use rayon::prelude::*;
use std::collections::BTreeMap;

type Argument<'a, 'py> = &'a Bound<'py, PyAny>;

/// Returns the area, radius ratio, minimum and maximum angle (degrees) and mean edge length of each
/// triangle.
#[pyfunction]
pub(crate) fn triangle_quality(py: Python<'_>, points: Argument, triangles: Argument) -> PyResult<[Array; 5]> {
    let mesh = mesh(points, triangles)?;
    compute(py, move || {
        let measures = |t: usize| {
            let [a, b, c] = mesh.corners(t);
            let angles = angles(a, b, c);
            let smallest = angles.into_iter().fold(f64::NAN, f64::min);
            let largest = angles.into_iter().fold(f64::NAN, f64::max);
            let edge_length = (a.distance(b) + b.distance(c) + c.distance(a)) / 3.0;
            [area(a, b, c), radius_ratio(a, b, c), smallest, largest, edge_length]
        };
        Array::columns(&(0..mesh.triangles.len()).into_par_iter().map(measures).collect::<Vec<_>>())
    })
}

/// Returns the volume, radius ratio, scaled Jacobian, minimum and maximum dihedral angle (degrees),
/// aspect ratio, edge ratio and mean edge length of each tetrahedron.
#[pyfunction]
pub(crate) fn tetrahedron_quality(py: Python<'_>, points: Argument, tetrahedra: Argument) -> PyResult<[Array; 8]> {
    let points = self::points(points)?;
    let tetrahedra = cells::<4>(tetrahedra, points.len())?;
    compute(py, move || {
        let measures = qualities(&points, &tetrahedra).into_iter().map(|own| {
            [
                own.volume,
                own.radius_ratio,
                own.scaled_jacobian,
                own.min_dihedral,
                own.max_dihedral,
                own.aspect_ratio,
                own.edge_ratio,
                own.edge_length,
            ]
        });
        Array::columns(&measures.collect::<Vec<_>>())
    })
}

/// Returns the signed volume of each tetrahedron.
#[pyfunction]
pub(crate) fn tetrahedron_volumes(py: Python<'_>, points: Argument, tetrahedra: Argument) -> PyResult<Array> {
    let points = self::points(points)?;
    let tetrahedra = cells::<4>(tetrahedra, points.len())?;
    let volume = move |cell: &[u32; 4]| TetrahedronQuality::of(&cell.map(|v| points[v as usize])).volume;
    compute(py, move || Array::column(&tetrahedra.par_iter().map(volume).collect::<Vec<_>>()))
}

/// The percentiles that a summary contains.
const PERCENTILES: [u8; 9] = [1, 5, 10, 25, 50, 75, 90, 95, 99];

/// Returns statistics of numbers, with a histogram if its ascending edges are given. Numbers that
/// are not finite are only counted.
#[pyfunction]
#[pyo3(signature = (numbers, edges=None))]
pub(crate) fn summarize<'py>(
    py: Python<'py>,
    numbers: Argument,
    edges: Option<Vec<f64>>,
) -> PyResult<Bound<'py, PyDict>> {
    let numbers: Vec<f64> = values(numbers)?;
    let count = numbers.len();
    let (finite, mean) = compute(py, move || {
        let mut finite: Vec<f64> = numbers.into_iter().filter(|value| value.is_finite()).collect();
        let mean = mean(&finite);
        finite.par_sort_unstable_by(f64::total_cmp);
        (finite, mean)
    })?;
    let summary = PyDict::new(py);
    summary.set_item("count", count)?;
    summary.set_item("infinite", count - finite.len())?;
    let [Some(min), Some(max)] = [finite.first(), finite.last()] else { return Ok(summary) };
    for (name, value) in [("min", *min), ("max", *max), ("mean", mean), ("median", percentile(&finite, 50.0))] {
        summary.set_item(name, value)?;
    }
    let percentiles = PyDict::new(py);
    for percent in PERCENTILES {
        percentiles.set_item(format!("p{percent}"), percentile(&finite, percent.into()))?;
    }
    summary.set_item("percentiles", percentiles)?;
    if let Some(edges) = edges {
        // the last bin includes its upper edge
        let below = |edge: f64, last: bool| finite.partition_point(|&value| value < edge || last && value == edge);
        let bins = (1..edges.len()).map(|k| below(edges[k], k + 1 == edges.len()) - below(edges[k - 1], false));
        let histogram = PyDict::new(py);
        histogram.set_item("counts", bins.collect::<Vec<_>>())?;
        histogram.set_item("edges", edges)?;
        summary.set_item("histogram", histogram)?;
    }
    Ok(summary)
}

/// Counts that state whether a triangle mesh is a closed oriented surface.
#[derive(IntoPyObject)]
pub(crate) struct Counts {
    vertices: usize,
    triangles: usize,
    edges: usize,
    unused_vertices: usize,
    open_edges: usize,
    nonmanifold_edges: usize,
    badly_oriented_edges: usize,
    nonmanifold_vertices: usize,
    components: usize,
    euler_characteristic: i64,
}

impl Counts {
    fn of(topology: &Topology, vertices: usize, triangles: usize) -> Self {
        Self {
            vertices,
            triangles,
            edges: topology.edges,
            unused_vertices: topology.unused_vertices.len(),
            open_edges: topology.open_edges.len(),
            nonmanifold_edges: topology.non_manifold_edges.len(),
            badly_oriented_edges: topology.badly_oriented_edges.len(),
            nonmanifold_vertices: topology.non_manifold_vertices.len(),
            components: topology.components.len(),
            euler_characteristic: topology.euler,
        }
    }
}

/// Counts the edges, fans and components of a mesh with this number of vertices.
#[pyfunction]
pub(crate) fn surface_topology(py: Python<'_>, vertices: usize, triangles: Argument) -> PyResult<Counts> {
    let triangles = cells(triangles, vertices)?;
    let mesh = TriangleMesh { vertices: vec![DVec3::ZERO; vertices], triangles };
    compute(py, move || Counts::of(&analyse(&mesh), vertices, mesh.triangles.len()))
}

/// The components of a closed surface.
#[derive(IntoPyObject)]
pub(crate) struct Components {
    /// Component of each triangle.
    labels: Array,
    /// Signed volume of each component.
    volumes: Array,
    /// Number of components that enclose each component.
    depths: Array,
    /// The smallest component that encloses each component, or -1.
    parents: Array,
}

/// Finds the components of a closed surface and their nesting.
#[pyfunction]
pub(crate) fn surface_components(py: Python<'_>, points: Argument, triangles: Argument) -> PyResult<Components> {
    let mesh = mesh(points, triangles)?;
    compute(py, move || {
        let topology = analyse(&mesh);
        let nesting = nest(&mesh, &topology.component_of_triangle, topology.components.len());
        let numbers = |values: Vec<i64>| Array::column(&values);
        Components {
            labels: Array::indices(&topology.component_of_triangle),
            volumes: Array::column(&nesting.measures.iter().map(|measure| measure.volume).collect::<Vec<_>>()),
            depths: numbers(nesting.depths.iter().map(|&depth| depth as i64).collect()),
            parents: numbers(nesting.parents.iter().map(|parent| parent.map_or(-1, i64::from)).collect()),
        }
    })
}

/// Returns the pairs of triangles that intersect outside their common vertices and edges.
#[pyfunction]
pub(crate) fn self_intersections(py: Python<'_>, points: Argument, triangles: Argument) -> PyResult<Array> {
    let mesh = mesh(points, triangles)?;
    compute(py, move || Array::cells(&intersect::self_intersections(&mesh)))
}

/// Returns the number of triangles of the first mesh that the second lacks, and the reverse.
#[pyfunction]
pub(crate) fn changed_triangles(
    py: Python<'_>,
    points: Argument,
    triangles: Argument,
    other_points: Argument,
    other_triangles: Argument,
) -> PyResult<[usize; 2]> {
    let (first, second) = (mesh(points, triangles)?, mesh(other_points, other_triangles)?);
    compute(py, move || differing_triangles(&first, &second))
}

/// Returns the distances from the vertices and centroids of a mesh to another mesh, and the
/// reverse. If a mesh has more than 200,000 of them, only every n-th is used.
#[pyfunction]
pub(crate) fn distances_both_ways(
    py: Python<'_>,
    points: Argument,
    triangles: Argument,
    other_points: Argument,
    other_triangles: Argument,
) -> PyResult<(Array, Array)> {
    let (first, second) = (mesh(points, triangles)?, mesh(other_points, other_triangles)?);
    let both = compute(py, move || sampled_distances(&first, &second).zip(sampled_distances(&second, &first)))?;
    let (there, back) = both.ok_or_else(|| PyValueError::new_err("the mesh has no triangles"))?;
    Ok((Array::column(&there), Array::column(&back)))
}

/// Returns the distances from positions to a mesh.
#[pyfunction]
pub(crate) fn distances_to(
    py: Python<'_>,
    positions: Argument,
    points: Argument,
    triangles: Argument,
) -> PyResult<Array> {
    let (positions, mesh) = (crate::arrays::points(positions)?, mesh(points, triangles)?);
    let nearest = compute(py, move || nearest::nearest_triangles(&mesh, &positions))?;
    let nearest = nearest.ok_or_else(|| PyValueError::new_err("the mesh has no triangles"))?;
    Ok(Array::column(&nearest.into_iter().map(|(_, distance)| distance).collect::<Vec<_>>()))
}

/// Returns a flag for each triangle: the flag, 0 or 1, of the triangle of another mesh that is
/// nearest to its centroid.
#[pyfunction]
pub(crate) fn nearest_flags(
    py: Python<'_>,
    points: Argument,
    triangles: Argument,
    other_points: Argument,
    other_triangles: Argument,
    flags: Argument,
) -> PyResult<Array> {
    let (first, second) = (mesh(points, triangles)?, mesh(other_points, other_triangles)?);
    let flags: Vec<bool> = values::<u8>(flags)?.into_iter().map(|flag| flag != 0).collect();
    if flags.len() != second.triangles.len() {
        return Err(PyValueError::new_err("each triangle of the other mesh must have a flag"));
    }
    compute(py, move || Array::column(&nearest::nearest_flags(&first, &second, &flags)))
}

/// Returns the boundary of tetrahedra with this number of vertices: its triangles, the tetrahedron
/// of each, and the body of each tetrahedron.
#[pyfunction]
pub(crate) fn tetrahedron_boundary(
    py: Python<'_>,
    vertices: usize,
    tetrahedra: Argument,
) -> PyResult<(Array, Array, Array)> {
    let tetrahedra = cells::<4>(tetrahedra, vertices)?;
    compute(py, move || {
        let found = boundary(&tetrahedra, vertices);
        (Array::cells(&found.triangles), Array::indices(&found.owners), Array::indices(&found.bodies))
    })
}

/// Faults of a complex, and the volumes that it bounds.
#[derive(IntoPyObject)]
pub(crate) struct ComplexCheck {
    /// Triangles without area.
    flat: Array,
    /// Triangles with the same vertices as an earlier one.
    duplicates: Array,
    /// Number of edges at which a material is not closed, by material.
    open_edges: BTreeMap<u32, usize>,
    /// Pairs of triangles that intersect.
    crossing: Array,
    /// The volumes, unless one of the lists above has entries.
    shells: Option<Shells>,
}

/// The volumes of a complex.
#[derive(IntoPyObject)]
pub(crate) struct Shells {
    materials: Array,
    sizes: Array,
    of_inside: Array,
    of_outside: Array,
    mixed: usize,
    narrowest: Array,
    inside_out: usize,
}

/// Checks a complex. `inside` and `outside` contain the material on each side of the triangles, all
/// below `materials`.
#[pyfunction]
pub(crate) fn check_complex(
    py: Python<'_>,
    points: Argument,
    triangles: Argument,
    inside: Argument,
    outside: Argument,
    materials: usize,
) -> PyResult<ComplexCheck> {
    let (mesh, between) = complex(points, triangles, inside, outside, materials)?;
    compute(py, move || {
        let (flat, duplicates) = (zero_area_triangles(&mesh), duplicate_triangles(&mesh));
        let is_sound = flat.is_empty() && duplicates.is_empty();
        let complex = is_sound.then(|| Complex::new(&mesh, &between, materials));
        let open_edges = complex.as_ref().map(Complex::open_edges).unwrap_or_default();
        let complex = complex.filter(|_| open_edges.is_empty());
        let crossing = if complex.is_some() { intersect::self_intersections(&mesh) } else { Vec::new() };
        let shells = complex.filter(|_| crossing.is_empty()).map(|complex| complex.shells());
        ComplexCheck {
            flat: Array::indices(&flat),
            duplicates: Array::indices(&duplicates),
            open_edges,
            crossing: Array::cells(&crossing),
            shells: shells.map(|shells| {
                let side = |k: usize| Array::column(&shells.of_triangle.iter().map(|of| of[k]).collect::<Vec<_>>());
                Shells {
                    materials: Array::indices(&shells.materials),
                    sizes: Array::column(&shells.sizes),
                    of_inside: side(0),
                    of_outside: side(1),
                    mixed: shells.mixed,
                    narrowest: Array::column(&shells.narrowest),
                    inside_out: shells.inside_out,
                }
            }),
        }
    })
}

/// Counts and measures of a complex.
#[derive(IntoPyObject)]
pub(crate) struct Description {
    junction_edges: usize,
    junction_vertices: usize,
    edges_by_triangles: BTreeMap<usize, usize>,
    vertices_by_materials: BTreeMap<usize, usize>,
    rms_turn_degrees: Option<f64>,
    /// Topology of the closed surface of each material.
    topologies: BTreeMap<u32, Counts>,
    /// Number of pieces, and root mean square of the turns, of each pair of materials, ascending.
    interfaces: Vec<(usize, Option<f64>)>,
}

/// Counts and measures a complex that [`check_complex`] accepts.
#[pyfunction]
pub(crate) fn describe_complex(
    py: Python<'_>,
    points: Argument,
    triangles: Argument,
    inside: Argument,
    outside: Argument,
    materials: usize,
) -> PyResult<Description> {
    let (mesh, between) = complex(points, triangles, inside, outside, materials)?;
    compute(py, move || {
        let found = Complex::new(&mesh, &between, materials).describe();
        let counts = |own: &MaterialSummary| (own.number, Counts::of(&own.topology, own.vertices, own.triangles));
        Description {
            junction_edges: found.junction_edges,
            junction_vertices: found.junction_vertices,
            edges_by_triangles: found.edges_by_triangles,
            vertices_by_materials: found.vertices_by_materials,
            rms_turn_degrees: found.rms_turn,
            topologies: found.materials.iter().map(counts).collect(),
            interfaces: found.interfaces.iter().map(|own| (own.pieces, own.rms_turn)).collect(),
        }
    })
}

fn complex(
    points: Argument,
    triangles: Argument,
    inside: Argument,
    outside: Argument,
    materials: usize,
) -> PyResult<(TriangleMesh, Vec<[u32; 2]>)> {
    let mesh = mesh(points, triangles)?;
    let between = between(inside, outside, materials, mesh.triangles.len())?;
    Ok((mesh, between))
}

/// Copies the materials on both sides of `triangles` triangles. All must be below `materials`.
pub(crate) fn between(
    inside: Argument,
    outside: Argument,
    materials: usize,
    triangles: usize,
) -> PyResult<Vec<[u32; 2]>> {
    let (inside, outside) = (indices(inside, materials)?, indices(outside, materials)?);
    if inside.len() != triangles || outside.len() != triangles {
        return Err(PyValueError::new_err("each triangle must have a material on each side"));
    }
    Ok(inside.into_iter().zip(outside).map(|(inside, outside)| [inside, outside]).collect())
}
