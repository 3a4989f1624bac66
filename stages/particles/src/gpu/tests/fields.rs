//! Tests that F, h, the energies and their derivatives are the same on the device and on the CPU.

use super::any_gpu;
use crate::gpu::adapter::{AdapterChoice, Gpu};
use crate::gpu::constants::{LIST_TILE, WORD_LONGEST_LIST};
use crate::gpu::engine::GpuEngine;
use crate::gpu::levels::device_origin;
use crate::gpu::memory::download;
use crate::gpu::schedule::{Plan, Step, steps};
use crate::neighbourhood::TangentPlane;
use crate::reference::energy_jet;
use crate::scenes::Scene;
use crate::settle::{Binning, Engine, Order, Parameters};
use crate::state::State;
use glam::{DVec3, Vec3};

/// Returns an engine with sorted particles and neighbour lists, and with a buffer for the output of
/// the test kernels.
pub(super) fn sorted<'a>(gpu: &'a Gpu, scene: &Scene, binning: Binning) -> GpuEngine<'a> {
    let settings = Parameters { binning, ..Parameters::default() };
    let mut engine = GpuEngine::new(gpu, &scene.fields(), &scene.seeds, &settings).unwrap();
    let plan = Plan { sort: true, bring: false, density: false, set: 0, classes: 0 };
    let all = |engine: &GpuEngine<'_>| steps(engine.count, &engine.levels, Order::Classes, plan);
    let words = engine.run_steps(1, all(&engine), true).unwrap();
    if words[WORD_LONGEST_LIST] > engine.list_room {
        engine.make_lists(words[WORD_LONGEST_LIST]).unwrap();
        engine.run_steps(1, all(&engine), true).unwrap();
    }
    let bytes = 48 * u64::from(engine.count);
    engine.memory.make(gpu, "probed", bytes, wgpu::BufferUsages::empty()).unwrap();
    engine
}

/// Returns the neighbour list of each particle.
pub(super) fn lists(gpu: &Gpu, engine: &GpuEngine<'_>) -> Vec<Vec<u32>> {
    let (count, room) = (engine.count as usize, engine.list_room as usize);
    let lengths: Vec<u32> = download(gpu, engine.memory.get("list_lengths"), count).unwrap();
    let tile = LIST_TILE as usize;
    let all: Vec<u32> = download(gpu, engine.memory.get("lists"), room * count.next_multiple_of(tile)).unwrap();
    // lists are stored in groups of four members; within a tile, the groups of all particles are
    // interleaved
    let place = |i: usize, n: usize| 4 * ((i / tile * (room / 4) + n / 4) * tile + i % tile) + n % 4;
    (0..count).map(|i| (0..lengths[i] as usize).map(|n| all[place(i, n)]).collect()).collect()
}

/// Returns the positions on the device.
fn on_device(gpu: &Gpu, engine: &GpuEngine<'_>) -> Vec<DVec3> {
    let place: Vec<[f32; 4]> = download(gpu, engine.memory.get("place"), engine.count as usize).unwrap();
    let origin = device_origin(&engine.geometry);
    place.iter().map(|p| origin + Vec3::new(p[0], p[1], p[2]).as_dvec3()).collect()
}

fn vector(v: [f32; 4]) -> DVec3 {
    Vec3::new(v[0], v[1], v[2]).as_dvec3()
}

