//! Tests the triangulation against brute force and topological invariants on many kinds of
//! degenerate input.

use super::*;
use isoparticles_field::random::uniform;
use proptest::prelude::*;
use std::collections::{BTreeSet, HashMap, HashSet};

fn cube(count: u64) -> Vec<DVec3> {
    (0..count).map(|n| DVec3::new(uniform(3, 0, n), uniform(3, 1, n), uniform(3, 2, n))).collect()
}

fn grid(n: usize) -> Vec<DVec3> {
    let mut points = Vec::new();
    for k in 0..n {
        for j in 0..n {
            for i in 0..n {
                points.push(DVec3::new(i as f64, j as f64, k as f64));
            }
        }
    }
    points
}

/// Returns all points with integer coordinates on a sphere of radius 21.
fn cospherical() -> Vec<DVec3> {
    let mut set = BTreeSet::new();
    for x in -21i32..=21 {
        for y in -21i32..=21 {
            for z in -21i32..=21 {
                if x * x + y * y + z * z == 441 {
                    set.insert((x, y, z));
                }
            }
        }
    }
    set.into_iter().map(|(x, y, z)| DVec3::new(x.into(), y.into(), z.into())).collect()
}

fn torus(count: u64) -> Vec<DVec3> {
    (0..count)
        .map(|n| {
            let (u, v) = (uniform(5, 0, n) * std::f64::consts::TAU, uniform(5, 1, n) * std::f64::consts::TAU);
            DVec3::new((3.0 + v.cos()) * u.cos(), (3.0 + v.cos()) * u.sin(), v.sin())
        })
        .collect()
}

/// Checks that neighbour links are mutual, cells have positive volume, and every vertex is present.
/// With the vertex at infinity, the triangulation must have the Euler characteristic of the
/// 3-sphere.
fn check_structure(d: &Delaunay) {
    let mut seen = HashSet::new();
    let (mut edges, mut facets, mut cells) = (HashSet::new(), HashSet::new(), 0);
    for (t, v) in d.tetrahedra() {
        cells += 1;
        let n = d.neighbours(t);
        for i in 0..4 {
            assert!(d.is_alive(n[i]), "dead neighbour");
            let back = d.neighbours(n[i]).iter().position(|&b| b == t).expect("neighbours agree");
            let mut ours: Vec<u32> = d.facet(t, i).to_vec();
            let mut theirs: Vec<u32> = d.facet(n[i], back).to_vec();
            ours.sort_unstable();
            theirs.sort_unstable();
            assert_eq!(ours, theirs, "a shared facet has the same vertices on both sides");
            facets.insert(ours);
            seen.insert(v[i]);
            for j in 0..i {
                edges.insert((v[i].min(v[j]), v[i].max(v[j])));
            }
        }
        if !v.contains(&INFINITE) {
            let [a, b, c, e] = v.map(|i| d.points()[i as usize]);
            assert!(orientation(a, b, c, e) > 0.0, "flat or inverted cell {v:?}");
        }
    }
    assert_eq!(seen.len(), d.vertex_count() + 1);
    assert_eq!(seen.len() as i64 - edges.len() as i64 + facets.len() as i64 - i64::from(cells), 0, "Euler");
    for v in 0..d.points().len() as u32 {
        match d.incident(v) {
            Some(t) => assert!(d.is_alive(t) && d.vertices(t).contains(&v)),
            None => assert!(d.duplicate_of(v).is_some()),
        }
    }
}

/// Checks that no point lies strictly inside a circumsphere or strictly beyond a hull triangle.
fn check_spheres(d: &Delaunay) {
    for (t, v) in d.tetrahedra() {
        let corners = |p: DVec3| v.map(|i| if i == INFINITE { p } else { d.points()[i as usize] });
        for &p in d.points() {
            let [a, b, c, e] = corners(p);
            if d.is_ghost(t) {
                assert!(orientation(a, b, c, e) <= 0.0, "the hull is convex");
            } else {
                assert!(predicates::in_sphere(a, b, c, e, p) <= 0.0, "sphere of {v:?} holds {p}");
            }
        }
    }
}

