//! Tests of settling on analytic surfaces: density, uniform spacing, thin walls, repeatability and
//! resuming.

use glam::DVec3;
use isoparticles_field::energy::{PRINTED_IDEAL_ENERGY, SUPPORT, ideal_energy, lattice_spacing};
use isoparticles_field::marching_cubes::marching_cubes;
use isoparticles_field::particle_set::ParticleSet;
use isoparticles_field::random::uniform;
use isoparticles_field::sizing::SizingField;
use isoparticles_field::spline::CubicSpline;
use isoparticles_particles::{Fields, INITIAL_LAMBDA, Parameters, PassRecord, settle};
use isoparticles_volume::{Geometry, Image};

const SIZE: usize = 40;

fn sampled(f: impl Fn(DVec3) -> f64) -> Image<f32> {
    let geometry = Geometry::axis_aligned([SIZE; 3], DVec3::splat(1.0));
    let centre = 0.5 * geometry.upper_corner();
    let mut data = Vec::with_capacity(geometry.voxel_count());
    for k in 0..SIZE {
        for j in 0..SIZE {
            for i in 0..SIZE {
                data.push(f(DVec3::new(i as f64, j as f64, k as f64) - centre) as f32);
            }
        }
    }
    Image { geometry, data }
}

/// Returns up to `count` random points projected onto the surface. `start` maps random directions
/// to points near the surface.
fn seeds(surface: &CubicSpline, sizing: &SizingField, count: u64, start: impl Fn(DVec3) -> DVec3) -> ParticleSet {
    let centre = 0.5 * surface.geometry().upper_corner();
    let mut set = ParticleSet {
        geometry: surface.geometry().clone(),
        positions: vec![],
        normals: vec![],
        sizes: vec![],
        energies: vec![],
        lambdas: vec![],
    };
    for n in 0..count {
        let random = DVec3::new(uniform(1, 0, n), uniform(1, 1, n), uniform(1, 2, n)) - 0.5;
        if let Some((p, g)) = surface.project_with_gradient(centre + start(random.normalize()), 3.0, 1e-6) {
            set.positions.push(p);
            set.normals.push(g.normalize());
            set.sizes.push(sizing.at(p));
            set.energies.push(0.0);
            set.lambdas.push(INITIAL_LAMBDA);
        }
    }
    set
}

fn uniform_size(image: &Image<f32>, h: f64) -> SizingField {
    SizingField::new(Image::filled(image.geometry.clone(), h as f32))
}

/// Returns the distance of each particle to its nearest neighbour, divided by the smaller h of the
/// two (as in Eq. 2).
fn nearest(set: &ParticleSet) -> Vec<f64> {
    (0..set.positions.len())
        .map(|i| {
            (0..set.positions.len())
                .filter(|&j| j != i)
                .map(|j| set.positions[i].distance(set.positions[j]) / set.sizes[i].min(set.sizes[j]))
                .fold(f64::INFINITY, f64::min)
        })
        .collect()
}

#[test]
fn a_ball_gets_lattice_spacing_h_from_few_and_many_seeds() {
    let image = sampled(|p| p.length() - 12.0);
    let surface = CubicSpline::new(&image);
    let sizing = uniform_size(&image, 1.6);
    let fields = Fields { surface: &surface, sizing: &sizing };
    let lattice = 4.0 * std::f64::consts::PI * 144.0 * 2.0 / (3f64.sqrt() * 1.6 * 1.6);
    for count in [40, 3000] {
        let (set, summary) = settle(
            &seeds(&surface, &sizing, count, |d| 12.0 * d),
            None,
            &fields,
            &Parameters { max_passes: 120, ..Parameters::default() },
            |_, _| Ok(()),
        )
        .unwrap();
        let found = set.positions.len() as f64;
        assert!((found / lattice - 1.0).abs() < 0.08, "from {count}: {found} particles, the lattice has {lattice:.0}");
        assert!((summary.energy_ratio - 1.0).abs() < 0.2, "{summary:?}");
        let gaps = nearest(&set);
        let mean = gaps.iter().sum::<f64>() / found;
        assert!((mean - 1.0).abs() < 0.08, "from {count}: mean nearest distance {mean} h");
        assert!(gaps.iter().all(|&g| g > 0.75), "{:?}", gaps.iter().copied().fold(f64::INFINITY, f64::min));
        for (&p, &n) in set.positions.iter().zip(&set.normals) {
            let (f, g) = surface.value_gradient(p);
            assert!(f.abs() < 1e-7, "F = {f}");
            assert!((g.normalize() - n).length() < 1e-9);
        }
        // the stored energies must equal Eq. 1 at the final positions; one particle is checked
        let i = set.positions.len() / 2;
        let energy: f64 = (0..set.positions.len())
            .filter(|&j| j != i)
            .map(|j| {
                let d = set.positions[i].distance(set.positions[j]) / (SUPPORT * set.sizes[i].min(set.sizes[j]));
                isoparticles_field::energy::pair_energy(d)
            })
            .sum();
        assert!((energy - set.energies[i]).abs() < 1e-9);
    }
}

