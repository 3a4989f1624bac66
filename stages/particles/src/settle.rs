//! The main loop (Figure 1 of the paper): moves the particles, measures the energy, controls the
//! density, and repeats until a stop test is met or the pass limit is reached. The engines that run
//! a pass are in `cpu.rs` and `gpu/`.

use crate::constants::{
    BALANCE_WINDOW, COARSE_CLOSING_PASSES, COARSE_REST_SHARE, DEFECT_TOLERANCE, DEFECT_WINDOW, FINAL_TOLERANCE,
    REST_SHARE,
};
use crate::gpu::DeviceReport;
use crate::implicit::Implicit;
use crate::state::{Fields, State};
use clap::ValueEnum;
use isoparticles_field::energy;
use isoparticles_field::materials::Stratum;
use isoparticles_field::particle_set::ParticleSet;
use isoparticles_stage::error::Result;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::time::Instant;

/// Parameters of a run.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Parameters {
    /// Maximum number of passes on the last level, whose edge length is h. If `levels` is 1, this
    /// is the only level.
    pub max_passes: u64,
    /// Stop when the fraction of particles that are lattice defects decreases by less than this
    /// relative amount per pass, averaged over [`DEFECT_WINDOW`] passes, and density control is
    /// nearly at rest.
    pub defect_tolerance: f64,
    /// If given, replaces the stop test with the paper's test (E_min): stop when the relative
    /// change per pass of the energy per particle, averaged over `energy_window` passes, is below
    /// this value and density control is nearly at rest.
    pub energy_tolerance: Option<f64>,
    /// Number of passes over which the energy test averages. With 1 it compares consecutive passes,
    /// as printed.
    pub energy_window: usize,
    /// Maximum number of additions and deletions per pass, as a fraction of the particles, for
    /// density control to count as nearly at rest. If the value is 1 or more, the stop tests ignore
    /// density control.
    pub rest_share: f64,
    /// Energy of a particle in the target lattice (E_ideal), 0.554 to 7.84. It determines
    /// [`Parameters::spacing`].
    pub ideal_energy: f64,
    /// Add a particle where E is below this multiple of E_ideal.
    pub add_below: f64,
    /// Delete a particle where E is above this multiple of E_ideal.
    pub delete_above: f64,
    /// True if particles may be added. The paper's synthetic test (Table 3) does not add particles.
    /// If false, there is only one level.
    pub allow_insert: bool,
    /// Number of passes without density control at the end, during which the last newcomers settle.
    /// On levels before the last there are at most three such passes.
    pub closing_passes: u64,
    /// Two particles interact only if the dot product of their normals exceeds this value.
    pub normal_agreement: f64,
    /// Seed of all random numbers of a run.
    pub seed: u64,
    /// Number of levels of coarse-to-fine placement. The first level settles at `2^(levels - 1)`
    /// times h, the last at h.
    pub levels: u32,
    /// Maximum number of passes on each level before the last.
    pub coarse_passes: u64,
    /// Bins of the neighbour search on a GPU.
    pub binning: Binning,
    /// Order in which a GPU moves the particles of a pass.
    pub order: Order,
}

/// Bins of the neighbour search on a GPU.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Binning {
    /// One level of bins for each octave of h
    #[default]
    Graded,
    /// One level of bins for all particles, with the bin width that the maximum h requires (as in
    /// the paper)
    Uniform,
}

/// Order in which a GPU moves the particles of a pass.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Order {
    /// Classes of particles that do not interact with each other, one class at a time
    #[default]
    Classes,
    /// Bins in 27 colours, one colour at a time; the particles of a bin move one after another (as
    /// in the paper; requires uniform bins)
    Bins,
}

impl Default for Parameters {
    fn default() -> Self {
        Self {
            // on one level, the torus described at `REST_SHARE` takes 89 passes
            max_passes: 150,
            defect_tolerance: DEFECT_TOLERANCE,
            energy_tolerance: None,
            // docs/developer/method.md compares values of the energy window, the closing passes and
            // the number of levels (runs A to H)
            energy_window: 5,
            rest_share: REST_SHARE,
            ideal_energy: energy::ideal_energy(),
            // the printed 0.75 and 1.35 leave larger gaps: on the heart of method.md, the energy
            // reaches 0.92 of the ideal energy instead of 0.94 (runs B and C)
            add_below: 0.8,
            delete_above: 1.25,
            allow_insert: true,
            closing_passes: 10,
            // normals must be less than 90 degrees apart, so the two faces of a thin wall do not
            // interact
            normal_agreement: 0.0,
            seed: 0,
            levels: 3,
            // the coarsest level of the torus takes 53 passes
            coarse_passes: 100,
            binning: Binning::Graded,
            order: Order::Classes,
        }
    }
}

