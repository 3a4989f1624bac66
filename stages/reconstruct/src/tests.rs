//! The reconstruction of analytic scenes from sparse and from dense points.

use crate::defects::Defects;
use crate::isosurface::Isosurface;
use crate::prepare::{PrepareReport, SurfacePoints};
use crate::refine::{RefineOptions, RefineReport, Refinement};
use crate::scenes::{self, Scene};
use glam::DVec3;
use isoparticles_common::mesh::TriangleMesh;

fn surface(scene: &Scene, spacing: f64) -> (TriangleMesh, Defects, RefineReport, Vec<i64>) {
    let positions = scene.points(spacing);
    let sizes = vec![spacing * 1.2; positions.len()];
    let points = SurfacePoints { positions, sizes, report: PrepareReport::default() };
    let isosurface = Isosurface::new(&scene.image);
    let mut refinement = Refinement::new(&points, &scene.field, &isosurface, RefineOptions::default()).unwrap();
    let facets = refinement.run(|_, _| Ok(())).unwrap();
    let defects = refinement.defects(&facets);
    let mesh = TriangleMesh {
        vertices: refinement.restricted.points().to_vec(),
        triangles: facets.iter().map(|f| f.vertices).collect(),
    };
    (mesh, defects, refinement.report.clone(), isosurface.euler.clone())
}

fn volume_and_area(mesh: &TriangleMesh) -> (f64, f64) {
    mesh.triangles.iter().fold((0.0, 0.0), |(volume, area), t| {
        let [a, b, c] = t.map(|v| mesh.vertices[v as usize] - DVec3::splat(15.0));
        (volume + a.dot(b.cross(c)) / 6.0, area + (b - a).cross(c - a).length() / 2.0)
    })
}

#[test]
fn all_scenes_at_several_spacings() {
    for (name, scene) in [
        ("sphere", scenes::sphere()),
        ("torus", scenes::torus()),
        ("balls", scenes::two_balls()),
        ("shell", scenes::shell()),
        ("gyroid", scenes::gyroid()),
    ] {
        for spacing in [0.8, 1.5, 2.5, 4.0] {
            let (mesh, defects, report, euler) = surface(&scene, spacing);
            let (volume, area) = volume_and_area(&mesh);
            println!(
                "{name} {spacing}: {} points, V {volume:.1} A {area:.1} empty {} euler {euler:?} {report:?}",
                mesh.vertices.len(),
                defects.is_empty()
            );
        }
    }
}

#[test]
fn look() {
    let scene = scenes::gyroid();
    let iso = Isosurface::new(&scene.image);
    for c in 0..iso.component_count() {
        let s = iso.samples(c as u32);
        let low = s.iter().copied().reduce(DVec3::min).unwrap();
        let high = s.iter().copied().reduce(DVec3::max).unwrap();
        println!("coarse {c}: {} euler {} {low} {high}", s.len(), iso.euler[c]);
    }
    let fine = Scene::new([106; 3], DVec3::splat(1.0 / 3.0), |p| scene.field.value(p));
    let iso = Isosurface::new(&fine.image);
    for c in 0..iso.component_count() {
        let s = iso.samples(c as u32);
        let low = s.iter().copied().reduce(DVec3::min).unwrap();
        let high = s.iter().copied().reduce(DVec3::max).unwrap();
        println!("fine {c}: {} euler {} {low} {high}", s.len(), iso.euler[c]);
    }
}
