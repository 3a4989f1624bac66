//! Tests label maps: smoothness, volume, sides of voxel centres, and thin parts.

mod support;

use glam::DVec3;
use isoparticles_distfield::field::{Demands, LeastDistances, Source, redistance};
use isoparticles_distfield::{Border, Keep, LabelOptions, Redistanced, from_labels};
use isoparticles_field::spline::{BrickSpline, CubicSpline};
use isoparticles_stage::cli::Context;
use isoparticles_volume::Image;
use support::{directions, sampled, topology, volume};

const MARGIN: usize = 4;

const OPTIONS: LabelOptions =
    LabelOptions { border: Border::Cap, margin: MARGIN, cut: [[false; 2]; 3], clearance: 0.05, keep: Keep::All };

fn extract(mask: &Image<bool>) -> Redistanced {
    let result = from_labels(mask, &OPTIONS, &Context::silent("distfield")).expect("a surface");
    let least = (OPTIONS.clearance * mask.geometry.min_spacing()) as f32;
    let [nx, ny, _] = mask.geometry.size;
    for (n, &inside) in mask.data.iter().enumerate() {
        let f = result.field.at(n % nx + MARGIN, n / nx % ny + MARGIN, n / (nx * ny) + MARGIN);
        assert_eq!(f < 0.0, inside, "voxel {n} changed sides");
        assert!(f.abs() >= least * 0.999, "voxel {n}: |F| = {f}");
    }
    result
}

/// Returns the root-mean-square error of the radius along rays (mm) and the relative error of the
/// volume.
fn ball_errors(radius: f64, spacing: DVec3) -> (f64, f64) {
    let size = ((2.0 * radius + 4.0 * spacing.max_element()) / spacing).ceil();
    let centre = (0.5 * size + DVec3::new(0.13, -0.21, 0.37)) * spacing;
    let mask = sampled([size.x as usize, size.y as usize, size.z as usize], spacing, |p| p.distance(centre) < radius);
    let result = extract(&mask);
    assert_eq!((result.parts_after.components, result.parts_after.cavities), (1, 0));
    let spline = CubicSpline::new(&result.field);
    let centre = centre + spacing * MARGIN as f64;
    let count = 2000;
    let (mut squares, mut cubes) = (0.0, 0.0);
    for direction in directions(count) {
        let (mut low, mut high) = (0.5 * radius, 1.5 * radius);
        for _ in 0..40 {
            let middle = 0.5 * (low + high);
            if spline.value(centre + direction * middle) < 0.0 {
                low = middle;
            } else {
                high = middle;
            }
        }
        squares += (low - radius).powi(2);
        cubes += low.powi(3);
    }
    ((squares / count as f64).sqrt(), cubes / count as f64 / radius.powi(3) - 1.0)
}

#[test]
fn a_binary_ball_becomes_round() {
    let (rms, volume) = ball_errors(20.0, DVec3::ONE);
    println!("ball of 20 voxels: rms {rms:.4} voxel, volume {:+.3} %", 100.0 * volume);
    assert!(rms < 0.06, "rms {rms} voxel");
    assert!(volume.abs() < 0.003, "volume off by {volume}");
}

#[test]
fn thick_slices_are_smoothed_as_well() {
    let spacing = DVec3::new(0.7, 0.7, 3.0);
    let (rms, volume) = ball_errors(14.0, spacing);
    println!("ball of 14 mm, slices of 3 mm: rms {rms:.4} mm, volume {:+.3} %", 100.0 * volume);
    assert!(rms < 0.1 * 3.0, "rms {rms} mm");
    assert!(volume.abs() < 0.005, "volume off by {volume}");
}

/// Returns the thickness, in voxels, of the region F < 0 along a direction through a point. The
/// point is given in index coordinates of the mask.
fn thickness(result: &Redistanced, index: DVec3, direction: DVec3) -> f64 {
    let spline = CubicSpline::new(&result.field);
    let geometry = &result.field.geometry;
    let at = |t: f64| geometry.index_to_grid(index + DVec3::splat(MARGIN as f64) + direction * t);
    (-400..400).filter(|&n| spline.value(at(f64::from(n) * 0.005)) < 0.0).count() as f64 * 0.005
}

