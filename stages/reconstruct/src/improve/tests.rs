//! Improves meshes with bad triangles on analytic surfaces. The result must have better triangles
//! and pass the checks.

use super::patch::Patch;
use super::*;
use crate::check::{CheckOptions, CheckReport, Fault, check_object};
use crate::interfaces::OBJECT;
use crate::subject::Object;
use acceptance::{Goal, commit_or_rollback};
use constants::{FIT, REACHES};
use isoparticles_field::marching_cubes::marching_cubes;
use isoparticles_field::random::uniform;
use isoparticles_field::spline::CubicSpline;
use isoparticles_field::topology::FieldTopology;
use isoparticles_mesh::shapes;
use isoparticles_mesh::spatial::Bounds;
use isoparticles_volume::{Geometry, Image};
use remesh::Curves;

pub(super) fn sampled(size: [usize; 3], spacing: DVec3, f: impl Fn(DVec3) -> f64) -> Image<f32> {
    let geometry = Geometry::axis_aligned(size, spacing);
    let mut image = Image::filled(geometry, 0.0f32);
    for k in 0..size[2] {
        for j in 0..size[1] {
            for i in 0..size[0] {
                let at = image.geometry.linear(i, j, k);
                image.data[at] = f(image.geometry.index_to_grid(DVec3::new(i as f64, j as f64, k as f64))) as f32;
            }
        }
    }
    image
}

pub(super) fn ball(centre: DVec3, radius: f64) -> impl Fn(DVec3) -> f64 {
    move |p| p.distance(centre) - radius
}

fn ring(centre: DVec3, radius: f64, tube: f64) -> impl Fn(DVec3) -> f64 {
    move |p| {
        let q = p - centre;
        (q.x.hypot(q.y) - radius).hypot(q.z) - tube
    }
}

/// Asserts that a mesh is closed, manifold, free of intersections, on F = 0, and has the same
/// topology as before.
pub(super) fn assert_sound(mesh: &TriangleMesh, field: &CubicSpline, before: &CheckReport, label: &str) -> CheckReport {
    let options = CheckOptions {
        subject: Some(&Object { field, topology: &FieldTopology::new(field), samples: None }),
        max_vertex_distance: Some(1e-4),
        ..CheckOptions::default()
    };
    let after = check_object(mesh, &options);
    assert_eq!(after.failed, Vec::<String>::new(), "{label}");
    let topology = |report: &CheckReport| (report.object().components.len(), report.object().euler);
    assert_eq!(topology(&after), topology(before), "{label}");
    assert_eq!(after.count(Fault::TurnedTriangles), 0, "{label}");
    after
}

/// Improves the mesh of one object. The vertices in `held` are fixed.
pub(crate) fn improve_object(
    mesh: &mut TriangleMesh,
    held: &[u32],
    field: &CubicSpline,
    h: &(dyn Fn(DVec3) -> f64 + Sync),
    options: &ImproveOptions,
    step: Step,
) -> Result<(ImproveReport, Vec<u32>)> {
    let mut freedom = vec![Freedom::Interface; mesh.vertices.len()];
    held.iter().for_each(|&v| freedom[v as usize] = Freedom::None);
    let mut interfaces = Interfaces::of_object(std::mem::take(mesh));
    let made = improve(&mut interfaces, Constraints { functions: field, freedom, sides: None }, h, options, step);
    *mesh = interfaces.mesh;
    made
}

/// Improves the mesh of one object. If the samples of F are given, the grid nodes keep their sides.
pub(super) fn improve_guarded(
    mesh: &mut TriangleMesh,
    field: &CubicSpline,
    samples: Option<&Image<f32>>,
    h: &(dyn Fn(DVec3) -> f64 + Sync),
    options: &ImproveOptions,
) -> ImproveReport {
    let sides = samples.map(|image| NodeSides::of_object(mesh, image));
    let freedom = vec![Freedom::Interface; mesh.vertices.len()];
    let mut interfaces = Interfaces::of_object(std::mem::take(mesh));
    let (report, _) =
        improve(&mut interfaces, Constraints { functions: field, freedom, sides }, h, options, &|| Ok(()))
            .expect("a sound mesh");
    *mesh = interfaces.mesh;
    report
}

