//! Tests that prefix sums and the sort into bins are exact, and that totals are correct, for any
//! count and any number of workgroups.

use super::any_gpu;
use crate::gpu::adapter::{AdapterChoice, Gpu};
use crate::gpu::commands::{Command, Profile, encode, submit};
use crate::gpu::constants::{LIST_TILE, PARTICLE_GROUP, SUM_BLOCK};
use crate::gpu::kernels::Kernels;
use crate::gpu::levels::BinLevels;
use crate::gpu::memory::{Memory, download, upload};
use crate::gpu::parameters::{pass_block, run_block, scan_block};
use crate::gpu::schedule::{Step, scan};
use glam::{DVec3, Vec3};
use isoparticles_field::energy::{pair_energy, scaled_distance};
use isoparticles_field::random::{bits, uniform};
use isoparticles_volume::Geometry;
use std::sync::Arc;

/// Buffers that the tests fill directly, and methods to run individual steps on them.
struct Rig {
    gpu: Gpu,
    kernels: Arc<Kernels>,
    memory: Memory,
}

impl Rig {
    fn new(what: &str) -> Option<Self> {
        let gpu = any_gpu(what, AdapterChoice::default())?;
        let kernels = gpu.kernels(false, false).unwrap();
        Some(Self { gpu, kernels, memory: Memory::default() })
    }

    fn put<T: bytemuck::NoUninit + Sync>(&mut self, name: &str, values: &[T]) {
        let bytes = size_of_val(values) as u64;
        self.memory.make(&self.gpu, name, bytes, wgpu::BufferUsages::UNIFORM).unwrap();
        upload(&self.gpu, self.memory.get(name), values).unwrap();
    }

    fn run(&mut self, steps: &[Step]) {
        let buffer_called = |name: &str| self.memory.get(name);
        let bind = |s: &Step| self.kernels.bind(&self.gpu.device, buffer_called, s.kernel, s.round, s.aliases);
        let groups: Vec<_> = steps.iter().map(bind).collect();
        let commands: Vec<_> = steps
            .iter()
            .zip(&groups)
            .map(|(s, group)| Command::Run { kernel: s.kernel, group, workgroups: s.workgroups.unwrap() })
            .collect();
        submit(&self.gpu, encode(&self.gpu, &self.kernels, &commands, &mut Profile::default()));
    }

    fn take(&self, name: &str, count: usize) -> Vec<u32> {
        download(&self.gpu, self.memory.get(name), count).unwrap()
    }
}

#[test]
fn prefix_sums_are_exact() {
    let Some(mut rig) = Rig::new("prefix sums") else { return };
    for count in [0usize, 1, 2, 7, 2047, 2048, 2049, 4096, 70_001, 3_000_017] {
        let numbers: Vec<u32> = (0..count as u64).map(|n| (bits(3, 0, n) % 9) as u32).collect();
        rig.put("keep", &numbers);
        rig.put("destinations", &vec![77u32; count + 1]);
        rig.put("scan_sums", &vec![77u32; count / SUM_BLOCK as usize + 2]);
        rig.put("scan_keep", bytemuck::cast_slice::<u8, u32>(scan_block(count as u32).bytes()));
        let mut steps = Vec::new();
        scan(&mut steps, "keep", count as u32);
        rig.run(&steps);
        let mut sum = 0;
        let want: Vec<u32> = std::iter::once(0)
            .chain(numbers.iter().map(|n| {
                sum += n;
                sum
            }))
            .collect();
        assert!(rig.take("destinations", count + 1) == want, "{count} numbers");
    }
}

/// Sorts particles and compares the result with a stable sort by (level, bin).
fn check_sort(rig: &mut Rig, count: usize, largest: f32, contrast: f64, levels: usize) {
    let geometry = Geometry::axis_aligned([9, 9, 9], DVec3::ONE);
    let (low, high) = (Vec3::splat(-4.0), Vec3::splat(4.0));
    let levels = BinLevels::over(low, high, largest, levels);
    let place: Vec<[f32; 4]> = (0..count as u64)
        .map(|n| {
            let at = |axis| (10.0 * uniform(5, axis, n) - 5.0) as f32;
            [at(0), at(1), at(2), largest * contrast.powf(-uniform(5, 3, n)) as f32]
        })
        .collect();
    let settings = crate::Parameters::default();
    let words = |block: crate::gpu::parameters::Block| bytemuck::cast_slice::<u8, u32>(block.bytes()).to_vec();
    rig.put("parameters", &words(run_block(&geometry, &levels, &settings, 729, 1)));
    rig.put("now", &words(pass_block(1, count as u32, true)));
    rig.put("listed_place", &place);
    rig.put("listed_normal", &place);
    for name in ["place", "normal", "place_at_listing"] {
        rig.put(name, &vec![[0.0f32; 4]; count]);
    }
    for name in ["bin_of", "order", "outcome"] {
        rig.put(name, &vec![0u32; count]);
    }
    let bins = levels.bin_total();
    rig.put("bin_counts", &vec![0u32; bins as usize]);
    rig.put("bin_starts", &vec![0u32; bins as usize + 1]);
    rig.put("scan_sums", &vec![0u32; bins as usize / SUM_BLOCK as usize + 2]);
    rig.put("scan_bins", &words(scan_block(bins)));
    let each = count.div_ceil(PARTICLE_GROUP as usize) as u32;
    let mut steps = vec![Step::over("bin_count", 0, each)];
    scan(&mut steps, "bins", bins);
    steps.push(Step::over("bin_scatter", 0, each));
    steps.push(Step::over("bin_reorder", 0, each));
    rig.run(&steps);
    let mut keyed: Vec<(u32, u32)> = place
        .iter()
        .enumerate()
        .map(|(i, p)| {
            let level = levels.levels.iter().rposition(|l| p[3] <= l.largest).unwrap_or(0);
            let l = &levels.levels[level];
            let cell = ((Vec3::new(p[0], p[1], p[2]) - levels.origin) * (1.0 / l.edge)).floor();
            let cell = cell.max(Vec3::ZERO).as_uvec3().min(l.bins - 1);
            (l.first_bin + (cell.z * l.bins.y + cell.y) * l.bins.x + cell.x, i as u32)
        })
        .collect();
    keyed.sort_unstable();
    let want: Vec<u32> = keyed.iter().flat_map(|&(_, i)| place[i as usize].map(f32::to_bits)).collect();
    assert!(rig.take("place", 4 * count) == want, "{count} particles in {} levels", levels.levels.len());
    assert!(rig.take("bin_counts", bins as usize).iter().all(|&n| n == 0), "counts go back to zero");
    let starts = rig.take("bin_starts", bins as usize + 1);
    assert_eq!(starts[bins as usize], count as u32);
    assert!(
        keyed
            .iter()
            .enumerate()
            .all(|(k, &(bin, _))| { (starts[bin as usize]..starts[bin as usize + 1]).contains(&(k as u32)) })
    );
}

