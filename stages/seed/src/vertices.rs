//! Takes seeds from the vertices of marching cubes on F (section 3.1 of the paper): either all
//! vertices, or a given number of them as in the synthetic test of Table 3 ("a user defined number
//! of particles").

use glam::DVec3;
use isoparticles_field::marching_cubes::marching_cubes;
use isoparticles_field::neighbours::space_order;
use isoparticles_field::spline::CubicSpline;
use isoparticles_mesh::TriangleMesh;
use isoparticles_stage::monitor::{Interrupted, Monitor};
use isoparticles_volume::{Geometry, Image};
use rayon::prelude::*;

/// Maximum refinement of the marching-cubes grid, in cells along each edge of a voxel. The grid is
/// refined until it gives the requested number of vertices. The seeds in Table 3 need a refinement
/// of at most 2: the ribcage of the torso phantom has 170,480 vertices on the voxel grid and
/// 684,588 on a grid twice as fine, more than twice the largest number of seeds in the table.
pub const FINEST: usize = 4;

/// Memory in bytes per node of a refined grid, for the value of the node and for the vertices and
/// triangles near it. Measured with `seed --count 300000` on the ribcage: 362 MiB for 47.5 million
/// nodes, which is 8 bytes per node.
pub(crate) const BYTES_PER_NODE: f64 = 8.0;

/// Marching-cubes vertices that serve as seeds.
#[derive(Clone, Debug, Default)]
pub struct Vertices {
    /// Positions in mm in the grid frame, each with an outward normal of any length.
    pub points: Vec<(DVec3, DVec3)>,
    /// Number of cells of the grid along each edge of a voxel.
    pub refinement: usize,
    /// Total number of marching-cubes vertices on that grid.
    pub available: usize,
}

/// Returns the vertices of marching cubes on the samples of F, in mesh order. If `count` is given,
/// returns only that many vertices, evenly spread. If the voxel grid gives too few, the spline is
/// resampled on a grid two, three or [`FINEST`] times as fine, provided that `has_room` accepts the
/// number of nodes. The result has fewer than `count` points if even the finest grid has too few
/// vertices.
///
/// # Errors
/// If the monitor interrupts the run, or if `has_room` rejects the nodes of a finer grid.
pub fn vertices<E: From<Interrupted>>(
    distance: &Image<f32>,
    surface: &CubicSpline,
    count: Option<usize>,
    has_room: impl Fn(usize) -> Result<(), E>,
    monitor: &dyn Monitor,
) -> Result<Vertices, E> {
    let _phase = monitor.phase("marching cubes");
    let (mut refinement, mut mesh) = (1, marching_cubes(distance, 0.0));
    while refinement < FINEST && !mesh.vertices.is_empty() && count.is_some_and(|count| mesh.vertices.len() < count) {
        monitor.check()?;
        refinement += 1;
        let grid = refined(surface.geometry(), refinement);
        has_room(grid.voxel_count())?;
        mesh = marching_cubes(&sampled(surface, grid), 0.0);
    }
    let available = mesh.vertices.len();
    let points = with_normals(&mesh);
    let points = match count {
        Some(count) if count < available => {
            let spacing = surface.geometry().mean_spacing() / refinement as f64;
            spread(&mesh.vertices, spacing, count).into_iter().map(|v| points[v as usize]).collect()
        }
        _ => points,
    };
    Ok(Vertices { points, refinement, available })
}

/// Returns the grid with `refinement` cells along each edge of a voxel.
fn refined(voxels: &Geometry, refinement: usize) -> Geometry {
    let size = voxels.size.map(|n| (n - 1) * refinement + 1);
    Geometry { size, spacing: voxels.spacing / refinement as f64, ..voxels.clone() }
}

/// Samples F at the nodes of a grid.
fn sampled(surface: &CubicSpline, geometry: Geometry) -> Image<f32> {
    let [nx, ny, _] = geometry.size;
    let mut data = vec![0.0f32; geometry.voxel_count()];
    data.par_chunks_mut(nx).enumerate().for_each(|(row, values)| {
        for (i, value) in values.iter_mut().enumerate() {
            let index = DVec3::new(i as f64, (row % ny) as f64, (row / ny) as f64);
            *value = surface.value(geometry.index_to_grid(index)) as f32;
        }
    });
    Image { geometry, data }
}