#[test]
fn parts_one_voxel_thin_keep_topology_and_half_a_voxel() {
    for spacing in [DVec3::ONE, DVec3::new(0.7, 0.7, 3.0)] {
        let index = |p: DVec3| (p / spacing).round();
        let size = [20, 20, 20];

        let plate = extract(&sampled(size, spacing, |p| {
            let i = index(p);
            i.z == 9.0 && i.x >= 4.0 && i.x < 16.0 && i.y >= 4.0 && i.y < 16.0
        }));
        let found = topology(&plate.field);
        assert_eq!((found.components.len(), found.components[0].genus), (1, Some(0)));
        let thick = thickness(&plate, DVec3::splat(9.0), DVec3::Z);
        assert!(thick > 0.5 * spacing.x.min(spacing.z) / spacing.z, "plate {thick} voxel");

        let rod = extract(&sampled(size, spacing, |p| {
            let i = index(p);
            i.z == 9.0 && i.y == 10.0 && i.x >= 3.0 && i.x < 17.0
        }));
        let found = topology(&rod.field);
        assert_eq!((found.components.len(), found.components[0].genus), (1, Some(0)));
        let thick = thickness(&rod, DVec3::new(9.0, 10.0, 9.0), DVec3::Y);
        assert!(thick > 0.5, "rod {thick} voxel");

        // the outermost voxels of a box form a shell with a cavity
        let shell = extract(&sampled(size, spacing, |p| (index(p) - DVec3::splat(9.0)).abs().max_element() == 5.0));
        assert_eq!((shell.parts_after.components, shell.parts_after.cavities), (1, 1));

        // a square ring of rods: genus 1
        let ring = extract(&sampled(size, spacing, |p| {
            let i = index(p) - DVec3::splat(9.0);
            i.z == 0.0 && i.x.abs().max(i.y.abs()) == 5.0
        }));
        let found = topology(&ring.field);
        assert_eq!((found.components.len(), found.components[0].genus), (1, Some(1)));

        // two blocks one voxel apart keep a gap of more than half a voxel
        let blocks = extract(&sampled(size, spacing, |p| {
            let i = index(p);
            (4.0..=15.0).contains(&i.y) && (4.0..=15.0).contains(&i.z) && (3.0..=15.0).contains(&i.x) && i.x != 9.0
        }));
        assert_eq!(blocks.parts_after.components, 2);
        let gap = 4.0 - thickness(&blocks, DVec3::splat(9.0), DVec3::X);
        assert!(gap > 0.5, "gap {gap} voxel");
    }
}

#[test]
fn single_voxels_and_the_border_are_kept() {
    let voxel = extract(&sampled([7, 7, 7], DVec3::ONE, |p| p == DVec3::splat(3.0)));
    assert_eq!(topology(&voxel.field).components.len(), 1);
    // an object that fills the volume becomes its box
    let full = extract(&sampled([12, 12, 12], DVec3::ONE, |_| true));
    assert!(topology(&full.field).is_closed_manifold());
    let lost = 1.0 - volume(&full.field) / 12f64.powi(3);
    assert!(lost.abs() < 0.03, "volume lost: {lost}");
    let open = LabelOptions { border: Border::Open, ..OPTIONS };
    let slab = sampled([12, 12, 12], DVec3::ONE, |p| p.z < 5.5);
    let slab = from_labels(&slab, &open, &Context::silent("distfield")).expect("a plane");
    assert!(!topology(&slab.field).is_watertight());
    let error = from_labels(&sampled([5, 5, 5], DVec3::ONE, |_| true), &open, &Context::silent("distfield"));
    assert!(error.is_err());
}

#[test]
fn parts_that_touch_along_an_edge_are_joined() {
    let mask = sampled([30, 30, 30], DVec3::ONE, |p| {
        let in_block =
            |low: f64| [p.x, p.y].iter().all(|&x| (low..low + 10.0).contains(&x)) && (5.0..25.0).contains(&p.z);
        in_block(5.0) || in_block(15.0)
    });
    let result = extract(&mask);
    assert_eq!((result.undecided, result.parts_after.components), (0, 1));
    assert_eq!(topology(&result.field).components[0].genus, Some(0));
    let spline = CubicSpline::new(&result.field);
    for z in 5..25 {
        let edge = DVec3::new(14.5, 14.5, f64::from(z)) + DVec3::splat(MARGIN as f64);
        assert!(spline.value(edge) < -0.01, "F = {} at z = {z}", spline.value(edge));
    }
}

