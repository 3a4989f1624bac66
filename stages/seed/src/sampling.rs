//! Seeds the isosurface by Poisson-disk sampling, with the spacing given by the sizing field. All
//! seeds, including those at marching-cubes vertices, are then projected onto F = 0, and every
//! component gets a minimum number of particles.

use crate::vertices::Vertices;
use glam::DVec3;
use isoparticles_field::neighbours;
use isoparticles_field::particle_set::ParticleSet;
use isoparticles_field::random;
use isoparticles_field::sizing::SizingField;
use isoparticles_field::spline::CubicSpline;
use isoparticles_field::topology::FieldComponents;
use isoparticles_mesh::TriangleMesh;
use isoparticles_mesh::buckets::joined;
use isoparticles_stage::monitor::{Interrupted, Monitor};
use rayon::prelude::*;

/// Number of candidates per predicted particle. More candidates fill more of the gaps between
/// disks: with 16 instead of 8, the number of seeds is 7 % higher at the same radius.
pub(crate) const OVERSAMPLING: f64 = 8.0;
/// Memory in bytes per seeded particle, including its candidates, their order and their bins.
/// Measured: between 8,514 and 99,084 particles on the same grid, the peak memory grows by 660
/// bytes per particle (`make bench-stages`, table in `docs/developer/performance.md`). The constant
/// is twice as large, because vectors grow by doubling.
pub const BYTES_PER_PARTICLE: f64 = 1300.0;
/// Minimum distance between two seeds in units of h. On a plane, the sampling then reaches 0.94
/// times the density of the hexagonal lattice of spacing h (`cargo test -p isoparticles-seed
/// density`). Density control adds the missing particles. Above 0.777, no number of candidates
/// reaches the density of the lattice: random disks jam at a covered fraction of 0.547, and at this
/// diameter, the lattice covers the same fraction.
pub(crate) const DISK_RADIUS: f64 = 0.71;
/// Maximum distance from a point on a marching-cubes triangle to F = 0, in voxels. Each vertex lies
/// on a cell edge along which F changes sign, so it is less than one voxel from the surface. The
/// other half voxel is a margin for points inside a triangle.
pub(crate) const MAX_PROJECTION: f64 = 1.5;
/// Tolerance of the projection, in voxels: a tenth of the tolerance on |F| after a pass of
/// `particles` (1e-5).
pub(crate) const PROJECTION_TOLERANCE: f64 = 1e-6;
/// Minimum number of particles per component. The icosahedron, with 12 vertices, is the smallest
/// triangulation of a sphere without vertices of degree three or four.
pub const COMPONENT_MINIMUM: usize = 12;

/// Statistics of the seeding.
#[derive(Clone, Copy, Debug, Default, serde::Serialize)]
pub struct Summary {
    /// Number of components of the isosurface.
    pub components: usize,
    /// Number of components that got extra particles because the sizing field gave them too few.
    pub underpopulated_components: usize,
    /// Number of seeds dropped because the projection onto F = 0 failed.
    pub not_projected: usize,
    /// Number of marching-cubes vertices; `None` for Poisson-disk sampling.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub vertices: Option<usize>,
    /// Number of marching-cubes cells along each edge of a voxel; `None` for Poisson-disk sampling.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub refinement: Option<usize>,
}

/// Random points on triangles, from which seeds are selected.
#[derive(Default)]
pub(crate) struct Candidates {
    pub(crate) points: Vec<DVec3>,
    pub(crate) normals: Vec<DVec3>,
    pub(crate) sizes: Vec<f64>,
    /// Component of the surface that contains each point.
    pub(crate) component: Vec<u32>,
}

/// Seeds the surface F = 0 by sampling the marching-cubes triangles with the density of `spread`.
/// The particle sizes come from `sizing`, which differs from `spread` by a constant factor if
/// `--count` is given (the paper's Table 3). The result depends only on the arguments.
///
/// # Errors
/// If the monitor interrupts the run.
pub fn seed_surface(
    mesh: &TriangleMesh,
    surface: &CubicSpline,
    (spread, sizing): (&SizingField, &SizingField),
    seed: u64,
    monitor: &dyn Monitor,
) -> Result<(ParticleSet, Summary), Interrupted> {
    let components = components_of(surface, monitor)?;
    let _phase = monitor.phase("sample");
    let every: Vec<u32> = (0..mesh.triangles.len() as u32).collect();
    let density = |p, normal| OVERSAMPLING * spread.lattice_density(p, normal);
    let all = sample(mesh, &every, |_| 0, density, |p| spread.at(p), seed);
    monitor.check()?;
    let mut chosen = eliminate(&all, seed, |_, _| true);
    chosen.par_sort_unstable();
    let picked: Vec<_> = chosen.into_par_iter().map(|i| (all.points[i as usize], all.normals[i as usize])).collect();
    monitor.check()?;
    Ok(on_every_component(&components, surface, sizing, &picked, seed))
}