/// Returns the vertices, each with the area-weighted sum of the normals of the adjacent triangles.
fn with_normals(mesh: &TriangleMesh) -> Vec<(DVec3, DVec3)> {
    let mut normals = vec![DVec3::ZERO; mesh.vertices.len()];
    for triangle in &mesh.triangles {
        let [a, b, c] = triangle.map(|v| mesh.vertices[v as usize]);
        let doubled = (b - a).cross(c - a);
        for &v in triangle {
            normals[v as usize] += doubled;
        }
    }
    mesh.vertices.iter().copied().zip(normals).collect()
}

/// Selects `count` of the points, evenly spaced along a space-filling curve, so that about the same
/// fraction of points is selected in every region. `count` must be below the number of points.
/// Returns indices in ascending order.
fn spread(points: &[DVec3], spacing: f64, count: usize) -> Vec<u32> {
    let along = space_order(points, &vec![spacing; points.len()], 1.0);
    let mut chosen: Vec<u32> = (0..count).map(|n| along[(2 * n + 1) * points.len() / (2 * count)]).collect();
    chosen.sort_unstable();
    chosen
}

#[cfg(test)]
mod tests {
    use super::*;
    use isoparticles_stage::monitor::Silent;

    /// Calls [`vertices`] with a memory check that always passes.
    fn taken(image: &Image<f32>, surface: &CubicSpline, count: Option<usize>) -> Vertices {
        vertices(image, surface, count, |_| Ok::<_, Interrupted>(()), &Silent).unwrap()
    }

    fn ball() -> (Image<f32>, CubicSpline) {
        let geometry = Geometry::axis_aligned([24; 3], DVec3::new(1.0, 0.9, 1.1));
        let centre = 0.5 * geometry.upper_corner();
        let image = Image::sampled(geometry, |p| (p.distance(centre) - 8.0) as f32);
        let surface = CubicSpline::new(&image);
        (image, surface)
    }

    #[test]
    fn a_number_of_vertices_is_spread_evenly() {
        let (image, surface) = ball();
        let all = taken(&image, &surface, None);
        assert_eq!((all.refinement, all.available), (1, all.points.len()));
        let centre = 0.5 * surface.geometry().upper_corner();
        for count in [40, 300, all.available - 1] {
            let some = taken(&image, &surface, Some(count));
            assert_eq!((some.points.len(), some.refinement), (count, 1));
            assert!(some.points.iter().all(|p| all.points.contains(p)));
            let mut distinct: Vec<_> = some.points.iter().map(|(p, _)| p.to_array().map(f64::to_bits)).collect();
            distinct.sort_unstable();
            distinct.dedup();
            assert_eq!(distinct.len(), count, "a vertex was taken twice");
            // the fraction of selected vertices in each octant deviates less from the fraction of
            // all vertices than with a random selection
            let share = |points: &[(DVec3, DVec3)], octant: usize| {
                let inside = |p: DVec3| (0..3).all(|a| (p[a] > centre[a]) == ((octant >> a) & 1 == 1));
                points.iter().filter(|(p, _)| inside(*p)).count() as f64 / points.len() as f64
            };
            let off = |octant| share(&some.points, octant) - share(&all.points, octant);
            let variance = (0..8).map(|octant| (off(octant) * count as f64).powi(2)).sum::<f64>() / 8.0;
            let random = count as f64 * (1.0 - count as f64 / all.available as f64) * (1.0 / 8.0) * (7.0 / 8.0);
            println!("{count}: variance {variance:.2} vertices squared, of a random choice {random:.2}");
            assert!(variance < 0.5 * random || variance < 1.0, "{count}: {variance}, of a random choice {random}");
        }
    }

    #[test]
    fn more_vertices_come_from_a_finer_grid_and_there_is_an_end() {
        let (image, surface) = ball();
        let own = taken(&image, &surface, None).available;
        let more = taken(&image, &surface, Some(3 * own));
        assert_eq!((more.points.len(), more.refinement), (3 * own, 2));
        let too_many = taken(&image, &surface, Some(100 * own));
        assert_eq!((too_many.refinement, too_many.points.len()), (FINEST, too_many.available));
        assert!(too_many.available > 14 * own && too_many.available < 18 * own, "{}", too_many.available);
    }
}