fn cells(d: &Delaunay) -> BTreeSet<[u32; 4]> {
    d.finite_tetrahedra()
        .map(|(_, mut v)| {
            v.sort_unstable();
            v
        })
        .collect()
}

fn volume(d: &Delaunay) -> f64 {
    let sixth = |v: [u32; 4]| {
        let [a, b, c, e] = v.map(|i| d.points()[i as usize]);
        (b - a).cross(c - a).dot(e - a) / 6.0
    };
    d.finite_tetrahedra().map(|(_, v)| sixth(v)).sum()
}

#[test]
fn random_points_in_a_cube() {
    let d = Delaunay::new(&cube(400)).unwrap();
    check_structure(&d);
    check_spheres(&d);
    let large = Delaunay::new(&cube(20_000)).unwrap();
    check_structure(&large);
    // uniformly random points in unbounded space have 6.77 cells per vertex on average; the hull
    // reduces this number
    let ratio = large.finite_tetrahedra().count() as f64 / 20_000.0;
    assert!((6.3..6.8).contains(&ratio), "{ratio} cells a vertex");
}

#[test]
fn points_exactly_on_one_sphere() {
    let points = cospherical();
    assert!(points.len() > 150);
    let d = Delaunay::new(&points).unwrap();
    check_structure(&d);
    check_spheres(&d);
    for (t, _) in d.finite_tetrahedra() {
        let centre = d.circumcentre(t).unwrap();
        assert!(centre.length() < 1e-9, "all cells share one sphere, yet one has its centre at {centre}");
    }
}

#[test]
fn grid_fills_its_box() {
    let d = Delaunay::new(&grid(7)).unwrap();
    check_structure(&d);
    check_spheres(&d);
    assert!((volume(&d) - 216.0).abs() < 1e-9);
    let ghosts = d.tetrahedra().filter(|&(t, _)| d.is_ghost(t)).count();
    assert_eq!(ghosts, 6 * 6 * 6 * 2, "two hull triangles a face of a border cell");
}

#[test]
fn two_coplanar_layers_and_a_line() {
    let mut points: Vec<DVec3> = Vec::new();
    for n in 0..120u64 {
        points.push(DVec3::new((n % 12) as f64, (n / 12) as f64, 0.0));
        points.push(DVec3::new(uniform(9, 0, n) * 11.0, uniform(9, 1, n) * 9.0, 2.0));
    }
    points.extend((0..30).map(|n| DVec3::new(f64::from(n) - 9.0, 4.0, 1.0)));
    let d = Delaunay::new(&points).unwrap();
    check_structure(&d);
    check_spheres(&d);
}

#[test]
fn flat_input_and_too_few_points_are_refused() {
    let plane: Vec<DVec3> = cube(50).into_iter().map(|p| DVec3::new(p.x, p.y, 0.25)).collect();
    let line: Vec<DVec3> = (0..50).map(|n| DVec3::splat(f64::from(n))).collect();
    for (points, says) in
        [(plane, "one plane"), (line, "one line"), (vec![DVec3::ONE; 9], "1 distinct"), (vec![], "0 distinct")]
    {
        let error = Delaunay::new(&points).unwrap_err();
        assert!(error.to_string().contains(says), "{error}");
    }
    let mut points = cube(20);
    points[7].y = f64::NAN;
    assert!(matches!(Delaunay::new(&points), Err(Error::Coordinate(_))));
    let mut d = Delaunay::new(&cube(20)).unwrap();
    assert!(d.insert(DVec3::new(0.0, f64::INFINITY, 0.0), None).is_err());
    check_structure(&d);
}

#[test]
fn duplicates_map_to_the_first_point() {
    let mut points = torus(300);
    let copies: Vec<DVec3> = points.iter().step_by(3).copied().collect();
    points.extend(copies);
    points[299] = points[0];
    let d = Delaunay::new(&points).unwrap();
    check_structure(&d);
    assert_eq!(d.vertex_count(), 299);
    assert_eq!(d.duplicate_of(299), Some(0));
    assert_eq!(d.duplicate_of(300), Some(0));
    assert_eq!(d.duplicate_of(301), Some(3));
    assert_eq!(d.duplicate_of(0), None);
}

