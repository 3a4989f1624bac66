//! Runs passes on the device: submits a pass, waits for it, and repeats it if the neighbour lists
//! or the classes overflow.
//!
//! A pass with density control reads one set of listed buffers and writes the other. It can
//! therefore be submitted before the host has read the result of the previous pass, so the device
//! does not idle. The number of particles stays on the device (`shaders/begin_pass.wgsl`). A pass
//! submitted early is discarded if the run ends, if lists or classes of the previous pass
//! overflowed, or if there are more particles than the pass can process. In all these cases its
//! input is unchanged.

use super::commands::{Command, Encoded, encode, submit};
use super::constants::{
    CLASSES, COUNT_ON_DEVICE, WORD_CLASSES, WORD_COUNT, WORD_DEFECTS, WORD_ENERGY, WORD_KEPT, WORD_LISTED,
    WORD_LONGEST_LIST, WORD_LONGEST_WAY, WORD_MOVED, WORD_TRIES, WORDS,
};
use super::engine::{EncodedPass, GpuEngine, SubmittedPass};
use super::memory::read_staging;
use super::parameters::plan_block;
use super::report::DeviceReport;
use super::schedule::{Plan, Step, listed, steps};
use crate::constants::{REBUILD_MOVE, REORDER_INTERVAL};
use crate::settle::{Engine, PassOutcome};
use isoparticles_field::materials::Stratum;
use isoparticles_field::particle_set::ParticleSet;
use isoparticles_stage::error::Result;
use std::time::Instant;

/// Number of classes dispatched in addition to the classes in use. Where particles are dense, the
/// number in use varies from pass to pass, and a pass that needs more classes must be repeated.
/// Measured on the heart of docs/developer/method.md
/// (`--backend gpu --adapter llvmpipe --max-passes 60`), with the default seeds and with
/// `seed --from marching-cubes`: with 0, 2 and 4 additional classes, no pass is repeated for lack
/// of classes. Each additional class costs an empty dispatch.
const CLASSES_TO_SPARE: u32 = 2;