impl Parameters {
    /// Returns the parameters of the method as printed in the paper: at most 50 passes on one
    /// level, the printed stop test, limits and ideal energy, density control up to the last pass,
    /// one bin size, and the order by coloured bins (GPU only). All other parameters have their
    /// default values.
    pub fn as_printed() -> Self {
        Self {
            max_passes: 50,
            energy_tolerance: Some(0.0015),
            energy_window: 1,
            rest_share: 1.0,
            ideal_energy: energy::PRINTED_IDEAL_ENERGY,
            add_below: 0.75,
            delete_above: 1.35,
            closing_passes: 0,
            levels: 1,
            binning: Binning::Uniform,
            order: Order::Bins,
            ..Self::default()
        }
    }

    /// Returns the spacing, in units of h, of the hexagonal lattice in which each particle has the
    /// ideal energy (Eq. 1): 1 by default, and 0.657 for the ideal energy printed in the paper
    /// (3.462). This spacing scales the distance at which newcomers are placed, their minimum
    /// distance from other particles, and the radius of the first ring, which defines lattice
    /// defects.
    pub fn spacing(&self) -> f64 {
        energy::lattice_spacing(self.ideal_energy)
    }

    /// Returns the number of levels on which the particles settle.
    pub(crate) fn level_count(&self) -> u32 {
        // splitting edges between levels adds particles
        if self.allow_insert { self.levels.max(1) } else { 1 }
    }
}

/// One line of the log. With many materials, all statistics except `neighbours` exclude the held
/// particles of junction points and curves.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct PassRecord {
    /// Number of the pass, starting from 1.
    pub pass: u64,
    /// Sum of the energies (Eq. 1) of the particles after the movement.
    pub energy: f64,
    /// Number of particles after density control.
    pub count: usize,
    /// Number of particles added.
    pub inserted: usize,
    /// Number of particles deleted.
    pub deleted: usize,
    /// Number of particles removed because they left the surface. Always zero, because a pass
    /// rejects a step that cannot be projected.
    pub escaped: usize,
    /// Number of particles that took a step.
    pub moved: usize,
    /// Mean number of attempted steps per particle, including rejected steps.
    pub tries_per_particle: f64,
    /// Mean length of the neighbour lists.
    pub neighbours: f64,
    /// Number of lattice defects after the movement.
    pub lattice_defects: usize,
    /// Seconds since this run started the level.
    pub seconds: f64,
    /// Edge length of the level in units of h.
    pub scale: f64,
}

/// Result of a run.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Summary {
    /// Number of passes, including those before a resume.
    pub passes: u64,
    /// True if the stop test ended the run, false if the pass limit ended it.
    pub settled: bool,
    /// Number of particles of the last level that the final projection could not place on the
    /// surface. With many materials, this includes the seeds that are not on their interface.
    pub escaped: usize,
    /// Final energy per particle, divided by E_ideal.
    pub energy_ratio: f64,
}

/// Result of one pass by an engine.
#[derive(Clone, Copy, Debug, Default)]
pub struct PassOutcome {
    /// Sum of the energies (Eq. 1) of the particles after the movement.
    pub energy: f64,
    /// Number of particles after density control.
    pub count: usize,
    /// Number of particles added.
    pub inserted: usize,
    /// Number of particles deleted.
    pub deleted: usize,
    /// Number of particles that took a step.
    pub moved: usize,
    /// Mean number of attempted steps per particle, including rejected steps.
    pub tries_per_particle: f64,
    /// Mean length of the neighbour lists.
    pub neighbours: f64,
    /// Number of lattice defects after the movement.
    pub lattice_defects: usize,
}