/// Seeds the surface F = 0 at marching-cubes [`vertices`](crate::vertices::vertices), without
/// thinning them. These are the paper's seeds; density control deletes the surplus.
///
/// # Errors
/// If the monitor interrupts the run.
pub fn seed_vertices(
    vertices: &Vertices,
    surface: &CubicSpline,
    sizing: &SizingField,
    seed: u64,
    monitor: &dyn Monitor,
) -> Result<(ParticleSet, Summary), Interrupted> {
    let components = components_of(surface, monitor)?;
    let _phase = monitor.phase("project");
    let (set, summary) = on_every_component(&components, surface, sizing, &vertices.points, seed);
    let (available, refinement) = (Some(vertices.available), Some(vertices.refinement));
    Ok((set, Summary { vertices: available, refinement, ..summary }))
}

fn components_of(surface: &CubicSpline, monitor: &dyn Monitor) -> Result<FieldComponents, Interrupted> {
    let _phase = monitor.phase("topology");
    FieldComponents::new(surface, monitor)
}

/// Projects the selected points onto F = 0. Each component with fewer than [`COMPONENT_MINIMUM`]
/// points is resampled on its own, with a spacing derived from its area.
fn on_every_component(
    components: &FieldComponents,
    surface: &CubicSpline,
    sizing: &SizingField,
    picked: &[(DVec3, DVec3)],
    seed: u64,
) -> (ParticleSet, Summary) {
    let (seeds, mut not_projected) = onto_surface(surface, picked);
    let component_of: Vec<Option<u32>> = seeds.par_iter().map(|&(p, g)| components.at(surface, p, g)).collect();
    let mut counts = vec![0usize; components.all().len()];
    component_of.iter().flatten().for_each(|&c| counts[c as usize] += 1);
    let is_bare = |c: &u32| counts[*c as usize] < COMPONENT_MINIMUM;
    let mut kept: Vec<(DVec3, DVec3)> =
        seeds.into_iter().zip(component_of).filter(|(_, c)| !c.as_ref().is_some_and(is_bare)).map(|(p, _)| p).collect();
    let bare: Vec<u32> = (0..counts.len() as u32).filter(is_bare).collect();
    let alone = |&c: &u32| {
        let mesh = components.mesh(c);
        let every: Vec<u32> = (0..mesh.triangles.len() as u32).collect();
        onto_surface(surface, &sample_alone(&mesh, &every, seed, u64::from(c)))
    };
    for (seeds, lost) in bare.par_iter().map(alone).collect::<Vec<_>>() {
        kept.extend(seeds);
        not_projected += lost;
    }
    let (positions, normals): (Vec<_>, Vec<_>) = kept.into_iter().map(|(p, g)| (p, g.normalize())).unzip();
    let sizes = positions.par_iter().map(|&p| sizing.at(p)).collect();
    let set = ParticleSet {
        geometry: surface.geometry().clone(),
        energies: vec![0.0; positions.len()],
        lambdas: vec![0.1; positions.len()],
        positions,
        normals,
        sizes,
    };
    let (components, underpopulated_components) = (components.all().len(), bare.len());
    (set, Summary { components, underpopulated_components, not_projected, ..Summary::default() })
}

/// Projects points with normals onto F = 0. Returns the projected points, each with grad F, and the
/// number of discarded points. A point is discarded if the projection fails or if grad F and the
/// normal differ by 90 degrees or more.
fn onto_surface(surface: &CubicSpline, picked: &[(DVec3, DVec3)]) -> (Vec<(DVec3, DVec3)>, usize) {
    let spacing = surface.geometry().mean_spacing();
    let project = |&(p, n): &(DVec3, DVec3)| {
        surface
            .project_with_gradient(p, MAX_PROJECTION * spacing, PROJECTION_TOLERANCE * spacing)
            .filter(|(_, g)| g.dot(n) > 0.0)
    };
    let found: Vec<_> = picked.par_iter().filter_map(project).collect();
    let lost = picked.len() - found.len();
    (found, lost)
}

/// Returns the centroid of a triangle, and a normal whose length is twice the area.
pub(crate) fn centre_and_normal(mesh: &TriangleMesh, triangle: usize) -> (DVec3, DVec3) {
    let [a, b, c] = mesh.triangles[triangle].map(|v| mesh.vertices[v as usize]);
    ((a + b + c) / 3.0, (b - a).cross(c - a))
}

