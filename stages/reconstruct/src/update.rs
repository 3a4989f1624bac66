//! Updates a finished surface where h has changed (`--update`).
//!
//! The surface stores h at each of its vertices. Vertices at which the size field differs from the
//! stored h may change, and so may three rings of vertices around them. Edges between these
//! vertices are split and collapsed until their lengths fit the new h, and the triangles are
//! improved. All other vertices keep their positions bit for bit, and their triangles keep their
//! corners. All edits preserve the topology. The whole mesh is checked as after a reconstruction.

use crate::complete::Completion;
use crate::complete::Reconstruction;
use crate::interfaces::{Interface, Interfaces, Joined};
use crate::materials::each::SIDES;
use crate::materials::nodes::Nodes;
use crate::options::Options;
use crate::subject::Subject;
use glam::DVec3;
use isoparticles_field::materials::MaterialId;
use isoparticles_field::sizing::SizingField;
use isoparticles_field::spline::{CubicSpline, distance_estimate};
use isoparticles_field::topology::FieldTopology;
use isoparticles_mesh::TriangleMesh;
use isoparticles_mesh::surface::Surface;
use isoparticles_stage::distance_field::DistanceField;
use isoparticles_stage::error::{Error, Result};
use isoparticles_stage::monitor::Monitor;
use rayon::prelude::*;

/// Relative differences of h up to this value are due to rounding. Without a change, the same f32
/// samples are interpolated, at a position that rounding has changed by a relative 1e-15.
const SAME_SIZE: f64 = 1e-6;

/// Distance from an interface, in voxels. If more than half of the vertices are farther away, the
/// surface belongs to another field and is rejected. The same rule applies to particles.
const FARTHEST: f64 = 1.0;

/// Data that depend only on the field, so that all updates of a field can share them.
pub enum Reference {
    /// F and its topology.
    Object(Box<(CubicSpline, FieldTopology)>),
    /// The material of each grid node, and the Euler characteristics of the regions.
    Materials(Box<Nodes>),
}

impl Reference {
    /// Derives the reference of a distance field or of the indicators of many materials.
    ///
    /// # Errors
    /// If the run is interrupted.
    pub fn new(distance: &DistanceField, monitor: &dyn Monitor) -> Result<Self> {
        let _phase = monitor.phase("topology");
        match distance {
            DistanceField::Object(field) => {
                let spline = CubicSpline::new(&field.image);
                let topology = FieldTopology::watched(&spline, monitor)?;
                Ok(Self::Object(Box::new((spline, topology))))
            }
            DistanceField::Materials(file) => {
                Ok(Self::Materials(Box::new(Nodes::new(file.materials.geometry(), &file.materials))))
            }
        }
    }
}

/// Changes the surface `previous` (world coordinates, with h at its vertices and, for many
/// materials, those of its triangles) where `sizing` differs from this h.
///
/// # Errors
/// If the surface has no h or no materials, if it belongs to another field, or if the run is
/// interrupted. A mesh that fails a check is not an error.
pub fn update(
    previous: &Surface,
    subject: &dyn Subject,
    sizing: &SizingField,
    options: &Options,
    monitor: &dyn Monitor,
) -> Result<Reconstruction> {
    let phase = monitor.phase("read the interfaces");
    let mut interfaces = interfaces_of(previous, subject)?;
    join_the_distant(&mut interfaces, subject, options)?;
    let size = |p: DVec3| sizing.at(p);
    let around = with_another_size(&interfaces.mesh, &sizes_of(previous)?, &size);
    drop(phase);
    monitor.check()?;

    let phase = monitor.phase("improve");
    let before = interfaces.mesh.vertices.clone();
    let dimensions = interfaces.dimensions();
    let completion = Completion { subject, size: &size, options, monitor };
    let (improved, numbers) = completion.improve(&mut interfaces, &dimensions, Some(&around), true)?;
    drop(phase);
    let kept = kept(&previous.mesh, &before, &interfaces.mesh, &numbers);
    completion.check(interfaces, improved, None, kept)
}

