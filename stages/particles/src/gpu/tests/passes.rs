//! Tests of the whole backend: the CPU and the GPU give similar lattices, and every GPU run gives
//! the same bytes, even after a resume.

use super::any_gpu;
use crate::cpu::settle;
use crate::gpu::adapter::{AdapterChoice, Gpu};
use crate::gpu::engine::GpuEngine;
use crate::gpu::memory::Memory;
use crate::scenes::Scene;
use crate::settle::{Binning, Engine, Order, Parameters, PassRecord, Summary, settle_with};
use isoparticles_field::particle_set::ParticleSet;

fn settled(gpu: &Gpu, scene: &Scene, parameters: &Parameters) -> (ParticleSet, Summary) {
    let fields = scene.fields();
    let mut engine = GpuEngine::new(gpu, &fields, &scene.seeds, parameters).unwrap();
    settle_with(&mut engine, &fields, parameters, &[], |_, _| Ok(())).unwrap()
}

/// Asserts that count and energy agree to within 1 %.
fn alike(a: &(ParticleSet, Summary), b: &(ParticleSet, Summary), what: &str) {
    let count = a.0.positions.len() as f64 / b.0.positions.len() as f64;
    let energy = a.1.energy_ratio / b.1.energy_ratio;
    assert!((count - 1.0).abs() < 0.01, "{what}: count off by {:.2} %", 100.0 * (count - 1.0));
    assert!((energy - 1.0).abs() < 0.01, "{what}: energy off by {:.2} %", 100.0 * (energy - 1.0));
}

#[test]
fn the_lattice_is_that_of_the_cpu() {
    let Some(gpu) = any_gpu("the whole backend", AdapterChoice::default()) else { return };
    let first = Parameters {
        max_passes: 12,
        closing_passes: 2,
        energy_tolerance: Some(0.0),
        levels: 1,
        ..Parameters::default()
    };
    let parameters = Parameters { max_passes: 25, seed: 5, ..first.clone() };
    for (mut scene, what) in [(Scene::ball(1500, 1.2), "ball"), (Scene::bumpy_torus(1300), "graded torus")] {
        // a first run makes the seeds about as evenly spaced as the output of the seed stage, which
        // reduces random variation
        scene.seeds = settle(&scene.seeds, None, &scene.fields(), &first, |_, _| Ok(())).unwrap().0;
        let on_cpu = settle(&scene.seeds, None, &scene.fields(), &parameters, |_, _| Ok(())).unwrap();
        let graded = settled(&gpu, &scene, &parameters);
        alike(&graded, &on_cpu, what);
        if what != "ball" {
            let uniform = Parameters { binning: Binning::Uniform, ..parameters.clone() };
            alike(&settled(&gpu, &scene, &uniform), &on_cpu, &format!("{what}, uniform bins"));
            let coloured = Parameters { order: Order::Bins, ..uniform };
            let found = settled(&gpu, &scene, &coloured);
            alike(&found, &on_cpu, &format!("{what}, coloured bins"));
            assert!(found.0 == settled(&gpu, &scene, &coloured).0, "two runs in the order of bins differ");
        }
    }
}

#[test]
fn particles_stay_on_the_surface_and_energy_falls() {
    let Some(gpu) = any_gpu("movement", AdapterChoice::default()) else { return };
    let scene = Scene::bumpy_torus(1300);
    let fields = scene.fields();
    let mut engine = GpuEngine::new(&gpu, &fields, &scene.seeds, &Parameters::default()).unwrap();
    let mut last = f64::INFINITY;
    for pass in 1..=6 {
        let outcome = engine.pass(pass, false).unwrap();
        assert!(outcome.energy < last * 1.0001, "pass {pass}: {} after {last}", outcome.energy);
        assert!(outcome.moved as f64 > 0.9 * outcome.count as f64);
        last = outcome.energy;
        let set = engine.particles().unwrap();
        let voxel = scene.surface.geometry().min_spacing();
        for ((&p, &n), &h) in set.positions.iter().zip(&set.normals).zip(&set.sizes) {
            let (f, g) = scene.surface.value_gradient(p);
            assert!(f.abs() < 1e-4 * voxel, "F = {f}");
            assert!((g.normalize() - n).length() < 1e-4);
            assert!((scene.sizing.at(p) - h).abs() < 1e-5);
        }
    }
}

