//! Tests of the topology of analytic scenes.

use super::cells::{around, moved};
use super::*;
use crate::marching_cubes::marching_cubes;
use crate::random::uniform;
use crate::topology::surface::Surface;
use isoparticles_mesh::topology::analyse;
use isoparticles_volume::Geometry;
use isoparticles_volume::Image;
use std::collections::BTreeMap;

/// The spline through the samples of a function.
pub(super) struct Scene {
    pub(super) field: CubicSpline,
}

impl Scene {
    pub(super) fn new(size: [usize; 3], spacing: DVec3, function: impl Fn(DVec3) -> f64) -> Self {
        let image = Image::sampled(Geometry::axis_aligned(size, spacing), |p| function(p) as f32);
        Self { field: CubicSpline::new(&image) }
    }

    /// Triangulates F = 0 by marching cubes with `fine` samples per voxel edge. Returns the Euler
    /// characteristics of the components, in ascending order.
    fn by_samples(&self, fine: usize) -> Vec<i64> {
        let own = self.field.geometry();
        let size = own.size.map(|n| (n - 1) * fine + 1);
        let geometry = Geometry::axis_aligned(size, own.spacing / fine as f64);
        let mesh = marching_cubes(&Image::sampled(geometry, |p| self.field.value(p) as f32), 0.0);
        sorted(analyse(&mesh).components.iter().map(|c| c.euler))
    }

    fn topology(&self) -> FieldTopology {
        FieldTopology::new(&self.field)
    }
}

fn sorted(euler: impl Iterator<Item = i64>) -> Vec<i64> {
    let mut euler: Vec<i64> = euler.collect();
    euler.sort_unstable();
    euler
}

fn euler(topology: &FieldTopology) -> Vec<i64> {
    sorted(topology.components().iter().map(|c| c.euler))
}

fn unwatched() -> Watch<'static> {
    Watch::new(&Silent, 0)
}

const CENTRE: DVec3 = DVec3::splat(15.7);

/// A torus with a ring radius of 9 mm and a tube radius of 4 mm.
pub(super) fn torus() -> Scene {
    Scene::new([32; 3], DVec3::ONE, |p| {
        let q = p - CENTRE;
        (q.truncate().length() - 9.0).hypot(q.z) - 4.0
    })
}

/// Two balls of radius 5 mm, separated by a gap of 2 mm.
pub(super) fn two_balls() -> Scene {
    Scene::new([32, 24, 24], DVec3::ONE, |p| {
        let centre = |x: f64| DVec3::new(x, 11.6, 11.6);
        (p.distance(centre(9.6)) - 5.0).min(p.distance(centre(21.6)) - 5.0)
    })
}

/// A spherical shell with radii of 8 and 10.5 mm.
pub(super) fn shell() -> Scene {
    Scene::new([32; 3], DVec3::ONE, |p| (p.distance(CENTRE) - 9.25).abs() - 1.25)
}

/// A gyroid inside a ball of radius 13 mm. Near the surface of the ball, single inside nodes are
/// attached by necks thinner than a voxel.
pub(super) fn gyroid() -> Scene {
    Scene::new([36; 3], DVec3::ONE, |p| {
        let q = (p - DVec3::splat(17.6)) * 0.45;
        let g = q.x.sin() * q.y.cos() + q.y.sin() * q.z.cos() + q.z.sin() * q.x.cos();
        let (g, ball) = (g / 0.7, (p - DVec3::splat(17.6)).length() - 13.0);
        (g + ball + (g - ball).hypot(1.0)) / 2.0
    })
}

/// A torus with a ring radius of 5 mm and a tube radius of 4.8 mm. Its hole is 0.4 voxel wide and
/// lies between the nodes.
fn pierced() -> Scene {
    let (ring, tube) = (5.0, 4.8);
    Scene::new([28; 3], DVec3::ONE, |p| {
        let q = p - DVec3::new(13.43, 13.61, 13.52);
        let square = q.length_squared() + ring * ring - tube * tube;
        (square * square - 4.0 * ring * ring * q.truncate().length_squared()) / (8.0 * ring * ring * tube)
    })
}