/// Options that improve triangles below 0.6 without sweeps.
const WORST_ONLY: ImproveOptions =
    ImproveOptions { target: 0.6, relaxation_sweeps: 0, thins: false, around: None, adjusts: false };

/// Remeshes a mesh of marching cubes to edges of length h, as patches are remeshed, and improves
/// it. If `sides` is given, the grid nodes keep their sides.
pub(super) fn remeshed(
    image: &Image<f32>,
    field: &CubicSpline,
    h: &(dyn Fn(DVec3) -> f64 + Sync),
    sides: Option<&Image<f32>>,
) -> (TriangleMesh, ImproveReport) {
    let mut mesh = marching_cubes(image, 0.0);
    mesh.vertices.iter_mut().for_each(|p| *p = field.project(*p, 1.0, 1e-7).unwrap_or(*p));
    let mut surface = Surface::new(&mesh, field, h);
    surface.sides = sides.map(|image| NodeSides::of_object(&mesh, image));
    for _ in 0..8 {
        remesh::round(&mut surface, &Limits::STRICT, Curves::Keep, &mut Tally::default());
    }
    mesh = surface.into_mesh();
    let options = ImproveOptions { relaxation_sweeps: 4, ..WORST_ONLY };
    let report = improve_guarded(&mut mesh, field, sides, h, &options);
    (mesh, report)
}

fn remesh_from_marching_cubes(image: &Image<f32>, h: f64, label: &str) -> CheckReport {
    let field = CubicSpline::new(image);
    let before = check_object(&marching_cubes(image, 0.0), &CheckOptions::default());
    let (mesh, report) = remeshed(image, &field, &|_| h, None);
    assert_eq!(report.frozen_vertices, 0, "{label}");
    let after = assert_sound(&mesh, &field, &before, label);
    assert_eq!(report.after, after.quality, "{label}");
    after
}

#[test]
fn remeshing_improves_meshes_of_marching_cubes() {
    let centre = DVec3::splat(10.2);
    let sphere = sampled([21; 3], DVec3::ONE, ball(centre, 7.3));
    let torus = sampled([42, 42, 18], DVec3::splat(0.5), ring(DVec3::new(10.3, 10.1, 4.2), 6.4, 2.3));
    let uneven = sampled([32, 26, 21], DVec3::new(0.7, 0.8, 1.0), ball(DVec3::new(10.8, 10.1, 10.2), 7.1));
    // measured: minima 0.83 to 0.88, means 0.981 to 0.982
    for (image, h, genus, label) in
        [(&sphere, 1.3, 0, "sphere"), (&torus, 0.8, 1, "torus"), (&uneven, 1.3, 0, "uneven spacing")]
    {
        let after = remesh_from_marching_cubes(image, h, label);
        assert_eq!(after.object().components[0].topology.genus, Some(genus), "{label}");
        assert!(after.quality.radius_ratio_min >= 0.7, "{label}: {:?}", after.quality);
        assert!(after.quality.radius_ratio_mean >= 0.97, "{label}: {:?}", after.quality);
        assert!((after.quality.edge_length_mean / h - 1.0).abs() < 0.15, "{label}: {:?}", after.quality);
    }
}

#[test]
fn a_gyroid_keeps_its_genus_and_gets_good_triangles() {
    let centre = DVec3::splat(8.0);
    let gyroid = |p: DVec3| {
        let q = (p - centre) * 0.62;
        let g = 1.2 * (q.x.sin() * q.y.cos() + q.y.sin() * q.z.cos() + q.z.sin() * q.x.cos());
        // intersected with a ball; the rim is rounded over about a voxel
        let b = p.distance(centre) - 6.6;
        0.5 * (g + b + (g - b).hypot(1.0))
    };
    let image = sampled([20; 3], DVec3::splat(0.85), gyroid);
    let after = remesh_from_marching_cubes(&image, 0.9, "gyroid in a ball");
    assert_eq!(after.object().components[0].topology.genus, Some(2));
    assert!(after.quality.radius_ratio_min >= 0.4, "{:?}", after.quality);
}