#[test]
fn contacts_near_the_border_decide_as_in_the_middle() {
    // wavy layers, one to two voxels thick, without a random quarter of their voxels
    let wave = |p: DVec3| p.z + 4.0 * (0.5 * p.x).sin() + 4.0 * (0.37 * p.y).sin();
    let is_missing = |p: DVec3| (p.dot(DVec3::new(127.1, 311.7, 74.7)).sin() * 43758.5453).rem_euclid(1.0) < 0.25;
    let mask = sampled([30; 3], DVec3::ONE, |p| wave(p).rem_euclid(7.0) < 1.6 && !is_missing(p));
    let result = extract(&mask);
    assert_eq!(result.undecided, 0);
    let parts = [result.parts_before, result.parts_after].map(|parts| (parts.components, parts.cavities));
    assert_eq!(parts[0], parts[1]);
}

#[test]
fn parts_that_touch_at_a_corner_are_apart() {
    let mask = sampled([22, 22, 22], DVec3::ONE, |p| {
        [4.0, 11.0].iter().any(|&low| p.min_element() >= low && p.max_element() < low + 7.0)
    });
    assert_eq!(extract(&mask).parts_after.components, 2);
}

/// Returns the relative difference between the volume of F and the volume of the voxels.
fn swelling(mask: &Image<bool>) -> f64 {
    let voxels = mask.data.iter().filter(|inside| **inside).count() as f64;
    extract(mask).parts_after.volume / (voxels * mask.geometry.spacing.element_product()) - 1.0
}

#[test]
fn thin_layers_and_rods_keep_their_volume() {
    let normals = [DVec3::Z, DVec3::new(1.0, 1.0, 0.0), DVec3::new(8.0, 3.0, 1.0)].map(DVec3::normalize);
    for (thickness, limit) in [(1.0, 0.08), (2.0, 0.03), (3.0, 0.01)] {
        for normal in normals {
            let centre = DVec3::new(15.5, 15.5, if thickness == 2.0 { 15.5 } else { 15.0 });
            let plate = sampled([32; 3], DVec3::ONE, |p| {
                (p - centre).dot(normal).abs() < 0.5 * thickness + 1e-9 && p.distance(centre) < 11.5
            });
            let change = swelling(&plate);
            println!("plate of {thickness} across {normal:.2}: {:+.2} %", 100.0 * change);
            assert!(change.abs() < limit, "plate of {thickness} across {normal}: {change}");
        }
        let rod = sampled([14, 14, 40], DVec3::ONE, |p| {
            [p.x, p.y].iter().all(|x| (5.0..5.0 + thickness).contains(x)) && (5.0..35.0).contains(&p.z)
        });
        let shell =
            sampled([40; 3], DVec3::ONE, |p| (12.0 - thickness..12.0).contains(&p.distance(DVec3::splat(19.5))));
        for (what, mask) in [("rod", rod), ("shell", shell)] {
            let change = swelling(&mask);
            println!("{what} of {thickness}: {:+.2} %", 100.0 * change);
            assert!(change.abs() < limit, "{what} of {thickness}: {change}");
        }
    }
}

/// Returns the position of the zero of F on a line through a point, in voxels from the point. The
/// point is given in index coordinates of the mask.
fn crossing(result: &Redistanced, index: DVec3, direction: DVec3) -> f64 {
    let spline = CubicSpline::new(&result.field);
    let at =
        |t: f64| spline.value(result.field.geometry.index_to_grid(index + DVec3::splat(MARGIN as f64) + direction * t));
    let (mut low, mut high) = (-0.9, 0.9);
    let inside = at(low) < 0.0;
    for _ in 0..40 {
        let middle = 0.5 * (low + high);
        if (at(middle) < 0.0) == inside { low = middle } else { high = middle }
    }
    low
}

#[test]
fn flat_faces_and_caps_stay_flat() {
    let cube = |size: f64| {
        let side = 7.0..7.0 + size;
        extract(&sampled([14 + size as usize; 3], DVec3::ONE, |p| p.to_array().iter().all(|x| side.contains(x))))
    };
    let cylinder =
        extract(&sampled([32, 32, 40], DVec3::ONE, |p| (p.truncate() - glam::DVec2::splat(15.5)).length() < 12.0));
    // maximum distance of F = 0 from height `z` over a square region of the face at low z
    let largest = |result: &Redistanced, [first, last]: [i32; 2], z: f64| {
        let places =
            (first..=last).flat_map(|x| (first..=last).map(move |y| DVec3::new(f64::from(x), f64::from(y), z)));
        places.map(|place| crossing(result, place, DVec3::Z).abs()).fold(0.0, f64::max)
    };
    // all positions are at least 5.5 voxels from the edges of the cubes
    let faces = [largest(&cube(20.0), [12, 21], 6.5), largest(&cube(40.0), [12, 41], 6.5)];
    let cap = largest(&cylinder, [12, 21], -0.5);
    println!("largest distance from half-way, voxels: faces {:.3} {:.3}, cap {cap:.3}", faces[0], faces[1]);
    assert!(faces[0] < 0.05 && faces[1] < 0.05 && cap < 0.02, "{faces:?} {cap}");
}