/// Returns the indices in `mesh` of the vertices that have kept their positions, with these
/// positions in world coordinates, bit for bit as in `previous`. `before` contains the grid
/// positions of the vertices of `previous`, and `numbers` their indices in `mesh`, `u32::MAX` for
/// removed vertices.
fn kept(previous: &TriangleMesh, before: &[DVec3], mesh: &TriangleMesh, numbers: &[u32]) -> Vec<(u32, DVec3)> {
    let numbered = numbers.iter().zip(before.iter().zip(&previous.vertices));
    let is_kept = |number: u32, place: DVec3| number != u32::MAX && mesh.vertices[number as usize] == place;
    numbered.filter(|(number, (place, _))| is_kept(**number, **place)).map(|(&number, (_, &p))| (number, p)).collect()
}

/// Returns h at the vertices of a surface.
fn sizes_of(surface: &Surface) -> Result<Vec<f64>> {
    let sizes = surface.point_data.iter().find(|array| array.name == "h").map(|array| array.values.to_f64());
    sizes.filter(|sizes| sizes.len() == surface.mesh.vertices.len()).ok_or_else(|| {
        Error::input(
            "the surface has no array h at its vertices",
            "it shows where h has changed",
            "pass a .vtp file that reconstruct has written from the same distance field",
        )
    })
}

/// Converts a surface to interfaces in the grid frame, with the edges of their junction curves.
fn interfaces_of(surface: &Surface, subject: &dyn Subject) -> Result<Interfaces> {
    let (mesh, count, first_beyond) =
        (surface.to_grid(subject.geometry()), subject.table().len(), subject.first_beyond());
    if count == 0 {
        return Ok(Interfaces::of_object(mesh));
    }
    let array = |name: &str| {
        let found = surface.cell_data.iter().find(|array| array.name == name)?;
        let values = found.values.to_f64();
        (values.len() == surface.mesh.triangles.len()).then_some(values)
    };
    let Some((inside, outside)) = array(SIDES[0]).zip(array(SIDES[1])) else {
        return Err(Error::input(
            "the triangles have no materials",
            "the interfaces between materials cannot be updated without them",
            "pass a .vtp file that reconstruct has written from the same indicators",
        ));
    };
    let count = count as f64;
    if inside.iter().chain(&outside).any(|&id| !(0.0..count).contains(&id)) {
        return Err(Error::input(
            format!("a triangle has a material with a number above {}", count - 1.0),
            "the surface does not belong to these indicators",
            "pass the indicators from which the surface was made",
        ));
    }
    let cap = array("cap").unwrap_or_else(|| vec![0.0; inside.len()]);
    let beyond = |cap: f64| first_beyond.filter(|_| cap > 0.0).map(|first| MaterialId(first.0 + cap as u16 - 1));
    let sides = inside.into_iter().zip(outside).zip(cap);
    let pair = |((inside, outside), cap): ((f64, f64), f64)| {
        [MaterialId(inside as u16), beyond(cap).unwrap_or(MaterialId(outside as u16))]
    };
    let mut interfaces = Interfaces { mesh, between: sides.map(pair).collect(), first_beyond, ..Interfaces::default() };
    interfaces.segments = interfaces.edges_of_curves();
    Ok(interfaces)
}