#[test]
fn the_two_faces_of_a_thin_shell_never_cross() {
    // a wall of 1.6 voxels, with edges nearly as long as the thickness of the wall
    let image = sampled([19; 3], DVec3::ONE, |p| (p.distance(DVec3::splat(9.1)) - 6.0).abs() - 0.8);
    let after = remesh_from_marching_cubes(&image, 1.4, "shell");
    assert_eq!(after.object().components.len(), 2);
    assert!(after.quality.radius_ratio_min >= 0.5, "{:?}", after.quality);
}

#[test]
fn improving_the_worst_triangles_keeps_the_others() {
    let (centre, radius) = (DVec3::splat(6.1), 4.0);
    let image = sampled([26; 3], DVec3::splat(0.5), ball(centre, radius));
    let field = CubicSpline::new(&image);
    let onto = |p: DVec3| field.project(p, 1.0, 1e-7).unwrap_or(p);
    let mut mesh = shapes::icosphere(radius, 4);
    for p in &mut mesh.vertices {
        *p = onto(*p + centre);
    }
    // some vertices move along the surface until their triangles are needles
    let dragged = [100u32, 700, 1500, 2200];
    for v in dragged {
        let near = mesh.triangles.iter().find(|t| t.contains(&v)).map_or(0, |t| t[usize::from(t[0] == v)]);
        let (p, q) = (mesh.vertices[v as usize], mesh.vertices[near as usize]);
        mesh.vertices[v as usize] = onto(p.lerp(q, 0.9));
    }
    let before = check_object(&mesh, &CheckOptions::default());
    assert!(
        before.quality.radius_ratio_min < 0.2 && before.count(Fault::SelfIntersections) == 0,
        "{:?}",
        before.quality
    );
    let untouched: Vec<DVec3> = mesh.vertices.clone();
    let h = 0.3;
    let (report, _) = improve_object(&mut mesh, &[], &field, &|_| h, &WORST_ONLY, &|| Ok(())).expect("a sound mesh");
    let after = assert_sound(&mesh, &field, &before, "dragged vertices");
    assert!(after.quality.radius_ratio_min >= 0.6, "{:?}", after.quality);
    assert_eq!(report.below_target, 0);
    // all vertices more than two rings from a moved vertex are unchanged
    let stayed = untouched.iter().filter(|p| mesh.vertices.contains(p)).count();
    assert!(stayed + dragged.len() * 20 >= untouched.len(), "{stayed} of {} stayed", untouched.len());
}

#[test]
fn polishing_raises_quality_and_keeps_the_counts() {
    let centre = DVec3::splat(6.1);
    let image = sampled([26; 3], DVec3::splat(0.5), ball(centre, 4.0));
    let field = CubicSpline::new(&image);
    let mut mesh = shapes::icosphere(4.0, 3);
    for (n, p) in mesh.vertices.iter_mut().enumerate() {
        let shake = DVec3::from_array(std::array::from_fn(|a| uniform(5, a as u64, n as u64) - 0.5));
        *p = field.project(*p + centre + 0.35 * shake, 1.0, 1e-7).unwrap_or(*p + centre);
    }
    let before = check_object(&mesh, &CheckOptions::default());
    assert_eq!(before.count(Fault::SelfIntersections), 0);
    let (vertices, triangles) = (mesh.vertices.len(), mesh.triangles.len());
    // without removal of vertices
    let options = ImproveOptions { thins: false, ..ImproveOptions::default() };
    improve_object(&mut mesh, &[], &field, &|_| 0.6, &options, &|| Ok(())).expect("a sound mesh");
    let after = assert_sound(&mesh, &field, &before, "shaken sphere");
    // measured: mean 0.871 to 0.996, minimum 0.296 to 0.943
    assert!(before.quality.radius_ratio_mean < 0.9, "{:?}", before.quality);
    assert!(after.quality.radius_ratio_mean >= 0.98, "{:?}", after.quality);
    assert!(after.quality.radius_ratio_min >= 0.85, "{:?}", after.quality);
    assert_eq!((mesh.vertices.len(), mesh.triangles.len()), (vertices, triangles));
}

