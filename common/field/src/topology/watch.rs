//! How far the work is, slice by slice, and whether it shall go on.

pub(super) use isoparticles_file::monitor::Interrupted;
use isoparticles_file::monitor::{Counter, Monitor};

/// Watches work that goes through the slices of a volume several times.
pub(super) struct Watch<'a> {
    monitor: &'a dyn Monitor,
    counter: Box<dyn Counter + 'a>,
}

impl<'a> Watch<'a> {
    /// Work of so many slices in all.
    pub(super) fn new(monitor: &'a dyn Monitor, slices: usize) -> Self {
        Self { monitor, counter: monitor.counter("topology", Some(slices as u64)) }
    }

    /// A slice more begins.
    pub(super) fn slice(&self) -> Result<(), Interrupted> {
        self.monitor.check()?;
        self.counter.add(1);
        Ok(())
    }
}
