//! Compares the movement of one class or colour and every kernel of density control with their
//! sequential twins.

use super::any_gpu;
use super::fields::{lists, sorted};
use crate::constants::{FARTHEST_MOVE, NEWCOMER_DISTANCE};
use crate::density::{Newcomer, propose};
use crate::gpu::adapter::{AdapterChoice, Gpu};
use crate::gpu::constants::{
    COLOUR_STRIDE, PARTICLE_GROUP, SUM_BLOCK, WORD_COUNT, WORD_DEFECTS, WORD_ENERGY, WORD_KEPT, WORD_LONGEST_WAY,
    WORD_MOVED, WORD_TRIES,
};
use crate::gpu::engine::GpuEngine;
use crate::gpu::levels::device_origin;
use crate::gpu::memory::download;
use crate::gpu::schedule::{COLOURS, LISTED_SETS, Step, bins_of, scan};
use crate::movement;
use crate::neighbourhood::Record;
use crate::reference::energy_at;
use crate::scenes::Scene;
use crate::settle::{Binning, Engine, Parameters};
use crate::state::State;
use glam::{DVec3, UVec3, Vec3};
use isoparticles_field::energy::{SUPPORT, pair_energy, scaled_distance};

/// Pass number used for the random numbers.
const PASS: u32 = 7;
/// Relative distance from a threshold within which an f32 value may fall on either side: about 100
/// rounding errors of 2^-23.
const ROUNDING: f64 = 1e-5;

/// Returns random bits; the twin of `shaders/shared/random.wgsl`.
fn random_bits(stream: u32, counter: u32) -> u32 {
    fn mix(x: u32) -> u32 {
        let state = x.wrapping_mul(747_796_405).wrapping_add(2_891_336_453);
        let word = ((state >> ((state >> 28) + 4)) ^ state).wrapping_mul(277_803_737);
        (word >> 22) ^ word
    }
    mix(mix(mix(Parameters::default().seed as u32).wrapping_add(stream)).wrapping_add(counter))
}

fn random_uniform(kind: u32, counter: usize) -> f64 {
    f64::from(random_bits(4 * PASS + kind, counter as u32) >> 8) / f64::from(1 << 24)
}

/// Particles on the device, their lists, and access to the results of kernels.
struct Rig<'a> {
    gpu: &'a Gpu,
    engine: GpuEngine<'a>,
    /// Position relative to the device origin (xyz), and h.
    places: Vec<[f32; 4]>,
    lists: Vec<Vec<u32>>,
}

impl<'a> Rig<'a> {
    fn new(gpu: &'a Gpu, scene: &Scene) -> Self {
        Self::in_bins(gpu, scene, Binning::Graded)
    }

    fn in_bins(gpu: &'a Gpu, scene: &Scene, binning: Binning) -> Self {
        let mut engine = sorted(gpu, scene, binning);
        engine.listed = false;
        let count = engine.count as usize;
        let lists = lists(gpu, &engine);
        let places = download(gpu, engine.memory.get("place"), count).unwrap();
        Self { gpu, engine, places, lists }
    }

    fn count(&self) -> usize {
        self.engine.count as usize
    }

    fn list(&self, i: usize) -> impl Iterator<Item = usize> + '_ {
        self.lists[i].iter().map(|&j| j as usize)
    }

    fn run(&mut self, kernel: &'static str, round: u32) {
        let each = self.engine.count.div_ceil(PARTICLE_GROUP);
        self.engine.run_steps(u64::from(PASS), vec![Step::over(kernel, round, each)], false).unwrap();
    }

    fn take<T: bytemuck::AnyBitPattern>(&self, name: &str, count: usize) -> Vec<T> {
        download(self.gpu, self.engine.memory.get(name), count).unwrap()
    }

    /// Returns the scaled distance between two particles (Eq. 2).
    fn apart(&self, i: usize, j: usize) -> f64 {
        let at = |i: usize| Vec3::from_slice(&self.places[i]).as_dvec3();
        scaled_distance(at(i).distance(at(j)), f64::from(self.places[i][3]), f64::from(self.places[j][3]))
    }

    /// Returns the particles as a CPU state, with lists built on the CPU.
    fn state(&mut self) -> State {
        let mut state = State::unlisted(self.engine.particles().unwrap(), Parameters::default().normal_agreement);
        state.rebuild();
        state
    }
}