#[test]
fn all_triangles_at_a_neck_become_fit() {
    let scene = crate::scenes::hourglass();
    let mut unfit = 0;
    for h in [1.2, 1.6, 2.0, 2.4, 3.2] {
        let (mesh, _, _) = crate::tests::restricted(&scene, h / 1.2);
        let before = check_object(&mesh, &CheckOptions::default());
        let size = |_: DVec3| h;
        let mut surface = Surface::new(&mesh, &scene.field, &size);
        let mut tally = Tally::default();
        optimise::optimise(&mut surface, FIT, &|| Ok(()), &mut tally).expect("nothing stops it");
        let after = assert_sound(&surface.into_mesh(), &scene.field, &before, "hourglass");
        let is_fit = |quality: &QualitySummary| {
            quality.radius_ratio_min >= 0.5 && quality.angle_min >= 25.0 && quality.angle_max <= 120.0
        };
        unfit += usize::from(!is_fit(&before.quality));
        assert!(is_fit(&after.quality), "h {h}: {:?} {tally:?}", after.quality);
    }
    assert!(unfit > 0, "there was nothing to do");
}

#[test]
fn patch_remeshing_changes_only_the_patch() {
    let scene = crate::scenes::hourglass();
    let mut lifted = 0;
    for h in [1.6, 2.0, 2.4, 3.2] {
        let (mesh, _, _) = crate::tests::restricted(&scene, h / 1.2);
        let before = check_object(&mesh, &CheckOptions::default());
        let size = |_: DVec3| h;
        let mut surface = Surface::new(&mesh, &scene.field, &size);
        let all = 0..mesh.triangles.len() as u32;
        let worst = all.min_by(|&a, &b| surface.quality(a).total_cmp(&surface.quality(b))).expect("triangles");
        let least = surface.quality(worst);
        if least >= FIT {
            continue;
        }
        let [a, b, c] = surface.corners(worst);
        let centre = (a + b + c) / 3.0;
        assert!(target_length::remesh(&mut surface, worst, REACHES[0], FIT), "h {h}");
        let alive = || (0..surface.triangles.len() as u32).filter(|&t| surface.is_alive(t));
        let near = |t: &u32| surface.corners(*t).iter().any(|p| p.distance(centre) < h);
        assert!(alive().filter(near).all(|t| surface.quality(t) > least), "h {h}");
        assert!(!surface.is_alive(worst) || surface.quality(worst) >= FIT, "h {h}");
        for (p, q) in mesh.vertices.iter().zip(&surface.positions) {
            assert!(p == q || p.distance(centre) < 2.5 * h, "h {h}: a vertex at {p} was moved");
        }
        assert_sound(&surface.into_mesh(), &scene.field, &before, "hourglass");
        lifted += 1;
    }
    assert!(lifted > 0, "there was nothing to do");
}

/// Returns F of a ball and its mesh of marching cubes, with the vertices on F = 0.
fn rough_sphere(centre: DVec3) -> (CubicSpline, TriangleMesh) {
    let image = sampled([26; 3], DVec3::splat(0.5), ball(centre, 4.0));
    let field = CubicSpline::new(&image);
    let mut mesh = marching_cubes(&image, 0.0);
    mesh.vertices.iter_mut().for_each(|p| *p = field.project(*p, 1.0, 1e-9).unwrap_or(*p));
    (field, mesh)
}

