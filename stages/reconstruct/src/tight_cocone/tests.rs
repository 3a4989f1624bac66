//! Tests Tight Cocone on analytic scenes, and on noisy, incomplete and degenerate point clouds.

use super::*;
use crate::check::{CheckOptions, CheckReport, check_object};
use crate::interfaces::Interfaces;
use crate::prepare::SurfacePoints;
use crate::scenes::{self, Scene};
use isoparticles_field::random::uniform;
use isoparticles_mesh::TriangleMesh;
use rayon::prelude::*;

/// Returns the surface of points, as the program computes it without a field.
fn surface(positions: &[DVec3], normals: &[DVec3]) -> Result<(TriangleMesh, CoconeReport)> {
    let (positions, normals) = (positions.to_vec(), normals.to_vec());
    let mut points = SurfacePoints { positions, normals, ..SurfacePoints::default() };
    let delaunay = points.triangulate()?;
    let normals = (!points.normals.is_empty()).then_some(&points.normals[..]);
    let (facets, report) = tight_cocone(&delaunay, normals)?;
    let mut interfaces = Interfaces::compact_object(&points.positions, facets.iter().map(|facet| facet.vertices)).0;
    interfaces.separate_touching(|_, p| Some(p));
    Ok((interfaces.mesh, report))
}

fn checked(mesh: &TriangleMesh) -> CheckReport {
    check_object(mesh, &CheckOptions::default())
}

fn normals_of(scene: &Scene, points: &[DVec3]) -> Vec<DVec3> {
    points.iter().map(|&p| scene.gradient(p)).collect()
}

/// Euler characteristic of a component, and whether it is the wall of a cavity.
type Part = (i64, bool);

fn parts(report: &CheckReport) -> Vec<Part> {
    let mut parts: Vec<Part> =
        report.object().components.iter().map(|c| (c.topology.euler, c.measure.volume < 0.0)).collect();
    parts.sort_unstable();
    parts
}

/// A torus of radii 9 and 3.5 with bumps.
fn bumpy_torus() -> Scene {
    Scene::new([32; 3], DVec3::ONE, |p| {
        let q = p - scenes::CENTRE;
        let ring = q.truncate().length() - 9.0;
        ring.hypot(q.z) - 3.5 - 0.35 * (6.0 * q.y.atan2(q.x)).sin() * (3.0 * q.z.atan2(ring)).cos()
    })
}

/// A ball in the cavity of a shell.
fn ball_in_a_shell() -> Scene {
    Scene::new([32; 3], DVec3::ONE, |p| {
        let r = p.distance(scenes::CENTRE);
        (r - 4.0).min((r - 10.0).abs() - 2.0)
    })
}

