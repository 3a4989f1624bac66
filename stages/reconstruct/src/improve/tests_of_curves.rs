//! Vertices on a junction curve of three interfaces slide along it and are merged into neighbours
//! on it.

use super::acceptance::{Goal, Limits, commit_or_rollback};
use super::curves::{collapse_along, slide};
use super::functions::Freedom;
use super::surface::Surface;
use super::*;
use crate::interfaces::Interface;
use glam::DMat3;
use isoparticles_field::materials::MaterialId;
use isoparticles_field::spline::Jet;
use std::f64::consts::TAU;

/// Three half-planes that meet in the z axis. The function of each half-plane is the signed
/// distance from its plane.
struct HalfPlanes;

/// Returns the interface with a number from 0 to 2.
fn pair(number: u16) -> Interface {
    [MaterialId(number), MaterialId((number + 1) % 3)]
}

fn way(pair: Interface) -> DVec3 {
    let angle = f64::from(pair[0].0) * TAU / 3.0;
    DVec3::new(angle.cos(), angle.sin(), 0.0)
}

fn normal(pair: Interface) -> DVec3 {
    way(pair).cross(DVec3::Z)
}

impl InterfaceFunctions for HalfPlanes {
    fn value(&self, pair: Interface, p: DVec3) -> f64 {
        normal(pair).dot(p)
    }

    fn value_gradient(&self, pair: Interface, p: DVec3) -> (f64, DVec3) {
        (self.value(pair, p), normal(pair))
    }

    fn jet(&self, pair: Interface, p: DVec3) -> Jet {
        Jet { value: self.value(pair, p), gradient: normal(pair), hessian: DMat3::ZERO }
    }

    fn project(&self, pair: Interface, start: DVec3, limit: f64, _: f64) -> Option<(DVec3, DVec3)> {
        let place = start - normal(pair) * self.value(pair, start);
        (place.distance(start) < limit).then_some((place, normal(pair)))
    }

    fn project_onto_curve(&self, _: [Interface; 2], start: DVec3, limit: f64, _: f64) -> Option<DVec3> {
        let place = DVec3::Z * start.z;
        (place.distance(start) <= limit).then_some(place)
    }

    fn voxel(&self) -> f64 {
        1.0
    }
}

/// Returns a mesh of three interfaces, the interface of each triangle and the freedom of each
/// vertex. The vertices on the axis have the given heights; the first and last are fixed. In each
/// interface, triangles join them to a row of fixed vertices.
fn fan(heights: &[f64]) -> (TriangleMesh, Vec<Interface>, Vec<Freedom>) {
    let count = heights.len() as u32;
    let mut mesh = TriangleMesh { vertices: heights.iter().map(|&z| DVec3::Z * z).collect(), triangles: Vec::new() };
    let mut interfaces = Vec::new();
    let last = count - 1;
    let ends = |v: u32| if v == 0 || v == last { Freedom::None } else { Freedom::Curve };
    let mut freedom: Vec<Freedom> = (0..count).map(ends).collect();
    for pair in [0, 1, 2].map(pair) {
        let first = mesh.vertices.len() as u32;
        mesh.vertices.extend((0..count).map(|n| 0.8 * way(pair) + DVec3::Z * (f64::from(n) + 0.5)));
        freedom.resize(mesh.vertices.len(), Freedom::None);
        for n in 0..last {
            let [a, b, c, d] = [n, n + 1, first + n, first + n + 1];
            for [p, q, r] in [[a, c, b], [b, c, d]] {
                let [x, y, z] = [p, q, r].map(|v| mesh.vertices[v as usize]);
                let is_upright = (y - x).cross(z - x).dot(normal(pair)) > 0.0;
                mesh.triangles.push(if is_upright { [p, q, r] } else { [p, r, q] });
                interfaces.push(pair);
            }
        }
    }
    (mesh, interfaces, freedom)
}

const LIMITS: Limits = Limits { lengths: [0.3, 2.0], ..Limits::STRICT };

#[test]
fn sliding_maximises_the_minimum_over_three_interfaces() {
    let (mesh, interfaces, freedom) = fan(&[0.0, 1.0, 2.4, 3.0, 4.0]);
    let mut surface = Surface::of_interfaces(&mesh, interfaces, freedom, &HalfPlanes, &|_| 1.0);
    surface.fill_grid();
    assert!(surface.curve_through(2).is_some_and(|curve| curve.ends == [1, 3] && curve.pairs == [0, 1, 2].map(pair)));
    assert!(!slide(&mut surface, 0) && !slide(&mut surface, 7), "what is held stays");
    assert!(slide(&mut surface, 2));
    let place = surface.positions[2];
    assert!(place.truncate().length() == 0.0 && (place.z - 2.0).abs() < 0.02, "{place}");
    assert!(commit_or_rollback(&mut surface, &LIMITS, Goal::Lift { bar: 0.9 }).is_some());
    assert!(!slide(&mut surface, 2), "there is no better place");
    // only the triangles at the vertex have changed, not their neighbours
    let at_vertex = |t: u32| surface.triangles[t as usize].contains(&2);
    let all = 0..surface.triangles.len() as u32;
    assert!(all.into_iter().all(|t| surface.has_changed(t) == at_vertex(t)));
}

#[test]
fn a_curve_collapse_removes_a_triangle_of_each_interface() {
    let (mesh, interfaces, freedom) = fan(&[0.0, 1.0, 1.2, 2.0, 3.0]);
    let count = mesh.triangles.len();
    let mut surface = Surface::of_interfaces(&mesh, interfaces, freedom, &HalfPlanes, &|_| 1.0);
    surface.fill_grid();
    assert!(!collapse_along(&mut surface, 3, 1), "no neighbours");
    assert!(!collapse_along(&mut surface, 1, 0), "what is held stays");
    assert!(collapse_along(&mut surface, 1, 2));
    let alive = surface.triangles.iter().filter(|t| t[0] != u32::MAX).count();
    assert_eq!((alive, surface.degree(2)), (count - 3, 0));
    assert!(surface.curve_through(1).is_some_and(|curve| curve.ends == [0, 3]), "{:?}", surface.curve_through(1));
    surface.rollback();
    assert!(surface.curve_through(1).is_some_and(|curve| curve.ends == [0, 2]));
}

#[test]
fn curve_vertices_of_two_or_three_interfaces_can_move() {
    for (count, expected) in [(1, Freedom::None), (2, Freedom::Curve), (3, Freedom::Curve)] {
        let (mut mesh, mut interfaces, freedom) = fan(&[0.0, 1.0, 2.0, 3.0]);
        mesh.triangles.truncate(6 * count);
        interfaces.truncate(6 * count);
        let surface = Surface::of_interfaces(&mesh, interfaces, freedom, &HalfPlanes, &|_| 1.0);
        assert_eq!(surface.freedom[1], expected, "{count} interfaces");
        // no edge of the curve has both triangles in one interface
        assert!(surface.edge_triangles(0, 1).is_none());
    }
}