/// Moves the particles, on the CPU or on a GPU. Every `REORDER_INTERVAL` passes an engine sorts
/// the particles and rebuilds all derived data. A run resumed at that point therefore gives the
/// same result as an uninterrupted run.
pub trait Engine {
    /// Moves every particle once, measures the energy and, if `density` is set, controls the
    /// density.
    fn pass(&mut self, pass: u64, density: bool) -> Result<PassOutcome>;

    /// Announces the last pass that controls the density. Up to that pass, an engine may start a
    /// pass before it has read the result of the previous pass.
    fn controls_density_until(&mut self, _pass: u64) {}

    /// Returns a copy of the particles.
    fn particles(&mut self) -> Result<ParticleSet>;

    /// Returns the strata of the particles; empty for one object.
    fn strata(&self) -> &[Stratum] {
        &[]
    }

    /// Returns the statistics of the device, if the engine uses one.
    fn device_report(&self) -> Option<DeviceReport> {
        None
    }
}

/// One level of coarse-to-fine placement.
pub(crate) struct Level {
    /// Edge length in units of h.
    pub scale: f64,
    /// Number of passes on the earlier levels.
    pub before: u64,
    /// Maximum number of passes on this level.
    pub max_passes: u64,
}

/// Settles the particles on a single level, whose edge length is h, with the given engine. At the
/// end, the CPU projects them onto F = 0 with a tolerance of 1e-8 voxels.
pub fn settle_with<S: Implicit>(
    engine: &mut dyn Engine,
    fields: &Fields<S>,
    parameters: &Parameters,
    resumed: &[PassRecord],
    mut observe: impl FnMut(&PassRecord, &mut dyn Engine) -> Result<()>,
) -> Result<(ParticleSet, Summary)> {
    let level = Level { scale: 1.0, before: 0, max_passes: parameters.max_passes };
    let (state, summary) = settle_level(engine, fields, parameters, &level, resumed, &mut observe)?;
    Ok((state.set, summary))
}

/// Works like [`settle_with`], but settles on one of several levels. `resumed` contains the records
/// of the passes already run on this level.
pub(crate) fn settle_level<S: Implicit>(
    engine: &mut dyn Engine,
    fields: &Fields<S>,
    parameters: &Parameters,
    level: &Level,
    resumed: &[PassRecord],
    observe: &mut dyn FnMut(&PassRecord, &mut dyn Engine) -> Result<()>,
) -> Result<(State, Summary)> {
    let start = Instant::now();
    let mut records = resumed.to_vec();
    let mut pass = records.last().map_or(level.before, |r| r.pass);
    let end = level.before + level.max_passes;
    let mut closing = closing_since(&records, parameters);
    let most = if level.scale > 1.0 { COARSE_CLOSING_PASSES } else { u64::MAX };
    let closing_passes = parameters.closing_passes.min(most);
    engine.controls_density_until(end.saturating_sub(closing_passes));
    while pass < end && closing.is_none_or(|since| pass < since + closing_passes) {
        pass += 1;
        let quiet = closing.is_some() || pass + closing_passes > end;
        let outcome = engine.pass(pass, !quiet)?;
        let record = PassRecord {
            pass,
            energy: outcome.energy,
            count: outcome.count,
            inserted: outcome.inserted,
            deleted: outcome.deleted,
            escaped: 0,
            moved: outcome.moved,
            tries_per_particle: outcome.tries_per_particle,
            neighbours: outcome.neighbours,
            lattice_defects: outcome.lattice_defects,
            seconds: start.elapsed().as_secs_f64(),
            scale: level.scale,
        };
        records.push(record);
        observe(&record, engine)?;
        closing = closing_since(&records, parameters);
    }
    let mut state = State::unlisted(engine.particles()?, parameters.normal_agreement).on(engine.strata().to_vec());
    let escaped = finish(&mut state, fields);
    let energy = state.measure().energy;
    let summary = Summary {
        passes: pass,
        settled: closing.is_some(),
        escaped,
        energy_ratio: energy / (parameters.ideal_energy * state.movable().max(1) as f64),
    };
    Ok((state, summary))
}