/// Returns the result of `value > threshold`, or `None` if the difference is too small to decide.
fn beyond(value: f64, threshold: f64) -> Option<bool> {
    ((value - threshold).abs() > ROUNDING * (1.0 + threshold.abs())).then_some(value > threshold)
}

/// Returns the logical AND of two operands. The result is `None` only if it depends on an undecided
/// operand.
fn both(a: Option<bool>, b: Option<bool>) -> Option<bool> {
    if a == Some(false) || b == Some(false) { Some(false) } else { a.and(b) }
}

fn oversampled(energy: f32, i: usize) -> Option<bool> {
    let parameters = Parameters::default();
    let excess = f64::from(energy) / parameters.ideal_energy - 1.0;
    let bar = parameters.delete_above - 1.0;
    both(beyond(excess, bar), beyond(random_uniform(0, i) * excess, bar))
}

fn undersampled(energy: f32, i: usize) -> Option<bool> {
    let parameters = Parameters::default();
    let lack = 1.0 - f64::from(energy) / parameters.ideal_energy;
    let bar = 1.0 - parameters.add_below;
    both(beyond(lack, bar), beyond(random_uniform(1, i) * lack, bar))
}

/// Returns a torus with graded h and more particles than its lattice has, at random positions.
fn too_many() -> Scene {
    Scene::bumpy_torus(2100)
}

#[test]
fn one_class_moves_as_on_the_cpu_and_nobody_else_does() {
    let Some(gpu) = any_gpu("movement of a class", AdapterChoice::default()) else { return };
    let scene = too_many();
    let mut rig = Rig::new(&gpu, &scene);
    let (state, fields) = (rig.state(), scene.fields());
    let classes: Vec<u32> = rig.take("classes", rig.count());
    let class = 3;
    let step = Step { workgroups: None, ..Step::over("move_particles", class, 0) };
    rig.engine.run_steps(u64::from(PASS), vec![step], false).unwrap();
    let after: Vec<[f32; 4]> = rig.take("place", rig.count());
    let origin = device_origin(&rig.engine.geometry);
    let (mut members, mut alike, mut moved) = (0, 0, 0);
    for i in 0..rig.count() {
        if classes[i] != class {
            assert!(after[i] == rig.places[i], "{i} is of class {}", classes[i]);
            continue;
        }
        let wanted = movement::step_alone(&state, &fields, i);
        let found = origin + Vec3::from_slice(&after[i]).as_dvec3();
        let h = state.set.sizes[i];
        assert!(found.distance(state.set.positions[i]) <= (FARTHEST_MOVE + 1e-5) * h, "{i} went too far");
        members += 1;
        moved += usize::from(wanted.moved);
        alike += usize::from(found.distance(wanted.position) < 1e-3 * h);
        let (was, now) =
            (energy_at(&state, i, state.set.positions[i], h), energy_at(&state, i, found, f64::from(after[i][3])));
        assert!(now <= was * (1.0 + 1e-4), "{i}: energy {was} -> {now}");
    }
    assert!(members > 40 && moved * 10 > members * 9, "{moved} of {members} moved");
    // if the energies before and after a step are nearly equal, one backend may accept the step and
    // the other reject it
    assert!(alike * 100 >= members * 98, "{alike} of {members} went where the CPU sends them");
}