#[test]
fn the_sort_is_exact_and_stable() {
    let Some(mut rig) = Rig::new("the sort into bins") else { return };
    for (count, contrast, levels) in [(0, 1.0, 1), (1, 1.0, 1), (63, 1.0, 1), (1001, 8.0, 1), (6000, 30.0, 5)] {
        check_sort(&mut rig, count, 0.5, contrast, levels);
    }
}

#[test]
fn more_than_65535_workgroups_are_no_different() {
    let Some(mut rig) = Rig::new("more than 65,535 workgroups") else { return };
    check_sort(&mut rig, 65_536 * 64 + 33, 0.04, 1.0, 1);
}

#[test]
fn energies_and_totals_of_more_than_65535_workgroups() {
    let Some(mut rig) = Rig::new("energies of more than 65,535 workgroups") else { return };
    // the particles form pairs of mutual neighbours; the last particle has no neighbour
    let count = 65_536 * 64 + 33u32;
    let distance = |pair: u32| 0.2 + 0.7 * uniform(5, 0, u64::from(pair)) as f32;
    let places: Vec<[f32; 4]> =
        (0..count).map(|i| [if i % 2 == 0 { 0.0 } else { distance(i / 2) }, 0.0, 0.0, 0.5]).collect();
    let last = count - 1;
    // each list has a capacity of four members, one group, so the lists are stored one after the
    // other
    let lengths: Vec<u32> = (0..count).map(|i| u32::from(i < last)).collect();
    let lists: Vec<[u32; 4]> = (0..count.next_multiple_of(LIST_TILE)).map(|i| [i ^ 1; 4]).collect();
    let geometry = Geometry::axis_aligned([9; 3], DVec3::ONE);
    let levels = BinLevels::over(Vec3::ZERO, Vec3::splat(4.0), 1.0, 1);
    let words = |block: &crate::gpu::parameters::Block| bytemuck::cast_slice::<u8, u32>(block.bytes()).to_vec();
    rig.put("parameters", &words(&run_block(&geometry, &levels, &crate::Parameters::default(), 729, 4)));
    rig.put("now", &words(&pass_block(1, count, true)));
    rig.put("place", &places);
    rig.put("place_at_listing", &places);
    // with one object, no kernel uses the carried values, so one element is enough
    rig.put("normal", &[[0.0f32; 4]]);
    rig.put("list_lengths", &lengths);
    rig.put("lists", &lists);
    // every third particle took a step at its second attempt; the others failed at their only
    // attempt
    let outcome: Vec<u32> = (0..count).map(|i| if i % 3 == 0 { 0x8000_0002 } else { 1 }).collect();
    rig.put("outcome", &outcome);
    for name in ["energies", "marks", "touched"] {
        rig.put(name, &vec![7u32; count as usize]);
    }
    let blocks = count.div_ceil(SUM_BLOCK);
    rig.put("block_totals", &vec![0u32; 7 * blocks as usize]);
    rig.put("words", &[0u32; 16]);
    let each = Step::over("energies", 0, count.div_ceil(PARTICLE_GROUP));
    rig.run(&[each, Step::over("sum_blocks", 0, blocks), Step::over("sum_total", 0, 1)]);
    let energies = rig.take("energies", count as usize);
    let pair = |pair: u32| pair_energy(scaled_distance(f64::from(distance(pair)), 0.5, 0.5));
    for i in 0..last {
        let found = f64::from(f32::from_bits(energies[i as usize]));
        let wanted = pair(i / 2);
        assert!((found - wanted).abs() < 1e-4 * (wanted + 1e-3), "{i}: {found}, not {wanted}");
    }
    assert_eq!(energies[last as usize], 0);
    let totals = rig.take("words", 9);
    let energy: f64 = (0..last / 2).map(|p| 2.0 * pair(p)).sum();
    assert!((f64::from(f32::from_bits(totals[0])) / energy - 1.0).abs() < 1e-5);
    assert_eq!(totals[1], count.div_ceil(3), "moved");
    assert_eq!(totals[2], count + count.div_ceil(3), "tries");
    assert_eq!(totals[3], 0, "nobody is away from where the lists were made");
    assert_eq!(totals[7], count, "faults: nobody has six neighbours");
    assert_eq!((totals[4], totals[8]), (last, 1), "members of all lists and of the longest");
    assert!(rig.take("marks", count as usize).iter().all(|&mark| mark == 0));
}