/// Returns the first pass that meets the stop test, if any. Density control is off in all later
/// passes.
fn closing_since(records: &[PassRecord], parameters: &Parameters) -> Option<u64> {
    let window = if parameters.energy_tolerance.is_some() { parameters.energy_window.max(1) } else { DEFECT_WINDOW };
    (window..records.len()).find_map(|last| {
        let (old, new) = (&records[last - window], &records[last]);
        // values per particle: a change in the count alone must not look like an improvement
        let before_control = |r: &PassRecord| (r.count + r.deleted - r.inserted).max(1) as f64;
        let change = |quantity: &dyn Fn(&PassRecord) -> f64| {
            let (old, new) = (quantity(old) / before_control(old), quantity(new) / before_control(new));
            (old - new) / new.max(f64::MIN_POSITIVE) / window as f64
        };
        let settled = match parameters.energy_tolerance {
            Some(tolerance) => change(&|r| r.energy).abs() < tolerance,
            None => new.lattice_defects == 0 || change(&|r| r.lattice_defects as f64) < parameters.defect_tolerance,
        };
        let churn = records[last + 1 - window..=last].iter().map(|r| r.inserted + r.deleted).sum::<usize>();
        let allowed =
            if new.scale > 1.0 { parameters.rest_share.max(COARSE_REST_SHARE) } else { parameters.rest_share };
        let rest = allowed >= 1.0 || churn as f64 <= allowed * window as f64 * new.count as f64;
        ((settled && rest) || is_balanced(&records[..=last], parameters)).then_some(new.pass)
    })
}

/// Returns whether density control adds about as many particles as it deletes while the fraction of
/// lattice defects hardly decreases. Compares the mean fraction over the last [`BALANCE_WINDOW`]
/// passes with the mean over the same number of preceding passes. `rest_share` limits the mean net
/// growth per pass over the last window.
fn is_balanced(records: &[PassRecord], parameters: &Parameters) -> bool {
    let window = BALANCE_WINDOW;
    let Some(before) = records.len().checked_sub(2 * window) else { return false };
    let defects = |records: &[PassRecord]| {
        let share = |r: &PassRecord| r.lattice_defects as f64 / (r.count + r.deleted - r.inserted).max(1) as f64;
        records.iter().map(share).sum::<f64>() / window as f64
    };
    let (old, new) = (&records[before..before + window], &records[before + window..]);
    let falls = (defects(old) - defects(new)) / defects(new).max(f64::MIN_POSITIVE) / window as f64;
    let growth = new.iter().map(|r| r.inserted as f64 - r.deleted as f64).sum::<f64>();
    let is_at_rest = growth.abs() <= parameters.rest_share * window as f64 * new[window - 1].count as f64;
    parameters.energy_tolerance.is_none() && falls < parameters.defect_tolerance && is_at_rest
}