#[test]
fn edits_in_a_patch_form_one_transaction_of_the_whole() {
    let centre = DVec3::splat(6.1);
    let (field, mesh) = rough_sphere(centre);
    let before = check_object(&mesh, &CheckOptions::default());
    let (h, fine) = (|_: DVec3| 0.8, |_: DVec3| 0.4);
    let mut surface = Surface::new(&mesh, &field, &h);
    let region = Bounds { low: centre, high: centre + 5.0 };
    let limits = Limits { lengths: [0.0, f64::INFINITY], ..Limits::STRICT };
    let mut tally = Tally::default();
    let mut remeshed = |surface: &Surface| {
        let whole = Patch::within(surface, &region);
        let mut part = Patch::with_target(&whole.surface, &fine);
        let is_free: Vec<bool> = part.surface.positions.iter().map(|p| p.z > centre.z + 0.5).collect();
        part.keep_free(|v| is_free[v as usize]);
        for _ in 0..4 {
            remesh::round(&mut part.surface, &limits, Curves::Keep, &mut tally);
        }
        let mut whole = whole;
        part.edits(&whole.surface).make(&mut whole.surface);
        whole.edits(surface)
    };
    remeshed(&surface).make(&mut surface);
    // the rest is unchanged, and a rollback restores everything
    for (p, q) in mesh.vertices.iter().zip(&surface.positions) {
        assert!(p == q || p.z > centre.z + 0.5);
    }
    let touched = surface.touched();
    let edited = surface.triangles.clone();
    surface.rollback();
    assert_eq!((&surface.positions, &surface.triangles), (&mesh.vertices, &mesh.triangles));
    // a patch without edits makes no edits in the whole
    Patch::within(&surface, &region).edits(&surface).make(&mut surface);
    assert!(surface.touched().is_empty());

    remeshed(&surface).make(&mut surface);
    assert_eq!((&surface.touched(), &surface.triangles), (&touched, &edited), "the same again");
    assert!(commit_or_rollback(&mut surface, &limits, Goal::Keep { floor: 0.1 }).is_some());
    assert!(tally.collapses > 10 && tally.flips > 10, "{tally:?}");
    assert_sound(&surface.into_mesh(), &field, &before, "a ball with a fine octant");
}

#[test]
fn disjoint_patches_can_all_add_vertices() {
    let centre = DVec3::splat(6.1);
    let (field, mesh) = rough_sphere(centre);
    let before = check_object(&mesh, &CheckOptions::default());
    let mut surface = Surface::new(&mesh, &field, &|_| 0.6);
    let edits: Vec<_> = [DVec3::X, DVec3::NEG_X, DVec3::Y]
        .map(|side| {
            let middle = centre + 4.0 * side;
            let mut patch = Patch::within(&surface, &Bounds { low: middle - 1.5, high: middle + 1.5 });
            let near = |v: &usize| patch.surface.positions[*v].distance(middle);
            let v = (0..patch.surface.positions.len()).min_by(|a, b| near(a).total_cmp(&near(b))).expect("vertices");
            let (u, _) = patch.surface.link(v as u32).next().expect("neighbours");
            moves::split(&mut patch.surface, v as u32, u).expect("an edge");
            patch.surface.commit_as_it_is();
            patch.edits(&surface)
        })
        .into();
    for edits in edits {
        assert!(edits.commit(&mut surface, &[]).len() >= 4);
    }
    for t in 0..surface.triangles.len() as u32 {
        assert_eq!(surface.facts[t as usize], surface.measure(t), "facts of triangle {t}");
    }
    let made = surface.into_mesh();
    assert_eq!(made.vertices.len(), mesh.vertices.len() + 3);
    assert_sound(&made, &field, &before, "three splits");
}

/// Returns F of a double cone and its mesh. The rim of radius 8 is a fold of F: the normals on its
/// two sides differ by 140 degrees.
fn double_cone() -> (Image<f32>, TriangleMesh) {
    let (centre, radius) = (DVec3::splat(11.6), 8.0);
    let (sine, cosine) = 20f64.to_radians().sin_cos();
    let image = sampled([24; 3], DVec3::ONE, |p| {
        let q = p - centre;
        cosine * q.z.abs() + sine * (q.x.hypot(q.y) - radius)
    });
    let apex = radius * sine / cosine;
    let mut mesh =
        TriangleMesh { vertices: vec![centre + apex * DVec3::Z, centre - apex * DVec3::Z], ..Default::default() };
    let rim = 24u32;
    for n in 0..rim {
        let (y, x) = (std::f64::consts::TAU * f64::from(n) / f64::from(rim)).sin_cos();
        mesh.vertices.push(centre + radius * DVec3::new(x, y, 0.0));
        let (a, b) = (2 + n, 2 + (n + 1) % rim);
        mesh.triangles.extend([[0, a, b], [1, b, a]]);
    }
    (image, mesh)
}