/// The object consists of a ball, a smaller ball, and two single voxels.
#[test]
fn small_parts_are_dropped_and_reported() {
    let mask = sampled([30, 20, 20], DVec3::ONE, |p| {
        let in_ball = |x: f64, r: f64| p.distance(DVec3::new(x, 9.0, 9.0)) <= r;
        in_ball(8.0, 6.0) || in_ball(22.0, 3.0) || p == DVec3::new(28.0, 2.0, 2.0) || p == DVec3::new(2.0, 17.0, 17.0)
    });
    let volume =
        |x: f64| mask.data.iter().enumerate().filter(|&(n, &m)| m && ((n % 30) as f64 - x).abs() < 6.5).count();
    // each count includes one of the single voxels, which is subtracted
    let (large, small) = (volume(8.0) as f64 - 1.0, volume(22.0) as f64 - 1.0);
    assert!(large > 800.0 && (100.0..200.0).contains(&small));
    for (keep, components, gone) in [
        (Keep::All, 4, 0.0),
        (Keep::Volume(50.0), 2, 2.0),
        (Keep::Volume(small), 2, 2.0),
        (Keep::Largest, 1, small + 2.0),
    ] {
        let options = LabelOptions { keep, ..OPTIONS };
        let result = from_labels(&mask, &options, &Context::silent("distfield")).expect("a surface");
        assert_eq!((result.parts_before.components, result.parts_after.components), (components, components), "{keep}");
        assert_eq!((result.dropped.components, result.dropped.volume), (4 - components, gone), "{keep}");
        // voxels of parts that were not dropped keep their side
        let inside = result.field.data.iter().filter(|f| **f < 0.0).count();
        assert_eq!(inside + gone as usize, mask.data.iter().filter(|m| **m).count(), "{keep}");
        assert_eq!(result.dropped.nodes.as_ref().map_or(0, |nodes| nodes.count()), gone as usize);
    }
    let options = LabelOptions { keep: Keep::Volume(5000.0), ..OPTIONS };
    let error = from_labels(&mask, &options, &Context::silent("distfield")).err().expect("nothing would be left");
    assert!(error.what.contains("--keep 5000"), "{error}");
}

#[test]
fn parts_at_an_open_border_count_only_their_voxels() {
    let block = |p: DVec3, low: [f64; 3], high: [f64; 3]| {
        p.cmpge(DVec3::from_array(low) - 0.5).all() && p.cmplt(DVec3::from_array(high) - 0.5).all()
    };
    // a part of 64 voxels, and a part of 32 voxels at the face z = 0; the open border extends the
    // smaller part into the margin, which must not count
    let mask = sampled([16, 10, 14], DVec3::ONE, |p| {
        block(p, [2.0, 3.0, 7.0], [6.0, 7.0, 11.0]) || block(p, [9.0, 3.0, 0.0], [13.0, 7.0, 2.0])
    });
    let options = LabelOptions { keep: Keep::Largest, border: Border::Open, ..OPTIONS };
    let result = from_labels(&mask, &options, &Context::silent("distfield")).expect("a surface");
    assert_eq!((result.dropped.components, result.dropped.volume), (1, 32.0));
    let kept = result.field.data.iter().filter(|f| **f < 0.0).count();
    assert_eq!(kept, 64);
}

#[test]
fn a_one_voxel_hole_in_a_full_open_volume_is_kept() {
    let hole = sampled([9, 9, 9], DVec3::ONE, |p| p != DVec3::splat(4.0));
    let open = LabelOptions { border: Border::Open, ..OPTIONS };
    let kept = from_labels(&hole, &open, &Context::silent("distfield")).expect("the hole");
    assert_eq!(kept.parts_after.cavities, 1);
}

#[test]
fn a_source_without_a_zero_set_is_refused() {
    for value in [-1.0, 1.0] {
        let nodes = sampled([6, 6, 6], DVec3::ONE, |_| value);
        let source = Source { spline: BrickSpline::new(&nodes), cap: None };
        let silent = Context::silent("distfield");
        let least = LeastDistances { most: 1e-3, at: |_| 1e-3 };
        let error =
            redistance(nodes, &source, least, (Keep::All, 0), &Demands::default(), &silent).err().expect("no surface");
        assert!(error.what.contains("no surface"), "{error}");
    }
}