/// Returns random points on the triangles in `members`. On average, a triangle gets
/// `density(centre, unit normal)` points per mm^2.
pub(crate) fn sample(
    mesh: &TriangleMesh,
    members: &[u32],
    component: impl Fn(usize) -> u32 + Sync,
    density: impl Fn(DVec3, DVec3) -> f64 + Sync,
    size: impl Fn(DVec3) -> f64 + Sync,
    seed: u64,
) -> Candidates {
    // number of triangles per parallel task; it does not affect the result
    const CHUNK: usize = 4096;
    let mut parts: Vec<Candidates> = members
        .par_chunks(CHUNK)
        .map(|chunk| {
            let mut part = Candidates::default();
            for &t in chunk {
                let t = t as usize;
                let (centre, doubled) = centre_and_normal(mesh, t);
                let normal = doubled.normalize_or_zero();
                let wanted = 0.5 * doubled.length() * density(centre, normal);
                // rounds up or down at random, which preserves the mean
                let count = (wanted + random::uniform(seed, 0, t as u64)).floor() as u64;
                let [a, b, c] = mesh.triangles[t].map(|v| mesh.vertices[v as usize]);
                for n in 0..count {
                    let stream = 1 + 2 * n;
                    let (u, v) = (random::uniform(seed, stream, t as u64), random::uniform(seed, stream + 1, t as u64));
                    let (u, v) = if u + v > 1.0 { (1.0 - u, 1.0 - v) } else { (u, v) };
                    let p = a + (b - a) * u + (c - a) * v;
                    part.points.push(p);
                    part.normals.push(normal);
                    part.sizes.push(size(p));
                    part.component.push(component(t));
                }
            }
            part
        })
        .collect();
    Candidates {
        points: taken(&mut parts, |part| &mut part.points),
        normals: taken(&mut parts, |part| &mut part.normals),
        sizes: taken(&mut parts, |part| &mut part.sizes),
        component: taken(&mut parts, |part| &mut part.component),
    }
}

/// Moves one list out of every part and concatenates the pieces. A caller that does this for one
/// list at a time has only one list in memory twice.
fn taken<T: Copy + Default + Send + Sync>(
    parts: &mut [Candidates],
    list: impl Fn(&mut Candidates) -> &mut Vec<T>,
) -> Vec<T> {
    joined(parts.iter_mut().map(|part| std::mem::take(list(part))).collect())
}

/// Selects candidates in random order. Each selected candidate removes all other candidates within
/// the disk radius whose normals differ from its own by less than 90 degrees and for which `crowd`
/// returns true.
pub(crate) fn eliminate(candidates: &Candidates, seed: u64, crowd: impl Fn(usize, usize) -> bool + Sync) -> Vec<u32> {
    let numbers = (0..candidates.points.len()).into_par_iter();
    let mut order: Vec<(u64, u32)> = numbers.map(|i| (random::bits(seed ^ 0x5eed, 0, i as u64), i as u32)).collect();
    order.par_sort_unstable();
    let order: Vec<u32> = order.into_par_iter().map(|(_, i)| i).collect();
    neighbours::eliminate(&candidates.points, &candidates.sizes, DISK_RADIUS, &order, |i, j, _| {
        candidates.normals[j].dot(candidates.normals[i]) > 0.0 && crowd(i, j)
    })
}

/// Returns seeds on the triangles in `members`, which form component `c`: about twice
/// [`COMPONENT_MINIMUM`].
pub(crate) fn sample_alone(mesh: &TriangleMesh, members: &[u32], seed: u64, c: u64) -> Vec<(DVec3, DVec3)> {
    let area: f64 = members.iter().map(|&t| 0.5 * centre_and_normal(mesh, t as usize).1.length()).sum();
    let density = 2.0 * COMPONENT_MINIMUM as f64 / area;
    let h = (2.0 / (3f64.sqrt() * density)).sqrt();
    let density = |_, _| 4.0 * OVERSAMPLING * density;
    let candidates = sample(mesh, members, |_| c as u32, density, |_| h, seed.wrapping_add(c + 1));
    let chosen = eliminate(&candidates, seed, |_, _| true);
    chosen.into_iter().map(|i| (candidates.points[i as usize], candidates.normals[i as usize])).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn disks_have_094_of_the_density_of_the_lattice() {
        // a square with an edge length of 60 h, where h = 1
        let side = 60.0;
        let vertices = vec![DVec3::ZERO, DVec3::X * side, DVec3::new(side, side, 0.0), DVec3::Y * side];
        let mesh = TriangleMesh { vertices, triangles: vec![[0, 1, 2], [0, 2, 3]] };
        let lattice = 2.0 / 3f64.sqrt();
        let all = sample(&mesh, &[0, 1], |_| 0, |_, _| OVERSAMPLING * lattice, |_| 1.0, 1);
        let inner = |&i: &u32| {
            all.points[i as usize].truncate().cmpge(glam::DVec2::splat(5.0)).all()
                && all.points[i as usize].truncate().cmple(glam::DVec2::splat(side - 5.0)).all()
        };
        let count = eliminate(&all, 1, |_, _| true).iter().filter(|i| inner(i)).count() as f64;
        let density = count / (side - 10.0).powi(2);
        println!("density: {:.3} of the lattice", density / lattice);
        assert!((density / lattice - 0.94).abs() < 0.03, "{}", density / lattice);
    }
}