/// Records as joined the vertices of junction curves that exceed the distance limit of the check to
/// one of their interfaces. In the surface of a reconstruction, these are vertices at which strata
/// were merged. The check accepts their present distances.
///
/// # Errors
/// If the mesh is empty or not well-formed, or if most vertices are far from their interfaces.
fn join_the_distant(interfaces: &mut Interfaces, subject: &dyn Subject, options: &Options) -> Result<()> {
    let mesh = &interfaces.mesh;
    if mesh.triangles.is_empty() || !mesh.is_well_formed() {
        return Err(Error::input(
            "the surface has no triangles, or a coordinate or an index is invalid",
            "such a surface cannot be updated",
            "pass a .vtp file that reconstruct has written",
        ));
    }
    let voxel = subject.geometry().mean_spacing();
    let distance = |&(v, interface): &(u32, Interface)| {
        let (value, gradient) = subject.functions().value_gradient(interface, mesh.vertices[v as usize]);
        (v, distance_estimate(value, gradient).abs())
    };
    let distances: Vec<(u32, f64)> = interfaces.pairs_at_vertices().par_iter().map(distance).collect();
    let of_vertex = distances.chunk_by(|a, b| a.0 == b.0);
    let maximum = |own: &[(u32, f64)]| own.iter().map(|(_, distance)| *distance).fold(0.0, f64::max);
    let far = of_vertex.clone().filter(|own| maximum(own) > FARTHEST * voxel).count();
    if 2 * far > mesh.vertices.len() {
        let count = mesh.vertices.len();
        return Err(Error::input(
            format!("{far} of {count} vertices are not within {FARTHEST} voxel of F = 0 or of their interfaces"),
            "the surface does not belong to the distance field",
            "pass the distance field from which the surface was made",
        ));
    }
    let limit = options.max_vertex_distance * voxel;
    let distant = of_vertex.filter(|own| own.len() > 1 && maximum(own) > limit);
    interfaces.joined = distant.map(|own| Joined { vertex: own[0].0, distance: maximum(own) }).collect();
    Ok(())
}