#[test]
fn well_sampled_scenes_keep_topology_with_and_without_normals() {
    const BALL: Part = (2, false);
    const CAVITY: Part = (2, true);
    let cases: &[(&str, Scene, f64, &[Part])] = &[
        ("ball", scenes::sphere(), 1.0, &[BALL]),
        ("sparse ball", scenes::sphere(), 3.0, &[BALL]),
        ("torus", scenes::torus(), 0.8, &[(0, false)]),
        ("sparse torus", scenes::torus(), 1.6, &[(0, false)]),
        ("bumpy torus", bumpy_torus(), 0.6, &[(0, false)]),
        ("two balls", scenes::two_balls(), 0.8, &[BALL, BALL]),
        ("thin wall", scenes::shell(), 0.9, &[BALL, CAVITY]),
        ("ball in a shell", ball_in_a_shell(), 1.0, &[BALL, BALL, CAVITY]),
        ("gyroid", scenes::gyroid(), 0.6, &[(-14, false)]),
    ];
    for (name, scene, spacing, expected) in cases {
        let points = scene.points(*spacing);
        let normals = normals_of(scene, &points);
        let inward: Vec<DVec3> = normals.iter().map(|n| -3.0 * *n).collect();
        let senseless: Vec<DVec3> = (0..points.len() as u64)
            .map(|n| normals[n as usize] * if uniform(4, 0, n) < 0.5 { -1.0 } else { 1.0 })
            .collect();
        let partly: Vec<DVec3> = (0..points.len() as u64)
            .map(|n| if uniform(6, 0, n) < 0.3 { DVec3::ZERO } else { normals[n as usize] })
            .collect();
        let random: Vec<DVec3> = (0..points.len() as u64)
            .map(|n| DVec3::new(uniform(5, 0, n), uniform(5, 1, n), uniform(5, 2, n)) - 0.5)
            .collect();
        let mut bare = None;
        for (kind, normals, taken, oriented) in [
            ("none", vec![], false, false),
            ("outward", normals, true, true),
            ("inward", inward, true, true),
            ("of no sense", senseless, true, false),
            ("random", random, false, false),
            ("partly zero", partly, true, false),
            ("all zero", vec![DVec3::ZERO; points.len()], false, false),
        ] {
            let (mesh, report) = surface(&points, &normals).unwrap();
            let failed = checked(&mesh).failed;
            assert!(failed.is_empty(), "{name}, normals {kind}: {failed:?} {report:?}");
            assert_eq!(parts(&checked(&mesh)), *expected, "{name}, normals {kind}: {report:?}");
            assert_eq!((report.normals_taken, report.normals_oriented), (taken, oriented), "{name}, normals {kind}");
            let bare = bare.get_or_insert_with(|| mesh.clone());
            assert!(taken || mesh == *bare, "{name}: normals that are not taken change nothing");
        }
    }
}

#[test]
fn the_ball_has_the_correct_volume_and_area() {
    let (mesh, report) = surface(&scenes::sphere().points(1.0), &[]).unwrap();
    let checked = checked(&mesh);
    // an inscribed triangulation with edge e loses 5 e^2 / 24 R^2 of the area and 3 e^2 / 8 R^2 of
    // the volume
    assert!((checked.object().volume / 4188.8 - 1.0).abs() < 0.01, "{}", checked.object().volume);
    assert!((checked.object().area / 1256.6 - 1.0).abs() < 0.006, "{}", checked.object().area);
    assert_eq!((report.flat, report.with_umbrella, report.unused), (report.points, report.points, 0));
}

/// Returns the points, each moved by a random distance of at most `by` along each axis.
fn noisy(points: &[DVec3], by: f64) -> Vec<DVec3> {
    let moved = |(n, p): (usize, &DVec3)| {
        let u = |axis| 2.0 * uniform(8, axis, n as u64) - 1.0;
        *p + by * DVec3::new(u(0), u(1), u(2))
    };
    points.iter().enumerate().map(moved).collect()
}

#[test]
fn noise_and_holes_leave_the_surface_watertight() {
    // Noise of up to 0.4 on points at least 0.8 apart. Points within up to 6 of `top` are removed,
    // on tubes of radius 4.
    for (scene, euler, volume) in [(scenes::sphere(), 2, 4188.8), (scenes::torus(), 0, 2842.4)] {
        let clean = scene.points(0.8);
        let top = scenes::CENTRE + DVec3::new(6.0, 5.0, 4.0);
        for (noise, hole) in [(0.1, 0.0), (0.2, 2.0), (0.0, 6.0), (0.3, 4.0), (0.4, 6.0)] {
            let kept = |(p, _): &(DVec3, DVec3)| p.distance(top) >= hole;
            let all = noisy(&clean, noise).into_iter().zip(normals_of(&scene, &clean));
            let (points, normals): (Vec<DVec3>, Vec<DVec3>) = all.filter(kept).unzip();
            for normals in [&[][..], &normals[..]] {
                let (mesh, report) = surface(&points, normals).unwrap();
                let found = checked(&mesh);
                let failed = &found.failed;
                assert!(failed.is_empty(), "noise {noise}, hole {hole}: {failed:?} {report:?}");
                assert_eq!(parts(&found), [(euler, false)], "noise {noise}, hole {hole}: {report:?}");
                // the largest hole reduces the volume of the torus by 7 % (measured)
                assert!(
                    (found.object().volume / volume - 1.0).abs() < 0.1,
                    "noise {noise}, hole {hole}: {}",
                    found.object().volume
                );
            }
        }
    }
}