#[test]
fn only_bins_of_the_colour_move_one_particle_at_a_time() {
    let Some(gpu) = any_gpu("movement of a colour", AdapterChoice::default()) else { return };
    let scene = too_many();
    let mut rig = Rig::in_bins(&gpu, &scene, Binning::Uniform);
    let (mut state, fields) = (rig.state(), scene.fields());
    let bins = rig.engine.levels.levels[0].bins;
    let starts: Vec<u32> = rig.take("bin_starts", bins.element_product() as usize + 1);
    let colour = 14;
    let first = UVec3::new(colour, colour / COLOUR_STRIDE, colour / (COLOUR_STRIDE * COLOUR_STRIDE)) % COLOUR_STRIDE;
    rig.engine.run_steps(u64::from(PASS), vec![Step::over("move_bins", colour, bins_of(colour, bins))], false).unwrap();
    let after: Vec<[f32; 4]> = rig.take("place", rig.count());
    let origin = device_origin(&rig.engine.geometry);
    let (mut members, mut moved, mut alike) = (0, 0, 0);
    for bin in 0..bins.element_product() {
        let at = UVec3::new(bin % bins.x, bin / bins.x % bins.y, bin / bins.x / bins.y);
        let range = starts[bin as usize] as usize..starts[bin as usize + 1] as usize;
        if at % COLOUR_STRIDE != first {
            assert!(range.clone().all(|i| after[i] == rig.places[i]), "bin {at} is not of the colour");
            continue;
        }
        members += range.len();
        moved += range.clone().filter(|&i| after[i] != rig.places[i]).count();
        // the reference steps on the CPU use the new positions of the earlier particles of the bin,
        // because the kernel moves these one after the other
        for i in range {
            let wanted = movement::step_alone(&state, &fields, i);
            let found = origin + Vec3::from_slice(&after[i]).as_dvec3();
            alike += usize::from(found.distance(wanted.position) < 1e-3 * state.set.sizes[i]);
            (state.set.positions[i], state.set.sizes[i]) = (found, f64::from(after[i][3]));
            state.records[i] = Record::new(found, state.set.sizes[i]);
        }
    }
    assert!(members > 40 && moved * 10 > members * 9, "{moved} of {members} moved");
    assert!(alike * 100 >= members * 98, "{alike} of {members} went where the CPU sends them");
}

#[test]
fn every_bin_has_one_colour() {
    for bins in [UVec3::ONE, UVec3::new(1, 2, 3), UVec3::new(4, 5, 6), UVec3::new(17, 3, 8)] {
        assert_eq!((0..COLOURS).map(|colour| bins_of(colour, bins)).sum::<u32>(), bins.element_product(), "{bins}");
    }
}

#[test]
fn rounds_of_deletion_are_those_of_the_twin() {
    let Some(gpu) = any_gpu("deletion", AdapterChoice::default()) else { return };
    let mut rig = Rig::new(&gpu, &too_many());
    let count = rig.count();
    let mut gone = [0; 4];
    for round in 1..=3 {
        let was: Vec<u32> = rig.take("marks", count);
        let energies: Vec<f32> = rig.take("energies", count);
        rig.run("density_delete", round);
        let marks: Vec<u32> = rig.take("marks", count);
        let touched: Vec<u32> = rig.take("touched", count);
        for i in 0..count {
            if was[i] != 0 {
                assert_eq!(marks[i], was[i], "{i} was deleted before");
                continue;
            }
            // a particle is deleted if it is oversampled, unless an interacting particle of higher
            // energy is oversampled too
            let mut wanted = oversampled(energies[i], i);
            for j in rig.list(i).filter(|&j| was[j] == 0) {
                let worse = energies[j] > energies[i] || (energies[j] == energies[i] && j < i);
                let beaten = both(both(Some(worse), oversampled(energies[j], j)), beyond(1.0, rig.apart(i, j)));
                wanted = both(wanted, beaten.map(|b| !b));
            }
            assert!(
                wanted.is_none_or(|w| w == (marks[i] == round)),
                "{i} in round {round}: {wanted:?}, mark {}",
                marks[i]
            );
            gone[round as usize] += usize::from(marks[i] == round);
            let near_one = rig.list(i).any(|j| marks[j] == round);
            assert_eq!(touched[i] == round, near_one, "{i} in round {round}");
        }
        rig.run("density_relieve", round);
        let relieved: Vec<f32> = rig.take("energies", count);
        for i in (0..count).filter(|&i| marks[i] == 0) {
            let share: f64 = rig.list(i).filter(|&j| marks[j] == round).map(|j| pair_energy(rig.apart(i, j))).sum();
            let wanted = f64::from(energies[i]) - share;
            assert!((f64::from(relieved[i]) - wanted).abs() < 1e-4 * (0.1 + f64::from(energies[i])), "{i}: {wanted}");
        }
    }
    assert!(gone[1] > 50 && gone[2] > 5, "{gone:?} were deleted: too few for a test");
}