#[test]
fn repeated_resumed_and_slab_runs_give_the_same_bytes() {
    let Some(gpu) = any_gpu("repeatability", AdapterChoice::default()) else { return };
    let scene = Scene::bumpy_torus(900);
    let fields = scene.fields();
    let in_classes = Parameters { max_passes: 27, ..Parameters::default() };
    let in_bins = Parameters { binning: Binning::Uniform, order: Order::Bins, ..in_classes.clone() };
    for parameters in [in_classes, in_bins] {
        let mut kept: Option<(Vec<PassRecord>, ParticleSet)> = None;
        let mut records = Vec::new();
        let mut engine = GpuEngine::new(&gpu, &fields, &scene.seeds, &parameters).unwrap();
        let whole = settle_with(&mut engine, &fields, &parameters, &[], |record, engine| {
            records.push(*record);
            if record.pass == 10 {
                kept = Some((records.clone(), engine.particles()?));
            }
            Ok(())
        })
        .unwrap();
        assert!(records.iter().map(|r| r.inserted).sum::<usize>() > 50, "the seeds were to be too few");
        assert!(whole.0 == settled(&gpu, &scene, &parameters).0, "two runs differ");
        let (records, set) = kept.unwrap();
        let mut engine = GpuEngine::new(&gpu, &fields, &set, &parameters).unwrap();
        let resumed = settle_with(&mut engine, &fields, &parameters, &records, |_, _| Ok(())).unwrap();
        assert!(whole.0 == resumed.0, "a resumed run differs");
        let Some(narrow) =
            any_gpu("slabs", AdapterChoice { largest_slab: Some(48 * 1024), ..AdapterChoice::default() })
        else {
            return;
        };
        assert!(whole.0 == settled(&narrow, &scene, &parameters).0, "slabs make a difference");
    }
}

#[test]
fn passes_before_their_turn_are_no_different() {
    let Some(gpu) = any_gpu("passes before their turn", AdapterChoice::default()) else { return };
    // with these numbers of seeds, some passes leave more particles than the next pass can process,
    // and lists and classes overflow
    for count in [1, 60, 700, 3000] {
        let scene = Scene::ball(count, 1.6);
        let parameters = Parameters { max_passes: 16, levels: 1, closing_passes: 3, ..Parameters::default() };
        let fields = scene.fields();
        let mut ahead = GpuEngine::new(&gpu, &fields, &scene.seeds, &parameters).unwrap();
        let mut in_turn = GpuEngine::new(&gpu, &fields, &scene.seeds, &parameters).unwrap();
        ahead.controls_density_until(13);
        for pass in 1..=16 {
            // density control ends after pass 9, earlier than announced
            let density = pass <= 9;
            let [a, b] = [&mut ahead, &mut in_turn].map(|engine| engine.pass(pass, density).unwrap());
            assert_eq!(format!("{a:?}"), format!("{b:?}"), "pass {pass} from {count}");
            if pass % 4 == 0 {
                assert!(ahead.particles().unwrap() == in_turn.particles().unwrap(), "pass {pass} from {count}");
            }
        }
    }
}

#[test]
fn crowds_and_lonely_ones_end_as_the_lattice() {
    let Some(gpu) = any_gpu("density control", AdapterChoice::default()) else { return };
    let lattice = 4.0 * std::f64::consts::PI * 144.0 * 2.0 / (3f64.sqrt() * 1.6 * 1.6);
    // 3000 is more than three times the lattice count, so the lists exceed their initial capacity
    for count in [40, 3000] {
        let parameters = Parameters { max_passes: 60, ..Parameters::default() };
        let (set, summary) = settled(&gpu, &Scene::ball(count, 1.6), &parameters);
        let found = set.positions.len() as f64;
        assert!((found / lattice - 1.0).abs() < 0.08, "from {count}: {found}, the lattice has {lattice:.0}");
        assert!((summary.energy_ratio - 1.0).abs() < 0.2, "{summary:?}");
    }
}