#[test]
fn later_insertions_give_the_triangulation_of_the_whole() {
    for points in [cube(500), torus(500), grid(6), cospherical()] {
        let whole = Delaunay::new(&points).unwrap();
        let half = points.len() / 2;
        let mut grown = Delaunay::new(&points[..half]).unwrap();
        for (k, &p) in points[half..].iter().enumerate() {
            let near = (k % 3 != 0).then_some((k % half) as u32);
            assert_eq!(grown.insert(p, near).unwrap(), Insertion::New((half + k) as u32));
            assert!(grown.created().iter().all(|&t| grown.vertices(t).contains(&((half + k) as u32))));
        }
        assert_eq!(grown.insert(points[3], None).unwrap(), Insertion::Duplicate(3));
        check_structure(&grown);
        assert_eq!(cells(&whole), cells(&grown), "the perturbation makes the triangulation unique");
    }
}

/// Limits that divide even small triangulations into many regions.
const FINELY: Cutting = Cutting { points: 40, depth: 6 };

#[test]
fn regions_give_the_triangulation_of_the_whole() {
    let mut twice = torus(3000);
    twice.extend_from_within(..500);
    let line: Vec<DVec3> = (0..2000).map(|n| DVec3::new(f64::from(n), 0.0, 0.0)).chain(cube(5)).collect();
    for (points, much) in [
        (cube(6000), true),
        (torus(6000), true),
        (grid(12), true),
        (cospherical(), false),
        (twice, true),
        (line, false),
    ] {
        let whole = Delaunay::with_cutting(&points, Cutting { points: usize::MAX, depth: 0 }).unwrap();
        let regions = Delaunay::with_cutting(&points, FINELY).unwrap();
        check_structure(&regions);
        assert_eq!(cells(&whole), cells(&regions));
        let numbers = |d: &Delaunay| d.tetrahedra().map(|(t, v)| (t, v, d.neighbours(t))).collect::<Vec<_>>();
        assert!(!much || numbers(&whole) != numbers(&regions), "nothing was cut");
    }
}

#[test]
fn numbers_do_not_depend_on_the_threads() {
    let points = torus(20_000);
    let on = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| Delaunay::with_cutting(&points, FINELY).unwrap())
    };
    let (one, three) = (on(1), on(3));
    assert!(one.tetrahedra().eq(three.tetrahedra()));
    assert!(one.tetrahedra().all(|(t, _)| one.neighbours(t) == three.neighbours(t)));
    assert_eq!(one.slot_count(), three.slot_count());
}

#[test]
fn regions_are_open_to_later_insertions() {
    let points = torus(2000);
    let mut grown = Delaunay::with_cutting(&points[..1500], FINELY).unwrap();
    for (k, &p) in points[1500..].iter().enumerate() {
        assert_eq!(grown.insert(p, None).unwrap(), Insertion::New(1500 + k as u32));
    }
    check_structure(&grown);
    assert_eq!(cells(&grown), cells(&Delaunay::new(&points).unwrap()));
}

/// The circumspheres of all tetrahedra contain the centre of the sphere, so the cavity of the
/// centre has more walls than the edge table can hold.
#[test]
fn large_cavities() {
    let on_sphere = |n: u64| {
        let p = DVec3::new(uniform(11, 0, n), uniform(11, 1, n), uniform(11, 2, n)) - 0.5;
        p.normalize()
    };
    let points: Vec<DVec3> = (0..800).map(on_sphere).chain([DVec3::ZERO]).collect();
    let mut d = Delaunay::new(&points[..800]).unwrap();
    d.insert(points[800], None).unwrap();
    assert!(d.created().len() > 1000, "{} walls", d.created().len());
    check_structure(&d);
    check_spheres(&d);
    assert_eq!(cells(&d), cells(&Delaunay::new(&points).unwrap()));
}

#[test]
fn near_duplicates_keep_every_point() {
    let mut points = torus(200);
    for (n, p) in torus(200).into_iter().enumerate() {
        let step = [1e-15, 1e-12, 1e-9][n % 3];
        points.extend([p + DVec3::X * step, p + DVec3::new(-step, step, step)]);
    }
    let d = Delaunay::new(&points).unwrap();
    check_structure(&d);
    check_spheres(&d);
}

