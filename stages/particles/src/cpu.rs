//! Settling on the CPU: the engine that runs a pass, and the entry points for one object and for
//! many materials.

use crate::coarse::{MakeEngine, settle_levels};
use crate::constants::REORDER_INTERVAL;
use crate::density::{self, Limits};
use crate::gpu::DeviceReport;
use crate::implicit::{Implicit, Interfaces};
use crate::movement;
use crate::settle::{Engine, Level, Parameters, PassOutcome, PassRecord, Summary, settle_level};
use crate::state::{Fields, Measures, State};
use isoparticles_field::materials::{Indicators, Stratum};
use isoparticles_field::particle_set::{ParticleSet, Strata};
use isoparticles_stage::error::Result;

#[cfg(test)]
pub(crate) mod scenes;
#[cfg(test)]
mod tests;

/// Settles particles on the CPU with the threads of the current rayon pool. `resumed` contains the
/// records of the passes already run and the particles after them. `observe` receives each new
/// record, can read the particles, and can end the run with an error.
pub fn settle(
    seeds: &ParticleSet,
    resumed: Option<(ParticleSet, &[PassRecord])>,
    fields: &Fields,
    parameters: &Parameters,
    mut observe: impl FnMut(&PassRecord, &mut dyn Engine) -> Result<()>,
) -> Result<(ParticleSet, Summary)> {
    let (set, summary, _) = settle_levels(seeds, resumed, fields, parameters, &OnCpu(parameters), &mut observe)?;
    Ok((set, summary))
}

/// Multi-material particles with their strata.
pub type OnStrata = (ParticleSet, Strata);

/// Settles multi-material particles on their interfaces. Works like [`settle`], but on a single
/// level. The particles of junction points and curves come first; they are held and do not move.
/// Particles that do not lie on their interface are removed at the start and at the end.
pub fn settle_interfaces<I: Indicators>(
    seeds: &OnStrata,
    resumed: Option<(OnStrata, &[PassRecord])>,
    fields: &Fields<Interfaces<'_, I>>,
    parameters: &Parameters,
    mut observe: impl FnMut(&PassRecord, &mut dyn Engine) -> Result<()>,
) -> Result<(OnStrata, Summary)> {
    let make = |set, strata| Ok(Box::new(CpuEngine::new(set, strata, fields, parameters)) as Box<dyn Engine + '_>);
    let (settled, summary, _) = settle_interfaces_with(make, seeds, resumed, fields, parameters, &mut observe)?;
    Ok((settled, summary))
}

/// Works like [`settle_interfaces`], but uses the engine that `make` creates from the particles and
/// their strata.
pub(crate) fn settle_interfaces_with<'e, S: Implicit>(
    make: impl FnOnce(ParticleSet, Vec<Stratum>) -> Result<Box<dyn Engine + 'e>>,
    seeds: &OnStrata,
    resumed: Option<(OnStrata, &[PassRecord])>,
    fields: &Fields<'_, S>,
    parameters: &Parameters,
    observe: &mut dyn FnMut(&PassRecord, &mut dyn Engine) -> Result<()>,
) -> Result<(OnStrata, Summary, Option<DeviceReport>)> {
    let segments = &seeds.1.segments;
    let mut real = State::unlisted(seeds.0.clone(), parameters.normal_agreement).on(seeds.1.of.clone());
    let kept: Vec<u32> = (0..real.len())
        .filter(|&i| i < real.held || fields.surface.is_real(real.stratum(i), real.set.positions[i]))
        .map(|i| i as u32)
        .collect();
    let unreal = real.len() - kept.len();
    real.take(&kept);
    let (set, strata, records) = match resumed {
        Some(((set, strata), records)) => (set, strata.of, records),
        None => (real.set, real.strata, &[][..]),
    };
    let mut engine = make(set, strata)?;
    let level = Level { scale: 1.0, before: 0, max_passes: parameters.max_passes };
    let (state, mut summary) = settle_level(engine.as_mut(), fields, parameters, &level, records, observe)?;
    summary.escaped += unreal;
    let settled = (state.set, Strata { of: state.strata, segments: segments.clone() });
    Ok((settled, summary, engine.device_report()))
}

/// Creates engines that move the particles on the CPU.
pub(crate) struct OnCpu<'a>(pub &'a Parameters);

impl MakeEngine for OnCpu<'_> {
    fn make<'f>(&self, set: ParticleSet, fields: &'f Fields<'f>) -> Result<Box<dyn Engine + 'f>>
    where
        Self: 'f,
    {
        Ok(Box::new(CpuEngine::new(set, Vec::new(), fields, self.0)))
    }
}

/// Engine that moves the particles on the CPU.
pub(crate) struct CpuEngine<'a, S> {
    state: State,
    fields: &'a Fields<'a, S>,
    parameters: Parameters,
}

impl<'a, S: Implicit> CpuEngine<'a, S> {
    pub(crate) fn new(
        set: ParticleSet,
        strata: Vec<Stratum>,
        fields: &'a Fields<'a, S>,
        parameters: &Parameters,
    ) -> Self {
        let mut state = State::unlisted(set, parameters.normal_agreement).at_spacing(parameters.spacing()).on(strata);
        state.sort_spatially();
        Self { state, fields, parameters: parameters.clone() }
    }
}

impl<S: Implicit> Engine for CpuEngine<'_, S> {
    fn pass(&mut self, pass: u64, density: bool) -> Result<PassOutcome> {
        let (state, parameters) = (&mut self.state, &self.parameters);
        if pass % REORDER_INTERVAL == 1 {
            // checkpoints are written only just before a sort, so a resumed run starts with the
            // particles in the same order
            state.sort_spatially();
        }
        state.rebuild();
        let moves = movement::pass(state, self.fields);
        let Measures { energy, lattice_defects } = state.measure();
        let (movable, neighbours) = (state.movable(), state.neighbours.mean_count());
        let limits = Limits {
            ideal_energy: parameters.ideal_energy,
            add_below: parameters.add_below,
            delete_above: parameters.delete_above,
        };
        let changes = if density {
            density::control(state, self.fields, &limits, parameters.seed, pass, parameters.allow_insert)
        } else {
            density::Changes::default()
        };
        Ok(PassOutcome {
            energy,
            count: state.movable(),
            inserted: changes.inserted,
            deleted: changes.deleted,
            moved: moves.moved,
            tries_per_particle: moves.tries as f64 / movable.max(1) as f64,
            neighbours,
            lattice_defects,
        })
    }

    fn particles(&mut self) -> Result<ParticleSet> {
        Ok(self.state.set.clone())
    }

    fn strata(&self) -> &[Stratum] {
        &self.state.strata
    }
}
