//! A pass over the particles on the device: handed over, waited for, done again where a list had no room.
//!
//! A pass that controls the density begins from one set of listed buffers and leaves its result in the other, so it can be handed over before the host has read
//! what the pass before it did: the device goes from one to the next without waiting, and the number of particles goes with it (`shaders/begin_pass.wgsl`). Where that pass
//! was not to be (the run ends, the lists had no room, more particles came than it was made for), what it began from is still there.

use super::commands::{Command, Encoded, encode, submit};
use super::constants::{
    AS_LEFT, CLASSES, WORD_CLASSES, WORD_COUNT, WORD_DEFECTS, WORD_ENERGY, WORD_KEPT, WORD_LISTED, WORD_LONGEST_LIST,
    WORD_LONGEST_WAY, WORD_MOVED, WORD_TRIES, WORDS,
};
use super::engine::GpuEngine;
use super::memory::read_staging;
use super::parameters::plan_block;
use super::report::DeviceReport;
use super::schedule::{Plan, Step, listed, steps};
use crate::constants::REBUILD_MOVE;
use crate::settle::{Engine, PassOutcome, REORDER_INTERVAL};
use isoparticles_field::materials::Stratum;
use isoparticles_field::particle_set::ParticleSet;
use isoparticles_stage::error::Result;
use std::time::Instant;

/// Classes that passes are made for beyond those in use: crowds come and go, and a pass that needs more is done again.
const CLASSES_TO_SPARE: u32 = 2;

/// Commands of the next pass, made while the device works.
pub(super) struct Ahead {
    plan: Plan,
    /// Particles that they are made for.
    room: u32,
    encoded: Encoded,
}

/// A pass that was handed over.
pub(super) struct Flight {
    pass: u64,
    plan: Plan,
    /// Particles that it was made for.
    room: u32,
    submission: wgpu::SubmissionIndex,
    /// The kernels that have timestamps.
    timed: Vec<&'static str>,
}

