//! Regions and mending of tetrahedra, for `tetmesh-check`. Arrays are as in `meshes`.

use crate::arrays::{Array, cells, compute, compute_unless_stopped, mesh, points};
use crate::meshes::between;
use isoparticles_mesh::tetrahedra::conform::{Conformity, NOBODY, conform as conform_tetrahedra};
use isoparticles_mesh::tetrahedra::forced::{
    Side, forced_sides as find_forced_sides, largest_jacobians as find_jacobians,
};
use isoparticles_mesh::tetrahedra::mend::{Filled, Mended, mend as mend_tetrahedra};
use isoparticles_mesh::tetrahedra::target::Goal;
use pyo3::prelude::*;

type Argument<'a, 'py> = &'a Bound<'py, PyAny>;

/// Conformity of tetrahedra and interfaces.
#[derive(IntoPyObject)]
pub(crate) struct Fit {
    /// Material of each tetrahedron; 0 if unknown.
    regions: Array,
    /// Part of each tetrahedron.
    parts: Array,
    /// Tetrahedron behind each triangle; -1 if there is none.
    behind: Array,
    /// Tetrahedron in front of each triangle; -1 if there is none.
    before: Array,
    missing: usize,
    added: usize,
    crowded: usize,
    undecided: usize,
}

impl Fit {
    fn of(found: &Conformity) -> Self {
        let owners = |owners: &[u32]| {
            let signed = owners.iter().map(|&cell| if cell == NOBODY { -1 } else { i64::from(cell) });
            Array::column(&signed.collect::<Vec<_>>())
        };
        Self {
            regions: Array::indices(&found.regions),
            parts: Array::indices(&found.parts),
            behind: owners(&found.behind),
            before: owners(&found.before),
            missing: found.missing,
            added: found.added,
            crowded: found.crowded,
            undecided: found.undecided,
        }
    }
}

/// A mended mesh, and the changes.
#[derive(IntoPyObject)]
pub(crate) struct MendedMesh {
    points: Array,
    tetrahedra: Array,
    fit: Fit,
    goal_degrees: f64,
    below: [usize; 2],
    moves: usize,
    /// Number of tetrahedra that were removed and added.
    changed_tetrahedra: [usize; 2],
    /// Number of vertices that were removed and added.
    changed_vertices: [usize; 2],
}

/// Finds the material of each tetrahedron between interfaces. `vertices` is the number of vertices.
#[pyfunction]
pub(crate) fn conform(
    py: Python<'_>,
    vertices: usize,
    tetrahedra: Argument,
    triangles: Argument,
    inside: Argument,
    outside: Argument,
) -> PyResult<Fit> {
    let (tetrahedra, triangles) = (cells::<4>(tetrahedra, vertices)?, cells::<3>(triangles, vertices)?);
    let between = between(inside, outside, u32::MAX as usize, triangles.len())?;
    compute(py, move || Fit::of(&conform_tetrahedra(vertices, &tetrahedra, &triangles, &between)))
}

/// Returns the triangle, the side (0 behind, 1 in front) and the bound (degrees) of each side of a
/// triangle on which no tetrahedron reaches a dihedral angle of `angle` degrees.
#[pyfunction]
pub(crate) fn forced_sides(
    py: Python<'_>,
    points: Argument,
    triangles: Argument,
    angle: f64,
) -> PyResult<(Array, Array, Array)> {
    let mesh = mesh(points, triangles)?;
    compute(py, move || {
        let found = find_forced_sides(&mesh.vertices, &mesh.triangles, angle);
        let facets: Vec<u32> = found.iter().map(|own| own.facet).collect();
        let sides: Vec<u32> = found.iter().map(|own| u32::from(own.side == Side::Before)).collect();
        let bounds: Vec<f64> = found.iter().map(|own| own.bound).collect();
        (Array::indices(&facets), Array::indices(&sides), Array::column(&bounds))
    })
}

/// Returns the largest scaled Jacobian of a tetrahedron on each triangle whose dihedral angles are
/// at least `angle` degrees.
#[pyfunction]
pub(crate) fn largest_jacobians(py: Python<'_>, points: Argument, triangles: Argument, angle: f64) -> PyResult<Array> {
    let mesh = mesh(points, triangles)?;
    compute(py, move || Array::column(&find_jacobians(&mesh.vertices, &mesh.triangles, angle)))
}

/// Mends the tetrahedra that miss the limits of the checks or the angle to aim at. Returns `None`
/// if nothing is changed. `interfaces` contains the triangles, and the materials behind and in
/// front of each.
#[pyfunction]
pub(crate) fn mend(
    py: Python<'_>,
    points: Argument,
    tetrahedra: Argument,
    interfaces: (Bound<'_, PyAny>, Bound<'_, PyAny>, Bound<'_, PyAny>),
    min_dihedral: f64,
    min_scaled_jacobian: f64,
) -> PyResult<Option<MendedMesh>> {
    let points = self::points(points)?;
    let (triangles, inside, outside) = interfaces;
    let (tetrahedra, triangles) = (cells::<4>(tetrahedra, points.len())?, cells::<3>(&triangles, points.len())?);
    let between = between(&inside, &outside, u32::MAX as usize, triangles.len())?;
    let goal = Goal::of_limits(min_dihedral, min_scaled_jacobian);
    compute_unless_stopped(py, move |listener| {
        let filled = Filled { points: &points, cells: &tetrahedra, triangles: &triangles, between: &between };
        let Mended { points, cells, conformity, changes } =
            mend_tetrahedra(filled, &goal, &|| listener.is_cancelled())?;
        Some(MendedMesh {
            points: Array::points(&points),
            tetrahedra: Array::cells(&cells),
            fit: Fit::of(&conformity),
            goal_degrees: goal.aim_dihedral,
            below: changes.below,
            moves: changes.moves,
            changed_tetrahedra: changes.cells,
            changed_vertices: changes.vertices,
        })
    })
}