#[test]
fn adjacent_triangles_may_fold_only_where_f_folds() {
    let (image, mesh) = double_cone();
    let loose = Limits { deviation: f64::INFINITY, lengths: [0.0, f64::INFINITY], ..Limits::LOOSE };
    let moved_along_the_rim = |field: &CubicSpline, limits: &Limits| {
        let mut surface = Surface::new(&mesh, field, &|_| 2.0);
        surface.move_vertex(2, mesh.vertices[2].lerp(mesh.vertices[3], 0.2));
        acceptance::keeps_limits(&surface, limits)
    };
    let cone = CubicSpline::new(&image);
    assert!(moved_along_the_rim(&cone, &loose));
    assert!(!moved_along_the_rim(&cone, &Limits { fold_of_f: loose.fold, ..loose }), "the rim is no fold");
    // here, the normals of the triangles at this vertex deviate by 70 degrees from grad F: the
    // triangles do not follow F, so their fold is not a fold of F
    let plane = CubicSpline::new(&sampled([24; 3], DVec3::ONE, |p| p.x - 19.6));
    assert!(!moved_along_the_rim(&plane, &loose));
    assert!(moved_along_the_rim(&plane, &Limits { fold: -0.8, ..loose }), "it was not for the fold");
}

#[test]
fn edge_midpoints_stay_on_their_face_of_a_thin_wall() {
    // the midpoint of a chord of the outer face may lie beyond the middle of the wall
    let centre = DVec3::splat(8.1);
    let image = sampled([66; 3], DVec3::splat(0.25), |p| (p.distance(centre) - 6.0).abs() - 0.5);
    let field = CubicSpline::new(&image);
    let size = |_: DVec3| 1.0;
    let surface = Surface::new(&TriangleMesh::default(), &field, &size);
    for outward in [DVec3::X, DVec3::new(0.6, 0.0, -0.8), DVec3::ONE.normalize()] {
        for depth in [0.2, 0.6, 0.8] {
            let middle = centre + (6.5 - depth) * outward;
            let newton = surface.field.projected(OBJECT, middle, 2.0).expect("a point of F = 0").distance(centre);
            assert!((newton - if depth < 0.5 { 6.5 } else { 5.5 }).abs() < 0.02, "{newton}");
            // the normal of a triangle differs from that of F
            let normal = (outward + 0.3 * outward.any_orthonormal_vector()).normalize();
            let facing = surface.field.projected_facing(OBJECT, middle, normal, 2.0).expect("the outer face");
            assert!((facing.distance(centre) - 6.5).abs() < 0.02, "{facing}");
            let other = surface.field.projected_facing(OBJECT, middle, -normal, 2.0).expect("the inner face");
            assert!((other.distance(centre) - 5.5).abs() < 0.02, "{other}");
        }
    }
    assert_eq!(surface.field.projected_facing(OBJECT, centre, DVec3::X, 2.0), None);
}

#[test]
fn deviation_across_a_neck_is_the_radius_of_the_neck() {
    // F has its saddle at the centroid, where |F| / |grad F| is unbounded
    let centre = DVec3::new(11.37, 12.21, 11.84);
    let image = sampled([24; 3], DVec3::ONE, |p| {
        let q = p - centre;
        0.05 * (-0.7 * q.x * q.x + (q.y / 0.2).powi(2) + (q.z / 0.3).powi(2) - 1.0)
    });
    let field = CubicSpline::new(&image);
    let (value, gradient) = field.value_gradient(centre);
    assert!(value.abs() > 100.0 * gradient.length(), "{value} {gradient}");
    let corners = [DVec3::new(1.0, 0.0, 0.0), DVec3::new(-0.5, 0.0, -0.8), DVec3::new(-0.5, 0.0, 0.8)];
    let mesh = TriangleMesh { vertices: corners.map(|c| centre + c).to_vec(), triangles: vec![[0, 1, 2]] };
    let size = |_: DVec3| 2.0;
    let surface = Surface::new(&mesh, &field, &size);
    assert!((surface.facts[0].deviation - 0.2 / 2.0).abs() < 1e-3, "{:?}", surface.facts[0]);
}