/// Returns, for each vertex, whether `size` differs from `before`, the previous h.
fn with_another_size(mesh: &TriangleMesh, before: &[f64], size: &(dyn Fn(DVec3) -> f64 + Sync)) -> Vec<bool> {
    let differs = |(p, before): (&DVec3, &f64)| (size(*p) / before - 1.0).abs() > SAME_SIZE;
    mesh.vertices.par_iter().zip(before).map(differs).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::reconstruct::reconstruct;
    use crate::scenes::{self, Scene};
    use crate::subject::Object;
    use isoparticles_field::particle_set::ParticleSet;
    use isoparticles_mesh::surface::DataArray;
    use isoparticles_stage::monitor::Silent;
    use isoparticles_volume::Image;

    /// Edge length of the mesh that is updated.
    const H: f64 = 1.6;
    /// A point on the outer rim of the torus.
    const PLACE: DVec3 = DVec3::new(28.7, 15.7, 15.7);

    fn surface_of(made: &Reconstruction, scene: &Scene, previous: Option<&Surface>) -> Surface {
        let mut surface = Surface::from_grid(&made.interfaces.mesh, &scene.image.geometry);
        assert_eq!(made.kept.is_empty(), previous.is_none());
        made.kept.iter().for_each(|&(v, place)| surface.mesh.vertices[v as usize] = place);
        surface.point_data = vec![DataArray::scalars("h", made.sizes.clone())];
        surface
    }

    fn meshed(scene: &Scene) -> Surface {
        let positions = scene.points(H);
        let count = positions.len();
        let particles = ParticleSet {
            geometry: scene.image.geometry.clone(),
            normals: vec![DVec3::Z; count],
            positions,
            sizes: vec![H; count],
            energies: vec![0.0; count],
            lambdas: vec![0.1; count],
        };
        let sizing = field_of(scene, |_| H);
        let field = (&scene.field, &scene.image);
        let made = reconstruct(&particles, field, Some(&sizing), &Options::default(), &Silent).expect("near F");
        assert_eq!(made.failed, [""; 0]);
        surface_of(&made, scene, None)
    }

    fn field_of(scene: &Scene, h: impl Fn(DVec3) -> f64) -> SizingField {
        SizingField::new(Image::sampled(scene.image.geometry.clone(), |p| h(p) as f32))
    }

    /// Returns a field that is `size` within 4 mm of [`PLACE`] and changes towards [`H`] with slope
    /// 0.4: outside this ball for a smaller size, inside for a larger one.
    fn near(size: f64) -> impl Fn(DVec3) -> f64 {
        move |p| {
            let away = 0.4 * (p.distance(PLACE) - 4.0);
            if size < H { (size + away.max(0.0)).min(H) } else { size.min(H - away).max(H) }
        }
    }

    fn run(previous: &Surface, scene: &Scene, h: impl Fn(DVec3) -> f64) -> Result<Reconstruction> {
        let topology = FieldTopology::new(&scene.field);
        let subject = Object { field: &scene.field, topology: &topology, samples: Some(&scene.image) };
        update(previous, &subject, &field_of(scene, h), &Options::default(), &Silent)
    }

    fn updated(scene: &Scene, previous: &Surface, h: impl Fn(DVec3) -> f64) -> (Reconstruction, Surface) {
        let made = run(previous, scene, h).expect("of F");
        assert_eq!(made.failed, [""; 0]);
        let surface = surface_of(&made, scene, Some(previous));
        (made, surface)
    }

    fn mean_edge(surface: &Surface) -> f64 {
        let near = |p: &DVec3| p.distance(PLACE) < 3.0;
        let triangles = surface.mesh.triangles.iter().map(|t| t.map(|v| surface.mesh.vertices[v as usize]));
        let inside = triangles.filter(|corners| corners.iter().all(near));
        let edges: Vec<f64> = inside.flat_map(|[a, b, c]| [a.distance(b), b.distance(c), c.distance(a)]).collect();
        edges.iter().sum::<f64>() / edges.len() as f64
    }

    #[test]
    fn only_the_surroundings_of_a_ball_change() {
        let scene = scenes::torus();
        let before = meshed(&scene);
        for size in [0.6, 2.4] {
            let (made, after) = updated(&scene, &before, near(size));
            let quality = &made.checked.quality;
            assert!(quality.radius_ratio_min > 0.5 && quality.radius_ratio_mean > 0.9, "{size}: {quality:?}");
            let edge = mean_edge(&after);
            assert!((edge / size - 1.0).abs() < 0.15, "{size}: {edge}");
            // h changes up to 2.5 mm outside the ball; the rim adds three edges of up to 1.6 h each
            let is_kept = |q: &DVec3| before.mesh.vertices.contains(q);
            let changed = after.mesh.vertices.iter().filter(|q| !is_kept(q));
            let farthest = changed.map(|q| q.distance(PLACE)).fold(0.0, f64::max);
            assert!(farthest < 4.0 + 2.5 + 5.0 * H, "{size}: {farthest}");
        }
    }

    #[test]
    fn nothing_changes_without_a_change_of_h() {
        let scene = scenes::torus();
        let before = meshed(&scene);
        let (made, after) = updated(&scene, &before, |_| H);
        assert_eq!(after.mesh, before.mesh);
        assert_eq!(made.kept.len(), before.mesh.vertices.len());
    }

    #[test]
    fn the_finer_mesh_can_be_made_coarse_again() {
        let scene = scenes::torus();
        let before = meshed(&scene);
        let (_, fine) = updated(&scene, &before, near(0.6));
        let (_, after) = updated(&scene, &fine, |_| H);
        let [first, between, last] = [&before, &fine, &after].map(|surface| surface.mesh.vertices.len());
        // the first mesh, from random points, has fewer vertices than h requests
        assert!(between > first + 100 && last < between - 100, "{first}, {between}, {last}");
        assert!((mean_edge(&after) / H - 1.0).abs() < 0.2, "{}", mean_edge(&after));
    }

    #[test]
    fn surfaces_without_h_or_of_another_field_are_refused() {
        let scene = scenes::torus();
        let mut surface = meshed(&scene);
        let told = |surface: &Surface, scene: &Scene| run(surface, scene, |_| H).expect_err("refused").what;
        assert!(told(&surface, &scenes::sphere()).contains("are not within 1 voxel of F = 0"));
        surface.point_data.clear();
        assert_eq!(told(&surface, &scene), "the surface has no array h at its vertices");
    }
}