#[test]
fn newcomers_are_those_of_the_twin_and_everybody_finds_a_place() {
    let Some(gpu) = any_gpu("insertion", AdapterChoice::default()) else { return };
    // these scenes have far fewer particles than their lattices, so many particles propose
    // newcomers, and some newcomers are close to each other
    let tori = (120..420).step_by(60).map(Scene::bumpy_torus);
    let balls = (40..400).step_by(20).map(|n| Scene::ball(n, 1.6));
    let by_distance: usize =
        tori.chain(balls).chain([Scene::meeting_newcomers()]).map(|scene| insertion(&gpu, &scene)).sum();
    assert!(by_distance >= 3, "{by_distance} newcomers gave way to another's over a distance: too few for a test");
}

/// Compares all steps of insertion. Returns the number of newcomers rejected because they are too
/// close to a newcomer whose parent is not a neighbour of their own parent.
fn insertion(gpu: &Gpu, scene: &Scene) -> usize {
    let mut rig = Rig::new(gpu, scene);
    let (state, fields) = (rig.state(), scene.fields());
    let count = rig.count();
    for round in 1..=3 {
        rig.run("density_delete", round);
        rig.run("density_relieve", round);
    }
    let marks: Vec<u32> = rig.take("marks", count);
    let energies: Vec<f32> = rig.take("energies", count);
    rig.run("insert_propose", 0);
    let proposals: Vec<u32> = rig.take("proposals", count);
    let newcomers: Vec<[f32; 4]> = rig.take("newcomer_place", count);
    let origin = device_origin(&rig.engine.geometry);
    let deleted: Vec<bool> = marks.iter().map(|&mark| mark != 0).collect();
    let (mut made, mut differ) = (0, 0);
    for i in 0..count {
        let Some(is_undersampled) = undersampled(energies[i], i) else { continue };
        let wanted = (is_undersampled && !deleted[i]).then(|| propose(&state, &fields, &deleted, i)).flatten();
        made += usize::from(proposals[i] != 0);
        let alike = match wanted {
            Some(Newcomer { position: p, size: h, .. }) => {
                let found = origin + Vec3::from_slice(&newcomers[i]).as_dvec3();
                proposals[i] == 1 && found.distance(p) < 1e-3 * h && (f64::from(newcomers[i][3]) - h).abs() < 1e-3 * h
            }
            None => proposals[i] == 0,
        };
        differ += usize::from(!alike);
    }
    assert!(made > 10, "{made} newcomers: too few for a test");
    // 1 % may differ: two gaps may be equally wide in f32, and a distance may be too close to the
    // minimum to be compared reliably
    assert!(differ * 100 <= made, "{differ} of {made} proposals differ");

    rig.run("insert_choose", 0);
    let keep: Vec<u32> = rig.take("keep", 2 * count);
    let facing: Vec<[f32; 4]> = rig.take("newcomer_normal", count);
    let at = |i: usize| Vec3::from_slice(&newcomers[i]).as_dvec3();
    let proposed: Vec<usize> = (0..count).filter(|&i| proposals[i] != 0).collect();
    // unlike the kernel, the test compares every pair of newcomers, however far apart the parents
    // are
    let too_near = |i: usize, j: usize| {
        let least = NEWCOMER_DISTANCE * f64::from(newcomers[i][3].min(newcomers[j][3]));
        let same_interface = Vec3::from_slice(&facing[i]).dot(Vec3::from_slice(&facing[j])) > 0.0;
        i != j && same_interface && DVec3::distance(at(i), at(j)) < least
    };
    let beats = |j: usize, i: usize| {
        let priority = |i: usize| random_bits(4 * PASS + 2, i as u32);
        priority(j) > priority(i) || (priority(j) == priority(i) && j < i)
    };
    let mut by_distance = 0;
    for i in 0..count {
        assert_eq!(keep[i] == 1, !deleted[i], "{i}");
        let beaten_by_neighbour = rig.list(i).any(|j| proposals[j] != 0 && beats(j, i));
        let beaten_by_distance = proposals[i] != 0 && proposed.iter().any(|&j| beats(j, i) && too_near(i, j));
        let wanted = proposals[i] != 0 && !beaten_by_neighbour && !beaten_by_distance;
        by_distance += usize::from(proposals[i] != 0 && !beaten_by_neighbour && beaten_by_distance);
        assert_eq!(keep[count + i] == 1, wanted, "newcomer of {i}");
    }
    let chosen: Vec<usize> = proposed.into_iter().filter(|&i| keep[count + i] == 1).collect();
    for &i in &chosen {
        assert!(!chosen.iter().any(|&j| too_near(i, j)), "the newcomer of {i} is too near another");
    }

    let mut last = Vec::new();
    scan(&mut last, "keep", 2 * count as u32);
    last.push(Step { aliases: LISTED_SETS[1], ..Step::over("compact", 0, rig.engine.count.div_ceil(PARTICLE_GROUP)) });
    let words = rig.engine.run_steps(u64::from(PASS), last, false).unwrap();
    let stay = (0..count).filter(|&i| keep[i] == 1).map(|i| rig.places[i]);
    let come = (0..count).filter(|&i| keep[count + i] == 1).map(|i| newcomers[i]);
    let wanted: Vec<[f32; 4]> = stay.chain(come).collect();
    assert_eq!(
        [words[WORD_COUNT], words[WORD_KEPT]].map(|w| w as usize),
        [wanted.len(), keep[..count].iter().sum::<u32>() as usize]
    );
    assert!(rig.take::<[f32; 4]>("listed_place_1", wanted.len()) == wanted, "places after compaction");
    by_distance
}