/// Projects every particle, except held particles, onto F = 0 or its interface with a tolerance of
/// 1e-8 voxels, and removes particles whose projection fails. Returns the number of removed
/// particles. Sorts the particles spatially first, so that a run resumed after the last pass gives
/// the same result.
fn finish<S: Implicit>(state: &mut State, fields: &Fields<S>) -> usize {
    state.sort_spatially();
    let spacing = fields.surface.min_spacing();
    let set = &state.set;
    let projected: Vec<_> = (state.held..state.len())
        .into_par_iter()
        .map(|i| {
            let limit = 0.5 * set.sizes[i].max(spacing);
            fields.project(state.stratum(i), set.positions[i], limit, FINAL_TOLERANCE * spacing)
        })
        .collect();
    let mut kept: Vec<u32> = (0..state.held as u32).collect();
    for (i, place) in (state.held..).zip(projected) {
        if let Some((position, normal, size)) = place {
            state.set.positions[i] = position;
            state.set.normals[i] = normal;
            state.set.sizes[i] = size;
            kept.push(i as u32);
        }
    }
    let escaped = state.len() - kept.len();
    if escaped > 0 {
        state.take(&kept);
    }
    state.rebuild_lists();
    escaped
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns the records of 40 passes over 1000 particles, with the given number of lattice
    /// defects in each pass and `churn` particles added per pass.
    fn records(defects: impl Fn(u64) -> usize, churn: usize, scale: f64) -> Vec<PassRecord> {
        let record = |pass| PassRecord {
            pass,
            energy: 700.0,
            count: 1000 + churn,
            inserted: churn,
            deleted: 0,
            escaped: 0,
            moved: 1000,
            tries_per_particle: 1.0,
            neighbours: 20.0,
            lattice_defects: defects(pass),
            seconds: 0.0,
            scale,
        };
        (1..=40).map(record).collect()
    }

    #[test]
    fn additions_and_deletions_in_balance_end_the_run() {
        let parameters = Parameters::default();
        // each pass adds 1 % of the particles and deletes 1 %; together this is ten times
        // `rest_share`
        let in_balance = |defects: &dyn Fn(u64) -> usize, growth: usize| -> Vec<PassRecord> {
            let balanced = |r: PassRecord| PassRecord {
                deleted: r.inserted - growth,
                count: 1000 + growth * r.pass as usize,
                ..r
            };
            records(defects, 10, 1.0).into_iter().map(balanced).collect()
        };
        assert_eq!(closing_since(&in_balance(&|_| 100, 0), &parameters), Some(2 * BALANCE_WINDOW as u64));
        // the run goes on if the defects still fall by 1 % per pass or the count still grows by 0.5
        // % per pass
        assert_eq!(
            closing_since(&in_balance(&|pass| (1000.0 * 0.99f64.powi(pass as i32)) as usize, 0), &parameters),
            None
        );
        assert_eq!(closing_since(&in_balance(&|_| 100, 5), &parameters), None);
        let paper = Parameters { energy_tolerance: Some(0.0), ..Parameters::default() };
        assert_eq!(closing_since(&in_balance(&|_| 100, 0), &paper), None);
    }

    #[test]
    fn passes_continue_while_defects_fall_or_density_changes() {
        let parameters = Parameters::default();
        let closing = |records: &[PassRecord]| closing_since(records, &parameters);
        // the defects fall by 1 % per pass until pass 20 and then stay constant; at pass 22, the
        // mean decrease over the window of ten passes is still 0.8 % per pass, above the tolerance
        // of 0.75 %
        let falling = |pass: u64| (900.0 * 0.99f64.powi(pass.min(20) as i32)) as usize;
        assert_eq!(closing(&records(falling, 0, 1.0)), Some(23));
        assert_eq!(closing(&records(|pass| 900 - 9 * pass as usize, 0, 1.0)), None);
        assert_eq!(closing(&records(|_| 300, 0, 1.0)), Some(11), "the first pass that has a window behind it");
        assert_eq!(closing(&records(|pass| 300 + pass as usize, 0, 1.0)), Some(11));
        assert_eq!(closing(&records(|_| 0, 0, 1.0)), Some(11));
        // one newcomer per pass (0.1 % of the particles) is below the limit of 0.2 % on the last
        // level; three are above it, but below the limit of 5 % on a coarse level
        assert_eq!(closing(&records(|_| 300, 1, 1.0)), Some(11));
        assert_eq!(closing(&records(|_| 300, 3, 1.0)), None);
        assert_eq!(closing(&records(|_| 300, 3, 2.0)), Some(11));
        assert_eq!(closing(&records(|_| 300, 80, 2.0)), None);
    }

    #[test]
    fn the_test_of_the_paper_looks_at_the_energy_alone() {
        let test = |tolerance| {
            let parameters = Parameters { energy_tolerance: Some(tolerance), ..Parameters::default() };
            closing_since(&records(|pass| 900 - 9 * pass as usize, 0, 1.0), &parameters)
        };
        assert_eq!(test(0.0015), Some(6));
        assert_eq!(test(0.0), None, "0 runs all passes");
        let mut falling = records(|_| 300, 0, 1.0);
        // with the printed parameters, consecutive passes are compared and density control is
        // ignored
        let busy = records(|_| 300, 500, 1.0);
        let closing = |parameters: &Parameters| closing_since(&busy, parameters);
        assert_eq!(closing(&Parameters::as_printed()), Some(2));
        assert_eq!(closing(&Parameters { energy_window: 7, ..Parameters::as_printed() }), Some(8));
        assert_eq!(closing(&Parameters { rest_share: 0.3, ..Parameters::as_printed() }), None);
        falling.iter_mut().for_each(|r| r.energy *= 0.998f64.powi(r.pass as i32));
        let parameters = Parameters { energy_tolerance: Some(0.0015), ..Parameters::default() };
        assert_eq!(closing_since(&falling, &parameters), None);
    }
}
