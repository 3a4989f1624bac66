//! Progress and interruption of the work, slice by slice.

pub(super) use isoparticles_file::monitor::Interrupted;
use isoparticles_file::monitor::{Counter, Monitor};

/// Watches work that passes several times through the slices of a volume.
pub(super) struct Watch<'a> {
    monitor: &'a dyn Monitor,
    counter: Box<dyn Counter + 'a>,
}

impl<'a> Watch<'a> {
    /// Watches work of `slices` slices in total.
    pub(super) fn new(monitor: &'a dyn Monitor, slices: usize) -> Self {
        Self { monitor, counter: monitor.counter("topology", Some(slices as u64)) }
    }

    /// Counts the start of a slice; fails if the monitor interrupts the work.
    pub(super) fn slice(&self) -> Result<(), Interrupted> {
        self.monitor.check()?;
        self.counter.add(1);
        Ok(())
    }
}