#[test]
fn no_particle_and_one_are_no_different() {
    let Some(gpu) = any_gpu("few particles", AdapterChoice::default()) else { return };
    let alone = Parameters { max_passes: 12, allow_insert: false, ..Parameters::default() };
    for count in [0, 1] {
        let scene = Scene::ball(count, 1.6);
        let (set, summary) = settled(&gpu, &scene, &alone);
        assert_eq!(set.positions.len() as u64, count);
        assert_eq!(summary.energy_ratio, 0.0, "nobody to repel it");
        assert!(set.positions.iter().zip(&scene.seeds.positions).all(|(p, q)| p.distance(*q) < 1e-4), "it stays");
    }
    // a single particle gets newcomers until the ball is full
    let growing = Parameters { max_passes: 40, ..Parameters::default() };
    let (set, _) = settled(&gpu, &Scene::ball(1, 1.6), &growing);
    assert!(set.positions.len() > 100, "{} after 40 passes", set.positions.len());
}

#[test]
fn an_adapter_that_is_not_there_ends_with_exit_code_3() {
    let choice = AdapterChoice { name: Some("no such adapter".to_owned()), ..AdapterChoice::default() };
    let Err(error) = Gpu::open(&choice) else { panic!("it was opened") };
    assert_eq!(error.kind, isoparticles_stage::error::Kind::Gpu);
}

#[test]
fn a_lost_device_is_a_gpu_error_and_the_run_can_resume() {
    let Some(gpu) = any_gpu("a lost device", AdapterChoice::default()) else { return };
    let scene = Scene::ball(300, 1.6);
    let parameters = Parameters { max_passes: 15, levels: 1, ..Parameters::default() };
    let whole = settled(&gpu, &scene, &parameters);
    let mut kept: Option<(Vec<PassRecord>, ParticleSet)> = None;
    let mut records = Vec::new();
    let fields = scene.fields();
    let mut engine = GpuEngine::new(&gpu, &fields, &scene.seeds, &parameters).unwrap();
    let lost = settle_with(&mut engine, &fields, &parameters, &[], |record, engine| {
        records.push(*record);
        match record.pass {
            10 => kept = Some((records.clone(), engine.particles()?)),
            12 => gpu.device.destroy(),
            _ => {}
        }
        Ok(())
    });
    let Err(error) = lost else { panic!("it was not noticed") };
    assert_eq!(error.kind, isoparticles_stage::error::Kind::Gpu, "{error}");
    assert!(error.next.contains("--resume"), "{error}");
    assert_eq!(records.len(), 12, "no pass after the loss counts");
    // resume from the last checkpoint on a reopened device
    let (records, set) = kept.unwrap();
    let Some(gpu) = any_gpu("a device opened anew", AdapterChoice::default()) else { return };
    let mut engine = GpuEngine::new(&gpu, &fields, &set, &parameters).unwrap();
    let resumed = settle_with(&mut engine, &fields, &parameters, &records, |_, _| Ok(())).unwrap();
    assert!(whole.0 == resumed.0, "the resumed run differs");
}

#[test]
fn a_buffer_beyond_the_limits_is_refused() {
    let Some(gpu) = any_gpu("limits of buffers", AdapterChoice::default()) else { return };
    let mut memory = Memory::default();
    let most = gpu.limits.max_buffer_size.min(gpu.limits.max_storage_buffer_binding_size);
    let error = memory.make(&gpu, "lists", most + 16, wgpu::BufferUsages::empty()).unwrap_err();
    assert_eq!(error.kind, isoparticles_stage::error::Kind::Gpu);
    assert!(error.what.contains("lists") && error.what.contains(&most.to_string()), "{error}");
    assert_eq!(memory.peak(), 0, "nothing was taken");
}

#[test]
fn a_field_beyond_the_limits_is_refused() {
    let choice = AdapterChoice { largest_slab: Some(1024), ..AdapterChoice::default() };
    let Some(gpu) = any_gpu("limits", choice) else { return };
    let scene = Scene::ball(10, 1.6);
    let engine = GpuEngine::new(&gpu, &scene.fields(), &scene.seeds, &Parameters::default());
    let Err(error) = engine else { panic!("it was taken") };
    assert_eq!(error.kind, isoparticles_stage::error::Kind::Gpu);
}