#[test]
fn the_two_faces_of_a_thin_shell_do_not_see_each_other() {
    // the wall is 1.5 voxels thick and h is 2.5 voxels, so each face is within the interaction
    // radius of the other
    let image = sampled(|p| (p.length() - 11.0).abs() - 0.75);
    let surface = CubicSpline::new(&image);
    let sizing = uniform_size(&image, 2.5);
    let fields = Fields { surface: &surface, sizing: &sizing };
    let mut start = seeds(&surface, &sizing, 400, |d| 11.75 * d);
    let inner = seeds(&surface, &sizing, 300, |d| 10.25 * d);
    start.positions.extend(inner.positions);
    start.normals.extend(inner.normals);
    start.sizes.extend(inner.sizes);
    start.energies.extend(inner.energies);
    start.lambdas.extend(inner.lambdas);
    let (set, _) = settle(&start, None, &fields, &Parameters::default(), |_, _| Ok(())).unwrap();
    let centre = 0.5 * image.geometry.upper_corner();
    let (mut outside, mut inside) = (0.0, 0.0);
    for p in &set.positions {
        if p.distance(centre) > 11.0 { outside += 1.0 } else { inside += 1.0 }
    }
    let ratio = outside / inside;
    let areas = (11.75f64 / 10.25).powi(2);
    assert!((ratio / areas - 1.0).abs() < 0.15, "outer {outside}, inner {inside}");
    let lattice = 4.0 * std::f64::consts::PI * 11.75f64.powi(2) * 2.0 / (3f64.sqrt() * 6.25);
    assert!((outside / lattice - 1.0).abs() < 0.12, "outer face has {outside}, its lattice {lattice:.0}");
}

#[test]
fn graded_sizes_are_followed() {
    let image = sampled(|p| p.length() - 12.0);
    let surface = CubicSpline::new(&image);
    let mut h = Image::filled(image.geometry.clone(), 0.0f32);
    for n in 0..h.data.len() {
        h.data[n] = (0.9 + 0.06 * (n % SIZE) as f64) as f32;
    }
    let sizing = SizingField::new(h);
    let fields = Fields { surface: &surface, sizing: &sizing };
    let (set, _) =
        settle(&seeds(&surface, &sizing, 900, |d| 12.0 * d), None, &fields, &Parameters::default(), |_, _| Ok(()))
            .unwrap();
    // the lattice count is an integral over x: the sphere has area 2 pi R dx between x and x + dx,
    // and h is linear in x
    let centre = 0.5 * image.geometry.upper_corner();
    for (low, high) in [(-12.0, -6.0), (-6.0, 0.0), (0.0, 6.0), (6.0, 12.0)] {
        let steps = 600;
        let lattice: f64 = (0..steps)
            .map(|n| low + (high - low) * (f64::from(n) + 0.5) / f64::from(steps))
            .map(|x| 2.0 / (3f64.sqrt() * (0.9 + 0.06 * (x + centre.x)).powi(2)))
            .sum::<f64>()
            * 2.0
            * std::f64::consts::PI
            * 12.0
            * (high - low)
            / f64::from(steps);
        let found = set.positions.iter().filter(|p| (low..high).contains(&(p.x - centre.x))).count() as f64;
        assert!((found / lattice - 1.0).abs() < 0.12, "{low} < x < {high}: {found}, the lattice has {lattice:.0}");
    }
}

