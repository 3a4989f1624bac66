//! Updates the interfaces between materials where h has changed, like [`crate::update`] for one
//! object.

use super::improve::improve;
use super::nodes::Nodes;
use super::reconstruct::{MaterialsTruth, Reconstruction, checked};
use crate::improve::ImproveOptions;
use crate::interfaces::{Interfaces, Joined};
use crate::materials::each::SIDES;
use crate::options::Options;
use crate::update::{FARTHEST, check_belongs, kept, sizes_of, with_another_size};
use glam::DVec3;
use isoparticles_field::materials::{Indicators, Material, MaterialId};
use isoparticles_field::sizing::SizingField;
use isoparticles_field::spline::distance_estimate;
use isoparticles_mesh::surface::Surface;
use isoparticles_stage::error::{Error, Result};
use isoparticles_stage::monitor::Monitor;
use isoparticles_volume::Geometry;
use rayon::prelude::*;

/// Changes the interfaces of `previous` (world coordinates, with h at its vertices and materials at
/// its triangles) where `sizing` differs from this h. `table` contains the materials.
///
/// # Errors
/// If the surface has no h or no materials, or if the run is interrupted. A complex that fails a
/// check is not an error.
pub fn update(
    previous: &Surface,
    (indicators, nodes): (&dyn Indicators, &Nodes),
    table: &[Material],
    sizing: &SizingField,
    options: &Options,
    monitor: &dyn Monitor,
) -> Result<Reconstruction> {
    let phase = monitor.phase("read the interfaces");
    let mut interfaces = interfaces_of(previous, indicators, nodes.geometry(), table.len())?;
    join_the_distant(&mut interfaces, indicators, options)?;
    drop(phase);
    monitor.check()?;

    let phase = monitor.phase("improve");
    let size = |p: DVec3| sizing.at(p);
    let around = with_another_size(&interfaces.mesh, &sizes_of(previous)?, &size);
    let how = ImproveOptions {
        target: options.improve_below,
        relaxation_sweeps: options.relaxation_sweeps,
        thins: false,
        sides: None,
        around: Some(&around),
        adjusts: true,
    };
    let dimensions = interfaces.dimensions();
    let before = interfaces.mesh.vertices.clone();
    let guarded = options.keeps_voxels.then_some(nodes);
    let step = || Ok(monitor.check()?);
    let (improved, numbers) = improve(&mut interfaces, &dimensions, indicators, guarded, &size, &how, &step)?;
    // the edges of curves have changed if they were split or collapsed
    interfaces.segments = interfaces.edges_of_curves();
    drop(phase);
    monitor.check()?;
    let kept = kept(&previous.mesh, &before, &interfaces.mesh, &numbers);
    let sizes = interfaces.mesh.vertices.par_iter().map(|&p| size(p)).collect();
    let truth = MaterialsTruth { indicators, nodes };
    let (checked, pieces, failed) = checked(&interfaces, &truth, table, options, monitor);
    Ok(Reconstruction { interfaces, sizes, joining: None, kept, improved, checked, pieces, failed })
}

/// Converts a surface to interfaces in the grid frame, with the edges of their junction curves.
/// `count` is the number of materials.
fn interfaces_of(
    surface: &Surface,
    indicators: &dyn Indicators,
    geometry: &Geometry,
    count: usize,
) -> Result<Interfaces> {
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
    let first_beyond = indicators.first_beyond();
    let beyond = |cap: f64| first_beyond.filter(|_| cap > 0.0).map(|first| MaterialId(first.0 + cap as u16 - 1));
    let sides = inside.into_iter().zip(outside).zip(cap);
    let pair = |((inside, outside), cap): ((f64, f64), f64)| {
        [MaterialId(inside as u16), beyond(cap).unwrap_or(MaterialId(outside as u16))]
    };
    let mut interfaces = Interfaces {
        mesh: surface.to_grid(geometry),
        between: sides.map(pair).collect(),
        first_beyond,
        ..Interfaces::default()
    };
    interfaces.segments = interfaces.edges_of_curves();
    Ok(interfaces)
}

/// Records as joined the vertices that are farther than the limit of the check from one of their
/// interfaces. In the surface of a reconstruction, these are vertices at which strata were merged.
/// The check accepts their present distances.
///
/// # Errors
/// If most vertices are far from their interfaces.
fn join_the_distant(interfaces: &mut Interfaces, indicators: &dyn Indicators, options: &Options) -> Result<()> {
    let limit = options.max_vertex_distance * indicators.voxel();
    let distance = |&(v, [i, j]): &(u32, [MaterialId; 2])| {
        let (value, gradient) = indicators.difference_gradient(i, j, interfaces.mesh.vertices[v as usize]);
        (v, distance_estimate(value, gradient).abs())
    };
    let distances: Vec<(u32, f64)> = interfaces.pairs_at_vertices().par_iter().map(distance).collect();
    let of_vertex = distances.chunk_by(|a, b| a.0 == b.0);
    let worst: Vec<(u32, f64)> =
        of_vertex.map(|own| (own[0].0, own.iter().map(|(_, distance)| *distance).fold(0.0, f64::max))).collect();
    let far = worst.iter().filter(|own| own.1 > FARTHEST * indicators.voxel()).count();
    check_belongs(&interfaces.mesh, far, "its interfaces")?;
    let distant = worst.into_iter().filter(|own| own.1 > limit);
    interfaces.joined = distant.map(|(vertex, distance)| Joined { vertex, distance }).collect();
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::super::reconstruct::reconstruct;
    use super::super::scenes::{self, CENTRE, Scene};
    use super::*;
    use isoparticles_mesh::surface::DataArray;
    use isoparticles_stage::monitor::Silent;
    use isoparticles_volume::Image;

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
        let made = update(
            &before,
            (&scene.analytic, &Nodes::new(&geometry, &scene.analytic)),
            &table,
            &field(&h),
            &options,
            &Silent,
        );
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
        let (analytic, nodes) = (&scene.analytic, &Nodes::new(&scene.geometry(1.0), &scene.analytic));
        let made = update(&before, (analytic, nodes), &scene.table(), &sizing, &Options::default(), &Silent);
        assert!(made.err().expect("refused").what.contains("have no materials"));
    }
}