#[test]
fn an_error_of_step_leaves_the_mesh_unchanged() {
    use std::sync::atomic::{AtomicUsize, Ordering::Relaxed};
    let scene = crate::scenes::hourglass();
    let (before, _, _) = crate::tests::restricted(&scene, 2.0);
    let stopped_after = |most: usize| {
        let (calls, mut mesh) = (AtomicUsize::new(0), before.clone());
        let step = || if calls.fetch_add(1, Relaxed) < most { Ok(()) } else { Err(Error::input("stopped", "", "")) };
        let ended = improve_object(&mut mesh, &[], &scene.field, &|_| 2.4, &ImproveOptions::default(), &step);
        (ended.is_err(), mesh == before, calls.into_inner())
    };
    let (stopped, unchanged, calls) = stopped_after(usize::MAX);
    assert!(!stopped && !unchanged && calls > ImproveOptions::default().relaxation_sweeps, "{calls}");
    for most in [0, 1, calls - 1] {
        assert_eq!(stopped_after(most), (true, true, most + 1));
    }
}

#[test]
fn a_good_mesh_is_not_changed() {
    let centre = DVec3::splat(6.1);
    let image = sampled([26; 3], DVec3::splat(0.5), ball(centre, 4.0));
    let field = CubicSpline::new(&image);
    let mut mesh = shapes::icosphere(4.0, 3);
    for p in &mut mesh.vertices {
        *p = field.project(*p + centre, 1.0, 1e-7).unwrap_or(*p);
    }
    let before = mesh.clone();
    let (report, _) = improve_object(&mut mesh, &[], &field, &|_| 0.6, &WORST_ONLY, &|| Ok(())).expect("a sound mesh");
    assert_eq!(mesh, before);
    assert_eq!(report.moves, Tally::default());
}

#[test]
fn guarded_nodes_stay_on_their_side() {
    // grid nodes lie near the surface on both sides; long edges would put many of them on the wrong
    // side
    let image = sampled([22; 3], DVec3::ONE, |p| {
        let f = p.distance(DVec3::splat(10.3)) - 7.4;
        if f.abs() < 0.08 { 0.08 * f.signum() } else { f }
    });
    let field = CubicSpline::new(&image);
    let topology = FieldTopology::new(&field);
    let start = marching_cubes(&image, 0.0);
    let before = check_object(
        &start,
        &CheckOptions {
            subject: Some(&Object { field: &field, topology: &topology, samples: Some(&image) }),
            ..CheckOptions::default()
        },
    );
    assert_eq!(before.count(Fault::NodesOnWrongSide), 0);
    let run = |sides: Option<&Image<f32>>| {
        let (mesh, report) = remeshed(&image, &field, &|_| 1.8, sides);
        let after = check_object(
            &mesh,
            &CheckOptions {
                subject: Some(&Object { field: &field, topology: &topology, samples: Some(&image) }),
                ..CheckOptions::default()
            },
        );
        (report, after.count(Fault::NodesOnWrongSide), after.quality.radius_ratio_mean)
    };
    let free = run(None);
    assert!(free.1 > 0, "the guard has nothing to do: {free:?}");
    let guarded = run(Some(&image));
    assert_eq!(guarded.1, 0);
    assert_eq!(guarded.0.nodes_on_wrong_side, Some([0, 0]));
    assert!(guarded.2 > 0.9, "{:?}", guarded.0.after);
}

#[test]
fn edge_lengths_follow_a_graded_size() {
    let centre = DVec3::splat(10.2);
    let image = sampled([21; 3], DVec3::ONE, ball(centre, 7.3));
    let field = CubicSpline::new(&image);
    let before = check_object(&marching_cubes(&image, 0.0), &CheckOptions::default());
    let h = |p: DVec3| 0.6 + 0.1 * (p.z - 2.9).max(0.0);
    let (mesh, report) = remeshed(&image, &field, &h, None);
    assert_sound(&mesh, &field, &before, "graded");
    assert!(report.after.radius_ratio_min >= 0.5, "{:?}", report.after);
    let mean_relative_length = |low: f64, high: f64| {
        let (mut sum, mut count) = (0.0, 0);
        for t in 0..mesh.triangles.len() {
            let [a, b, c] = mesh.corners(t);
            if (low..high).contains(&a.z) {
                sum += (a.distance(b) + b.distance(c) + c.distance(a)) / (3.0 * h(a));
                count += 1;
            }
        }
        sum / f64::from(count)
    };
    for (low, high) in [(2.0, 6.0), (6.0, 12.0), (12.0, 18.0)] {
        let relative = mean_relative_length(low, high);
        assert!((relative - 1.0).abs() < 0.15, "edges are {relative} h between z = {low} and {high}");
    }
}

