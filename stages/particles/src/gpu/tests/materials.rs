//! Tests of many materials on the device: the particle counts are close to the counts on the CPU,
//! the particles are on their interfaces, and every run gives the same result.

use super::any_gpu;
use crate::cpu::scenes::{Body, CENTRE, corners, nested, sectors};
use crate::cpu::{OnStrata, settle_interfaces, settle_interfaces_with};
use crate::gpu::adapter::{AdapterChoice, Gpu};
use crate::gpu::engine::GpuEngine;
use crate::gpu::levels::device_origin;
use crate::gpu::memory::download;
use crate::gpu::schedule::Step;
use crate::implicit::Interfaces;
use crate::settle::{Binning, Engine, Order, Parameters, PassRecord, Summary};
use crate::state::Fields;
use glam::{DVec3, Vec3};
use isoparticles_field::materials::{Bound, Indicators, MaterialId, Materials, Stratum};
use isoparticles_field::particle_set::Strata;

fn settled(
    gpu: &Gpu,
    (body, materials): (&Body, &Materials),
    parameters: &Parameters,
    resumed: Option<(OnStrata, &[PassRecord])>,
    mut kept: impl FnMut(&PassRecord, OnStrata),
) -> (OnStrata, Summary) {
    let surface = Interfaces::new(materials, 1.0);
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
        settle_interfaces_with(make, &body.seeds, resumed, &fields, parameters, &mut observe).unwrap();
    (settled, summary)
}

#[test]
fn interfaces_fill_on_the_device_as_on_the_cpu() {
    let Some(gpu) = any_gpu("interfaces_fill_on_the_device_as_on_the_cpu", AdapterChoice::default()) else { return };
    let parameters = Parameters { levels: 1, max_passes: 50, ..Parameters::default() };
    let in_bins = Parameters { binning: Binning::Uniform, order: Order::Bins, ..parameters.clone() };
    for (name, body, parameters) in [
        ("nested balls", nested(1.0, 900), &parameters),
        ("sectors", sectors(1.0, 400), &parameters),
        ("corners", corners(1.0, 500), &parameters),
        ("sectors in the order of bins", sectors(1.0, 400), &in_bins),
    ] {
        let materials = body.sampled();
        let surface = Interfaces::new(&materials, 1.0);
        let fields = Fields { surface: &surface, sizing: &body.sizing };
        let (on_cpu, of_cpu) = settle_interfaces(&body.seeds, None, &fields, parameters, |_, _| Ok(())).unwrap();
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
    let Some(gpu) = any_gpu("a_run_of_materials_is_the_same_again_and_after_a_break", AdapterChoice::default()) else {
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

#[test]
fn differences_and_their_reality_are_those_of_the_cpu() {
    for largest_slab in [None, Some(256 * 1024)] {
        let choice = AdapterChoice { largest_slab, ..AdapterChoice::default() };
        let Some(gpu) = any_gpu("differences_and_their_reality_are_those_of_the_cpu", choice) else { return };
        let (mut real, mut unreal, mut unknown) = (0, 0, 0);
        let normal = DVec3::new(0.3, -0.4, 1.2).normalize();
        let plane = Bound { name: "cut".to_owned(), point: CENTRE + 2.0 * normal, normal };
        for (body, bounds) in [
            (nested(1.0, 900), vec![]),
            (sectors(1.0, 400), vec![]),
            (corners(1.0, 500), vec![]),
            (nested(1.0, 900), vec![plane]),
        ] {
            let is_cut = !bounds.is_empty();
            let materials = body.sampled().with_bounds(bounds);
            let (mut set, mut strata) = (body.seeds.0.clone(), body.seeds.1.of.clone());
            if is_cut {
                let of = |n: usize| Stratum::interface(MaterialId(1 + n as u16 % 2), MaterialId(3));
                (0..strata.len()).filter(|n| n % 5 < 3).for_each(|n| strata[n] = of(n));
            }
            let strata = &strata;
            let held = strata.partition_point(|on| on.dimension() < 2);
            let own = |n: usize| [strata[n].materials()[1], strata[n].materials()[0]];
            // a third of the particles are at random points; the others are on the zero set of
            // their interface, even where another material is closer
            let corner = set.geometry.upper_corner();
            for n in held..strata.len() {
                let at = |axis| isoparticles_field::random::uniform(3, axis, n as u64);
                // in cells at the border of the grid, splines are mirrored, and planes are not
                let border = if is_cut { materials.geometry().spacing } else { DVec3::ZERO };
                let start = border + (corner - 2.0 * border) * DVec3::new(at(0), at(1), at(2));
                let met = materials.project_onto_interface(own(n), start, corner.length(), 1e-7);
                let is_inside = |p: &DVec3| p.cmpge(border).all() && p.cmple(corner - border).all();
                set.positions[n] = met.filter(is_inside).filter(|_| n % 3 > 0).unwrap_or(start);
            }
            let fields = (&materials, &body.sizing);
            let mut engine = GpuEngine::of_materials(&gpu, fields, (&set, strata), &Parameters::default()).unwrap();
            let probed = probe_listed(&gpu, &mut engine);
            let origin = device_origin(&engine.geometry);
            for (n, found) in probed.chunks(3).enumerate().skip(held) {
                let at = origin + (set.positions[n] - origin).as_vec3().as_dvec3();
                let (value, gradient) = materials.difference_gradient(own(n)[0], own(n)[1], at);
                if found[0] == [0.0; 4] {
                    unknown += 1;
                    // the distance from a plane is known everywhere, also without the material
                    let is_far = materials.value_gradient(own(n)[1], at).0.is_infinite();
                    let is_unknown = is_far || gradient == DVec3::ZERO || value.abs() > 1.0;
                    assert!(is_unknown, "{n}: {value} {gradient} is not known");
                    continue;
                }
                let slope = Vec3::from_slice(&found[0]).as_dvec3();
                assert!((f64::from(found[0][3]) - value).abs() < 1e-5 * (1.0 + value.abs()), "{n}: {value} {found:?}");
                assert!((slope - gradient).length() < 5e-5, "{n}: {gradient} {found:?}");
                let clearance = materials.clearance(at, &own(n));
                if value.abs() < 1e-4 && clearance.abs() > 1e-3 {
                    assert_eq!(found[2][0] != 0.0, clearance > 0.0, "{n}: {clearance}");
                    real += usize::from(clearance > 0.0);
                    unreal += usize::from(clearance < 0.0);
                }
            }
        }
        let counts = [real, unreal, unknown];
        assert!(counts.iter().all(|&count| count > 50), "{counts:?} real, unreal and not known: too few for a test");
    }
}

/// Returns the output of `probe_fields` for the uploaded particles, in their original order.
fn probe_listed(gpu: &Gpu, engine: &mut GpuEngine<'_>) -> Vec<[f32; 4]> {
    let bytes = 48 * u64::from(engine.count);
    engine.memory.make(gpu, "probed", bytes, wgpu::BufferUsages::empty()).unwrap();
    let aliases = &[("place", "listed_place_0"), ("normal", "listed_normal_0")];
    let step = Step { aliases, ..Step::over("tests/probe_fields", 0, engine.count) };
    engine.run_steps(1, vec![step], false).unwrap();
    download(gpu, engine.memory.get("probed"), 3 * engine.count as usize).unwrap()
}
