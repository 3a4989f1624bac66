//! Repairs grid nodes on the wrong side, collapses superfluous vertices, and measures the quality
//! of triangles.

use super::acceptance::{Goal, commit_or_rollback};
use super::constants::{AIM, FIT};
use super::surface::measure::quality_of;
use super::tests::{ball, improve_guarded, remeshed, sampled};
use super::*;
use crate::check::{CheckOptions, Fault, check_object};
use crate::interfaces::OBJECT;
use crate::subject::Object;
use isoparticles_field::spline::CubicSpline;
use isoparticles_field::topology::FieldTopology;
use isoparticles_mesh::shapes;

const LIMITS: Limits = Limits::STRICT;

#[test]
fn wrong_grid_nodes_are_repaired_with_fit_triangles() {
    // grid nodes lie near the surface on both sides; an unguarded mesh has some on the wrong side
    let image = sampled([22; 3], DVec3::ONE, |p| {
        let f = p.distance(DVec3::splat(10.3)) - 7.4;
        if f.abs() < 0.08 { 0.08 * f.signum() } else { f }
    });
    let field = CubicSpline::new(&image);
    let (mut mesh, _) = remeshed(&image, &field, &|_| 1.8, None);
    let report = improve_guarded(&mut mesh, &field, Some(&image), &|_| 1.8, &ImproveOptions::default());
    let [before, after] = report.nodes_on_wrong_side.expect("nodes are guarded");
    assert!(before > 0, "there was nothing to do");
    assert_eq!(after, 0, "{before} before, {:?}", report.moves);
    let checked = check_object(
        &mesh,
        &CheckOptions {
            subject: Some(&Object { field: &field, topology: &FieldTopology::new(&field), samples: Some(&image) }),
            ..CheckOptions::default()
        },
    );
    assert_eq!(checked.count(Fault::NodesOnWrongSide), 0);
    assert!(checked.quality.radius_ratio_min >= FIT, "{:?}", checked.quality);
}

#[test]
fn superfluous_vertices_are_collapsed_and_the_others_kept() {
    let centre = DVec3::splat(6.1);
    let field = CubicSpline::new(&sampled([26; 3], DVec3::splat(0.5), ball(centre, 4.0)));
    let mut mesh = shapes::icosphere(4.0, 3);
    for p in &mut mesh.vertices {
        *p = field.project(*p + centre, 1.0, 1e-7).expect("F = 0 is near");
    }
    let h = summarise(&mesh).edge_length_mean;
    let size = |_: DVec3| h;
    let mut surface = Surface::new(&mesh, &field, &size);
    let all = |surface: &Surface| (0..surface.triangles.len() as u32).collect::<Vec<_>>();
    let triangles = all(&surface);
    target_length::coarsen(&mut surface, triangles, h);
    let count = surface.clone().into_mesh().vertices.len();
    assert!(count > mesh.vertices.len() * 4 / 5, "{count} of {}", mesh.vertices.len());
    for (a, b) in remesh::edges(&surface).into_iter().filter(|&(a, _)| a < 40) {
        if moves::split(&mut surface, a, b).is_some() {
            commit_or_rollback(&mut surface, &LIMITS, Goal::Keep { floor: 0.3 });
        }
        surface.rollback();
    }
    let split = surface.clone().into_mesh().vertices.len();
    assert!(split > count + 50, "{split} of {count}");
    let triangles = all(&surface);
    target_length::coarsen(&mut surface, triangles, h);
    let made = surface.into_mesh();
    assert!(made.vertices.len() < count + (split - count) / 4, "{} of {split}, {count} before", made.vertices.len());
    assert!(summarise(&made).radius_ratio_min >= FIT, "{:?}", summarise(&made));
}

#[test]
fn quality_is_fit_and_aim_at_the_limits_of_the_angles() {
    // quality of an isosceles triangle with this angle (degrees) at the apex
    let quality = |apex: f64| {
        let (x, y) = (0.5 * apex.to_radians()).sin_cos();
        quality_of(DVec3::ZERO, DVec3::new(x, y, 0.0), DVec3::new(-x, y, 0.0))
    };
    for (apex, expected) in [(12.5, 0.5 * FIT), (25.0, FIT), (28.0, AIM), (60.0, 1.0), (105.0, AIM)] {
        assert!((quality(apex) - expected).abs() < 1e-9, "{apex} degrees: {}", quality(apex));
    }
    assert!(quality(120.0) < FIT && quality(27.9) < AIM && quality(105.1) < AIM);
}

#[test]
fn triangles_on_short_fixed_sides_are_rated_by_height() {
    // a tetrahedron with h = 1 and one short edge between fixed vertices
    let apex = |y: f64, z: f64| DVec3::new(0.025, y, z);
    let vertices = vec![DVec3::ZERO, DVec3::X * 0.05, apex(0.75f64.sqrt(), 0.0), apex(0.0, 0.3)];
    let mesh = TriangleMesh { vertices, triangles: vec![[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]] };
    let field = CubicSpline::new(&sampled([5; 3], DVec3::ONE, ball(DVec3::ZERO, 1.0)));
    let judged = |ends: [Freedom; 2]| {
        let freedom = vec![ends[0], ends[1], Freedom::Interface, Freedom::Interface];
        let surface = Surface::of_interfaces(&mesh, vec![OBJECT; 4], freedom, &field, &|_| 1.0);
        [0, 1, 2].map(|t| surface.quality(t))
    };
    let [plain, low, other] = judged([Freedom::None; 2]);
    assert!(plain < 0.15 && low < 0.35, "{plain} {low}");
    let [good, lower, same] = judged([Freedom::Point; 2]);
    assert!((good - 1.0).abs() < 1e-9, "{good}");
    assert_eq!(lower, low, "a corner as near as that can be at a better place, which is nearer still");
    assert_eq!(other, same, "no other triangle is judged by it");
    assert_eq!(
        judged([Freedom::Point, Freedom::None]),
        [plain, low, other],
        "a curve's vertex may be far from the next"
    );
}