#[test]
fn the_result_does_not_depend_on_the_number_of_threads() {
    let run = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("a thread pool");
        pool.install(|| {
            let image = sampled([21; 3], DVec3::ONE, ball(DVec3::splat(10.2), 6.3));
            let (ball, _) = remeshed(&image, &CubicSpline::new(&image), &|_| 1.2, None);
            // patches are remeshed at the neck of this scene
            let scene = crate::scenes::hourglass();
            let mut tally = Tally::default();
            let necks = [1.6, 2.0, 2.4, 3.2].map(|h| {
                let (mesh, _, _) = crate::tests::restricted(&scene, h / 1.2);
                let size = |_: DVec3| h;
                let [mut lifted, mut patched] = [(); 2].map(|()| Surface::new(&mesh, &scene.field, &size));
                let is_unfit = |t: &u32| patched.quality(*t) < FIT;
                if let Some(unfit) = (0..mesh.triangles.len() as u32).find(is_unfit) {
                    target_length::remesh(&mut patched, unfit, REACHES[0], FIT);
                }
                optimise::optimise(&mut lifted, 0.7, &|| Ok(()), &mut tally).expect("nothing stops it");
                [lifted.into_mesh(), patched.into_mesh()]
            });
            assert!(tally.single_moves > 0, "{tally:?}");
            (ball, necks)
        })
    };
    assert_eq!(run(1), run(3));
}

#[test]
fn non_manifold_parts_stay_and_invalid_input_fails() {
    let centre = DVec3::splat(6.1);
    let image = sampled([26; 3], DVec3::splat(0.5), ball(centre, 4.0));
    let field = CubicSpline::new(&image);
    let mut mesh = shapes::icosphere(4.0, 2);
    for (n, p) in mesh.vertices.iter_mut().enumerate() {
        let shake = DVec3::from_array(std::array::from_fn(|a| uniform(3, a as u64, n as u64) - 0.5));
        *p += centre + 0.3 * shake;
    }
    // a hole, a duplicate triangle, and a triangle turned around
    let gone = mesh.triangles.pop().unwrap_or_default();
    mesh.triangles.push(mesh.triangles[0]);
    mesh.triangles[40].swap(0, 1);
    let kept = gone.map(|v| mesh.vertices[v as usize]);
    let (report, _) =
        improve_object(&mut mesh, &[], &field, &|_| 0.9, &ImproveOptions::default(), &|| Ok(())).expect("well formed");
    assert!(report.frozen_vertices >= 9);
    assert!(kept.iter().all(|p| mesh.vertices.contains(p)));

    assert!(improve_object(&mut mesh.clone(), &[], &field, &|_| 0.0, &ImproveOptions::default(), &|| Ok(())).is_err());
    assert!(
        improve_object(&mut mesh.clone(), &[], &field, &|_| f64::NAN, &ImproveOptions::default(), &|| Ok(())).is_err()
    );
    let mut broken = mesh.clone();
    broken.triangles[0][1] = u32::MAX;
    assert!(improve_object(&mut broken, &[], &field, &|_| 0.9, &ImproveOptions::default(), &|| Ok(())).is_err());
    broken = mesh;
    broken.vertices[0].x = f64::NAN;
    assert!(improve_object(&mut broken, &[], &field, &|_| 0.9, &ImproveOptions::default(), &|| Ok(())).is_err());
    let mut empty = TriangleMesh::default();
    assert!(improve_object(&mut empty, &[], &field, &|_| 0.9, &ImproveOptions::default(), &|| Ok(())).is_ok());
}