#[test]
fn totals_are_those_of_the_particles() {
    let Some(gpu) = any_gpu("totals", AdapterChoice::default()) else { return };
    // a single particle, at most one block of particles, and three blocks
    for count in [1, 2048, 4500] {
        let mut rig = Rig::new(&gpu, &Scene::ball(count, 0.9));
        let energies: Vec<f32> = rig.take("energies", rig.count());
        let blocks = rig.engine.count.div_ceil(SUM_BLOCK);
        let steps = vec![Step::over("sum_blocks", 0, blocks), Step::over("sum_total", 0, 1)];
        let words = rig.engine.run_steps(u64::from(PASS), steps, false).unwrap();
        let energy: f64 = energies.iter().map(|&e| f64::from(e)).sum();
        assert!((f64::from(f32::from_bits(words[WORD_ENERGY])) - energy).abs() <= 1e-5 * energy, "{count}: {energy}");
        assert_eq!([words[WORD_MOVED], words[WORD_TRIES], words[WORD_LONGEST_WAY]], [0; 3], "nobody has moved");
        let mut state = rig.state();
        let defects = state.measure().lattice_defects;
        let unsure = (0..state.len()).filter(|&i| on_the_edge(&state, i)).count();
        assert!(
            (words[WORD_DEFECTS] as usize).abs_diff(defects) <= unsure,
            "{} lattice defects, not {}",
            words[WORD_DEFECTS],
            defects
        );
        assert!(unsure * 100 <= rig.count(), "{unsure} of {count} are close calls");
    }
}

/// Returns whether f32 rounding may move a neighbour of particle i across the limit of the first
/// ring or of the support.
fn on_the_edge(state: &State, i: usize) -> bool {
    let set = &state.set;
    state.neighbours.of(i).iter().any(|&j| {
        let ratio = set.positions[i].distance(set.positions[j as usize]) / set.sizes[i].min(set.sizes[j as usize]);
        (ratio / crate::constants::FIRST_RING - 1.0).abs() < ROUNDING || (ratio / SUPPORT - 1.0).abs() < ROUNDING
    })
}