/// Two balls, with the given value of F (mm) at the saddle between them.
fn touching(value: f64) -> Scene {
    let balls = |level: f64| {
        let [a, b] = [9.3, 21.8].map(|x| DVec3::new(x, 15.4, 15.6));
        Scene::new([32; 3], DVec3::ONE, |p| (p.distance(a) - 6.0).min(p.distance(b) - 6.0) - level)
    };
    let middle = DVec3::new(15.55, 15.4, 15.6);
    let far = |c: &CriticalPoint| c.position.distance(middle);
    let saddles = critical_points(&balls(0.0).field, 0.0);
    let saddle = saddles.into_iter().min_by(|a, b| far(a).total_cmp(&far(b))).expect("a saddle between the balls");
    // splines reproduce constants, so this shifts F at the saddle to `value`
    balls(saddle.value - value)
}

#[test]
fn known_shapes_have_their_components_and_euler_characteristics() {
    for (scene, expected) in [
        (torus(), vec![0]),
        (two_balls(), vec![2, 2]),
        (shell(), vec![2, 2]),
        (gyroid(), vec![-14]),
        (pierced(), vec![0]),
    ] {
        let topology = scene.topology();
        assert_eq!(euler(&topology), expected);
        assert_eq!(topology.undecided(), []);
        let summary = topology.summary();
        assert_eq!(summary.components_between, [expected.len(); 2]);
        assert_eq!(summary.euler_between, [expected.iter().sum::<i64>(); 2]);
    }
    // the samples alone do not reveal the hole
    assert_eq!(pierced().by_samples(1), [2]);
}

#[test]
fn sizes_are_those_of_the_shapes() {
    let within = |measured: f64, truth: f64, part: f64| (measured - truth).abs() < part * truth.abs();
    let topology = torus().topology();
    let torus = &topology.components()[0];
    // chords of one voxel on a tube of radius 4 reduce its cross section by 1/96; the limit is
    // almost three times as large
    assert!(within(torus.volume, 2842.4, 0.03), "{torus:?}");
    assert!(within(torus.area, 1421.2, 0.03), "{torus:?}");
    assert!((torus.bounds.high - torus.bounds.low - DVec3::new(26.0, 26.0, 8.0)).abs().max_element() < 0.1);
    let topology = shell().topology();
    let volumes = sorted(topology.components().iter().map(|c| c.volume.round() as i64));
    assert!(volumes[0] < 0 && within(volumes[0] as f64, -2144.7, 0.03), "{volumes:?}");
    assert!(within(volumes[1] as f64, 4849.0, 0.03), "{volumes:?}");
}

#[test]
fn points_belong_to_the_interface_that_they_lie_on() {
    for scene in [two_balls(), shell(), gyroid()] {
        let topology = scene.topology();
        for component in 0..topology.components().len() as u32 {
            let samples = topology.samples(component);
            assert!(samples.len() > 100);
            for p in samples.into_iter().filter_map(|p| scene.field.project(p, 1.0, 1e-9)) {
                let normal = scene.field.value_gradient(p).1;
                assert_eq!(topology.component_at(&scene.field, p, normal), Some(component), "at {p}");
            }
        }
        assert_eq!(topology.component_at(&scene.field, DVec3::ZERO, DVec3::X), None);
    }
}