#[test]
fn fields_are_those_of_the_cpu_also_outside_and_in_slabs() {
    for largest_slab in [None, Some(48 * 1024)] {
        let Some(gpu) = any_gpu("fields", AdapterChoice { largest_slab, ..AdapterChoice::default() }) else { return };
        let mut scene = Scene::bumpy_torus(300);
        // random points, including points outside the grid
        let corner = scene.surface.geometry().upper_corner();
        for (n, p) in scene.seeds.positions.iter_mut().enumerate().skip(100) {
            let at = |axis| 1.4 * isoparticles_field::random::uniform(2, axis, n as u64) - 0.2;
            *p = corner * DVec3::new(at(0), at(1), at(2));
        }
        scene.seeds.positions[100] = corner;
        scene.seeds.positions[101] = DVec3::ZERO;
        let mut engine = sorted(&gpu, &scene, Binning::Graded);
        let count = engine.count;
        engine.run_steps(1, vec![Step::over("tests/probe_fields", 0, count)], false).unwrap();
        let probed: Vec<[f32; 4]> = download(&gpu, engine.memory.get("probed"), 3 * engine.count as usize).unwrap();
        for (p, found) in on_device(&gpu, &engine).into_iter().zip(probed.chunks(3)) {
            let (value, gradient) = scene.surface.value_gradient(p);
            assert!((f64::from(found[0][3]) - value).abs() < 2e-6 * (1.0 + value.abs()), "F at {p}");
            assert!((vector(found[0]) - gradient).length() < 2e-5, "gradient at {p}: {:?}, {gradient}", found[0]);
            let (h, slope) = scene.sizing.value_gradient(p);
            let most = engine.levels.levels[0].largest;
            assert!((found[1][3] - (h as f32).min(most)).abs() < 2e-6, "h at {p}");
            assert!((vector(found[1]) - slope).length() < 2e-5, "gradient of h at {p}: {:?}, {slope}", found[1]);
        }
    }
}

#[test]
fn energies_and_forces_are_those_of_the_cpu() {
    let Some(gpu) = any_gpu("energies and forces", AdapterChoice::default()) else { return };
    for scene in [Scene::ball(900, 1.6), Scene::bumpy_torus(1500)] {
        let mut engine = sorted(&gpu, &scene, Binning::Graded);
        let count = engine.count;
        engine.run_steps(1, vec![Step::over("tests/probe_jets", 0, count)], false).unwrap();
        let probed: Vec<[f32; 4]> = download(&gpu, engine.memory.get("probed"), 3 * count as usize).unwrap();
        let energies: Vec<f32> = download(&gpu, engine.memory.get("energies"), count as usize).unwrap();
        engine.listed = false;
        let mut state = State::unlisted(engine.particles().unwrap(), 0.0);
        state.rebuild();
        let fields = scene.fields();
        let mut worst = [0.0f64; 4];
        for (i, found) in probed.chunks(3).enumerate() {
            let (energy, gradient, hessian) = energy_jet(&state, &fields, i);
            let normal = state.set.normals[i];
            let plane = TangentPlane::new(normal);
            let force = plane.out_of_plane(plane.coordinates(gradient));
            let curvature = plane.restrict(&hessian);
            let scale = 1e-9 + energy;
            worst[0] = worst[0].max((f64::from(found[0][3]) - energy).abs() / scale);
            worst[0] = worst[0].max((f64::from(found[1][3]) - energy).abs() / scale);
            worst[0] = worst[0].max((f64::from(energies[i]) - energy).abs() / scale);
            // the terms of a force largely cancel, so the tolerance is relative to the sum of their
            // magnitudes, which is about the Hessian times h
            let size = curvature[0].abs().max(curvature[2].abs()) * state.set.sizes[i] + 1e-9;
            worst[1] = worst[1].max((vector(found[0]) - force).length() / size);
            for (a, b) in found[1].iter().zip(curvature) {
                worst[2] = worst[2].max((f64::from(*a) - b).abs() * state.set.sizes[i] / size);
            }
            let (value, slope) = scene.surface.value_gradient(state.set.positions[i]);
            let surface = (f64::from(found[2][3]) - value).abs() + (vector(found[2]) - slope).length();
            worst[3] = worst[3].max(surface);
        }
        assert!(worst[0] < 1e-4 && worst[1] < 1e-4 && worst[2] < 1e-3 && worst[3] < 2e-5, "{worst:?}");
    }
}