impl GpuEngine<'_> {
    /// Runs steps alone; returns the words that the host reads.
    #[cfg(test)]
    pub(super) fn run_steps(&mut self, pass: u64, steps: Vec<Step>, sort: bool) -> Result<Vec<u32>> {
        let plan = Plan { sort, bring: sort && !self.listed, density: false, set: self.set, classes: CLASSES };
        let mut all = vec![super::schedule::beginning()];
        all.extend(steps.into_iter().filter(|step| step.kernel != "begin_pass"));
        let encoded = self.encode(&all, plan, self.count);
        let flight = self.hand_over(pass, Ahead { plan, room: self.count, encoded }, self.count, plan)?;
        self.wait_for(&flight)
    }

    /// Particles that a pass is made for whose number is not known yet: one in sixteen may come, and there are never more than there is room for.
    fn room_ahead(&self) -> u32 {
        (self.count + self.count / 16 + 64).min(self.rows)
    }

    /// Commands of a pass for at least `least` particles, made for `room` where none are ready.
    fn commands(&mut self, plan: Plan, least: u32, room: u32) -> Ahead {
        let ready = self.ahead.take().filter(|ahead| ahead.plan == plan && least <= ahead.room);
        ready.unwrap_or_else(|| self.make_commands(plan, room))
    }

    fn make_commands(&mut self, plan: Plan, room: u32) -> Ahead {
        let steps = steps(room, &self.levels, self.settling.order, plan);
        let encoded = self.encode(&steps, plan, room);
        Ahead { plan, room, encoded }
    }

    /// Encodes steps, after bringing the particles back to the listed buffers if the plan says so.
    fn encode(&mut self, steps: &[Step], plan: Plan, room: u32) -> Encoded {
        let key = |step: &Step| (step.label, step.round, step.aliases.first().map_or("", |alias| alias.1));
        for step in steps {
            if !self.groups.contains_key(&key(step)) {
                let group = self.kernels.bind(self.gpu, &self.memory, step.kernel, step.round, step.aliases);
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

    /// Hands a pass over `count` particles to the device; `before` is the pass before, where that is still at work.
    fn hand_over(&self, pass: u64, ahead: Ahead, count: u32, before: Plan) -> Result<Flight> {
        let Ahead { plan, room, encoded } = ahead;
        let rooms = (self.list_room, before.classes);
        let block = plan_block(pass, count, self.settling.allow_insert, room, rooms);
        self.write("planned", block.bytes());
        let (submission, timed) = submit(self.gpu, encoded);
        self.gpu.check()?;
        Ok(Flight { pass, plan, room, submission, timed })
    }

    /// Hands over a pass at its turn.
    fn set_off(&mut self, pass: u64, plan: Plan) -> Result<Flight> {
        let begun = Instant::now();
        let commands = self.commands(plan, self.count, self.count);
        let flight = self.hand_over(pass, commands, self.count, plan)?;
        self.spent.encode_seconds += begun.elapsed().as_secs_f64();
        Ok(flight)
    }

    /// While the device works on a pass: hands over the next one if it is certain enough to be, and makes the commands of the one after.
    fn look_ahead(&mut self, now: &Flight) -> Result<()> {
        let after = |plan: Plan, pass: u64| {
            let density = plan.density && pass < self.last_control;
            let sort = plan.sort || (pass + 1) % REORDER_INTERVAL == 1;
            let set = if plan.density { 1 - plan.set } else { plan.set };
            Plan { sort, bring: sort && !plan.density, density, set, classes: self.classes }
        };
        let next = after(now.plan, now.pass);
        let mut to_make = next;
        // timestamps are of one pass at a time
        if next.density && self.flight.is_none() && self.changed <= self.count / 16 && !self.gpu.timestamps {
            let one_after = after(next, now.pass + 1);
            // those ready were made a pass ago, when there may have been fewer: half of the room to spare is enough
            let least = self.count.midpoint(self.room_ahead());
            let commands = self.commands(next, least, self.room_ahead());
            self.flight = Some(self.hand_over(now.pass + 1, commands, AS_LEFT, now.plan)?);
            to_make = one_after;
        }
        if self.ahead.is_none() {
            self.ahead = Some(self.make_commands(to_make, self.room_ahead()));
        }
        Ok(())
    }

    /// Waits for a pass to end; returns its words.
    fn wait_for(&self, flight: &Flight) -> Result<Vec<u32>> {
        read_staging(self.gpu, &self.words[flight.plan.set], 4 * WORDS as u64, Some(&flight.submission))
    }

    /// Does a pass until its lists have room; returns its plan and words.
    fn fly(&mut self, pass: u64, density: bool) -> Result<(Plan, Vec<u32>)> {
        // one that was not to be is cast away
        let ready = self.flight.take().filter(|flight| density && flight.pass == pass);
        let sort = density || self.listed || self.stale || pass % REORDER_INTERVAL == 1;
        let mut plan = Plan { sort, bring: sort && !self.listed, density, set: self.set, classes: self.classes };
        let mut flight = match ready {
            Some(flight) => flight,
            None => self.set_off(pass, plan)?,
        };
        loop {
            self.look_ahead(&flight)?;
            let waiting = Instant::now();
            self.profile.collect(self.gpu, &flight.timed)?;
            let words = self.wait_for(&flight)?;
            self.spent.wait_seconds += waiting.elapsed().as_secs_f64();
            let (longest, classes) = (words[WORD_LONGEST_LIST], words[WORD_CLASSES]);
            // the device asks the same where the next pass begins (begin_pass.wgsl)
            if longest <= self.list_room && classes <= flight.plan.classes {
                if classes + CLASSES_TO_SPARE / 2 > self.classes || self.classes == CLASSES {
                    self.classes = (classes + CLASSES_TO_SPARE).min(CLASSES);
                }
                return Ok((flight.plan, words));
            }
            // what the pass has done is cast away, and what was to follow it has done nothing
            (self.flight, self.listed, self.classes) = (None, true, CLASSES);
            (plan.bring, plan.classes) = (false, CLASSES);
            if longest > self.list_room {
                self.make_lists(longest)?;
            }
            flight = self.set_off(pass, plan)?;
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
        let (plan, words) = self.fly(pass, density)?;
        let before = self.count;
        let (after, kept) = (words[WORD_COUNT], words[WORD_KEPT]);
        self.listed = plan.density;
        self.set = if plan.density { 1 - plan.set } else { plan.set };
        self.stale = f64::from(f32::from_bits(words[WORD_LONGEST_WAY])) > REBUILD_MOVE;
        self.count = after;
        self.changed = after.abs_diff(before);
        if self.flight.as_ref().is_some_and(|flight| after > flight.room) {
            self.flight = None;
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
