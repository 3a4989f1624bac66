//! Updates the interfaces of scenes of many materials where h changes.

use super::each::SIDES;
use super::nodes::Nodes;
use super::reconstruct::reconstruct;
use super::scenes::{self, CENTRE, Scene};
use super::subject::Materials;
use crate::complete::Reconstruction;
use crate::options::Options;
use crate::update::update;
use glam::DVec3;
use isoparticles_field::sizing::SizingField;
use isoparticles_mesh::surface::{DataArray, Surface};
use isoparticles_stage::monitor::Silent;
use isoparticles_volume::{Geometry, Image};

const H: f64 = 1.5;

fn surface_of(made: &Reconstruction, geometry: &Geometry) -> Surface {
    let mut surface = Surface::from_grid(&made.interfaces.mesh, geometry);
    made.kept.iter().for_each(|&(v, place)| surface.mesh.vertices[v as usize] = place);
    surface.point_data = vec![DataArray::scalars("h", made.sizes.clone())];
    let side = |n: usize| made.interfaces.between.iter().map(|pair| i64::from(pair[n].0)).collect();
    surface.cell_data = vec![DataArray::integers(SIDES[0], side(0)), DataArray::integers(SIDES[1], side(1))];
    surface
}

/// Returns the surface of a scene, and an update to `size` within 3 mm of a position.
fn before_and_after(scene: &Scene, place: DVec3, size: f64) -> (Surface, Reconstruction, Surface) {
    let geometry = scene.geometry(1.0);
    let (particles, strata) = scene.particles(H, 0.75);
    let field = |h: &dyn Fn(DVec3) -> f64| SizingField::new(Image::sampled(geometry.clone(), |p| h(p) as f32));
    let (options, table) = (Options::default(), scene.table());
    let made = reconstruct((&particles, &strata), &scene.analytic, &table, Some(&field(&|_| H)), &options, &Silent);
    let before = surface_of(&made.expect("on their strata"), &geometry);
    let cone = |p: DVec3| 0.4 * (p.distance(place) - 3.0);
    let h = |p: DVec3| if size < H { (size + cone(p).max(0.0)).min(H) } else { size.min(H - cone(p)).max(H) };
    let nodes = Nodes::new(&geometry, &scene.analytic);
    let subject = Materials { indicators: &scene.analytic, nodes: &nodes, table: &table };
    let made = update(&before, &subject, &field(&h), &options, &Silent);
    let made = made.expect("its surface");
    let after = surface_of(&made, &geometry);
    (before, made, after)
}

#[test]
fn curves_and_interfaces_become_finer_and_coarser() {
    let (sectors, quarters) = (scenes::sectors(), scenes::quarters());
    for (scene, size) in [(&sectors, 0.6), (&sectors, 2.2), (&quarters, 0.6), (&quarters, 2.2)] {
        // the pole of the sectors and an edge of the quarters lie near this place
        let place = CENTRE + 0.5 * scene.extent * DVec3::Z * 0.3;
        let (before, made, after) = before_and_after(scene, place, size);
        assert_eq!(made.failed, [""; 0], "{size}");
        assert!(made.checked.junctions.junction_points >= 2);
        let quality = &made.checked.quality;
        assert!(quality.radius_ratio_mean > 0.88 && quality.radius_ratio_min > 0.4, "{size}: {quality:?}");
        let near = |surface: &Surface| surface.mesh.vertices.iter().filter(|p| p.distance(place) < 3.0).count();
        let (old, new) = (near(&before), near(&after));
        assert_eq!(size < H, new > old, "{size}: {old}, {new}");
        let is_new = |q: &&DVec3| !before.mesh.vertices.contains(q);
        let changed = after.mesh.vertices.iter().filter(is_new);
        let farthest = changed.map(|q| q.distance(place)).fold(0.0, f64::max);
        assert!(farthest < 3.0 + 2.5 + 4.0 * H, "{size}: {farthest}");
    }
}

#[test]
fn surfaces_without_materials_are_refused() {
    let scene = scenes::sectors();
    let (mut before, ..) = before_and_after(&scene, CENTRE, 0.8);
    before.cell_data.clear();
    let sizing = SizingField::new(Image::filled(scene.geometry(1.0), H as f32));
    let nodes = Nodes::new(&scene.geometry(1.0), &scene.analytic);
    let subject = Materials { indicators: &scene.analytic, nodes: &nodes, table: &scene.table() };
    let made = update(&before, &subject, &sizing, &Options::default(), &Silent);
    assert!(made.expect_err("refused").what.contains("have no materials"));
}