/// A smooth union of four balls or tori. The samples are noisy if the seed is odd.
fn random(seed: u64) -> Scene {
    let u = |k: u64| uniform(78, seed, k);
    let parts: Vec<(DVec3, f64, f64)> = (0..4u64)
        .map(|k| {
            let at = |n: u64| u(10 * (k + 1) + n);
            (DVec3::new(at(0), at(1), at(2)) * 7.0 + DVec3::splat(6.5), 1.6 + 2.0 * at(3), at(4))
        })
        .collect();
    let noise = if seed.is_multiple_of(2) { 0.0 } else { 0.9 };
    Scene::new([20; 3], DVec3::new(1.0, 0.8, 1.3), |p| {
        let q = p / DVec3::new(1.0, 0.8, 1.3);
        let distance = |&(centre, radius, kind): &(DVec3, f64, f64)| {
            let d = q - centre;
            if kind < 0.5 { d.length() - radius } else { (d.truncate().length() - radius - 1.0).hypot(d.z) - 0.8 }
        };
        let soft = -0.4 * parts.iter().map(|part| (-2.5 * distance(part)).exp()).sum::<f64>().ln();
        // positive at the border, so that the surface is closed
        let border = 1.5 - q.min(DVec3::splat(19.0) - q).min_element();
        (soft + noise * (uniform(seed, 5, (q.x * 1e2 + q.y * 1e4 + q.z * 1e6).round() as u64) - 0.5)).max(border)
    })
}

#[test]
fn random_scenes_have_the_topology_of_much_denser_samples() {
    let (mut certain, mut handles) = (0, 0);
    for seed in 0..12 {
        let scene = random(seed);
        let topology = scene.topology();
        // five samples per voxel edge may miss fine features, but the resulting counts must lie in
        // the ranges that the topology allows
        let (summary, dense) = (topology.summary(), scene.by_samples(5));
        let [least, most] = summary.components_between;
        assert!((least..=most).contains(&dense.len()), "scene {seed}: {summary:?} and {}", dense.len());
        let [low, high] = summary.euler_between;
        let sum: i64 = dense.iter().sum();
        assert!((low..=high).contains(&sum), "scene {seed}: {summary:?} and {sum}");
        if topology.undecided().is_empty() {
            assert_eq!(euler(&topology), dense, "scene {seed}");
            certain += 1;
            handles += dense.iter().filter(|&&euler| euler <= 0).count();
        }
    }
    assert!(certain >= 6 && handles >= 3, "{certain} scenes and {handles} components with handles show little");
}

#[test]
fn what_touches_is_undecided_and_what_nearly_touches_is_not() {
    for value in [-1e-7, 0.0, 1e-7] {
        let topology = touching(value).topology();
        let summary = topology.summary();
        assert_eq!((summary.components_between, topology.groups().all().len()), ([1, 2], 1), "{summary:?}");
        assert_eq!(topology.undecided().len(), 1, "{summary:?}");
        let place = &topology.undecided()[0];
        assert!(DVec3::from_array(place.place).distance(DVec3::new(15.55, 15.4, 15.6)) < 0.2, "{place:?}");
        assert!(place.size <= 0.5 && place.kind == UndecidedKind::Uncertain(1), "{place:?}");
        let [low, high] = summary.euler_between;
        assert!(low <= 2 && high == 4 && high - low <= 4, "{summary:?}");
    }
    // a neck and a gap, each about a third of a voxel wide, are decided
    assert_eq!(euler(&touching(-0.01).topology()), [2]);
    assert_eq!(euler(&touching(0.05).topology()), [2, 2]);
    assert!(touching(-0.01).topology().undecided().is_empty() && touching(0.05).topology().undecided().is_empty());
}

#[test]
fn a_speck_between_the_samples_is_a_component() {
    // F is positive at all samples and negative in the middle of a cell
    let scene = Scene::new([12; 3], DVec3::ONE, |p| 0.4 * (p.distance_squared(DVec3::new(5.5, 5.45, 5.52)) - 0.3));
    assert_eq!(scene.by_samples(1), Vec::<i64>::new());
    let topology = scene.topology();
    assert_eq!(euler(&topology), [2]);
    assert!(topology.components()[0].place.distance(DVec3::splat(5.5)) < 0.8);
}