impl GpuEngine<'_> {
    /// Runs individual steps and returns the words that the host reads.
    #[cfg(test)]
    pub(super) fn run_steps(&mut self, pass: u64, steps: Vec<Step>, sort: bool) -> Result<Vec<u32>> {
        let plan = Plan { sort, bring: sort && !self.listed, density: false, set: self.set, classes: CLASSES };
        let mut all = vec![super::schedule::beginning()];
        all.extend(steps.into_iter().filter(|step| step.kernel != "begin_pass"));
        let encoded = self.encode(&all, plan, self.count);
        let submitted = self.submit_pass(pass, EncodedPass { plan, room: self.count, encoded }, self.count, plan)?;
        self.wait_for(&submitted)
    }

    /// Returns the capacity, in particles, of a pass that is submitted before the number of its
    /// particles is known: about 1/16 more than the current number, limited by the size of the
    /// buffers. If there are more particles, the pass is discarded and submitted again after the
    /// previous pass has ended.
    fn room_ahead(&self) -> u32 {
        (self.count + self.count / 16 + 64).min(self.rows)
    }

    /// Returns the commands of a pass with a capacity of at least `least` particles. Uses the
    /// commands already encoded if they fit; otherwise encodes new commands for `room` particles.
    fn commands(&mut self, plan: Plan, least: u32, room: u32) -> EncodedPass {
        let ready = self.encoded_next.take().filter(|ahead| ahead.plan == plan && least <= ahead.room);
        ready.unwrap_or_else(|| self.make_commands(plan, room))
    }

    fn make_commands(&mut self, plan: Plan, room: u32) -> EncodedPass {
        let steps = steps(room, &self.levels, self.settling.order, plan);
        let encoded = self.encode(&steps, plan, room);
        EncodedPass { plan, room, encoded }
    }

    /// Encodes steps. If the plan requires it, the particles are first copied back to the listed
    /// buffers.
    fn encode(&mut self, steps: &[Step], plan: Plan, room: u32) -> Encoded {
        let key = |step: &Step| (step.label, step.round, step.aliases.first().map_or("", |alias| alias.1));
        let buffer_called = |name: &str| self.memory.get(name);
        for step in steps {
            if !self.groups.contains_key(&key(step)) {
                let group = self.kernels.bind(&self.gpu.device, buffer_called, step.kernel, step.round, step.aliases);
                self.groups.insert(key(step), group);
            }
        }
        let memory = &self.memory;
        let mut commands = Vec::with_capacity(steps.len() + 4);
        if plan.bring {
            for (from, to) in ["place", "normal"].into_iter().zip(listed(plan.set)) {
                let bytes = 16 * u64::from(room);
                commands.push(Command::Copy { from: memory.get(from), to: memory.get(to), bytes });
            }
        }
        if plan.sort {
            commands.push(Command::Clear { buffer: memory.get("class_counts") });
        }
        commands.extend(steps.iter().map(|step| {
            let group = &self.groups[&key(step)];
            match step.workgroups {
                Some(workgroups) => Command::Run { kernel: step.kernel, group, workgroups },
                None => Command::RunIndirect {
                    kernel: step.kernel,
                    group,
                    arguments: memory.get("class_arguments"),
                    offset: 12 * u64::from(step.round),
                },
            }
        }));
        let words = &self.words[plan.set];
        commands.push(Command::Copy { from: memory.get("words"), to: words, bytes: 4 * WORDS as u64 });
        encode(self.gpu, &self.kernels, &commands, &mut self.profile)
    }

    /// Submits a pass over `count` particles. `before` is the plan of the previous pass, which may
    /// still be running.
    fn submit_pass(&self, pass: u64, ahead: EncodedPass, count: u32, before: Plan) -> Result<SubmittedPass> {
        let EncodedPass { plan, room, encoded } = ahead;
        let rooms = (self.list_room, before.classes);
        let block = plan_block(pass, count, self.settling.allow_insert, room, rooms);
        self.write("planned", block.bytes());
        let (submission, timed) = submit(self.gpu, encoded);
        self.gpu.check()?;
        Ok(SubmittedPass { pass, plan, room, submission, timed })
    }

    /// Submits a pass. The previous pass must have ended.
    fn submit_now(&mut self, pass: u64, plan: Plan) -> Result<SubmittedPass> {
        let begun = Instant::now();
        let commands = self.commands(plan, self.count, self.count);
        let submitted = self.submit_pass(pass, commands, self.count, plan)?;
        self.spent.encode_seconds += begun.elapsed().as_secs_f64();
        Ok(submitted)
    }

    /// Prepares work while the device runs a pass: submits the next pass if it is likely to be
    /// valid, and encodes the commands of the first pass that has not been submitted.
    fn look_ahead(&mut self, now: &SubmittedPass) -> Result<()> {
        let after = |plan: Plan, pass: u64| {
            let density = plan.density && pass < self.last_control;
            let sort = plan.sort || (pass + 1) % REORDER_INTERVAL == 1;
            let set = if plan.density { 1 - plan.set } else { plan.set };
            Plan { sort, bring: sort && !plan.density, density, set, classes: self.classes }
        };
        let next = after(now.plan, now.pass);
        let mut to_make = next;
        // there is only one set of timestamp queries, so a timed pass must end before the next is
        // submitted
        if next.density && self.submitted.is_none() && self.changed <= self.count / 16 && !self.gpu.timestamps {
            let one_after = after(next, now.pass + 1);
            // commands encoded one pass ago may have less spare capacity than new ones; half of the
            // spare capacity is enough
            let least = self.count.midpoint(self.room_ahead());
            let commands = self.commands(next, least, self.room_ahead());
            self.submitted = Some(self.submit_pass(now.pass + 1, commands, COUNT_ON_DEVICE, now.plan)?);
            to_make = one_after;
        }
        if self.encoded_next.is_none() {
            self.encoded_next = Some(self.make_commands(to_make, self.room_ahead()));
        }
        Ok(())
    }

    /// Waits for a pass and returns its words.
    fn wait_for(&self, submitted: &SubmittedPass) -> Result<Vec<u32>> {
        read_staging(self.gpu, &self.words[submitted.plan.set], 4 * WORDS as u64, Some(&submitted.submission))
    }

    /// Runs a pass and repeats it until neither lists nor classes overflow. Returns the plan and
    /// the words of the pass.
    fn run_until_valid(&mut self, pass: u64, density: bool) -> Result<(Plan, Vec<u32>)> {
        // discard an early submission that does not match this pass
        let ready = self.submitted.take().filter(|submitted| density && submitted.pass == pass);
        let sort = density || self.listed || self.stale || pass % REORDER_INTERVAL == 1;
        let mut plan = Plan { sort, bring: sort && !self.listed, density, set: self.set, classes: self.classes };
        let mut submitted = match ready {
            Some(submitted) => submitted,
            None => self.submit_now(pass, plan)?,
        };
        loop {
            self.look_ahead(&submitted)?;
            let waiting = Instant::now();
            self.profile.collect(self.gpu, &submitted.timed)?;
            let words = self.wait_for(&submitted)?;
            self.spent.wait_seconds += waiting.elapsed().as_secs_f64();
            let (longest, classes) = (words[WORD_LONGEST_LIST], words[WORD_CLASSES]);
            // begin_pass.wgsl applies the same test before the next pass
            if longest <= self.list_room && classes <= submitted.plan.classes {
                if classes + CLASSES_TO_SPARE / 2 > self.classes || self.classes == CLASSES {
                    self.classes = (classes + CLASSES_TO_SPARE).min(CLASSES);
                }
                return Ok((submitted.plan, words));
            }
            // this pass is repeated; its output is discarded, and a pass already submitted after it
            // has no effect
            (self.submitted, self.listed, self.classes) = (None, true, CLASSES);
            (plan.bring, plan.classes) = (false, CLASSES);
            if longest > self.list_room {
                self.make_lists(longest)?;
            }
            submitted = self.submit_now(pass, plan)?;
        }
    }
}

