//! Many materials on the device: as many on each sheet as on the CPU, on their sheets, and the same on every run.

use super::any_gpu;
use crate::cpu::scenes::{Body, corners, nested, sectors};
use crate::cpu::{OnStrata, settle_sheets, settle_sheets_with};
use crate::gpu::adapter::{Choice, Gpu};
use crate::gpu::engine::GpuEngine;
use crate::implicit::Sheets;
use crate::settle::{Binning, Engine, Order, Parameters, PassRecord, Summary};
use crate::state::Fields;
use isoparticles_field::materials::{Indicators, Materials};
use isoparticles_field::particle_set::Strata;

fn settled(
    gpu: &Gpu,
    (body, materials): (&Body, &Materials),
    parameters: &Parameters,
    resumed: Option<(OnStrata, &[PassRecord])>,
    mut kept: impl FnMut(&PassRecord, OnStrata),
) -> (OnStrata, Summary) {
    let surface = Sheets::new(materials, 1.0);
    let fields = Fields { surface: &surface, sizing: &body.sizing };
    let make = |set, strata: Vec<_>| {
        let fields = (materials, &body.sizing);
        let engine = GpuEngine::of_materials(gpu, fields, (&set, &strata), parameters)?;
        Ok(Box::new(engine) as Box<dyn Engine + '_>)
    };
    let mut observe = |record: &PassRecord, engine: &mut dyn Engine| {
        let set = engine.particles()?;
        let strata = Strata { of: engine.strata().to_vec(), segments: body.seeds.1.segments.clone() };
        kept(record, (set, strata));
        Ok(())
    };
    let (settled, summary, _) =
        settle_sheets_with(make, &body.seeds, resumed, &fields, parameters, &mut observe).unwrap();
    (settled, summary)
}

#[test]
fn sheets_fill_on_the_device_as_on_the_cpu() {
    let Some(gpu) = any_gpu("sheets_fill_on_the_device_as_on_the_cpu", Choice::default()) else { return };
    let parameters = Parameters { levels: 1, max_passes: 50, ..Parameters::default() };
    let in_bins = Parameters { binning: Binning::Uniform, order: Order::Bins, ..parameters.clone() };
    for (name, body, parameters) in [
        ("nested balls", nested(1.0, 900), &parameters),
        ("sectors", sectors(1.0, 400), &parameters),
        ("corners", corners(1.0, 500), &parameters),
        ("sectors in the order of bins", sectors(1.0, 400), &in_bins),
    ] {
        let materials = body.sampled();
        let surface = Sheets::new(&materials, 1.0);
        let fields = Fields { surface: &surface, sizing: &body.sizing };
        let (on_cpu, of_cpu) = settle_sheets(&body.seeds, None, &fields, parameters, |_, _| Ok(())).unwrap();
        let (on_gpu, of_gpu) = settled(&gpu, (&body, &materials), parameters, None, |_, _| ());
        println!("{name}: {of_cpu:?} {of_gpu:?}");
        let held = on_gpu.1.of.partition_point(|on| on.dimension() < 2);
        assert_eq!(on_gpu.0.positions[..held], body.seeds.0.positions[..held]);
        assert_eq!(on_gpu.1.of[..held], body.seeds.1.of[..held]);
        assert_eq!(on_gpu.1.segments, body.seeds.1.segments);
        for (&p, on) in on_gpu.0.positions.iter().zip(&on_gpu.1.of).skip(held) {
            assert!(materials.clearance(p, on.materials()) > 0.0, "{name}: {p} is off {on:?}");
        }
        assert!((of_gpu.energy_ratio / of_cpu.energy_ratio - 1.0).abs() < 0.03, "{name}");
        for (on, _) in body.lattice_counts() {
            let count = |particles: &OnStrata| particles.1.of.iter().filter(|&&other| other == on).count() as f64;
            let (a, b) = (count(&on_gpu), count(&on_cpu));
            println!("  {:?}: {a} on the device, {b} on the CPU", on.materials());
            assert!((a / b - 1.0).abs() < 0.06, "{name}: {a} and {b} on {on:?}");
        }
    }
}

#[test]
fn a_run_of_materials_is_the_same_again_and_after_a_break() {
    let Some(gpu) = any_gpu("a_run_of_materials_is_the_same_again_and_after_a_break", Choice::default()) else {
        return;
    };
    let body = corners(1.0, 500);
    let materials = body.sampled();
    let parameters = Parameters { levels: 1, max_passes: 23, ..Parameters::default() };
    let mut records = Vec::new();
    let mut kept = None;
    let whole = settled(&gpu, (&body, &materials), &parameters, None, |record, particles| {
        records.push(*record);
        if record.pass == 10 {
            kept = Some((particles, records.clone()));
        }
    });
    let again = settled(&gpu, (&body, &materials), &parameters, None, |_, _| ());
    assert!(whole == again, "two runs differ");
    let (particles, records) = kept.expect("pass 10");
    let resumed = settled(&gpu, (&body, &materials), &parameters, Some((particles, &records)), |_, _| ());
    assert!(whole == resumed, "a resumed run differs");
}