#[test]
fn scales_from_tiny_to_huge() {
    for scale in [1e-30, 1e-6, 1.0, 1e12, 1e40] {
        let points: Vec<DVec3> = cube(80).into_iter().chain(grid(3)).map(|p| p * scale).collect();
        let d = Delaunay::new(&points).unwrap();
        check_structure(&d);
        check_spheres(&d);
    }
}

#[test]
fn circumcentre_of_a_thin_cell_is_at_its_distance() {
    // four points near the unit circle in the plane z = 0; the last one is displaced by `far`. The
    // circumcentre must have the same distance from all four.
    let p = |angle: f64, z: f64| DVec3::new(angle.cos(), angle.sin(), z);
    for far in [1e-3, 1e-6, 1e-9] {
        let corners = [p(0.0, 0.0), p(1.0, 0.0), p(2.5, 0.0), p(4.0, 0.0) * (1.0 + far) + DVec3::Z * far];
        let centre = circumcentre(corners).unwrap();
        let radii = corners.map(|c| c.distance(centre));
        for r in radii {
            assert!((r - radii[0]).abs() < 1e-5 * radii[0], "{radii:?}");
        }
    }
}

#[test]
fn circumcentre_of_a_flat_cell_is_far_away_in_any_unit() {
    // The corners form quadrilaterals in a tilted plane. The volume of each tetrahedron results
    // only from the rounding of the coordinates and is below the error bound of the orientation
    // filter.
    let (u, v) = (DVec3::new(0.9, 0.2, -0.3).normalize(), DVec3::new(0.1, 0.7, 0.6));
    let mut undecided = 0;
    for k in 0..200u64 {
        let at = |n: u64| {
            let r = |m: u64| uniform(3, n, 2 * k + m);
            DVec3::new(0.3, 0.5, 0.7) + u * (r(0) + (n % 2) as f64) + v * (r(1) + (n / 2) as f64)
        };
        let corners = [at(0), at(1), at(2), at(3)];
        let exact = predicates::volume(corners[0], corners[1], corners[2], corners[3]);
        if exact == 0.0 {
            continue;
        }
        undecided += 1;
        let Some(centre) = circumcentre(corners) else { continue };
        assert!(centre.length() > 1e6, "{centre}");
        // scaling by powers of two is exact
        for scale in [2f64.powi(-10), 2f64.powi(-3), 2f64.powi(10)] {
            assert_eq!(circumcentre(corners.map(|p| p * scale)), Some(centre * scale));
        }
    }
    assert!(undecided > 100, "{undecided}");
}

#[test]
fn memory_is_counted() {
    let d = Delaunay::new(&torus(5000)).unwrap();
    let memory = d.memory();
    assert_eq!(memory.tetrahedra, d.tetrahedra().count());
    assert!(memory.slots >= memory.tetrahedra && memory.bytes > memory.slots * 32);
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(200))]

    #[test]
    fn small_integer_coordinates(raw in proptest::collection::vec((0i32..4, 0i32..4, 0i32..4), 0..40)) {
        let points: Vec<DVec3> = raw.iter().map(|&(x, y, z)| DVec3::new(x.into(), y.into(), z.into())).collect();
        match Delaunay::new(&points) {
            Ok(d) => {
                check_structure(&d);
                check_spheres(&d);
                let regions = Delaunay::with_cutting(&points, Cutting { points: 6, depth: 3 }).unwrap();
                check_structure(&regions);
                prop_assert_eq!(cells(&d), cells(&regions));
                let mut places = HashMap::new();
                for (i, p) in raw.iter().enumerate() {
                    let first = *places.entry(p).or_insert(i as u32);
                    prop_assert_eq!(d.duplicate_of(i as u32), (first != i as u32).then_some(first));
                }
            }
            Err(error) => prop_assert!(matches!(error, Error::TooFew(_) | Error::Collinear(_) | Error::Coplanar(_))),
        }
    }
}