#[test]
fn a_surface_that_ends_at_the_border_is_counted_as_it_is_there() {
    // a disk, an open cylinder along x and a hemisphere have Euler characteristics 1, 0 and 1
    let plane = Scene::new([9, 10, 11], DVec3::ONE, |p| p.x - 4.4);
    let tube = Scene::new([12; 3], DVec3::ONE, |p| DVec3::new(0.0, p.y - 5.3, p.z - 5.6).length() - 3.2);
    let dome = Scene::new([12; 3], DVec3::ONE, |p| p.distance(DVec3::new(5.3, 5.6, 0.0)) - 3.2);
    assert_eq!([plane, tube, dome].map(|scene| euler(&scene.topology())), [[1], [0], [1]]);
    let nothing = Scene::new([4; 3], DVec3::ONE, |_| 1.0);
    assert_eq!(euler(&nothing.topology()), Vec::<i64>::new());
    let flat = Scene::new([5, 1, 5], DVec3::ONE, |p| p.x - 2.2);
    assert_eq!(euler(&flat.topology()), Vec::<i64>::new());
}

#[test]
fn neighbouring_crossed_cells_differ_by_at_most_one_level() {
    let scene = random(3);
    let cells = Cells::new(&scene.field, &unwatched()).expect("not interrupted");
    let mut by_level: BTreeMap<u8, usize> = BTreeMap::new();
    for k in 0..cells.size()[2] as u32 {
        for (cell, _) in cells.crossed_in_slice(k) {
            *by_level.entry(cell.level).or_default() += 1;
            for (other, state) in around().filter_map(|away| moved(cell, away)).filter_map(|cell| cells.find(cell)) {
                assert!(state == cells::State::Clear || other.level + 1 >= cell.level, "{cell:?} {other:?}");
            }
        }
    }
    assert!(by_level.len() >= 4, "{by_level:?}: this shows little");
}

#[test]
fn a_dome_through_a_face_between_cell_sizes_stays_connected() {
    // The top of the dome is 0.05 voxel above the middle of a face. Grad F turns so much in the
    // cell above the face that this cell is subdivided. The cell below the face is not subdivided.
    // Only the smaller cells have a corner at the middle of the face; the larger cell contains a
    // loop around that middle, next to the base of the dome.
    let top = DVec3::new(7.5, 7.5, 7.0);
    let scene = Scene::new([16; 3], DVec3::ONE, |p| {
        let d = p - top;
        d.z - d.z * d.z / 1.6 + 0.3 * d.truncate().length_squared() - 0.05
    });
    let mut cells = Cells::new(&scene.field, &unwatched()).expect("not interrupted");
    let beside = [[7, 7, 6], [7, 7, 7]].map(|at| cells.find(cells::Cell { level: 0, at }).map(|(_, state)| state));
    assert_eq!(beside[0], Some(cells::State::Graph));
    assert!(matches!(beside[1], Some(cells::State::Halved(_))), "{beside:?}");
    // if the larger cell closed the loop with a lid, the dome would be a separate component
    let (polygons, undecided) = surface::read_all(&scene.field, &cells, &unwatched()).expect("not interrupted");
    let with_lid = Surface::of(&scene.field, &cells, &polygons, undecided);
    assert_eq!(sorted(with_lid.components.iter().map(|c| c.euler)), [1, 1, 2]);
    let settled = Surface::new(&scene.field, &mut cells, &unwatched()).expect("not interrupted");
    assert_eq!(sorted(settled.components.iter().map(|c| c.euler)), [1, 1]);
    assert_eq!((euler(&scene.topology()), scene.by_samples(5)), (vec![1, 1], vec![1, 1]));
}

/// Returns the topology of a speck of the given radius, optionally with a second surface at a
/// distance of 1.3 voxels. Splines reproduce cubic functions, and the effect of the grid border has
/// decayed at the speck.
fn speck(radius: f64, has_interface: bool) -> FieldTopology {
    cubic(radius, if has_interface { 0.3 } else { 0.0 })
}