#[test]
fn the_result_depends_neither_on_threads_nor_on_a_break() {
    let image = sampled(|p| (p.truncate().length() - 11.0).hypot(p.z) - 4.0);
    let surface = CubicSpline::new(&image);
    let sizing = uniform_size(&image, 1.3);
    let start = seeds(&surface, &sizing, 800, |d| 11.0 * d.with_z(0.0).normalize() + 4.0 * d);
    let parameters = Parameters { max_passes: 43, levels: 1, ..Parameters::default() };
    let mut kept: Option<(Vec<PassRecord>, ParticleSet)> = None;
    let in_pool = |threads, body: &mut (dyn FnMut() -> ParticleSet + Send)| {
        rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap().install(body)
    };
    let mut records = Vec::new();
    let whole = in_pool(1, &mut || {
        let fields = Fields { surface: &surface, sizing: &sizing };
        settle(&start, None, &fields, &parameters, |r, engine| {
            records.push(*r);
            if r.pass == 20 {
                kept = Some((records.clone(), engine.particles()?));
            }
            Ok(())
        })
        .unwrap()
        .0
    });
    let fields = Fields { surface: &surface, sizing: &sizing };
    let threaded = in_pool(3, &mut || settle(&start, None, &fields, &parameters, |_, _| Ok(())).unwrap().0);
    assert!(whole == threaded, "one and three threads differ");
    let (records, set) = kept.unwrap();
    let (resumed, _) = settle(&start, Some((set, &records)), &fields, &parameters, |_, _| Ok(())).unwrap();
    assert!(whole == resumed, "a resumed run differs");
    assert!((records[19].energy / records[19].count as f64 / ideal_energy() - 1.0).abs() < 0.3);
}

/// The settled count is within 7 % of the predicted count on a ball with constant h and with
/// steeply graded h, on balls with a radius of only a few h, and on a noisy surface with folds and
/// specks smaller than a voxel.
#[test]
fn as_many_settle_as_are_predicted() {
    let ball = |radius: f64| sampled(move |p| p.length() - radius);
    let mut rough = ball(10.0);
    for (n, value) in rough.data.iter_mut().enumerate() {
        *value += 0.8 * (uniform(7, 0, n as u64) - 0.5) as f32;
    }
    let even = |h: f64| move |_: DVec3| h;
    let steep = |slope: f64| move |p: DVec3| 1.2 + slope * (p.x + 12.0);
    let settled_of_predicted = |image: &Image<f32>, radius: f64, h: &dyn Fn(DVec3) -> f64| {
        let (surface, sizing) = (CubicSpline::new(image), SizingField::new(sampled(h)));
        let fields = Fields { surface: &surface, sizing: &sizing };
        let predicted = sizing.predicted_count(&surface);
        let start = seeds(&surface, &sizing, predicted as u64, |d| radius * d);
        let (set, _) = settle(&start, None, &fields, &Parameters::default(), |_, _| Ok(())).unwrap();
        println!("{} settle, {predicted:.1} are predicted", set.positions.len());
        set.positions.len() as f64 / predicted
    };
    // measured ratios of settled to predicted count: 0.947, 1.027, 1.023, 0.940, 0.953, 0.954,
    // 0.954; most are below 1 because density control stops a few percent below the ideal energy
    for (image, radius, h) in [
        (&ball(12.0), 12.0, &even(1.2) as &dyn Fn(DVec3) -> f64),
        (&ball(12.0), 12.0, &steep(0.15)),
        (&ball(12.0), 12.0, &steep(0.3)),
        (&ball(6.0), 6.0, &even(1.5)),
        (&ball(4.0), 4.0, &even(2.0)),
        (&ball(3.0), 3.0, &even(2.0)),
        (&rough, 10.0, &even(0.6)),
    ] {
        let ratio = settled_of_predicted(image, radius, h);
        assert!((ratio - 1.0).abs() < 0.07, "{ratio}");
    }
}