/// Returns the grid points on the faces of a cube with edges of `count` cells.
fn cube_faces(count: i32) -> Vec<DVec3> {
    let mut points = Vec::new();
    for (i, j, k) in (0..=count).flat_map(|i| (0..=count).flat_map(move |j| (0..=count).map(move |k| (i, j, k)))) {
        if [i, j, k].iter().any(|x| *x == 0 || *x == count) {
            points.push(DVec3::new(i.into(), j.into(), k.into()));
        }
    }
    points
}

#[test]
fn degenerate_points_are_meshed_or_rejected() {
    // on a grid, in flat faces with sharp edges, cospherical everywhere, each point twice
    let cube = cube_faces(8);
    let (mesh, report) = surface(&[&cube[..], &cube[..]].concat(), &[]).unwrap();
    let found = checked(&mesh);
    assert!(found.failed.is_empty(), "{:?} {report:?}", found.failed);
    assert_eq!((parts(&found), report.points), (vec![(2, false)], cube.len()));
    // the corners may be cut off, because their cells are as wide as long
    assert!((510.0..=512.0).contains(&found.object().volume), "{}", found.object().volume);
    // integer points exactly on one sphere
    let whole = |n: i32, side: i32| DVec3::new((n % side).into(), (n / side % side).into(), (n / (side * side)).into());
    let sphere: Vec<DVec3> =
        (0..43 * 43 * 43).map(|n| whole(n, 43) - 21.0).filter(|p| p.length_squared() == 441.0).collect();
    let (mesh, report) = surface(&sphere, &[]).unwrap();
    assert!(checked(&mesh).failed.is_empty());
    assert_eq!((parts(&checked(&mesh)), mesh.vertices.len()), (vec![(2, false)], report.points));
    // no surface: points that fill a volume, or that are too few
    let lattice: Vec<DVec3> = (0..1000).map(|n| whole(n, 10)).collect();
    let dust: Vec<DVec3> =
        (0..1000).map(|n| DVec3::new(uniform(1, 0, n), uniform(1, 1, n), uniform(1, 2, n))).collect();
    let few: Vec<DVec3> = scenes::sphere().points(1.0).into_iter().take(8).collect();
    let line: Vec<DVec3> = (0..50).map(|n| DVec3::splat(f64::from(n))).collect();
    let plane: Vec<DVec3> = cube.iter().map(|p| DVec3::new(p.x, p.y, 0.25)).collect();
    for (points, says) in [
        (lattice, "do not enclose a solid"),
        (dust, "do not enclose a solid"),
        (few, "do not enclose a solid"),
        (line, "one line"),
        (plane, "one plane"),
        (vec![DVec3::ONE; 9], "1 distinct"),
        (vec![], "0 distinct"),
    ] {
        let error = surface(&points, &[]).unwrap_err();
        assert!(error.what.contains(says), "{error}");
    }
}

#[test]
fn the_result_does_not_depend_on_the_number_of_threads() {
    let scene = scenes::gyroid();
    let points = noisy(&scene.points(0.9), 0.1);
    let with = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| surface(&points, &[]).unwrap())
    };
    assert_eq!(with(1), with(5));
}

/// Results of both methods on a random scene.
struct OfScene {
    /// Whether the restricted surface has the topology of F, except at undecided places.
    restricted: bool,
    /// Whether Tight Cocone with the field, which adds points, has this topology.
    beside: bool,
    /// Whether the restricted surface and Tight Cocone with the field have the Euler characteristic
    /// of F, including undecided places.
    exact: [bool; 2],
    /// Whether Tight Cocone on the points alone has the topology of F. `None` if it returned an
    /// error.
    alone: Option<bool>,
    failures: Vec<String>,
}