fn cubic(radius: f64, bend: f64) -> FieldTopology {
    let centre = DVec3::new(15.43, 15.61, 15.52);
    let scene = Scene::new([32; 3], DVec3::ONE, |p| {
        let q = p - centre;
        0.4 * (q.length_squared() - radius * radius) - bend * q.x.powi(3)
    });
    scene.topology()
}

#[test]
fn a_component_at_the_resolution_may_vanish_or_join_another() {
    // the radius from the second-order expansion is just above the resolution, but the extent of
    // the crossings is less than twice the resolution
    let radius = 1.003 * RESOLUTION;
    let topology = speck(radius, false);
    let [place] = topology.undecided() else { panic!("{:?}", topology.undecided()) };
    assert!(topology.critical_points().iter().all(|c| c.radius >= RESOLUTION), "{:?}", topology.critical_points());
    assert_eq!((place.kind, &place.components[..]), (UndecidedKind::Speck, &[0][..]));
    assert!(place.size < 2.0 * RESOLUTION && topology.groups().may_vanish(0), "{place:?}");
    let [group] = topology.groups().all() else { panic!("{:?}", topology.groups()) };
    let may_be = |count, euler| group.may_be(count, euler);
    assert_eq!((group.component_count.clone(), group.euler.clone()), (0..=1, 0..=2));
    assert!(may_be(1, 2) && may_be(0, 0) && !may_be(1, 0) && !may_be(0, 2));

    let topology = speck(radius, true);
    let [place] = topology.undecided() else { panic!("{:?}", topology.undecided()) };
    assert_eq!((place.kind, &place.components[..]), (UndecidedKind::Uncertain(1), &[0, 1][..]));
    let [group] = topology.groups().all() else { panic!("{:?}", topology.groups()) };
    assert_eq!((group.component_count.clone(), group.euler.clone()), (1..=2, 1..=3));
    assert!(group.may_be(2, 3) && group.may_be(1, 1) && !group.may_be(2, 1) && !group.may_be(1, 3));

    // larger specks are decided
    assert_eq!(speck(1.1 * RESOLUTION, true).undecided(), []);
}

#[test]
fn only_a_closed_speck_may_vanish() {
    let topology = speck(0.5 * RESOLUTION, false);
    assert!(topology.groups().may_vanish(0) && topology.undecided()[0].kind == UndecidedKind::Speck);
    // a speck that opens into the adjacent surface is part of its component, which must not vanish
    let topology = cubic(0.9 * RESOLUTION, 1.78);
    assert_eq!(topology.components().len(), 1);
    assert!(topology.critical_points().iter().any(|c| !c.ways.contains(&DVec3::ZERO) && c.radius < RESOLUTION));
    assert!(!topology.groups().may_vanish(0), "{:?}", topology.undecided());
}

#[test]
fn components_and_euler_characteristic_are_told_pair_by_pair() {
    let one = touching(0.0).topology();
    let [group] = one.groups().all() else { panic!("{:?}", one.groups()) };
    assert!(group.may_be(2, 4) && group.may_be(1, 2));
    assert!(!group.may_be(1, 4) && !group.may_be(2, 2) && !group.may_be(3, 6));
}

#[test]
fn work_that_shall_stop_stops() {
    struct Stopped;
    impl Monitor for Stopped {
        fn check(&self) -> Result<(), Interrupted> {
            Err(Interrupted { by: "test".to_owned() })
        }

        fn phase<'a>(&'a self, name: &str) -> Box<dyn isoparticles_file::monitor::Phase + 'a> {
            Silent.phase(name)
        }

        fn counter<'a>(&'a self, label: &str, total: Option<u64>) -> Box<dyn isoparticles_file::monitor::Counter + 'a> {
            Silent.counter(label, total)
        }
    }
    let scene = torus();
    assert!(FieldTopology::watched(&scene.field, &Stopped).is_err());
    assert!(FieldComponents::new(&scene.field, &Stopped).is_err());
}