/// Returns a ball of radius 12 mm with constant h, its marching-cubes vertices as seeds, and the
/// number of particles in the lattice of edge h.
fn ball_at_vertices(h: f64) -> (CubicSpline, SizingField, ParticleSet, f64) {
    let image = sampled(|p| p.length() - 12.0);
    let (surface, sizing) = (CubicSpline::new(&image), uniform_size(&image, h));
    let mut set = seeds(&surface, &sizing, 0, |d| d);
    for vertex in marching_cubes(&image, 0.0).vertices {
        let (p, g) = surface.project_with_gradient(vertex, 3.0, 1e-6).expect("on the ball");
        set.positions.push(p);
        set.normals.push(g.normalize());
        set.sizes.push(sizing.at(p));
        set.energies.push(0.0);
        set.lambdas.push(INITIAL_LAMBDA);
    }
    let lattice = 4.0 * std::f64::consts::PI * 144.0 * 2.0 / (3f64.sqrt() * h * h);
    (surface, sizing, set, lattice)
}

#[test]
fn the_printed_ideal_energy_gets_its_own_lattice() {
    let spacing = lattice_spacing(PRINTED_IDEAL_ENERGY);
    let (surface, sizing, _, lattice) = ball_at_vertices(1.6);
    let fields = Fields { surface: &surface, sizing: &sizing };
    // few seeds, so that most particles are newcomers; too many seeds, so that many are deleted;
    // and three levels
    for (count, levels) in [(60, 1), (4000, 1), (816, 3)] {
        let parameters = Parameters { ideal_energy: PRINTED_IDEAL_ENERGY, levels, ..Parameters::default() };
        let start = seeds(&surface, &sizing, count, |d| 12.0 * d);
        let mut last = None;
        let (set, summary) = settle(&start, None, &fields, &parameters, |record, _| {
            last = Some(*record);
            Ok(())
        })
        .unwrap();
        let (found, wanted) = (set.positions.len() as f64, lattice / (spacing * spacing));
        let gaps = nearest(&set);
        let mean = gaps.iter().sum::<f64>() / found / spacing;
        let defects = last.expect("passes").lattice_defects as f64 / found;
        println!(
            "{count}, {levels}: {} of the lattice, {} of its energy, {mean}, {defects}",
            found / wanted,
            summary.energy_ratio
        );
        assert!((found / wanted - 1.0).abs() < 0.12, "{count}: {found} particles, the lattice has {wanted:.0}");
        assert!((summary.energy_ratio - 1.0).abs() < 0.2, "{count}: {summary:?}");
        assert!((mean - 1.0).abs() < 0.1, "{count}: mean nearest distance {mean} of the lattice's");
        assert!(defects < 0.4, "{count}: {defects} are lattice defects");
    }
}

#[test]
fn printed_method_deletes_vertices_and_reaches_its_energy() {
    let (surface, sizing, start, _) = ball_at_vertices(1.6);
    let fields = Fields { surface: &surface, sizing: &sizing };
    let printed = Parameters::as_printed();
    for parameters in [printed.clone(), Parameters { allow_insert: false, ..printed }] {
        let mut records = Vec::new();
        let (set, summary) = settle(&start, None, &fields, &parameters, |record, _| {
            records.push(*record);
            Ok(())
        })
        .unwrap();
        let sum = |of: &dyn Fn(&PassRecord) -> usize| records.iter().map(of).sum::<usize>();
        let (deleted, inserted) = (sum(&|r| r.deleted), sum(&|r| r.inserted));
        println!("{} seeds, {deleted} deleted, {inserted} inserted, {summary:?}", start.positions.len());
        assert_eq!(set.positions.len() + deleted, start.positions.len() + inserted);
        assert!(deleted * 25 > start.positions.len(), "{deleted} of {} were deleted", start.positions.len());
        assert!(parameters.allow_insert || inserted == 0);
        assert!(summary.settled && summary.passes <= 50, "{summary:?}");
        assert!((summary.energy_ratio - 1.0).abs() < 0.2, "{summary:?}");
        // without closing passes, the run ends with the pass that meets the stop test, even if that
        // pass adds or deletes particles
        assert_eq!(records.len() as u64, summary.passes);
    }
}