/// Meshes a random scene by both methods. For odd seeds, Tight Cocone on the points alone gets no
/// normals.
fn of_scene(seed: u64, spacing: f64) -> OfScene {
    let scene = scenes::random(seed);
    let mut failures = Vec::new();
    let (mesh, euler, defects) = crate::tests::restricted(&scene, spacing);
    let by_restricted = checked(&mesh).object().euler;
    if !defects.is_manifold() {
        failures.push(format!("scene {seed} at {spacing}: restricted {defects:?}"));
    }
    let restricted = defects.is_empty();
    let (mesh, expected, defects) = crate::tests::tight_cocone_beside_field(&scene, spacing);
    let found = checked(&mesh);
    if !found.failed.is_empty() {
        failures.push(format!("scene {seed} at {spacing}: beside F {:?}", found.failed));
    }
    let beside = defects.is_empty();
    let exact = [by_restricted, found.object().euler].map(|of_mesh| of_mesh == expected.iter().sum::<i64>());
    let points = scene.points(spacing);
    let normals = if seed % 2 == 1 { Vec::new() } else { normals_of(&scene, &points) };
    let alone = match surface(&points, &normals) {
        Ok((mesh, report)) => {
            let found = checked(&mesh);
            let failed = &found.failed;
            if !failed.is_empty() {
                failures.push(format!("scene {seed} at {spacing}: {failed:?} {report:?}"));
            }
            Some((found.object().components.len(), found.object().euler) == (euler.len(), euler.iter().sum()))
        }
        Err(error) => {
            assert!(error.what.contains("do not enclose a solid"), "{error}");
            None
        }
    };
    OfScene { restricted, beside, exact, alone, failures }
}

/// Prints the counts. This command uses more scenes:
///
/// ```text
/// ISOPARTICLES_SCENES=500 cargo test --release -p isoparticles-reconstruct random_scenes \
///     -- --nocapture
/// ```
#[test]
fn random_scenes_are_watertight_with_both_methods() {
    let count = std::env::var("ISOPARTICLES_SCENES").ok().and_then(|text| text.parse().ok()).unwrap_or(8u64);
    for spacing in [0.7, 1.4] {
        let found: Vec<OfScene> = (0..count).into_par_iter().map(|seed| of_scene(seed, spacing)).collect();
        let restricted = found.iter().filter(|of| of.restricted).count() as u64;
        let beside = found.iter().filter(|of| of.beside).count() as u64;
        let alone =
            |bare: usize, what: Option<bool>| found.iter().skip(bare).step_by(2).filter(|of| of.alone == what).count();
        let right = [0, 1].map(|bare| alone(bare, Some(true)));
        println!(
            "{count} scenes, points {spacing} apart: topology right by restricted {restricted}, by Tight Cocone beside F {beside}, of the \
             points alone {} with normals and {} without; refused {} and {}",
            right[0],
            right[1],
            alone(0, None),
            alone(1, None)
        );
        let wrong = |is_right: fn(&OfScene) -> bool| {
            found.iter().enumerate().filter(move |(_, of)| !is_right(of)).map(|(seed, _)| seed)
        };
        println!("not by restricted: {:?}", wrong(|of| of.restricted).collect::<Vec<_>>());
        println!("not beside F: {:?}", wrong(|of| of.beside).collect::<Vec<_>>());
        println!("other than F at undecided places, restricted: {:?}", wrong(|of| of.exact[0]).collect::<Vec<_>>());
        println!("other than F at undecided places, Tight Cocone: {:?}", wrong(|of| of.exact[1]).collect::<Vec<_>>());
        let failures: Vec<&String> = found.iter().flat_map(|of| &of.failures).collect();
        assert!(failures.is_empty(), "{failures:#?}");
        assert!(10 * restricted >= 9 * count, "restricted has the topology of {restricted} only");
        assert!(10 * beside >= 9 * count, "Tight Cocone beside F has the topology of {beside} only");
        assert!(
            spacing > 1.0 || 2 * (right[0] + right[1]) as u64 >= count,
            "Tight Cocone has the topology of {right:?} only"
        );
    }
}
