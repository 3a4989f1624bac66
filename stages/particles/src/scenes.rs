//! Surfaces and particles for tests.

use crate::state::Fields;
use glam::DVec3;
use isoparticles_field::particle_set::ParticleSet;
use isoparticles_field::random::uniform;
use isoparticles_field::sizing::SizingField;
use isoparticles_field::spline::CubicSpline;
use isoparticles_volume::{Geometry, Image};

/// A surface with its size field and seeds.
pub(crate) struct Scene {
    pub surface: CubicSpline,
    pub sizing: SizingField,
    pub seeds: ParticleSet,
}

impl Scene {
    pub(crate) fn fields(&self) -> Fields<'_> {
        Fields { surface: &self.surface, sizing: &self.sizing }
    }

    /// Creates a scene. Samples `f` and `h`, functions of the position relative to the grid centre,
    /// on the grid. The seeds are up to `count` points projected onto F = 0; `start` maps a random
    /// direction to the point that is projected.
    pub(crate) fn new(
        size: [usize; 3],
        spacing: DVec3,
        f: impl Fn(DVec3) -> f64,
        h: impl Fn(DVec3) -> f64,
        count: u64,
        start: impl Fn(DVec3) -> DVec3,
    ) -> Self {
        let geometry = Geometry::axis_aligned(size, spacing);
        let centre = 0.5 * geometry.upper_corner();
        let sampled = |g: &dyn Fn(DVec3) -> f64| {
            let mut image = Image::filled(geometry.clone(), 0.0f32);
            for (n, value) in image.data.iter_mut().enumerate() {
                let (i, j, k) = (n % size[0], n / size[0] % size[1], n / size[0] / size[1]);
                *value = g(geometry.index_to_grid(DVec3::new(i as f64, j as f64, k as f64)) - centre) as f32;
            }
            image
        };
        let surface = CubicSpline::new(&sampled(&f));
        let sizing = SizingField::new(sampled(&h));
        let mut seeds = ParticleSet {
            geometry,
            positions: vec![],
            normals: vec![],
            sizes: vec![],
            energies: vec![],
            lambdas: vec![],
        };
        for n in 0..count {
            let random = DVec3::new(uniform(1, 0, n), uniform(1, 1, n), uniform(1, 2, n)) - 0.5;
            if let Some((p, g)) = surface.project_with_gradient(centre + start(random.normalize()), 6.0, 1e-6) {
                seeds.positions.push(p);
                seeds.normals.push(g.normalize());
                seeds.sizes.push(sizing.at(p));
                seeds.energies.push(0.0);
                seeds.lambdas.push(crate::INITIAL_LAMBDA);
            }
        }
        Self { surface, sizing, seeds }
    }

    /// Returns a ball of radius 12 mm with constant h.
    pub(crate) fn ball(count: u64, h: f64) -> Self {
        Self::new([34; 3], DVec3::ONE, |p| p.length() - 12.0, |_| h, count, |d| 12.0 * d)
    }

    /// Returns a ball with four particles on each of eight meridians. The distances between
    /// consecutive particles are h, 2.35 h and h. The inner two particles are not in each other's
    /// lists. Each of them proposes a newcomer at distance h in the direction of the other, so the
    /// two newcomers are only 0.35 h apart.
    pub(crate) fn meeting_newcomers() -> Self {
        let mut scene = Self::ball(0, 1.6);
        let centre = 0.5 * scene.surface.geometry().upper_corner();
        for meridian in 0..8 {
            let turn = f64::from(meridian) * std::f64::consts::FRAC_PI_4;
            for arc in [-2.175, -1.175, 1.175, 2.175] {
                let latitude: f64 = arc * 1.6 / 12.0;
                let out = DVec3::new(latitude.cos() * turn.cos(), latitude.cos() * turn.sin(), latitude.sin());
                let (p, g) = scene.surface.project_with_gradient(centre + 12.0 * out, 1.0, 1e-6).unwrap();
                scene.seeds.positions.push(p);
                scene.seeds.normals.push(g.normalize());
                scene.seeds.sizes.push(1.6);
                scene.seeds.energies.push(0.0);
                scene.seeds.lambdas.push(crate::INITIAL_LAMBDA);
            }
        }
        scene
    }

    /// Returns a torus whose tube radius varies, on a grid with anisotropic voxels. h increases
    /// from 0.8 to 3.2 mm across the torus.
    pub(crate) fn bumpy_torus(count: u64) -> Self {
        let f = |p: DVec3| {
            let around = p.y.atan2(p.x);
            (p.truncate().length() - 13.0).hypot(p.z) - 4.5 - 0.6 * (5.0 * around).sin()
        };
        let h = |p: DVec3| 0.8 * 4f64.powf((p.x / 38.0 + 0.5).clamp(0.0, 1.0));
        Self::new([42, 53, 18], DVec3::new(1.0, 0.8, 1.0), f, h, count, |d| {
            let (out, tube) = (d.with_z(0.0).normalize(), std::f64::consts::TAU * (7.3 * d.z).fract());
            13.0 * out + 4.5 * (tube.cos() * out + tube.sin() * DVec3::Z)
        })
    }
}