impl Engine for GpuEngine<'_> {
    fn device_report(&self) -> Option<DeviceReport> {
        Some(self.report())
    }

    fn controls_density_until(&mut self, pass: u64) {
        self.last_control = pass;
    }

    fn pass(&mut self, pass: u64, density: bool) -> Result<PassOutcome> {
        let (plan, words) = self.run_until_valid(pass, density)?;
        let before = self.count;
        let (after, kept) = (words[WORD_COUNT], words[WORD_KEPT]);
        self.listed = plan.density;
        self.set = if plan.density { 1 - plan.set } else { plan.set };
        self.stale = f64::from(f32::from_bits(words[WORD_LONGEST_WAY])) > REBUILD_MOVE;
        self.count = after;
        self.changed = after.abs_diff(before);
        if self.submitted.as_ref().is_some_and(|submitted| after > submitted.room) {
            self.submitted = None;
        }
        if after > self.rows {
            self.grow()?;
        }
        let held = self.carried.held();
        let movable = f64::from(before.max(1)) - held as f64;
        Ok(PassOutcome {
            energy: f64::from(f32::from_bits(words[WORD_ENERGY])),
            count: after as usize - held,
            inserted: (after - kept) as usize,
            deleted: (before - kept) as usize,
            moved: words[WORD_MOVED] as usize,
            tries_per_particle: f64::from(words[WORD_TRIES]) / movable.max(1.0),
            neighbours: f64::from(words[WORD_LISTED]) / f64::from(before.max(1)),
            lattice_defects: words[WORD_DEFECTS] as usize,
        })
    }

    fn particles(&mut self) -> Result<ParticleSet> {
        self.bring_back()
    }

    fn strata(&self) -> &[Stratum] {
        &self.strata
    }
}
